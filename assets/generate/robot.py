"""Writes `assets/robots/sam`: a KUKA LWR 4+ under a suspended platform, as URDF with meshes.

Kinematics and limits are the published ones (0.11 + 0.2005 | 0.20 + 0.20 | 0.20 + 0.19 | 0.078 m,
axes z -y z +y z -y z; torques and speeds of the data sheet). Masses of the arm are a total of
16 kg in capsules; those of platform and tool are assumed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from assets.generate import arm, platform
from assets.generate.shapes import Array
from scene.glb import to_glb
from scene.mesh import MeshData

TOOL_LENGTH = 0.25
TIMES_DEG = np.pi / 180.0
JOINTS = (
    # name, offset z, axis, limit deg, torque Nm, speed deg/s
    ("A1", 0.11, (0, 0, 1), 170, 176, 110),
    ("A2", 0.2005, (0, -1, 0), 120, 176, 110),
    ("E1", 0.20, (0, 0, 1), 170, 100, 128),
    ("A3", 0.20, (0, 1, 0), 120, 100, 128),
    ("A4", 0.20, (0, 0, 1), 170, 100, 204),
    ("A5", 0.19, (0, -1, 0), 120, 38, 184),
    ("A6", 0.078, (0, 0, 1), 170, 38, 184),
)
README = """# SAM: a KUKA LWR 4+ below a suspended platform

Root link `platform` (x forward, z up); the arm hangs below it, its `base` turned upside down.
Joints `A1 A2 E1 A3 A4 A5 A6` with the published kinematics (flange 1.1785 m above the base at
zero), limits, torques and speeds. Frames others rely on:

| link | what |
|---|---|
| `tcp` | inner bottom of the J-hook, z along the tool; the hook opens towards +x |
| `hc` | optical frame of the hand-eye camera, beside the tool, looking along it |
| `mako` | optical frame of the eye-to-hand camera, at the platform's front, looking down ahead |

The arm weighs 16 kg, spread over capsules; platform (45 kg) and tool (3 kg) are assumed. Meshes
are glTF, metres, Z up, below 2000 faces a link; shapes are our own after published dimensions.

Made by `python -m assets.generate`; licence: MIT, as the project. KUKA is a trademark of its
owner, who has no part in this.
"""
MAKO_XYZ, MAKO_AIM = (0.36, 0.2, -0.115), (0.6, 0.0, -1.15)
"""Place of the eye-to-hand camera and what it looks at, in the platform's frame [m]."""


@dataclass(frozen=True, slots=True)
class Mass:
    """Mass of a link, spread over a capsule, box or cylinder."""

    kilograms: float
    """Mass [kg]."""
    centre: tuple[float, float, float]
    """Centre of mass in the link [m]."""
    inertia: tuple[float, float, float]
    """Principal moments about it, along the link's axes [kg m^2]."""


@dataclass(frozen=True, slots=True)
class Link:
    """A link to write."""

    name: str
    """Its name."""
    mesh: str | None = None
    """Name of its mesh file without ending."""
    mass: Mass | None = None
    """Its mass."""
    solids: Sequence[str] = field(default=())
    """Collision elements, as text."""


def make(folder: Path) -> None:
    """Write the description and its meshes into a folder."""
    meshes = folder / "meshes"
    meshes.mkdir(parents=True, exist_ok=True)
    for name, mesh in robot_meshes().items():
        (meshes / f"{name}.glb").write_bytes(to_glb(mesh))
    (folder / "robot.urdf").write_text(urdf(), encoding="utf-8")
    (folder / "README.md").write_text(README, encoding="utf-8")


def robot_meshes() -> dict[str, MeshData]:
    """Return the meshes of the robot by file name."""
    return {
        "platform": platform.deck_mesh(),
        "boom": platform.boom_mesh(),
        "winch": platform.winch_mesh(),
        "rigging": platform.rigging_mesh(),
        "base": arm.base_mesh(),
        "link_1": arm.rising_mesh(0.2005),
        "link_2": arm.leaving_mesh(0.2),
        "link_3": arm.rising_mesh(0.2),
        "link_4": arm.leaving_mesh(0.2, wrist=True),
        "link_5": arm.forearm_mesh(0.19),
        "link_6": arm.wrist_mesh(0.078),
        "link_7": arm.flange_mesh(),
        "tool": platform.tool_mesh(TOOL_LENGTH),
        "hc_body": platform.stereo_mesh(),
        "mako_body": platform.mako_mesh(),
    }


def urdf() -> str:
    """Return the description as text."""
    lines = [
        '<?xml version="1.0"?>',
        "<!-- Made by assets/generate; a KUKA LWR 4+ (published kinematics and limits) below a",
        "     cable-suspended platform. Root: platform, x forward, z up. Metres, kilograms. -->",
        '<robot name="sam">',
        *(line for link in _links() for line in _link_lines(link)),
        *_fixed("base_mount", "platform", "base", (0, 0, -0.125), (np.pi, 0, 0)),
    ]
    parent = "base"
    for index, joint in enumerate(JOINTS, start=1):
        lines += _revolute(joint, parent, f"link_{index}")
        parent = f"link_{index}"
    lines += _fixed("tool_mount", parent, "tool")
    lines += _fixed("tcp_mount", "tool", "tcp", (0, 0, TOOL_LENGTH))
    lines += _fixed("hc_mount", "tool", "hc", (0.105, -0.0325, 0.045), (0, 0, np.pi / 2))
    lines += _fixed("hc_body_mount", "hc", "hc_body")
    lines += _fixed("mako_mount", "platform", "mako", MAKO_XYZ, _looking(MAKO_XYZ, MAKO_AIM))
    lines += _fixed("mako_body_mount", "mako", "mako_body")
    for index, angle in enumerate(np.radians((45.0, 135.0, 225.0, 315.0)), start=1):
        edge = 0.3 * np.cos(angle), 0.3 * np.sin(angle), 0.0
        lines += _fixed(f"boom_{index}_mount", "platform", f"boom_{index}", edge, (0, 0, angle))
    for index, angle in enumerate(np.radians((60.0, 180.0, 300.0)), start=1):
        radius = platform.WINCH_RADIUS
        foot = radius * np.cos(angle), radius * np.sin(angle), 0.006
        lines += _fixed(f"winch_{index}_mount", "platform", f"winch_{index}", foot, (0, 0, angle))
    lines += _fixed("rigging_mount", "platform", "rigging")
    return "\n".join([*lines, "</robot>", ""])


def _links() -> list[Link]:
    """Return every link; 45 kg platform, 16 kg arm, 3 kg tool."""
    wrist = Mass(1.4, (0, 0, 0.014), (0.0019, 0.0019, 0.0012))
    return [
        Link(
            "platform",
            "platform",
            Mass(27.0, (0, 0, -0.01), (0.95, 0.95, 1.6)),
            [_cylinder(0.34, 0.09, (0, 0, -0.035))],
        ),
        *(
            Link(f"boom_{i}", "boom", Mass(3.0, (0.52, 0, 0), (0.09, 0.12, 0.2)))
            for i in range(1, 5)
        ),
        *(Link(f"winch_{i}", "winch", Mass(2.0, (0, 0, 0.05), (0.005,) * 3)) for i in range(1, 4)),
        Link("rigging", "rigging"),
        Link(
            "base",
            "base",
            Mass(2.3, (0, 0, 0.05), (0.0085, 0.0085, 0.0095)),
            [_cylinder(0.09, 0.11, (0, 0, 0.055))],
        ),
        Link("link_1", "link_1", _capsule(2.5, 0.2005), _tube(0.2005, -0.02)),
        Link("link_2", "link_2", _capsule(2.5, 0.2), _tube(0.2, 0.02)),
        Link("link_3", "link_3", _capsule(2.4, 0.2), _tube(0.2, -0.02)),
        Link("link_4", "link_4", _capsule(2.4, 0.2), _tube(0.2, 0.02)),
        Link("link_5", "link_5", _capsule(2.2, 0.19), _tube(0.19, -0.02)),
        Link("link_6", "link_6", wrist, [_sphere(0.0505, (0, 0, 0))]),
        Link("link_7", "link_7", Mass(0.3, (0, 0, -0.011), (0.00013, 0.00013, 0.00024))),
        Link("tool", "tool", Mass(3.0, (-0.008, 0, 0.08), (0.016, 0.016, 0.004)), _hook_solids()),
        Link("tcp"),
        Link("hc"),
        Link("hc_body", "hc_body"),
        Link("mako"),
        Link("mako_body", "mako_body"),
    ]


def _capsule(kilograms: float, length: float, *, radius: float = 0.06) -> Mass:
    """Return the mass of an arm section: a capsule of the section's length along z."""
    straight = length - radius
    share = straight / (straight + 4.0 / 3.0 * radius)
    rod, ends = kilograms * share, kilograms * (1.0 - share)
    about = rod * radius**2 / 2.0 + ends * 2.0 / 5.0 * radius**2
    across = rod * (radius**2 / 4.0 + straight**2 / 12.0)
    across += ends * (2.0 / 5.0 * radius**2 + straight**2 / 4.0 + 3.0 / 8.0 * straight * radius)
    return Mass(kilograms, (0, 0, length / 2.0), (across, across, about))


def _tube(length: float, y: float) -> list[str]:
    housing = (0.0, y, length if y < 0 else 0.0)
    return [_cylinder(0.062, length, (0, y / 2, length / 2)), _sphere(0.066, housing)]


def _hook_solids() -> list[str]:
    """Return spheres along the hook's rod, close enough to slide along, and its housing."""
    line = platform.hook_line(TOOL_LENGTH)[1:]
    balls = [_sphere(0.01, tuple(point)) for point in line]
    shank = _cylinder(0.01, 0.15, (-0.05, 0, 0.135))
    return [_cylinder(0.041, 0.06, (0, 0, 0.03)), shank, *balls]


def _cylinder(radius: float, length: float, xyz: Sequence[float]) -> str:
    return _solid(f'<cylinder radius="{radius:g}" length="{length:g}"/>', xyz)


def _sphere(radius: float, xyz: Sequence[float]) -> str:
    return _solid(f'<sphere radius="{radius:g}"/>', xyz)


def _solid(shape: str, xyz: Sequence[float]) -> str:
    return f'<collision><origin xyz="{_words(xyz)}"/><geometry>{shape}</geometry></collision>'


def _link_lines(link: Link) -> list[str]:
    inside = []
    if link.mass is not None:
        xx, yy, zz = (f"{value:.6g}" for value in link.mass.inertia)
        centre = f'<origin xyz="{_words(link.mass.centre)}"/>'
        inside.append(f'<inertial>{centre}<mass value="{link.mass.kilograms:g}"/>')
        moments = f'ixx="{xx}" ixy="0" ixz="0" iyy="{yy}" iyz="0" izz="{zz}"'
        inside.append(f"  <inertia {moments}/></inertial>")
    if link.mesh is not None:
        file = f"meshes/{link.mesh}.glb"
        inside.append(f'<visual><geometry><mesh filename="{file}"/></geometry></visual>')
    inside += link.solids
    if not inside:
        return [f'  <link name="{link.name}"/>']
    return [f'  <link name="{link.name}">', *(f"    {line}" for line in inside), "  </link>"]


def _fixed(
    name: str,
    parent: str,
    child: str,
    xyz: Sequence[float] = (0, 0, 0),
    rpy: Sequence[float] = (0, 0, 0),
) -> list[str]:
    origin = f'<origin xyz="{_words(xyz)}" rpy="{_words(rpy)}"/>'
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return [f'  <joint name="{name}" type="fixed">{ends}{origin}</joint>']


def _revolute(
    joint: tuple[str, float, tuple[int, int, int], int, int, int], parent: str, child: str
) -> list[str]:
    name, z, axis, limit, torque, speed = joint
    reach, fast = _words([limit * TIMES_DEG]), _words([speed * TIMES_DEG])
    return [
        f'  <joint name="{name}" type="revolute">',
        f'    <parent link="{parent}"/><child link="{child}"/>',
        f'    <origin xyz="0 0 {z:g}"/><axis xyz="{_words(axis)}"/>',
        f'    <limit lower="-{reach}" upper="{reach}" effort="{torque}" velocity="{fast}"/>',
        "  </joint>",
    ]


def _looking(place: Sequence[float], aim: Sequence[float]) -> tuple[float, float, float]:
    """Return the fixed-axis angles [rad] of an optical frame that looks at a point, y leftmost.

    The image's up is the platform's forward as far as possible.
    """
    z = np.subtract(aim, place)
    z = z / np.linalg.norm(z)
    x = np.cross(z, (1.0, 0.0, 0.0))
    x = x / np.linalg.norm(x)
    rotation: Array = np.stack((x, np.cross(z, x), z), axis=1)
    pitch = np.arcsin(-rotation[2, 0])
    roll = np.arctan2(rotation[2, 1], rotation[2, 2])
    yaw = np.arctan2(rotation[1, 0], rotation[0, 0])
    return float(roll), float(pitch), float(yaw)


def _words(values: Sequence[float] | Sequence[int]) -> str:
    return " ".join(f"{round(float(v), 12) + 0.0:.12g}" for v in values)
