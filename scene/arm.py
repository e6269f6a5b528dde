"""Where the robot's links are at any instant, from joint samples that come late and in any order.

q(t) = (1 - s) q_a + s q_b           between two samples
q(t) = q_n + clamp(t - t_n) v_n      beyond the newest, for no longer than a horizon
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from scene.robot import Robot
from spatial.frames import Base, Frame
from spatial.pose import Pose
from spatial.rotation import Array
from spatial.samples import JointSample
from spatial.stamp import NS_PER_S, StampedBuffer, seconds

SPAN_NS = 2 * NS_PER_S
"""How far back joints are remembered [ns]: longer than any image is late."""
CACHED_INSTANTS = 8
"""Instants whose forward kinematics are kept: all objects of a tick share one or two."""

Links = Mapping[str, Pose[Base, Frame]]


@dataclass(frozen=True, slots=True, eq=False)
class JointState:
    """Positions and velocities in the order of the robot's free joints."""

    positions: Array
    """(n,) [rad or m]."""
    velocities: Array
    """(n,) [rad/s or m/s]."""


class ArmHistory:
    """Joint samples of the last two seconds and the forward kinematics of them."""

    def __init__(self, robot: Robot, *, horizon_ns: int) -> None:
        """Start without samples: every joint at zero.

        Args:
            robot: the robot; it has a link named `base`.
            horizon_ns: nothing is extrapolated for longer [ns].
        """
        self._robot = robot
        self._horizon_ns = horizon_ns
        self._names = tuple(j.name for j in robot.joints if j.moves and j.mimic is None)
        self._rest = JointState(np.zeros(len(self._names)), np.zeros(len(self._names)))
        self._buffer: StampedBuffer[JointState] = StampedBuffer(name="joints", span_ns=SPAN_NS)
        self._cache: dict[int, Links] = {}

    @property
    def newest_ns(self) -> int | None:
        """Stamp of the newest sample [ns], `None` before the first."""
        newest = self._buffer.newest
        return None if newest is None else newest.stamp_ns

    def put(self, sample: JointSample) -> bool:
        """Take a sample; joints it does not name keep their last position.

        Returns:
            False for one that is not usable: numbers that are not finite, arrays that do not
            fit the names, or no joint of this robot.
        """
        count = len(sample.names)
        positions, velocities = sample.positions_rad, sample.velocities_rad_s
        if len(velocities) != count:  # many drivers send none
            velocities = np.zeros(count)
        usable = len(positions) == count and np.isfinite([positions, velocities]).all()
        place = {name: index for index, name in enumerate(sample.names)}
        known = [(i, place[name]) for i, name in enumerate(self._names) if name in place]
        if not usable or not known:
            return False
        ours, theirs = np.array(known).T
        newest = self._buffer.newest
        q = (self._rest if newest is None else newest.value).positions.copy()
        v = np.zeros(len(self._names))
        q[ours], v[ours] = positions[theirs], velocities[theirs]
        if self._buffer.put(sample.stamp_ns, JointState(q, v)):
            self._cache.clear()
        return True

    def links(self, instant_ns: int) -> Links:
        """Return the pose of every link in the base at an instant [ns]."""
        if instant_ns not in self._cache:
            if len(self._cache) >= CACHED_INSTANTS:
                self._cache.clear()
            self._cache[instant_ns] = self._links(self._positions(instant_ns))
        return self._cache[instant_ns]

    def forget(self) -> None:
        """Drop every sample, as when time jumps back; the last pose stays until the next one."""
        newest = self._buffer.newest
        if newest is not None:
            self._rest = JointState(newest.value.positions, np.zeros(len(self._names)))
        self._buffer.clear()
        self._cache.clear()

    def _positions(self, instant_ns: int) -> Array:
        newest, interval = self._buffer.newest, self._buffer.interval_ns
        if newest is None or interval is None:
            return self._rest.positions
        if instant_ns >= newest.stamp_ns:
            ahead_s = seconds(min(instant_ns - newest.stamp_ns, self._horizon_ns))
            return newest.value.positions + ahead_s * newest.value.velocities
        return self._buffer.interpolate(max(instant_ns, interval[0]), _blend).positions

    def _links(self, positions: Array) -> Links:
        in_root = self._robot.fk(dict(zip(self._names, positions.tolist(), strict=True)))
        T_base_root = in_root["base"].inverse().matrix
        return {name: Pose(T_base_root @ pose.matrix) for name, pose in in_root.items()}


def _blend(older: JointState, younger: JointState, share: float) -> JointState:
    return JointState(
        (1.0 - share) * older.positions + share * younger.positions, younger.velocities
    )
