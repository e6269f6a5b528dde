"""Where a link is rigid to another one, read from a URDF without its meshes."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np

from spatial.errors import FileInputError, unknown
from spatial.frames import Frame
from spatial.pose import A, B, Pose
from spatial.rotation import exp_so3

_X, _Y, _Z = np.eye(3)


def rigid_pose(urdf: Path, *, parent: str, child: str) -> Pose[A, B]:
    """Return the pose of one link in another, over fixed joints only.

    Args:
        urdf: the robot's file.
        parent: name of the link the pose is given in.
        child: name of the other link.

    Raises:
        FileInputError: not a URDF, a link it does not have, or a moving joint between the two.
    """
    joints = _joints(urdf)
    up_parent, up_child = _ancestors(joints, parent, urdf), _ancestors(joints, child, urdf)
    common = next((link for link in up_child if link in up_parent), None)
    if common is None:
        raise FileInputError(f"links {parent!r} and {child!r} are not connected", path=urdf)
    T_common_parent: Pose[Frame, A] = _chain(joints, up_parent[: up_parent.index(common)], urdf)
    T_common_child: Pose[Frame, B] = _chain(joints, up_child[: up_child.index(common)], urdf)
    return T_common_parent.inverse() @ T_common_child


def _joints(urdf: Path) -> dict[str, ET.Element]:
    """Return the joints of a URDF by their child link, and check that links exist."""
    try:
        text = urdf.read_bytes()
        if b"<!DOCTYPE" in text:
            raise FileInputError("a robot description has no DOCTYPE", path=urdf)
        root = ET.fromstring(text)  # noqa: S314 -- entities need a DOCTYPE, refused above
    except OSError as error:
        raise FileInputError(f"cannot be read: {error.strerror}", path=urdf) from error
    except ET.ParseError as error:
        line = error.position[0]
        raise FileInputError(f"is not XML: {error}", path=urdf, line=line) from error
    return {_link(joint, "child", urdf): joint for joint in root.findall("joint")}


def _link(joint: ET.Element, role: str, urdf: Path) -> str:
    element = joint.find(role)
    name = element.get("link") if element is not None else None
    if name is None:
        message = f"joint {joint.get('name')!r} has no <{role} link=...>"
        raise FileInputError(message, path=urdf)
    return name


def _ancestors(joints: dict[str, ET.Element], link: str, urdf: Path) -> list[str]:
    names = {*joints, *(_link(joint, "parent", urdf) for joint in joints.values())}
    if link not in names:
        raise FileInputError(unknown("link", link, names), path=urdf)
    up = [link]
    while up[-1] in joints:
        up.append(_link(joints[up[-1]], "parent", urdf))
        if len(up) > len(names):
            raise FileInputError(f"the joints above link {link!r} form a circle", path=urdf)
    return up


def _chain(joints: dict[str, ET.Element], links: list[str], urdf: Path) -> Pose[A, B]:
    matrix = np.eye(4)
    for link in links:
        joint = joints[link]
        if joint.get("type") != "fixed":
            message = f"joint {joint.get('name')!r} above link {link!r} moves; a camera is rigid"
            raise FileInputError(message, path=urdf)
        matrix = _origin(joint, urdf).matrix @ matrix
    return Pose.of(matrix[:3, :3], matrix[:3, 3])


def _origin(joint: ET.Element, urdf: Path) -> Pose[Frame, Frame]:
    """Return the pose of a joint's child in its parent: xyz, then roll pitch yaw about x y z."""
    origin = joint.find("origin")
    attributes = {} if origin is None else origin.attrib
    values = []
    for name in ("xyz", "rpy"):
        try:
            numbers = [float(word) for word in attributes.get(name, "0 0 0").split()]
        except ValueError:
            numbers = []
        if len(numbers) != 3 or not np.isfinite(numbers).all():
            message = f"joint {joint.get('name')!r}: {name} must be three finite numbers"
            raise FileInputError(message, path=urdf)
        values.append(numbers)
    xyz, (roll, pitch, yaw) = values
    return Pose.of(exp_so3(yaw * _Z) @ exp_so3(pitch * _Y) @ exp_so3(roll * _X), xyz)
