"""Pose chains that are wrong. mypy must reject each line: an ignore it does not need is an error."""

from spatial.frames import Base, Cam, Hc, Mako, Object, Target, Tcp, W
from spatial.pose import Pose, interpolate


def chains(
    T_base_tcp: Pose[Base, Tcp],
    T_tcp_hc: Pose[Tcp, Hc],
    T_hc_object: Pose[Hc, Object],
    T_base_mako: Pose[Base, Mako],
    T_mako_object: Pose[Mako, Object],
    T_w_hc: Pose[W, Hc],
    T_x_object: Pose[Target, Object],
) -> None:
    # right, so that the file is not rejected for another reason
    T_base_object: Pose[Base, Object] = T_base_tcp @ T_tcp_hc @ T_hc_object
    T_object_base: Pose[Object, Base] = T_base_object.inverse()
    T_object_object: Pose[Object, Object] = (
        T_mako_object.inverse() @ T_base_mako.inverse() @ T_base_tcp @ T_tcp_hc @ T_hc_object
    )

    # a swapped product
    T_tcp_hc @ T_base_tcp  # type: ignore[operator]
    T_hc_object @ T_tcp_hc  # type: ignore[operator]
    # an inverse too few
    T_mako_object @ T_base_mako  # type: ignore[operator]
    T_w_hc @ T_base_tcp  # type: ignore[operator]
    # an inverse too many
    T_base_tcp @ T_tcp_hc.inverse()  # type: ignore[operator]
    T_base_tcp.inverse() @ T_tcp_hc  # type: ignore[operator]
    # the other camera
    T_tcp_hc @ T_mako_object  # type: ignore[operator]
    T_base_mako @ T_hc_object  # type: ignore[operator]
    # a factor forgotten
    T_base_tcp @ T_hc_object  # type: ignore[operator]
    T_tcp_hc @ T_x_object  # type: ignore[operator]
    # a result under the name of another
    T_tcp_base: Pose[Tcp, Base] = T_base_tcp  # type: ignore[assignment]
    T_tcp_object: Pose[Tcp, Object] = T_base_object  # type: ignore[assignment]
    T_w_object: Pose[W, Object] = T_w_hc.inverse() @ T_hc_object  # type: ignore[operator, assignment]
    # a camera is not any camera
    T_cam_object: Pose[Cam, Object] = T_hc_object  # type: ignore[assignment]
    # poses of different frames have no distance and nothing between them
    T_base_tcp.distance_to(T_tcp_hc)  # type: ignore[arg-type]
    interpolate(T_base_tcp, T_base_mako, 0.5)  # type: ignore[misc]
    # a number is no pose
    T_base_tcp @ 2.0  # type: ignore[operator]
    # points are moved by `apply`
    T_base_tcp @ T_base_tcp.translation  # type: ignore[operator]
