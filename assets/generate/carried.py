"""The things that are handled: peg, cage, crawler and hook.

Bent bars are made of short pieces that are not joined: physics takes the convex hull of each piece
that hangs together, and a hook has to find its way under a handle and through an eye.
"""

from __future__ import annotations

import numpy as np

from assets.generate.arm import DARK, GREY, ORANGE, STEEL
from assets.generate.platform import ACCENT, ANODISED, GLASS, YELLOW, hook_line
from assets.generate.shapes import (
    Body,
    arc,
    bevelled_box,
    capsule_line,
    cut,
    cylinder,
    dome,
    placed,
    ring,
    rod,
    rounded_plate,
    skin_of,
    swept,
    turned,
)
from assets.generate.tags import Tag
from assets.generate.things import Fixture, Place, Thing

UP, DOWN = (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)
X, Y = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)
PIPE_RADIUS = 0.1365
SADDLE_DEG = 40.0
WHEEL_DEG = 24.0
AXIS_BELOW_CAGE = 0.199
"""From the middle of the cage down to the axis of the pipe it sits on [m]."""
GRASP_WXYZ = (0.0, 0.70710678, 0.70710678, 0.0)
"""Orientation of a hook's tcp below a bar along x: z down, x along the object's y."""


def peg() -> Thing:
    """Return the peg: 40 mm across, 140 mm long, a head with four tags and an eye."""
    body = Body()
    body.add(
        STEEL,
        turned(
            [
                (0.0, 0.0),
                (0.016, 0.0),
                (0.02, 0.006),
                (0.02, 0.128),
                (0.019, 0.13),
                (0.019, 0.14),
                (0.0, 0.14),
            ],
            sides=40,
        ),
    )
    body.add(DARK, ring(0.0188, 0.0203, 0.1, 0.102, sides=40))
    body.add(ORANGE, cylinder(0.034, 0.14, 0.152, bevel=0.003, sides=36))
    body.add(ANODISED, placed(bevelled_box((0.062, 0.062, 0.066), 0.004), (0, 0, 0.185)))
    body.add(ORANGE, placed(bevelled_box((0.064, 0.064, 0.006), 0.002), (0, 0, 0.221)))
    for start in range(0, 360, 36):
        piece = arc((0.0, 0.0, 0.262), 0.036, start - 1.0, start + 37.0, steps=6)
        body.add(STEEL, swept(piece, 0.007, sides=14))
    body.add(STEEL, cylinder(0.013, 0.222, 0.232, bevel=0.002, sides=20))
    sides = ((1, 0), (0, 1), (-1, 0), (0, -1))
    tags = tuple(
        Tag(30 + i, 0.044, (0.031 * x, 0.031 * y, 0.185), (x, y, 0), UP, target=i == 0)
        for i, (x, y) in enumerate(sides)
    )
    return Thing(
        slug="peg",
        name="Peg",
        mass_kg=1.8,
        color=(168, 173, 180),
        motion="held",
        body=body,
        tags=tags,
        diameter_m=0.33,
        continuous_axis=UP,
        places=(
            Place("tip", "tip"),
            Place("grasp", "grasp", (0.0, 0.0, 0.291), (0.0, 1.0, 0.0, 0.0)),
        ),
        about="Round steel peg for the hole plate: 40 mm across, 140 mm long, eye for the hook.",
    )


def hook() -> Thing:
    """Return a spare J-hook with four tags; its frame stands in the inner bottom, z up."""
    body = Body()
    turn = (180.0, 0.0, 0.0)
    line = hook_line(0.25)
    line[0, 2] = 0.04
    body.add(YELLOW, placed(capsule_line(line, 0.01), (0, 0, 0.25), rpy_deg=turn))
    body.add(ANODISED, placed(bevelled_box((0.064, 0.064, 0.064), 0.004), (-0.05, 0, 0.205)))
    body.add(DARK, placed(cylinder(0.041, 0.237, 0.262, bevel=0.003, sides=32), (-0.05, 0, 0)))
    body.add(ACCENT, placed(ring(0.039, 0.0415, 0.248, 0.252, sides=32), (-0.05, 0, 0)))
    body.add(STEEL, placed(cylinder(0.0315, 0.262, 0.27, bevel=0.001, sides=28), (-0.05, 0, 0)))
    sides = ((1, 0), (0, 1), (-1, 0), (0, -1))
    tags = tuple(
        Tag(50 + i, 0.044, (0.032 * x - 0.05, 0.032 * y, 0.205), (x, y, 0), UP, target=i == 0)
        for i, (x, y) in enumerate(sides)
    )
    return Thing(
        slug="hook",
        name="Hook",
        mass_kg=1.6,
        color=(240, 184, 34),
        motion="held",
        body=body,
        tags=tags,
        diameter_m=0.32,
        places=(
            Place("bowl", "grasp", (0.0, 0.0, 0.0), (0.0, 1.0, 0.0, 0.0)),
            Place("tip", "tip", (0.05, 0.0, 0.072)),
        ),
        about="J-hook of a 20 mm rod: inner radius 40 mm, opening 80 mm. Origin: inner bottom.",
    )


def cage() -> Thing:
    """Return the transport cage: open below, saddles for the pipe, a handle for the hook."""
    body = Body()
    _cage_frame(body)
    _saddles(body)
    for side, start in ((-1, 90.0), (1, 0.0)):
        bend = arc((side * 0.08, 0.0, 0.265), 0.04, start, start + 90.0, steps=8)
        post = rod((side * 0.12, 0.0, 0.13), (side * 0.12, 0.0, 0.2655), 0.01)
        body.add(YELLOW, post, swept(bend, 0.01, sides=16))
    body.add(YELLOW, rod((-0.0805, 0.0, 0.305), (0.0805, 0.0, 0.305), 0.01))
    for x in (-0.12, 0.12):
        body.add(DARK, placed(cylinder(0.02, 0.129, 0.14, bevel=0.003, sides=20), (x, 0.0, 0.0)))
    body.add(DARK, rod((-0.05, 0.0, 0.305), (0.05, 0.0, 0.305), 0.0115, sides=16))
    top = [(0.145, 0.095), (-0.145, 0.095), (-0.145, -0.095), (0.145, -0.095)]
    tags = [Tag(10 + i, 0.07, (x, y, 0.129), UP, Y, target=i == 0) for i, (x, y) in enumerate(top)]
    for i, (x, y) in enumerate(((0.09, 1.0), (-0.09, 1.0), (0.09, -1.0), (-0.09, -1.0))):
        tags.append(Tag(14 + i, 0.08, (x, 0.154 * y, 0.035), (0, y, 0), UP))
    tags.append(Tag(18, 0.07, (-0.204, 0.0, 0.045), (-1, 0, 0), UP))
    tags.append(Tag(19, 0.044, (0.2035, 0.0, 0.094), (1, 0, 0), UP))
    return Thing(
        slug="cage",
        name="Cage",
        mass_kg=3.0,
        color=(208, 212, 216),
        motion="static",
        body=body,
        tags=tuple(tags),
        diameter_m=0.68,
        places=(
            Place("grasp", "grasp", (0.0, 0.0, 0.295), GRASP_WXYZ),
            Place("below", "approach", (0.0, 0.0, 0.195), GRASP_WXYZ),
            Place("beside", "approach", (0.0, -0.13, 0.195), GRASP_WXYZ),
            Place("above", "approach", (0.0, -0.13, 0.45), GRASP_WXYZ),
            Place("saddle", "seat", (0.0, 0.0, -AXIS_BELOW_CAGE)),
        ),
        fixtures=(
            Fixture(
                "approach",
                "funnel",
                "inside",
                "object",
                (0.0, 0.0, 0.165),
                {"radius_m": 0.15, "mouth_radius_m": 0.3, "length_m": 0.42},
            ),
            Fixture(
                "lid",
                "box",
                "forbidden",
                "object",
                (0.0, 0.0, 0.14),
                {"size_m": [0.42, 0.32, 0.03]},
            ),
        ),
        about="Transport cage of the crawler: open below, saddles at 40 deg seat a 273 mm pipe "
        "199 mm below its middle; handle bar 20 mm, 240 mm wide, 180 mm above the frame.",
    )


def _cage_frame(body: Body) -> None:
    x, y, z = 0.19, 0.14, 0.115
    for sx in (-1, 1):
        for sy in (-1, 1):
            post = bevelled_box((0.02, 0.02, 0.25), 0.0025)
            body.add(GREY, placed(post, (sx * x, sy * y, 0.0)))
            foot = bevelled_box((0.026, 0.026, 0.02), 0.003)
            body.add(DARK, placed(foot, (sx * x, sy * y, -0.118)))
        body.add(GREY, placed(bevelled_box((0.02, 0.26, 0.02), 0.0025), (sx * x, 0.0, z)))
    for sy in (-1, 1):
        body.add(GREY, placed(bevelled_box((0.36, 0.02, 0.02), 0.0025), (0.0, sy * y, z)))
        body.add(GREY, placed(bevelled_box((0.36, 0.02, 0.02), 0.0025), (0.0, sy * y, -0.105)))
        panel = rounded_plate((0.34, 0.12, 0.004), 0.015, bevel=0.001, steps=4)
        body.add(ACCENT, placed(panel, (0.0, sy * 0.152, 0.035), rpy_deg=(90, 0, 0)))
    lid = rounded_plate((0.4, 0.3, 0.004), 0.02, bevel=0.001, steps=5)
    slots = [
        placed(rounded_plate((0.13, 0.05, 0.02), 0.024, steps=5), (0.0, s * 0.095, 0.127))
        for s in (-1, 1)
    ]
    body.add(ANODISED, cut(placed(lid, (0.0, 0.0, 0.127)), *slots))
    stop = rounded_plate((0.13, 0.26, 0.004), 0.015, bevel=0.001, steps=4)
    body.add(ACCENT, placed(stop, (-0.202, 0.0, 0.045), rpy_deg=(0, 90, 0)))
    body.add(DARK, placed(bevelled_box((0.006, 0.07, 0.062), 0.002), (0.2005, 0.0, 0.094)))


def _saddles(body: Body) -> None:
    """Add gussets with inclined pads that meet the pipe at `SADDLE_DEG` from its crown."""
    slope = np.tan(np.radians(SADDLE_DEG))
    apex = -AXIS_BELOW_CAGE + PIPE_RADIUS / np.cos(np.radians(SADDLE_DEG))
    inner, outer = 0.062, 0.13
    for sx in (-1, 1):
        for sy in (-1, 1):
            edge = np.array([(outer, apex - outer * slope), (inner, apex - inner * slope)])
            edge[:, 1] += 0.008 / np.cos(np.radians(SADDLE_DEG))
            outline = [
                *edge,
                (inner + 0.004, edge[1, 1] + 0.012),
                (0.135, -0.02),
                (0.135, edge[0, 1]),
            ]
            rings = [
                np.array([(sx * 0.19 + dx, sy * a, b) for a, b in outline])
                for dx in (-0.004, 0.004)
            ]
            gusset = skin_of(rings if sy > 0 else rings[::-1])
            body.add(GREY, gusset)
            middle = 0.5 * (inner + outer)
            pad = bevelled_box(
                (0.05, (outer - inner) / np.cos(np.radians(SADDLE_DEG)), 0.008), 0.002
            )
            lift = 0.004 / np.cos(np.radians(SADDLE_DEG))
            at = (sx * 0.19, sy * middle, apex - middle * slope + lift)
            body.add(DARK, placed(pad, at, rpy_deg=(-sy * SADDLE_DEG, 0, 0)))


def crawler() -> Thing:
    """Return the inspection crawler: 300 x 200 x 150 mm, magnet wheels that follow a pipe."""
    body = Body()
    hull_ = rounded_plate((0.2, 0.116, 0.062), 0.022, bevel=0.006, steps=5)
    body.add(ORANGE, placed(hull_, (0.0, 0.0, -0.004)))
    body.add(ANODISED, placed(rounded_plate((0.16, 0.1, 0.03), 0.016, bevel=0.005), (0, 0, 0.04)))
    body.add(DARK, placed(bevelled_box((0.206, 0.07, 0.03), 0.006), (0.0, 0.0, -0.034)))
    for sx in (-1, 1):
        for sy in (-1, 1):
            _wheel(body, sx, sy)
    body.add(DARK, placed(rounded_plate((0.05, 0.07, 0.05), 0.014, bevel=0.006), (0.125, 0, 0.0)))
    lens = cylinder(0.015, 0.0, 0.012, bevel=0.003, sides=24)
    body.add(STEEL, placed(lens, (0.138, 0.0, 0.006), rpy_deg=(0, 90, 0)))
    eye = dome(0.0115, low_deg=0.0, rings=6, sides=20, flat=0.4)
    body.add(GLASS, placed(eye, (0.1495, 0.0, 0.006), rpy_deg=(0, 90, 0)))
    for y in (-0.024, 0.024):
        lamp = cylinder(0.006, 0.0, 0.004, bevel=0.001, sides=14)
        body.add(GREY, placed(lamp, (0.149, y, -0.01), rpy_deg=(0, 90, 0)))
    body.add(
        STEEL,
        placed(cylinder(0.009, 0.0, 0.03, bevel=0.002), (-0.12, 0, 0.02), rpy_deg=(0, -90, 0)),
    )
    body.add(DARK, placed(bevelled_box((0.03, 0.06, 0.045), 0.006), (-0.112, 0.0, 0.004)))
    bar = [
        (-0.075, 0.0, 0.05),
        (-0.07, 0.0, 0.064),
        (-0.055, 0.0, 0.069),
        (0.055, 0.0, 0.069),
        (0.07, 0.0, 0.064),
        (0.075, 0.0, 0.05),
    ]
    for y in (-0.058, 0.058):
        body.add(DARK, placed(swept(np.array(bar), 0.006, sides=12), (0, y, -0.012)))
    tags = [
        Tag(40, 0.055, (0.038, 0.0, 0.055), UP, Y, target=True),
        Tag(41, 0.055, (-0.038, 0.0, 0.055), UP, Y),
        *(Tag(42 + i, 0.04, (0.0, 0.058 * s, 0.0), (0, s, 0), UP) for i, s in enumerate((1, -1))),
        Tag(44, 0.036, (-0.127, 0.0, 0.003), (-1, 0, 0), UP),
    ]
    return Thing(
        slug="crawler",
        name="Inspection crawler",
        mass_kg=6.4,
        color=(236, 106, 28),
        motion="mobile",
        body=body,
        tags=tuple(tags),
        diameter_m=0.39,
        places=(
            Place("seat", "seat", (0.0, 0.0, -0.075 - PIPE_RADIUS)),
            Place("camera", "tip", (0.154, 0.0, 0.006)),
        ),
        about="Pipe inspection robot, 300 x 200 x 150 mm, 6.4 kg; rides on a 273 mm pipe.",
    )


def _wheel(body: Body, sx: int, sy: int) -> None:
    """Add a wheel square on the pipe, `WHEEL_DEG` from its crown, with its arm."""
    turn = np.radians(WHEEL_DEG)
    radius, wide = 0.033, 0.026
    reach = PIPE_RADIUS + radius
    centre = (sx * 0.085, sy * reach * np.sin(turn), -0.075 - PIPE_RADIUS + reach * np.cos(turn))
    tyre = turned(
        [
            (0.0, -wide / 2),
            (0.022, -wide / 2),
            (radius - 0.003, -wide / 2 + 0.001),
            (radius, -wide / 2 + 0.005),
            (radius, wide / 2 - 0.005),
            (radius - 0.003, wide / 2 - 0.001),
            (0.022, wide / 2),
            (0.0, wide / 2),
        ],
        sides=30,
    )
    hub = turned(
        [
            (0.0, wide / 2 - 0.001),
            (0.02, wide / 2 - 0.001),
            (0.018, wide / 2 + 0.003),
            (0.006, wide / 2 + 0.004),
            (0.0, wide / 2 + 0.004),
        ],
        sides=24,
    )
    lean = (-sy * (90.0 + WHEEL_DEG), 0.0, 0.0)
    body.add(DARK, placed(tyre, centre, rpy_deg=lean))
    body.add(STEEL, placed(hub, centre, rpy_deg=lean))
    body.add(ANODISED, rod((centre[0], sy * 0.04, -0.022), centre, 0.011, sides=12))


THINGS = (peg, cage, crawler, hook)
