"""Solids the assets are made of: turned, swept, bevelled and bored bodies, in metres."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import trimesh
from numpy.typing import ArrayLike, NDArray

from scene.mesh import Material, MeshData, MeshPart

Array = NDArray[np.float64]
Solid = Any
"""A trimesh.Trimesh; the library is only half typed."""
Look = tuple[str, Material]
"""A material with the name of the part it makes."""


@dataclass(slots=True)
class Body:
    """Solids by material, joined into one mesh."""

    parts: dict[str, tuple[Material, list[Solid]]] = field(default_factory=dict)
    """Material and solids by the name of the part."""
    extra: list[MeshPart] = field(default_factory=list)
    """Finished parts, such as printed markers."""

    def add(self, look: Look, *solids: Solid) -> None:
        """Add solids of one look."""
        name, material = look
        self.parts.setdefault(name, (material, []))[1].extend(solids)

    def mesh(self) -> MeshData:
        """Return everything as a mesh, coordinates rounded to a micrometre."""
        made = []
        for name, (material, solids) in self.parts.items():
            whole: Solid = trimesh.util.concatenate(solids)
            vertices: Array = np.round(np.array(whole.vertices), 6) + 0.0
            made.append(MeshPart(name, vertices, np.asarray(whole.faces, np.int64), material))
        return MeshData.of((*made, *self.extra))


def look(
    name: str, rgb: tuple[int, int, int], *, metallic: float = 0.0, roughness: float = 0.5
) -> Look:
    """Return a named material."""
    return name, Material(color=(*rgb, 255), metallic=metallic, roughness=roughness)


def placed(
    solid: Solid,
    xyz: ArrayLike = (0, 0, 0),
    *,
    rpy_deg: tuple[float, float, float] = (0, 0, 0),
    scale: ArrayLike = (1, 1, 1),
) -> Solid:
    """Return a copy scaled, then turned about fixed x, y, z [deg], then moved."""
    copy = solid.copy()
    copy.vertices = copy.vertices * np.asarray(scale, dtype=np.float64)
    if float(np.prod(np.asarray(scale, dtype=np.float64))) < 0:
        copy.invert()
    copy.apply_transform(transform(xyz, rpy_deg))
    return copy


def transform(xyz: ArrayLike, rpy_deg: ArrayLike = (0, 0, 0)) -> Array:
    """Return the matrix (4, 4) of a translation and fixed-axis angles [deg]."""
    roll, pitch, yaw = np.radians(np.asarray(rpy_deg, dtype=np.float64))
    turns: Any = trimesh.transformations
    matrix: Array = turns.euler_matrix(roll, pitch, yaw, "sxyz")
    matrix[:3, 3] = xyz
    return matrix


def turned(profile: Sequence[tuple[float, float]], *, sides: int = 32) -> Solid:
    """Return the body of a profile of (radius, z) turned about z, from bottom to top.

    A profile that starts and ends at radius 0 is closed; one that returns to its start is a ring.
    """
    points = np.array(profile, dtype=np.float64)
    angles = np.linspace(0.0, 2.0 * np.pi, sides, endpoint=False)
    circle = np.stack((np.cos(angles), np.sin(angles)), axis=1)
    rings = [np.column_stack((radius * circle, np.full(sides, z))) for radius, z in points]
    return _skin(np.array(rings))


def cylinder(
    radius: float, low: float, high: float, *, bevel: float = 0.0, sides: int = 32
) -> Solid:
    """Return a cylinder about z from `low` to `high` with bevelled rims."""
    profile = [(0.0, low), (radius - bevel, low), (radius, low + bevel)]
    profile += [(radius, high - bevel), (radius - bevel, high), (0.0, high)]
    return turned(
        profile if bevel else [p for i, p in enumerate(profile) if i not in {2, 4}], sides=sides
    )


def ring(
    inner: float, outer: float, low: float, high: float, *, bevel: float = 0.0, sides: int = 32
) -> Solid:
    """Return a ring about z with bevelled rims."""
    b = bevel
    profile = [
        (inner + b, low),
        (outer - b, low),
        (outer, low + b),
        (outer, high - b),
        (outer - b, high),
        (inner + b, high),
        (inner, high - b),
        (inner, low + b),
        (inner + b, low),
    ]
    if not b:
        profile = [(inner, low), (outer, low), (outer, high), (inner, high), (inner, low)]
    return turned(profile, sides=sides)


def dome(
    radius: float,
    *,
    low_deg: float = -90.0,
    high_deg: float = 90.0,
    sides: int = 32,
    rings: int = 10,
    flat: float = 1.0,
) -> Solid:
    """Return a ball, or a zone of one between two latitudes, flattened along z by `flat`."""
    latitudes = np.radians(np.linspace(low_deg, high_deg, rings))
    profile = [(radius * np.cos(a), flat * radius * np.sin(a)) for a in latitudes]
    profile = [(0.0, profile[0][1]), *profile, (0.0, profile[-1][1])]
    return turned(profile, sides=sides)


def swept(spine: ArrayLike, radii: ArrayLike, *, sides: int = 16, closed: bool = False) -> Solid:
    """Return a tube of given radii along a line of points (n, 3), with flat ends."""
    points = np.asarray(spine, dtype=np.float64)
    radius = np.broadcast_to(np.asarray(radii, dtype=np.float64), len(points))
    ahead = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    if not closed:
        ahead[0], ahead[-1] = points[1] - points[0], points[-1] - points[-2]
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    side = _across(ahead[0])
    angles = np.linspace(0.0, 2.0 * np.pi, sides, endpoint=False)
    rings = []
    for point, tangent, r in zip(points, ahead, radius, strict=True):
        side = side - tangent * (side @ tangent)
        side = side / np.linalg.norm(side)
        other = np.cross(tangent, side)
        rings.append(point + r * (np.outer(np.cos(angles), side) + np.outer(np.sin(angles), other)))
    if closed:
        return _skin(np.array([*rings, rings[0]]))
    first, last = np.tile(points[0], (sides, 1)), np.tile(points[-1], (sides, 1))
    return _skin(np.array([first, *rings, last]))


def rod(start: ArrayLike, end: ArrayLike, radius: float, *, sides: int = 16) -> Solid:
    """Return a round bar between two points."""
    return swept(np.array([start, end], dtype=np.float64), radius, sides=sides)


def capsule_line(points: ArrayLike, radius: float, *, sides: int = 16) -> Solid:
    """Return a round bar along points with ball ends."""
    line = np.asarray(points, dtype=np.float64)
    starts = []
    for tip, inner in ((line[0], line[1]), (line[-1], line[-2])):
        away = (tip - inner) / np.linalg.norm(tip - inner)
        angles = np.radians((72.0, 45.0, 20.0))
        starts.append([(tip + away * radius * np.sin(a), radius * np.cos(a)) for a in angles])
    head = starts[0]
    tail = starts[1][::-1]
    spine = np.array([*(p for p, _ in head), *line, *(p for p, _ in tail)])
    radii = [*(r for _, r in head), *([radius] * len(line)), *(r for _, r in tail)]
    return swept(spine, radii, sides=sides)


def bevelled_box(size: ArrayLike, bevel: float) -> Solid:
    """Return a box of size (3,), centred, with flat bevels on its twelve edges."""
    half = 0.5 * np.asarray(size, dtype=np.float64)
    corners = []
    for axis in range(3):
        inset = half - bevel
        inset[axis] = half[axis]
        corners.append(np.array(np.meshgrid(*[(-1, 1)] * 3)).reshape(3, -1).T * inset)
    return hull(np.concatenate(corners))


def rounded_plate(size: ArrayLike, radius: float, *, bevel: float = 0.0, steps: int = 5) -> Solid:
    """Return a plate of size (3,), centred, with round corners in xy and bevelled faces."""
    x, y, z = 0.5 * np.asarray(size, dtype=np.float64)
    angles = np.radians(np.linspace(0.0, 90.0, steps))
    outline = []
    for quarter, (sx, sy) in enumerate(((1, 1), (-1, 1), (-1, -1), (1, -1))):
        turn = angles + quarter * np.pi / 2.0
        centre = np.array((sx * (x - radius), sy * (y - radius)))
        outline.append(centre + radius * np.stack((np.cos(turn), np.sin(turn)), axis=1))
    flat = np.concatenate(outline)
    inner = flat * ((x - bevel) / x, (y - bevel) / y)
    levels = (
        [(inner, -z), (flat, -z + bevel), (flat, z - bevel), (inner, z)]
        if bevel
        else [(flat, -z), (flat, z)]
    )
    return extruded(levels)


def extruded(levels: Sequence[tuple[Array, float]]) -> Solid:
    """Return a convex-ended body through outlines (n, 2), counter-clockwise, at rising z."""
    rings = [np.column_stack((outline, np.full(len(outline), z))) for outline, z in levels]
    ends = [np.tile(r.mean(axis=0), (len(r), 1)) for r in (rings[0], rings[-1])]
    return _skin(np.array([ends[0], *rings, ends[1]]))


def hull(points: ArrayLike) -> Solid:
    """Return the convex hull of points (n, 3)."""
    return trimesh.convex.convex_hull(np.asarray(points, dtype=np.float64))


def cut(solid: Solid, *tools: Solid) -> Solid:
    """Return a solid less others."""
    return trimesh.boolean.difference([solid, *tools], engine="manifold")


def fused(*solids: Solid) -> Solid:
    """Return the union of solids."""
    return trimesh.boolean.union(list(solids), engine="manifold")


def arc(
    centre: ArrayLike,
    radius: float,
    start_deg: float,
    end_deg: float,
    *,
    steps: int,
    plane: str = "xz",
) -> Array:
    """Return points (steps, 3) of a circular arc in a coordinate plane."""
    angles = np.radians(np.linspace(start_deg, end_deg, steps))
    points = np.zeros((steps, 3))
    points[:, "xyz".index(plane[0])] = radius * np.cos(angles)
    points[:, "xyz".index(plane[1])] = radius * np.sin(angles)
    return points + np.asarray(centre, dtype=np.float64)


def smoothstep(share: ArrayLike) -> Array:
    """Return the smooth rise 0 to 1 of shares in [0, 1]."""
    t = np.asarray(share, dtype=np.float64)
    return t * t * (3.0 - 2.0 * t)


def _across(vector: Array) -> Array:
    helper = np.eye(3)[int(np.argmin(np.abs(vector)))]
    return np.cross(vector, helper)


def _skin(rings: Array) -> Solid:
    """Return the surface through rings (k, n, 3); a ring that is a point closes it."""
    count, sides = rings.shape[:2]
    below = np.arange(count * sides).reshape(count, sides)[:-1]
    beside = np.roll(below, -1, axis=1)
    quads = np.stack((below, beside, beside + sides, below + sides), axis=-1).reshape(-1, 4)
    faces = np.concatenate((quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]))
    mesh: Solid = trimesh.Trimesh(rings.reshape(-1, 3), faces, process=False)
    mesh.merge_vertices()
    mesh.update_faces(mesh.nondegenerate_faces())
    mesh.remove_unreferenced_vertices()
    return mesh


def skin_of(rings: Sequence[Array]) -> Solid:
    """Return the closed surface through rings of as many points each, ends flat."""
    first, last = (np.tile(r.mean(axis=0), (len(r), 1)) for r in (rings[0], rings[-1]))
    return _skin(np.array([first, *rings, last]))
