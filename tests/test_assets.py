"""What comes with the program: complete, loadable, true to size, and made by its generator."""

from __future__ import annotations

import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import scipy.spatial
import trimesh

from assets.generate import objects as object_generator
from assets.generate import robot as robot_generator
from scene.database import Database, load_database
from scene.marker_image import marker_pixels, side_cells
from scene.robot import load_robot

ASSETS = Path(__file__).parents[1] / "assets"
SLUGS = (
    "cage",
    "calibration_board",
    "crawler",
    "hole_plate",
    "hook",
    "peg",
    "pipe",
    "valve_wheel",
)


@pytest.fixture(scope="module")
def database() -> Database:
    return load_database(ASSETS / "objects")


def test_every_asset_folder_is_complete_and_loads(database: Database) -> None:
    assert not database.problems
    assert tuple(sorted(database.entries)) == SLUGS
    for folder in [*(ASSETS / "objects").iterdir(), *(ASSETS / "robots").iterdir()]:
        assert {"LICENSE", "README.md"} <= {path.name for path in folder.iterdir()}, folder
    for description in (ASSETS / "robots").glob("*/robot.urdf"):
        assert not load_robot(description).warnings


def test_the_generator_makes_the_committed_bytes(tmp_path: Path) -> None:
    object_generator.make(tmp_path / "objects")
    robot_generator.make(tmp_path / "robots" / "sam")
    made = [path for path in tmp_path.rglob("*") if path.is_file()]
    assert len(made) > 30
    for path in made:
        committed = ASSETS / path.relative_to(tmp_path)
        assert committed.read_bytes() == path.read_bytes(), f"{committed} is not what it makes"


def test_meshes_are_light(database: Database) -> None:
    assert max(len(entry.mesh.faces) for entry in database.entries.values()) <= 8000
    sam = load_robot(ASSETS / "robots" / "sam" / "robot.urdf")
    assert max(len(visual.mesh.faces) for visual in sam.visuals) < 2000


def test_dimensions_are_those_of_the_scenarios(database: Database) -> None:
    size = {slug: entry.extents_m for slug, entry in database.entries.items()}
    np.testing.assert_allclose(size["hole_plate"][:2], 0.3, atol=1e-3)
    np.testing.assert_allclose(size["pipe"][0], 2.0, atol=1e-3)
    np.testing.assert_allclose(size["cage"][:2], (0.4, 0.3), atol=0.032)
    np.testing.assert_allclose(size["crawler"], (0.3, 0.2, 0.15), atol=0.025)
    assert database.entries["crawler"].mass_kg == 6.4
    steel = next(p for p in database.entries["pipe"].mesh.parts if p.name == "paint")
    radius = np.hypot(steel.vertices[:, 1], steel.vertices[:, 2]).max()
    assert np.isclose(2 * radius, 0.273, atol=1e-5)
    plate = database.entries["hole_plate"].mesh.without("tag")
    near = np.hypot(plate.vertices[:, 0], plate.vertices[:, 1]) < 0.0246
    hole = plate.vertices[near & (plate.vertices[:, 2] > -0.09)]
    np.testing.assert_allclose(np.hypot(hole[:, 0], hole[:, 1]), 0.0245, atol=1e-5)


def test_a_seated_cage_touches_the_pipe_and_does_not_enter_it(database: Database) -> None:
    cage, pipe = database.entries["cage"], database.entries["pipe"]
    T_pipe_cage = pipe.frames["seat"].T_object_frame @ (
        cage.frames["saddle"].T_object_frame.inverse()
    )
    parts = [part for part in cage.mesh.parts if not part.name.startswith("tag")]
    radii = []
    for part in parts:
        points = T_pipe_cage.apply(part.vertices)
        corners = points[part.faces][:, :, 1:]
        radii.append(_segment_distance(corners).min())
    assert abs(min(radii) - 0.1365) < 0.0005


def _segment_distance(triangles: np.ndarray) -> np.ndarray:
    """Return the distance of the edges of triangles (n, 3, 2) from the origin."""
    start, end = triangles, np.roll(triangles, -1, axis=1)
    way = end - start
    length = np.maximum((way**2).sum(axis=-1), 1e-18)
    share = np.clip(-(start * way).sum(axis=-1) / length, 0.0, 1.0)
    return np.asarray(np.linalg.norm(start + share[..., None] * way, axis=-1))


def test_the_hook_fits_under_the_handle(database: Database) -> None:
    cage = database.entries["cage"]
    grasp = cage.frames["grasp"].T_object_frame
    np.testing.assert_allclose(grasp.translation, (0, 0, 0.125 + 0.18 - 0.01), atol=1e-9)
    np.testing.assert_allclose(grasp.rotation[:, 2], (0, 0, -1), atol=1e-7)
    sam = load_robot(ASSETS / "robots" / "sam" / "robot.urdf")
    tool = next(visual for visual in sam.visuals if visual.link == "tool").mesh
    poses = sam.fk({})
    points = (poses["tcp"].inverse() @ poses["tool"]).apply(tool.vertices)
    bar_distance = np.hypot(points[:, 0], points[:, 2] + 0.01)
    assert bar_distance.min() > 0.01 - 1e-3, "no part of the tool is where the bar is"
    assert np.isclose(bar_distance.min(), 0.01, atol=1e-3), "the bar lies in the bowl"


def test_no_convex_piece_fills_the_handle(database: Database) -> None:
    """Physics takes hulls of connected pieces: none may close the way of the hook."""
    mesh = database.entries["cage"].mesh
    whole = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    whole.merge_vertices()
    way = np.array([(x, 0.0, z) for x in (-0.06, 0.0, 0.06) for z in (0.16, 0.2, 0.26)])
    for piece in whole.split(only_watertight=False):
        if np.ptp(piece.vertices, axis=0).min() > 1e-4:
            planes = scipy.spatial.ConvexHull(piece.vertices).equations
            inside = (way @ planes[:, :3].T + planes[:, 3] < 0).all(axis=1)
            assert not inside.any(), piece.bounds


def test_markers_are_real_and_as_drawn(database: Database) -> None:
    for entry in database.entries.values():
        for marker in entry.markers:
            part = next(p for p in entry.mesh.parts if p.name == f"tag_{marker.id}")
            cells = side_cells(marker.family)
            edge = marker.size_m * (cells + 2) / cells
            local = marker.T_object_marker.inverse().apply(part.vertices)
            np.testing.assert_allclose(local[:, 2], 0.0, atol=1e-6)
            np.testing.assert_allclose(np.abs(local[:, :2]), edge / 2, atol=1e-6)
            texture, uv = part.material.texture, part.uv
            assert texture is not None
            assert uv is not None
            np.testing.assert_allclose(uv, local[:, :2] / edge + 0.5, atol=1e-4)
            np.testing.assert_array_equal(texture[..., 0], marker_pixels("tag36h11", marker.id))


def test_marker_pictures_are_what_a_detector_reads() -> None:
    picture = np.pad(marker_pixels("tag36h11", 123), 40, constant_values=255)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    corners, ids, _ = cv2.aruco.ArucoDetector(dictionary).detectMarkers(picture)
    assert ids is not None
    assert ids.ravel().tolist() == [123]
    first, last = 40 + 16, 40 + 16 + 8 * 16 - 1
    square = [(first, first), (last, first), (last, last), (first, last)]
    np.testing.assert_allclose(corners[0][0], square, atol=1.0)


def test_the_plate_shows_all_its_tags_on_one_face(database: Database) -> None:
    markers = database.entries["hole_plate"].markers
    assert len(markers) == 5
    for marker in markers:
        np.testing.assert_allclose(marker.T_object_marker.rotation[:, 2], (0, 0, 1), atol=1e-9)
        assert 0.06 <= marker.size_m <= 0.08


@pytest.mark.parametrize("slug", ["cage", "pipe", "crawler", "peg", "hook", "valve_wheel"])
def test_other_things_carry_tags_on_several_faces(database: Database, slug: str) -> None:
    rotations = [marker.T_object_marker.rotation for marker in database.entries[slug].markers]
    normals = {tuple(np.round(rotation[:, 2], 2) + 0.0) for rotation in rotations}
    assert len(normals) >= 3


def test_tags_do_not_overlap(database: Database) -> None:
    for entry in database.entries.values():
        for i, one in enumerate(entry.markers):
            for other in entry.markers[i + 1 :]:
                local = one.T_object_marker.inverse().apply(other.corners_object)
                flat = np.abs(local[:, 2]).max() < 1e-3
                reach = 0.5 * one.size_m
                inside = (np.abs(local[:, :2]) < reach).all(axis=1).any()
                assert not (flat and inside), (entry.slug, one.id, other.id)


def test_descriptions_name_no_place_of_a_machine() -> None:
    for path in [*ASSETS.rglob("*.toml"), *ASSETS.rglob("*.urdf"), *ASSETS.rglob("*.md")]:
        assert not re.search(r"(/home/|/work/|/root/|/tmp/|https?://)", path.read_text()), path


def test_fixtures_let_the_tool_reach_the_goal(database: Database) -> None:
    goals = {"cage": ("grasp", "below", "beside", "above"), "hole_plate": ("hole_axis",)}
    for slug, names in goals.items():
        entry = database.entries[slug]
        for name in names:
            goal = entry.frames[name].T_object_frame.translation
            for fixture in entry.fixtures:
                if fixture.enabled:
                    assert fixture.clearance([goal])[0] > -1e-6, (slug, name, fixture.name)
