"""A world file: where the crane, the objects and the steelwork of a simulated site stand.

    name = "yard"
    [crane]    tip_m, cable_m, rigging_m, hook_kg, platform_kg, arm_rad
    [sway]     slow_m, slow_hz, fast_m, fast_hz
    [sun]      direction, strength
    [[place]]  slug, translation_m, quaternion_wxyz, free     an object of the database
    [[prop]]   name, shape, size_m, color, translation_m, quaternion_wxyz   scenery, never moves
    [[shade]]  slug, translation_m, quaternion_wxyz, size_m   a hard shadow across an object's tags

All poses are in the plant's world: z up against gravity, z = 0 on the ground, origin below the
crane's tip at rest. A world is truth: nothing outside `sim` reads one.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from scene.table import TableReader, read_toml
from spatial.camera import PinholeCamera
from spatial.frames import Cam, Frame, Object, Tag, W
from spatial.pose import Pose

WORLDS = Path(__file__).parent / "worlds"
"""Folder of the worlds that come with the simulator."""
SHAPES = ("box", "cylinder")
"""Shapes of a prop: a box by its edges x, y, z, a cylinder by radius and length along z."""


class PropFrame(Frame):
    """Frame of a piece of scenery: in its middle."""


@dataclass(frozen=True, slots=True)
class Crane:
    """Cable, rigging and platform: the double pendulum (masses are assumed, not published)."""

    tip_m: float = 11.2
    """Height of the crane's tip above the ground [m]."""
    cable_m: float = 8.0
    """Crane cable, tip to crane hook [m]."""
    rigging_m: float = 1.0
    """Rigging, crane hook to the platform's frame [m]."""
    hook_kg: float = 3.0
    """Crane hook and shackle [kg]."""
    platform_kg: float = 45.0
    """Platform with propellers and winches, where the robot's description does not say [kg]."""
    arm_rad: tuple[float, ...] = (0.0, 0.6, 0.0, -1.4, 0.0, 1.1, 0.0)
    """Joint positions at the start (7,) [rad], in the order A1 A2 E1 A3 A4 A5 A6."""


@dataclass(frozen=True, slots=True)
class Sway:
    """How far wind and crane push the damped platform about, at any time."""

    slow_m: float = 0.05
    """Amplitude of the swing of the cable [m]."""
    slow_hz: float = 0.16
    """Its frequency [Hz]."""
    fast_m: float = 0.01
    """Amplitude of the rocking of the platform [m]."""
    fast_hz: float = 1.2
    """Its frequency [Hz]."""


@dataclass(frozen=True, slots=True)
class Sun:
    """The light that casts shadows."""

    direction: tuple[float, float, float] = (-0.35, 0.45, -0.82)
    """Where its rays go (3,)."""
    strength: float = 0.6
    """Share of the light in [0, 1]; the rest is the sky's."""


@dataclass(frozen=True, slots=True, eq=False)
class Placement:
    """One object of the database in the world."""

    slug: str
    """Name in the database."""
    T_w_object: Pose[W, Object]
    """Pose at the start."""
    free: bool = False
    """Whether it can be moved by contact; else it is fixed."""


@dataclass(frozen=True, slots=True, eq=False)
class Prop:
    """A piece of scenery; free objects stand on it."""

    name: str
    """Unique in the world."""
    shape: str
    """One of `SHAPES`."""
    size_m: tuple[float, ...]
    """Box: edges x, y, z [m]. Cylinder: radius, length [m]."""
    color: tuple[float, float, float]
    """Red, green, blue in [0, 1]."""
    T_w_prop: Pose[W, PropFrame]
    """Pose of its middle."""


@dataclass(frozen=True, slots=True, eq=False)
class Shade:
    """A hard shadow: live a dark translucent strip, in lock-step a bar that casts it."""

    slug: str
    """Object whose tags it crosses."""
    T_object_shade: Pose[Object, Frame]
    """Pose of the strip's middle in the object; the strip lies in x y, just above the tags."""
    size_m: tuple[float, float]
    """Edges x, y of the strip [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """Everything of the simulated site that is not the robot."""

    name: str
    """Name of the world."""
    placements: tuple[Placement, ...]
    """Objects."""
    props: tuple[Prop, ...] = ()
    """Scenery."""
    shades: tuple[Shade, ...] = ()
    """Hard shadows."""
    crane: Crane = field(default_factory=Crane)
    """Crane, cable and platform."""
    sway: Sway = field(default_factory=Sway)
    """Disturbance of the platform."""
    sun: Sun = field(default_factory=Sun)
    """Light."""


@dataclass(frozen=True, slots=True, eq=False)
class TrueCamera:
    """A camera as it really is; the site file holds what the station believes."""

    intrinsics: PinholeCamera
    """Intrinsics, distortion included."""
    parent: str
    """`tcp` or `base`."""
    T_parent_cam: Pose[Frame, Cam]
    """Mount."""


@dataclass(frozen=True, slots=True, eq=False)
class TrueMarker:
    """Where a marker really sits on its object."""

    slug: str
    """The object."""
    key: tuple[str, int]
    """Family and id."""
    T_object_marker: Pose[Object, Tag]
    """Mount."""


def load_world(name: str, *, folder: Path = WORLDS) -> World:
    """Return the world of file `folder/name.toml`.

    Raises:
        FileInputError: no such file, or a key that is missing, unknown or out of range.
    """
    path = folder / f"{name}.toml"
    reader = TableReader(read_toml(path), path=path, key="")
    world = World(
        name=reader.text("name"),
        placements=tuple(_placement(r) for r in reader.tables("place")),
        props=tuple(_prop(r) for r in reader.tables("prop")),
        shades=tuple(_shade(r) for r in reader.tables("shade")),
        crane=_crane(reader.table("crane", optional=True)),
        sway=_sway(reader.table("sway", optional=True)),
        sun=_sun(reader.table("sun", optional=True)),
    )
    reader.finish()
    return world


def _crane(reader: TableReader) -> Crane:
    d = Crane()
    crane = Crane(
        tip_m=reader.number("tip_m", default=d.tip_m, above=0.0),
        cable_m=reader.number("cable_m", default=d.cable_m, above=0.0),
        rigging_m=reader.number("rigging_m", default=d.rigging_m, above=0.0),
        hook_kg=reader.number("hook_kg", default=d.hook_kg, above=0.0),
        platform_kg=reader.number("platform_kg", default=d.platform_kg, above=0.0),
        arm_rad=reader.numbers("arm_rad", 7, default=d.arm_rad),
    )
    reader.finish()
    return crane


def _sway(reader: TableReader) -> Sway:
    d = Sway()
    sway = Sway(
        slow_m=reader.number("slow_m", default=d.slow_m, least=0.0),
        slow_hz=reader.number("slow_hz", default=d.slow_hz, above=0.0),
        fast_m=reader.number("fast_m", default=d.fast_m, least=0.0),
        fast_hz=reader.number("fast_hz", default=d.fast_hz, above=0.0),
    )
    reader.finish()
    return sway


def _sun(reader: TableReader) -> Sun:
    d = Sun()
    x, y, z = reader.numbers("direction", 3, default=d.direction)
    sun = Sun(direction=(x, y, z), strength=reader.number("strength", default=d.strength, least=0))
    reader.finish()
    return sun


def _placement(reader: TableReader) -> Placement:
    placement = Placement(
        slug=reader.text("slug"),
        free=reader.flag("free", default=False),
        T_w_object=reader.pose(),
    )
    reader.finish()
    return placement


def _prop(reader: TableReader) -> Prop:
    shape = reader.choice("shape", SHAPES)
    red, green, blue = reader.numbers("color", 3, default=(0.45, 0.47, 0.5))
    prop = Prop(
        name=reader.text("name"),
        shape=shape,
        size_m=reader.numbers("size_m", 3 if shape == "box" else 2),
        color=(red, green, blue),
        T_w_prop=reader.pose(),
    )
    reader.finish()
    return prop


def _shade(reader: TableReader) -> Shade:
    x, y = reader.numbers("size_m", 2)
    shade = Shade(slug=reader.text("slug"), T_object_shade=reader.pose(), size_m=(x, y))
    reader.finish()
    return shade
