"""What a site accepts as a command: the last guard in front of the robot.

A command counts when it is finite, newer than the one before, younger than its time to live, and
it is saturated to the workspace. The set-point then walks to the goal with bounded speed:

    step = min(1, v_max dt / |t|, w_max dt / |phi|),   T' = T exp(step (t, phi))

When the time to live of the newest command has passed, the goal becomes the set-point: the tool
holds. A sender that starts anew may then count from its own first number again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np

from spatial.frames import Base, Tcp
from spatial.pose import Pose, interpolate
from spatial.samples import ToolCommand
from spatial.stamp import NS_PER_MS, NS_PER_S


@dataclass(frozen=True, slots=True)
class SafetyLimits:
    """Bounds of what the tool may be told."""

    lower_base_m: tuple[float, float, float] = (-1.1, -1.1, 0.15)
    """Least x, y, z of the tcp in base [m]."""
    upper_base_m: tuple[float, float, float] = (1.1, 1.1, 1.4)
    """Greatest x, y, z of the tcp in base [m]."""
    speed_m_s: float = 0.25
    """Fastest set-point [m/s]."""
    turn_rad_s: float = 0.8
    """Fastest turn of the set-point [rad/s]."""
    ttl_ns: int = 500 * NS_PER_MS
    """Longest time to live believed [ns], whatever the command says."""
    ahead_ns: int = NS_PER_S
    """A stamp further in the future than this is no stamp of our clock [ns]."""


class Verdict(Enum):
    """What became of a command."""

    ACCEPTED = "accepted"
    """Taken as it is."""
    SATURATED = "saturated"
    """Taken, its position moved to the edge of the workspace."""
    NOT_FINITE = "not finite"
    """Refused: a number that is not finite, or a time to live that is not positive."""
    OLD_SEQUENCE = "old sequence"
    """Refused: not newer than the command before it."""
    EXPIRED = "expired"
    """Refused: older than its time to live."""
    FROM_FUTURE = "from the future"
    """Refused: stamped far ahead of the site's clock."""


TAKEN = frozenset({Verdict.ACCEPTED, Verdict.SATURATED})
"""Verdicts that move the goal."""


@dataclass(frozen=True, slots=True, eq=False)
class GuardState:
    """What the guard remembers."""

    T_base_tcp: Pose[Base, Tcp]
    """Present set-point of the tool."""
    T_base_tcp_goal: Pose[Base, Tcp]
    """Where it walks to."""
    sequence: int | None = None
    """Number of the newest command taken; `None` while holding, when any number is new."""
    deadline_ns: int = 0
    """The tool holds from this stamp on [ns]."""

    @property
    def holding(self) -> bool:
        """Whether no living command is in force."""
        return self.sequence is None


def initial_state(T_base_tcp: Pose[Base, Tcp]) -> GuardState:
    """Return the state that holds the tool where it is."""
    return GuardState(T_base_tcp, T_base_tcp)


def accept(
    limits: SafetyLimits, *, state: GuardState, command: ToolCommand, now_ns: int
) -> tuple[GuardState, Verdict]:
    """Weigh one command; return the state after it and what became of it.

    Args:
        limits: bounds.
        state: state before.
        command: what came.
        now_ns: the site's clock [ns].
    """
    verdict = _refusal(limits, state, command, now_ns)
    if verdict is not None:
        return state, verdict
    goal = command.T_base_tcp
    low, high = np.array(limits.lower_base_m), np.array(limits.upper_base_m)
    inside = np.clip(goal.translation, low, high)
    saturated = bool((inside != goal.translation).any())
    if saturated:
        goal = Pose.of(goal.rotation, inside)
    deadline_ns = command.stamp_ns + min(command.ttl_ns, limits.ttl_ns)
    state = GuardState(state.T_base_tcp, goal, command.sequence, deadline_ns)
    return state, Verdict.SATURATED if saturated else Verdict.ACCEPTED


def advance(limits: SafetyLimits, *, state: GuardState, now_ns: int, dt_s: float) -> GuardState:
    """Walk the set-point by `dt_s` [s], or hold when the newest command has outlived itself."""
    if state.holding:
        return state
    if now_ns >= state.deadline_ns:
        return initial_state(state.T_base_tcp)
    far, turn = state.T_base_tcp.distance_to(state.T_base_tcp_goal)
    longest = max(far / limits.speed_m_s, turn / limits.turn_rad_s)
    if longest <= dt_s:
        return replace(state, T_base_tcp=state.T_base_tcp_goal)
    step = interpolate(state.T_base_tcp, state.T_base_tcp_goal, dt_s / longest)
    return replace(state, T_base_tcp=step)


def _refusal(
    limits: SafetyLimits, state: GuardState, command: ToolCommand, now_ns: int
) -> Verdict | None:
    if not command.T_base_tcp.is_finite() or command.ttl_ns <= 0:
        return Verdict.NOT_FINITE
    if command.stamp_ns > now_ns + limits.ahead_ns:
        return Verdict.FROM_FUTURE
    if now_ns >= command.stamp_ns + min(command.ttl_ns, limits.ttl_ns):
        return Verdict.EXPIRED
    if state.sequence is not None and command.sequence <= state.sequence:
        return Verdict.OLD_SEQUENCE
    return None
