from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from scene.database import Database
from scene.entry import ObjectEntry
from scene.mesh import box_mesh
from scene.robot import Robot, load_robot
from scene.site import DEFAULT_SITE, Site, load_site
from sim.plant import Plant
from sim.world import Crane, Placement, Prop, Shade, Sway, TrueMarker, World
from spatial.camera import PinholeCamera
from spatial.frames import Object, W
from spatial.marker import Marker
from spatial.pose import Pose
from spatial.rotation import exp_so3

ROBOT = DEFAULT_SITE.parents[1] / "robots" / "sam" / "robot.urdf"
ARM_RAD = (0.0, 0.11, 0.0, 1.83, 0.0, 1.33, 0.0)
BOARD = "board"
TAG_M = 0.08


@cache
def _robot(*, looks: bool) -> Robot:
    return load_robot(ROBOT, visuals=looks)


@cache
def _board() -> ObjectEntry:
    """A light grey board with four tags."""
    markers = tuple(
        Marker("tag36h11", 500 + i, TAG_M, Pose.translated(x, y, 0.01))
        for i, (x, y) in enumerate([(-0.09, 0.09), (0.09, 0.09), (0.09, -0.09), (-0.09, -0.09)])
    )
    return ObjectEntry(
        slug=BOARD,
        name="Board",
        revision=1,
        sha256="",
        folder=Path(),
        mesh_path=Path(),
        mesh=box_mesh(np.array([0.36, 0.36, 0.02])),
        color=(180, 184, 190),
        opacity=1.0,
        mass_kg=1.5,
        motion="static",
        markers=markers,
        target=markers[0].key,
        frames={},
        fixtures=(),
        diameter_m=0.5,
        symmetry_axis=None,
    )


def _site(*, hc: PinholeCamera | None = None) -> Site:
    """The site as shipped, with another hand-eye camera where one is given."""
    shipped = load_site(DEFAULT_SITE)
    if hc is None:
        return shipped
    cameras = {**shipped.cameras, "hc": replace(shipped.cameras["hc"], intrinsics=hc)}
    return replace(shipped, cameras=cameras)


def _make_plant(
    *,
    looks: bool = False,
    seed: int = 1,
    sway: Sway | None = None,
    board_at: Pose[W, Object] | None = None,
    free: bool = False,
    props: tuple[Prop, ...] = (),
    shades: tuple[Shade, ...] = (),
    hc: PinholeCamera | None = None,
    markers: tuple[TrueMarker, ...] = (),
) -> Plant:
    world = World(
        name="test",
        placements=() if board_at is None else (Placement(BOARD, board_at, free),),
        props=props,
        shades=shades,
        crane=replace(Crane(), arm_rad=ARM_RAD),
        sway=Sway() if sway is None else sway,
    )
    database = Database(Path(), {BOARD: _board()}, ())
    return Plant(
        _site(hc=hc), _robot(looks=looks), database, world=world, markers=markers, seed=seed
    )


@pytest.fixture
def make_plant() -> Callable[..., Plant]:
    """Make a plant with a board of four tags where the test wants it."""
    return _make_plant


@pytest.fixture
def robot() -> Robot:
    return _robot(looks=False)


@pytest.fixture
def board() -> ObjectEntry:
    return _board()


@pytest.fixture
def board_in_view() -> Pose[W, Object]:
    """Pose of the board where the hand-eye camera looks at the start."""
    return Pose.of(exp_so3([0.12, -0.35, 0.3]), (0.74, -0.02, 0.70))
