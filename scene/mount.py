"""Where one link of a robot is rigid to another one."""

from __future__ import annotations

from scene.kinematics import RobotJoint
from scene.robot import Robot
from spatial.errors import FileInputError, unknown
from spatial.frames import Frame
from spatial.pose import A, B, Pose


def rigid_pose(robot: Robot, *, parent: str, child: str) -> Pose[A, B]:
    """Return the pose of one link in another, over joints that never move.

    Args:
        robot: the robot; its meshes are not needed.
        parent: name of the link the pose is given in.
        child: name of the other link.

    Raises:
        FileInputError: a link it does not have, or a moving joint between the two.
    """
    for link in (parent, child):
        if link not in robot.links:
            raise FileInputError(unknown("link", link, robot.links), path=robot.path)
    joints = {joint.child: joint for joint in robot.joints}
    up_parent, up_child = _ancestors(joints, parent), _ancestors(joints, child)
    shared = {joint.child for joint in up_parent} & {joint.child for joint in up_child}
    for joint in (*up_parent, *up_child):
        if joint.moves and joint.child not in shared:
            message = f"{child!r} is not rigid to {parent!r}: joint {joint.name!r} between moves"
            raise FileInputError(message, path=robot.path)
    links = robot.fk({})
    T_root_parent: Pose[Frame, A] = Pose(links[parent].matrix)
    T_root_child: Pose[Frame, B] = Pose(links[child].matrix)
    return T_root_parent.inverse() @ T_root_child


def _ancestors(joints: dict[str, RobotJoint], link: str) -> list[RobotJoint]:
    up = []
    while link in joints:
        up.append(joints[link])
        link = joints[link].parent
    return up
