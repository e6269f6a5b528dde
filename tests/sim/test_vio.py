import math

import numpy as np
import pytest

from sim.vio import LEVELS, Vio, VioLevel, drift_sigma_m, level_named, ou_step
from spatial.errors import InputError
from spatial.frames import Cam, W
from spatial.pose import Pose
from spatial.rotation import Array
from spatial.samples import MotionSample

DT_NS = 5_000_000
STILL = np.zeros(6)
PERFECT = VioLevel(0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0)

# per-axis drift of a camera at rest [mm] after 1, 5, 10 and 60 s
DRIFT_TABLE_MM = {
    "good": (0.9, 3.6, 5.7, 15.0),
    "nominal": (2.8, 11.0, 17.0, 46.0),
    "degraded": (7.6, 31.0, 52.0, 148.0),
    "bad": (19.0, 83.0, 142.0, 423.0),
}


def swing(i: int) -> Pose[W, Cam]:
    t = i * 5e-3
    phi = (0.1 * math.sin(t), 0.2 * math.sin(0.7 * t), 0.0)
    return Pose.of(np.eye(3), (0.05 * math.sin(t), 0.0, 2.0)) @ Pose.exp((0, 0, 0, *phi))


def run(level: VioLevel, *, seed: int, count: int) -> list[MotionSample | None]:
    vio = Vio(level, seed=seed)
    return [
        vio.step(i * DT_NS, T_w_cam=swing(i), xi_w_cam_cam=STILL, acceleration_cam=np.zeros(3))
        for i in range(count)
    ]


@pytest.mark.parametrize("name", LEVELS)
def test_drift_is_that_of_the_table(name: str) -> None:
    level = LEVELS[name]
    rng = np.random.default_rng(7)
    dt_s, runs = 0.05, 3000
    velocity = level.sigma_v_m_s * rng.standard_normal((runs, 3))
    position = np.zeros((runs, 3))
    measured: dict[int, float] = {}
    for i in range(1, 1201):
        noise = rng.standard_normal((runs, 3))
        velocity = ou_step(
            velocity, sigma=level.sigma_v_m_s, tau_s=level.tau_s, dt_s=dt_s, noise=noise
        )
        position = position + velocity * dt_s
        if i in (20, 100, 200, 1200):
            measured[round(i * dt_s)] = 1e3 * float(position.std())
    for (second, drift), expected in zip(measured.items(), DRIFT_TABLE_MM[name], strict=True):
        assert drift == pytest.approx(expected, rel=0.05), second
        assert 1e3 * drift_sigma_m(level, second) == pytest.approx(expected, rel=0.05)


def test_the_reported_position_drifts_as_the_model_says() -> None:
    ends = []
    for seed in range(60):
        vio = Vio(VioLevel(2e-2, 4.0, 0.0, 0.0, 0.0, 0.0, 0.0), seed=seed)
        last: MotionSample | None = None
        for i in range(0, 1000, 10):
            last = vio.step(
                i * DT_NS, T_w_cam=Pose.identity(), xi_w_cam_cam=STILL, acceleration_cam=np.zeros(3)
            )
        assert last is not None
        ends.append(last.T_w_cam.translation)
    assert float(np.std(ends)) == pytest.approx(0.083, rel=0.25)


def test_a_perfect_odometry_reports_the_true_motion_in_a_world_of_its_own() -> None:
    samples = [s for s in run(PERFECT, seed=3, count=800) if s is not None]
    first, last = samples[0].T_w_cam, samples[-1].T_w_cam
    assert np.allclose(first.translation, 0.0, atol=1e-9)
    moved = first.inverse() @ last
    far, turn = moved.distance_to(swing(0).inverse() @ swing(799))
    # the reported orientation keeps its white noise of a quarter of a milliradian
    assert far < 1e-3
    assert turn < 2e-3
    up_w: Array = last.rotation @ swing(799).rotation.T @ np.array([0.0, 0.0, 1.0])
    assert up_w[2] > 1.0 - 1e-5
    other = [s for s in run(PERFECT, seed=4, count=1) if s is not None]
    assert first.distance_to(other[0].T_w_cam)[1] > 0.01


def test_roll_and_pitch_stay_bounded_while_yaw_drifts() -> None:
    level = LEVELS["degraded"]
    quiet = VioLevel(0.0, 2.0, level.yaw_bias_rad_s, 0.0, level.tilt_rad, 0.0, 0.0)
    samples = [s for s in run(quiet, seed=1, count=4000) if s is not None]
    errors = [s.T_w_cam.rotation @ swing(i).rotation.T for i, s in enumerate(samples)]
    tilts = [math.acos(min(1.0, float(e[2, 2]))) for e in errors]
    assert max(tilts) < 6 * level.tilt_rad
    yaws = np.unwrap([math.atan2(float(e[1, 0]), float(e[0, 0])) for e in errors])
    assert abs(yaws[-1] - yaws[0]) == pytest.approx(20.0 * level.yaw_bias_rad_s, rel=0.4)


def test_jumps_are_sized_and_mostly_flagged() -> None:
    level = VioLevel(0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, jump_rate_hz=2.0)
    samples = [s for s in run(level, seed=5, count=12_000) if s is not None]
    at = np.array([s.T_w_cam.translation for s in samples])
    true = np.array([swing(i).translation for i in range(len(at))])
    steps = np.abs(np.linalg.norm(np.diff(at, axis=0), axis=1))
    jumped = np.flatnonzero(steps > np.linalg.norm(np.diff(true, axis=0), axis=1) + 5e-3) + 1
    flagged = {i for i, s in enumerate(samples) if s.jump_flagged}
    assert len(jumped) == pytest.approx(120, abs=40)
    assert 0.65 < len(flagged & set(jumped.tolist())) / len(jumped) < 0.92
    assert steps.max() < 0.052


def test_drop_outs_fall_silent_and_long_ones_start_a_new_world() -> None:
    level = VioLevel(0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, drop_rate_hz=0.3)
    samples = run(level, seed=2, count=12_000)
    resets = [s.reset_count for s in samples if s is not None]
    assert resets == sorted(resets)
    assert resets[-1] > 0
    gaps = np.diff([i for i, s in enumerate(samples) if s is not None])
    assert gaps.max() <= 2.0 * 200 + 2
    assert gaps[gaps > 1].min() >= 0.2 * 200 - 1


def test_good_and_nominal_neither_jump_nor_fall_silent() -> None:
    for name in ("good", "nominal"):
        samples = run(LEVELS[name], seed=1, count=6000)
        assert all(s is not None and not s.jump_flagged and s.reset_count == 0 for s in samples)


def test_the_same_seed_reports_the_same() -> None:
    one, two = (run(LEVELS["bad"], seed=9, count=300) for _ in range(2))
    for a, b in zip(one, two, strict=True):
        assert (a is None) == (b is None)
        if a is not None and b is not None:
            assert np.array_equal(a.T_w_cam.matrix, b.T_w_cam.matrix)
            assert np.array_equal(a.xi_w_cam_cam, b.xi_w_cam_cam)


def test_an_unknown_level_names_those_that_exist() -> None:
    with pytest.raises(InputError, match="bad, degraded, good, nominal"):
        level_named("superb")
