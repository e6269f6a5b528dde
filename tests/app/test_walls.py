"""One shape, drawn and felt: the surfaces of fixtures lie on their solids and hide nothing."""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
import pytest

from app.walls import crease_edges, surface_of, wall_look
from scene.fixture import Fixture
from scene.mesh import box_mesh
from spatial.pose import Pose
from spatial.solids import Box, Cylinder, Funnel, MeshSolid, Plane, Solid, Tube, smooth_line

LINE = smooth_line([(0.0, 0.0, 0.0), (0.1, 0.0, 0.05), (0.2, 0.1, 0.1), (0.2, 0.3, 0.1)])
CUBE = box_mesh(np.array([0.1, 0.2, 0.3]))
SOLIDS: dict[str, Solid] = {
    "plane": Plane((0.4, 0.2)),
    "box": Box((0.4, 0.2, 0.1)),
    "cylinder": Cylinder(0.1365, 0.4),
    "funnel": Funnel(0.016, 0.05, 0.08),
    "tube": Tube(LINE, 0.03),
    "mesh": MeshSolid(np.array(CUBE.vertices), np.array(CUBE.faces)),
}
WITHIN_M = 1e-4


@pytest.mark.parametrize("kind", SOLIDS)
def test_every_vertex_lies_on_the_wall(kind: str) -> None:
    solid = SOLIDS[kind]
    surface = surface_of(solid)
    assert np.abs(solid.signed_distance(surface.vertices)).max() < WITHIN_M
    assert surface.faces.min() >= 0
    assert surface.faces.max() < len(surface.vertices)
    assert np.abs(solid.signed_distance(surface.edges.reshape(-1, 3))).max() < WITHIN_M


@pytest.mark.parametrize("kind", SOLIDS)
def test_a_wall_blends_and_faces_both_ways(kind: str) -> None:
    pose: Any = Pose.translated(0.0, 0.1, 0.0)
    look = wall_look(Fixture(kind, "inside", SOLIDS[kind], pose))
    length = struct.unpack_from("<I", look.glb, 12)[0]
    tree = json.loads(look.glb[20 : 20 + length])
    assert [m["alphaMode"] for m in tree["materials"]] == ["BLEND"]
    assert 0.1 < tree["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"][3] < 0.35
    triangles = tree["accessors"][tree["meshes"][0]["primitives"][0]["indices"]]["count"] // 3
    assert triangles == 2 * len(surface_of(SOLIDS[kind]).faces)
    assert len(look.edges)


def test_walls_are_in_the_frame_of_the_object() -> None:
    pose: Any = Pose.translated(1.0, 2.0, 3.0)
    look = wall_look(Fixture("w", "forbidden", Plane((0.2, 0.2)), pose))
    np.testing.assert_allclose(look.edges.reshape(-1, 3).mean(axis=0), [1.0, 2.0, 3.0])


def test_a_box_has_twelve_edges_however_its_vertices_are_shared() -> None:
    corners = CUBE.vertices[CUBE.faces].reshape(-1, 3)
    split = np.arange(len(corners)).reshape(-1, 3)
    assert len(crease_edges(CUBE.vertices, CUBE.faces)) == 12
    assert len(crease_edges(corners, split)) == 12
