"""What a site says, in Foxglove's messages where they exist.

Two of ours ride on Foxglove's: `OdometryExtension` and `LogExtension` have field numbers from
100 on and are appended to the bytes, which protobuf merges. Others skip them unread.
"""

from __future__ import annotations

from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.JointState_pb2 import JointState
from foxglove_schemas_protobuf.JointStates_pb2 import JointStates
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry

from spatial.camera import PinholeCamera
from spatial.errors import InputError, MessageError
from spatial.samples import (
    CalibrationSample,
    HealthSample,
    ImageSample,
    JointSample,
    MotionSample,
    WrenchSample,
)
from wire.codec_parts import (
    Encoded,
    checked_count,
    checked_name,
    checked_number,
    checked_stamp,
    checked_text,
    foxglove_pose_of,
    parse,
    put_foxglove_pose,
    put_stamp,
    stamp_of,
    vector,
)
from wire.generated.telepresence.v1.telepresence_pb2 import LogExtension, OdometryExtension, Wrench

JPEG_START = b"\xff\xd8\xff"
DISTORTION_MODEL = "plumb_bob"
MAX_SHOWN = 40
_LEVELS = {"ok": Log.INFO, "warning": Log.WARNING, "error": Log.ERROR}
_LEVEL_NAMES = {value: name for name, value in _LEVELS.items()}


def encode_image(image: ImageSample) -> Encoded:
    """Encode an image as foxglove.CompressedImage."""
    message = CompressedImage(frame_id=image.camera, data=image.jpeg, format="jpeg")
    put_stamp(message.timestamp, image.stamp_ns)
    return Encoded(message.SerializeToString(), "foxglove.CompressedImage")


def decode_image(payload: bytes) -> ImageSample:
    """Decode foxglove.CompressedImage.

    Raises:
        MessageError: not such a message, no stamp, or not a JPEG by its first bytes.
    """
    message = parse(CompressedImage, payload)
    if message.format != "jpeg" or not message.data.startswith(JPEG_START):
        raise MessageError(f"image of format {message.format[:20]!r}, expected a jpeg")
    return ImageSample(
        camera=checked_name("camera", message.frame_id),
        stamp_ns=stamp_of(message.timestamp),
        jpeg=message.data,
    )


def encode_calibration(calibration: CalibrationSample) -> Encoded:
    """Encode intrinsics as foxglove.CameraCalibration."""
    c = calibration.intrinsics
    message = CameraCalibration(
        frame_id=calibration.camera,
        width=c.width,
        height=c.height,
        distortion_model=DISTORTION_MODEL,
        D=c.distortion,
        K=c.K.ravel().tolist(),
        R=[1, 0, 0, 0, 1, 0, 0, 0, 1],
        P=[c.fx, 0, c.cx, 0, 0, c.fy, c.cy, 0, 0, 0, 1, 0],
    )
    put_stamp(message.timestamp, calibration.stamp_ns)
    return Encoded(message.SerializeToString(), "foxglove.CameraCalibration")


def decode_calibration(payload: bytes) -> CalibrationSample:
    """Decode foxglove.CameraCalibration.

    Raises:
        MessageError: not such a message, another distortion model, or impossible intrinsics.
    """
    message = parse(CameraCalibration, payload)
    if message.distortion_model not in ("", DISTORTION_MODEL):
        raise MessageError(
            f"distortion model {message.distortion_model[:40]!r}, expected {DISTORTION_MODEL!r}"
        )
    k = vector("K", message.K, 9).tolist()
    d = vector("D", message.D or [0.0] * 5, 5).tolist()
    try:
        intrinsics = PinholeCamera(
            message.width, message.height, k[0], k[4], k[2], k[5], (d[0], d[1], d[2], d[3], d[4])
        )
    except InputError as error:
        raise MessageError(str(error)) from error
    return CalibrationSample(
        camera=checked_name("camera", message.frame_id),
        stamp_ns=stamp_of(message.timestamp),
        intrinsics=intrinsics,
    )


def encode_motion(motion: MotionSample) -> Encoded:
    """Encode motion as foxglove.Odometry with our extension behind it."""
    message = Odometry(frame_id="w", body_frame_id="hc")
    put_stamp(message.timestamp, motion.stamp_ns)
    put_foxglove_pose(message.pose.position, message.pose.orientation, motion.T_w_cam)
    twist = motion.xi_w_cam_cam.tolist()
    linear, angular = message.linear_velocity, message.angular_velocity
    linear.x, linear.y, linear.z = twist[:3]
    angular.x, angular.y, angular.z = twist[3:]
    extension = OdometryExtension(
        acceleration_body=motion.acceleration_cam.tolist(),
        reset_count=motion.reset_count,
        jump_flagged=motion.jump_flagged,
    )
    payload = message.SerializeToString() + extension.SerializeToString()
    return Encoded(payload, "foxglove.Odometry")


def decode_motion(payload: bytes) -> MotionSample:
    """Decode foxglove.Odometry; without our extension acceleration and resets are zero.

    Raises:
        MessageError: not such a message, no stamp, or numbers that are no pose or twist.
    """
    message, extension = parse(Odometry, payload), parse(OdometryExtension, payload)
    linear, angular = message.linear_velocity, message.angular_velocity
    twist = [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]
    pose = message.pose
    return MotionSample(
        stamp_ns=stamp_of(message.timestamp),
        T_w_cam=foxglove_pose_of("odometry", pose.position, pose.orientation),
        xi_w_cam_cam=vector("twist", twist, 6),
        acceleration_cam=vector("acceleration", extension.acceleration_body or [0.0] * 3, 3),
        reset_count=extension.reset_count,
        jump_flagged=extension.jump_flagged,
    )


def encode_joints(joints: JointSample) -> Encoded:
    """Encode joint states as foxglove.JointStates."""
    message = JointStates()
    put_stamp(message.timestamp, joints.stamp_ns)
    rows = zip(
        joints.names,
        joints.positions_rad.tolist(),
        joints.velocities_rad_s.tolist(),
        joints.torques_nm.tolist(),
        strict=True,
    )
    message.joints.extend(
        JointState(name=name, position=q, velocity=dq, effort=tau) for name, q, dq, tau in rows
    )
    return Encoded(message.SerializeToString(), "foxglove.JointStates")


def decode_joints(payload: bytes) -> JointSample:
    """Decode foxglove.JointStates.

    Raises:
        MessageError: not such a message, no stamp, no joint, a repeated name, a bad number.
    """
    message = parse(JointStates, payload)
    count = len(message.joints)
    checked_count("joints", count)
    names = tuple(checked_name("joint", joint.name) for joint in message.joints)
    if not names or len(set(names)) < count:
        raise MessageError(f"joints {list(names)[:20]}, expected distinct names")
    return JointSample(
        stamp_ns=stamp_of(message.timestamp),
        names=names,
        positions_rad=vector("joint positions", (j.position for j in message.joints), count),
        velocities_rad_s=vector("joint velocities", (j.velocity for j in message.joints), count),
        torques_nm=vector("joint torques", (j.effort for j in message.joints), count),
    )


def encode_wrench(wrench: WrenchSample) -> Encoded:
    """Encode a wrench as telepresence.v1.Wrench."""
    message = Wrench(
        stamp_ns=wrench.stamp_ns,
        force_n=wrench.force_tcp_n.tolist(),
        torque_nm=wrench.torque_tcp_nm.tolist(),
    )
    return Encoded(message.SerializeToString(), "telepresence.v1.Wrench")


def decode_wrench(payload: bytes) -> WrenchSample:
    """Decode telepresence.v1.Wrench.

    Raises:
        MessageError: not such a message, no stamp, or not three finite numbers each.
    """
    message = parse(Wrench, payload)
    return WrenchSample(
        stamp_ns=checked_stamp(message.stamp_ns),
        force_tcp_n=vector("force", message.force_n, 3),
        torque_tcp_nm=vector("torque", message.torque_nm, 3),
    )


def encode_health(health: HealthSample) -> Encoded:
    """Encode health as foxglove.Log with our extension behind it.

    Raises:
        InputError: the level is none of `ok`, `warning`, `error`.
    """
    if health.level not in _LEVELS:
        raise InputError(f"health level {health.level!r}, expected one of {', '.join(_LEVELS)}")
    message = Log(level=_LEVELS[health.level], name=health.component, message=health.text)
    put_stamp(message.timestamp, health.stamp_ns)
    extension = LogExtension(values=health.values)
    payload = message.SerializeToString(deterministic=True)
    return Encoded(payload + extension.SerializeToString(deterministic=True), "foxglove.Log")


def decode_health(payload: bytes) -> HealthSample:
    """Decode foxglove.Log; without our extension there are no values.

    Raises:
        MessageError: not such a message, no stamp, an unknown level, a value not finite.
    """
    message, extension = parse(Log, payload), parse(LogExtension, payload)
    if message.level not in _LEVEL_NAMES:
        raise MessageError(f"log level {message.level}, expected {sorted(_LEVEL_NAMES)}")
    checked_count("values", len(extension.values))
    return HealthSample(
        stamp_ns=stamp_of(message.timestamp),
        component=checked_name("component", message.name),
        level=_LEVEL_NAMES[message.level],
        text=checked_text("health text", message.message),
        values={
            checked_name("value name", name): checked_number(name[:MAX_SHOWN], value)
            for name, value in sorted(extension.values.items())
        },
    )
