"""The sensors of the simulated site: what is read from the plant, at which rate, under which key.

Every sample carries the stamp of the physics step it was read at and leaves through the outlet.
Truth goes past the outlet's delays to a key of its own, at the stamps of the odometry.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from typing import Protocol

from scene.robot import Robot
from scene.site import Site
from sim.outlet import Outlet
from sim.truth import TruthSample, encode_truth
from sim.vio import Vio, VioLevel
from spatial.frames import Cam, Frame, W
from spatial.pose import Pose
from spatial.rotation import Array
from spatial.samples import CalibrationSample, JointSample, WrenchSample
from wire.codec import Encoded, encode, encode_link_transforms, encode_robot_description
from wire.keys import Keys

STEPS_PER_S = 1000
"""Physics steps in a second."""
JOINTS_HZ = 250.0
"""Rate of the joint states [Hz]."""
WRENCH_HZ = 100.0
"""Rate of the wrench [Hz]."""
LINKS_HZ = 30.0
"""Rate of the link transforms for other tools [Hz]."""


class PlantView(Protocol):
    """What sensors read of the plant."""

    def joints(self) -> tuple[tuple[str, ...], Array, Array, Array]:
        """Return names, positions [rad], velocities [rad/s] and torques [N m]."""
        ...

    def wrench(self) -> tuple[Array, Array]:
        """Return force (3,) [N] and torque (3,) [N m] on the tool, in tcp axes."""
        ...

    def truth(self) -> Mapping[str, Pose[W, Frame]]:
        """Return true poses by name."""
        ...

    def camera_twist(self, name: str) -> tuple[Array, Array]:
        """Return body twist (6,) and acceleration (3,) of a camera, in its axes."""
        ...


def is_due(step: int, *, rate_hz: float) -> bool:
    """Return whether something that happens `rate_hz` times a second happens at this step."""
    return int(step * rate_hz / STEPS_PER_S) != int((step - 1) * rate_hz / STEPS_PER_S)


class Sensors:
    """Reads the plant step by step and feeds the outlet."""

    def __init__(
        self,
        plant: PlantView,
        *,
        site: Site,
        robot: Robot,
        keys: Keys,
        vio: VioLevel,
        seed: int,
        outlet: Outlet,
    ) -> None:
        """Make the sensors of a site.

        Args:
            plant: what is measured.
            site: rates, and the nominal calibration that is told to the station.
            robot: forward kinematics for link transforms.
            keys: where everything goes.
            vio: quality of the odometry.
            seed: seeds every random number.
            outlet: stage that delays, jitters and loses.
        """
        self._plant = plant
        self._site = site
        self._robot = robot
        self._keys = keys
        self._outlet = outlet
        self._vio = Vio(vio, seed=zlib.crc32(f"vio {seed}".encode()))
        self._urdf = site.robot.read_text(encoding="utf-8")

    def tick(self, step: int, *, stamp_ns: int) -> None:
        """Read what is due at a physics step whose state was true at `stamp_ns` [ns]."""
        if is_due(step, rate_hz=JOINTS_HZ):
            self._put("joints", self._keys.joints, encode(self._joints(stamp_ns)), stamp_ns)
        if is_due(step, rate_hz=self._site.vio_rate_hz):
            self._odometry(stamp_ns)
        if is_due(step, rate_hz=WRENCH_HZ):
            force, torque = self._plant.wrench()
            wrench = WrenchSample(stamp_ns, force, torque)
            self._put("wrench", self._keys.wrench, encode(wrench), stamp_ns)
        if is_due(step, rate_hz=LINKS_HZ):
            self._links(stamp_ns)

    def latched(self, stamp_ns: int) -> dict[str, Encoded]:
        """Return what a late joiner must know, by key: calibrations and the robot."""
        said = {
            self._keys.calibration(name): encode(
                CalibrationSample(name, stamp_ns, camera.intrinsics)
            )
            for name, camera in self._site.cameras.items()
        }
        said[self._keys.robot_description] = encode_robot_description(self._urdf)
        return said

    def _joints(self, stamp_ns: int) -> JointSample:
        names, positions, velocities, torques = self._plant.joints()
        return JointSample(stamp_ns, names, positions, velocities, torques)

    def _odometry(self, stamp_ns: int) -> None:
        camera = self._site.vio_camera
        truth = self._plant.truth()
        twist, acceleration = self._plant.camera_twist(camera)
        T_w_cam: Pose[W, Cam] = Pose(truth[camera].matrix)
        motion = self._vio.step(
            stamp_ns, T_w_cam=T_w_cam, xi_w_cam_cam=twist, acceleration_cam=acceleration
        )
        if motion is not None:
            self._put("vio", self._keys.vio, encode(motion), stamp_ns)
        sample = TruthSample(stamp_ns, truth)
        self._put("truth", self._keys.truth("poses"), encode_truth(sample), stamp_ns)

    def _links(self, stamp_ns: int) -> None:
        joints = self._joints(stamp_ns)
        poses = self._robot.fk(dict(zip(joints.names, joints.positions_rad.tolist(), strict=True)))
        root = self._robot.root
        children = {link: pose for link, pose in poses.items() if link != root}
        self._put(
            "links", self._keys.tf, encode_link_transforms(stamp_ns, root, children), stamp_ns
        )

    def _put(self, stream: str, key: str, message: Encoded, stamp_ns: int) -> None:
        self._outlet.put(
            stream, key=key, payload=message.payload, schema=message.schema, captured_ns=stamp_ns
        )
