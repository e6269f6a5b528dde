"""The object database: strict files, named faults, and never a crash."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scene.database import load_database, load_object
from scene.entry import ObjectEntry
from scene.glb import to_glb
from scene.mesh import box_mesh
from spatial.errors import FileInputError, InputError

QUATERNION = "marker[1].quaternion_wxyz"
GLB = to_glb(box_mesh(np.array([0.1, 0.2, 0.3])))
TEXT = """schema = 1
slug = "box"
name = "Box"
revision = 3
mass_kg = 1.5

[mesh]
file = "mesh.glb"

[appearance]
color = [10, 20, 30]

[[marker]]
family = "tag36h11"
id = 200
size_m = 0.05
translation_m = [0, 0, 0.15]
target = true

[[marker]]
family = "tag36h11"
id = 201
size_m = 0.04
translation_m = [0.05, 0, 0]
quaternion_wxyz = [0.70710678, 0, 0.70710678, 0]

[[frame]]
name = "hole"
kind = "axis"
translation_m = [0, 0, 0.15]

[[fixture]]
name = "approach"
kind = "funnel"
role = "inside"
frame = "hole"
radius_m = 0.02
mouth_radius_m = 0.1
length_m = 0.3
"""


def folder_of(root: Path, text: str = TEXT, *, slug: str = "box", glb: bytes = GLB) -> Path:
    folder = root / slug
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "object.toml").write_text(text, encoding="utf-8")
    (folder / "mesh.glb").write_bytes(glb)
    return folder


def refused(root: Path, text: str, *, glb: bytes = GLB) -> FileInputError:
    with pytest.raises(FileInputError) as caught:
        load_object(folder_of(root, text, glb=glb))
    return caught.value


def test_an_object_says_all_that_is_in_its_file(tmp_path: Path) -> None:
    entry = load_object(folder_of(tmp_path))
    assert (entry.slug, entry.name, entry.revision) == ("box", "Box", 3)
    assert (entry.mass_kg, entry.motion, entry.color) == (1.5, "static", (10, 20, 30))
    np.testing.assert_allclose(entry.extents_m, (0.1, 0.2, 0.3), atol=1e-6)
    assert entry.target == ("tag36h11", 200)
    marked = entry.marked()
    assert (marked.slug, marked.revision, len(marked.markers)) == ("box", 3, 2)
    out = entry.markers[1].T_object_marker.rotate((0.0, 0.0, 1.0))
    np.testing.assert_allclose(out, (1, 0, 0), atol=1e-7)
    np.testing.assert_allclose(entry.frames["hole"].T_object_frame.translation, (0, 0, 0.15))
    fixture = entry.fixtures[0]
    assert fixture.allows([[0.0, 0.0, 0.3]]).all()
    assert not fixture.allows([[0.2, 0.0, 0.3]]).any()


def test_the_digest_follows_the_description_and_the_mesh(tmp_path: Path) -> None:
    def digest(text: str = TEXT, glb: bytes = GLB) -> str:
        return load_object(folder_of(tmp_path, text, glb=glb)).sha256

    other = to_glb(box_mesh(np.ones(3)))
    assert digest() == digest()
    assert len({digest(), digest(TEXT.replace("= 3", "= 4")), digest(glb=other)}) == 3


@pytest.mark.parametrize(
    ("old", "new", "key", "line", "said"),
    [
        ("schema = 1", "schema = 2", "schema", 1, "reads schema 1"),
        ('slug = "box"', 'slug = "bax"', "slug", 2, "'box'"),
        ('name = "Box"', "name = 5", "name", 3, "5"),
        ("revision = 3", "revision = 0", "revision", 4, "at least 1"),
        ("mass_kg = 1.5", "mass_kg = -1.5", "mass_kg", 5, "-1.5"),
        ("mass_kg = 1.5", "mass_kg = nan", "mass_kg", 5, "nan"),
        ('file = "mesh.glb"', 'file = "none.glb"', "mesh.file", 8, "available: mesh.glb"),
        ('file = "mesh.glb"', 'file = "../x.glb"', "mesh.file", 8, "out of the folder"),
        ("[10, 20, 30]", "[10, 20, 300]", "appearance.color", 11, "0 to 255"),
        ("[10, 20, 30]", "[10, 20]", "appearance.color", 11, "3 finite numbers"),
        ("id = 201", "id = 200", "marker[1].id", 22, "listed twice"),
        ("id = 201", "id = 587", "marker[1].id", 22, "0 to 586"),
        ('"tag36h11"\nid = 201', '"tag36h12"\nid = 201', "marker[1].family", 21, "tag36h11"),
        ("size_m = 0.04", "size_m = 0", "marker[1].size_m", 23, "greater than 0"),
        ("[0.05, 0, 0]", "[0.05, 0]", "marker[1].translation_m", 24, "3 finite numbers"),
        (
            "[0.70710678, 0, 0.70710678, 0]",
            "[1, 0, 1, 0]",
            "marker[1].quaternion_wxyz",
            25,
            "unit length",
        ),
        ("target = true\n", "", "marker", 13, "exactly one marker has target"),
        ('kind = "axis"', 'kind = "hole"', "frame[0].kind", 29, "available: approach, axis"),
        ('frame = "hole"', 'frame = "hola"', "fixture[0].frame", 36, "available: hole, object"),
        ("length_m = 0.3", "lenght_m = 0.3", "fixture[0].length_m", 32, "length_m"),
        ('name = "hole"', 'name = "hole"\ncolour = 1', "frame[0].colour", 29, "unknown key"),
    ],
)
def test_a_fault_is_named_with_key_and_line(
    tmp_path: Path, *, old: str, new: str, key: str, line: int, said: str
) -> None:
    assert old in TEXT
    error = refused(tmp_path, TEXT.replace(old, new, 1))
    assert (error.key, error.line) == (key, line)
    assert said in str(error)
    assert str(error).endswith("object.toml)")


def test_a_file_that_is_not_toml_names_its_line(tmp_path: Path) -> None:
    assert refused(tmp_path, TEXT.replace("revision = 3", "revision =")).line == 4
    assert "UTF-8" in str(refused_bytes(tmp_path, b"\xff\xfe"))
    assert "TOML" in str(refused(tmp_path, "a = " + "[" * 5000))
    assert "TOML" in str(refused(tmp_path, "a = " + "9" * 5000))


def refused_bytes(root: Path, data: bytes) -> FileInputError:
    folder = folder_of(root)
    (folder / "object.toml").write_bytes(data)
    with pytest.raises(FileInputError) as caught:
        load_object(folder)
    return caught.value


def test_a_broken_mesh_names_the_mesh_file(tmp_path: Path) -> None:
    error = refused(tmp_path, TEXT, glb=b"no mesh")
    assert error.path.name == "mesh.glb"
    assert "glTF" in str(error)


def test_an_object_without_markers_loads_but_cannot_be_tracked(tmp_path: Path) -> None:
    text = TEXT[: TEXT.index("[[marker]]")]
    entry = load_object(folder_of(tmp_path, text))
    assert entry.target is None
    with pytest.raises(FileInputError, match="no marker"):
        entry.marked()


def test_the_database_lists_what_works_and_why_the_rest_does_not(tmp_path: Path) -> None:
    folder_of(tmp_path)
    folder_of(tmp_path, TEXT.replace("revision = 3", "revision = x"), slug="torn")
    (tmp_path / "empty").mkdir()
    (tmp_path / ".trash").mkdir()
    (tmp_path / "notes.txt").write_text("no object", encoding="utf-8")
    database = load_database(tmp_path)
    assert set(database.entries) == {"box"}
    assert [problem.slug for problem in database.problems] == ["empty", "torn"]
    assert "line 4" in database.problems[1].message
    assert database.entry("box").name == "Box"
    with pytest.raises(InputError, match=r"'torn' cannot be used.*line 4"):
        database.entry("torn")
    with pytest.raises(InputError, match="unknown object 'bax'; available: box"):
        database.entry("bax")


def test_two_objects_with_one_marker_are_both_refused(tmp_path: Path) -> None:
    folder_of(tmp_path)
    copy = TEXT.replace('slug = "box"', 'slug = "copy"').replace("id = 200", "id = 300")
    folder_of(tmp_path, copy, slug="copy")
    other = copy.replace('slug = "copy"', 'slug = "other"').replace("id = 201", "id = 301")
    folder_of(tmp_path, other.replace("id = 300", "id = 302"), slug="other")
    database = load_database(tmp_path)
    assert set(database.entries) == {"other"}
    said = {problem.slug: problem.message for problem in database.problems}
    assert "tag36h11 201 is also on copy" in said["box"]
    assert "tag36h11 201 is also on box" in said["copy"]


def test_a_missing_database_is_an_input_error(tmp_path: Path) -> None:
    with pytest.raises(FileInputError, match="cannot be read"):
        load_database(tmp_path / "none")


@settings(max_examples=200, deadline=None)
@given(data=st.data())
def test_damaged_descriptions_load_or_are_refused(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    root = tmp_path_factory.mktemp("damaged")
    folder = folder_of(root)
    text = bytearray(TEXT.encode())
    pieces = [b"nan", b"inf", b'"', b"[", b"[[", b"\n", b"-1", b"1e999", b"true", b"={}", b"\xff"]
    for _ in range(data.draw(st.integers(1, 4))):
        place = data.draw(st.integers(0, len(text)))
        piece = data.draw(st.one_of(st.binary(max_size=3), st.sampled_from(pieces)))
        text[place : place + data.draw(st.integers(0, 8))] = piece
    (folder / "object.toml").write_bytes(text)
    try:
        entry: ObjectEntry = load_object(folder)
    except FileInputError:
        return
    finally:
        shutil.rmtree(root)
    assert all(marker.T_object_marker.is_finite() for marker in entry.markers)
