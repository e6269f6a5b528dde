"""Eq. 1, Eq. 3, Eq. 4 and the display roots against a world whose true poses are known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scene.graph import ObjectNode, SceneState
from scene.routes import Object1, Object2, carried, flat, in_tool, nested, root_to_base
from spatial.errors import InputError
from spatial.frames import Base, Cam, Frame, Hc, Mako, Object, Platform, Tcp, W
from spatial.pose import A, B, Pose
from spatial.tracked import TrackState

seeds = st.integers(0, 10_000)


def some_pose(rng: np.random.Generator) -> Pose[A, B]:
    return Pose.exp(rng.normal(0.0, 0.8, 6))


def close(one: Pose[A, B], other: Pose[A, B]) -> bool:
    return bool(np.abs(one.matrix - other.matrix).max() < 1e-9)


@settings(derandomize=True, deadline=None, max_examples=30)
@given(seeds)
def test_both_equations_agree_with_poses_in_the_world(seed: int) -> None:
    rng = np.random.default_rng(seed)
    T_w_base: Pose[W, Base] = some_pose(rng)
    T_w_tcp: Pose[W, Tcp] = some_pose(rng)
    T_w_hc: Pose[W, Hc] = some_pose(rng)
    T_w_mako: Pose[W, Mako] = some_pose(rng)
    T_w_object1: Pose[W, Object1] = some_pose(rng)
    T_w_object2: Pose[W, Object2] = some_pose(rng)
    measured = flat(
        T_base_mako=T_w_base.inverse() @ T_w_mako,
        T_mako_object1=T_w_mako.inverse() @ T_w_object1,
        T_base_tcp=T_w_base.inverse() @ T_w_tcp,
        T_tcp_hc=T_w_tcp.inverse() @ T_w_hc,
        T_hc_object2=T_w_hc.inverse() @ T_w_object2,
    )
    assert close(measured, T_w_object1.inverse() @ T_w_object2)
    T_w_object: Pose[W, Object] = some_pose(rng)
    in_tcp = nested(T_tcp_hc=T_w_tcp.inverse() @ T_w_hc, T_hc_object=T_w_hc.inverse() @ T_w_object)
    assert close(in_tcp, T_w_tcp.inverse() @ T_w_object)


@settings(derandomize=True, deadline=None, max_examples=30)
@given(seeds, st.floats(-0.1, 0.1))
def test_a_carried_object_stays_where_it_is_in_the_world(seed: int, dt_s: float) -> None:
    rng = np.random.default_rng(seed)
    T_w_cam: Pose[W, Cam] = some_pose(rng)
    T_w_object: Pose[W, Object] = some_pose(rng)
    xi_w_cam_cam = rng.normal(0.0, 1.0, 6)
    step: Pose[Cam, Cam] = Pose.exp(dt_s * xi_w_cam_cam)
    T_cam_object = carried(T_w_cam.inverse() @ T_w_object, xi_w_cam_cam=xi_w_cam_cam, dt_s=dt_s)
    assert close(T_w_cam @ step @ T_cam_object, T_w_object)


def scene(T_base_w: Pose[Base, W] | None) -> SceneState:
    rng = np.random.default_rng(7)
    T_base_object: Pose[Base, Object] = some_pose(rng)
    unseen = _node("peg", None)
    return SceneState(
        instant_ns=1,
        tick=1,
        Ts_base_link={},
        T_base_tcp=some_pose(rng),
        T_base_platform=some_pose(rng),
        T_base_w=T_base_w,
        Ts_base_cam={},
        objects=(_node("cage", T_base_object), unseen),
        robot_ms=0.0,
    )


def _node(slug: str, T_base_object: Pose[Base, Object] | None) -> ObjectNode:
    return ObjectNode(
        slug=slug,
        revision=1,
        state=TrackState.TRACKED,
        hierarchy="nested",
        T_base_object=T_base_object,
        T_base_object_raw=None,
        covariance_base=np.zeros((3, 3)),
        seen_ms=None,
        predicted_ms=None,
        camera="hc",
        reason="",
    )


def root(state: SceneState, name: str) -> Pose[Frame, Base]:
    T_root_base = root_to_base(state, root=name)
    assert T_root_base is not None
    return T_root_base


def test_in_its_own_root_a_frame_is_at_the_origin() -> None:
    state = scene(some_pose(np.random.default_rng(3)))
    node = state.objects[0]
    assert state.T_base_w is not None
    assert node.T_base_object is not None
    np.testing.assert_allclose((root(state, "w") @ state.T_base_w).matrix, np.eye(4), atol=1e-12)
    in_itself = root(state, "cage") @ node.T_base_object
    np.testing.assert_allclose(in_itself.matrix, np.eye(4), atol=1e-12)
    T_tcp_object = in_tool(state, node)
    assert T_tcp_object is not None
    assert close(state.T_base_tcp @ T_tcp_object, node.T_base_object)


def test_base_root_has_gravity_down_and_the_base_at_its_origin() -> None:
    state = scene(some_pose(np.random.default_rng(4)))
    assert state.T_base_w is not None
    T_root_base = root(state, "base")
    up_root = T_root_base.rotate(state.T_base_w.rotate([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(up_root, [0.0, 0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(T_root_base.translation, 0.0)


def test_base_root_keeps_the_heading_of_a_level_platform() -> None:
    rng = np.random.default_rng(5)
    state = scene(None)
    T_platform_w: Pose[Platform, W] = Pose.exp([1.0, 2.0, 3.0, 0.0, 0.0, rng.uniform(-3, 3)])
    level = scene(state.T_base_platform @ T_platform_w)
    upright = state.T_base_platform.inverse().rotation
    np.testing.assert_allclose(root(state, "base").rotation, upright)
    np.testing.assert_allclose(root(level, "base").rotation, upright, atol=1e-9)


def test_a_root_that_is_unknown_has_no_pose_and_one_that_does_not_exist_is_refused() -> None:
    state = scene(None)
    assert root_to_base(state, root="w") is None
    assert root_to_base(state, root="peg") is None
    assert in_tool(state, state.objects[1]) is None
    with pytest.raises(InputError, match="unknown display root 'moon'; available: base, cage"):
        root_to_base(state, root="moon")
