"""Messages: golden bytes, what goes in comes out, what cannot be is refused."""

from __future__ import annotations

import dataclasses
import json
import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.Odometry_pb2 import Odometry
from hypothesis import given
from hypothesis import strategies as st

from spatial.camera import PinholeCamera
from spatial.errors import InputError, MessageError
from spatial.frames import Cam, Object
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
from spatial.tracked import (
    PoseMeasurement,
    TagUse,
    TrackedObject,
    TrackedObjects,
    TrackReport,
    TrackState,
)
from wire import codec, codec_time
from wire.codec import Encoded
from wire.codec_time import ClockProbe, EventMark, PlaybackState
from wire.generated.telepresence.v1 import telepresence_pb2 as pb
from wire.proto.generate import GENERATED, generate

STAMP = 1_700_000_000_123_456_789
JPEG = b"\xff\xd8\xff\xe0rest of the picture\xff\xd9"
POSE: Pose[Any, Any] = Pose.parse([0.1, -0.2, 0.75], [0.5, 0.5, -0.5, 0.5])
COVARIANCE = np.diag([1.0, 2.0, 4.0, 0.5, 0.25, 0.125]) * 2.0**-16
CAMERA = PinholeCamera(1280, 960, 900.5, 901.5, 639.5, 479.5, (-0.1, 0.01, 0.001, -0.002, 0.0))


def tracked_object(slug: str, pose: Pose[Cam, Object] | None = POSE) -> TrackedObject:
    return TrackedObject(
        slug=slug,
        revision=3,
        camera="hc",
        state=TrackState.BRIDGED if pose is not None else TrackState.LOST,
        T_cam_object=pose,
        xi_w_cam_cam=np.arange(6.0) / 8,
        covariance=COVARIANCE if pose is not None else np.zeros((6, 6)),
        seen_ns=STAMP - 40_000_000 if pose is not None else 0,
        motion_ns=STAMP,
        reset_count=1,
        reason="no tag in view",
    )


TAGS = (
    TagUse("tag36h11", 7, np.arange(8.0).reshape(4, 2) + 0.25, True, "", 0.125),
    TagUse("tag36h11", 8, np.arange(8.0).reshape(4, 2), False, "bits differ", 3.5),
)
SAMPLES: dict[str, Any] = {
    "image": ImageSample("hc", STAMP, JPEG),
    "calibration": CalibrationSample("hc", STAMP, CAMERA),
    "motion": MotionSample(STAMP, POSE, np.arange(6.0) / 4, np.arange(3.0), 2, True),
    "joints": JointSample(STAMP, ("A1", "A2"), np.ones(2), np.arange(2.0), np.array([1.5, -2])),
    "wrench": WrenchSample(STAMP, np.array([1.0, 2, 3]), np.array([0.5, 0, -1])),
    "health": HealthSample(STAMP, "tracker", "warning", "dark", {"b_hz": 180.5, "a_ms": 3.0}),
    "command": ToolCommand(STAMP, 12, 200_000_000, POSE),
    "measurement": PoseMeasurement("hc", "peg", STAMP, POSE, COVARIANCE, "joint"),
    "tracked": TrackedObjects(STAMP, (tracked_object("peg"), tracked_object("cage", None))),
    "report": TrackReport(
        "hc", "peg", STAMP, "joint", TAGS, (7, 8, 9), POSE, None, 4, 0.125, "because"
    ),
}
DECODERS: dict[str, Callable[[bytes], Any]] = {
    "image": codec.decode_image,
    "calibration": codec.decode_calibration,
    "motion": codec.decode_motion,
    "joints": codec.decode_joints,
    "wrench": codec.decode_wrench,
    "health": codec.decode_health,
    "command": codec.decode_command,
    "measurement": codec.decode_measurement,
    "tracked": codec.decode_tracked,
    "report": codec.decode_report,
    "robot_description": codec.decode_robot_description,
    "link_transforms": codec.decode_link_transforms,
    "named_poses": codec.decode_named_poses,
    "probe": codec_time.decode_probe,
    "playback": codec_time.decode_playback,
    "event": codec_time.decode_event,
}


def encoded() -> dict[str, Encoded]:
    """Every example as bytes."""
    poses = {"tcp": (POSE.translation, POSE.quaternion_wxyz)}
    return {name: codec.encode(sample) for name, sample in SAMPLES.items()} | {
        "robot_description": codec.encode_robot_description('<robot name="r"/>'),
        "link_transforms": codec.encode_link_transforms(STAMP, "base", {"tcp": POSE, "hc": POSE}),
        "named_poses": codec.encode_named_poses(STAMP, poses),
        "probe": codec_time.encode_probe(ClockProbe(9, 4, -5, STAMP, STAMP + 7)),
        "playback": codec_time.encode_playback(
            PlaybackState(STAMP, 0.5, True, STAMP - 10, STAMP + 10, 2)
        ),
        "event": codec_time.encode_event(EventMark(STAMP, "contact", "peg touched the plate")),
    }


GOLDEN = Path(__file__).with_name("golden.json")
NAMES = sorted(DECODERS)


def same(a: Any, b: Any) -> bool:
    """Equality through dataclasses, arrays and poses."""
    if isinstance(a, Pose):
        return isinstance(b, Pose) and np.allclose(a.matrix, b.matrix, atol=1e-12)
    if isinstance(a, np.ndarray):
        return np.allclose(a, b, rtol=1e-6, atol=0) and a.shape == b.shape
    if isinstance(a, PinholeCamera):
        return bool(a == b)
    if dataclasses.is_dataclass(a):
        return type(a) is type(b) and all(
            same(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a)
        )
    if isinstance(a, tuple):
        return len(a) == len(b) and all(map(same, a, b))
    return bool(a == b)


def test_every_message_has_its_golden_bytes() -> None:
    golden = json.loads(GOLDEN.read_text())
    actual = {name: [e.schema, e.payload.hex()] for name, e in sorted(encoded().items())}
    assert actual == golden


@pytest.mark.parametrize("name", sorted(SAMPLES))
def test_sample_comes_back_as_it_went_in(name: str) -> None:
    assert same(SAMPLES[name], DECODERS[name](codec.encode(SAMPLES[name]).payload))


def test_generated_code_is_what_the_sources_compile_to(tmp_path: Path) -> None:
    for file in generate(tmp_path):
        assert (tmp_path / file).read_text() == (GENERATED / file).read_text(), file


FINITE = st.floats(-1e6, 1e6)
VECTORS = st.lists(FINITE, min_size=6, max_size=6).map(np.array)


@given(VECTORS, st.integers(1, 2**63 - 1), st.booleans())
def test_motion_round_trips(xi: np.ndarray, stamp_ns: int, jump: bool) -> None:
    pose: Pose[Any, Any] = Pose.exp(xi / 1e6)
    sample = dataclasses.replace(
        SAMPLES["motion"], stamp_ns=stamp_ns, T_w_cam=pose, xi_w_cam_cam=xi, jump_flagged=jump
    )
    assert same(sample, codec.decode_motion(codec.encode(sample).payload))


@given(VECTORS, VECTORS)
def test_covariance_round_trips_to_float32(xi: np.ndarray, row: np.ndarray) -> None:
    a = np.outer(row, row)
    entry = dataclasses.replace(
        tracked_object("peg", Pose.exp(xi / 1e6)), covariance=a, xi_w_cam_cam=xi
    )
    sample = TrackedObjects(STAMP, (entry,))
    back = codec.decode_tracked(codec.encode(sample).payload).objects[0]
    assert np.allclose(back.covariance, a, rtol=1e-6, atol=1e-40)
    assert np.array_equal(back.covariance, back.covariance.T)
    assert same(back.T_cam_object, entry.T_cam_object)


@given(st.dictionaries(st.text(min_size=1, max_size=20), FINITE, max_size=5), st.text(max_size=99))
def test_health_round_trips_any_text(values: dict[str, float], text: str) -> None:
    sample = HealthSample(STAMP, "site", "ok", text, values)
    assert same(sample, codec.decode_health(codec.encode(sample).payload))


@pytest.mark.parametrize("name", NAMES)
@given(junk=st.binary(max_size=300))
def test_garbage_is_refused_and_nothing_else_happens(name: str, junk: bytes) -> None:
    with pytest.raises(MessageError):
        DECODERS[name](junk)


@pytest.mark.parametrize("name", NAMES)
def test_every_damaged_byte_gives_a_message_or_a_message_error(name: str) -> None:
    payload = encoded()[name].payload
    for index in range(len(payload)):
        for value in (0, 0x7F, 0xFF, payload[index] ^ 1):
            damaged = payload[:index] + bytes([value]) + payload[index + 1 :]
            _decode_or_refuse(name, damaged)
        _decode_or_refuse(name, payload[:index])


def _decode_or_refuse(name: str, payload: bytes) -> None:
    try:
        DECODERS[name](payload)
    except MessageError:
        return


@pytest.mark.parametrize("name", NAMES)
def test_absurd_size_is_refused(name: str) -> None:
    with pytest.raises(MessageError):
        DECODERS[name](bytes(17 * 1024 * 1024))


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("index", range(7))
def test_pose_that_is_not_finite_is_refused(bad: float, index: int) -> None:
    message = pb.ToolCommand.FromString(encoded()["command"].payload)
    message.base_tcp[index] = bad
    with pytest.raises(MessageError):
        codec.decode_command(message.SerializeToString())


@pytest.mark.parametrize("wxyz", [(0, 0, 0, 0), (2, 0, 0, 0), (0.9, 0, 0, 0)])
def test_quaternion_not_of_unit_length_is_refused(wxyz: tuple[float, ...]) -> None:
    message = pb.TrackedObjects.FromString(encoded()["tracked"].payload)
    message.objects[0].cam_object[3:] = wxyz
    with pytest.raises(MessageError, match="unit"):
        codec.decode_tracked(message.SerializeToString())


def test_foxglove_quaternion_is_xyzw_and_checked() -> None:
    message = Odometry.FromString(encoded()["motion"].payload)
    w, x, y, z = POSE.quaternion_wxyz
    q = message.pose.orientation
    assert (q.w, q.x, q.y, q.z) == (w, x, y, z)
    q.w = math.nan
    with pytest.raises(MessageError, match="finite"):
        codec.decode_motion(message.SerializeToString())


def test_odometry_of_others_decodes_without_our_extension() -> None:
    message = Odometry.FromString(encoded()["motion"].payload)
    message.DiscardUnknownFields()
    motion = codec.decode_motion(message.SerializeToString())
    assert motion.reset_count == 0
    assert not motion.acceleration_cam.any()


@pytest.mark.parametrize("name", ["wrench", "tracked", "report", "command", "measurement"])
def test_stamp_of_zero_is_refused(name: str) -> None:
    sample = dataclasses.replace(SAMPLES[name], stamp_ns=0)
    with pytest.raises(MessageError, match="stamp 0"):
        DECODERS[name](codec.encode(sample).payload)


def test_stamp_before_1970_is_refused() -> None:
    sample = dataclasses.replace(SAMPLES["motion"], stamp_ns=-1)
    with pytest.raises(MessageError, match="stamp"):
        codec.decode_motion(codec.encode(sample).payload)


def test_negative_variance_is_refused() -> None:
    bad = COVARIANCE - np.eye(6)
    sample = dataclasses.replace(SAMPLES["measurement"], covariance=bad)
    with pytest.raises(MessageError, match="negative variance"):
        codec.decode_measurement(codec.encode(sample).payload)


def test_repeated_slug_is_refused() -> None:
    sample = TrackedObjects(STAMP, (tracked_object("peg"), tracked_object("peg")))
    with pytest.raises(MessageError, match="distinct"):
        codec.decode_tracked(codec.encode(sample).payload)


def test_thousand_objects_are_refused() -> None:
    sample = TrackedObjects(STAMP, tuple(tracked_object(f"o{i}") for i in range(1000)))
    with pytest.raises(MessageError, match="1000 objects"):
        codec.decode_tracked(codec.encode(sample).payload)


def test_image_that_is_no_jpeg_is_refused() -> None:
    message = CompressedImage.FromString(encoded()["image"].payload)
    message.data = JPEG[1:]
    with pytest.raises(MessageError, match="jpeg"):
        codec.decode_image(message.SerializeToString())


def test_unknown_health_level_is_refused_where_it_is_made() -> None:
    with pytest.raises(InputError, match="fine"):
        codec.encode(dataclasses.replace(SAMPLES["health"], level="fine"))


def test_decoded_arrays_are_read_only() -> None:
    motion = codec.decode_motion(encoded()["motion"].payload)
    with pytest.raises(ValueError, match="read-only"):
        motion.xi_w_cam_cam[0] = 1.0


def test_eight_objects_cost_less_than_a_millisecond_both_ways() -> None:
    sample = TrackedObjects(STAMP, tuple(tracked_object(f"o{i}") for i in range(8)))
    best = math.inf
    for _ in range(5):
        start = time.process_time()
        for _ in range(40):
            codec.decode_tracked(codec.encode(sample).payload)
        best = min(best, (time.process_time() - start) / 40)
    assert best < 1e-3, f"{best * 1e6:.0f} us"
