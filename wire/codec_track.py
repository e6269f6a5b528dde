"""What trackers and operators say, in messages of `telepresence.v1`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from spatial.errors import MessageError
from spatial.frames import Cam, Object
from spatial.pose import Pose
from spatial.rotation import Array
from spatial.samples import ToolCommand
from spatial.tracked import (
    PoseMeasurement,
    TagUse,
    TrackedObject,
    TrackedObjects,
    TrackReport,
    TrackState,
)
from wire.codec_parts import (
    Encoded,
    checked_count,
    checked_name,
    checked_number,
    checked_stamp,
    checked_text,
    covariance_numbers,
    covariance_of,
    parse,
    pose_numbers,
    pose_of,
    unit_wxyz,
    vector,
)
from wire.generated.telepresence.v1 import telepresence_pb2 as pb

_STATES = {state: pb.TrackState.Value(state.name) for state in TrackState}
_STATE_OF = {number: state for state, number in _STATES.items()}
_NO_COVARIANCE = np.zeros((6, 6))
_NO_COVARIANCE.flags.writeable = False


def encode_measurement(measurement: PoseMeasurement) -> Encoded:
    """Encode one measured pose."""
    message = pb.PoseMeasurement(
        stamp_ns=measurement.stamp_ns,
        camera=measurement.camera,
        slug=measurement.slug,
        cam_object=pose_numbers(measurement.T_cam_object),
        covariance=covariance_numbers(measurement.covariance),
        source=measurement.source,
    )
    return Encoded(message.SerializeToString(), "telepresence.v1.PoseMeasurement")


def decode_measurement(payload: bytes) -> PoseMeasurement:
    """Decode one measured pose.

    Raises:
        MessageError: not such a message, no stamp or name, or numbers that are no pose.
    """
    message = parse(pb.PoseMeasurement, payload)
    return PoseMeasurement(
        camera=checked_name("camera", message.camera),
        slug=checked_name("slug", message.slug),
        stamp_ns=checked_stamp(message.stamp_ns),
        T_cam_object=pose_of("measured pose", message.cam_object),
        covariance=covariance_of(message.covariance),
        source=checked_name("source", message.source),
    )


def encode_tracked(tracked: TrackedObjects) -> Encoded:
    """Encode all objects at one motion stamp; without a pose a covariance is not sent."""
    message = pb.TrackedObjects(stamp_ns=tracked.stamp_ns)
    message.objects.extend(_tracked_message(entry) for entry in tracked.objects)
    return Encoded(message.SerializeToString(), "telepresence.v1.TrackedObjects")


def _tracked_message(entry: TrackedObject) -> pb.TrackedObject:
    pose = entry.T_cam_object
    return pb.TrackedObject(
        slug=entry.slug,
        revision=entry.revision,
        camera=entry.camera,
        state=_STATES[entry.state],
        cam_object=pose_numbers(pose) if pose is not None else (),
        twist_w_cam_cam=entry.xi_w_cam_cam.tolist(),
        covariance=covariance_numbers(entry.covariance) if pose is not None else (),
        seen_ns=entry.seen_ns,
        motion_ns=entry.motion_ns,
        reset_count=entry.reset_count,
        reason=entry.reason,
    )


def decode_tracked(payload: bytes) -> TrackedObjects:
    """Decode all objects at one motion stamp; without a pose the covariance is zero.

    Raises:
        MessageError: not such a message, no stamp, a repeated slug, or numbers that are no pose.
    """
    message = parse(pb.TrackedObjects, payload)
    checked_count("objects", len(message.objects))
    objects = tuple(_tracked_object(entry) for entry in message.objects)
    if len({entry.slug for entry in objects}) < len(objects):
        raise MessageError(f"objects {[o.slug for o in objects][:20]}, expected distinct slugs")
    return TrackedObjects(stamp_ns=checked_stamp(message.stamp_ns), objects=objects)


def _tracked_object(entry: pb.TrackedObject) -> TrackedObject:
    if entry.state not in _STATE_OF:
        raise MessageError(f"track state {entry.state}, expected {sorted(_STATE_OF)}")
    pose = _optional_pose("tracked pose", entry.cam_object)
    return TrackedObject(
        slug=checked_name("slug", entry.slug),
        revision=entry.revision,
        camera=checked_name("camera", entry.camera),
        state=_STATE_OF[entry.state],
        T_cam_object=pose,
        xi_w_cam_cam=vector("twist", entry.twist_w_cam_cam, 6),
        covariance=covariance_of(entry.covariance) if pose is not None else _NO_COVARIANCE,
        seen_ns=entry.seen_ns,
        motion_ns=entry.motion_ns,
        reset_count=entry.reset_count,
        reason=checked_text("reason", entry.reason),
    )


def _optional_pose(what: str, numbers: Sequence[float]) -> Pose[Cam, Object] | None:
    return pose_of(what, numbers) if numbers else None


def encode_report(report: TrackReport) -> Encoded:
    """Encode why a pose is what it is."""
    pose, prior = report.T_cam_object, report.T_cam_object_prior
    message = pb.TrackReport(
        stamp_ns=report.stamp_ns,
        camera=report.camera,
        slug=report.slug,
        method=report.method,
        tags=[_tag_message(tag) for tag in report.tags],
        expected_ids=report.expected_ids,
        cam_object=pose_numbers(pose) if pose is not None else (),
        cam_object_prior=pose_numbers(prior) if prior is not None else (),
        hypotheses=report.hypotheses,
        residual_px=report.residual_px,
        reason=report.reason,
    )
    return Encoded(message.SerializeToString(), "telepresence.v1.TrackReport")


def _tag_message(tag: TagUse) -> pb.TagUse:
    return pb.TagUse(
        family=tag.family,
        id=tag.id,
        corners_px=tag.corners_px.ravel().tolist(),
        used=tag.used,
        reason=tag.reason,
        residual_px=tag.residual_px,
    )


def decode_report(payload: bytes) -> TrackReport:
    """Decode why a pose is what it is.

    Raises:
        MessageError: not such a message, no stamp or name, or numbers that are not what they say.
    """
    message = parse(pb.TrackReport, payload)
    checked_count("tags", max(len(message.tags), len(message.expected_ids)))
    return TrackReport(
        camera=checked_name("camera", message.camera),
        slug=checked_name("slug", message.slug),
        stamp_ns=checked_stamp(message.stamp_ns),
        method=checked_name("method", message.method),
        tags=tuple(_tag_use(tag) for tag in message.tags),
        expected_ids=tuple(message.expected_ids),
        T_cam_object=_optional_pose("measured pose", message.cam_object),
        T_cam_object_prior=_optional_pose("predicted pose", message.cam_object_prior),
        hypotheses=message.hypotheses,
        residual_px=checked_number("residual", message.residual_px),
        reason=checked_text("reason", message.reason),
    )


def _tag_use(tag: pb.TagUse) -> TagUse:
    return TagUse(
        family=checked_name("family", tag.family),
        id=tag.id,
        corners_px=vector("corners", tag.corners_px, 8).reshape(4, 2),
        used=tag.used,
        reason=checked_text("reason", tag.reason),
        residual_px=checked_number("residual", tag.residual_px),
    )


def encode_command(command: ToolCommand) -> Encoded:
    """Encode where the operator wants the tool."""
    message = pb.ToolCommand(
        stamp_ns=command.stamp_ns,
        sequence=command.sequence,
        ttl_ns=command.ttl_ns,
        base_tcp=pose_numbers(command.T_base_tcp),
    )
    return Encoded(message.SerializeToString(), "telepresence.v1.ToolCommand")


def decode_command(payload: bytes) -> ToolCommand:
    """Decode where the operator wants the tool.

    Raises:
        MessageError: not such a message, no stamp, no time to live, or numbers that are no pose.
    """
    message = parse(pb.ToolCommand, payload)
    if message.ttl_ns == 0:
        raise MessageError("command with a time to live of 0 ns, expected more")
    return ToolCommand(
        stamp_ns=checked_stamp(message.stamp_ns),
        sequence=message.sequence,
        ttl_ns=message.ttl_ns,
        T_base_tcp=pose_of("commanded pose", message.base_tcp),
    )


def encode_named_poses(stamp_ns: int, poses: dict[str, tuple[Array, Array]]) -> Encoded:
    """Encode {name: (translation (3,) [m], quaternion (4,) wxyz)} at one stamp."""
    message = pb.NamedPoses(stamp_ns=stamp_ns)
    for name, (translation, wxyz) in poses.items():
        numbers = [*map(float, translation), *map(float, wxyz)]
        message.poses.append(pb.NamedPose(name=name, pose=numbers))
    return Encoded(message.SerializeToString(), "telepresence.v1.NamedPoses")


def decode_named_poses(payload: bytes) -> tuple[int, dict[str, tuple[Array, Array]]]:
    """Decode the stamp [ns] and {name: (translation (3,) [m], quaternion (4,) wxyz)}.

    Raises:
        MessageError: not such a message, no stamp, a repeated name, or numbers that are no pose.
    """
    message = parse(pb.NamedPoses, payload)
    checked_count("poses", len(message.poses))
    poses: dict[str, tuple[Array, Array]] = {}
    for entry in message.poses:
        numbers = vector("named pose", entry.pose, 7)
        poses[checked_name("pose name", entry.name)] = (numbers[:3], unit_wxyz(numbers[3:]))
    if len(poses) < len(message.poses):
        raise MessageError(f"poses {list(poses)[:20]}, expected distinct names")
    return checked_stamp(message.stamp_ns), poses
