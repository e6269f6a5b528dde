"""The things that stand at the site: hole plate, pipe, valve wheel and calibration board."""

from __future__ import annotations

import numpy as np

from assets.generate.arm import DARK, GREY, ORANGE, STEEL
from assets.generate.carried import PIPE_RADIUS, UP, X, Y
from assets.generate.platform import ACCENT, ANODISED, YELLOW
from assets.generate.shapes import (
    Body,
    arc,
    bevelled_box,
    cut,
    cylinder,
    look,
    placed,
    ring,
    rod,
    rounded_plate,
    swept,
    turned,
)
from assets.generate.tags import Tag
from assets.generate.things import Fixture, Place, Thing

PAINT = look("paint", (104, 120, 132), metallic=0.25, roughness=0.5)
RUBBER = look("rubber", (34, 36, 40), roughness=0.9)
RED = look("red", (196, 44, 38), roughness=0.42)
GREEN = look("casting", (46, 92, 104), metallic=0.2, roughness=0.55)
WHITE = look("board", (238, 240, 242), roughness=0.7)
HOLE_RADIUS, HOLE_DEPTH, CHAMFER = 0.0245, 0.1, 0.005


def hole_plate() -> Thing:
    """Return the plate with a chamfered hole of 49 mm, 100 mm deep, and five tags around it."""
    body = Body()
    plate = placed(rounded_plate((0.3, 0.3, 0.014), 0.018, bevel=0.002, steps=6), (0, 0, -0.007))
    bore = turned(
        [
            (0.0, -0.05),
            (HOLE_RADIUS, -0.05),
            (HOLE_RADIUS, -CHAMFER),
            (HOLE_RADIUS + CHAMFER + 0.002, 0.002),
            (0.0, 0.002),
        ],
        sides=48,
    )
    body.add(ANODISED, cut(plate, bore))
    body.add(
        STEEL,
        turned(
            [
                (HOLE_RADIUS, -HOLE_DEPTH),
                (0.034, -HOLE_DEPTH),
                (0.036, -HOLE_DEPTH + 0.002),
                (0.036, -0.02),
                (0.044, -0.0135),
                (HOLE_RADIUS, -0.0135),
                (HOLE_RADIUS, -HOLE_DEPTH),
            ],
            sides=48,
        ),
        turned(
            [
                (HOLE_RADIUS, -0.0138),
                (HOLE_RADIUS, -CHAMFER),
                (HOLE_RADIUS + CHAMFER, 0.0004),
                (HOLE_RADIUS + CHAMFER + 0.006, 0.0004),
                (HOLE_RADIUS + CHAMFER + 0.0075, -0.001),
                (HOLE_RADIUS, -0.0138),
            ],
            sides=48,
        ),
    )
    body.add(DARK, cylinder(0.034, -HOLE_DEPTH - 0.006, -HOLE_DEPTH, bevel=0.002, sides=36))
    for angle in np.radians((0.0, 90.0, 180.0, 270.0)):
        rib = bevelled_box((0.07, 0.008, 0.07), 0.002)
        at = (0.07 * np.cos(angle), 0.07 * np.sin(angle), -0.048)
        body.add(ANODISED, placed(rib, at, rpy_deg=(0, 0, np.degrees(angle))))
    for sx in (-1, 1):
        for sy in (-1, 1):
            leg = cylinder(0.012, -0.13, -0.012, bevel=0.002, sides=20)
            body.add(STEEL, placed(leg, (sx * 0.125, sy * 0.125, 0)))
            body.add(
                RUBBER,
                placed(
                    cylinder(0.018, -0.14, -0.128, bevel=0.003, sides=20),
                    (sx * 0.125, sy * 0.125, 0),
                ),
            )
            body.add(
                STEEL,
                placed(
                    cylinder(0.007, 0.0, 0.004, bevel=0.001, sides=6), (sx * 0.138, sy * 0.138, 0)
                ),
            )
    spots = (
        (0.0, 0.093, 0.07),
        (-0.095, 0.086, 0.06),
        (0.095, 0.086, 0.06),
        (-0.09, -0.088, 0.07),
        (0.09, -0.088, 0.07),
    )
    tags = tuple(
        Tag(i, size, (x, y, 0.0), UP, Y, target=i == 0) for i, (x, y, size) in enumerate(spots)
    )
    return Thing(
        slug="hole_plate",
        name="Hole plate",
        mass_kg=9.0,
        color=(72, 78, 88),
        motion="static",
        body=body,
        tags=tags,
        diameter_m=0.45,
        places=(Place("hole_axis", "axis"), Place("seat", "seat", (0, 0, -HOLE_DEPTH))),
        fixtures=(
            Fixture(
                "approach",
                "funnel",
                "inside",
                "hole_axis",
                (0.0, 0.0, 0.0),
                {"radius_m": HOLE_RADIUS, "mouth_radius_m": 0.1644, "length_m": 0.3},
            ),
            Fixture(
                "bore",
                "cylinder",
                "inside",
                "seat",
                (0.0, 0.0, 0.0),
                {"radius_m": HOLE_RADIUS, "length_m": HOLE_DEPTH},
                enabled=False,
            ),
        ),
        about="Plate 300 x 300 mm with a hole of 49 mm, 100 mm deep, 5 mm chamfer; a 40 mm peg has "
        "9 mm of margin. Five tags on one face; the cone of approach opens by 25 deg to each side.",
    )


def pipe() -> Thing:
    """Return two metres of a 273 mm pipe with bands that carry tags."""
    body = Body()
    r, half, wall = PIPE_RADIUS, 1.0, 0.0093
    lay = (0.0, 90.0, 0.0)
    profile = [
        (r - wall, -half),
        (r - 0.002, -half),
        (r, -half + 0.002),
        (r, half - 0.002),
        (r - 0.002, half),
        (r - wall, half),
        (r - wall, -half),
    ]
    body.add(PAINT, placed(turned(profile, sides=56), rpy_deg=lay))
    for x in (-0.6, 0.6):
        weld = arc((x, 0, 0), r + 0.0005, 0.0, 360.0, steps=41, plane="yz")[:-1]
        body.add(STEEL, swept(weld, 0.0035, sides=5, closed=True))
    tags: list[Tag] = []
    ids = iter(range(20, 30))
    for x, angles in (
        (0.4, (0, 62, -62)),
        (-0.4, (0, 62, -62)),
        (0.8, (40, -40)),
        (-0.8, (40, -40)),
    ):
        body.add(
            ANODISED,
            placed(ring(r, r + 0.003, x - 0.02, x + 0.02, sides=40), rpy_deg=lay),
        )
        for angle in angles:
            tags.append(_band_tag(body, next(ids), x, float(angle), target=not tags))
    for x in (-0.93, 0.93):
        body.add(ORANGE, placed(ring(r, r + 0.0015, x - 0.03, x + 0.03, sides=48), rpy_deg=lay))
        _support(body, 0.93 * np.sign(x) * 0.72)
    walls = {"size_m": [0.9, 0.5]}
    return Thing(
        slug="pipe",
        name="Pipe",
        mass_kg=121.0,
        color=(104, 120, 132),
        motion="static",
        body=body,
        tags=tuple(tags),
        diameter_m=2.02,
        continuous_axis=X,
        places=(Place("seat", "seat"), Place("crown", "place", (0.0, 0.0, r))),
        fixtures=(
            Fixture(
                "left",
                "plane",
                "forbidden",
                "seat",
                (0.0, 0.27, 0.5),
                walls,
                quaternion_wxyz=_leaning(1.0),
            ),
            Fixture(
                "right",
                "plane",
                "forbidden",
                "seat",
                (0.0, -0.27, 0.5),
                walls,
                quaternion_wxyz=_leaning(-1.0),
            ),
        ),
        about="Steel pipe, 273.0 mm outside, 2 m long; its middle is free for the cage. Two walls "
        "lead the saddles onto its crown.",
    )


def _leaning(side: float) -> tuple[float, float, float, float]:
    """Return the orientation of a plane at one side of y whose free side looks in and up."""
    half = np.radians(side * 68.0) / 2.0
    return round(float(np.cos(half)), 9), round(float(np.sin(half)), 9), 0.0, 0.0


def _band_tag(body: Body, number: int, x: float, angle_deg: float, *, target: bool) -> Tag:
    turn = np.radians(angle_deg)
    out = np.array((0.0, -np.sin(turn), np.cos(turn)))
    stand = PIPE_RADIUS + 0.012
    block = bevelled_box((0.036, 0.05, 0.014), 0.002)
    body.add(DARK, placed(block, (x, *(out * (stand - 0.008))[1:]), rpy_deg=(angle_deg, 0, 0)))
    carrier = rounded_plate((0.106, 0.106, 0.003), 0.01, steps=3)
    body.add(
        ANODISED, placed(carrier, (x, *(out * (stand + 0.0005))[1:]), rpy_deg=(angle_deg, 0, 0))
    )
    surface = out * (stand + 0.002)
    across = (0.0, float(np.cos(turn)), float(np.sin(turn)))
    return Tag(
        number,
        0.08,
        (x, float(surface[1]), float(surface[2])),
        (0.0, float(out[1]), float(out[2])),
        across,
        target=target,
    )


def _support(body: Body, x: float) -> None:
    """Add a trestle under the pipe."""
    r = PIPE_RADIUS
    for sy in (-1, 1):
        body.add(YELLOW, rod((x, sy * 0.07, -r - 0.02), (x, sy * 0.2, -0.42), 0.014, sides=12))
        roller = cylinder(0.03, -0.03, 0.03, bevel=0.004, sides=20)
        lift = (r + 0.03) * np.cos(np.radians(35.0))
        at = (x, sy * (r + 0.03) * np.sin(np.radians(35.0)), -lift)
        body.add(RUBBER, placed(roller, at, rpy_deg=(0, 90, 0)))
        body.add(DARK, placed(bevelled_box((0.09, 0.06, 0.012), 0.003), (x, sy * 0.2, -0.424)))
    body.add(YELLOW, placed(bevelled_box((0.05, 0.24, 0.02), 0.004), (x, 0, -r - 0.045)))
    body.add(YELLOW, rod((x, -0.155, -0.33), (x, 0.155, -0.33), 0.009, sides=10))


def valve_wheel() -> Thing:
    """Return a gate valve with a five-spoked hand wheel, tags on its hub, body and base."""
    body = Body()
    rim = arc((0, 0, 0), 0.13, 0.0, 360.0, steps=49, plane="xy")[:-1]
    body.add(RED, swept(rim, 0.0125, sides=14, closed=True))
    for angle in np.radians(np.arange(18.0, 360.0, 72.0)):
        way = np.array([(0.03, -0.012), (0.06, -0.016), (0.095, -0.01), (0.128, 0.0)])
        spoke = np.stack((way[:, 0] * np.cos(angle), way[:, 0] * np.sin(angle), way[:, 1]), axis=1)
        body.add(RED, swept(spoke, (0.0115, 0.0095, 0.0085, 0.009), sides=10))
    body.add(RED, cylinder(0.04, -0.026, 0.0, bevel=0.004, sides=36))
    body.add(STEEL, cylinder(0.011, -0.14, -0.02, sides=20))
    body.add(
        GREEN,
        turned(
            [
                (0.0, -0.2),
                (0.05, -0.2),
                (0.05, -0.165),
                (0.026, -0.15),
                (0.022, -0.1),
                (0.03, -0.094),
                (0.03, -0.084),
                (0.02, -0.08),
                (0.0, -0.08),
            ],
            sides=32,
        ),
    )
    body.add(GREEN, placed(cylinder(0.086, -0.014, 0.0, bevel=0.003, sides=40), (0, 0, -0.192)))
    for angle in np.radians(np.arange(30.0, 360.0, 60.0)):
        nut = cylinder(0.009, -0.192, -0.183, sides=6)
        body.add(STEEL, placed(nut, (0.07 * np.cos(angle), 0.07 * np.sin(angle), 0)))
    body.add(GREEN, placed(bevelled_box((0.13, 0.13, 0.1), 0.012), (0, 0, -0.255)))
    bore = turned(
        [
            (0.0, -0.15),
            (0.052, -0.15),
            (0.052, -0.112),
            (0.084, -0.112),
            (0.086, -0.11),
            (0.086, -0.096),
            (0.05, -0.092),
            (0.05, 0.092),
            (0.086, 0.096),
            (0.086, 0.11),
            (0.084, 0.112),
            (0.052, 0.112),
            (0.052, 0.15),
            (0.0, 0.15),
        ],
        sides=40,
    )
    body.add(GREEN, placed(bore, (0, 0, -0.262), rpy_deg=(0, 90, 0)))
    base = rounded_plate((0.4, 0.4, 0.012), 0.03, bevel=0.002, steps=6)
    body.add(ANODISED, placed(base, (0, 0, -0.366)))
    body.add(DARK, placed(bevelled_box((0.12, 0.12, 0.06), 0.006), (0, 0, -0.33)))
    corners = ((0.145, 0.145), (-0.145, 0.145), (-0.145, -0.145), (0.145, -0.145))
    tags = [Tag(60, 0.052, (0.0, 0.0, 0.0), UP, Y, target=True)]
    tags += [Tag(61 + i, 0.075, (x, y, -0.36), UP, Y) for i, (x, y) in enumerate(corners)]
    tags += [
        Tag(65 + i, 0.06, (0.0, 0.065 * s, -0.255), (0, s, 0), UP) for i, s in enumerate((1, -1))
    ]
    return Thing(
        slug="valve_wheel",
        name="Valve wheel",
        mass_kg=24.0,
        color=(196, 44, 38),
        motion="static",
        body=body,
        tags=tuple(tags),
        diameter_m=0.66,
        places=(Place("wheel_axis", "axis"), Place("rim", "grasp", (0.13, 0.0, 0.0))),
        fixtures=(
            Fixture(
                "approach",
                "funnel",
                "inside",
                "wheel_axis",
                (0.0, 0.0, -0.05),
                {"radius_m": 0.16, "mouth_radius_m": 0.3, "length_m": 0.4},
            ),
        ),
        about="Gate valve with a hand wheel of 285 mm on five spokes, on a base plate.",
    )


def calibration_board() -> Thing:
    """Return a board of 6 x 4 tags of 60 mm, 84 mm apart."""
    body = Body()
    body.add(WHITE, placed(rounded_plate((0.54, 0.372, 0.004), 0.012, bevel=0.001), (0, 0, -0.002)))
    body.add(
        ANODISED, placed(rounded_plate((0.548, 0.38, 0.006), 0.014, bevel=0.0015), (0, 0, -0.0075))
    )
    for y in (-0.12, 0.12):
        body.add(GREY, placed(bevelled_box((0.5, 0.03, 0.02), 0.003), (0, y, -0.02)))
    for x in (-0.2, 0.2):
        body.add(GREY, placed(bevelled_box((0.03, 0.3, 0.016), 0.003), (x, 0, -0.022)))
    for sx in (-1, 1):
        for sy in (-1, 1):
            head = cylinder(0.0045, 0.0, 0.002, bevel=0.0006, sides=12)
            body.add(STEEL, placed(head, (sx * 0.26, sy * 0.176, 0)))
    body.add(ACCENT, placed(cylinder(0.004, 0.0, 0.0006, sides=16), (-0.26, 0.0, 0)))
    tags = tuple(
        Tag(
            100 + 6 * row + column,
            0.06,
            (0.084 * (column - 2.5), 0.084 * (1.5 - row), -0.0019),
            UP,
            Y,
            target=row == column == 0,
        )
        for row in range(4)
        for column in range(6)
    )
    return Thing(
        slug="calibration_board",
        name="Calibration board",
        mass_kg=2.2,
        color=(238, 240, 242),
        motion="static",
        body=body,
        tags=tags,
        diameter_m=0.67,
        places=(Place("middle", "place"),),
        about="Board of 6 x 4 AprilTags of 60 mm, 84 mm apart, ids 100 to 123 row by row from the "
        "upper left; for intrinsics, hand-eye and base calibration.",
    )


THINGS = (hole_plate, pipe, valve_wheel, calibration_board)
