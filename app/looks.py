"""What the stage draws, made once from the robot, the database and the site: bytes and lines."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from app.walls import WallLook, crease_edges, wall_look
from scene.fixture import Fixture
from scene.glb import to_glb
from scene.mesh import MeshData
from scene.robot import Robot
from spatial.camera import PinholeCamera
from spatial.errors import TelepresenceError
from spatial.rotation import Array

BRIDGED_RGBA = (240, 184, 92, 120)
STALE_RGBA = (112, 118, 124, 255)
MAX_OUTLINE = 500
"""Segments of an outline."""
OUTLINE_SHARE = 0.22
"""Lines that span less of the object's diagonal are left out."""
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class LinkLook:
    """One link of the robot."""

    link: str
    """Name of the link."""
    glb: bytes
    """Mesh in the frame of the link."""


@dataclass(frozen=True, slots=True, eq=False)
class ObjectLook:
    """One object in every state, in its own frame."""

    slug: str
    """Name in the database."""
    name: str
    """Name for people."""
    solid: bytes
    """TRACKED."""
    bridged: bytes
    """BRIDGED: translucent."""
    stale: bytes
    """STALE: grey."""
    outline: Array
    """LOST and raw pose: segments (n, 2, 3) [m]."""
    corners: Array
    """Corners (8, 3) of the bounding box [m]."""
    walls: tuple[WallLook, ...]
    """Fixtures attached to it."""


@dataclass(frozen=True, slots=True, eq=False)
class StageLook:
    """Everything the stage draws."""

    links: tuple[LinkLook, ...]
    """Robot."""
    objects: tuple[ObjectLook, ...]
    """Objects of the site."""
    cameras: Mapping[str, PinholeCamera]
    """Cameras whose frusta are drawn."""


def link_looks(robot: Robot) -> tuple[LinkLook, ...]:
    """Return one mesh per link that has visuals."""
    parts: dict[str, list[MeshData]] = {}
    for visual in robot.visuals:
        pose = visual.T_link_visual
        moved = tuple(
            replace(
                part,
                vertices=pose.apply(part.vertices),
                normals=None if part.normals is None else pose.rotate(part.normals),
            )
            for part in visual.mesh.parts
        )
        parts.setdefault(visual.link, []).append(MeshData.of(moved))
    return tuple(
        LinkLook(link, to_glb(MeshData.of(tuple(p for mesh in meshes for p in mesh.parts))))
        for link, meshes in parts.items()
    )


def object_look(
    slug: str, mesh: MeshData, *, name: str | None = None, fixtures: Iterable[Fixture] = ()
) -> ObjectLook:
    """Return the looks of an object from its mesh; printed markers show only on the solid body."""
    bare = mesh.without("tag_")
    body = bare if len(bare.faces) else mesh
    low, high = body.vertices.min(axis=0), body.vertices.max(axis=0)
    corners = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    return ObjectLook(
        slug,
        name or slug,
        to_glb(mesh),
        to_glb(body.coloured(BRIDGED_RGBA)),
        to_glb(body.coloured(STALE_RGBA)),
        _outline(body),
        low + np.array(corners) * (high - low),
        _walls(slug, fixtures),
    )


def _walls(slug: str, fixtures: Iterable[Fixture]) -> tuple[WallLook, ...]:
    looks = []
    for fixture in fixtures:
        if not fixture.enabled:
            continue
        try:
            looks.append(wall_look(fixture))
        except TelepresenceError as error:
            _LOG.warning("fixture %s of %s is not drawn: %s", fixture.name, slug, error)
    return tuple(looks)


def _outline(mesh: MeshData) -> Array:
    """Return the lines that tell the shape: bolts and fillets would only be mush."""
    edges = crease_edges(mesh.vertices, mesh.faces)
    if not len(edges):
        return edges
    line = _lines_of(edges)
    diagonal = float(np.linalg.norm(mesh.extents_m))
    order = np.argsort(line, kind="stable")
    starts = np.flatnonzero(np.diff(line[order], prepend=-1))
    low = np.minimum.reduceat(edges[order].min(axis=1), starts)
    high = np.maximum.reduceat(edges[order].max(axis=1), starts)
    sizes = np.linalg.norm(high - low, axis=1)
    kept = edges[sizes[line] >= min(OUTLINE_SHARE * diagonal, sizes.max())]
    longest = np.argsort(-np.linalg.norm(kept[:, 1] - kept[:, 0], axis=1))[:MAX_OUTLINE]
    return np.asarray(kept[np.sort(longest)])


def _lines_of(edges: Array) -> np.ndarray:
    """Return the number 0, 1, ... of the connected line each segment (n, 2, 3) is part of."""
    _, ends = np.unique(np.round(edges.reshape(-1, 3), 7), axis=0, return_inverse=True)
    pairs = ends.reshape(-1, 2)
    count = int(pairs.max()) + 1
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    _, labels = connected_components(graph, directed=False)
    return np.asarray(np.unique(labels[pairs[:, 0]], return_inverse=True)[1].reshape(-1))
