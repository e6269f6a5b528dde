"""Control at the site: the arm as a Cartesian spring, the platform damped by its propellers.

Arm, in world axes, e and v of the tool against the base (Ott, Cartesian Impedance Control, 2008):

    tau = J^T (K e - D v) + N (k_n (q_0 - q) - d_n dq) + g(q) + limits
    N = 1 - J^T Jbar^T,   Jbar = M^-1 J^T (J M^-1 J^T)^-1

The commanded pose is followed no faster than `TOOL_SPEED_M_S` and `TOOL_TURN_RAD_S`. Without the
platform's damping a tool held in the world would set the platform swinging ever more, so damping
is part of the plant. It acts against moving air: gusts keep the platform swaying at will.

    F = -D_p (v - v_air),   T = -D_r (w - w_air) - K_yaw yaw + winches
"""

from __future__ import annotations

import math

import mujoco
import numpy as np

from sim.model import SiteModel
from sim.world import World
from spatial.frames import Base, Tcp
from spatial.pose import Pose
from spatial.rotation import Array, exp_so3, log_so3

CONTROL_EVERY = 2
"""Physics steps per control step: 500 Hz."""
STIFFNESS = np.array([1500.0, 1500.0, 1500.0, 120.0, 120.0, 120.0])
"""K [N/m, N m/rad]."""
DAMPING = np.array([80.0, 80.0, 80.0, 9.0, 9.0, 9.0])
"""D [N s/m, N m s/rad]."""
NULL_STIFFNESS, NULL_DAMPING = 12.0, 5.0
"""k_n [N m/rad] and d_n [N m s/rad]."""
LIMIT_MARGIN_RAD, LIMIT_STIFFNESS = 0.17, 120.0
"""A joint closer than this to its limit is pushed back by this spring."""
TOOL_SPEED_M_S, TOOL_TURN_RAD_S = 0.25, 0.8
"""Fastest move of the commanded pose."""
FURTHEST_M, FURTHEST_RAD = 0.08, 0.35
"""The spring pulls as if the error were at most this: what bounds its force."""
AIR_DAMPING = np.array([150.0, 150.0])
"""D_p [N s/m] and D_r [N m s/rad] of the propellers."""
YAW_STIFFNESS = 220.0
"""K_yaw [N m/rad]: the propellers hold the heading."""
WINCH_S = 1.5
"""Time constant of the winches that bring the centre of mass under the hook [s]."""
FAST_GAIN = 2.5
"""Air speed per speed of rocking wanted, found by measurement."""
_SOFT = 1e-4 * np.eye(6)


class ArmControl:
    """Impedance control of the arm towards a commanded pose of the tool in its base."""

    def __init__(self, site: SiteModel, *, posture_rad: Array, start: Pose[Base, Tcp]) -> None:
        """Hold a pose.

        Args:
            site: the model.
            posture_rad: joint positions (n,) the elbow prefers.
            start: pose of the tool at the beginning.
        """
        self._site = site
        self._posture = posture_rad
        self._commanded = start
        self.T_base_target = start
        joints = site.arm_joints
        self._lower = np.array([-np.inf if j.lower is None else j.lower for j in joints])
        self._upper = np.array([np.inf if j.upper is None else j.upper for j in joints])
        self._effort = np.array([np.inf if j.effort is None else j.effort for j in joints])
        nv = site.model.nv
        self._jacobian = np.zeros((6, nv))
        self._mass = np.zeros((nv, nv))
        self._block = np.ix_(site.arm_dof, site.arm_dof)

    def command(self, T_base_tcp: Pose[Base, Tcp]) -> None:
        """Go there, as fast as the tool is allowed to."""
        self._commanded = T_base_tcp

    def torques(self, data: mujoco.MjData, *, dt_s: float) -> Array:
        """Return joint torques (n,) [N m] and advance the rate-limited target."""
        site = self._site
        self.T_base_target = _towards(self.T_base_target, self._commanded, dt_s=dt_s)
        jacobian = self._jacobian_of_tool(data)
        position, speed = data.qpos[site.arm_qpos], data.qvel[site.arm_dof]
        wrench = STIFFNESS * self._error(data) - DAMPING * (jacobian @ speed)
        mujoco.mj_fullM(site.model, data, self._mass)
        null = NULL_STIFFNESS * (self._posture - position) - NULL_DAMPING * speed
        null += LIMIT_STIFFNESS * (
            np.maximum(0.0, self._lower + LIMIT_MARGIN_RAD - position)
            - np.maximum(0.0, position - self._upper + LIMIT_MARGIN_RAD)
        )
        wanted = jacobian.T @ wrench + _projected(null, jacobian, self._mass[self._block])
        wanted += data.qfrc_bias[site.arm_dof]
        return np.asarray(np.clip(wanted, -self._effort, self._effort))

    def _jacobian_of_tool(self, data: mujoco.MjData) -> Array:
        """Return the Jacobian (6, n) of the tool against the base, in world axes."""
        mujoco.mj_jacBody(
            self._site.model, data, self._jacobian[:3], self._jacobian[3:], self._site.tool
        )
        return self._jacobian[:, self._site.arm_dof]

    def _error(self, data: mujoco.MjData) -> Array:
        """Return target less tool (6,): position [m], rotation vector [rad], in world axes."""
        base, tool = self._site.base, self._site.tool
        R_w_base = data.xmat[base].reshape(3, 3)
        target = self.T_base_target
        shift = R_w_base @ target.translation + data.xpos[base] - data.xpos[tool]
        turn = log_so3(R_w_base @ target.rotation @ data.xmat[tool].reshape(3, 3).T)
        return np.concatenate((_bounded(shift, FURTHEST_M), _bounded(turn, FURTHEST_RAD)))


class PlatformControl:
    """Propellers, winches and gusts: one wrench on the platform."""

    def __init__(self, site: SiteModel, *, world: World, seed: int) -> None:
        """Start at rest; the seed gives the phases of the gusts."""
        self._site = site
        self._sway = world.sway
        self._arm_m = world.crane.cable_m + world.crane.rigging_m
        self._rigging = int(site.model.joint("rigging").id)
        self._phases = np.random.default_rng(seed).uniform(0.0, 2.0 * math.pi, 6)
        self._velocity = np.zeros(6)
        self._offset: Array | None = None

    def wrench(self, data: mujoco.MjData, *, dt_s: float) -> Array:
        """Return force [N] and torque [N m] (6,) on the platform's centre, in world axes."""
        site = self._site
        mujoco.mj_objectVelocity(
            site.model, data, mujoco.mjtObj.mjOBJ_BODY, site.platform, self._velocity, 0
        )
        air = self.air(data.time)
        force = -AIR_DAMPING[0] * (self._velocity[3:] - air[:3])
        torque = -AIR_DAMPING[1] * (self._velocity[:3] - air[3:])
        R_w_platform = data.xmat[site.platform].reshape(3, 3)
        torque[2] -= YAW_STIFFNESS * math.atan2(R_w_platform[1, 0], R_w_platform[0, 0])
        torque += self._winches(data, R_w_platform, dt_s=dt_s)
        return np.concatenate((force, torque))

    def air(self, time_s: float) -> Array:
        """Return velocity [m/s] and angular velocity [rad/s] (6,) of the air."""
        sway, p = self._sway, self._phases
        slow, fast = 2.0 * math.pi * sway.slow_hz, 2.0 * math.pi * sway.fast_hz
        swell = 1.0 + 0.2 * math.sin(2.0 * math.pi * time_s / 37.0 + p[4])
        slow_x = swell * sway.slow_m * slow * math.cos(slow * time_s + p[0])
        slow_y = swell * sway.slow_m * slow * math.cos(0.94 * slow * time_s + p[1])
        gain = FAST_GAIN * sway.fast_m * fast
        fast_x = gain * math.cos(fast * time_s + p[2])
        fast_y = gain * math.cos(0.93 * fast * time_s + p[3])
        yaw = 0.4 * swell * sway.slow_m * math.cos(0.7 * slow * time_s + p[5])
        x, y = slow_x + fast_x, slow_y + fast_y
        turn_x, turn_y = slow_x / self._arm_m + fast_x, slow_y / self._arm_m + fast_y
        return np.array([x, y, 0.0, -turn_y, turn_x, yaw])

    def _winches(self, data: mujoco.MjData, R_w_platform: Array, *, dt_s: float) -> Array:
        """Return the torque (3,) of shortened and lengthened rigging, a slow tilt loop."""
        site = self._site
        platform = site.platform
        weight = float(site.model.body_subtreemass[platform]) * abs(site.model.opt.gravity[2])
        arm = R_w_platform.T @ (data.subtree_com[platform] - data.xanchor[self._rigging])
        if self._offset is None:
            self._offset = arm[:2].copy()
        self._offset += (arm[:2] - self._offset) * (dt_s / WINCH_S)
        # the weight (0, 0, -W) at offset (x, y) turns by (-y W, x W); the winches turn it back
        x, y = self._offset.tolist()
        return np.asarray(R_w_platform @ np.array([y * weight, -x * weight, 0.0]))


def _projected(torque: Array, jacobian: Array, mass: Array) -> Array:
    """Return the part of joint torques (n,) that does not move the tool: N torque."""
    per_mass = np.linalg.solve(mass, jacobian.T)
    core = jacobian @ per_mass
    core += _SOFT  # a stretched arm has fewer than six directions
    return torque - jacobian.T @ np.linalg.solve(core, per_mass.T @ torque)


def _towards(now: Pose[Base, Tcp], goal: Pose[Base, Tcp], *, dt_s: float) -> Pose[Base, Tcp]:
    """Return a pose nearer to the goal by what the speed limits allow."""
    if now is goal:
        return goal
    shift = goal.translation - now.translation
    turn = log_so3(goal.rotation @ now.rotation.T)
    far = max(
        _length(shift) / (TOOL_SPEED_M_S * dt_s),
        _length(turn) / (TOOL_TURN_RAD_S * dt_s),
    )
    if far <= 1.0:
        return goal
    return Pose.of(exp_so3(turn / far) @ now.rotation, now.translation + shift / far)


def _bounded(vector: Array, longest: float) -> Array:
    length = _length(vector)
    return vector if length <= longest else vector * (longest / length)


def _length(vector: Array) -> float:
    return math.sqrt(float(vector @ vector))
