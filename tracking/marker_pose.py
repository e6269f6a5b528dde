"""Pose of one square marker: both planar solutions.

The four corners of a plane have two poses that reproject almost alike when the marker is small or
frontal (Collins and Bartoli, Infinitesimal Plane-based Pose Estimation, 2014; OpenCV's
IPPE_SQUARE). Both are returned; who has more to go by chooses.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike

from spatial.camera import PinholeCamera
from spatial.errors import InputError
from spatial.frames import Cam, Tag
from spatial.marker import UNIT_CORNERS
from spatial.pose import Pose
from spatial.rotation import Array, exp_so3

_FRONT_M = 1e-3
_NUDGE_PX = np.array([[1e-3, 0.0], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]])


@dataclass(frozen=True, slots=True, eq=False)
class PlanarPose:
    """One of the two poses of a marker."""

    T_cam_tag: Pose[Cam, Tag]
    """Pose of the marker in the camera."""
    reprojection_px: float
    """RMS distance of the corners from its projection [px]."""


def planar_poses(
    corners_px: ArrayLike, *, size_m: float, camera: PinholeCamera
) -> tuple[PlanarPose, ...]:
    """Return the poses in front of the camera, the better one first; none for a broken quad.

    Args:
        corners_px: TL TR BR BL (4, 2) [px], pixel centres at integers.
        size_m: edge of the outer black square [m].
        camera: its intrinsics.

    Raises:
        InputError: corners that are not (4, 2) finite numbers, or a size that is not positive.
    """
    corners = np.asarray(corners_px, dtype=np.float64)
    if corners.shape != (4, 2) or not np.isfinite(corners).all() or not size_m > 0.0:
        raise InputError(
            f"a marker is four finite corners and a size in metres, got {corners.tolist()} "
            f"and {size_m}"
        )
    straight = camera.normalise(corners) * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    found = _solve(straight, size_m=size_m, camera=camera)
    if not found:
        # Exactly frontal, OpenCV loses the half turn about x: a millipixel brings it back.
        found = _solve(straight + _NUDGE_PX, size_m=size_m, camera=camera)
    return tuple(sorted(found, key=lambda p: p.reprojection_px))


def _solve(straight: Array, *, size_m: float, camera: PinholeCamera) -> list[PlanarPose]:
    """Return the solutions whose printed face looks at the camera."""
    _, turns, shifts, errors = cv2.solvePnPGeneric(
        size_m * UNIT_CORNERS, straight, camera.K, None, flags=cv2.SOLVEPNP_IPPE_SQUARE
    )
    solutions = []
    for turn, shift, error in zip(turns, shifts, errors, strict=True):
        rotation, translation = exp_so3(np.ravel(turn)), np.ravel(shift)
        in_front = float(translation[2]) > _FRONT_M and np.isfinite(turn).all()
        if in_front and float(rotation[:, 2] @ translation) < 0.0:
            pose: Pose[Cam, Tag] = Pose.of(rotation, translation)
            solutions.append(PlanarPose(pose, float(np.ravel(error)[0])))
    return solutions
