"""Looks of the suspended platform, its tool and its cameras (own design after the SAM's parts).

Platform frame: x forward, z up, origin in the middle of the deck.
"""

from __future__ import annotations

import numpy as np

from assets.generate.arm import DARK, GREY, STEEL
from assets.generate.shapes import (
    Body,
    Look,
    Solid,
    arc,
    bevelled_box,
    capsule_line,
    cut,
    cylinder,
    extruded,
    look,
    placed,
    ring,
    rod,
    rounded_plate,
    skin_of,
    swept,
    turned,
)
from scene.mesh import MeshData

ANODISED = look("anodised", (52, 57, 66), metallic=0.55, roughness=0.42)
CARBON = look("carbon", (27, 29, 33), metallic=0.2, roughness=0.34)
ROPE = look("rope", (196, 190, 172), roughness=0.85)
BLADE = look("blade", (22, 23, 26), roughness=0.45)
ACCENT = look("accent", (39, 134, 196), roughness=0.45)
GLASS = look("glass", (24, 34, 58), metallic=0.3, roughness=0.08)
YELLOW = look("yellow", (240, 184, 34), roughness=0.45)

DECK_RADIUS = 0.34
BOOM_LENGTH = 0.62
WINCH_RADIUS = 0.235
RING_HEIGHT = 1.0


def deck_mesh() -> MeshData:
    """Return the deck: two octagonal plates, spacers, electronics, batteries, arm mount."""
    body = Body()
    for z, thick in ((0.0, 0.012), (-0.07, 0.01)):
        holes = [
            placed(cylinder(0.055, -0.05, 0.05, sides=16), (0.2 * np.cos(a), 0.2 * np.sin(a), z))
            for a in np.radians((0.0, 90.0, 180.0, 270.0))
        ]
        body.add(ANODISED, cut(_octagon(DECK_RADIUS, z, thick), *holes))
    for angle in np.radians(np.arange(22.5, 360.0, 45.0)):
        x, y = 0.31 * np.cos(angle), 0.31 * np.sin(angle)
        body.add(STEEL, placed(cylinder(0.009, -0.066, -0.005, sides=10), (x, y, 0.0)))
    body.add(ANODISED, cylinder(0.115, -0.125, -0.072, bevel=0.004, sides=30))
    body.add(ACCENT, ring(0.11, 0.1165, -0.105, -0.099, sides=30))
    body.add(DARK, placed(bevelled_box((0.17, 0.13, 0.075), 0.008), (-0.02, 0.0, 0.046)))
    body.add(GREY, placed(bevelled_box((0.13, 0.09, 0.006), 0.002), (-0.02, 0.0, 0.086)))
    for side in (-1.0, 1.0):
        battery = rounded_plate((0.15, 0.075, 0.058), 0.012, bevel=0.004, steps=3)
        body.add(YELLOW, placed(battery, (-0.02, side * 0.125, 0.036)))
        body.add(
            DARK, placed(bevelled_box((0.02, 0.08, 0.062), 0.003), (-0.02, side * 0.125, 0.036))
        )
    body.add(DARK, placed(bevelled_box((0.1, 0.1, 0.05), 0.006), (0.0, 0.0, -0.038)))
    return body.mesh()


def boom_mesh() -> MeshData:
    """Return a boom with its two ducted propellers: along x from the deck's edge at x = 0.

    The propellers stand on a crossbar at the end, tilted to both sides so that together they push
    in every direction.
    """
    body = Body()
    for z in (-0.012, -0.058):
        body.add(CARBON, rod((-0.12, 0.0, z), (BOOM_LENGTH * 0.72, 0.0, -0.02), 0.0125, sides=10))
    body.add(CARBON, rod((-0.1, 0.0, -0.02), (BOOM_LENGTH, 0.0, -0.02), 0.017, sides=12))
    body.add(ANODISED, placed(bevelled_box((0.06, 0.05, 0.05), 0.006), (BOOM_LENGTH, 0.0, -0.02)))
    for side in (-1.0, 1.0):
        hub = np.array((BOOM_LENGTH, side * 0.185, 0.03))
        body.add(CARBON, rod((BOOM_LENGTH, 0.0, -0.02), hub - (0.0, 0.0, 0.012), 0.0125, sides=12))
        for look_, solid in _propeller(int(side)):
            body.add(look_, placed(solid, hub, rpy_deg=(side * 32.0, 0, 0)))
    return body.mesh()


def winch_mesh() -> MeshData:
    """Return a winch: motor, drum about y and its cheeks, standing on z = 0."""
    body = Body()
    body.add(ANODISED, placed(bevelled_box((0.09, 0.12, 0.008), 0.002), (0.0, 0.0, 0.004)))
    for y in (-0.045, 0.045):
        cheek = rounded_plate((0.085, 0.085, 0.008), 0.03, bevel=0.002, steps=4)
        body.add(ANODISED, placed(cheek, (0.0, y, 0.05), rpy_deg=(90, 0, 0)))
    drum = turned(
        [
            (0.0, -0.04),
            (0.04, -0.04),
            (0.04, -0.034),
            (0.027, -0.031),
            (0.027, 0.031),
            (0.04, 0.034),
            (0.04, 0.04),
            (0.0, 0.04),
        ],
        sides=28,
    )
    body.add(STEEL, placed(drum, (0.0, 0.0, 0.05), rpy_deg=(90, 0, 0)))
    coil = turned(
        [
            (0.0, -0.028),
            *((0.031 + 0.0022 * (i % 2), -0.028 + 0.007 * i) for i in range(9)),
            (0.0, 0.028),
        ],
        sides=24,
    )
    body.add(ROPE, placed(coil, (0.0, 0.0, 0.05), rpy_deg=(90, 0, 0)))
    motor = cylinder(0.029, 0.05, 0.12, bevel=0.004, sides=24)
    body.add(DARK, placed(motor, (0.0, 0.0, 0.05), rpy_deg=(-90, 0, 0)))
    return body.mesh()


def rigging_mesh() -> MeshData:
    """Return the three ropes from the winches to the master ring the crane holds."""
    body = Body()
    for angle in np.radians((60.0, 180.0, 300.0)):
        foot = (WINCH_RADIUS * np.cos(angle), WINCH_RADIUS * np.sin(angle), 0.08)
        top = (0.018 * np.cos(angle), 0.018 * np.sin(angle), RING_HEIGHT - 0.05)
        body.add(ROPE, rod(foot, top, 0.004, sides=8))
        body.add(STEEL, rod(top, (0.0, 0.0, RING_HEIGHT - 0.03), 0.009, sides=10))
    circle = arc((0.0, 0.0, RING_HEIGHT), 0.038, 0.0, 360.0, steps=33)[:-1]
    body.add(STEEL, swept(circle, 0.0095, sides=12, closed=True))
    return body.mesh()


def tool_mesh(length: float) -> MeshData:
    """Return the tool from the flange at z = 0 to the inner bottom of its hook at z = `length`.

    A force-torque sensor, an adapter and a J-hook of a 20 mm rod: inner radius 40 mm, opening
    80 mm towards +x.
    """
    body = Body()
    body.add(DARK, cylinder(0.041, 0.0, 0.034, bevel=0.003, sides=32))
    body.add(ACCENT, ring(0.039, 0.0415, 0.014, 0.019, sides=32))
    body.add(GREY, cylinder(0.036, 0.034, 0.046, bevel=0.002, sides=28))
    body.add(ANODISED, placed(bevelled_box((0.1, 0.05, 0.016), 0.004), (-0.02, 0.0, 0.053)))
    body.add(ANODISED, placed(cylinder(0.017, 0.055, 0.085, bevel=0.003, sides=20), (-0.05, 0, 0)))
    body.add(YELLOW, capsule_line(hook_line(length), 0.01, sides=16))
    return body.mesh()


def hook_line(length: float, *, steps: int = 17) -> np.ndarray:
    """Return the centre line (n, 3) of the hook's rod, from the shank to its tip."""
    middle = length - 0.04
    bowl = arc((0.0, 0.0, middle), 0.05, 180.0, 0.0, steps=steps)
    bowl[:, 2] = middle + np.abs(bowl[:, 2] - middle)
    return np.array([(-0.05, 0.0, 0.06), *bowl, (0.05, 0.0, middle - 0.022)])


def stereo_mesh() -> MeshData:
    """Return the hand-eye camera: a stereo box around its left lens, in the optical frame."""
    body = Body()
    box = rounded_plate((0.135, 0.05, 0.058), 0.01, bevel=0.003, steps=4)
    body.add(GREY, placed(box, (0.0325, 0.0, -0.032)))
    body.add(
        DARK, placed(rounded_plate((0.125, 0.042, 0.004), 0.008, steps=4), (0.0325, 0, -0.0025))
    )
    for x in (0.0, 0.065):
        body.add(DARK, placed(cylinder(0.0125, -0.003, 0.0025, bevel=0.001, sides=24), (x, 0, 0)))
        glass = turned([(0.0, 0.0), (0.0095, 0.0), (0.0095, 0.0022), (0.0, 0.0034)], sides=24)
        body.add(GLASS, placed(glass, (x, 0.0, 0.0005)))
    body.add(ACCENT, placed(bevelled_box((0.02, 0.006, 0.001), 0.0003), (0.0325, 0.0, 0.0)))
    body.add(ANODISED, placed(bevelled_box((0.05, 0.045, 0.012), 0.002), (0.0325, 0.045, -0.04)))
    return body.mesh()


def mako_mesh() -> MeshData:
    """Return the eye-to-hand camera: a cube with a lens, in the optical frame."""
    body = Body()
    body.add(DARK, placed(bevelled_box((0.03, 0.03, 0.05), 0.002), (0.0, 0.0, -0.072)))
    for z in np.arange(-0.09, -0.052, 0.007):
        body.add(STEEL, placed(bevelled_box((0.0315, 0.0315, 0.0018), 0.0005), (0.0, 0.0, z)))
    lens = turned(
        [
            (0.0, -0.047),
            (0.0145, -0.047),
            (0.0145, -0.03),
            (0.017, -0.028),
            (0.017, -0.012),
            (0.0155, -0.01),
            (0.0155, 0.0),
            (0.0125, 0.0),
            (0.011, -0.006),
            (0.0, -0.006),
        ],
        sides=28,
    )
    body.add(DARK, lens)
    body.add(ACCENT, ring(0.0165, 0.0175, -0.022, -0.019, sides=28))
    body.add(GLASS, turned([(0.0, -0.0062), (0.011, -0.0062), (0.0, -0.003)], sides=24))
    body.add(ANODISED, placed(bevelled_box((0.045, 0.008, 0.05), 0.002), (0.0, 0.019, -0.072)))
    body.add(ANODISED, placed(bevelled_box((0.024, 0.11, 0.016), 0.002), (0.0, 0.073, -0.082)))
    return body.mesh()


def _octagon(radius: float, z: float, thick: float) -> Solid:
    angles = np.radians(np.arange(22.5, 360.0, 45.0))
    outline = radius * np.stack((np.cos(angles), np.sin(angles)), axis=1)
    return extruded([(outline, z - thick / 2), (outline, z + thick / 2)])


def _propeller(spin: int) -> list[tuple[Look, Solid]]:
    """Return duct, motor and blades about z, the disc at z = 0."""
    duct = turned(
        [
            (0.138, -0.032),
            (0.144, -0.034),
            (0.148, -0.022),
            (0.151, 0.012),
            (0.149, 0.026),
            (0.143, 0.031),
            (0.138, 0.026),
            (0.136, 0.0),
            (0.138, -0.032),
        ],
        sides=32,
    )
    made: list[tuple[Look, Solid]] = [(GREY, duct)]
    made.append((DARK, cylinder(0.019, -0.03, 0.006, bevel=0.003, sides=14)))
    made.append(
        (ACCENT, turned([(0.0, 0.006), (0.0165, 0.006), (0.011, 0.016), (0.0, 0.02)], sides=16))
    )
    for angle in (0.0, 120.0, 240.0):
        arm = rod((0.0, 0.0, -0.022), (0.139, 0.0, -0.022), 0.005, sides=5)
        made.append((CARBON, placed(arm, rpy_deg=(0, 0, angle + 60.0))))
    blades = [placed(_blade(spin), rpy_deg=(0, 0, angle)) for angle in (20.0, 200.0)]
    return [*made, *((BLADE, blade) for blade in blades)]


def _blade(spin: int) -> Solid:
    stations = ((0.012, 0.012, 24.0), (0.04, 0.026, 22.0), (0.08, 0.024, 15.0), (0.128, 0.011, 9.0))
    rings = []
    for radius, chord, pitch_deg in stations:
        turn = np.radians(spin * pitch_deg)
        around = np.radians(np.arange(0.0, 360.0, 60.0))
        across = 0.5 * chord * np.cos(around)
        thick = 0.0022 * np.sin(around)
        rings.append(
            np.column_stack(
                (
                    np.full(6, radius),
                    across * np.cos(turn) - thick * np.sin(turn),
                    0.002 + across * np.sin(turn) + thick * np.cos(turn),
                )
            )
        )
    return skin_of(rings)
