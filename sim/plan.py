"""What the scripted operator means to do, phase by phase, in terms of what the page shows.

A phase says where the tool ought to be: against the pose it started from, or against the handle
of the target as the tracker shows it. Following a shown object is what compensates the sway.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sim.hand import T_tcp_wrist, Wrist
from spatial.frames import Base, Object, Tcp
from spatial.pose import Pose
from spatial.rotation import exp_so3


@dataclass(frozen=True, slots=True)
class Phase:
    """One thing the operator does for a while."""

    name: str
    """What it does."""
    lasts_s: float
    """For how long [s]."""
    at_target: bool
    """Whether it goes to the target's handle or stays near where it started."""
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Of the tcp, in axes of the tool at the start, from the handle or from the start [m]."""
    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Turn of the hand about the wrist, rotation vector in tool axes [deg]."""
    wander_m: float = 0.0
    """Amplitude of a slow search motion across the tool [m]."""
    wander_deg: float = 0.0
    """Amplitude of the search by turning the tool [deg]."""


@dataclass(frozen=True, slots=True)
class Plan:
    """Phases in order; after the last one it goes on with phase `again`."""

    phases: tuple[Phase, ...]
    """What is done."""
    again: int
    """Index of the first phase of the loop."""

    def at(self, time_s: float) -> Phase:
        """Return the phase at a time since the start [s]."""
        lasts = [phase.lasts_s for phase in self.phases]
        once, whole = sum(lasts[: self.again]), sum(lasts)
        if time_s >= whole:
            time_s = once + (time_s - whole) % (whole - once)
        for phase in self.phases:
            if time_s < phase.lasts_s:
                return phase
            time_s -= phase.lasts_s
        return self.phases[-1]


AWAY = Phase("turn away", 8.5, at_target=False, turn_deg=(0.0, -80.0, 0.0), wander_deg=2.0)
PICK = Plan(
    (
        Phase("look around", 9.0, at_target=False, wander_m=0.04, wander_deg=4.0),
        Phase("approach", 6.5, at_target=True, offset_m=(-0.12, 0.0, -0.20), wander_m=0.01),
        AWAY,
        Phase("look again", 5.0, at_target=True, offset_m=(-0.12, 0.0, -0.20), wander_m=0.01),
        Phase("lower", 5.0, at_target=True, offset_m=(-0.12, 0.0, 0.03)),
        Phase("under the handle", 7.0, at_target=True, offset_m=(0.0, 0.0, 0.03)),
        Phase("hold", 6.0, at_target=True, offset_m=(0.0, 0.0, 0.02), wander_m=0.004),
        Phase("back out", 4.0, at_target=True, offset_m=(-0.12, 0.0, 0.03)),
        Phase("lift", 5.0, at_target=True, offset_m=(-0.12, 0.0, -0.20)),
        Phase("look around", 6.0, at_target=False, wander_m=0.04, wander_deg=4.0),
    ),
    again=3,
)
"""Brings the hook under the handle; between second 15 and 30 it looks away for over five."""
IDLE = Plan((Phase("look around", 10.0, at_target=False, wander_m=0.04, wander_deg=4.0),), again=0)
"""Looks about and touches nothing."""
PLANS = {"pick": PICK, "idle": IDLE}


def goal(
    phase: Phase,
    *,
    time_s: float,
    T_base_tcp_start: Pose[Base, Tcp],
    T_base_handle: Pose[Base, Object] | None,
) -> Pose[Base, Tcp]:
    """Return where the tool ought to be.

    Args:
        phase: what is done.
        time_s: time since the start [s].
        T_base_tcp_start: where the tool was at the start; its axes are those of every offset.
        T_base_handle: the handle as shown now; without one the tool stays near its start.
    """
    R_start = T_base_tcp_start.rotation
    anchor = T_base_tcp_start.translation
    offset = np.array(phase.offset_m)
    if phase.at_target:
        if T_base_handle is None:
            offset = np.zeros(3)
        else:
            anchor = T_base_handle.translation
    swing = np.array([math.sin(0.9 * time_s), math.sin(0.63 * time_s + 1.0), 0.0])
    position = anchor + R_start @ (offset + phase.wander_m * swing)
    nod = phase.wander_deg * np.array([math.sin(0.71 * time_s), math.sin(0.53 * time_s), 0.0])
    upright: Pose[Base, Tcp] = Pose.of(R_start, position)
    turn: Pose[Wrist, Wrist] = Pose.of(exp_so3(np.radians(nod + phase.turn_deg)), np.zeros(3))
    return upright @ T_tcp_wrist @ turn @ T_tcp_wrist.inverse()
