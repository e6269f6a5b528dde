"""Solids of the physics: what can touch.

An object's mesh is taken apart into its connected pieces and each piece is replaced by its convex
hull: a cage of bars stays a cage of bars, and a hook can go under its handle. A bent bar is one
piece and fills up, so bars are modelled straight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from scene.mesh import MeshData
from scene.robot import Collision
from sim.paint import add_hull
from spatial.rotation import Array

SOLID_GROUP = 3
"""Geom group of solids, never drawn."""
_MERGE_DECIMALS = 5
_SMALLEST_M = 1e-4


@dataclass(frozen=True, slots=True)
class Piece:
    """A convex piece of an object, already in the model as a mesh."""

    mesh: str
    """Name of the mesh."""


def pieces_of(spec: mujoco.MjSpec, slug: str, mesh: MeshData) -> tuple[Piece, ...]:
    """Add the convex hulls of a mesh's connected pieces to a model."""
    names: list[str] = []
    for points in connected_pieces(mesh):
        if np.ptp(points, axis=0).min() > _SMALLEST_M:  # a flat piece has no hull and no weight
            names.append(add_hull(spec, f"solid/{slug}/{len(names)}", points))
    return tuple(Piece(name) for name in names)


def connected_pieces(mesh: MeshData) -> list[Array]:
    """Return the vertices (n, 3) [m] of each piece of a mesh that hangs together."""
    points, index = np.unique(np.round(mesh.vertices, _MERGE_DECIMALS), axis=0, return_inverse=True)
    faces = index.ravel()[mesh.faces]
    rows = faces[:, [0, 1]].ravel()
    columns = faces[:, [1, 2]].ravel()
    graph = coo_array((np.ones(len(rows)), (rows, columns)), shape=(len(points), len(points)))
    _, labels = connected_components(graph, directed=False)
    used = np.unique(labels[faces[:, 0]])
    return [points[labels == label] for label in used]


def add_solids(body: mujoco.MjsBody, solids: Sequence[Piece | Collision]) -> None:
    """Add solids that touch to a body; they weigh nothing, the body has its own mass."""
    for solid in solids:
        geom = body.add_geom(contype=1, conaffinity=1, group=SOLID_GROUP, mass=0.0)
        if isinstance(solid, Piece):
            geom.type = mujoco.mjtGeom.mjGEOM_MESH
            geom.meshname = solid.mesh
            continue
        pose = solid.T_link_collision
        geom.pos, geom.quat = pose.translation, pose.quaternion_wxyz
        geom.type, geom.size = _primitive(solid)


def _primitive(solid: Collision) -> tuple[mujoco.mjtGeom, Array]:
    """Return the geom of a primitive; a cylinder becomes a capsule, which has no edge to catch."""
    size = solid.size_m
    if solid.kind == "box":
        return mujoco.mjtGeom.mjGEOM_BOX, size / 2.0
    if solid.kind == "cylinder":
        half = max(_SMALLEST_M, float(size[1]) / 2.0 - float(size[0]))
        return mujoco.mjtGeom.mjGEOM_CAPSULE, np.array([size[0], half, 0.0])
    return mujoco.mjtGeom.mjGEOM_SPHERE, np.array([size[0], 0.0, 0.0])
