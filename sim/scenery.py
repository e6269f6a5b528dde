"""What stands around: sky, ground, light, steelwork, and the hard shadows of a scenario.

Light adds up to at most one, so that white paper does not clip: a share from the sky everywhere,
the rest from the sun, which alone casts shadows.
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.paint import Paints
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
_TILE_PX = 512
_TILE_M = 2.0
_SKY = ((0.66, 0.72, 0.78), (0.42, 0.52, 0.64))


def add_scenery(spec: mujoco.MjSpec, paints: Paints, world: World) -> None:
    """Add sky, ground, light and props to a model."""
    _light(spec, world.sun)
    _sky(spec)
    tile = paints.add_tile("ground", _concrete(), repeat=2.0 * _GROUND_M / _TILE_M)
    spec.worldbody.add_geom(
        name="ground",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[_GROUND_M, _GROUND_M, 0.1],
        material=tile,
        contype=1,
        conaffinity=1,
    )
    for prop in world.props:
        _add_prop(spec, prop)


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


def _add_prop(spec: mujoco.MjSpec, prop: Prop) -> None:
    kind = mujoco.mjtGeom.mjGEOM_BOX if prop.shape == "box" else mujoco.mjtGeom.mjGEOM_CYLINDER
    size = np.array(prop.size_m) / 2.0
    if prop.shape == "cylinder":
        size = np.array([prop.size_m[0], prop.size_m[1] / 2.0, 0.0])
    spec.worldbody.add_geom(
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


def _sky(spec: mujoco.MjSpec) -> None:
    horizon, zenith = _SKY
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=horizon,
        rgb2=zenith,
        width=128,
        height=768,
    )


def _concrete() -> NDArray[np.uint8]:
    """Return a tile of concrete slabs (h, w, 3): smooth stains, fine grain, joints at its edge."""
    rng = np.random.default_rng(7)
    stains = sum((_smooth(rng, cells) * gain for cells, gain in ((4, 9.0), (16, 5.0))), 0.0)
    grey = 132.0 + stains + rng.normal(0.0, 4.0, (_TILE_PX, _TILE_PX))
    joint = np.minimum(np.arange(_TILE_PX), np.arange(_TILE_PX)[::-1]) < 3
    grey[joint, :] -= 34.0
    grey[:, joint] -= 34.0
    tinted = grey[:, :, None] * np.array([1.0, 0.985, 0.955])
    return np.asarray(np.clip(tinted, 0.0, 255.0), dtype=np.uint8)


def _smooth(rng: np.random.Generator, cells: int) -> Array:
    """Return noise (h, w) of some cells per side that repeats at the tile's edge."""
    spectrum = np.zeros((_TILE_PX, _TILE_PX), np.complex128)
    low = np.fft.fft2(rng.normal(0.0, 1.0, (cells, cells)))
    index = np.fft.fftfreq(cells, 1.0 / cells).astype(int)
    spectrum[np.ix_(index, index)] = low * (_TILE_PX / cells) ** 2
    return np.asarray(np.fft.ifft2(spectrum).real)
