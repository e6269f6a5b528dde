"""Recordings: the bytes of the bus, whole or made whole, told apart from other files."""

from __future__ import annotations

import dataclasses
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from mcap.reader import make_reader

from spatial.errors import FileInputError, StateError
from spatial.stamp import NS_PER_MS, NS_PER_S
from spatial.tracked import TrackedObjects
from wire import codec
from wire.bus import Qos, Sample
from wire.clock import LOCKSTEP_EPOCH_NS, SystemClock, VirtualClock
from wire.codec_time import decode_event
from wire.keys import Keys, qos_of
from wire.memory_bus import MemoryBus
from wire.peek import capture_stamp_ns
from wire.recorder import Recorder
from wire.recording import Recording, info
from wire.repair import repair
from wire.schemas import schema_data

MS = NS_PER_MS
KEYS = Keys()
START = LOCKSTEP_EPOCH_NS


def tracked(stamp_ns: int) -> bytes:
    return codec.encode(TrackedObjects(stamp_ns, ())).payload


TRACKED = "telepresence.v1.TrackedObjects"


def record(path: Path, *, seconds: float = 2.0, step_ns: int = 10 * MS) -> list[Sample]:
    """Record poses at 100 Hz and a robot description, in lock-step; return what was sent."""
    bus, clock = MemoryBus(), VirtualClock(START)
    urdf = codec.encode_robot_description("<robot/>")
    bus.publish(KEYS.robot_description, urdf.payload, schema=urdf.schema, qos=Qos.LATCHED)
    sent = [Sample(KEYS.robot_description, urdf.payload, urdf.schema)]
    recorder = Recorder(bus, path, keys=KEYS, clock=clock)
    for _ in range(round(seconds * NS_PER_S / step_ns)):
        payload = tracked(clock.now_ns() - 30 * MS)
        bus.publish(KEYS.tracked, payload, schema=TRACKED)
        sent.append(Sample(KEYS.tracked, payload, TRACKED))
        recorder.tick()
        clock.advance(step_ns)
    recorder.attach("site.toml", b"name = 'sam'")
    assert recorder.stop().messages == len(sent)
    return sent


def test_recording_holds_the_bytes_of_the_bus_without_the_session(tmp_path: Path) -> None:
    sent = record(tmp_path / "a.mcap")
    with Recording(tmp_path / "a.mcap") as recording:
        read = list(recording.iterate())
        assert [(f"live/{r.topic}", r.payload, r.schema) for r in read] == [
            (s.key, s.payload, s.schema) for s in sent
        ]
        assert recording.attachments() == {"site.toml": b"name = 'sam'"}
        assert recording.metadata() == {"telepresence": {"session": "live", "site": "sam"}}
    poses = [r for r in read if r.topic == "sam/tracked"]
    assert [r.stamp_ns for r in poses] == [r.log_ns - 30 * MS for r in poses]


def test_other_tools_can_decode_it(tmp_path: Path) -> None:
    record(tmp_path / "a.mcap", seconds=0.1)
    with (tmp_path / "a.mcap").open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    schemas = {s.name: (s.encoding, len(s.data) > 10) for s in summary.schemas.values()}
    assert schemas == {
        "std_msgs/msg/String": ("jsonschema", True),
        TRACKED: ("protobuf", True),
    }
    assert {c.message_encoding for c in summary.channels.values()} == {"json", "protobuf"}


@pytest.mark.parametrize("name", ["Odometry", "FrameTransforms", "CompressedImage", "Log"])
def test_foxglove_schemas_are_embedded_with_what_they_need(name: str) -> None:
    encoding, data = schema_data(f"foxglove.{name}")
    assert encoding == "protobuf"
    assert b"google/protobuf/timestamp.proto" in data


@pytest.mark.parametrize("name", ["foxglove.Nothing", "x.Y", "", "foxglove.os.system"])
def test_unknown_schema_is_no_harm(name: str) -> None:
    assert schema_data(name) == ("", b"")


def test_info_says_what_is_inside(tmp_path: Path) -> None:
    record(tmp_path / "a.mcap")
    result = info(tmp_path / "a.mcap")
    assert result["whole"]
    assert result["duration_s"] == pytest.approx(1.99)
    assert result["attachments"] == ["site.toml"]
    assert result["warnings"] == []
    assert result["streams"][1] == {
        "key": "sam/tracked",
        "schema": TRACKED,
        "count": 200,
        "hz": pytest.approx(100.0),
        "first_ns": START,
        "last_ns": START + 1990 * MS,
    }


def test_latched_and_plain_topics_are_told_apart_by_name() -> None:
    assert qos_of("sam/robot_description") is Qos.LATCHED
    assert qos_of("sam/camera/hc/calibration") is Qos.LATCHED
    assert qos_of("sam/camera/hc/image") is Qos.IMAGE
    assert qos_of("sam/tracked") is Qos.STATE


def test_truth_is_recorded_only_when_asked(tmp_path: Path) -> None:
    for with_truth in (False, True):
        bus, path = MemoryBus(), tmp_path / f"{with_truth}.mcap"
        recorder = Recorder(bus, path, keys=KEYS, clock=VirtualClock(), with_truth=with_truth)
        bus.publish(KEYS.truth("poses"), b"opaque", schema="s")
        bus.publish(KEYS.vio, b"v", schema="s")
        bus.publish("replay-1/sam/vio", b"another session", schema="s")
        recorder.stop()
        with Recording(path) as recording:
            assert recording.topics == (["sam/vio", "truth/poses"] if with_truth else ["sam/vio"])


def test_only_wanted_topics_are_recorded(tmp_path: Path) -> None:
    bus, path = MemoryBus(), tmp_path / "a.mcap"
    recorder = Recorder(bus, path, keys=KEYS, clock=VirtualClock(), topics=("*/vio", "*/camera/**"))
    for key in (KEYS.vio, KEYS.joints, KEYS.image("hc")):
        bus.publish(key, b"", schema="s")
    recorder.stop()
    assert [s["key"] for s in info(path)["streams"]] == ["sam/camera/hc/image", "sam/vio"]


def test_marks_come_back_from_the_bus(tmp_path: Path) -> None:
    bus, path = MemoryBus(), tmp_path / "a.mcap"
    with Recorder(bus, path, keys=KEYS, clock=SystemClock()) as recorder:
        recorder.mark("contact", "peg touched the plate")
    with Recording(path) as recording:
        (mark,) = [decode_event(r.payload) for r in recording.iterate()]
    assert (mark.name, mark.text) == ("contact", "peg touched the plate")
    with pytest.raises(StateError, match="ended"):
        recorder.mark("late")
    with pytest.raises(StateError, match="ended"):
        recorder.attach("late", b"")


def test_messages_that_come_too_fast_are_dropped_and_counted(tmp_path: Path) -> None:
    bus = MemoryBus()
    recorder = Recorder(bus, tmp_path / "a.mcap", keys=KEYS, clock=VirtualClock(), capacity=10)
    for _ in range(25):
        bus.publish(KEYS.vio, b"", schema="s")
    status = recorder.stop()
    assert (status.messages, status.dropped) == (10, 15)


def test_file_that_exists_is_not_overwritten_unasked(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_text("precious")
    with pytest.raises(FileInputError, match=r"exists.*a\.mcap"):
        Recorder(MemoryBus(), path, keys=KEYS, clock=VirtualClock())
    assert path.read_text() == "precious"
    with pytest.raises(FileInputError, match="cannot record"):
        Recorder(MemoryBus(), tmp_path / "no" / "a.mcap", keys=KEYS, clock=VirtualClock())


def test_arrival_times_never_go_back(tmp_path: Path) -> None:
    class Jumping:
        times = iter([START, START + 5, START + 3, START + 9] * 100)

        def now_ns(self) -> int:
            return next(self.times)

    bus, path = MemoryBus(), tmp_path / "a.mcap"
    recorder = Recorder(bus, path, keys=KEYS, clock=Jumping())
    for _ in range(20):
        bus.publish(KEYS.vio, b"", schema="s")
    recorder.stop()
    with Recording(path) as recording:
        times = [r.log_ns for r in recording.iterate()]
    assert times == sorted(times)
    assert len(times) == 20


def test_disk_that_refuses_ends_the_recording_with_a_reason(tmp_path: Path) -> None:
    bus = MemoryBus()
    recorder = Recorder(bus, tmp_path / "a.mcap", keys=KEYS, clock=VirtualClock())
    recorder._file.close()
    recorder._file = recorder._writer = _FullDisk()  # type: ignore[assignment]  # a stand-in
    bus.publish(KEYS.vio, b"", schema="s")
    recorder.tick()
    assert "No space left" in recorder.status.error
    recorder.stop()


class _FullDisk:
    def __getattr__(self, name: str) -> object:
        def refuse(*_: object, **__: object) -> object:
            raise OSError(28, "No space left on device")

        return refuse


@pytest.mark.parametrize("share", [0.2, 0.5, 0.9, 0.999])
def test_truncated_file_is_told_and_repaired_in_place(tmp_path: Path, share: float) -> None:
    path = tmp_path / "a.mcap"
    sent = record(path, seconds=4.0)
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    before = info(path)
    assert not before["whole"]
    assert "repair" in before["warnings"][0]
    with pytest.raises(FileInputError, match="not whole"):
        Recording(path)
    result = repair(path)
    assert result.damaged == tmp_path / "a.mcap.damaged"
    assert result.damaged.read_bytes() == data[: int(share * len(data))]
    assert info(path)["whole"]
    assert sum(s["count"] for s in before["streams"]) == result.messages
    with Recording(path) as recording:
        read = [(f"live/{r.topic}", r.payload) for r in recording.iterate()]
    assert read == [(s.key, s.payload) for s in sent[: len(read)]]
    assert len(read) >= share * len(sent) - 90  # the index at the end holds no message


def test_chunk_with_a_flipped_bit_is_left_out_and_the_rest_saved(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    sent = record(path)
    data = bytearray(path.read_bytes())
    middle = len(data) // 3
    data[middle] ^= 0x10
    path.write_bytes(data)
    result = repair(path, out=tmp_path / "b.mcap")
    assert result.lost_chunks <= 1
    assert len(sent) - 25 <= result.messages
    assert info(tmp_path / "b.mcap")["whole"]
    with pytest.raises(FileInputError, match="exists"):
        repair(path, out=tmp_path / "b.mcap")


def test_repair_of_a_whole_file_changes_nothing(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    record(path)
    data = path.read_bytes()
    assert repair(path).damaged is None
    assert path.read_bytes() == data
    assert [p.name for p in tmp_path.iterdir()] == ["a.mcap"]


@pytest.mark.parametrize(
    "content", [b"", b"PNG", b"\x89MCAP0\r\n", b"\x89MCAP0\r\n" + b"\xff" * 99]
)
def test_other_files_are_refused_by_name(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "photo.mcap"
    path.write_bytes(content)
    for function in (Recording, info, repair):
        with pytest.raises(FileInputError, match=r"photo\.mcap"):
            function(path)
    with pytest.raises(FileInputError, match=r"none\.mcap"):
        info(tmp_path / "none.mcap")


def test_recording_without_a_message_says_so(tmp_path: Path) -> None:
    Recorder(MemoryBus(), tmp_path / "a.mcap", keys=KEYS, clock=VirtualClock()).stop()
    result = info(tmp_path / "a.mcap")
    assert result["whole"]
    assert result["warnings"] == ["no message inside"]


def test_unknown_topic_names_those_inside(tmp_path: Path) -> None:
    record(tmp_path / "a.mcap", seconds=0.1)
    with Recording(tmp_path / "a.mcap") as recording, pytest.raises(FileInputError, match="vio"):
        next(recording.iterate(topics=["sam/vio"]))


def test_last_before_finds_the_newest_not_younger(tmp_path: Path) -> None:
    record(tmp_path / "a.mcap")
    with Recording(tmp_path / "a.mcap") as recording:
        found = recording.last_before("sam/tracked", START + 505 * MS)
        assert found is not None
        assert found.log_ns == START + 500 * MS
        assert recording.last_before("sam/tracked", START - 1) is None
        urdf, late = "sam/robot_description", START + 1900 * MS
        assert recording.last_before(urdf, late, within_ns=500 * MS) is None
        assert recording.last_before(urdf, late) is not None


def test_stamps_are_read_without_decoding() -> None:
    transforms = codec.encode_link_transforms(START + 7, "base", {})
    assert capture_stamp_ns(tracked(START + 7), TRACKED) == START + 7
    assert capture_stamp_ns(transforms.payload, transforms.schema) is None
    assert capture_stamp_ns(b"{}", "std_msgs/msg/String") is None
    for junk in (b"", b"\x09\x01", b"\x0a\xff\xff\xff", b"\x0a\x02\x08", b"\xff" * 20):
        assert capture_stamp_ns(junk, "foxglove.Log") is None


CHILD = """
import sys, time
from pathlib import Path
from wire.clock import SystemClock
from wire.keys import Keys
from wire.memory_bus import MemoryBus
from wire.recorder import Recorder
clock, bus, keys = SystemClock(), MemoryBus(), Keys()
with Recorder(bus, Path(sys.argv[1]), keys=keys, clock=clock):
    for index in range(100_000):
        bus.publish(keys.vio, bytes(200), schema="s")
        if index == 200:
            print("recording", flush=True)
        time.sleep(0.005)
"""


@pytest.mark.processes
def test_killed_recorder_loses_the_last_moment_only(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    command = [sys.executable, "-c", CHILD, str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "recording\n"
        process.send_signal(signal.SIGKILL)
        killed_ns = SystemClock().now_ns()
    assert repair(path).messages > 100
    with Recording(path) as recording:
        assert killed_ns - recording.interval_ns[1] < 300 * MS


def test_recorded_is_plain_data(tmp_path: Path) -> None:
    record(tmp_path / "a.mcap", seconds=0.1)
    with Recording(tmp_path / "a.mcap") as recording:
        first = next(recording.iterate())
    with pytest.raises(dataclasses.FrozenInstanceError):
        first.topic = "x"  # type: ignore[misc]  # that is what is tested
