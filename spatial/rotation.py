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
    vector = np.asarray(phi, dtype=np.float64)
    angle = math.sqrt(float(vector @ vector))
    skew = hat(vector)
    if angle < SMALL_ANGLE:
        return np.eye(3) + skew + 0.5 * skew @ skew
    a = math.sin(angle) / angle
    b = (1.0 - math.cos(angle)) / (angle * angle)
    return np.eye(3) + a * skew + b * skew @ skew


def log_so3(rotation: ArrayLike) -> Array:
    """Return the rotation vector (3,) [rad], of norm at most pi, of a rotation matrix (3, 3)."""
    w, x, y, z = quaternion_wxyz_of(rotation).tolist()
    norm = math.sqrt(x * x + y * y + z * z)
    if norm < SMALL_ANGLE:
        return 2.0 * np.array([x, y, z])
    angle = 2.0 * math.atan2(norm, w)
    return (angle / norm) * np.array([x, y, z])


def quaternion_wxyz_of(rotation: ArrayLike) -> Array:
    """Return the unit quaternion (4,), wxyz, w >= 0, of a rotation matrix (3, 3)."""
    (a, b, c), (d, e, f), (g, h, i) = np.asarray(rotation, dtype=np.float64).tolist()
    squares = (1 + a + e + i, 1 + a - e - i, 1 - a + e - i, 1 - a - e + i)
    largest = squares.index(max(squares))
    candidates = (
        (squares[0], h - f, c - g, d - b),
        (h - f, squares[1], b + d, c + g),
        (c - g, b + d, squares[2], f + h),
        (d - b, c + g, f + h, squares[3]),
    )
    q = np.array(candidates[largest])
    q /= math.sqrt(float(q @ q))
    return q if q[0] >= 0 else -q


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
