"""Meshes: what is accepted, what is refused, and that a round trip loses nothing."""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scene.glb import to_glb
from scene.marker_image import marker_pixels
from scene.mesh import (
    Material,
    MeshData,
    MeshPart,
    box_mesh,
    cylinder_mesh,
    load_mesh,
    sphere_mesh,
)
from spatial.errors import FileInputError

TRIANGLE = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0)], np.float64)


def stl(triangles: np.ndarray) -> bytes:
    layout = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("extra", "<u2")])
    rows = np.zeros(len(triangles), layout)
    rows["corners"] = triangles
    return b"binary".ljust(80, b" ") + struct.pack("<I", len(rows)) + rows.tobytes()


def glb(change: Any = None) -> bytes:
    """Return a valid GLB of a box, its JSON changed by `change`."""
    data = to_glb(box_mesh(np.array([1.0, 2.0, 3.0])))
    if change is None:
        return data
    (length,) = struct.unpack_from("<I", data, 12)
    tree = json.loads(data[20 : 20 + length])
    change(tree)
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    head = struct.pack("<4sIIII", b"glTF", 2, 20 + len(text) + len(rest), len(text), 0x4E4F534A)
    return head + text + rest


def loaded(folder: Path, name: str, data: bytes | str) -> MeshData:
    path = folder / name
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    return load_mesh(path)


def refused(folder: Path, name: str, data: bytes | str) -> str:
    with pytest.raises(FileInputError) as caught:
        loaded(folder, name, data)
    assert str(caught.value).endswith(f"{name})"), "the path comes last"
    return str(caught.value)


def test_primitives_have_their_extents() -> None:
    np.testing.assert_allclose(box_mesh(np.array([1, 2, 3])).extents_m, (1, 2, 3))
    np.testing.assert_allclose(cylinder_mesh(0.5, 2).extents_m, (1, 1, 2))
    np.testing.assert_allclose(sphere_mesh(0.5).extents_m, (1, 1, 1), rtol=0.02)
    assert box_mesh(np.ones(3)).watertight


def test_a_glb_comes_back_as_it_was_written(tmp_path: Path) -> None:
    pixels = np.repeat(marker_pixels("tag36h11", 5)[..., None], 3, axis=2)
    orange = Material(color=(236, 106, 28, 255), metallic=0.25, roughness=0.4)
    dark = Material(color=(9, 11, 14, 128))
    parts = (
        MeshPart("shell", TRIANGLE, np.array([(0, 1, 2)]), orange),
        MeshPart("seam", TRIANGLE + 1, np.array([(0, 1, 2)]), dark),
        MeshPart(
            "tag_5", TRIANGLE, np.array([(0, 1, 2)]), Material(texture=pixels), uv=TRIANGLE[:, :2]
        ),
    )
    mesh = loaded(tmp_path, "m.glb", to_glb(MeshData.of(parts)))
    by_name = {part.name: part for part in mesh.parts}
    assert set(by_name) == {"shell", "seam", "tag_5"}
    shell = by_name["shell"].material
    assert (shell.color, shell.metallic, shell.roughness) == (orange.color, 0.25, 0.4)
    assert by_name["seam"].material.color == dark.color
    texture = by_name["tag_5"].material.texture
    assert texture is not None
    np.testing.assert_array_equal(texture, pixels)
    uv = by_name["tag_5"].uv
    assert uv is not None
    np.testing.assert_allclose(uv, TRIANGLE[:, :2], atol=1e-7)
    assert {part.name for part in mesh.without("tag_").parts} == {"shell", "seam"}


def test_the_same_mesh_makes_the_same_bytes_and_says_where_up_is() -> None:
    data = glb()
    assert data == glb()
    (length,) = struct.unpack_from("<I", data, 12)
    extras = json.loads(data[20 : 20 + length])["scenes"][0]["extras"]
    assert extras["up"] == "Z"
    assert extras["units"] == "m"


def test_sharp_edges_stay_sharp_and_round_ones_are_smooth(tmp_path: Path) -> None:
    box = loaded(tmp_path, "box.glb", to_glb(box_mesh(np.ones(3))))
    normals = box.parts[0].normals
    assert normals is not None
    assert np.isclose(np.abs(normals), 1.0).any(axis=1).all()
    ball = loaded(tmp_path, "ball.glb", to_glb(sphere_mesh(1.0))).parts[0]
    assert ball.normals is not None
    np.testing.assert_allclose(ball.normals, ball.vertices, atol=0.02)


def test_mirroring_keeps_the_outside_outside() -> None:
    mesh = box_mesh(np.ones(3)).scaled(np.array([-1.0, 1.0, 2.0]))
    corners = mesh.vertices[mesh.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.einsum("ij,ij->i", normals, corners.mean(axis=1)) > 0).all()
    np.testing.assert_allclose(mesh.extents_m, (1, 1, 2))


def test_every_format_loads(tmp_path: Path) -> None:
    assert len(loaded(tmp_path, "a.stl", stl(TRIANGLE[None])).faces) == 1
    assert len(loaded(tmp_path, "a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 -1\n").faces) == 1
    head = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
    head += "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
    assert len(loaded(tmp_path, "a.ply", head + "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n").faces) == 1
    assert len(loaded(tmp_path, "a.glb", glb()).faces) == 12


def test_a_closed_surface_is_found_even_where_corners_are_not_shared(tmp_path: Path) -> None:
    box = box_mesh(np.ones(3))
    soup = box.vertices[box.faces]
    assert loaded(tmp_path, "a.stl", stl(soup)).watertight
    assert loaded(tmp_path, "a.glb", to_glb(box)).watertight
    assert not loaded(tmp_path, "b.stl", stl(soup[:-1])).watertight


@pytest.mark.parametrize(
    ("name", "data", "said"),
    [
        ("a.stl", b"", "0 bytes"),
        ("a.stl", stl(TRIANGLE[None])[:-3], "134"),
        ("a.stl", stl(np.zeros((0, 3, 3))), "no triangle"),
        ("a.stl", stl(np.full((1, 3, 3), np.nan)), "not finite"),
        ("a.stl", b"\x89PNG\r\n\x1a\n" + b"\0" * 200, "binary STL"),
        ("a.stl", "solid x\nfacet normal 0 0 1\nouter loop\nvertex nan 0 0\n", "line 4"),
        ("a.obj", "v 0 0 0\nv 1 0 inf\nv 0 1 0\nf 1 2 3\n", "line 2"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", "line 4"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "vertices are 1 to 3"),
        ("a.obj", "usemtl a\n" * 5000 + "v 0 0 0\n", "changes of material"),
        ("a.obj", "v 0 0 0\np 1\n", "no triangle"),
        (
            "a.ply",
            b"ply\nformat binary_little_endian 1.0\nelement vertex 999999\nend_header\n",
            "claim",
        ),
        ("a.dae", "<!DOCTYPE x [<!ENTITY a 'b'>]><COLLADA/>", "document type"),
        ("a.glb", b"", "glTF"),
        ("a.glb", b"PK\x03\x04" + b"\0" * 100, "expected b'glTF'"),
        ("a.glb", glb()[:-40], "bytes"),
        ("a.zip", b"PK", "unknown mesh format"),
    ],
)
def test_bad_files_say_what_is_wrong(tmp_path: Path, name: str, data: bytes, said: str) -> None:
    assert said in refused(tmp_path, name, data)


def _many(tree: Any) -> None:
    tree["accessors"][0]["count"] = 400_000_000


def _outside(tree: Any) -> None:
    tree["buffers"][0]["uri"] = "http://example.invalid/a.bin"


def _index(tree: Any) -> None:
    tree["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = 99


def _circle(tree: Any) -> None:
    tree["nodes"][0]["children"] = [0]


def _nan(tree: Any) -> None:
    tree["nodes"][0]["translation"] = [0.0, float("nan"), 0.0]


def _deep(tree: Any) -> None:
    tree["nodes"] += [{"children": [i + 2]} for i in range(60)] + [{}]


@pytest.mark.parametrize("change", [_many, _outside, _index, _circle, _nan, _deep])
def test_a_glb_that_lies_is_refused(tmp_path: Path, change: Any) -> None:
    refused(tmp_path, "a.glb", glb(change))


def test_a_missing_file_is_an_input_error(tmp_path: Path) -> None:
    with pytest.raises(FileInputError, match="cannot be read"):
        load_mesh(tmp_path / "none.glb")


GOOD = {
    "a.stl": stl(np.stack([TRIANGLE, TRIANGLE + 1])),
    "a.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nvn 0 0 1\nf 1//1 2//1 3//1\n",
    "a.glb": glb(),
}


@settings(max_examples=120, deadline=None)
@given(
    name=st.sampled_from(sorted(GOOD)),
    edits=st.lists(st.tuples(st.integers(0, 4000), st.binary(max_size=6)), max_size=4),
    cut=st.integers(0, 4000),
)
def test_damaged_files_load_well_or_are_refused(
    tmp_path_factory: pytest.TempPathFactory,
    name: str,
    edits: list[tuple[int, bytes]],
    cut: int,
) -> None:
    data = bytearray(GOOD[name])
    for place, piece in edits:
        data[place : place + len(piece)] = piece
    data = data[: len(data) - cut if cut < 200 else len(data)]
    path = tmp_path_factory.mktemp("damaged") / name
    path.write_bytes(data)
    try:
        mesh = load_mesh(path)
    except FileInputError:
        return
    assert len(mesh.faces)
    assert np.isfinite(mesh.vertices).all()
    assert mesh.faces.min() >= 0
    assert mesh.faces.max() < len(mesh.vertices)
    assert len(mesh.face_colors) == len(mesh.faces)
