"""Carry the pose of a static object along the camera's own motion: Eq. 2 and Eq. 3.

    T_cam_object(now) = T_cam_w(now) @ T_w_cam(then) @ T_cam_object(then)

Eq. 2 puts the image before and this image for `then` and `now`; Eq. 3 puts this image and the
instant shown. It is one function. The relative motion of odometry is uncertain by a random walk,
in position with a velocity error that keeps its value for about tau,

    Q(dt) = diag(q_t^2 a(dt) I, q_r^2 dt I),   a(dt) = dt - tau (1 - exp(-dt / tau))
    S_object += Ad(T_object_cam) Q Ad(T_object_cam)^T

whose lever arm turns q_r into translation. Rates reproduce the drift of a good commercial
odometry: 11 mm after 5 s, 16 mm after 10 s, and a third of a millimetre from image to image.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from spatial.frames import Cam, Frame, W
from spatial.pose import Pose
from spatial.rotation import Array
from spatial.stamp import seconds

B = TypeVar("B", bound=Frame)

TURN_PER_DOUBT = 0.1
"""Variance of orientation [rad^2] per variance of position [m^2] that a replaced jump adds."""


@dataclass(frozen=True, slots=True)
class MotionNoise:
    """How fast a pose carried by motion becomes uncertain."""

    walk_m: float = 0.005
    """Random walk of position [m/sqrt(s)]."""
    walk_rad: float = 0.0015
    """Random walk of the camera's orientation, with the object at its end [rad/sqrt(s)]."""
    turn_rad: float = 0.0
    """Random walk of the object about itself [rad/sqrt(s)]."""
    settle_s: float = 0.0
    """tau: how long the velocity error behind the walk of position keeps its value [s]."""

    def variances(self, duration_s: float, *, distance_m: float) -> tuple[float, float]:
        """Return variances of position [m^2] and turn [rad^2] that a time [s] adds.

        Args:
            duration_s: time without measurement, not negative [s].
            distance_m: camera to object, the lever arm of the walk in orientation [m].
        """
        walked_s, tau = duration_s, self.settle_s
        if tau > 0.0:
            walked_s += tau * math.expm1(-duration_s / tau)
        lever = self.walk_rad * distance_m
        position = self.walk_m**2 * walked_s + lever * lever * duration_s
        return position, duration_s * (self.walk_rad**2 + self.turn_rad**2)


STATIC = MotionNoise(settle_s=0.8)
"""A static object, carried by odometry."""
HELD = MotionNoise(walk_m=0.01, walk_rad=0.0, turn_rad=0.1)
"""A held object: kinematics carry it, but it may slip or swing in the tool."""
MOBILE = MotionNoise(walk_m=0.05, turn_rad=0.2)
"""An object that moves by itself, between images."""
UNMOVED = MotionNoise(walk_m=0.1, walk_rad=0.1)
"""A static object before a camera whose motion is not known."""


def propagate(
    T_cam_b: Pose[Cam, B], *, T_w_cam_then: Pose[W, Cam], T_w_cam_now: Pose[W, Cam]
) -> Pose[Cam, B]:
    """Return the pose of something static in the camera after the camera has moved."""
    return T_w_cam_now.inverse() @ T_w_cam_then @ T_cam_b


def growth(
    *, duration_ns: int, noise: MotionNoise, distance_m: float, doubt_m2: float = 0.0
) -> Array:
    """Return what a time without measurement adds to a covariance, its diagonal (6,).

    Args:
        duration_ns: time carried [ns]; backwards counts alike.
        noise: rates of the random walk.
        distance_m: camera to object, the lever arm of the walk in orientation [m].
        doubt_m2: variance that replaced jumps have added.
    """
    position, turn = noise.variances(abs(seconds(duration_ns)), distance_m=distance_m)
    position, turn = position + doubt_m2, turn + TURN_PER_DOUBT * doubt_m2
    return np.array([position, position, position, turn, turn, turn])
