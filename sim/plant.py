"""The simulated site's physics: steps of one millisecond, truth, and what sensors would measure.

World `W` is gravity-aligned and fixed: z up, z = 0 on the ground. A plant is one thread's; other
threads read `snapshot()` and `history()`, which hand out copies.
"""

from __future__ import annotations

import hashlib
import math
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from scene.database import Database
from scene.robot import Robot
from scene.site import Site
from sim.control import CONTROL_EVERY, ArmControl, PlatformControl
from sim.model import TIMESTEP_S, TOOL_FRAME, SiteModel, build
from sim.world import TrueCamera, TrueMarker, World
from spatial.errors import InputError, unknown
from spatial.frames import Base, Frame, Tcp, W
from spatial.pose import Pose
from spatial.rotation import Array

HISTORY = 32
"""Snapshots kept, one per step: what motion blur looks back on."""
WRENCH_HZ = 80.0
"""Corner of the low pass a force-torque sensor has [Hz]."""
_WRENCH_SHARE = 1.0 - math.exp(-2.0 * math.pi * WRENCH_HZ * TIMESTEP_S)


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """Configuration at one instant, enough to draw it."""

    time_s: float
    """Time since the start [s]."""
    qpos: Array
    """Generalised positions, read-only."""


class Plant:
    """The simulated robot in its world, deterministic for a seed."""

    def __init__(
        self,
        site: Site,
        robot: Robot,
        database: Database,
        *,
        world: World,
        cameras: Mapping[str, TrueCamera] | None = None,
        markers: Iterable[TrueMarker] = (),
        seed: int = 0,
    ) -> None:
        """Build the site and hang the robot at rest.

        Args:
            site: nominal description; names its cameras.
            robot: the robot.
            database: objects; what is read here is a copy, later edits do not matter.
            world: what stands where.
            cameras: true cameras; the site's nominal ones where left out.
            markers: true marker mounts; nominal where left out.
            seed: of the gusts.

        Raises:
            InputError: a placed object the database does not have, or links the robot lacks.
        """
        self.world = world
        self.robot = robot
        self.cameras = {name: _nominal(site, name) for name in site.cameras} | dict(cameras or {})
        self.entries = {p.slug: database.entry(p.slug) for p in world.placements}
        self.site_model: SiteModel = build(
            robot, entries=self.entries, world=world, cameras=self.cameras, markers=markers
        )
        self._model = self.site_model.model
        self._data = mujoco.MjData(self._model)
        self._probe = mujoco.MjData(self._model)
        self._steps = 0
        posture = np.array(world.crane.arm_rad)
        if len(posture) != len(self.site_model.arm_joints):
            names = [joint.name for joint in self.site_model.arm_joints]
            raise InputError(f"arm_rad has {len(posture)} positions for the joints {names}")
        self._data.qpos[self.site_model.arm_qpos] = posture
        mujoco.mj_forward(self._model, self._data)
        start = self._tool_in_base()
        self._arm = ArmControl(self.site_model, posture_rad=posture, start=start)
        self._platform = PlatformControl(self.site_model, world=world, seed=seed)
        self._wrench = np.zeros(6)
        self._history: deque[Snapshot] = deque(maxlen=HISTORY)
        self._remember()

    @property
    def time_s(self) -> float:
        """Time since the start [s]."""
        return self._steps * TIMESTEP_S

    def step(self) -> None:
        """Advance by one millisecond."""
        if self._steps % CONTROL_EVERY == 0:
            dt_s = CONTROL_EVERY * TIMESTEP_S
            torques = self._arm.torques(self._data, dt_s=dt_s)
            self._data.qfrc_applied[self.site_model.arm_dof] = torques
            self._data.xfrc_applied[self.site_model.platform] = self._platform.wrench(
                self._data, dt_s=dt_s
            )
        mujoco.mj_step(self._model, self._data)
        self._steps += 1
        self._feel()
        self._remember()

    def command_tool(self, T_base_tcp: Pose[Base, Tcp]) -> None:
        """Move the tool to a pose in the base, at limited speed, and hold it there."""
        self._arm.command(T_base_tcp)

    def hold_tool(self) -> None:
        """Stay where the rate-limited command is now."""
        self._arm.command(self._arm.T_base_target)

    def joints(self) -> tuple[tuple[str, ...], Array, Array, Array]:
        """Return names, positions [rad], velocities [rad/s] and torques [N m], each (n,)."""
        site = self.site_model
        return (
            tuple(joint.name for joint in site.arm_joints),
            self._data.qpos[site.arm_qpos],
            self._data.qvel[site.arm_dof],
            self._data.qfrc_applied[site.arm_dof],
        )

    def wrench(self) -> tuple[Array, Array]:
        """Return contact force (3,) [N] and torque (3,) [N m] on the tool, at and in the tcp."""
        return self._wrench[:3].copy(), self._wrench[3:].copy()

    def truth(self) -> dict[str, Pose[W, Frame]]:
        """Return the true pose of every frame in W: robot frames, cameras, `object/<slug>`."""
        data = self._at_now()
        site = self.site_model
        poses: dict[str, Pose[W, Frame]] = {
            name: Pose.of(data.xmat[body].reshape(3, 3), data.xpos[body])
            for name, body in site.frames.items()
        }
        for name, index in site.camera_sites.items():
            poses[name] = Pose.of(data.site_xmat[index].reshape(3, 3), data.site_xpos[index])
        return poses

    def camera_twist(self, camera: str) -> tuple[Array, Array]:
        """Return a camera's body twist (6,) in W and its acceleration (3,), in camera axes.

        Velocity [m/s] before angular velocity [rad/s]; acceleration [m/s^2] without gravity.

        Raises:
            InputError: an unknown camera.
        """
        sites = self.site_model.camera_sites
        if camera not in sites:
            raise InputError(unknown("camera", camera, sites))
        data = self._at_now()
        mujoco.mj_comVel(self._model, data)
        mujoco.mj_rnePostConstraint(self._model, data)
        what, index = mujoco.mjtObj.mjOBJ_SITE, sites[camera]
        velocity, acceleration = np.zeros(6), np.zeros(6)
        mujoco.mj_objectVelocity(self._model, data, what, index, velocity, 1)
        mujoco.mj_objectAcceleration(self._model, data, what, index, acceleration, 1)
        # an accelerometer's reading, as MuJoCo gives it, holds the support against gravity
        gravity_cam = self._model.opt.gravity @ data.site_xmat[index].reshape(3, 3)
        return np.concatenate((velocity[3:], velocity[:3])), acceleration[3:] + gravity_cam

    def snapshot(self) -> Snapshot:
        """Return the newest configuration; any thread may ask."""
        return self._history[-1]

    def history(self) -> tuple[Snapshot, ...]:
        """Return the last `HISTORY` configurations, oldest first; the plant's own thread only."""
        return tuple(self._history)

    def digest(self) -> str:
        """Return a hash of the whole state: equal for two runs of one seed."""
        state = np.concatenate((self._data.qpos, self._data.qvel, self._wrench))
        return hashlib.sha256(state.tobytes()).hexdigest()

    def _at_now(self) -> mujoco.MjData:
        """Return data whose frames belong to the newest state; a step leaves them one behind."""
        probe = self._probe
        if probe.time != self._data.time or self._steps == 0:
            probe.time = self._data.time
            probe.qpos[:] = self._data.qpos
            probe.qvel[:] = self._data.qvel
            probe.qacc[:] = self._data.qacc
            mujoco.mj_kinematics(self._model, probe)
            mujoco.mj_comPos(self._model, probe)
        return probe

    def _tool_in_base(self) -> Pose[Base, Tcp]:
        poses = self.truth()
        T_w_base: Pose[W, Base] = Pose(poses["base"].matrix)
        T_w_tcp: Pose[W, Tcp] = Pose(poses[TOOL_FRAME].matrix)
        return T_w_base.inverse() @ T_w_tcp

    def _feel(self) -> None:
        """Filter the contact wrench on the tool."""
        data, site = self._data, self.site_model
        total: Array | float = 0.0
        if data.ncon or data.xfrc_applied[site.tool].any():
            mujoco.mj_rnePostConstraint(self._model, data)
            external = data.cfrc_ext[list(site.tool_bodies)].sum(axis=0)
            R_w_tcp = data.xmat[site.tool].reshape(3, 3)
            centre = data.subtree_com[self._model.body_rootid[site.tool]]
            torque = external[:3] + np.cross(centre - data.xpos[site.tool], external[3:])
            total = np.concatenate((external[3:] @ R_w_tcp, torque @ R_w_tcp))
        self._wrench += _WRENCH_SHARE * (total - self._wrench)

    def _remember(self) -> None:
        qpos = self._data.qpos.copy()
        qpos.flags.writeable = False
        self._history.append(Snapshot(self.time_s, qpos))


def _nominal(site: Site, name: str) -> TrueCamera:
    camera = site.cameras[name]
    return TrueCamera(camera.intrinsics, camera.parent, camera.T_parent_cam)
