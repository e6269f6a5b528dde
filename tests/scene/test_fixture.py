"""Fixtures from TOML tables: where the tool may be, and what a broken table says."""

from __future__ import annotations

import math
import tomllib
from pathlib import Path

import numpy as np
import pytest

from scene.database import load_database
from scene.fixture import Fixture, nearest_clearance, parse_fixture
from scene.site import ASSETS
from spatial.errors import FileInputError
from spatial.frames import Frame, Object
from spatial.pose import Pose
from spatial.solids import Box, Cylinder, Funnel, MeshSolid, Plane, Tube

HOLE: Pose[Object, Frame] = Pose.exp([0.1, 0.0, 0.2, 0.0, math.pi / 2, 0.0])
TETRAHEDRON = """v 0 0 0
v 0.1 0 0
v 0 0.1 0
v 0 0 0.1
f 1 3 2
f 1 2 4
f 1 4 3
f 2 3 4
"""


def parsed(text: str, *, folder: Path = Path()) -> Fixture:
    path = folder / "object.toml"
    frames = {"hole": HOLE}
    return parse_fixture(tomllib.loads(text), frames=frames, path=path, key="fixture[2]")


def table(kind: str, sizes: str, role: str = "inside", more: str = "") -> str:
    return f'name = "guide"\nkind = "{kind}"\nrole = "{role}"\n{sizes}\n{more}'


def test_every_kind_is_read(tmp_path: Path) -> None:
    (tmp_path / "tip.obj").write_text(TETRAHEDRON)
    cases = {
        Plane: table("plane", "size_m = [1, 2]"),
        Box: table("box", "size_m = [1, 2, 3]"),
        Cylinder: table("cylinder", "radius_m = 0.1\nlength_m = 0.3"),
        Funnel: table("funnel", "radius_m = 0.1\nmouth_radius_m = 0.2\nlength_m = 0.3"),
        Tube: table("tube", "radius_m = 0.1\npoints_m = [[0, 0, 0], [0, 0, 1], [1, 0, 1]]"),
        MeshSolid: table("mesh", 'file = "tip.obj"'),
    }
    for kind, text in cases.items():
        fixture = parsed(text, folder=tmp_path)
        assert type(fixture.solid) is kind
        assert (fixture.name, fixture.role, fixture.enabled) == ("guide", "inside", True)
        assert fixture.stiffness_n_m > 0


def test_a_fixture_hangs_in_its_frame() -> None:
    sizes = "radius_m = 0.02\nlength_m = 0.1"
    offset = 'frame = "hole"\ntranslation_m = [0, 0, 0.05]\nstiffness_n_m = 900\nenabled = false'
    fixture = parsed(table("cylinder", sizes, "inside", offset))
    centre_fixture = np.array([0.0, 0.0, 0.05])
    p_object = HOLE.apply([0.0, 0.0, 0.1])
    np.testing.assert_allclose(fixture.T_object_fixture.apply(centre_fixture), p_object)
    np.testing.assert_allclose(fixture.clearance(p_object), [0.02])
    assert (fixture.stiffness_n_m, fixture.enabled) == (900.0, False)
    assert nearest_clearance((fixture,), p_object).tolist() == [math.inf]  # switched off


def test_inside_keeps_in_and_forbidden_keeps_out() -> None:
    points = [[0.0, 0.0, 0.0], [0.0, 0.0, 0.9]]
    inside = parsed(table("box", "size_m = [1, 1, 1]"))
    outside = parsed(table("box", "size_m = [1, 1, 1]", "forbidden"))
    np.testing.assert_allclose(inside.clearance(points), [0.5, -0.4])
    np.testing.assert_allclose(outside.clearance(points), [-0.5, 0.4])
    assert inside.allows(points).tolist() == [True, False]
    floor = parsed(table("plane", "size_m = [1, 1]", "forbidden"))
    assert floor.allows([[0.0, 0.0, 0.1], [5.0, 0.0, -0.1]]).tolist() == [True, False]


def test_the_nearest_of_several_walls_counts() -> None:
    room = parsed(table("box", "size_m = [1, 1, 1]"))
    floor = parsed(table("plane", "size_m = [1, 1]", "forbidden"))
    np.testing.assert_allclose(nearest_clearance((room, floor), [[0.0, 0.0, 0.1]]), [0.1])
    np.testing.assert_allclose(nearest_clearance((room, floor), [[0.0, 0.0, 0.45]]), [0.05])
    assert nearest_clearance((), [[0.0, 0.0, 0.1]]).tolist() == [math.inf]


BROKEN = {
    "kind": (table("bax", "size_m = [1, 1, 1]"), "unknown kind 'bax'; available: box, cyl"),
    "role": (table("box", "size_m = [1, 1, 1]", "out"), "'out'; available: forbidden, inside"),
    "frame": (table("box", "size_m = [1, 1, 1]", more='frame = "h"'), "available: hole, object"),
    "missing": (table("cylinder", "radius_m = 0.1"), r"length_m is missing.*fixture\[2\]"),
    "count": (table("box", "size_m = [1, 1]"), "list of 3 finite numbers, got"),
    "negative": (table("box", "size_m = [1, -1, 1]"), r"positive, got .*key fixture\[2\]"),
    "stiffness": (
        table("plane", "size_m = [1, 1]", more="stiffness_n_m = 0"),
        "stiffness_n_m must be a number greater than 0",
    ),
    "left over": (table("plane", "size_m = [1, 1]\nradius_m = 2"), "unknown key 'radius_m'"),
    "turn": (
        table("plane", "size_m = [1, 1]", more="quaternion_wxyz = [1, 1, 0, 0]"),
        "unit length",
    ),
    "points": (table("tube", "radius_m = 1\npoints_m = [[0, 0]]"), "lists of 3 finite numbers"),
    "one point": (table("tube", "radius_m = 1\npoints_m = [[0, 0, 0]]"), "two or more"),
    "no file": (table("mesh", 'file = "none.obj"'), "unknown file 'none.obj'; available: tip.obj"),
    "far file": (table("mesh", 'file = "../tip.obj"'), "leads out of the folder"),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_table_says_where_and_what_was_expected(case: str, tmp_path: Path) -> None:
    (tmp_path / "tip.obj").write_text(TETRAHEDRON)
    text, said = BROKEN[case]
    with pytest.raises(FileInputError, match=said) as caught:
        parsed(text, folder=tmp_path)
    assert caught.value.key is not None
    assert caught.value.key.startswith("fixture[2]")


def test_an_open_mesh_is_refused(tmp_path: Path) -> None:
    (tmp_path / "open.obj").write_text(TETRAHEDRON.rsplit("f", 1)[0] + "f 1 2 3\n")
    with pytest.raises(FileInputError, match="not watertight"):
        parsed(table("mesh", 'file = "open.obj"'), folder=tmp_path)


def test_fixtures_of_the_shipped_objects_can_be_entered() -> None:
    database = load_database(ASSETS / "objects")
    fixtures = [(e.slug, f) for e in database.entries.values() for f in e.fixtures]
    assert fixtures
    for slug, fixture in fixtures:
        rng = np.random.default_rng(0)
        around = rng.uniform(-1.0, 1.0, (4000, 3)) * np.geomspace(0.01, 0.6, 4000)[:, None]
        allowed = fixture.allows(fixture.T_object_fixture.apply(around))
        assert allowed.any(), (slug, fixture.name)
        assert not allowed.all(), (slug, fixture.name)
