"""Laws of Pose and SO(3) over random inputs."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from spatial.errors import InputError
from spatial.frames import Base, Hc, Object, Tcp
from spatial.pose import Pose, interpolate, left_jacobian, mean_pose
from spatial.rotation import (
    Array,
    chordal_mean,
    exp_so3,
    hat,
    log_so3,
    nearest_rotation,
    quaternion_wxyz_of,
    rotation_of,
)

coordinate = st.floats(-10.0, 10.0)
vector = st.tuples(coordinate, coordinate, coordinate).map(np.array)
axis = vector.filter(lambda v: float(np.linalg.norm(v)) > 1e-3).map(lambda v: v / np.linalg.norm(v))
angle = st.one_of(
    st.floats(0.0, math.pi - 1e-9),
    st.floats(0.0, 1e-5),  # where series take over
    st.floats(math.pi - 1e-5, math.pi - 1e-9),  # where the logarithm is hard
)
rotation_vector = st.builds(lambda a, v: a * v, angle, axis)
tangent = st.builds(lambda t, r: np.concatenate((t, r)), vector, rotation_vector)
pose_strategy = st.builds(lambda t, r: (t, exp_so3(r)), vector, rotation_vector)


def T_base_tcp_of(parts: tuple[Array, Array]) -> Pose[Base, Tcp]:
    return Pose.of(parts[1], parts[0])


def T_tcp_hc_of(parts: tuple[Array, Array]) -> Pose[Tcp, Hc]:
    return Pose.of(parts[1], parts[0])


def T_hc_object_of(parts: tuple[Array, Array]) -> Pose[Hc, Object]:
    return Pose.of(parts[1], parts[0])


@given(pose_strategy, pose_strategy, pose_strategy)
def test_composition_is_associative(
    a: tuple[Array, Array], b: tuple[Array, Array], c: tuple[Array, Array]
) -> None:
    T_base_tcp, T_tcp_hc, T_hc_object = T_base_tcp_of(a), T_tcp_hc_of(b), T_hc_object_of(c)
    left = (T_base_tcp @ T_tcp_hc) @ T_hc_object
    right = T_base_tcp @ (T_tcp_hc @ T_hc_object)
    np.testing.assert_allclose(left.matrix, right.matrix, atol=1e-12)


@given(pose_strategy)
def test_inverse_and_identity(parts: tuple[Array, Array]) -> None:
    T_base_tcp = T_base_tcp_of(parts)
    identity: Pose[Base, Base] = Pose.identity()
    np.testing.assert_allclose((T_base_tcp @ T_base_tcp.inverse()).matrix, np.eye(4), atol=1e-12)
    np.testing.assert_allclose((T_base_tcp.inverse() @ T_base_tcp).matrix, np.eye(4), atol=1e-12)
    assert np.array_equal((identity @ T_base_tcp).matrix, T_base_tcp.matrix)
    np.testing.assert_allclose(T_base_tcp.inverse().inverse().matrix, T_base_tcp.matrix, atol=1e-12)


@given(pose_strategy, pose_strategy, vector)
def test_apply_is_an_action(a: tuple[Array, Array], b: tuple[Array, Array], p_hc: Array) -> None:
    T_base_tcp, T_tcp_hc = T_base_tcp_of(a), T_tcp_hc_of(b)
    one_by_one = T_base_tcp.apply(T_tcp_hc.apply(p_hc))
    np.testing.assert_allclose((T_base_tcp @ T_tcp_hc).apply(p_hc), one_by_one, atol=1e-11)
    stack = np.stack((p_hc, 2.0 * p_hc))
    np.testing.assert_allclose(T_tcp_hc.apply(stack)[0], T_tcp_hc.apply(p_hc), atol=1e-12)
    difference = T_tcp_hc.apply(stack[1]) - T_tcp_hc.apply(stack[0])
    np.testing.assert_allclose(T_tcp_hc.rotate(p_hc), difference, atol=1e-11)


@given(tangent)
def test_log_undoes_exp(xi: Array) -> None:
    T_base_tcp: Pose[Base, Tcp] = Pose.exp(xi)
    np.testing.assert_allclose(T_base_tcp.log(), xi, atol=2e-6)


@given(pose_strategy)
def test_exp_undoes_log(parts: tuple[Array, Array]) -> None:
    T_base_tcp = T_base_tcp_of(parts)
    again: Pose[Base, Tcp] = Pose.exp(T_base_tcp.log())
    np.testing.assert_allclose(again.matrix, T_base_tcp.matrix, atol=1e-8)


@given(tangent, st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_exp_is_a_one_parameter_group(xi: Array, s: float, t: float) -> None:
    first: Pose[Tcp, Tcp] = Pose.exp(s * xi)
    second: Pose[Tcp, Tcp] = Pose.exp(t * xi)
    whole: Pose[Tcp, Tcp] = Pose.exp((s + t) * xi)
    np.testing.assert_allclose((first @ second).matrix, whole.matrix, atol=1e-8)


@given(pose_strategy, tangent)
def test_adjoint_moves_a_tangent_through_a_pose(parts: tuple[Array, Array], xi: Array) -> None:
    T_base_tcp = T_base_tcp_of(parts)
    right: Pose[Tcp, Tcp] = Pose.exp(xi)
    left: Pose[Base, Base] = Pose.exp(T_base_tcp.adjoint() @ xi)
    np.testing.assert_allclose((T_base_tcp @ right).matrix, (left @ T_base_tcp).matrix, atol=1e-7)


@given(pose_strategy, pose_strategy)
def test_adjoint_is_a_homomorphism(a: tuple[Array, Array], b: tuple[Array, Array]) -> None:
    T_base_tcp, T_tcp_hc = T_base_tcp_of(a), T_tcp_hc_of(b)
    product = T_base_tcp.adjoint() @ T_tcp_hc.adjoint()
    np.testing.assert_allclose((T_base_tcp @ T_tcp_hc).adjoint(), product, atol=1e-10)


@given(rotation_vector)
def test_rotations_are_orthonormal_and_come_back(phi: Array) -> None:
    rotation = exp_so3(phi)
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-11)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    np.testing.assert_allclose(log_so3(rotation), phi, atol=1e-6)


@given(axis)
def test_log_of_half_a_turn_has_norm_pi_and_the_axis(unit: Array) -> None:
    phi = log_so3(exp_so3(math.pi * unit))
    assert np.linalg.norm(phi) == pytest.approx(math.pi)
    assert abs(phi @ unit) == pytest.approx(math.pi)


@given(rotation_vector)
def test_left_jacobian_is_the_mean_of_the_rotations_on_the_way(phi: Array) -> None:
    nodes, weights = np.polynomial.legendre.leggauss(12)
    shares = 0.5 * (nodes + 1.0)
    rotations = np.array([exp_so3(s * phi) for s in shares])
    mean = np.tensordot(0.5 * weights, rotations, axes=1)
    np.testing.assert_allclose(left_jacobian(phi), mean, atol=1e-6)


@given(vector, vector)
def test_hat_is_the_cross_product(a: Array, b: Array) -> None:
    np.testing.assert_allclose(hat(a) @ b, np.cross(a, b), atol=1e-12)


@given(rotation_vector)
def test_quaternion_round_trip_and_sign(phi: Array) -> None:
    rotation = exp_so3(phi)
    q = quaternion_wxyz_of(rotation)
    assert q[0] >= 0.0
    assert np.linalg.norm(q) == pytest.approx(1.0)
    np.testing.assert_allclose(rotation_of(q), rotation, atol=1e-11)
    np.testing.assert_allclose(rotation_of(-q), rotation, atol=1e-11)
    np.testing.assert_allclose(rotation_of(1.0004 * q), rotation, atol=1e-11)


def test_quaternion_of_known_turns() -> None:
    half = math.sqrt(0.5)
    quarter_about_z = exp_so3([0.0, 0.0, math.pi / 2])
    np.testing.assert_allclose(quaternion_wxyz_of(quarter_about_z), [half, 0, 0, half], atol=1e-12)
    np.testing.assert_allclose(quarter_about_z @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-12)


@pytest.mark.parametrize(
    "bad", [[0, 0, 0, 0], [1, 0, 0], [1.01, 0, 0, 0], [math.nan, 0, 0, 1], [math.inf, 0, 0, 0]]
)
def test_quaternions_from_outside_must_be_unit(bad: list[float]) -> None:
    with pytest.raises(InputError, match="unit length"):
        rotation_of(bad)


@pytest.mark.parametrize("bad", [[0.0, 0.0], [0.0, 0.0, math.nan], [math.inf, 0.0, 0.0]])
def test_translations_from_outside_must_be_finite(bad: list[float]) -> None:
    with pytest.raises(InputError, match="three finite numbers"):
        Pose.parse(bad, [1.0, 0.0, 0.0, 0.0])


@given(pose_strategy)
def test_parse_accepts_what_a_pose_shows(parts: tuple[Array, Array]) -> None:
    T_base_tcp = T_base_tcp_of(parts)
    parsed: Pose[Base, Tcp] = Pose.parse(T_base_tcp.translation, T_base_tcp.quaternion_wxyz)
    np.testing.assert_allclose(parsed.matrix, T_base_tcp.matrix, atol=1e-11)
    from_matrix: Pose[Base, Tcp] = Pose.parse_matrix(T_base_tcp.matrix)
    np.testing.assert_allclose(from_matrix.matrix, T_base_tcp.matrix, atol=1e-11)


def test_matrices_from_outside_must_be_rigid() -> None:
    mirror = np.diag([1.0, 1.0, -1.0, 1.0])
    shear = np.eye(4)
    shear[0, 1] = 0.01
    projective = np.eye(4)
    projective[3, 0] = 0.01
    for bad in (mirror, shear, projective, 2.0 * np.eye(4)):
        with pytest.raises(InputError, match="rigid"):
            Pose.parse_matrix(bad)
    for shapeless in (np.eye(3), np.full((4, 4), math.nan)):
        with pytest.raises(InputError, match="4x4"):
            Pose.parse_matrix(shapeless)


def test_a_pose_can_not_be_changed() -> None:
    T_base_tcp: Pose[Base, Tcp] = Pose.translated(1.0, 2.0, 3.0)
    for view in (T_base_tcp.matrix, T_base_tcp.rotation, T_base_tcp.translation):
        with pytest.raises(ValueError, match="read-only"):
            view[...] = 0.0
    assert T_base_tcp.is_finite()
    assert "1. 2. 3." in repr(T_base_tcp)


@given(pose_strategy, tangent)
def test_distance_is_a_metric_that_moving_the_frame_keeps(
    parts: tuple[Array, Array], xi: Array
) -> None:
    T_base_tcp = T_base_tcp_of(parts)
    step: Pose[Tcp, Tcp] = Pose.exp(xi)
    there, back = T_base_tcp @ step, T_base_tcp
    metres, radians = there.distance_to(back)
    assert metres == pytest.approx(float(np.linalg.norm(step.translation)), abs=1e-9)
    assert radians == pytest.approx(float(np.linalg.norm(xi[3:])), abs=1e-6)
    assert back.distance_to(there) == pytest.approx((metres, radians), abs=1e-9)
    assert back.distance_to(back) == pytest.approx((0.0, 0.0), abs=1e-7)


@given(pose_strategy, pose_strategy, st.floats(0.0, 1.0))
def test_interpolation_runs_from_one_pose_to_the_other_evenly(
    a: tuple[Array, Array], b: tuple[Array, Array], share: float
) -> None:
    older, younger = T_base_tcp_of(a), T_base_tcp_of(b)
    np.testing.assert_allclose(interpolate(older, younger, 0.0).matrix, older.matrix, atol=1e-9)
    np.testing.assert_allclose(interpolate(older, younger, 1.0).matrix, younger.matrix, atol=1e-7)
    angle_whole = older.distance_to(younger)[1]
    between = interpolate(older, younger, share)
    assert older.distance_to(between)[1] == pytest.approx(share * angle_whole, abs=1e-6)


@given(st.lists(rotation_vector, min_size=1, max_size=6), rotation_vector)
def test_chordal_mean_turns_with_its_rotations(phis: list[Array], turn: Array) -> None:
    near = [0.3 * phi / math.pi for phi in phis]  # within half a turn the mean is unique
    stack, R_turn = np.array([exp_so3(phi) for phi in near]), exp_so3(turn)
    mean = chordal_mean(stack)
    np.testing.assert_allclose(mean.T @ mean, np.eye(3), atol=1e-10)
    np.testing.assert_allclose(chordal_mean(R_turn @ stack), R_turn @ mean, atol=1e-8)
    np.testing.assert_allclose(chordal_mean(stack @ R_turn), mean @ R_turn, atol=1e-8)


@given(st.lists(rotation_vector, min_size=2, max_size=5), st.integers(0, 5), axis)
def test_chordal_mean_minimises_the_chord(phis: list[Array], seed: int, unit: Array) -> None:
    stack = np.array([exp_so3(0.4 * phi / math.pi) for phi in phis])
    weights = np.random.default_rng(seed).uniform(0.1, 2.0, len(stack))
    mean = chordal_mean(stack, weights)

    def cost(rotation: Array) -> float:
        return float(weights @ ((rotation - stack) ** 2).sum(axis=(1, 2)))

    assert cost(mean) <= cost(mean @ exp_so3(1e-3 * unit)) + 1e-12


@given(rotation_vector, st.floats(0.0, 1.0))
def test_mean_of_two_lies_between_them(phi: Array, share: float) -> None:
    step = 0.3 * phi
    poses: list[Pose[Base, Tcp]] = [
        Pose.identity(),
        Pose.of(exp_so3(step), np.array([1.0, 0.0, 0.0])),
    ]
    mean = mean_pose(poses, [1.0 - share, share])
    assert mean.translation[0] == pytest.approx(share)
    turned = float(np.linalg.norm(log_so3(mean.rotation)))
    assert turned <= float(np.linalg.norm(step)) + 1e-9
    halfway = mean_pose(poses)
    np.testing.assert_allclose(halfway.rotation, exp_so3(0.5 * step), atol=1e-8)


@given(rotation_vector, st.integers(0, 50))
def test_nearest_rotation_is_a_projection(phi: Array, seed: int) -> None:
    rotation = exp_so3(phi)
    noisy = rotation + np.random.default_rng(seed).normal(0.0, 0.02, (3, 3))
    nearest = nearest_rotation(noisy)
    np.testing.assert_allclose(nearest_rotation(nearest), nearest, atol=1e-12)
    assert np.linalg.norm(nearest - noisy) <= np.linalg.norm(rotation - noisy) + 1e-12
