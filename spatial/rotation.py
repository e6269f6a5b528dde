"""Rotations: SO(3) exponential and logarithm, quaternions (wxyz), chordal mean.

exp(phi) = I + sin(a)/a [phi] + (1 - cos(a))/a^2 [phi]^2,   a = |phi|
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from spatial.errors import InputError

Array: TypeAlias = NDArray[np.float64]

SMALL_ANGLE = 1e-6
"""Below it [rad] the series of an expression in the angle is used."""
UNIT_TOLERANCE = 1e-3
"""A quaternion from outside may be this far from unit length; it is renormalised."""


def hat(phi: ArrayLike) -> Array:
    """Return the skew matrix (3, 3) of a vector (3,): `hat(a) @ b = a x b`."""
    x, y, z = np.asarray(phi, dtype=np.float64).tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def exp_so3(phi: ArrayLike) -> Array:
    """Return the rotation matrix (3, 3) of a rotation vector (3,) [rad]."""
    x, y, z = np.asarray(phi, dtype=np.float64).tolist()
    angle = math.sqrt(x * x + y * y + z * z)
    a, b = 1.0, 0.5
    if angle >= SMALL_ANGLE:
        a = math.sin(angle) / angle
        b = (1.0 - math.cos(angle)) / (angle * angle)
    return np.array(
        [
            [1.0 - b * (y * y + z * z), b * x * y - a * z, b * x * z + a * y],
            [b * x * y + a * z, 1.0 - b * (x * x + z * z), b * y * z - a * x],
            [b * x * z - a * y, b * y * z + a * x, 1.0 - b * (x * x + y * y)],
        ]
    )


def log_so3(rotation: ArrayLike) -> Array:
    """Return the rotation vector (3,) [rad], of norm at most pi, of a rotation matrix (3, 3)."""
    w, x, y, z = _quaternion(rotation)
    norm = math.sqrt(x * x + y * y + z * z)
    scale = 2.0 if norm < SMALL_ANGLE else 2.0 * math.atan2(norm, w) / norm
    return np.array([scale * x, scale * y, scale * z])


def quaternion_wxyz_of(rotation: ArrayLike) -> Array:
    """Return the unit quaternion (4,), wxyz, w >= 0, of a rotation matrix (3, 3)."""
    return np.array(_quaternion(rotation))


def _quaternion(rotation: ArrayLike) -> tuple[float, float, float, float]:
    """Return w, x, y, z; in plain numbers, because arrays of four cost more than the sums."""
    (a, b, c), (d, e, f), (g, h, i) = np.asarray(rotation, dtype=np.float64).tolist()
    ww, xx, yy, zz = 1 + a + e + i, 1 + a - e - i, 1 - a + e - i, 1 - a - e + i
    largest = max(ww, xx, yy, zz)
    if ww == largest:
        w, x, y, z = ww, h - f, c - g, d - b
    elif xx == largest:
        w, x, y, z = h - f, xx, b + d, c + g
    elif yy == largest:
        w, x, y, z = c - g, b + d, yy, f + h
    else:
        w, x, y, z = d - b, c + g, f + h, zz
    length = math.sqrt(w * w + x * x + y * y + z * z)
    if w < 0.0:
        length = -length
    return w / length, x / length, y / length, z / length


def rotation_of(quaternion_wxyz: ArrayLike) -> Array:
    """Return the rotation matrix (3, 3) of a quaternion (4,), wxyz.

    Raises:
        InputError: not four finite numbers of unit length within `UNIT_TOLERANCE`.
    """
    values = np.asarray(quaternion_wxyz, dtype=np.float64).tolist()
    norm = math.hypot(*values) if isinstance(values, list) and len(values) == 4 else math.nan
    if not abs(norm - 1.0) < UNIT_TOLERANCE:
        msg = f"quaternion {values} is not four numbers w, x, y, z of unit length"
        raise InputError(msg)
    w, x, y, z = (value / norm for value in values)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def nearest_rotation(matrix: ArrayLike) -> Array:
    """Return the rotation (3, 3) closest to a matrix (3, 3) in the Frobenius norm."""
    u, _, vt = np.linalg.svd(np.asarray(matrix, dtype=np.float64))
    sign = np.sign(np.linalg.det(u @ vt))
    return np.asarray(u @ np.diag([1.0, 1.0, sign]) @ vt, dtype=np.float64)


def chordal_mean(rotations: ArrayLike, weights: ArrayLike | None = None) -> Array:
    """Return the chordal L2 mean (3, 3) of rotations (n, 3, 3).

    It minimises the sum of w_i |R - R_i|^2 in the Frobenius norm (Hartley et al., 2013).
    """
    stack = np.asarray(rotations, dtype=np.float64)
    w = np.ones(len(stack)) if weights is None else np.asarray(weights, dtype=np.float64)
    return nearest_rotation(np.tensordot(w, stack, axes=1))
