"""Forward kinematics of a tree of joints, all at once.

    T_parent_child(q) = F + sin(q) F K + (1 - cos(q)) F K^2 + d F N      (Rodrigues)

F is the joint's origin, K = [hat(a) 0; 0 0] of its axis a (revolute), N = [0 a; 0 0] (prismatic,
travel d). The four matrices are made once; a pose of the whole robot is one weighted sum over
them and one product per link.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from spatial.errors import InputError, unknown
from spatial.frames import Base, Frame
from spatial.pose import Pose
from spatial.rotation import Array, hat


@dataclass(frozen=True, slots=True)
class Mimic:
    """A joint that follows another: `q = multiplier * q_joint + offset`."""

    joint: str
    """The joint followed."""
    multiplier: float
    """Factor."""
    offset: float
    """Added [rad or m]."""


@dataclass(frozen=True, slots=True, eq=False)
class RobotJoint:
    """A joint of a robot."""

    name: str
    """Unique among joints."""
    type: str
    """`revolute`, `continuous`, `prismatic`, `fixed`, `floating` or `planar`."""
    parent: str
    """Link it is mounted on."""
    child: str
    """Link it moves."""
    lower: float | None
    """Lower limit [rad or m]; `None` without one."""
    upper: float | None
    """Upper limit [rad or m]; `None` without one."""
    velocity: float | None
    """Largest speed [rad/s or m/s]; `None` if not given."""
    effort: float | None
    """Largest torque or force [Nm or N]; `None` if not given."""
    mimic: Mimic | None
    """The joint it follows; `None` for a free one."""
    axis: Array
    """Unit axis (3,) in the joint's frame."""
    T_parent_joint: Pose[Frame, Frame]
    """Pose of the joint's frame, and of the child at zero, in the parent link."""

    @property
    def moves(self) -> bool:
        """Whether a position moves it."""
        return self.type in {"revolute", "continuous", "prismatic"}


class Kinematics:
    """Poses of all links from joint positions; made once per robot, holds no state."""

    def __init__(self, root: str, joints: Sequence[RobotJoint]) -> None:
        """Order the tree from its root and precompute the four matrices of every joint."""
        ordered = _from_root(root, joints)
        self.links = (root, *(joint.child for joint in ordered))
        place = {link: index for index, link in enumerate(self.links)}
        self._parents = [place[joint.parent] for joint in ordered]
        self._basis = np.array([_basis(joint) for joint in ordered]).reshape(-1, 4, 16)
        self._column = {joint.name: i for i, joint in enumerate(ordered) if joint.moves}
        self._slides = np.array([joint.type == "prismatic" for joint in ordered], dtype=bool)
        self._mimics = _mimic_order(ordered)

    def fk(self, positions: Mapping[str, float]) -> dict[str, Pose[Base, Frame]]:
        """Return the pose of every link in the root link.

        Args:
            positions: joint positions [rad or m]; a joint left out is at zero, or follows the
                joint it mimics. An explicit value wins over the mimic rule.

        Raises:
            InputError: an unknown joint or a value that is not finite.
        """
        q = self._vector(positions)
        weights = np.ones((len(q), 4))
        turns = np.where(self._slides, 0.0, q)
        weights[:, 1] = np.sin(turns)
        weights[:, 2] = 1.0 - np.cos(turns)
        weights[:, 3] = q - turns
        steps = np.matmul(weights[:, None, :], self._basis).reshape(-1, 4, 4)
        poses = [np.eye(4)]
        for parent, step in zip(self._parents, steps, strict=True):
            poses.append(poses[parent] @ step)
        return {link: Pose(pose) for link, pose in zip(self.links, poses, strict=True)}

    def _vector(self, positions: Mapping[str, float]) -> Array:
        q = np.zeros(len(self._parents))
        for name, value in positions.items():
            if name not in self._column:
                raise InputError(unknown("joint", name, self._column))
            q[self._column[name]] = value
        for name, mimic in self._mimics:
            if name not in positions:
                q[self._column[name]] = mimic.multiplier * q[self._column[mimic.joint]]
                q[self._column[name]] += mimic.offset
        if not np.isfinite(q).all():
            bad = {name: value for name, value in positions.items() if not np.isfinite(value)}
            raise InputError(f"joint positions {bad} are not finite")
        return q


def _from_root(root: str, joints: Sequence[RobotJoint]) -> list[RobotJoint]:
    """Order joints so that each comes after the one that carries its parent."""
    by_parent: dict[str, list[RobotJoint]] = {}
    for joint in joints:
        by_parent.setdefault(joint.parent, []).append(joint)
    ordered: list[RobotJoint] = []
    queue = [root]
    for link in queue:
        for joint in by_parent.get(link, ()):
            ordered.append(joint)
            queue.append(joint.child)
    return ordered


def _basis(joint: RobotJoint) -> Array:
    """Return the four matrices (4, 4, 4) of a joint."""
    basis = np.zeros((4, 4, 4))
    basis[0] = joint.T_parent_joint.matrix
    if joint.type == "prismatic":
        basis[3, :3, 3] = joint.T_parent_joint.rotation @ joint.axis
    elif joint.moves:
        turn = np.zeros((4, 4))
        turn[:3, :3] = hat(joint.axis)
        basis[1] = basis[0] @ turn
        basis[2] = basis[1] @ turn
    return basis


def _mimic_order(joints: Sequence[RobotJoint]) -> list[tuple[str, Mimic]]:
    """Order mimicking joints so that each comes after the one it follows."""
    rules = {joint.name: joint.mimic for joint in joints if joint.mimic and joint.moves}
    ordered: list[tuple[str, Mimic]] = []
    while rules:
        ready = [name for name, mimic in rules.items() if mimic.joint not in rules]
        ordered += [(name, rules.pop(name)) for name in ready]
    return ordered
