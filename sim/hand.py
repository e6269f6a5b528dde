"""A human hand on a joystick: late, soft, shaky and never fast.

    g_i = goal(t - reaction) + lead d/dt goal          what the hand aims at
    x'' = w^2 (g - x) - 2 w x',   |x'| <= speed         critically damped, w = 2 pi bandwidth
    R follows by at most turn dt per step;  out = (x + tremor, R)

The lead is how a practised operator follows a slow sway in spite of the reaction time; it sees
only the slow part, low-passed. The hand steers the wrist, so that a turn of the hand is a turn of
the tool about the wrist and not a sweep of the whole arm.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from sim.vio import ou_step
from spatial.frames import Base, Frame, Tcp
from spatial.pose import Pose, interpolate
from spatial.rotation import Array


class Wrist(Frame):
    """Where the last three axes of the arm meet; axes of the tcp."""


WRIST_BACK_M = 0.328
"""The wrist lies this far behind the tcp along the tool [m]."""
T_tcp_wrist: Pose[Tcp, Wrist] = Pose.translated(0.0, 0.0, -WRIST_BACK_M)
_TREMOR_TAU_S = 0.03
_LEAD_TAU_S = 0.4


@dataclass(frozen=True, slots=True)
class HandModel:
    """How good an operator is."""

    reaction_s: float = 0.2
    """Time from seeing to acting [s]."""
    bandwidth_hz: float = 2.5
    """Bandwidth of the motion [Hz]."""
    tremor_m: float = 0.0015
    """Standard deviation of the tremor over three axes [m]."""
    speed_m_s: float = 0.1
    """Fastest motion of the wrist [m/s]."""
    turn_rad_s: float = 0.7
    """Fastest turn [rad/s]."""


class Hand:
    """Turns where the tool ought to be into what a human would command."""

    def __init__(self, model: HandModel, *, start: Pose[Base, Tcp], seed: int) -> None:
        """Rest at a pose.

        Args:
            model: how good the operator is.
            start: pose of the tool at the beginning.
            seed: of the tremor.
        """
        self._model = model
        self._rng = np.random.default_rng(seed)
        self._pose: Pose[Base, Wrist] = start @ T_tcp_wrist
        self._velocity = np.zeros(3)
        self._tremor = np.zeros(3)
        self._seen: deque[tuple[float, Pose[Base, Wrist]]] = deque()
        self._aim = self._pose
        self._drift = np.zeros(3)

    def step(self, goal: Pose[Base, Tcp], *, now_s: float, dt_s: float) -> Pose[Base, Tcp]:
        """Return the command for the tool.

        Args:
            goal: where the tool ought to be, as seen now.
            now_s: present time, rising [s].
            dt_s: time since the step before [s].
        """
        self._look(goal @ T_tcp_wrist, now_s=now_s, dt_s=dt_s)
        self._move(dt_s)
        sigma = self._model.tremor_m / math.sqrt(3.0)
        self._tremor = ou_step(
            self._tremor,
            sigma=sigma,
            tau_s=_TREMOR_TAU_S,
            dt_s=dt_s,
            noise=self._rng.standard_normal(3),
        )
        shaken: Pose[Base, Wrist] = Pose.of(
            self._pose.rotation, self._pose.translation + self._tremor
        )
        return shaken @ T_tcp_wrist.inverse()

    def _look(self, goal: Pose[Base, Wrist], *, now_s: float, dt_s: float) -> None:
        """Take in what was seen a reaction time ago, and how it was moving."""
        self._seen.append((now_s, goal))
        before = self._aim.translation
        while self._seen and self._seen[0][0] <= now_s - self._model.reaction_s:
            self._aim = self._seen.popleft()[1]
        if dt_s > 0.0:
            moving = _limited((self._aim.translation - before) / dt_s, self._model.speed_m_s)
            self._drift += (1.0 - math.exp(-dt_s / _LEAD_TAU_S)) * (moving - self._drift)

    def _move(self, dt_s: float) -> None:
        model = self._model
        lead_s = model.reaction_s + 1.0 / (math.pi * model.bandwidth_hz)
        aim = self._aim.translation + lead_s * self._drift
        w = 2.0 * math.pi * model.bandwidth_hz
        pull = w * w * (aim - self._pose.translation) - 2.0 * w * self._velocity
        self._velocity = _limited(self._velocity + pull * dt_s, model.speed_m_s)
        _, angle = self._pose.distance_to(self._aim)
        most = model.turn_rad_s * dt_s
        soft = angle * (1.0 - math.exp(-w * dt_s))
        share = min(most, soft) / angle if angle > 0.0 else 0.0
        turned = interpolate(self._pose, self._aim, share)
        position = self._pose.translation + self._velocity * dt_s
        self._pose = Pose.of(turned.rotation, position)


def _limited(vector: Array, most: float) -> Array:
    length = float(np.linalg.norm(vector))
    return vector if length <= most else vector * (most / length)
