"""Looks of the KUKA LWR 4+: seven sections, each a bent tube with a joint housing beside it.

Every mesh is in the frame of its link (the split 0.11 + 0.2005 | 0.20 + 0.20 | 0.20 + 0.19 |
0.078 m); shapes are our own after the published dimensions.
"""

from __future__ import annotations

import numpy as np

from assets.generate.shapes import (
    Body,
    Solid,
    bevelled_box,
    cylinder,
    look,
    placed,
    ring,
    smoothstep,
    swept,
    turned,
)
from scene.mesh import MeshData

ORANGE = look("shell", (236, 106, 28), roughness=0.36)
GREY = look("cap", (214, 217, 220), metallic=0.15, roughness=0.42)
DARK = look("seam", (38, 41, 47), metallic=0.3, roughness=0.5)
STEEL = look("steel", (168, 173, 180), metallic=0.85, roughness=0.32)

HOUSING_RADIUS = 0.0665
HOUSING_REACH = 0.0735
WAIST_RADIUS = 0.0555
TUBE_RADIUS = 0.0615


def base_mesh() -> MeshData:
    """Return the base: mounting flange, foot and connector box, z from 0 to 0.11."""
    body = Body()
    body.add(DARK, cylinder(0.098, 0.0, 0.014, bevel=0.002, sides=40))
    body.add(
        ORANGE,
        turned(
            [
                (0.0, 0.012),
                (0.088, 0.012),
                (0.09, 0.02),
                (0.087, 0.045),
                (0.078, 0.075),
                (0.0695, 0.098),
                (0.067, 0.104),
                (0.0, 0.104),
            ],
            sides=40,
        ),
    )
    body.add(DARK, ring(0.04, 0.0665, 0.102, 0.1105, sides=40))
    body.add(DARK, placed(bevelled_box((0.05, 0.085, 0.05), 0.006), (-0.083, 0.0, 0.037)))
    for y in (-0.022, 0.022):
        plug = cylinder(0.011, 0.0, 0.014, bevel=0.002, sides=14)
        body.add(STEEL, placed(plug, (-0.107, y, 0.037), rpy_deg=(0, -90, 0)))
    for angle in np.radians(np.arange(22.5, 360.0, 45.0)):
        head = cylinder(0.0055, 0.0, 0.0045, sides=6)
        body.add(STEEL, placed(head, (0.0905 * np.cos(angle), 0.0905 * np.sin(angle), 0.0135)))
    return body.mesh()


def rising_mesh(length: float) -> MeshData:
    """Return a section from a roll joint at z = 0 up to its half (y < 0) of a pitch joint."""
    body = Body()
    body.add(ORANGE, _bend(0.0, -0.035, length), _housing(-1.0, length))
    _joint_cap(body, -1.0, length)
    body.add(DARK, ring(0.03, TUBE_RADIUS - 0.002, -0.0005, 0.0065))
    return body.mesh()


def leaving_mesh(length: float, *, wrist: bool = False) -> MeshData:
    """Return a section from its half (y > 0) of a pitch joint at z = 0 up to a roll joint."""
    body = Body()
    spine = _bend(0.0, -0.035, length)
    body.add(ORANGE, placed(spine, (0.0, 0.0, length), rpy_deg=(180, 0, 0)), _housing(1.0, 0.0))
    _joint_cap(body, 1.0, 0.0)
    if wrist:
        body.add(
            GREY,
            cylinder(TUBE_RADIUS + 0.0015, length - 0.03, length - 0.012, bevel=0.001, sides=26),
        )
    body.add(DARK, ring(0.03, TUBE_RADIUS - 0.001, length - 0.0065, length + 0.0005))
    return body.mesh()


def forearm_mesh(length: float) -> MeshData:
    """Return link 5: a roll joint at z = 0, tapering to the slim fork of the wrist."""
    body = Body()
    rise = np.linspace(0.0, 1.0, 14)
    spine = np.stack((0.0 * rise, -0.0355 * smoothstep(rise), (length - 0.012) * rise), axis=1)
    radii = TUBE_RADIUS + (0.043 - TUBE_RADIUS) * smoothstep(rise)
    body.add(ORANGE, swept(spine, radii, sides=26))
    fork = turned(
        [
            (0.0, 0.0),
            (0.049, 0.0),
            (0.052, 0.004),
            (0.052, 0.026),
            (0.047, 0.034),
            (0.036, 0.038),
            (0.0, 0.038),
        ],
    )
    body.add(ORANGE, placed(fork, (0.0, -0.043, length), rpy_deg=(90, 0, 0)))
    cap = turned([(0.0, 0.0), (0.036, 0.0), (0.034, 0.004), (0.0, 0.0055)], sides=28)
    body.add(GREY, placed(cap, (0.0, -0.08, length), rpy_deg=(90, 0, 0)))
    body.add(DARK, ring(0.03, TUBE_RADIUS - 0.002, -0.0005, 0.0065))
    return body.mesh()


def wrist_mesh(length: float) -> MeshData:
    """Return link 6: the ball of the wrist at z = 0 and the neck of the flange."""
    body = Body()
    ball = [(0.0, -0.0505)]
    ball += [(0.0505 * np.cos(a), 0.0505 * np.sin(a)) for a in np.radians(np.linspace(-75, 30, 9))]
    ball += [(0.041, 0.034), (0.0405, length - 0.026), (0.0, length - 0.026)]
    body.add(ORANGE, turned(ball))
    hub = cylinder(0.044, -0.0425, 0.049, bevel=0.003)
    body.add(GREY, placed(hub, (0.0, 0.0, 0.0), rpy_deg=(90, 0, 0)))
    body.add(DARK, ring(0.02, 0.0395, length - 0.027, length - 0.0205))
    return body.mesh()


def flange_mesh() -> MeshData:
    """Return link 7: the flange, its face at z = 0 (ISO 9409-1-50)."""
    body = Body()
    body.add(
        GREY,
        turned(
            [
                (0.0, -0.021),
                (0.039, -0.021),
                (0.0405, -0.019),
                (0.0405, -0.012),
                (0.034, -0.008),
                (0.0, -0.008),
            ]
        ),
    )
    body.add(STEEL, ring(0.0155, 0.0315, -0.0085, 0.0, bevel=0.001))
    for angle in np.radians(np.arange(0.0, 360.0, 360.0 / 7.0)):
        bolt = cylinder(0.0033, -0.0015, 0.0012, sides=6)
        body.add(DARK, placed(bolt, (0.025 * np.cos(angle), 0.025 * np.sin(angle), 0.0)))
    return body.mesh()


def _bend(start_y: float, end_y: float, length: float) -> Solid:
    """Return the tube of a section, slimmer where it runs into the joint's housing."""
    rise = np.linspace(0.0, 1.0, 13)
    y = start_y + (end_y - start_y) * smoothstep(rise)
    spine = np.stack((0.0 * rise, y, 0.004 + (length - 0.026) * rise), axis=1)
    waist = np.sin(np.pi * np.clip(rise / 0.9, 0.0, 1.0)) ** 2
    radii = TUBE_RADIUS + (WAIST_RADIUS - TUBE_RADIUS) * waist
    radii -= (TUBE_RADIUS - 0.047) * smoothstep(np.clip(rise / 0.45 - 1.2, 0.0, 1.0))
    return swept(spine, radii, sides=26)


def _housing(side: float, z: float) -> Solid:
    """Return the half of a pitch joint on one side of y, with a round shoulder."""
    r, reach = HOUSING_RADIUS, HOUSING_REACH
    profile = [(0.0, 0.0015), (r - 0.002, 0.0015), (r, 0.0045), (r, 0.030)]
    bulge = np.radians(np.linspace(12.0, 66.0, 6))
    profile += [(r - 0.026 * (1 - np.cos(a)), 0.030 + (reach - 0.034) * np.sin(a)) for a in bulge]
    profile += [(0.0, profile[-1][1])]
    return placed(turned(profile, sides=30), (0.0, 0.0, z), rpy_deg=(-90.0 * side, 0, 0))


def _joint_cap(body: Body, side: float, z: float) -> None:
    face = 0.030 + (HOUSING_REACH - 0.034) * np.sin(np.radians(66.0))
    turn = (-90.0 * side, 0, 0)
    rim = turned(
        [(0.0, face - 0.002), (0.0445, face - 0.002), (0.0445, face + 0.001), (0.0, face + 0.001)],
        sides=30,
    )
    cap = turned(
        [
            (0.0, face),
            (0.0415, face),
            (0.0405, face + 0.004),
            (0.036, face + 0.0065),
            (0.0, face + 0.0075),
        ],
        sides=30,
    )
    body.add(DARK, placed(rim, (0, 0, z), rpy_deg=turn))
    body.add(GREY, placed(cap, (0, 0, z), rpy_deg=turn))
