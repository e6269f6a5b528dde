import time

import cv2
import numpy as np
import pytest

from sim.painter import Painted, Painter, Shade
from spatial.camera import PinholeCamera
from spatial.frames import Cam, Object
from spatial.marker import MarkedObject, Marker
from spatial.pose import Pose
from tracking.detector import detect

STRAIGHT = PinholeCamera(1280, 960, 1078.0, 1078.0, 639.5, 479.5)
BENT = PinholeCamera(1280, 960, 1078.0, 1078.0, 633.0, 485.0, (-0.1, 0.02, 1e-3, -1e-3, 0.0))
TAGS = tuple(
    Marker("tag36h11", i, 0.08, Pose.translated((i % 3 - 1) * 0.15, (i // 3 - 0.5) * 0.15, 0.0))
    for i in range(6)
)
PLATE = Painted.of(
    MarkedObject("plate", 1, TAGS[0].key, TAGS),
    vertices=np.array([[-0.3, -0.2, 0.0], [0.3, -0.2, 0.0], [0.3, 0.2, 0.0], [-0.3, 0.2, 0.0]]),
    faces=np.array([[0, 1, 2], [0, 2, 3]]),
)


def poses(count: int, *, tilt: float = 0.3) -> list[Pose[Cam, Object]]:
    rng = np.random.default_rng(3)
    facing = np.diag([1.0, -1.0, -1.0])
    return [
        Pose.of(
            Pose[Cam, Object].exp([0, 0, 0, *(rng.normal(size=3) * tilt)]).rotation @ facing,
            (rng.normal() * 0.05, rng.normal() * 0.05, rng.uniform(0.6, 1.6)),
        )
        for _ in range(count)
    ]


def grey(image: np.ndarray) -> np.ndarray:
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), dtype=np.uint8)


@pytest.mark.parametrize("camera", [STRAIGHT, BENT], ids=["straight", "bent"])
def test_painted_corners_lie_where_the_pose_puts_them(camera: PinholeCamera) -> None:
    painter = Painter(camera, things={"plate": PLATE})
    errors = []
    for T_cam_plate in poses(8):
        for found in detect(grey(painter.render({"plate": T_cam_plate})), camera=camera):
            truth = camera.project(T_cam_plate.apply(TAGS[found.id].corners_object))
            errors.append(found.corners_px - truth)
    offsets = np.concatenate(errors)
    assert len(errors) >= 46
    assert np.median(np.linalg.norm(offsets, axis=1)) < 0.05
    assert np.abs(offsets.mean(axis=0)).max() < 0.01


def test_a_nearer_thing_hides_a_farther_one() -> None:
    wall = Painted(vertices=PLATE.vertices, faces=PLATE.faces)
    painter = Painter(STRAIGHT, things={"plate": PLATE, "wall": wall})
    facing = np.diag([1.0, -1.0, -1.0])
    far, near = Pose[Cam, Object].of(facing, (0, 0, 1.0)), Pose[Cam, Object].of(facing, (0, 0, 0.8))
    assert len(detect(grey(painter.render({"plate": far})))) == 6
    assert not detect(grey(painter.render({"plate": far, "wall": near})))
    assert len(detect(grey(painter.render({"plate": near, "wall": far})))) == 6


def test_markers_seen_from_behind_are_not_drawn() -> None:
    painter = Painter(STRAIGHT, things={"plate": PLATE})
    behind = Pose[Cam, Object].translated(0.0, 0.0, 1.0)
    assert not detect(grey(painter.render({"plate": behind})))


def test_a_shade_darkens_only_what_lies_under_it() -> None:
    strip = np.array(
        [[-0.02, -0.2, 1e-3], [0.02, -0.2, 1e-3], [0.02, 0.2, 1e-3], [-0.02, 0.2, 1e-3]]
    )
    pose = Pose[Cam, Object].of(np.diag([1.0, -1.0, -1.0]), (0, 0, 1.0))
    plain = Painter(STRAIGHT, things={"plate": PLATE}).render({"plate": pose}).astype(float)
    shaded = Painter(STRAIGHT, things={"plate": PLATE}, shades=[Shade("plate", strip)])
    ratio = shaded.render({"plate": pose}) / plain
    assert ratio[480, 640].mean() == pytest.approx(0.28, abs=0.02)
    assert ratio[480, 700].mean() == 1.0


def test_same_poses_give_the_same_pixels_and_frames_are_cheap() -> None:
    painter = Painter(STRAIGHT, things={"plate": PLATE})
    pose = poses(1)[0]
    first = painter.render({"plate": pose})
    start = time.process_time()
    for _ in range(5):
        again = painter.render({"plate": pose})
    assert (first == again).all()
    assert (time.process_time() - start) / 5 < 0.060  # 10 ms on a free core
