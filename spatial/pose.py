"""Poses: `T_a_b` is the pose of frame b in frame a, `p_a = T_a_b @ p_b`, inner names meet.

    T = [R t; 0 1],   exp(xi) = [exp(phi)  V rho; 0 1],   xi = (rho, phi)
    V = I + (1 - cos a)/a^2 [phi] + (a - sin a)/a^3 [phi]^2,   a = |phi|

A twist is body velocity: `T_a_b(t + dt) = T_a_b(t) @ Pose.exp(dt * xi_a_b_b)`. Perturbations and
covariances act on the right, in the target frame, translation [m] before rotation [rad].
"""

from __future__ import annotations

import math
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from spatial.errors import InputError
from spatial.frames import Frame
from spatial.rotation import (
    SMALL_ANGLE,
    Array,
    chordal_mean,
    exp_so3,
    hat,
    log_so3,
    nearest_rotation,
    quaternion_wxyz_of,
    rotation_of,
)

A = TypeVar("A", bound=Frame)
B = TypeVar("B", bound=Frame)
C = TypeVar("C", bound=Frame)

ROTATION_TOLERANCE = 1e-4
"""A matrix from outside may be this far from orthonormal; it is projected."""
_IDENTITY = np.eye(4)
_BOTTOM = np.array([0.0, 0.0, 0.0, 1.0])


class Pose(Generic[A, B]):
    """Pose of frame B in frame A: an immutable 4x4 matrix whose frames the type checker holds."""

    __slots__ = ("_matrix",)
    _matrix: Array

    def __init__(self, matrix: Array) -> None:
        """Wrap a matrix (4, 4) that is already valid; data from outside goes through `parse`."""
        matrix.flags.writeable = False
        self._matrix = matrix

    @classmethod
    def identity(cls) -> Pose[A, B]:
        """Return the pose of two coinciding frames."""
        return cls(np.eye(4))

    @classmethod
    def of(cls, rotation: ArrayLike, translation: ArrayLike) -> Pose[A, B]:
        """Return the pose with rotation matrix (3, 3) and translation (3,) [m], both valid."""
        matrix = _IDENTITY.copy()
        matrix[:3, :3] = rotation
        matrix[:3, 3] = translation
        return cls(matrix)

    @classmethod
    def translated(cls, x: float, y: float, z: float) -> Pose[A, B]:
        """Return a pure translation [m]."""
        return cls.of(np.eye(3), (x, y, z))

    @classmethod
    def parse(cls, translation: ArrayLike, quaternion_wxyz: ArrayLike) -> Pose[A, B]:
        """Return the pose of translation (3,) [m] and quaternion (4,) from outside.

        Raises:
            InputError: a value that is not finite, of the wrong length, or not of unit length.
        """
        t = np.asarray(translation, dtype=np.float64)
        if t.shape != (3,) or not all(map(math.isfinite, t.tolist())):
            msg = f"translation {t.tolist()} is not three finite numbers in metres"
            raise InputError(msg)
        return cls.of(rotation_of(quaternion_wxyz), t)

    @classmethod
    def parse_matrix(cls, matrix: ArrayLike) -> Pose[A, B]:
        """Return the pose of a matrix (4, 4) from outside.

        Raises:
            InputError: not finite, not 4x4, or not a rigid transform.
        """
        m = np.array(matrix, dtype=np.float64)
        if m.shape != (4, 4) or not np.isfinite(m).all():
            msg = f"a pose is a 4x4 matrix of finite numbers, got shape {m.shape}"
            raise InputError(msg)
        rotation = nearest_rotation(m[:3, :3])
        error = float(np.abs(rotation - m[:3, :3]).max() + np.abs(m[3] - _BOTTOM).max())
        if error > ROTATION_TOLERANCE:
            msg = f"not a rigid transform: off by {error:.2g}, allowed {ROTATION_TOLERANCE}"
            raise InputError(msg)
        return cls.of(rotation, m[:3, 3])

    @classmethod
    def exp(cls, xi: ArrayLike) -> Pose[A, B]:
        """Return the pose of a tangent vector (6,): translation part [m], then rotation [rad]."""
        vector = np.asarray(xi, dtype=np.float64)
        rho, phi = vector[:3], vector[3:]
        return cls.of(exp_so3(phi), left_jacobian(phi) @ rho)

    def log(self) -> Array:
        """Return the tangent vector (6,): translation part [m], then rotation vector [rad]."""
        phi = log_so3(self._matrix[:3, :3])
        return np.concatenate((np.linalg.solve(left_jacobian(phi), self._matrix[:3, 3]), phi))

    def inverse(self) -> Pose[B, A]:
        """Return the pose of A in B."""
        matrix = _IDENTITY.copy()
        transposed = self._matrix[:3, :3].T
        matrix[:3, :3] = transposed
        matrix[:3, 3] = -(transposed @ self._matrix[:3, 3])
        return Pose(matrix)

    def __matmul__(self, other: Pose[B, C]) -> Pose[A, C]:
        """Compose: `T_a_c = T_a_b @ T_b_c`."""
        return Pose(self._matrix @ other._matrix)

    def apply(self, points: ArrayLike) -> Array:
        """Return points (..., 3) [m] given in B, expressed in A."""
        p = np.asarray(points, dtype=np.float64)
        return p @ self._matrix[:3, :3].T + self._matrix[:3, 3]

    def rotate(self, vectors: ArrayLike) -> Array:
        """Return free vectors (..., 3) given in B, expressed in A."""
        return np.asarray(vectors, dtype=np.float64) @ self._matrix[:3, :3].T

    @property
    def matrix(self) -> Array:
        """Homogeneous matrix (4, 4), read-only."""
        return self._matrix

    @property
    def rotation(self) -> Array:
        """Rotation matrix R_a_b (3, 3), read-only."""
        return self._matrix[:3, :3]

    @property
    def translation(self) -> Array:
        """Position of B's origin in A (3,) [m], read-only."""
        return self._matrix[:3, 3]

    @property
    def quaternion_wxyz(self) -> Array:
        """Unit quaternion (4,), wxyz, w >= 0."""
        return quaternion_wxyz_of(self._matrix[:3, :3])

    def adjoint(self) -> Array:
        """Return Ad (6, 6): `T @ Pose.exp(xi) = Pose.exp(Ad @ xi) @ T`."""
        rotation = self._matrix[:3, :3]
        ad = np.zeros((6, 6))
        ad[:3, :3] = rotation
        ad[3:, 3:] = rotation
        ad[:3, 3:] = hat(self._matrix[:3, 3]) @ rotation
        return ad

    def is_finite(self) -> bool:
        """Return whether every entry is finite."""
        return bool(np.isfinite(self._matrix).all())

    def distance_to(self, other: Pose[A, B]) -> tuple[float, float]:
        """Return distance [m] and angle [rad] to another pose of the same frames."""
        offset = float(np.linalg.norm(self._matrix[:3, 3] - other._matrix[:3, 3]))
        turn = log_so3(self._matrix[:3, :3].T @ other._matrix[:3, :3])
        return offset, float(np.linalg.norm(turn))

    def __repr__(self) -> str:
        """Show translation and quaternion."""
        t = np.array2string(self.translation, precision=4)
        return f"Pose(translation={t}, wxyz={np.array2string(self.quaternion_wxyz, precision=4)})"


def left_jacobian(phi: ArrayLike) -> Array:
    """Return the left Jacobian V (3, 3) of SO(3) at a rotation vector (3,) [rad]."""
    vector = np.asarray(phi, dtype=np.float64)
    angle = math.sqrt(float(vector @ vector))
    skew = hat(vector)
    if angle < SMALL_ANGLE:
        return np.eye(3) + 0.5 * skew
    a = (1.0 - math.cos(angle)) / (angle * angle)
    b = (angle - math.sin(angle)) / (angle**3)
    return np.eye(3) + a * skew + b * skew @ skew


def interpolate(older: Pose[A, B], younger: Pose[A, B], share: float) -> Pose[A, B]:
    """Return the pose a share in [0, 1] of the way, at constant body twist."""
    step: Pose[B, B] = older.inverse() @ younger
    return older @ Pose[B, B].exp(share * step.log())


def mean_pose(poses: list[Pose[A, B]], weights: ArrayLike | None = None) -> Pose[A, B]:
    """Return the weighted mean: arithmetic for translation, chordal for rotation."""
    w = np.ones(len(poses)) if weights is None else np.asarray(weights, dtype=np.float64)
    translation = np.average([p.translation for p in poses], axis=0, weights=w)
    return Pose.of(chordal_mean([p.rotation for p in poses], w), translation)
