"""A human hand on a joystick: late, soft, shaky and never fast.

    g(t) = goal(t - reaction)
    x'' = w^2 (g - x) - 2 w x',   |x'| <= speed         critically damped, w = 2 pi bandwidth
    R follows by at most turn dt per step;  out = (x + tremor, R)

The hand moves in a frame it holds on to: the base, or the object the operator works at, as the
page shows it. Nobody follows a sway of 1.2 Hz with a reaction time of 0.2 s; who works on a
swinging platform steers against the shown object. The hand steers the wrist, so that its turn
turns the tool about the wrist and does not sweep the whole arm.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from sim.vio import ou_step
from spatial.frames import Frame, Tcp
from spatial.pose import Pose, interpolate
from spatial.rotation import Array


class Wrist(Frame):
    """Where the last three axes of the arm meet; axes of the tcp."""


class Grip(Frame):
    """What the hand holds on to: the base, or an object as it is shown."""


WRIST_BACK_M = 0.328
"""The wrist lies this far behind the tcp along the tool [m]."""
T_tcp_wrist: Pose[Tcp, Wrist] = Pose.translated(0.0, 0.0, -WRIST_BACK_M)
_TREMOR_TAU_S = 0.03


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
    """Turns where the tool ought to be into what a human would command, both in the grip."""

    def __init__(self, model: HandModel, *, start: Pose[Grip, Tcp], seed: int) -> None:
        """Rest at a pose.

        Args:
            model: how good the operator is.
            start: pose of the tool at the beginning.
            seed: of the tremor.
        """
        self._model = model
        self._rng = np.random.default_rng(seed)
        self._pose: Pose[Grip, Wrist] = start @ T_tcp_wrist
        self._aim = self._pose
        self._velocity = np.zeros(3)
        self._tremor = np.zeros(3)
        self._seen: deque[tuple[float, Pose[Grip, Wrist]]] = deque()

    def regrip(self, T_new_old: Pose[Grip, Grip]) -> None:
        """Hold on to something else, in whose frame the old grip is at `T_new_old`."""
        self._pose = T_new_old @ self._pose
        self._aim = T_new_old @ self._aim
        self._velocity = T_new_old.rotate(self._velocity)
        self._seen = deque((at_s, T_new_old @ pose) for at_s, pose in self._seen)

    def step(self, goal: Pose[Grip, Tcp], *, now_s: float, dt_s: float) -> Pose[Grip, Tcp]:
        """Return the command for the tool.

        Args:
            goal: where the tool ought to be, as seen now.
            now_s: present time, rising [s].
            dt_s: time since the step before [s].
        """
        self._seen.append((now_s, goal @ T_tcp_wrist))
        while self._seen and self._seen[0][0] <= now_s - self._model.reaction_s:
            self._aim = self._seen.popleft()[1]
        self._move(dt_s)
        sigma = self._model.tremor_m / math.sqrt(3.0)
        noise = self._rng.standard_normal(3)
        self._tremor = ou_step(
            self._tremor, sigma=sigma, tau_s=_TREMOR_TAU_S, dt_s=dt_s, noise=noise
        )
        shaken: Pose[Grip, Wrist] = Pose.of(
            self._pose.rotation, self._pose.translation + self._tremor
        )
        return shaken @ T_tcp_wrist.inverse()

    def _move(self, dt_s: float) -> None:
        model = self._model
        w = 2.0 * math.pi * model.bandwidth_hz
        far = self._aim.translation - self._pose.translation
        pull = w * w * far - 2.0 * w * self._velocity
        self._velocity = _limited(self._velocity + pull * dt_s, model.speed_m_s)
        _, angle = self._pose.distance_to(self._aim)
        most, soft = model.turn_rad_s * dt_s, angle * (1.0 - math.exp(-w * dt_s))
        share = min(most, soft) / angle if angle > 0.0 else 0.0
        turned = interpolate(self._pose, self._aim, share)
        self._pose = Pose.of(turned.rotation, self._pose.translation + self._velocity * dt_s)


def _limited(vector: Array, most: float) -> Array:
    length = float(np.linalg.norm(vector))
    return vector if length <= most else vector * (most / length)
