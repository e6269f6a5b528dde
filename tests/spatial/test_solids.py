"""Laws of signed distance: 1-Lipschitz, right sign, unit gradient, symmetry, exact outside."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spatial.errors import InputError
from spatial.rotation import Array, exp_so3
from spatial.solids import (
    Box,
    Cylinder,
    Funnel,
    MeshSolid,
    Plane,
    Solid,
    Tube,
    gradient,
    smooth_line,
)

BOX_CORNERS = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * (
    0.1,
    0.2,
    0.3,
)
BOX_QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
BOX_FACES = np.array([f for a, b, c, d in BOX_QUADS for f in ((a, b, c), (a, c, d))])

SOLIDS: dict[str, Solid] = {
    "plane": Plane((1.0, 1.0)),
    "box": Box((0.2, 0.4, 0.6)),
    "cylinder": Cylinder(0.15, 0.5),
    "funnel": Funnel(0.05, 0.25, 0.3),
    "narrowing": Funnel(0.25, 0.05, 0.3),
    "tube": Tube(smooth_line([[-0.4, 0, 0], [0, 0.1, 0.1], [0.3, 0, 0.3]]), 0.08),
    "mesh": MeshSolid(BOX_CORNERS, BOX_FACES),
}
solids = pytest.mark.parametrize("solid", SOLIDS.values(), ids=SOLIDS.keys())


def cloud(seed: int, count: int = 300) -> Array:
    return np.random.default_rng(seed).uniform(-0.6, 0.6, (count, 3))


@solids
def test_distance_is_1_lipschitz(solid: Solid) -> None:
    a = cloud(1)
    for step in (1e-4, 0.02, 0.5):
        b = a + step * np.random.default_rng(2).normal(size=a.shape)
        change = np.abs(solid.signed_distance(a) - solid.signed_distance(b))
        assert (change <= np.linalg.norm(a - b, axis=1) + 1e-12).all()


@solids
def test_gradient_has_unit_length_off_ridges(solid: Solid) -> None:
    norms = np.linalg.norm(gradient(solid, cloud(3)), axis=1)
    assert (norms <= 1.0 + 1e-6).all()
    assert (np.abs(norms - 1.0) < 1e-4).mean() > 0.98  # ridges have no volume


@solids
def test_a_step_down_the_gradient_lands_on_the_wall_from_outside(solid: Solid) -> None:
    points = cloud(4)
    distance = solid.signed_distance(points)
    outside = points[distance > 1e-3]
    d = solid.signed_distance(outside)
    landed = outside - d[:, None] * gradient(solid, outside)
    assert np.abs(solid.signed_distance(landed)).max() < 1e-5


def in_box(p: Array) -> np.ndarray:
    return np.asarray((np.abs(p) < (0.1, 0.2, 0.3)).all(axis=1))


INSIDE: dict[str, Callable[[Array], np.ndarray]] = {
    "plane": lambda p: p[:, 2] < 0,
    "box": in_box,
    "mesh": in_box,
    "cylinder": lambda p: (np.hypot(p[:, 0], p[:, 1]) < 0.15) & (p[:, 2] > 0) & (p[:, 2] < 0.5),
    "funnel": lambda p: (
        (np.hypot(p[:, 0], p[:, 1]) < 0.05 + p[:, 2] * 2 / 3) & (p[:, 2] > 0) & (p[:, 2] < 0.3)
    ),
}


@pytest.mark.parametrize("name", INSIDE)
def test_negative_is_inside(name: str) -> None:
    points = cloud(5, 2000)
    inside = INSIDE[name](points)
    assert inside.sum() > 20
    assert ((SOLIDS[name].signed_distance(points) < 0) == inside).all()


@solids
def test_nothing_of_the_wall_is_closer_than_the_distance(solid: Solid) -> None:
    points = cloud(6, 200)
    bound = np.abs(solid.signed_distance(points))
    directions = np.random.default_rng(7).normal(size=points.shape)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    reached = solid.signed_distance(points + 0.999 * bound[:, None] * directions)
    assert (np.sign(reached) == np.sign(solid.signed_distance(points)))[bound > 1e-9].all()


def test_a_mesh_of_a_box_is_that_box() -> None:
    points = cloud(8)
    exact = SOLIDS["box"].signed_distance(points)
    np.testing.assert_allclose(SOLIDS["mesh"].signed_distance(points), exact, atol=1e-12)
    turned = MeshSolid(BOX_CORNERS, BOX_FACES[:, ::-1])
    np.testing.assert_allclose(turned.signed_distance(points), exact, atol=1e-12)


def test_a_straight_funnel_is_a_cylinder() -> None:
    points = cloud(9)
    straight = Funnel(0.15, 0.15, 0.5).signed_distance(points)
    np.testing.assert_allclose(straight, SOLIDS["cylinder"].signed_distance(points), atol=1e-12)


def test_a_straight_tube_is_a_capsule() -> None:
    capsule = Tube(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.4]]), 0.1)
    points = np.array([[0.2, 0.0, 0.1], [0.0, 0.0, 0.6], [0.05, 0.0, 0.2], [0.0, 0.3, -0.4]])
    np.testing.assert_allclose(capsule.signed_distance(points), [0.1, 0.1, -0.05, 0.4])


@pytest.mark.parametrize("name", ["cylinder", "funnel", "narrowing"])
@given(turn=st.floats(-4.0, 4.0))
def test_what_is_round_does_not_change_when_turned(name: str, turn: float) -> None:
    points = cloud(10, 50)
    turned = points @ exp_so3([0.0, 0.0, turn]).T
    solid = SOLIDS[name]
    np.testing.assert_allclose(
        solid.signed_distance(turned), solid.signed_distance(points), atol=1e-12
    )


@pytest.mark.parametrize("name", ["box", "mesh"])
def test_boxes_are_mirror_symmetric(name: str) -> None:
    points, solid = cloud(11), SOLIDS[name]
    for flip in np.diag([-1.0, 1.0, 1.0]), np.diag([1.0, -1.0, 1.0]), np.diag([1.0, 1.0, -1.0]):
        mirrored = solid.signed_distance(points @ flip)
        np.testing.assert_allclose(mirrored, solid.signed_distance(points), atol=1e-12)


def test_a_smooth_line_passes_its_points_and_stays_straight_where_they_are() -> None:
    points = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.2, 0.1, 0.0], [0.3, 0.1, 0.1]])
    line = smooth_line(points)
    for point in points:
        assert np.linalg.norm(line - point, axis=1).min() < 1e-12
    straight = smooth_line([[0, 0, 0], [0, 0, 1], [0, 0, 2]])
    assert np.abs(straight[:, :2]).max() == 0.0
    assert (np.diff(straight[:, 2]) > 0).all()
    assert smooth_line(points[:2]).shape == (2, 3)


def test_what_has_no_inside_is_refused() -> None:
    with pytest.raises(InputError, match="not watertight: 3 of 33 edges"):
        MeshSolid(BOX_CORNERS, BOX_FACES[:-1])
    with pytest.raises(InputError, match="4 or more triangles"):
        MeshSolid(BOX_CORNERS, BOX_FACES[:3])
    with pytest.raises(InputError, match=r"index 8 vertices, got 0\.\.8"):
        MeshSolid(BOX_CORNERS, np.where(BOX_FACES == 7, 8, BOX_FACES))
    with pytest.raises(InputError, match="without area"):
        MeshSolid(BOX_CORNERS * (1.0, 1.0, 0.0), BOX_FACES)
    with pytest.raises(InputError, match="finite numbers"):
        MeshSolid(np.full((8, 3), np.nan), BOX_FACES)


REFUSED: dict[str, Callable[[], Solid]] = {
    "flat plane": lambda: Plane((0.0, 1.0)),
    "negative box": lambda: Box((1.0, -1.0, 1.0)),
    "nan radius": lambda: Cylinder(np.nan, 1.0),
    "no length": lambda: Cylinder(0.1, 0.0),
    "closed mouth": lambda: Funnel(0.1, 0.0, 0.2),
    "same point twice": lambda: Tube(np.zeros((2, 3)), 0.1),
    "one point": lambda: Tube(np.zeros((1, 3)), 0.1),
    "negative radius": lambda: Tube(np.array([[0.0, 0, 0], [1, 0, 0]]), -0.1),
}


@pytest.mark.parametrize("name", REFUSED)
def test_sizes_that_make_no_solid_are_refused(name: str) -> None:
    with pytest.raises(InputError):
        REFUSED[name]()


def test_large_clouds_are_measured_in_pieces_with_the_same_result() -> None:
    points = cloud(12, 40_000)
    mesh = SOLIDS["mesh"]
    together = mesh.signed_distance(points)
    np.testing.assert_array_equal(together[-100:], mesh.signed_distance(points[-100:]))
    assert mesh.signed_distance(np.zeros((0, 3))).shape == (0,)
