"""Laws of the pinhole camera."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spatial.camera import PinholeCamera
from spatial.errors import InputError

DISTORTED = PinholeCamera(
    1280, 960, 1078.0, 1076.0, 639.5, 479.5, (-0.21, 0.11, 8e-4, -5e-4, -0.02)
)
IDEAL = DISTORTED.undistorted()
cameras = st.sampled_from([DISTORTED, IDEAL])
pixel = st.tuples(st.floats(0.0, 1279.0), st.floats(0.0, 959.0)).map(np.array)


@given(cameras, pixel, st.floats(0.1, 50.0))
def test_project_undoes_normalise(camera: PinholeCamera, uv: np.ndarray, depth: float) -> None:
    ray = camera.normalise(uv)
    p_cam = depth * np.append(ray, 1.0)
    np.testing.assert_allclose(camera.project(p_cam), uv, atol=1e-6)


@given(cameras, st.integers(0, 100))
def test_stacks_are_projected_one_by_one(camera: PinholeCamera, seed: int) -> None:
    points = np.random.default_rng(seed).uniform((-1, -1, 2), (1, 1, 5), (4, 3, 3))
    together = camera.project(points)
    assert together.shape == (4, 3, 2)
    np.testing.assert_allclose(together[2, 1], camera.project(points[2, 1]), atol=1e-12)
    assert camera.normalise(together).shape == (4, 3, 2)


@given(st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(1, 9)).map(np.array))
def test_without_distortion_projection_is_the_camera_matrix(p_cam: np.ndarray) -> None:
    homogeneous = IDEAL.K @ p_cam
    np.testing.assert_allclose(IDEAL.project(p_cam), homogeneous[:2] / homogeneous[2], atol=1e-9)


def test_axes_are_optical() -> None:
    centre = IDEAL.project([0.0, 0.0, 2.0])
    np.testing.assert_allclose(centre, [IDEAL.cx, IDEAL.cy])
    right, down = IDEAL.project([0.1, 0.0, 2.0]), IDEAL.project([0.0, 0.1, 2.0])
    assert right[0] > centre[0]
    assert down[1] > centre[1]


def test_distortion_is_open_cv_s() -> None:
    cv2 = pytest.importorskip("cv2")
    points = np.random.default_rng(1).uniform((-1, -0.7, 2), (1, 0.7, 4), (50, 3))
    coefficients = np.array(DISTORTED.distortion)
    theirs, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), DISTORTED.K, coefficients)
    np.testing.assert_allclose(DISTORTED.project(points), theirs[:, 0], atol=1e-9)


def test_pixel_centres_are_integers_at_the_edges() -> None:
    corners = np.array([[0.0, 0.0], [1279.0, 959.0], [-0.1, 5.0], [1279.1, 5.0], [640.0, 959.5]])
    assert IDEAL.contains(corners).tolist() == [True, True, False, False, False]
    assert IDEAL.contains([[3.0, 3.0]], margin=4.0).tolist() == [False]
    assert not IDEAL.contains([math.nan, 3.0])


@pytest.mark.parametrize("change", [{"fx": 0.0}, {"width": 0}, {"cy": math.nan}, {"fy": math.inf}])
def test_what_is_no_camera_is_refused(change: dict[str, float]) -> None:
    values = {"width": 640, "height": 480, "fx": 500.0, "fy": 500.0, "cx": 320.0, "cy": 240.0}
    with pytest.raises(InputError, match="camera"):
        PinholeCamera(**{**values, **change})  # type: ignore[arg-type]  # wrong on purpose
