"""What the scripted operator means to do, phase by phase, in terms of what the page shows.

    T_base_tcp = exp(turn) about the wrist @ (T_base_object @ T_object_frame)     at the target
    T_base_tcp = exp(turn) about the wrist @ T_base_tcp_start                     else

A named frame of the target is a pose of the tool there. Following a shown object is what
compensates the sway.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sim.hand import T_tcp_wrist, Wrist
from spatial.frames import Base, Tcp
from spatial.pose import Pose
from spatial.rotation import exp_so3


@dataclass(frozen=True, slots=True)
class Phase:
    """One thing the operator does for a while."""

    name: str
    """What it does."""
    lasts_s: float
    """For how long [s]."""
    frame: str | None = None
    """Named frame of the target where the tool goes; `None`: where it was at the start."""
    shift_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Shift of the hand from there, in base axes [m]."""
    turn_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Turn of the hand about the wrist, rotation vector in base axes [deg]."""
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


AWAY = Phase(
    "turn away",
    10.0,
    shift_m=(0.07, -0.10, -0.30),
    turn_deg=(0.0, 65.0, 0.0),
    wander_deg=2.0,
)
"""The arm's camera looks ahead, the arm itself stands between the other one and the hole plate."""
PICK = Plan(
    (
        Phase("look around", 9.0, wander_m=0.04, wander_deg=4.0),
        Phase("approach", 6.5, frame="above", wander_m=0.01),
        AWAY,
        Phase("look again", 5.0, frame="above", wander_m=0.01),
        Phase("lower beside the handle", 5.0, frame="beside"),
        Phase("slide below the handle", 5.0, frame="below"),
        Phase("hook the handle", 6.0, frame="grasp", wander_m=0.003),
        Phase("unhook", 4.0, frame="below"),
        Phase("back out", 4.0, frame="beside"),
        Phase("lift", 5.0, frame="above"),
        Phase("look around", 6.0, wander_m=0.04, wander_deg=4.0),
    ),
    again=3,
)
"""Brings the hook under the handle; between second 15 and 30 it looks away for over five."""
IDLE = Plan((Phase("look around", 10.0, wander_m=0.04, wander_deg=4.0),), again=0)
"""Looks about and touches nothing."""
PLANS = {"pick": PICK, "idle": IDLE}
"""Plans by name."""


def goal(
    phase: Phase,
    *,
    time_s: float,
    T_base_tcp_start: Pose[Base, Tcp],
    Ts_base_frame: Mapping[str, Pose[Base, Tcp]],
) -> Pose[Base, Tcp]:
    """Return where the tool ought to be.

    Args:
        phase: what is done.
        time_s: time since the start [s].
        T_base_tcp_start: where the tool was at the start.
        Ts_base_frame: named frames of the target as shown now; empty while it was never seen,
            and the tool stays near its start.
    """
    anchor = T_base_tcp_start
    if phase.frame is not None:
        anchor = Ts_base_frame.get(phase.frame, T_base_tcp_start)
    across = np.array([math.sin(0.9 * time_s), math.sin(0.63 * time_s + 1.0), 0.0])
    nod = phase.wander_deg * np.array([math.sin(0.71 * time_s), math.sin(0.53 * time_s), 0.0])
    searching: Pose[Tcp, Tcp] = Pose.of(np.eye(3), phase.wander_m * across)
    T_base_wrist = anchor @ searching @ T_tcp_wrist
    turned: Pose[Base, Wrist] = Pose.of(
        exp_so3(np.radians(nod + phase.turn_deg)) @ T_base_wrist.rotation,
        T_base_wrist.translation + phase.shift_m,
    )
    return turned @ T_tcp_wrist.inverse()
