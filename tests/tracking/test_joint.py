import math

import numpy as np
import pytest

from spatial.camera import PinholeCamera
from spatial.frames import Cam, Object, Tag
from spatial.marker import Marker
from spatial.pose import Pose
from tracking.joint import CORNER_FLOOR_PX, CORNER_PER_SCATTER, Prior, SeenTag, solve_joint

CAMERA = PinholeCamera(1280, 960, 1000.0, 1000.0, 639.5, 479.5)
PLACES = ((-0.12, 0.08, 0.05), (0.12, 0.08, 0.06), (0, -0.1, 0.08), (0.2, -0.05, 0.1))
FACING = np.diag([1.0, -1.0, -1.0])


def markers(*, planar: bool) -> list[Marker]:
    made = []
    for i, (x, y, size) in enumerate((*PLACES, (-0.2, -0.05, 0.12))):
        yaw = 0.0 if planar or i < 3 else (0.7 if i == 3 else -0.7)
        turn = Pose[Object, Tag].exp([0, 0, 0, 0, yaw, 0]).rotation
        made.append(Marker("tag36h11", i, size, Pose.of(turn, (x, y, 0))))
    return made


def random_pose(rng: np.random.Generator, *, z: float, tilt: float) -> Pose[Cam, Object]:
    heading = rng.uniform(0, 2 * math.pi)
    lean = Pose[Cam, Object].exp([0, 0, 0, tilt * math.cos(heading), tilt * math.sin(heading), 0])
    roll = Pose[Cam, Object].exp([0, 0, 0, 0, 0, rng.uniform(-math.pi, math.pi)])
    return Pose.of(lean.rotation @ FACING @ roll.rotation, (*rng.uniform(-0.1, 0.1, 2) * z, z))


def scatter_of(sigma_px: float) -> float:
    return math.sqrt(max(sigma_px**2 - CORNER_FLOOR_PX**2, 0.0)) / CORNER_PER_SCATTER


def seen(
    T_cam_object: Pose[Cam, Object],
    tags: list[Marker],
    *,
    sigma_px: float,
    rng: np.random.Generator,
) -> list[SeenTag]:
    return [
        SeenTag(
            tag,
            CAMERA.project(T_cam_object.apply(tag.corners_object))
            + rng.normal(size=(4, 2)) * sigma_px,
            scatter_of(sigma_px),
        )
        for tag in tags
    ]


def bound(T_cam_object: Pose[Cam, Object], tags: list[Marker], sigma_px: float) -> np.ndarray:
    """Cramer-Rao bound (6, 6), its Jacobian by differences."""
    points = np.concatenate([tag.corners_object for tag in tags])
    h, columns = 1e-6, []
    for axis in np.eye(6):
        ahead = CAMERA.project((T_cam_object @ Pose[Object, Object].exp(h * axis)).apply(points))
        back = CAMERA.project((T_cam_object @ Pose[Object, Object].exp(-h * axis)).apply(points))
        columns.append((ahead - back).ravel() / (2 * h))
    jacobian = np.stack(columns, axis=1)
    return np.linalg.inv(jacobian.T @ jacobian / sigma_px**2)


CASES = {
    "five tags, two leaning": (False, 5, 0.15, 1.0, 0.3),
    "five coplanar, nearly frontal": (True, 5, 0.15, 1.0, 0.07),
    "five coplanar at two metres": (True, 5, 0.3, 2.0, 0.09),
    "three tags": (True, 3, 0.2, 0.8, 0.3),
    "coarse corners": (False, 5, 0.8, 1.0, 0.3),
}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_error_reaches_the_cramer_rao_bound_and_the_covariance_tells_it(
    case: tuple[bool, int, float, float, float],
) -> None:
    planar, count, sigma, z, tilt = case
    tags, rng = markers(planar=planar)[:count], np.random.default_rng(4)
    errors, bounds, surprises = [], [], []
    for _ in range(100):
        truth = random_pose(rng, z=z, tilt=tilt)
        solution = solve_joint(CAMERA, tags=seen(truth, tags, sigma_px=sigma, rng=rng))
        assert solution is not None
        off = (solution.T_cam_object.inverse() @ truth).log()
        errors.append(off**2)
        bounds.append(np.diag(bound(truth, tags, sigma)))
        surprises.append(off @ np.linalg.solve(solution.covariance, off))
    ratio = np.sqrt(np.mean(errors, axis=0) / np.mean(bounds, axis=0))
    assert ratio.max() < 1.3
    assert 0.5 < np.median(surprises) / 5.35 < 1.5  # median of chi2 with 6 degrees


def test_one_wrong_map_entry_is_found_and_costs_little() -> None:
    tags, rng = markers(planar=False), np.random.default_rng(5)
    wrong = [*tags]
    moved = tags[1].T_object_marker @ Pose[Tag, Tag].exp([0.03, 0, 0, 0, 0.2, 0])
    wrong[1] = Marker("tag36h11", 1, tags[1].size_m, moved)
    errors, bounds = [], []
    for _ in range(100):
        truth = random_pose(rng, z=1.0, tilt=0.3)
        found = seen(truth, tags, sigma_px=0.15, rng=rng)
        found = [SeenTag(m, t.corners_px, t.noise_px) for m, t in zip(wrong, found, strict=True)]
        solution = solve_joint(CAMERA, tags=found)
        assert solution is not None
        assert solution.used.tolist() == [True, False, True, True, True]
        errors.append((solution.T_cam_object.inverse() @ truth).log() ** 2)
        bounds.append(np.diag(bound(truth, tags, 0.15)))
    ratio = np.sqrt(np.mean(errors, axis=0) / np.mean(bounds, axis=0))
    assert ratio[:3].max() < 1.6


def test_with_a_prediction_two_frontal_tags_never_flip() -> None:
    tags, rng = markers(planar=True)[:2], np.random.default_rng(6)
    for _ in range(100):
        truth = random_pose(rng, z=1.5, tilt=0.1)
        guess = truth @ Pose[Object, Object].exp(rng.normal(size=6) * ([0.01] * 3 + [0.03] * 3))
        prior = Prior(guess, np.diag([1e-4] * 3 + [9e-4] * 3))
        solution = solve_joint(CAMERA, tags=seen(truth, tags, sigma_px=0.2, rng=rng), prior=prior)
        assert solution is not None
        assert solution.T_cam_object.distance_to(truth)[1] < 0.12


def test_a_false_prediction_does_not_pull_the_pose() -> None:
    tags, rng = markers(planar=False), np.random.default_rng(7)
    truth = random_pose(rng, z=1.0, tilt=0.3)
    found = seen(truth, tags, sigma_px=0.1, rng=rng)
    free = solve_joint(CAMERA, tags=found)
    guess = truth @ Pose[Object, Object].exp([0.2, -0.1, 0.1, 0.5, 0.4, -1.0])
    led = solve_joint(CAMERA, tags=found, prior=Prior(guess, np.eye(6) * 1e-4))
    assert free is not None
    assert led is not None
    assert led.T_cam_object.distance_to(free.T_cam_object) == pytest.approx((0, 0), abs=1e-5)


def test_no_tag_gives_no_pose() -> None:
    assert solve_joint(CAMERA, tags=[]) is None
