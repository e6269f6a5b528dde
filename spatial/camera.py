"""Pinhole camera with Brown-Conrady distortion; an integer pixel is the pixel's centre.

u = fx x' + cx,  v = fy y' + cy,   (x, y) = (X, Y) / Z,  r^2 = x^2 + y^2
x' = x (1 + k1 r^2 + k2 r^4 + k3 r^6) + 2 p1 x y + p2 (r^2 + 2 x^2)
y' = y (1 + k1 r^2 + k2 r^4 + k3 r^6) + p1 (r^2 + 2 y^2) + 2 p2 x y
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from spatial.errors import InputError
from spatial.rotation import Array

UNDISTORT_ITERATIONS = 20


@dataclass(frozen=True, slots=True)
class PinholeCamera:
    """Intrinsics of a camera."""

    width: int
    """Image width [px]."""
    height: int
    """Image height [px]."""
    fx: float
    """Focal length along x [px]."""
    fy: float
    """Focal length along y [px]."""
    cx: float
    """Principal point, x [px], pixel centres at integers."""
    cy: float
    """Principal point, y [px], pixel centres at integers."""
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)
    """k1, k2, p1, p2, k3, in OpenCV's order."""

    def __post_init__(self) -> None:
        """Refuse what cannot be a camera.

        Raises:
            InputError: a size or focal length that is not positive, or a value not finite.
        """
        values = (self.fx, self.fy, self.cx, self.cy, *self.distortion)
        if not np.isfinite(values).all():
            msg = f"camera intrinsics must be finite, got {values}"
            raise InputError(msg)
        if min(self.width, self.height, self.fx, self.fy) <= 0:
            msg = (
                "camera width, height, fx and fy must be positive, got "
                f"{self.width}, {self.height}, {self.fx}, {self.fy}"
            )
            raise InputError(msg)

    @property
    def K(self) -> Array:
        """Camera matrix (3, 3) [px]."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def undistorted(self) -> PinholeCamera:
        """Return the same camera without distortion, as an undistorted image has it."""
        return PinholeCamera(self.width, self.height, self.fx, self.fy, self.cx, self.cy)

    def scaled(self, width: int, height: int) -> PinholeCamera:
        """Return the camera of the same image resized to other pixels (pixel areas scale)."""
        sx, sy = width / self.width, height / self.height
        return PinholeCamera(
            width,
            height,
            self.fx * sx,
            self.fy * sy,
            (self.cx + 0.5) * sx - 0.5,
            (self.cy + 0.5) * sy - 0.5,
            self.distortion,
        )

    def project(self, points_cam: ArrayLike) -> Array:
        """Return pixels (..., 2) of points (..., 3) [m] in the camera frame, z > 0."""
        p = np.asarray(points_cam, dtype=np.float64)
        normalised = self._distort(p[..., :2] / p[..., 2:3])
        return normalised * (self.fx, self.fy) + (self.cx, self.cy)

    def normalise(self, pixels: ArrayLike) -> Array:
        """Return undistorted ray coordinates (..., 2) = (X/Z, Y/Z) of pixels (..., 2)."""
        px = np.asarray(pixels, dtype=np.float64)
        distorted = (px - (self.cx, self.cy)) / (self.fx, self.fy)
        if not any(self.distortion):
            return distorted
        undistorted = distorted
        for _ in range(UNDISTORT_ITERATIONS):
            undistorted = undistorted + (distorted - self._distort(undistorted))
        return undistorted

    def contains(self, pixels: ArrayLike, *, margin: float = 0.0) -> np.ndarray:
        """Return which pixels (..., 2) lie in the image, at least `margin` [px] from its edge."""
        px = np.asarray(pixels, dtype=np.float64)
        low, high = px >= margin, px <= np.array([self.width, self.height]) - 1.0 - margin
        return np.asarray((low & high).all(axis=-1))

    def _distort(self, xy: Array) -> Array:
        k1, k2, p1, p2, k3 = self.distortion
        if not any(self.distortion):
            return xy
        x, y = xy[..., 0], xy[..., 1]
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        dx = 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
        dy = p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
        return np.stack((x * radial + dx, y * radial + dy), axis=-1)
