"""Bytes and back: the one door between samples and the bus.

`encode` takes any sample; there is one decoder per message because a receiver knows what it
asked for. Every decoder raises `MessageError` for bytes, numbers or sizes that cannot be.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms

from spatial.errors import MessageError
from spatial.frames import Frame
from spatial.pose import Pose
from spatial.samples import (
    CalibrationSample,
    HealthSample,
    ImageSample,
    JointSample,
    MotionSample,
    ToolCommand,
    WrenchSample,
)
from spatial.tracked import PoseMeasurement, TrackedObjects, TrackReport
from wire import codec_site, codec_track
from wire.codec_parts import (
    MAX_MESSAGE_BYTES,
    Encoded,
    checked_count,
    checked_name,
    foxglove_pose_of,
    parse,
    put_foxglove_pose,
    put_stamp,
    stamp_of,
)
from wire.codec_site import (
    decode_calibration,
    decode_health,
    decode_image,
    decode_joints,
    decode_motion,
    decode_wrench,
)
from wire.codec_track import (
    decode_command,
    decode_measurement,
    decode_named_poses,
    decode_report,
    decode_tracked,
    encode_named_poses,
)

__all__ = [
    "ROBOT_DESCRIPTION_SCHEMA",
    "Encodable",
    "Encoded",
    "decode_calibration",
    "decode_command",
    "decode_health",
    "decode_image",
    "decode_joints",
    "decode_link_transforms",
    "decode_measurement",
    "decode_motion",
    "decode_named_poses",
    "decode_report",
    "decode_robot_description",
    "decode_tracked",
    "decode_wrench",
    "encode",
    "encode_link_transforms",
    "encode_named_poses",
    "encode_robot_description",
]

ROBOT_DESCRIPTION_SCHEMA = "std_msgs/msg/String"
"""Name under which other tools take a URDF from a topic."""

Encodable: TypeAlias = (
    ImageSample
    | CalibrationSample
    | MotionSample
    | JointSample
    | WrenchSample
    | HealthSample
    | ToolCommand
    | PoseMeasurement
    | TrackedObjects
    | TrackReport
)

_ENCODERS: dict[type, Callable[[Any], Encoded]] = {
    ImageSample: codec_site.encode_image,
    CalibrationSample: codec_site.encode_calibration,
    MotionSample: codec_site.encode_motion,
    JointSample: codec_site.encode_joints,
    WrenchSample: codec_site.encode_wrench,
    HealthSample: codec_site.encode_health,
    ToolCommand: codec_track.encode_command,
    PoseMeasurement: codec_track.encode_measurement,
    TrackedObjects: codec_track.encode_tracked,
    TrackReport: codec_track.encode_report,
}


def encode(sample: Encodable) -> Encoded:
    """Return the bytes of a sample and the name of their schema."""
    return _ENCODERS[type(sample)](sample)


def encode_robot_description(urdf: str) -> Encoded:
    """Encode a URDF as other tools take it from a topic: JSON with one string."""
    return Encoded(json.dumps({"data": urdf}).encode(), ROBOT_DESCRIPTION_SCHEMA)


def decode_robot_description(payload: bytes) -> str:
    """Return the URDF.

    Raises:
        MessageError: not JSON with a string under `data`, or too large.
    """
    if len(payload) > MAX_MESSAGE_BYTES:
        raise MessageError(f"robot description of {len(payload)} bytes is too large")
    try:
        urdf = json.loads(payload)["data"]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise MessageError('robot description is not JSON of the form {"data": urdf}') from error
    if not isinstance(urdf, str):
        raise MessageError(f"robot description holds {type(urdf).__name__}, expected a string")
    return urdf


def encode_link_transforms(
    stamp_ns: int, parent: str, poses: Mapping[str, Pose[Any, Any]]
) -> Encoded:
    """Encode poses of child frames in one parent as foxglove.FrameTransforms."""
    message = FrameTransforms()
    for child, pose in poses.items():
        entry = message.transforms.add(parent_frame_id=parent, child_frame_id=child)
        put_stamp(entry.timestamp, stamp_ns)
        put_foxglove_pose(entry.translation, entry.rotation, pose)
    return Encoded(message.SerializeToString(), "foxglove.FrameTransforms")


def decode_link_transforms(payload: bytes) -> tuple[int, str, dict[str, Pose[Frame, Frame]]]:
    """Return the stamp [ns], the parent and {child: pose of child in parent}.

    Raises:
        MessageError: not such a message, empty, more than one parent or stamp, or no poses.
    """
    message = parse(FrameTransforms, payload)
    checked_count("transforms", len(message.transforms))
    heads = {(stamp_of(t.timestamp), t.parent_frame_id) for t in message.transforms}
    if len(heads) != 1:
        raise MessageError(f"transforms with {len(heads)} stamps and parents, expected one")
    ((stamp_ns, parent),) = heads
    return (
        stamp_ns,
        checked_name("parent", parent),
        {
            checked_name("child", t.child_frame_id): foxglove_pose_of(
                "link transform", t.translation, t.rotation
            )
            for t in message.transforms
        },
    )
