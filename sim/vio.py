"""Visual-inertial odometry with the errors a real one has, at four quality levels.

Per sample, true displacement dp and the error states (v, psi, tilt, saw) give the reported pose:

    dv = -v dt / tau + sigma_v sqrt(2 dt / tau) n          velocity error, Ornstein-Uhlenbeck
    p' = p + Rz(psi) (1 + s) dp + v dt                     integrated, s: scale error
    psi' = psi + b dt                                      yaw drifts with a constant bias b
    R' = Rz(psi) exp(tilt) R                               roll and pitch stay bounded by gravity
    out = (p' + saw + noise, R' exp(noise))                saw: ramp reset at each visual update

so that Var[p'_axis](t) = 2 sigma_v^2 tau^2 (t / tau - 1 + exp(-t / tau)) for a camera at rest.
Jumps and drop-outs are Poisson processes; a long drop-out restarts in a new world (reset_count).
Magnitudes: EuRoC noise densities and the manual of a commercial 200 Hz sensor.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from spatial.errors import InputError, unknown
from spatial.frames import Cam, W
from spatial.pose import Pose
from spatial.rotation import Array, exp_so3
from spatial.samples import MotionSample
from spatial.stamp import seconds

VISUAL_UPDATE_S = 1.0 / 12.0
"""Period of the visual correction that resets the sawtooth [s]."""
RESET_AFTER_S = 1.5
"""A drop-out longer than this ends the world frame [s]."""
VELOCITY_NOISE_M_S = 5e-3
"""White noise of the reported velocity, per axis [m/s]."""
RATE_NOISE_RAD_S = 2.4e-3
"""White noise of the reported angular rate, per axis [rad/s]."""
ACCELERATION_NOISE_M_S2 = 0.03
"""White noise of the reported acceleration, per axis [m/s^2]."""


@dataclass(frozen=True, slots=True)
class VioLevel:
    """How good the odometry is."""

    sigma_v_m_s: float
    """Standard deviation of the velocity error, per axis [m/s]."""
    tau_s: float
    """Its correlation time [s]."""
    yaw_bias_rad_s: float
    """Magnitude of the yaw rate bias [rad/s]."""
    scale: float
    """Standard deviation of the scale error [1]."""
    tilt_rad: float
    """Standard deviation of roll and of pitch [rad]."""
    sawtooth_m_s: float
    """Standard deviation of the ramp between visual updates, per axis [m/s]."""
    position_noise_m: float
    """White noise of the reported position, per axis [m]."""
    jump_rate_hz: float = 0.0
    """Mean rate of jumps [1/s]."""
    drop_rate_hz: float = 0.0
    """Mean rate of drop-outs [1/s]."""
    jump_m: tuple[float, float] = (0.010, 0.050)
    """Smallest and largest jump [m]."""
    jump_rad: tuple[float, float] = (math.radians(0.2), math.radians(1.0))
    """Smallest and largest turn of a jump about the vertical [rad]."""
    flagged_share: float = 0.8
    """Share of the jumps the odometry itself reports."""
    drop_s: tuple[float, float] = (0.2, 2.0)
    """Shortest and longest drop-out [s]."""


LEVELS = {
    "good": VioLevel(1e-3, 2.0, 1e-4, 0.003, math.radians(0.1), 2e-3, 1e-4),
    "nominal": VioLevel(3e-3, 2.0, 3e-4, 0.005, math.radians(0.15), 4e-3, 2e-4),
    # 3 s rather than 2 s: only then does it drift by the 148 mm in a minute expected of it
    "degraded": VioLevel(
        8e-3,
        3.0,
        1e-3,
        0.01,
        math.radians(0.2),
        8e-3,
        4e-4,
        jump_rate_hz=1 / 60,
        drop_rate_hz=1 / 60,
    ),
    "bad": VioLevel(
        2e-2,
        4.0,
        3e-3,
        0.02,
        math.radians(0.3),
        2e-2,
        8e-4,
        jump_rate_hz=1 / 30,
        drop_rate_hz=1 / 30,
    ),
}
"""Quality levels by name."""
_TILT_TAU_S = 5.0


def level_named(name: str) -> VioLevel:
    """Return a quality level by name.

    Raises:
        InputError: unknown name.
    """
    if name not in LEVELS:
        raise InputError(unknown("VIO level", name, LEVELS))
    return LEVELS[name]


def ou_step(x: Array, *, sigma: float, tau_s: float, dt_s: float, noise: Array) -> Array:
    """Advance an Ornstein-Uhlenbeck process of any shape exactly by `dt_s`.

    Args:
        x: state, any shape.
        sigma: stationary standard deviation, in the unit of `x`.
        tau_s: correlation time [s].
        dt_s: step [s].
        noise: independent standard normal numbers of the shape of `x`.
    """
    keep = math.exp(-dt_s / tau_s)
    return keep * x + sigma * math.sqrt(1.0 - keep * keep) * noise


class Vio:
    """Turns the true motion of a camera into what an odometry would report of it."""

    def __init__(self, level: VioLevel, *, seed: int) -> None:
        """Start a world of its own: origin at the first pose, random heading.

        Args:
            level: quality.
            seed: seeds every random number.
        """
        self._level = level
        self._rng = np.random.default_rng(seed)
        self._reset_count = 0
        self._stamp_ns: int | None = None
        self._p_true = np.zeros(3)
        self._silent_until_ns = 0
        self._silent_s = 0.0
        self._start_world(np.zeros(3))

    @property
    def reset_count(self) -> int:
        """How often the world has started anew."""
        return self._reset_count

    def step(
        self,
        stamp_ns: int,
        *,
        T_w_cam: Pose[W, Cam],
        xi_w_cam_cam: Array,
        acceleration_cam: Array,
    ) -> MotionSample | None:
        """Report one sample, or `None` during a drop-out.

        Args:
            stamp_ns: capture stamp [ns], rising from call to call.
            T_w_cam: true pose in the simulator's world.
            xi_w_cam_cam: true body twist (6,) [m/s, rad/s].
            acceleration_cam: true acceleration (3,) without gravity, in camera axes [m/s^2].
        """
        if self._stamp_ns is None:
            self._start_world(T_w_cam.translation)
            self._stamp_ns = stamp_ns
        dt_s = seconds(stamp_ns - self._stamp_ns)
        self._stamp_ns = stamp_ns
        noise = self._rng.standard_normal(26)
        self._drift(dt_s, p_true=T_w_cam.translation, noise=noise)
        flagged = self._maybe_jump(dt_s)
        if self._silent(stamp_ns, dt_s=dt_s, p_true=T_w_cam.translation):
            return None
        return self._report(
            stamp_ns, T_w_cam.rotation, xi_w_cam_cam, acceleration_cam, noise=noise, flagged=flagged
        )

    def _start_world(self, p_true: Array) -> None:
        rng, level = self._rng, self._level
        self._position = np.zeros(3)
        self._p_true = np.array(p_true)
        self._velocity_error = level.sigma_v_m_s * rng.standard_normal(3)
        self._tilt = level.tilt_rad * rng.standard_normal(2)
        self._yaw = float(rng.uniform(-math.pi, math.pi))
        self._yaw_bias = level.yaw_bias_rad_s * float(rng.choice((-1.0, 1.0)))
        self._scale = level.scale * float(rng.standard_normal())
        self._saw_rate = np.zeros(3)
        self._saw_age_s = 0.0

    def _drift(self, dt_s: float, *, p_true: Array, noise: Array) -> None:
        level = self._level
        self._velocity_error = ou_step(
            self._velocity_error,
            sigma=level.sigma_v_m_s,
            tau_s=level.tau_s,
            dt_s=dt_s,
            noise=noise[0:3],
        )
        self._tilt = ou_step(
            self._tilt, sigma=level.tilt_rad, tau_s=_TILT_TAU_S, dt_s=dt_s, noise=noise[3:5]
        )
        self._yaw += self._yaw_bias * dt_s
        moved = (1.0 + self._scale) * (p_true - self._p_true)
        self._position = self._position + _yawed(self._yaw, moved) + self._velocity_error * dt_s
        self._p_true = np.array(p_true)
        self._saw_age_s += dt_s
        if self._saw_age_s >= VISUAL_UPDATE_S:
            self._saw_age_s %= VISUAL_UPDATE_S
            self._saw_rate = level.sawtooth_m_s * noise[5:8]

    def _maybe_jump(self, dt_s: float) -> bool:
        """Jump or not; return whether the odometry suspects it."""
        level, rng = self._level, self._rng
        if level.jump_rate_hz == 0.0 or rng.random() >= level.jump_rate_hz * dt_s:
            return False
        direction = rng.standard_normal(3)
        direction /= np.linalg.norm(direction)
        self._position = self._position + rng.uniform(*level.jump_m) * direction
        self._yaw += float(rng.uniform(*level.jump_rad) * rng.choice((-1.0, 1.0)))
        return bool(rng.random() < level.flagged_share)

    def _silent(self, stamp_ns: int, *, dt_s: float, p_true: Array) -> bool:
        """Return whether nothing is reported now; a long silence ends the world."""
        level, rng = self._level, self._rng
        if stamp_ns < self._silent_until_ns:
            self._silent_s += dt_s
            return True
        if self._silent_s > RESET_AFTER_S:
            self._reset_count += 1
            self._start_world(p_true)
        self._silent_s = 0.0
        if level.drop_rate_hz == 0.0 or rng.random() >= level.drop_rate_hz * dt_s:
            return False
        self._silent_until_ns = stamp_ns + round(1e9 * rng.uniform(*level.drop_s))
        return True

    def _report(
        self,
        stamp_ns: int,
        R_w_cam: Array,
        xi: Array,
        acceleration: Array,
        *,
        noise: Array,
        flagged: bool,
    ) -> MotionSample:
        level = self._level
        tilt = exp_so3((self._tilt[0], self._tilt[1], 0.0))
        rotation = _yaw_matrix(self._yaw) @ tilt @ R_w_cam
        jitter = exp_so3(0.1 * RATE_NOISE_RAD_S * noise[17:20])
        position = (
            self._position + self._saw_rate * self._saw_age_s + level.position_noise_m * noise[8:11]
        )
        twist = np.concatenate(
            (
                xi[:3] + rotation.T @ self._velocity_error + VELOCITY_NOISE_M_S * noise[11:14],
                xi[3:] + RATE_NOISE_RAD_S * noise[14:17],
            )
        )
        return MotionSample(
            stamp_ns=stamp_ns,
            T_w_cam=Pose.of(rotation @ jitter, position),
            xi_w_cam_cam=twist,
            acceleration_cam=acceleration + ACCELERATION_NOISE_M_S2 * noise[20:23],
            reset_count=self._reset_count,
            jump_flagged=flagged,
        )


def drift_sigma_m(level: VioLevel, duration_s: float) -> float:
    """Return the expected drift per axis [m] of a camera at rest after `duration_s`."""
    ratio = duration_s / level.tau_s
    growth = ratio - 1.0 + math.exp(-ratio)
    return level.sigma_v_m_s * level.tau_s * math.sqrt(2.0 * growth)


def _yaw_matrix(yaw: float) -> Array:
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _yawed(yaw: float, vector: Array) -> Array:
    return _yaw_matrix(yaw) @ vector
