"""Fixtures: solids attached to an object that guide the tool, drawn and felt from one shape.

    [[fixture]]
    name = "seat"
    kind = "funnel"                 # plane | box | cylinder | funnel | tube | mesh
    role = "inside"                 # inside: the tool stays in the solid; forbidden: out of it
    frame = "hole"                  # a [[frame]] of the object, or "object" (the default)
    translation_m = [0, 0, 0]       # of the solid in that frame, optional
    quaternion_wxyz = [1, 0, 0, 0]  # optional
    stiffness_n_m = 500.0           # optional
    enabled = true                  # optional
    radius_m = 0.016                # sizes, by kind, as the solids of `spatial.solids` name them

Sizes: plane `size_m = [x, y]` (what is drawn); box `size_m = [x, y, z]`; cylinder `radius_m,
length_m`; funnel `radius_m, mouth_radius_m, length_m`; tube `radius_m, points_m` (a smooth line
is laid through them); mesh `file`, a watertight mesh in the object's folder.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from scene.mesh import load_mesh
from scene.table import TableReader
from spatial.frames import Frame, Object
from spatial.pose import Pose
from spatial.rotation import Array
from spatial.solids import (
    Box,
    Cylinder,
    Funnel,
    MeshSolid,
    Plane,
    Solid,
    Tube,
    smooth_line,
)

ROLES = ("inside", "forbidden")
"""Where the tool has to stay: in the solid, or out of it."""
DEFAULT_STIFFNESS_N_M = 500.0
"""Spring of a wall nobody gave one [N/m]."""


class FixtureFrame(Frame):
    """Frame the solid of a fixture is defined in."""


@dataclass(frozen=True, slots=True, eq=False)
class Fixture:
    """A guiding wall or shape attached to an object."""

    name: str
    """Unique within the object."""
    role: str
    """`inside` (the tool stays in the solid) or `forbidden` (out of it)."""
    solid: Solid
    """Shape, in its own frame."""
    T_object_fixture: Pose[Object, FixtureFrame]
    """Pose of the solid's frame in the object."""
    stiffness_n_m: float = DEFAULT_STIFFNESS_N_M
    """Spring constant of the wall [N/m]."""
    enabled: bool = True
    """Whether it starts shown and felt."""

    def clearance(self, points_object: ArrayLike) -> Array:
        """Return how far points (n, 3) [m] of the object's frame are from the wall (n,) [m].

        Positive where the tool may be, negative where it may not.
        """
        distance = self.solid.signed_distance(self.T_object_fixture.inverse().apply(points_object))
        return -distance if self.role == "inside" else distance

    def allows(self, points_object: ArrayLike) -> np.ndarray:
        """Return whether the tool may be at points (n, 3) [m] of the object's frame."""
        return self.clearance(points_object) >= 0.0


def nearest_clearance(fixtures: tuple[Fixture, ...], points_object: ArrayLike) -> Array:
    """Return the smallest clearance (n,) [m] over all enabled fixtures; inf without any."""
    points = np.asarray(points_object, dtype=np.float64).reshape(-1, 3)
    walls = [fixture.clearance(points) for fixture in fixtures if fixture.enabled]
    return np.min(walls, axis=0) if walls else np.full(len(points), np.inf)


def parse_fixture(
    table: Mapping[str, Any], *, frames: Mapping[str, Pose[Object, Frame]], path: Path, key: str
) -> Fixture:
    """Return the fixture of one `[[fixture]]` table.

    Args:
        table: the table as TOML gives it.
        frames: named frames of the object by name; `object` exists without being listed.
        path: the file, for messages and as the place of mesh files.
        key: dotted key of the table, e.g. `fixture[0]`.

    Raises:
        FileInputError: a key that is missing, unknown, of the wrong type or out of range.
    """
    reader = TableReader(table, path=path, key=key)
    name = reader.text("name")
    kind = reader.choice("kind", tuple(_SOLIDS))
    role = reader.choice("role", ROLES)
    known: dict[str, Pose[Object, Frame]] = {"object": Pose.identity(), **frames}
    T_object_frame = known[reader.choice("frame", tuple(known), default="object")]
    T_frame_fixture: Pose[Frame, FixtureFrame] = reader.pose()
    stiffness = reader.number("stiffness_n_m", default=DEFAULT_STIFFNESS_N_M, above=0.0)
    enabled = reader.flag("enabled", default=True)
    solid = reader.guarded(_SOLIDS[kind])
    reader.finish()
    return Fixture(name, role, solid, T_object_frame @ T_frame_fixture, stiffness, enabled)


def _plane(reader: TableReader) -> Solid:
    x, y = reader.numbers("size_m", 2)
    return Plane((x, y))


def _box(reader: TableReader) -> Solid:
    x, y, z = reader.numbers("size_m", 3)
    return Box((x, y, z))


def _cylinder(reader: TableReader) -> Solid:
    return Cylinder(reader.number("radius_m"), reader.number("length_m"))


def _funnel(reader: TableReader) -> Solid:
    return Funnel(
        reader.number("radius_m"), reader.number("mouth_radius_m"), reader.number("length_m")
    )


def _tube(reader: TableReader) -> Solid:
    return Tube(smooth_line(reader.rows("points_m", 3)), reader.number("radius_m"))


def _mesh(reader: TableReader) -> Solid:
    mesh = load_mesh(reader.file("file"))
    vertices, index = np.unique(mesh.vertices, axis=0, return_inverse=True)  # files split them
    return MeshSolid(vertices, index.reshape(-1)[mesh.faces])


_SOLIDS: dict[str, Callable[[TableReader], Solid]] = {
    "plane": _plane,
    "box": _box,
    "cylinder": _cylinder,
    "funnel": _funnel,
    "tube": _tube,
    "mesh": _mesh,
}
