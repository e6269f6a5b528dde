import cv2
import numpy as np
import pytest

from sim.painter import Painted, Painter
from spatial.camera import PinholeCamera
from spatial.errors import InputError
from spatial.frames import Cam, Object
from spatial.marker import Marker
from spatial.pose import Pose
from tracking.bits import MIN_SCORE, bit_scores
from tracking.detector import detect
from tracking.edges import refine_corners
from tracking.families import DICTIONARIES, cells, side_cells
from tracking.marker_pose import planar_poses

CAMERA = PinholeCamera(640, 480, 540.0, 540.0, 319.5, 239.5)
FACING = np.diag([1.0, -1.0, -1.0])
POSE = Pose[Cam, Object].of(
    Pose[Cam, Object].exp([0, 0, 0, 0.3, -0.25, 0.4]).rotation @ FACING, (0.02, -0.01, 0.5)
)


def gray_of(*markers: Marker, noise: float = 0.0, seed: int = 0) -> np.ndarray:
    painter = Painter(CAMERA, things={"thing": Painted(markers)})
    image = cv2.cvtColor(painter.render({"thing": POSE}), cv2.COLOR_RGB2GRAY).astype(float)
    image += np.random.default_rng(seed).normal(size=image.shape) * noise
    return np.asarray(np.clip(image, 0, 255), dtype=np.uint8)


def truth_of(marker: Marker) -> np.ndarray:
    return CAMERA.project(POSE.apply(marker.corners_object))


@pytest.mark.parametrize("family", sorted(DICTIONARIES))
def test_every_family_is_read_with_its_corners_in_order(family: str) -> None:
    marker = Marker(family, 7, 0.1, Pose.identity())
    (found,) = detect(gray_of(marker), family=family, camera=CAMERA)
    assert found.key == (family, 7)
    assert np.abs(found.corners_px - truth_of(marker)).max() < 0.1


def test_refinement_orders_accuracy() -> None:
    marker = Marker("tag36h11", 3, 0.1, Pose.identity())
    gray = gray_of(marker, noise=2.0)
    worst = {
        how: np.abs(detect(gray, refine=how)[0].corners_px - truth_of(marker)).max()
        for how in ("edges", "subpix", "none")
    }
    assert worst["edges"] < 0.1 < worst["none"]
    assert worst["edges"] < worst["subpix"]


def test_edges_survive_a_prediction_several_pixels_off_and_a_hard_shadow() -> None:
    marker = Marker("tag36h11", 3, 0.1, Pose.identity())
    gray = gray_of(marker, noise=2.0).astype(float)
    gray[:, 320:] *= 0.28
    shadowed = gray.astype(np.uint8)
    truth = truth_of(marker)[None]
    for shift in ((4.0, -3.0), (-5.0, 2.0), (0.0, 5.0)):
        refined = refine_corners(
            shadowed, corners_px=truth + shift, sides=np.array([8]), search_px=6.0
        )
        assert refined.ok.all()
        assert np.abs(refined.corners_px - truth).max() < 0.25
    pattern = cells("tag36h11", 3)[None]
    assert bit_scores(shadowed, corners_px=truth, patterns=pattern)[0] > MIN_SCORE


def test_a_wrong_id_laid_on_a_real_marker_is_refused() -> None:
    marker = Marker("tag36h11", 3, 0.1, Pose.identity())
    gray = gray_of(marker, noise=2.0)
    patterns = np.array([cells("tag36h11", i) for i in range(120)])
    corners = np.repeat(truth_of(marker)[None], 120, axis=0)
    scores = bit_scores(gray, corners_px=corners, patterns=patterns)
    assert scores[3] > 0.95
    assert np.delete(scores, 3).max() < MIN_SCORE - 0.05
    turned = bit_scores(gray, corners_px=np.roll(corners[3:4], 1, axis=1), patterns=patterns[3:4])
    assert turned[0] < MIN_SCORE - 0.05


def clutter(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    image = np.full((480, 640), 120, np.uint8)
    for _ in range(60):
        corners = rng.uniform(0, 640, 2) + rng.uniform(-60, 60, (4, 2))
        cv2.fillConvexPoly(image, cv2.convexHull(corners.astype(np.int32)), int(rng.integers(255)))
    for _ in range(8):
        x, y, s = rng.integers(20, 400, 3) // np.array([1, 1, 6]) + np.array([0, 0, 25])
        image[y : y + s, x : x + s] = 235
        cells_ = rng.random((6, 6)) > 0.5
        inner = cv2.resize(np.pad(cells_, 1).astype(np.uint8) * 210 + 20, (int(s) - 8, int(s) - 8))
        image[y + 4 : y + s - 4, x + 4 : x + s - 4] = inner
    return image


def test_clutter_without_markers_gives_no_ids() -> None:
    for seed in range(6):
        gray = clutter(seed)
        assert detect(gray) == ()
        rng = np.random.default_rng(seed)
        centres = rng.uniform(80, 400, (150, 1, 2))
        quads = centres + np.array([[-30, -30], [30, -30], [30, 30], [-30, 30]])
        refined = refine_corners(gray, corners_px=quads, sides=np.full(150, 8))
        patterns = np.array([cells("tag36h11", i) for i in range(150)])
        scores = bit_scores(gray, corners_px=refined.corners_px, patterns=patterns)
        assert not (refined.ok & (scores >= MIN_SCORE)).any()


def test_planar_poses_are_two_the_true_one_first_on_a_tilted_marker() -> None:
    marker = Marker("tag36h11", 3, 0.1, Pose.identity())
    best, other = planar_poses(truth_of(marker), size_m=0.1, camera=CAMERA)
    assert best.reprojection_px < 1e-3 < other.reprojection_px
    off_m, off_rad = POSE.distance_to(Pose(best.T_cam_tag.matrix))
    assert off_m < 1e-6
    assert off_rad < 1e-5


def test_bad_input_is_named() -> None:
    gray = np.zeros((20, 30), np.uint8)
    with pytest.raises(InputError, match=r"tag99.*available: aruco4x4"):
        detect(gray, family="tag99")
    with pytest.raises(InputError, match="artoolkitplus_bch"):
        detect(gray, family="artoolkitplus_bch")
    with pytest.raises(InputError, match=r"unknown refinement 'best'.*edges, none, subpix"):
        detect(gray, refine="best")  # type: ignore[arg-type] # wrong on purpose
    with pytest.raises(InputError, match=r"\(20, 30, 3\)"):
        detect(np.zeros((20, 30, 3), np.uint8))
    with pytest.raises(InputError, match="0 to 586"):
        cells("tag36h11", 587)
    with pytest.raises(InputError, match="four finite corners"):
        planar_poses(np.full((4, 2), np.nan), size_m=0.1, camera=CAMERA)
    assert side_cells("tag36h11") == 8
