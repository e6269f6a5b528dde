"""What stands around: sky, ground, light, steelwork, and the hard shadows of a scenario.

Light adds up to at most one, so that white paper does not clip: a share from the sky everywhere,
the rest from the sun, which alone casts shadows.
"""

from __future__ import annotations

from itertools import pairwise

import mujoco
import numpy as np

from sim.solids import SOLID_GROUP
from sim.world import Prop, Shade, Sun, World
from spatial.frames import Frame, Object
from spatial.pose import Pose
from spatial.rotation import Array

LIVE_SHADE_GROUP, TRUE_SHADE_GROUP = 4, 5
"""Geom groups of the painted shadow strips and of the bars that cast true ones."""
SHADE_ALPHA = 0.62
"""How much of the light a painted strip takes."""
SHADE_LIFT_M = 0.001
"""Height of a painted strip above the tags [m]."""
BAR_DISTANCE_M = 0.9
"""Distance of a casting bar from the tags, towards the sun [m]."""
WORKSPACE_M = (0.6, 0.0, 1.2)
"""Middle of what shadows are computed for [m]."""
SHADOW_REACH_M = 1.6
"""Half size of what shadows are computed for [m]: the cable would blur a map of everything."""

_GROUND_M = 30.0
_SLAB_M, _JOINT_M = 1.5, 0.014
_CONCRETE = (0.50, 0.525, 0.545, 0.56)
_JOINT_GREY = 0.30
_DOME_M = 36.0
_DOME_SIDES, _DOME_RINGS = 24, 22
_SKY = ((0.66, 0.72, 0.78), (0.42, 0.52, 0.64))


def add_scenery(spec: mujoco.MjSpec, world: World) -> None:
    """Add sky, ground, light and props to a model."""
    _light(spec, world.sun)
    body = spec.worldbody.add_body(name="scenery")
    for prop in world.props:
        _add_prop(body, prop)
    _ground(spec, body)
    _sky(spec, body)


def add_shades(spec: mujoco.MjSpec, world: World) -> None:
    """Add a world's hard shadows; the objects they lie on are in the model already."""
    places = {placement.slug: placement.T_w_object for placement in world.placements}
    sun = np.array(world.sun.direction) / np.linalg.norm(world.sun.direction)
    for shade in world.shades:
        body = spec.body(f"object/{shade.slug}")
        towards = -places[shade.slug].inverse().rotate(sun)
        strip = shade.T_object_shade @ Pose[Frame, Frame].translated(0.0, 0.0, SHADE_LIFT_M)
        _add_strip(body, shade, strip, half_z=1e-4, group=LIVE_SHADE_GROUP)
        bar: Pose[Object, Frame] = Pose.of(
            shade.T_object_shade.rotation,
            shade.T_object_shade.translation + BAR_DISTANCE_M * towards,
        )
        _add_strip(body, shade, bar, half_z=0.004, group=TRUE_SHADE_GROUP)


def _add_strip(
    body: mujoco.MjsBody, shade: Shade, pose: Pose[Object, Frame], *, half_z: float, group: int
) -> None:
    painted = group == LIVE_SHADE_GROUP
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=pose.translation,
        quat=pose.quaternion_wxyz,
        size=[shade.size_m[0] / 2.0, shade.size_m[1] / 2.0, half_z],
        rgba=[0.0, 0.0, 0.0, SHADE_ALPHA] if painted else [0.25, 0.26, 0.28, 1.0],
        group=group,
        mass=0.0,
    )


def _add_prop(body: mujoco.MjsBody, prop: Prop) -> None:
    kind = mujoco.mjtGeom.mjGEOM_BOX if prop.shape == "box" else mujoco.mjtGeom.mjGEOM_CYLINDER
    size = np.array(prop.size_m) / 2.0
    if prop.shape == "cylinder":
        size = np.array([prop.size_m[0], prop.size_m[1] / 2.0, 0.0])
    body.add_geom(
        name=f"prop/{prop.name}",
        type=kind,
        size=size,
        pos=prop.T_w_prop.translation,
        quat=prop.T_w_prop.quaternion_wxyz,
        rgba=[*prop.color, 1.0],
        contype=1,
        conaffinity=1,
    )


def _light(spec: mujoco.MjSpec, sun: Sun) -> None:
    sky = 1.0 - sun.strength
    spec.visual.headlight.ambient = [0.7 * sky] * 3
    spec.visual.headlight.diffuse = [0.3 * sky] * 3
    spec.visual.headlight.specular = [0.0] * 3
    direction = np.array(sun.direction) / np.linalg.norm(sun.direction)
    spec.worldbody.add_light(
        name="sun",
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=np.array(WORKSPACE_M) - 3.0 * direction,
        dir=direction,
        diffuse=[sun.strength] * 3,
        specular=[0.25] * 3,
        ambient=[0.0] * 3,
        castshadow=True,
    )
    spec.stat.center = WORKSPACE_M
    spec.stat.extent = SHADOW_REACH_M
    spec.visual.map.shadowclip = 1.0


def _ground(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
    """Add a plane to touch, and slabs to see: a texture over all would cost 14 ms an image."""
    count = round(2.0 * _GROUND_M / _SLAB_M)
    starts = np.asarray(_SLAB_M * np.arange(count) - _GROUND_M, dtype=np.float64)
    x, y = np.tile(starts, count), starts.repeat(count)
    shade = np.random.default_rng(7).integers(0, len(_CONCRETE), len(x))
    inset = _SLAB_M - _JOINT_M
    for index, grey in enumerate(_CONCRETE):
        mine = shade == index
        _add_quads(spec, body, f"ground/{index}", x[mine], y[mine], size=(inset, inset), grey=grey)
    joint = np.asarray(starts + inset, dtype=np.float64)
    row = np.full(count, -_GROUND_M)
    for name, px, py, size in (
        ("ground/joints x", joint, row, (_JOINT_M, 2.0 * _GROUND_M)),
        ("ground/joints y", row, joint, (2.0 * _GROUND_M, _JOINT_M)),
    ):
        _add_quads(spec, body, name, px, py, size=size, grey=_JOINT_GREY)
    body.add_geom(
        name="ground",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[_GROUND_M, _GROUND_M, 0.1],
        group=SOLID_GROUP,
        contype=1,
        conaffinity=1,
    )


def _add_quads(
    spec: mujoco.MjSpec,
    body: mujoco.MjsBody,
    name: str,
    x: Array,
    y: Array,
    *,
    size: tuple[float, float],
    grey: float,
) -> None:
    """Add rectangles of one size on the ground, by their low corners x, y (n,) [m]."""
    corners = np.array([[0, 0, 0], [size[0], 0, 0], [size[0], size[1], 0], [0, size[1], 0]])
    vertices = np.stack((x, y, np.zeros_like(x)), axis=-1)[:, None, :] + corners
    faces = 4 * np.arange(len(x))[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])
    spec.add_mesh(
        name=name,
        uservert=vertices.ravel(),
        userface=faces.ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
    )
    body.add_geom(
        name=f"{name}/look",
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=name,
        rgba=[grey, 0.985 * grey, 0.955 * grey, 1.0],
        castshadow=False,  # it has nothing below, and a map this coarse would draw moire on it
        mass=0.0,
    )


def _sky(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
    """Add a dome of plain rings: a sky box costs three times the rest of a live image."""
    around = np.linspace(0.0, 2.0 * np.pi, _DOME_SIDES, endpoint=False)
    up = np.concatenate(([-0.05], np.linspace(0.0, 1.0, _DOME_RINGS + 1) ** 1.8 * np.pi / 2.0))
    horizon, zenith = (np.array(color) for color in _SKY)
    for index, (low, high) in enumerate(pairwise(up)):
        ring = [
            np.stack(
                (np.cos(around) * np.cos(a), np.sin(around) * np.cos(a), 0 * around + np.sin(a))
            )
            for a in (low, high)
        ]
        here = np.arange(_DOME_SIDES)
        there = (here + 1) % _DOME_SIDES
        a, b, c, d = here, there, there + _DOME_SIDES, here + _DOME_SIDES
        inward = np.concatenate((np.stack((a, c, b), -1), np.stack((a, d, c), -1)))
        spec.add_mesh(
            name=f"sky/{index}",
            uservert=_DOME_M * np.concatenate(ring, axis=1).T.ravel(),
            userface=inward.ravel(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
        share = max(0.0, low / (np.pi / 2.0)) ** 0.6
        color = horizon + (zenith - horizon) * share
        spec.add_material(name=f"sky/{index}", rgba=[*color, 1.0], emission=0.62, specular=0.0)
        body.add_geom(
            name=f"sky/{index}",
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=f"sky/{index}",
            material=f"sky/{index}",
            castshadow=False,
            mass=0.0,
        )
