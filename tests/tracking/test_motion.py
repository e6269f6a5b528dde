import numpy as np
import pytest

from spatial.errors import StampError
from spatial.frames import Cam, Object, W
from spatial.pose import Pose
from spatial.samples import MotionSample
from tracking.motion import HORIZON_NS, MotionHistory
from tracking.propagation import STATIC, growth, propagate

MS = 1_000_000
XI = np.array([0.2, -0.1, 0.05, 0.1, -0.2, 0.3])


def sample(
    ms: float, *, xi: np.ndarray = XI, off: Pose[W, W] | None = None, **more: object
) -> MotionSample:
    T_w_cam: Pose[W, Cam] = Pose.exp(ms / 1e3 * xi)
    moved = T_w_cam if off is None else off @ T_w_cam
    return MotionSample(round(ms * MS), moved, xi, np.zeros(3), **more)  # type: ignore[arg-type]


def history(*, until_ms: int = 100) -> MotionHistory:
    motion = MotionHistory()
    for ms in range(0, until_ms + 1, 5):
        assert motion.put(sample(ms))
    return motion


def test_constant_twist_is_reproduced_between_and_beyond_samples() -> None:
    motion = history()
    for ms in (0.0, 2.5, 51.3, 100.0, 130.0, 199.0):
        held = motion.at(round(ms * MS))
        assert held.stamp_ns == round(ms * MS)
        assert held.T_w_cam.distance_to(sample(ms).T_w_cam) == pytest.approx((0, 0), abs=1e-9)


def test_acceleration_bends_the_extrapolation() -> None:
    motion = MotionHistory()
    motion.put(MotionSample(0, Pose.identity(), np.zeros(6), np.array([2.0, 0, 0])))
    assert motion.at(100 * MS).T_w_cam.translation[0] == pytest.approx(0.5 * 2.0 * 0.1**2)


def test_stamps_outside_are_refused_with_what_is_held() -> None:
    motion = history()
    with pytest.raises(StampError, match="stored is 0 to 100000000 ns"):
        motion.at(100 * MS + HORIZON_NS + 1)
    with pytest.raises(StampError):
        motion.at(-1)
    with pytest.raises(StampError, match="nothing is stored"):
        MotionHistory().at(0)


def test_repeated_and_late_samples_change_nothing_that_follows() -> None:
    motion = MotionHistory()
    for ms in (0, 5, 15, 20):
        motion.put(sample(ms))
    assert motion.put(sample(10))
    assert not motion.put(sample(10))
    assert not motion.put(sample(-5))
    assert motion.newest is not None
    assert motion.newest.stamp_ns == 20 * MS


@pytest.mark.parametrize("flagged", [False, True])
@pytest.mark.parametrize("size_m", [0.012, 0.3])
def test_a_jump_moves_nothing_whether_flagged_or_not(size_m: float, *, flagged: bool) -> None:
    motion = history(until_ms=50)
    off = Pose[W, W].exp([size_m, 0, 0, 0, 0, 0.01])
    for ms in range(55, 105, 5):
        motion.put(sample(ms, off=off, jump_flagged=flagged and ms == 55))
    assert motion.jumps == 1
    assert motion.at(100 * MS).T_w_cam.distance_to(sample(100).T_w_cam)[0] < 1e-6
    assert motion.doubt_m2(since_ns=50 * MS) > 0.0
    assert motion.doubt_m2(since_ns=60 * MS) == 0.0


def test_a_jump_smeared_over_samples_is_found_too() -> None:
    motion = history(until_ms=50)
    for i, ms in enumerate(range(55, 105, 5)):
        motion.put(sample(ms, off=Pose[W, W].translated(0.03 * (i + 1), 0, 0)))
    assert motion.jumps == 10
    assert motion.at(100 * MS).T_w_cam.distance_to(sample(100).T_w_cam)[0] < 1e-6


def test_ordinary_noise_is_no_jump() -> None:
    rng, motion = np.random.default_rng(0), MotionHistory()
    for ms in range(0, 5000, 5):
        held = sample(ms)
        noise = rng.normal(size=6) * ([1e-3] * 3 + [5e-4] * 3)
        twist = held.xi_w_cam_cam + rng.normal(size=6) * ([5e-3] * 3 + [2.4e-3] * 3)
        T_w_cam = held.T_w_cam @ Pose[Cam, Cam].exp(noise)
        motion.put(MotionSample(held.stamp_ns, T_w_cam, twist, np.zeros(3)))
    assert motion.jumps == 0


def test_a_new_world_is_joined_with_doubt() -> None:
    motion = history(until_ms=50)
    other = Pose[W, W].exp([3, 2, 1, 0, 0, 2.0])
    motion.put(sample(55, off=other, reset_count=1))
    assert motion.newest is not None
    assert motion.newest.reset_count == 1
    assert motion.newest.T_w_cam.distance_to(sample(55).T_w_cam)[0] < 1e-6
    assert np.sqrt(motion.doubt_m2(since_ns=0)) > 0.02


def test_propagation_is_a_group_action_and_undoes_itself() -> None:
    rng = np.random.default_rng(1)
    a, b, c = (Pose[W, Cam].exp(rng.normal(size=6)) for _ in range(3))
    T_cam_object = Pose[Cam, Object].exp(rng.normal(size=6))
    by_steps = propagate(
        propagate(T_cam_object, T_w_cam_then=a, T_w_cam_now=b), T_w_cam_then=b, T_w_cam_now=c
    )
    at_once = propagate(T_cam_object, T_w_cam_then=a, T_w_cam_now=c)
    assert by_steps.distance_to(at_once) == pytest.approx((0, 0), abs=1e-12)
    back = propagate(at_once, T_w_cam_then=c, T_w_cam_now=a)
    assert back.distance_to(T_cam_object) == pytest.approx((0, 0), abs=1e-12)
    still = a @ T_cam_object  # a static object stays where it is in w
    assert (c @ at_once).distance_to(still) == pytest.approx((0, 0), abs=1e-12)


def test_uncertainty_adds_over_time_and_reproduces_the_drift_of_good_odometry() -> None:
    def grown(s: float) -> np.ndarray:
        return growth(duration_ns=round(s * 1e9), noise=STATIC, distance_m=0.8)

    assert (grown(2.0) + grown(3.0) <= grown(5.0) + 1e-12).all()  # errors last, so they add up
    assert grown(60.0) - grown(59.0) == pytest.approx(grown(31.0) - grown(30.0))
    assert np.sqrt(grown(0.04)[0]) < 0.0005  # what image to image odometry is good for
    assert 0.008 < np.sqrt(grown(5.0)[0]) < 0.014
