from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from scene.entry import ObjectEntry
from sim import gl, render
from sim.lens import Sensor
from sim.plant import Plant
from sim.render import Renderer
from sim.world import Shade, TrueMarker
from spatial.camera import PinholeCamera
from spatial.errors import InputError, MissingError
from spatial.frames import Object, W
from spatial.pose import Pose
from spatial.rotation import Array

MakePlant = Callable[..., Plant]
STRANGE = PinholeCamera(1280, 960, 1083.0, 1071.0, 655.3, 468.8)
BENT = PinholeCamera(1280, 960, 1083.0, 1071.0, 655.3, 468.8, (-0.09, 0.05, 0.0008, -0.0006, 0.0))
needs_gl = pytest.mark.skipif(not gl.usable_backends(), reason="no EGL and no OSMesa here")


def projected(plant: Plant, camera: str) -> dict[int, Array]:
    """Where the corners (4, 2) of each tag must be but for distortion, from the truth alone."""
    truth = plant.truth()
    T_cam_object = Pose[Object, Object](
        (truth[camera].inverse().matrix @ truth["object/board"].matrix).copy()
    )
    mounts = plant.site_model.Ts_object_marker
    return {
        marker.id: plant.cameras[camera]
        .intrinsics.undistorted()
        .project(T_cam_object.apply(mounts[marker.key].apply(marker.corners_tag)))
        for marker in plant.entries["board"].markers
    }


def edge_crossing(grey: NDArray[np.float32], point: Array, normal: Array) -> float:
    """Signed distance [px] along a normal to where grey passes half way, near a point."""
    reach = np.arange(-4.0, 4.01, 0.25)
    places = (point + reach[:, None] * normal).astype(np.float32)
    profile = cv2.remap(grey, places[None, :, 0], places[None, :, 1], cv2.INTER_LINEAR)[0]
    half = (profile[:4].mean() + profile[-4:].mean()) / 2.0
    index = int(np.flatnonzero(np.diff(np.sign(profile - half)))[0])
    a, b = float(profile[index]), float(profile[index + 1])
    return float(reach[index] + 0.25 * (half - a) / (b - a))


def measured(image: np.ndarray, expected: Array, lens: PinholeCamera) -> Array:
    """Corners (4, 2) of a black square by lines fitted to its edges, as without distortion."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32)
    scale, centre = np.array([lens.fx, lens.fy]), np.array([lens.cx, lens.cy])
    lines = []
    for start, end in zip(expected, np.roll(expected, -1, axis=0), strict=True):
        along = end - start
        normal = np.array([-along[1], along[0]]) / np.linalg.norm(along)
        straight = np.array([start + s * along for s in np.linspace(0.12, 0.88, 60)])
        rays = np.column_stack(((straight - centre) / scale, np.ones(60)))
        points = lens.project(rays)
        points += np.array([[edge_crossing(grey, p, normal)] for p in points]) * normal
        points = lens.normalise(points) * scale + centre
        (vx,), (vy,), (x,), (y,) = cv2.fitLine(
            points.astype(np.float32), cv2.DIST_HUBER, 0, 1e-4, 1e-4
        )
        lines.append(np.cross((x, y, 1.0), (x + vx, y + vy, 1.0)))
    crossings = [np.cross(lines[i - 1], lines[i]) for i in range(4)]
    return np.array([c[:2] / c[2] for c in crossings])


def worst_and_median_px(plant: Plant, image: np.ndarray, camera: str) -> tuple[float, float]:
    lens = plant.cameras[camera].intrinsics
    distances = [
        np.linalg.norm(measured(image, corners, lens) - corners, axis=1)
        for corners in projected(plant, camera).values()
    ]
    return float(np.max(distances)), float(np.median(distances))


@needs_gl
@pytest.mark.parametrize("camera", ["hc", "mako"])
def test_tags_are_drawn_where_the_truth_projects_them(
    make_plant: MakePlant, board_in_view: Pose[W, Object], camera: str
) -> None:
    plant = make_plant(board_at=board_in_view, hc=STRANGE)
    with Renderer(plant, camera) as renderer:
        worst, median = worst_and_median_px(plant, renderer.render(), camera)
    assert median < 0.05
    assert worst < 0.2


@needs_gl
def test_lens_and_exposure_leave_tags_in_place(
    make_plant: MakePlant, board_in_view: Pose[W, Object]
) -> None:
    plant = make_plant(board_at=board_in_view, hc=BENT)
    sensor = Sensor(noise=0.5)
    with Renderer(plant, "hc", quality="lockstep", sensor=sensor) as renderer:
        worst, median = worst_and_median_px(plant, renderer.render(), "hc")
    assert median < 0.05
    assert worst < 0.3


def test_the_painter_draws_tags_in_the_same_place(
    make_plant: MakePlant, board_in_view: Pose[W, Object]
) -> None:
    plant = make_plant(board_at=board_in_view, hc=STRANGE)
    with Renderer(plant, "hc", backend="painter") as renderer:
        assert renderer.backend == "painter"
        worst, median = worst_and_median_px(plant, renderer.render(), "hc")
    assert median < 0.1
    assert worst < 0.5


@needs_gl
def test_a_print_lies_on_its_object_and_never_inside(
    make_plant: MakePlant, board_in_view: Pose[W, Object], board: ObjectEntry
) -> None:
    wrong = tuple(
        TrueMarker(
            "board", m.key, m.T_object_marker @ Pose.exp([0.0005, 0.0, -0.001, 0.003, 0.0, 0.0])
        )
        for m in board.markers
    )
    plant = make_plant(board_at=board_in_view, markers=wrong)
    with Renderer(plant, "hc") as renderer:
        _, median = worst_and_median_px(plant, renderer.render(), "hc")
    assert median < 0.05
    for marker in board.markers:
        corners = plant.site_model.Ts_object_marker[marker.key].apply(marker.corners_tag)
        assert corners[:, 2].min() >= marker.T_object_marker.translation[2]


@needs_gl
def test_white_paper_does_not_clip(make_plant: MakePlant, board_in_view: Pose[W, Object]) -> None:
    plant = make_plant(board_at=board_in_view)
    with Renderer(plant, "hc") as renderer:
        image = renderer.render()
    low = np.min([c.min(axis=0) for c in projected(plant, "hc").values()], axis=0).astype(int)
    high = np.max([c.max(axis=0) for c in projected(plant, "hc").values()], axis=0).astype(int)
    tags = image[low[1] : high[1], low[0] : high[0]]
    assert 180 < tags.max() <= 240
    assert tags.min() < 30


@needs_gl
def test_a_shade_darkens_tags_live_and_by_a_true_shadow_in_lock_step(
    make_plant: MakePlant, board_in_view: Pose[W, Object]
) -> None:
    strip = Shade("board", Pose.translated(0.0, 0.09, 0.011), (0.3, 0.03))
    for quality in ("live", "lockstep"):
        brightness = []
        for shades in ((), (strip,)):
            plant = make_plant(board_at=board_in_view, shades=shades)
            truth = plant.truth()
            middle = truth["hc"].inverse() @ truth["object/board"]
            u, v = plant.cameras["hc"].intrinsics.project(middle.apply([[0.0, 0.09, 0.01]]))[0]
            with Renderer(plant, "hc", quality=quality) as renderer:
                image = renderer.render()
            patch = image[round(v) - 3 : round(v) + 4, round(u) - 3 : round(u) + 4]
            brightness.append(float(patch.mean()))
        assert brightness[1] < 0.75 * brightness[0], quality


@needs_gl
def test_lock_step_images_are_the_same_for_the_same_seed(
    make_plant: MakePlant, board_in_view: Pose[W, Object]
) -> None:
    images = []
    for seed in (5, 5, 6):
        plant = make_plant(board_at=board_in_view, seed=2)
        for _ in range(40):
            plant.step()
        with Renderer(plant, "hc", quality="lockstep", seed=seed) as renderer:
            images.append(renderer.render())
            assert renderer.time_s == pytest.approx(plant.time_s - 0.003)
    assert np.array_equal(images[0], images[1])
    assert not np.array_equal(images[0], images[2])


@pytest.mark.skipif("osmesa" not in gl.usable_backends(), reason="no OSMesa here")
def test_osmesa_draws_in_a_process_of_its_own() -> None:
    code = (
        "from sim.gl import open_context\n"
        "context = open_context('osmesa', width=64, height=48)\n"
        "context.make_current()\n"
        "from OpenGL.GL import GL_RENDERER, glGetString\n"
        "print(glGetString(GL_RENDERER).decode())\n"
        "context.free()\n"
    )
    environment = {k: v for k, v in os.environ.items() if k != "PYOPENGL_PLATFORM"}
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
        env=environment,
    )
    assert "llvmpipe" in done.stdout or "softpipe" in done.stdout


def test_a_missing_library_is_named_with_its_packages(
    make_plant: MakePlant, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant = make_plant()
    monkeypatch.setattr(gl, "usable_backends", lambda: ())
    monkeypatch.setattr(render, "usable_backends", lambda: ())
    with pytest.raises(MissingError, match="apt-get install libegl1 libgl1-mesa-dri"):
        Renderer(plant, "hc", backend="egl")
    with pytest.raises(MissingError, match="apt-get install libosmesa6"):
        Renderer(plant, "hc", backend="osmesa")
    with Renderer(plant, "hc") as renderer:
        assert renderer.backend == "painter"


def test_what_does_not_exist_is_named(make_plant: MakePlant) -> None:
    plant = make_plant()
    with pytest.raises(InputError, match="unknown camera 'nose'; available: hc, mako"):
        Renderer(plant, "nose")
    with pytest.raises(InputError, match="unknown renderer 'voodoo'; available: egl"):
        Renderer(plant, "hc", backend="voodoo")
    with pytest.raises(InputError, match="unknown quality 'best'; available: live, lockstep"):
        Renderer(plant, "hc", quality="best")
