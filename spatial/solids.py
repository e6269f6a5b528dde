"""Solids of fixtures with an analytic signed distance d(p): negative inside, zero on the wall.

d is exact outside every solid and never overestimates inside, hence 1-Lipschitz: from p nothing
of the wall is closer than |d(p)|. One shape is drawn and felt: meshes and forces both come from d.

    plane        the half space z <= 0
    box          centred on the origin
    cylinder     from z = 0 to z = length, about z
    funnel       truncated cone from z = 0 (narrow) to z = length (mouth), about z
    tube         everything within a radius of a centre line, with round ends
    mesh         inside of a watertight surface: winding number over 1/2 (Jacobson et al., 2013)
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from spatial.errors import InputError
from spatial.rotation import Array

PAIRS_PER_CHUNK = 200_000
"""Point-triangle or point-segment pairs measured at once: bounds the memory."""
SPLINE_SAMPLES = 8
"""Straight pieces a smoothed centre line has between two of its points."""


@dataclass(frozen=True, slots=True)
class Plane:
    """Half space z <= 0; the free side is +z."""

    size_m: tuple[float, float]
    """Extent along x and y that is drawn [m]; the plane itself has no end."""

    def __post_init__(self) -> None:
        """Refuse sizes that are not positive."""
        _positive("plane", size_m=self.size_m)

    def signed_distance(self, points: ArrayLike) -> Array:
        """Return d (n,) [m] of points (n, 3) [m]."""
        return _points(points)[:, 2].copy()


@dataclass(frozen=True, slots=True)
class Box:
    """Box centred on the origin, edges along the axes."""

    size_m: tuple[float, float, float]
    """Edges along x, y and z [m]."""

    def __post_init__(self) -> None:
        """Refuse sizes that are not positive."""
        _positive("box", size_m=self.size_m)

    def signed_distance(self, points: ArrayLike) -> Array:
        """Return d (n,) [m] of points (n, 3) [m]."""
        return _box_distance(np.abs(_points(points)) - 0.5 * np.array(self.size_m))


@dataclass(frozen=True, slots=True)
class Cylinder:
    """Cylinder about z from z = 0 to z = length."""

    radius_m: float
    """Radius [m]."""
    length_m: float
    """Length along z [m]."""

    def __post_init__(self) -> None:
        """Refuse sizes that are not positive."""
        _positive("cylinder", radius_m=self.radius_m, length_m=self.length_m)

    def signed_distance(self, points: ArrayLike) -> Array:
        """Return d (n,) [m] of points (n, 3) [m]."""
        p, half = _points(points), 0.5 * self.length_m
        radial = np.hypot(p[:, 0], p[:, 1]) - self.radius_m
        return _box_distance(np.stack((radial, np.abs(p[:, 2] - half) - half), axis=-1))


@dataclass(frozen=True, slots=True)
class Funnel:
    """Truncated cone about z: narrow at z = 0, its mouth at z = length."""

    radius_m: float
    """Radius at z = 0 [m]."""
    mouth_radius_m: float
    """Radius at z = length [m]."""
    length_m: float
    """Length along z [m]."""

    def __post_init__(self) -> None:
        """Refuse sizes that are not positive."""
        _positive(
            "funnel",
            radius_m=self.radius_m,
            mouth_radius_m=self.mouth_radius_m,
            length_m=self.length_m,
        )

    def signed_distance(self, points: ArrayLike) -> Array:
        """Return d (n,) [m] of points (n, 3) [m]."""
        p = _points(points)
        rz = np.stack((np.hypot(p[:, 0], p[:, 1]), p[:, 2]), axis=-1)
        outline = np.array(
            [
                (0.0, 0.0),
                (self.radius_m, 0.0),
                (self.mouth_radius_m, self.length_m),
                (0.0, self.length_m),
            ]
        )
        distance = _polyline_distance(rz, outline)
        share = rz[:, 1] / self.length_m
        wall = self.radius_m + share * (self.mouth_radius_m - self.radius_m)
        inside = (share >= 0.0) & (share <= 1.0) & (rz[:, 0] <= wall)
        return np.where(inside, -distance, distance)


@dataclass(frozen=True, slots=True, eq=False)
class Tube:
    """Everything within a radius of a centre line; its ends are round."""

    centre_line: Array
    """Points (n, 3) [m] of the polyline, n >= 2; `smooth_line` makes one through a few points."""
    radius_m: float
    """Radius [m]."""

    def __post_init__(self) -> None:
        """Refuse what is not a tube.

        Raises:
            InputError: a radius that is not positive, fewer than two points, or repeated ones.
        """
        _positive("tube", radius_m=self.radius_m)
        line = np.array(self.centre_line, dtype=np.float64)
        if line.ndim != 2 or line.shape[1] != 3 or len(line) < 2 or not np.isfinite(line).all():
            msg = f"a tube needs two or more finite points (n, 3), got shape {line.shape}"
            raise InputError(msg)
        if not np.linalg.norm(np.diff(line, axis=0), axis=1).all():
            msg = "a tube needs points that differ from their neighbours"
            raise InputError(msg)
        line.flags.writeable = False
        object.__setattr__(self, "centre_line", line)

    def signed_distance(self, points: ArrayLike) -> Array:
        """Return d (n,) [m] of points (n, 3) [m]."""
        return _polyline_distance(_points(points), self.centre_line) - self.radius_m


@dataclass(frozen=True, slots=True, eq=False)
class MeshSolid:
    """Inside of a watertight triangle mesh, whichever way its faces turn."""

    vertices: Array
    """Vertices (n, 3) [m]."""
    faces: np.ndarray
    """Triangles (m, 3): indices into `vertices`."""
    _triangles: Array = field(init=False, repr=False)
    """Corners (m, 3, 3) [m]."""

    def __post_init__(self) -> None:
        """Refuse what has no inside.

        Raises:
            InputError: wrong shapes, values not finite, indices out of range, or open edges.
        """
        vertices = np.array(self.vertices, dtype=np.float64)
        faces = np.array(self.faces, dtype=np.int64)
        _check_mesh(vertices, faces)
        triangles = vertices[faces]
        for name, value in (("vertices", vertices), ("faces", faces), ("_triangles", triangles)):
            value.flags.writeable = False
            object.__setattr__(self, name, value)

    def signed_distance(self, points: ArrayLike) -> Array:
        """Return d (n,) [m] of points (n, 3) [m]."""
        p = _points(points)
        distance = np.zeros(len(p))
        step = max(1, PAIRS_PER_CHUNK // len(self.faces))
        for start in range(0, len(p), step):
            chunk = p[start : start + step]
            inside = np.abs(_winding(chunk, self._triangles)) > 0.5
            away = _triangle_distance(chunk, self._triangles)
            distance[start : start + step] = np.where(inside, -away, away)
        return distance


Solid: TypeAlias = Plane | Box | Cylinder | Funnel | Tube | MeshSolid
"""Any solid: it has `signed_distance(points) -> (n,)`."""


def gradient(solid: Solid, points: ArrayLike, *, step_m: float = 1e-6) -> Array:
    """Return the gradient of d (n, 3) at points (n, 3) [m]: outwards, unit length off ridges."""
    p = _points(points)
    shifts = step_m * np.concatenate((np.eye(3), -np.eye(3)))
    d = solid.signed_distance((p[None] + shifts[:, None]).reshape(-1, 3)).reshape(6, len(p))
    return np.asarray((d[:3] - d[3:]).T / (2.0 * step_m), dtype=np.float64)


def smooth_line(points: ArrayLike, *, samples: int = SPLINE_SAMPLES) -> Array:
    """Return a Catmull-Rom polyline (k, 3) [m] through points (n, 3) [m].

    The end tangents point to the neighbour; two points stay a straight line.
    """
    p = _points(points)
    if len(p) < 3:
        return p
    padded = np.concatenate((2 * p[:1] - p[1:2], p, 2 * p[-1:] - p[-2:-1]))
    s = np.arange(samples)[:, None] / samples
    spans = [
        b + 0.5 * s * (c - a + s * (2 * a - 5 * b + 4 * c - d + s * (3 * (b - c) + d - a)))
        for a, b, c, d in zip(padded, padded[1:], padded[2:], padded[3:], strict=False)
    ]
    return np.concatenate((*spans, p[-1:]))


def _points(points: ArrayLike) -> Array:
    return np.asarray(points, dtype=np.float64).reshape(-1, 3)


def _positive(kind: str, **sizes: float | tuple[float, ...]) -> None:
    for name, value in sizes.items():
        numbers = value if isinstance(value, tuple) else (value,)
        if not all(math.isfinite(n) and n > 0 for n in numbers):
            msg = f"{kind} {name} must be finite and positive, got {value}"
            raise InputError(msg)


def _box_distance(excess: Array) -> Array:
    outside = np.linalg.norm(np.maximum(excess, 0.0), axis=-1)
    return np.asarray(outside + np.minimum(excess.max(axis=-1), 0.0), dtype=np.float64)


def _polyline_distance(points: Array, line: Array) -> Array:
    """Return the distance (n,) of points (n, d) to a polyline (k, d)."""
    distance = np.zeros(len(points))
    step = max(1, PAIRS_PER_CHUNK // len(line))
    for start in range(0, len(points), step):
        chunk = points[start : start + step]
        squared = _squared_segment_distance(chunk, line[:-1], line[1:])
        distance[start : start + step] = np.sqrt(squared.min(axis=1))
    return distance


def _squared_segment_distance(points: Array, a: Array, b: Array) -> Array:
    """Return squared distances (n, k) of points (n, d) to segments from a to b (k, d)."""
    along = b - a
    offset = points[:, None] - a
    share = (offset * along).sum(axis=-1) / (along * along).sum(axis=-1)
    rest = offset - np.clip(share, 0.0, 1.0)[..., None] * along
    return np.asarray((rest * rest).sum(axis=-1), dtype=np.float64)


def _triangle_distance(points: Array, triangles: Array) -> Array:
    """Return the distance (n,) of points (n, 3) to the nearest of triangles (m, 3, 3)."""
    corners = [triangles[:, i] for i in range(3)]
    edges = [(corners[i], corners[(i + 1) % 3]) for i in range(3)]
    nearest = np.min([_squared_segment_distance(points, a, b) for a, b in edges], axis=0)
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    above = np.ones(nearest.shape, dtype=bool)
    for a, b in edges:
        above &= ((points[:, None] - a) * np.cross(normal, b - a)).sum(axis=-1) >= 0.0
    height = ((points[:, None] - corners[0]) * normal).sum(axis=-1)
    return np.asarray(np.sqrt(np.where(above, height * height, nearest).min(axis=1)))


def _winding(points: Array, triangles: Array) -> Array:
    """Return the winding number (n,) of points (n, 3): solid angle over 4 pi.

    Solid angle of a triangle after Van Oosterom and Strackee, 1983.
    """
    a, b, c = (triangles[:, i] - points[:, None] for i in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
    volume = (a * np.cross(b, c)).sum(axis=-1)
    ab, bc, ca = (a * b).sum(axis=-1), (b * c).sum(axis=-1), (c * a).sum(axis=-1)
    angle = 2.0 * np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb)
    return np.asarray(angle.sum(axis=1) / (4.0 * math.pi), dtype=np.float64)


def _check_mesh(vertices: Array, faces: np.ndarray) -> None:
    if vertices.ndim != 2 or vertices.shape[1:] != (3,) or not np.isfinite(vertices).all():
        msg = f"mesh vertices must be finite numbers (n, 3), got shape {vertices.shape}"
        raise InputError(msg)
    if faces.ndim != 2 or faces.shape[1:] != (3,) or len(faces) < 4:
        msg = f"a mesh solid needs 4 or more triangles (m, 3), got shape {faces.shape}"
        raise InputError(msg)
    if faces.min() < 0 or faces.max() >= len(vertices):
        msg = f"mesh faces must index {len(vertices)} vertices, got {faces.min()}..{faces.max()}"
        raise InputError(msg)
    corners = vertices[faces]
    area = np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    if not area.all():
        msg = f"mesh has {int((area == 0).sum())} triangles without area"
        raise InputError(msg)
    edges = np.concatenate((faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]))
    directed = {(int(a), int(b)) for a, b in edges}
    unpaired = sum((b, a) not in directed for a, b in directed)
    if unpaired or len(directed) != len(edges):
        msg = f"mesh is not watertight: {unpaired} of {len(edges)} edges have no partner"
        raise InputError(msg)
