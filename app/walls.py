"""Fixture solids as surfaces to draw: translucent, seen from both sides, with opaque edges.

A wall must never hide what is behind it. Its material blends, which keeps it from writing depth;
each triangle is there twice, facing both ways; and its edges are lines, for the eye to hold on to.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scene.fixture import Fixture
from scene.glb import to_glb
from scene.mesh import Material, MeshData, MeshPart
from spatial.errors import InputError
from spatial.pose import Pose
from spatial.rotation import Array
from spatial.solids import Box, Cylinder, Funnel, MeshSolid, Plane, Solid, Tube, gradient

SNAP_STEPS = 6
SEGMENTS = 64
"""Corners of a circle."""
COLORS = {"inside": (98, 172, 232, 46), "forbidden": (232, 132, 98, 54)}
"""RGBA of a wall by the role of its fixture."""
EDGE_COLORS = {"inside": (104, 158, 204), "forbidden": (206, 128, 102)}
EDGE_ANGLE_RAD = float(np.radians(30.0))


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """Triangles of a solid's wall and the lines along its edges, in the solid's frame."""

    vertices: Array
    """(n, 3) [m]."""
    faces: np.ndarray
    """(m, 3) indices into `vertices`."""
    edges: Array
    """Segments (k, 2, 3) [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class WallLook:
    """What the page draws of one fixture, in the object's frame."""

    name: str
    """Name of the fixture."""
    role: str
    """`inside` or `forbidden`."""
    glb: bytes
    """Translucent surface."""
    edges: Array
    """Segments (k, 2, 3) [m]."""


def wall_look(fixture: Fixture) -> WallLook:
    """Return what is drawn of a fixture."""
    surface = surface_of(fixture.solid)
    return WallLook(
        fixture.name,
        fixture.role,
        translucent_glb(_moved(surface, fixture.T_object_fixture), COLORS[fixture.role]),
        fixture.T_object_fixture.apply(surface.edges),
    )


def translucent_glb(surface: Surface, color: tuple[int, int, int, int]) -> bytes:
    """Return a blended, double-sided mesh; `color` is RGBA, 0 to 255."""
    corners = surface.vertices[surface.faces].reshape(-1, 3)
    front = np.arange(len(corners), dtype=np.int64).reshape(-1, 3)
    back = (front + len(corners))[:, ::-1]
    triangles = corners.reshape(-1, 3, 3)
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.repeat(normals / np.where(length > 0, length, 1.0), 3, axis=0)
    part = MeshPart(
        "wall",
        np.concatenate((corners, corners)),
        np.concatenate((front, back)),
        Material(color=color, roughness=0.9),
        normals=np.concatenate((normals, -normals)),
    )
    return to_glb(MeshData.of((part,)))


def surface_of(solid: Solid) -> Surface:
    """Return the wall of a solid; every vertex lies on it (signed distance zero).

    Raises:
        InputError: a solid of unknown kind.
    """
    if isinstance(solid, Plane):
        return _quad(solid.size_m)
    if isinstance(solid, Box):
        return _box(solid.size_m)
    if isinstance(solid, Cylinder):
        return _cone(solid.radius_m, solid.radius_m, solid.length_m)
    if isinstance(solid, Funnel):
        return _cone(solid.radius_m, solid.mouth_radius_m, solid.length_m)
    if isinstance(solid, Tube):
        return _tube(solid.centre_line, solid.radius_m)
    if isinstance(solid, MeshSolid):
        return Surface(solid.vertices, solid.faces, crease_edges(solid.vertices, solid.faces))
    raise InputError(f"no surface for a solid of kind {type(solid).__name__}")


def crease_edges(vertices: Array, faces: np.ndarray, *, angle_rad: float = EDGE_ANGLE_RAD) -> Array:
    """Return segments (k, 2, 3) where faces meet at an angle or end, however they share vertices.

    Args:
        vertices: (n, 3) [m].
        faces: (m, 3) indices.
        angle_rad: the smallest angle between the normals of two faces that makes an edge [rad].
    """
    places, same = np.unique(np.round(vertices, 7), axis=0, return_inverse=True)
    welded = same.reshape(-1)[faces]
    corners = places[welded]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = normals / np.where(length > 0, length, 1.0)
    pairs = np.sort(welded[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    owners = np.repeat(np.arange(len(faces)), 3)
    proper = pairs[:, 0] != pairs[:, 1]
    pairs, owners = pairs[proper], owners[proper]
    unique, group, count = np.unique(pairs, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(group.reshape(-1), kind="stable")
    starts = np.concatenate(([0], np.cumsum(count)[:-1]))
    first, last = owners[order[starts]], owners[order[starts + count - 1]]
    cosine = np.einsum("ij,ij->i", normals[first], normals[last])
    sharp = (count != 2) | (cosine < np.cos(angle_rad))
    return np.asarray(places[unique[sharp]])


def _moved(surface: Surface, pose: Pose) -> Surface:  # type: ignore[type-arg]  # any two frames
    return Surface(pose.apply(surface.vertices), surface.faces, pose.apply(surface.edges))


def _loop(points: Array) -> Array:
    return np.stack((points, np.roll(points, -1, axis=0)), axis=1)


def _quad(size: tuple[float, float]) -> Surface:
    x, y = 0.5 * size[0], 0.5 * size[1]
    corners = np.array([(-x, -y, 0.0), (x, -y, 0.0), (x, y, 0.0), (-x, y, 0.0)])
    return Surface(corners, np.array([(0, 1, 2), (0, 2, 3)]), _loop(corners))


def _box(size: tuple[float, float, float]) -> Surface:
    signs = np.array([(x, y, z) for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)])
    corners = 0.5 * signs * np.array(size)
    quads = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    faces = np.array([f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))])
    return Surface(corners, faces, crease_edges(corners, faces))


def _cone(radius: float, mouth: float, length: float) -> Surface:
    circle = _circle()
    low = np.column_stack((circle * radius, np.zeros(SEGMENTS)))
    high = np.column_stack((circle * mouth, np.full(SEGMENTS, length)))
    quarter = np.arange(0, SEGMENTS, SEGMENTS // 4)
    sides = np.stack((low[quarter], high[quarter]), axis=1)
    edges = np.concatenate((_loop(low), _loop(high), sides))
    return Surface(np.concatenate((low, high)), _strip(2), edges)


def _tube(line: Array, radius: float) -> Surface:
    tangents = np.gradient(line, axis=0)
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    side = np.cross(tangents[0], np.eye(3)[np.argmin(np.abs(tangents[0]))])
    rings = []
    for point, tangent in zip(line, tangents, strict=True):
        side = side - tangent * (side @ tangent)  # carried along without twist
        side = side / np.linalg.norm(side)
        up = np.cross(tangent, side)
        rings.append(point + radius * (_circle() @ np.stack((side, up))))
    # Where the line bends, rings lie off the wall that is felt: put them onto it.
    drawn = _onto(Tube(line, radius), np.concatenate(rings))
    first, last = drawn[:SEGMENTS], drawn[-SEGMENTS:]
    return Surface(drawn, _strip(len(rings)), np.concatenate([_loop(first), _loop(last)]))


def _onto(solid: Tube, points: Array) -> Array:
    """Return points (n, 3) moved along the gradient of the distance until it is zero."""
    for _ in range(SNAP_STEPS):
        points = points - solid.signed_distance(points)[:, None] * gradient(solid, points)
    return points


def _circle() -> Array:
    turn = np.linspace(0.0, 2.0 * np.pi, SEGMENTS, endpoint=False)
    return np.column_stack((np.cos(turn), np.sin(turn)))


def _strip(rings: int) -> np.ndarray:
    """Triangles (n, 3) between consecutive rings of SEGMENTS vertices."""
    here = np.arange(SEGMENTS)
    there = np.roll(here, -1)
    one = np.concatenate(
        (
            np.column_stack((here, there, there + SEGMENTS)),
            np.column_stack((here, there + SEGMENTS, here + SEGMENTS)),
        )
    )
    return np.concatenate([one + ring * SEGMENTS for ring in range(rings - 1)])
