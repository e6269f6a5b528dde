from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from scene.database import Database, load_database
from scene.robot import Robot, load_robot
from scene.site import DEFAULT_SITE, Site, load_site
from sim.plant import Plant
from sim.render import Renderer
from sim.world import load_world
from spatial.errors import FileInputError, InputError

Shipped = tuple[Site, Robot, Database]


@pytest.fixture(scope="module")
def shipped() -> Shipped:
    site = load_site(DEFAULT_SITE)
    return site, load_robot(site.robot), load_database(site.objects_dir)


def write(folder: Path, text: str) -> Path:
    (folder / "w.toml").write_text(text)
    return folder


def test_the_yard_holds_every_object_of_the_site(shipped: Shipped) -> None:
    site, _, _ = shipped
    placed = {placement.slug for placement in load_world("yard").placements}
    assert {entry.slug for entry in site.objects} <= placed


def test_at_the_start_each_camera_reads_tags_of_its_objects(shipped: Shipped) -> None:
    site, robot, database = shipped
    plant = Plant(site, robot, database, world=load_world("yard"))
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    detector = cv2.aruco.ArucoDetector(dictionary)
    for camera in site.cameras:
        with Renderer(plant, camera) as renderer:
            grey = cv2.cvtColor(renderer.render(), cv2.COLOR_RGB2GRAY)
        _, found, _ = detector.detectMarkers(grey)
        seen = set(np.array(found).ravel().tolist())
        for entry in site.objects:
            if entry.camera == camera:
                tags = {marker.id for marker in database.entry(entry.slug).markers}
                assert seen & tags, entry.slug


def test_free_objects_rest_and_nothing_touches_the_robot(shipped: Shipped) -> None:
    site, robot, database = shipped
    plant = Plant(site, robot, database, world=load_world("yard"))
    before = plant.truth()["object/cage"].translation
    for _ in range(500):
        plant.step()
    assert np.linalg.norm(plant.truth()["object/cage"].translation - before) < 1e-3
    assert np.linalg.norm(plant.wrench()[0]) == 0.0


def test_a_world_file_is_read_strictly(tmp_path: Path) -> None:
    with pytest.raises(FileInputError, match="cannot be read"):
        load_world("nowhere", folder=tmp_path)
    with pytest.raises(FileInputError, match=r"unknown key 'cabel_m'.*key crane.cabel_m"):
        load_world("w", folder=write(tmp_path, 'name = "w"\n[crane]\ncabel_m = 8.0\n'))
    text = 'name = "w"\n[[prop]]\nname = "p"\nshape = "cone"\nsize_m = [1, 1, 1]\n'
    with pytest.raises(FileInputError, match="unknown shape 'cone'; available: box, cylinder"):
        load_world("w", folder=write(tmp_path, text))


def test_a_placed_object_must_exist(tmp_path: Path, shipped: Shipped) -> None:
    site, robot, database = shipped
    folder = write(tmp_path, 'name = "w"\n[[place]]\nslug = "unicorn"\n')
    with pytest.raises(InputError, match="unknown object 'unicorn'; available: cage"):
        Plant(site, robot, database, world=load_world("w", folder=folder))
