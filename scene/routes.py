"""Routes from what cameras and joints measure to poses in the base: Eq. 1 and Eq. 4 of the paper.

    Eq. 1, nested:  T_tcp_object = T_tcp_hc @ T_hc_object
    Eq. 4, flat:    T_object1_object2 =
                        T_object1_mako @ T_mako_base @ T_base_tcp @ T_tcp_hc @ T_hc_object2
    Eq. 3, carry:   T_cam_object(t + dt) = exp(-dt xi_w_cam_cam) @ T_cam_object(t)

All factors of a product belong to one instant. A flat object hangs under the base, its pose is
the left or the right half of Eq. 4; a nested one hangs under the tcp. Which camera carries which
object is the table of the site file. Eq. 3 holds for an object that stands still in w.
"""

from __future__ import annotations

from typing import TypeVar, cast

import numpy as np

from scene.graph import ObjectNode, SceneState
from scene.site import SiteCamera
from spatial.errors import InputError, unknown
from spatial.frames import Base, Cam, Frame, Hc, Mako, Object, Tcp
from spatial.pose import Pose
from spatial.rotation import Array, exp_so3

FrameT = TypeVar("FrameT", bound=Frame)
CamT = TypeVar("CamT", bound=Cam)
_Z = np.array([0.0, 0.0, 1.0])


class Object1(Object):
    """The object mako sees in Eq. 4."""


class Object2(Object):
    """The object the hand-eye camera sees in Eq. 4."""


def nested(*, T_tcp_hc: Pose[Tcp, CamT], T_hc_object: Pose[CamT, Object]) -> Pose[Tcp, Object]:
    """Return the pose of an object in the tool, Eq. 1."""
    return T_tcp_hc @ T_hc_object


def flat(
    *,
    T_base_mako: Pose[Base, Mako],
    T_mako_object1: Pose[Mako, Object1],
    T_base_tcp: Pose[Base, Tcp],
    T_tcp_hc: Pose[Tcp, Hc],
    T_hc_object2: Pose[Hc, Object2],
) -> Pose[Object1, Object2]:
    """Return the pose of what the hand-eye camera sees in what mako sees, Eq. 4."""
    T_object1_base = (T_base_mako @ T_mako_object1).inverse()
    return T_object1_base @ T_base_tcp @ T_tcp_hc @ T_hc_object2


def camera_in_base(camera: SiteCamera, *, T_base_tcp: Pose[Base, Tcp]) -> Pose[Base, Cam]:
    """Return the pose of a camera of the site in the base, at the instant of `T_base_tcp`."""
    if camera.parent == "tcp":  # the site file names the frame as text, the type follows it
        return T_base_tcp @ cast("Pose[Tcp, Cam]", camera.T_parent_cam)
    return cast("Pose[Base, Cam]", camera.T_parent_cam)


def carried(
    T_cam_object: Pose[Cam, Object], *, xi_w_cam_cam: Array, dt_s: float
) -> Pose[Cam, Object]:
    """Return the pose of an object at rest in w after the camera moved on for `dt_s`, Eq. 3."""
    T_now_then: Pose[Cam, Cam] = Pose.exp(-dt_s * xi_w_cam_cam)
    return T_now_then @ T_cam_object


def root_to_base(state: SceneState, *, root: str) -> Pose[Frame, Base] | None:
    """Return the pose of the base in a display root, to draw a state in that root.

    `base` is the base with gravity down: its origin, the heading of the platform, and z up as
    the odometry knows it (the platform's z before it does). `w` and objects are those frames
    themselves; `None` while their pose is unknown.

    Args:
        state: the scene.
        root: `base`, `w` or the slug of an object.

    Raises:
        InputError: no such root.
    """
    if root == "base":
        return _upright(state)
    if root == "w":
        return None if state.T_base_w is None else _anonymous(state.T_base_w.inverse())
    nodes = {node.slug: node.T_base_object for node in state.objects}
    if root not in nodes:
        raise InputError(unknown("display root", root, ("base", "w", *nodes)))
    T_base_object = nodes[root]
    return None if T_base_object is None else _anonymous(T_base_object.inverse())


def _anonymous(T_frame_base: Pose[FrameT, Base]) -> Pose[Frame, Base]:
    return cast("Pose[Frame, Base]", T_frame_base)


def _upright(state: SceneState) -> Pose[Frame, Base]:
    T_platform_base = state.T_base_platform.inverse()
    rotation = T_platform_base.rotation
    if state.T_base_w is not None:
        up = T_platform_base.rotate(state.T_base_w.rotation @ _Z)
        axis = np.cross(up, _Z)
        sine = float(np.linalg.norm(axis))
        if sine > 0.0:
            rotation = exp_so3(np.arctan2(sine, up[2]) / sine * axis) @ rotation
    return Pose.of(rotation, np.zeros(3))


def in_tool(state: SceneState, node: ObjectNode) -> Pose[Tcp, Object] | None:
    """Return the pose of an object in the tool, as a nested node is drawn; `None` if unseen."""
    if node.T_base_object is None:
        return None
    return state.T_base_tcp.inverse() @ node.T_base_object
