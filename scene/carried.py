"""Motion of a camera that the robot carries, from the motion of the one that has odometry.

    T_w_mako = T_w_hc @ T_hc_tcp @ T_tcp_base @ T_base_mako           all at one stamp
    xi_w_mako_mako = Ad(T_mako_hc) xi_w_hc_hc + xi_hc_mako_mako

The relative twist xi_hc_mako_mako comes from the measured joint velocities, so no pose noise is
differentiated. Source: the contract's frames, which extend Section III-B of the paper.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scene.robot import Robot
from scene.site import SiteCamera
from spatial.frames import Cam
from spatial.pose import Pose
from spatial.rotation import Array
from spatial.samples import JointSample, MotionSample

STEP_S = 1e-3
"""Step over which the joint velocities are carried on to find the relative twist [s]."""


@dataclass(frozen=True, slots=True, eq=False)
class CarriedCamera:
    """A camera on the robot and the camera whose motion the odometry measures."""

    robot: Robot
    """Kinematics."""
    vio: SiteCamera
    """The camera with odometry."""
    carried: SiteCamera
    """The camera whose motion is wanted."""

    def motion(self, motion: MotionSample, joints: JointSample) -> MotionSample:
        """Return the carried camera's motion at the stamp of the odometry sample.

        Args:
            motion: of the camera with odometry.
            joints: at the same stamp.
        """
        T_vio_cam = self._relative(joints.names, joints.positions_rad)
        later = joints.positions_rad + STEP_S * joints.velocities_rad_s
        T_vio_cam_later = self._relative(joints.names, later)
        step: Pose[Cam, Cam] = T_vio_cam.inverse() @ T_vio_cam_later
        carried = T_vio_cam.inverse().adjoint() @ motion.xi_w_cam_cam
        return MotionSample(
            stamp_ns=motion.stamp_ns,
            T_w_cam=motion.T_w_cam @ T_vio_cam,
            xi_w_cam_cam=carried + step.log() / STEP_S,
            acceleration_cam=np.zeros(3),
            reset_count=motion.reset_count,
            jump_flagged=motion.jump_flagged,
        )

    def _relative(self, names: tuple[str, ...], positions: Array) -> Pose[Cam, Cam]:
        Ts_root_link = self.robot.fk(dict(zip(names, positions.tolist(), strict=True)))
        T_root_vio = Ts_root_link[self.vio.parent] @ self.vio.T_parent_cam
        return T_root_vio.inverse() @ (
            Ts_root_link[self.carried.parent] @ self.carried.T_parent_cam
        )
