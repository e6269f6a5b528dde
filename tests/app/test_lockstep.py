"""A session in lock-step depends on scenario, assets and seed, and is what a live one would be."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pytest

from app.__main__ import main
from app.lockstep import record_lockstep
from app.processes.config import BusConfig, SiteConfig, SiteFiles
from scene.site import DEFAULT_SITE
from spatial.errors import FileInputError
from spatial.stamp import NS_PER_MS
from wire.codec import decode_joints, decode_named_poses, decode_tracked
from wire.recording import Recording

from .conftest import DURATION_S, record


def digest(path: Path, *, ends: tuple[str, ...]) -> str:
    """Return the hash of log times and bytes of some topics."""
    said = hashlib.sha256()
    with Recording(path) as recording:
        topics = [topic for topic in recording.topics if topic.endswith(ends)]
        for message in recording.iterate(topics=topics):
            said.update(f"{message.log_ns} {message.topic} ".encode())
            said.update(message.payload)
    return said.hexdigest()


def test_the_same_seed_gives_the_same_bytes_and_another_one_others(
    recording: Path, tmp_path: Path
) -> None:
    again = record(tmp_path / "again.mcap", duration_s=0.8)
    short = digest_until(recording, again)
    assert short[0] == short[1]
    other = record(tmp_path / "other.mcap", seed=2, duration_s=0.3)
    assert digest(other, ends=("/vio",)) != digest(again, ends=("/vio",))


def digest_until(first: Path, second: Path) -> tuple[list[bytes], list[bytes]]:
    """Return all messages of both up to where the shorter one ends."""
    with Recording(first) as a, Recording(second) as b:
        until_ns = min(a.interval_ns[1], b.interval_ns[1])
        streams = [
            [
                f"{m.log_ns} {m.topic} {hashlib.sha256(m.payload).hexdigest()}".encode()
                for m in recording.iterate(until_ns=until_ns)
            ]
            for recording in (a, b)
        ]
    assert any(b"image" in line for line in streams[1])
    assert any(b"tracked" in line for line in streams[1])
    return streams[0], streams[1]


def test_a_recording_holds_every_stream_at_its_rate(recording: Path) -> None:
    with Recording(recording) as held:
        counts = {stream.key: stream.count for stream in held.streams()}
        about = json.loads(held.attachments()["lockstep.json"])
        site = held.attachments()["site.toml"].decode()
    assert counts["sam/vio"] == pytest.approx(200 * DURATION_S, rel=0.02)
    assert counts["sam/joints"] == pytest.approx(250 * DURATION_S, rel=0.02)
    assert counts["sam/tracked"] == counts["sam/vio"]
    assert counts["sam/track_report"] > 0
    assert counts["sam/camera/hc/calibration"] == counts["sam/robot_description"] == 1
    assert counts["truth/poses"] == pytest.approx(200 * DURATION_S, rel=0.02)
    assert (about["scenario"], about["seed"], about["renderer"]) == ("pick", 1, "painter")
    assert site == DEFAULT_SITE.read_text(encoding="utf-8")


def test_log_times_are_arrivals_and_answers_come_when_they_are_ready(recording: Path) -> None:
    with Recording(recording) as held:
        messages = list(held.iterate())
        about = json.loads(held.attachments()["lockstep.json"])
    late = {m.topic: (m.log_ns - m.stamp_ns) / NS_PER_MS for m in messages}
    assert 70.0 < late["sam/camera/hc/image"] < 120.0
    assert 3.0 < late["sam/vio"] < 17.0
    arrived = {
        decode_stamp: m.log_ns
        for m in messages
        if m.topic == "sam/camera/hc/image"
        for decode_stamp in [m.stamp_ns]
    }
    said = {m.stamp_ns: m.log_ns for m in messages if m.topic == "sam/track_report"}
    waits = {said[s] - arrived[s] for s in said.keys() & arrived.keys()}
    assert waits == {round(about["processing_ms"] * NS_PER_MS)}
    motions = {m.stamp_ns: m.log_ns for m in messages if m.topic == "sam/vio"}
    for message in messages:
        if message.topic == "sam/tracked":
            assert message.log_ns == motions[decode_tracked(message.payload).stamp_ns]


def test_the_operator_moves_the_arm(recording: Path) -> None:
    with Recording(recording) as held:
        moved = [decode_joints(m.payload) for m in held.iterate(topics=["sam/joints"])]
        truth = [decode_named_poses(m.payload)[1] for m in held.iterate(topics=["truth/poses"])]
    assert abs(moved[-1].positions_rad - moved[0].positions_rad).max() > 0.005
    assert "object/cage" in truth[0]


def test_truth_stays_out_unless_it_is_asked_for(tmp_path: Path) -> None:
    config = SiteConfig(
        bus=BusConfig(endpoint="", site="sam"),
        files=SiteFiles(site=str(DEFAULT_SITE)),
        scenario="pick",
        seed=1,
    )
    path = tmp_path / "blind.mcap"
    record_lockstep(
        config, path=path, duration_s=0.05, with_truth=False, backend="painter", rates_hz={}
    )
    with Recording(path) as held:
        assert not [topic for topic in held.topics if topic.startswith("truth")]
    with pytest.raises(FileInputError, match=r"exist.*blind\.mcap"):
        record_lockstep(config, path=path, duration_s=0.05, with_truth=False, rates_hz={})


def test_the_command_records_and_prints_nothing_on_standard_output(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "site.mcap"
    arguments = ["site", "--lock-step", "--record", str(path), "--duration", "0.1"]
    assert main([*arguments, "--delay-ms", "vio=1"]) == 0
    said = capsys.readouterr()
    assert said.out == ""
    assert str(path) in said.err
    with Recording(path) as held:
        assert "sam/vio" in held.topics
    assert main(arguments) == 2
    assert "exist" in capsys.readouterr().err
