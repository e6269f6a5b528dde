"""What streams carry, as plain data; `wire.codec` turns each into bytes and back."""

from __future__ import annotations

from dataclasses import dataclass

from spatial.camera import PinholeCamera
from spatial.frames import Base, Cam, Tcp, W
from spatial.pose import Pose
from spatial.rotation import Array


@dataclass(frozen=True, slots=True, eq=False)
class ImageSample:
    """A compressed camera image."""

    camera: str
    """Name of the camera: `hc` or `mako`."""
    stamp_ns: int
    """Mid-exposure stamp [ns]."""
    jpeg: bytes
    """JPEG file content."""


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationSample:
    """Nominal intrinsics of a camera, latched."""

    camera: str
    """Name of the camera."""
    stamp_ns: int
    """When it became valid [ns]."""
    intrinsics: PinholeCamera
    """The intrinsics."""


@dataclass(frozen=True, slots=True, eq=False)
class MotionSample:
    """Motion of a camera in the odometry's world, from VIO or through kinematics."""

    stamp_ns: int
    """Capture stamp [ns]."""
    T_w_cam: Pose[W, Cam]
    """Pose of the camera in w."""
    xi_w_cam_cam: Array
    """Body twist (6,): velocity [m/s] and angular velocity [rad/s] of cam in w, in cam axes."""
    acceleration_cam: Array
    """Linear acceleration (3,) of cam in w without gravity, in cam axes [m/s^2]."""
    reset_count: int = 0
    """Raised by one whenever the world frame starts anew."""
    jump_flagged: bool = False
    """The odometry itself suspects a jump at this sample."""


@dataclass(frozen=True, slots=True, eq=False)
class JointSample:
    """Measured joint states of the robot."""

    stamp_ns: int
    """Capture stamp [ns]."""
    names: tuple[str, ...]
    """Joint names, in the order of the arrays."""
    positions_rad: Array
    """Positions (n,) [rad]."""
    velocities_rad_s: Array
    """Velocities (n,) [rad/s]."""
    torques_nm: Array
    """Torques (n,) [N m]."""


@dataclass(frozen=True, slots=True, eq=False)
class WrenchSample:
    """Contact wrench on the tool, low-passed as a force-torque sensor's."""

    stamp_ns: int
    """Capture stamp [ns]."""
    force_tcp_n: Array
    """Force (3,) on the tool in tcp axes [N]."""
    torque_tcp_nm: Array
    """Torque (3,) on the tool about the tcp origin, in tcp axes [N m]."""


@dataclass(frozen=True, slots=True, eq=False)
class HealthSample:
    """How a process says that it lives and what it suffers from."""

    stamp_ns: int
    """When it was said [ns]."""
    component: str
    """Name of the process: site, tracker, viewer, ..."""
    level: str
    """`ok`, `warning` or `error`."""
    text: str
    """One sentence for the operator, empty when all is well."""
    values: dict[str, float]
    """Figures by name, with the unit in the name."""


@dataclass(frozen=True, slots=True, eq=False)
class ToolCommand:
    """Where the operator wants the tool."""

    stamp_ns: int
    """Send stamp on the site's clock [ns]."""
    sequence: int
    """Rises by one per command of one sender."""
    ttl_ns: int
    """The site holds its position when no newer command came for this long [ns]."""
    T_base_tcp: Pose[Base, Tcp]
    """Desired pose of the tool in the base of the arm."""
