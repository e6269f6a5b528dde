import math

import numpy as np
import pytest

from sim.metrics import Histogram, Metrics, euler_xyz, merge_display
from sim.truth import TruthSample
from spatial.frames import Cam, Frame, Object, W
from spatial.pose import Pose
from spatial.rotation import exp_so3
from spatial.tracked import TrackedObject, TrackedObjects, TrackState

MS = 1_000_000
DT_NS = 5 * MS
START_NS = 1_700_000_000_000_000_000
Offset = tuple[float, float, float]


def truth(i: int, *, far_m: float = 1.0) -> TruthSample:
    sway = Pose[W, Frame].exp((0.05 * math.sin(0.05 * i), 0, 2.0, 0.1 * math.sin(0.03 * i), 0, 0))
    target: Pose[W, Frame] = sway @ Pose.translated(0.0, 0.0, far_m)
    return TruthSample(START_NS + i * DT_NS, {"hc": sway, "object/plate": target})


def shown(
    i: int,
    *,
    state: TrackState = TrackState.TRACKED,
    error_m: Offset = (0.0, 0.0, 0.0),
    turn: Offset = (0.0, 0.0, 0.0),
    far_m: float = 1.0,
    T_cam_object: Pose[Cam, Object] | None = None,
    fixed: bool = True,
) -> TrackedObjects:
    true: Pose[Cam, Object] = Pose.translated(0.0, 0.0, far_m)
    if T_cam_object is None and fixed:
        T_cam_object = Pose.of(true.rotation @ exp_so3(turn), true.translation + error_m)
    stamp_ns = START_NS + i * DT_NS
    item = TrackedObject(
        slug="plate",
        revision=1,
        camera="hc",
        state=state,
        T_cam_object=T_cam_object,
        xi_w_cam_cam=np.zeros(6),
        covariance=np.eye(6),
        seen_ns=stamp_ns - 90 * MS if fixed else 0,
        motion_ns=stamp_ns,
        reset_count=0,
        reason="",
    )
    return TrackedObjects(stamp_ns, (item,))


def run(samples: list[TrackedObjects], *, far_m: float = 1.0) -> dict[str, object]:
    metrics = Metrics()
    for i, sample in enumerate(samples):
        metrics.put_tracked(sample)
        metrics.put_truth(truth(i, far_m=far_m))
    plate: dict[str, object] = metrics.figures()["objects"]["plate"]
    return plate


def test_a_perfect_tracker_has_no_error() -> None:
    figures = run([shown(i) for i in range(201)])
    assert figures["rmse_in_sight_m"] == pytest.approx(0.0, abs=1e-12)
    assert figures["rmse_whole_rad"] == pytest.approx(0.0, abs=1e-12)
    assert figures["rmse_bridged_m"] is None
    assert figures["max_step_residual_m"] == pytest.approx(0.0, abs=1e-12)
    assert figures["longest_freeze_ms"] == 0.0
    assert figures["state_s"] == {"tracked": 1.0, "bridged": 0.0, "stale": 0.0, "lost": 0.0}
    assert figures["seen_ms"] == {
        "p50": pytest.approx(90, abs=0.5),
        "p95": pytest.approx(90, abs=0.5),
    }


def test_errors_go_to_the_state_they_were_made_in() -> None:
    states = [TrackState.TRACKED] * 100 + [TrackState.BRIDGED] * 50 + [TrackState.STALE] * 50
    errors: list[Offset] = (
        [(0.003, 0.0, 0.004)] * 100 + [(0.0, 0.02, 0.0)] * 50 + [(0.1, 0, 0)] * 50
    )
    figures = run(
        [shown(i, state=s, error_m=e) for i, (s, e) in enumerate(zip(states, errors, strict=True))]
    )
    assert figures["rmse_in_sight_m"] == pytest.approx(0.005)
    assert figures["rmse_bridged_m"] == pytest.approx(0.02)
    whole = math.sqrt((100 * 0.005**2 + 50 * 0.02**2 + 50 * 0.1**2) / 200)
    assert figures["rmse_whole_m"] == pytest.approx(whole)
    assert figures["rmse_y_m"] == pytest.approx(math.sqrt(50 * 0.02**2 / 200))
    assert figures["max_step_residual_m"] == pytest.approx(math.hypot(0.1, 0.02))


def test_rotation_errors_are_angles() -> None:
    figures = run([shown(i, turn=(0.0, 0.0, 0.1)) for i in range(20)])
    assert figures["rmse_whole_rad"] == pytest.approx(0.1)
    assert figures["rmse_yaw_rad"] == pytest.approx(0.1)
    assert figures["rmse_roll_rad"] == pytest.approx(0.0, abs=1e-9)


def test_what_is_far_away_or_was_never_seen_does_not_count() -> None:
    far = run([shown(i, far_m=1.6, error_m=(1.0, 0, 0)) for i in range(20)], far_m=1.6)
    assert far["rmse_whole_m"] is None
    unseen = run([shown(i, state=TrackState.LOST, fixed=False) for i in range(21)])
    assert unseen["rmse_whole_m"] is None
    assert unseen["longest_freeze_ms"] is None
    assert unseen["seen_ms"] == {"p50": None, "p95": None}
    assert unseen["state_s"] == {"tracked": 0.0, "bridged": 0.0, "stale": 0.0, "lost": 0.1}


def moving(i: int) -> Pose[Cam, Object]:
    return Pose.translated(1e-3 * i, 0.0, 1.0)


def run_moving(shown_at: list[int], *, states: dict[int, TrackState] | None = None) -> float:
    """Longest freeze when the object moves 1 mm a sample and `shown_at[k]` is shown at sample k."""
    metrics = Metrics()
    for i, at in enumerate(shown_at):
        true = TruthSample(
            START_NS + i * DT_NS,
            {"hc": Pose.identity(), "object/plate": Pose(np.array(moving(i).matrix))},
        )
        state = (states or {}).get(i, TrackState.TRACKED)
        if at >= 0:
            metrics.put_tracked(shown(i, state=state, T_cam_object=moving(at)))
        metrics.put_truth(true)
    return float(metrics.figures()["objects"]["plate"]["longest_freeze_ms"])


def test_a_freeze_lasts_from_the_last_move_to_the_next() -> None:
    fluent = list(range(100))
    assert run_moving(fluent) == pytest.approx(5.0)
    frozen = list(range(40)) + [40] * 21 + list(range(61, 100))
    assert run_moving(frozen) == pytest.approx(105.0)


def test_silence_is_a_freeze_and_a_held_stale_pose_is_none() -> None:
    silent = list(range(40)) + [-1] * 20 + list(range(60, 100))
    assert run_moving(silent) == pytest.approx(105.0)
    stale = dict.fromkeys(range(40, 60), TrackState.STALE)
    held = list(range(40)) + [39] * 20 + list(range(60, 100))
    assert run_moving(held, states=stale) == pytest.approx(5.0)


def test_truth_is_interpolated_at_the_stamp_and_samples_wait_for_it() -> None:
    metrics = Metrics()
    metrics.put_truth(truth(0))
    metrics.put_tracked(shown(1))
    assert metrics.figures()["objects"] == {}
    metrics.put_truth(truth(2))
    assert metrics.figures()["objects"]["plate"]["rmse_whole_m"] == pytest.approx(0.0, abs=1e-4)


def test_repeated_and_old_stamps_count_once() -> None:
    metrics = Metrics()
    for i in range(101):
        metrics.put_truth(truth(i))
        for _ in range(3):
            metrics.put_tracked(shown(i), arrival_ns=START_NS + i * DT_NS + 12 * MS)
        metrics.put_tracked(shown(max(0, i - 5)))
    figures = metrics.figures()
    assert figures["tracker_hz"] == pytest.approx(200.0)
    assert figures["objects"]["plate"]["predicted_ms"]["p95"] == pytest.approx(12.0, abs=0.5)


def test_samples_without_truth_are_counted() -> None:
    metrics = Metrics()
    metrics.put_truth(truth(50))
    metrics.put_tracked(shown(3))
    assert metrics.figures()["unmatched"] == 1


def test_percentiles_of_a_histogram() -> None:
    histogram = Histogram()
    for value in range(1, 101):
        histogram.put(float(value))
    assert histogram.percentile(0.5) == pytest.approx(50, abs=0.5)
    assert histogram.percentile(0.95) == pytest.approx(95, abs=0.5)
    histogram.put(1e9)
    histogram.put(-5.0)
    assert Histogram().percentile(0.5) is None


def test_euler_angles_are_those_of_x_then_y_then_z() -> None:
    x, y, z = np.eye(3)
    rotation = exp_so3(0.3 * z) @ exp_so3(-0.2 * y) @ exp_so3(0.1 * x)
    assert np.allclose(euler_xyz(rotation), (0.1, -0.2, 0.3))


def test_the_display_overrules_ages_and_nothing_else() -> None:
    figures = {"objects": {"plate": {"seen_ms": 1, "predicted_ms": 2, "rmse_whole_m": 3}}}
    merged = merge_display(figures, ages={"plate": {"seen_ms": 10, "rmse_x": 5}, "other": {}})
    assert merged["objects"]["plate"] == {"seen_ms": 10, "predicted_ms": 2, "rmse_whole_m": 3}
