"""`telepresence track`: a recording tracked again."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from app.__main__ import main
from app.perception import Perception
from app.recorded import track_recording
from app.stepped import SteppedTracker
from app.tracklive import ListeningBus, run
from app.tracklog import COLUMNS, TimedPerception, TrackLog
from scene.database import Database
from scene.robot import Robot
from scene.site import DEFAULT_SITE, Site
from spatial.errors import FileInputError
from spatial.samples import ImageSample
from spatial.stamp import NS_PER_MS
from spatial.tracked import TrackedObjects, TrackReport
from wire.bus import Sample, Subscription
from wire.clock import VirtualClock
from wire.codec import decode_image, encode
from wire.keys import Keys
from wire.memory_bus import MemoryBus
from wire.recorder import Recorder
from wire.recording import Recorded, Recording

Loaded = tuple[Site, Robot, Database]
IN_SIGHT_M = 0.006
"""Bar of the painted session: 0.7 m from the tags, calibration wrong by up to 0.2 % and 1 mm."""


def rewritten(source: Path, path: Path, change: Callable[[Recorded], bytes | None]) -> Path:
    """Copy a recording with other payloads; `None` leaves a message out."""
    keys, clock = Keys(), VirtualClock(1)
    with MemoryBus() as bus, Recording(source) as recording:
        recorder = Recorder(bus, path, keys=keys, clock=clock, with_truth=True)
        for message in recording.iterate():
            payload = change(message)
            if payload is not None:
                clock.set(message.log_ns)
                bus.publish(keys.of_topic(message.topic), payload, schema=message.schema)
                recorder.tick()
        recorder.stop()
    return path


class Heard:
    """Keeps what a tracker says."""

    def __init__(self) -> None:
        self.said: list[tuple[int, bytes]] = []

    def tracked(self, at_ns: int, tracked: TrackedObjects) -> None:
        self.said.append((at_ns, encode(tracked).payload))

    def reports(self, at_ns: int, reports: tuple[TrackReport, ...]) -> None:
        pass


def again(path: Path, loaded: Loaded, *, truth: bool) -> list[tuple[int, bytes]]:
    """Return what a tracker says of a recording, with the truth passed to it or not."""
    site, robot, database = loaded
    heard = Heard()
    tracker = SteppedTracker(
        Perception(site=site, robot=robot, database=database, method="joint"),
        site=site.name,
        processing_ns=15 * NS_PER_MS,
        listener=heard,
    )
    with Recording(path) as recording:
        for message in recording.iterate():
            if truth or not message.topic.startswith("truth"):
                tracker.put(message.log_ns, message.topic, message.payload)
    return heard.said


def test_a_recording_tracked_again_gives_the_poses_the_operator_saw(
    recording: Path, loaded: Loaded
) -> None:
    with Recording(recording) as held:
        then = [(m.log_ns, m.payload) for m in held.iterate(topics=["sam/tracked"])]
    assert again(recording, loaded, truth=False) == then
    assert again(recording, loaded, truth=True) == then


def test_the_report_is_the_contract_and_repeats(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    reports = []
    for name in ("a.csv", "b.csv"):
        assert main(["track", str(recording), "--json", "--out", str(tmp_path / name)]) == 0
        reports.append(json.loads(capsys.readouterr().out))
    first = reports[0]
    assert first["method"] == "joint"
    assert first["frames"] >= 10
    assert set(first["state_s"]) == {"tracked", "bridged", "stale", "lost"}
    assert 0.0 < first["run_time_ms"]["p50"] <= first["run_time_ms"]["p95"]
    axes = ("x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad")
    assert all(0.0 < first[f"rmse_{axis}"] < 0.02 for axis in axes)
    assert reports[0]["poses_sha256"] == reports[1]["poses_sha256"]
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()


def test_errors_in_sight_are_small_and_nothing_leaps(recording: Path, loaded: Loaded) -> None:
    site, robot, database = loaded
    report = track_recording(recording, site=site, robot=robot, database=database)
    for slug, figures in report["objects"].items():
        mobile = site.object(slug).motion == "mobile"  # carried by pixels alone
        assert figures["rmse_in_sight_m"] < (0.012 if mobile else IN_SIGHT_M), slug
        assert figures["max_step_residual_m"] < 0.010, slug
        assert figures["longest_freeze_ms"] <= 200.0, slug
        assert figures["state_s"]["tracked"] > 0.5, slug


def test_the_table_holds_every_pose_with_a_covariance(
    recording: Path, loaded: Loaded, tmp_path: Path
) -> None:
    site, robot, database = loaded
    out = tmp_path / "poses.csv"
    report = track_recording(recording, site=site, robot=robot, database=database, out=out)
    with out.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert tuple(rows[0]) == COLUMNS
    assert len(rows) == report["poses"]
    covariances = np.zeros((len(rows), 6, 6))
    upper = np.triu_indices(6)
    names = [name for name in COLUMNS if name.startswith("cov_")]
    for i, row in enumerate(rows):
        covariances[i][upper] = [float(row[name]) for name in names]
        covariances[i] += np.triu(covariances[i], 1).T
    assert (np.linalg.eigvalsh(covariances)[:, 0] > 0.0).all()
    norms = np.linalg.norm([[float(r[q]) for q in ("qw", "qx", "qy", "qz")] for r in rows], axis=1)
    np.testing.assert_allclose(norms, 1.0, atol=1e-6)
    assert {row["state"] for row in rows} <= {"tracked", "bridged", "stale", "lost"}


@pytest.mark.parametrize("method", ["algorithm1", "multiart", "single"])
def test_every_method_runs(recording: Path, loaded: Loaded, method: str) -> None:
    site, robot, database = loaded
    report = track_recording(recording, site=site, robot=robot, database=database, method=method)
    assert report["method"] == method
    assert report["frames"] >= 10
    plate = report["objects"]["hole_plate"]
    assert sum(plate["state_s"].values()) == pytest.approx(1.48, abs=0.03)
    if method == "single":  # the others wait for an image with all tags of an object
        assert plate["rmse_in_sight_m"] < 0.05


def test_garbage_is_counted_and_the_rest_is_used(
    recording: Path, loaded: Loaded, tmp_path: Path
) -> None:
    site, robot, database = loaded
    seen = 0

    def spoil(message: Recorded) -> bytes | None:
        nonlocal seen
        if not message.topic.endswith("hc/image"):
            return message.payload
        seen += 1
        if seen == 2:
            return b"\xff garbage"
        if seen == 3:
            old = decode_image(message.payload)
            return encode(ImageSample("hc", old.stamp_ns, old.jpeg[:40])).payload
        return message.payload

    path = rewritten(recording, tmp_path / "spoilt.mcap", spoil)
    report = track_recording(path, site=site, robot=robot, database=database)
    assert report["refused"] == 2
    assert any("not a JPEG" in reason for reason in report["warnings"])
    assert report["objects"]["cage"]["state_s"]["tracked"] > 0.3


def test_images_of_another_size_or_camera_are_a_plain_error(
    recording: Path, loaded: Loaded, tmp_path: Path
) -> None:
    site, robot, database = loaded
    jpeg = cv2.imencode(".jpg", np.zeros((48, 64), np.uint8))[1].tobytes()

    def resized(camera: str) -> Callable[[Recorded], bytes | None]:
        def change(message: Recorded) -> bytes | None:
            if "/image" not in message.topic:
                return message.payload
            old = decode_image(message.payload)
            return encode(ImageSample(camera, old.stamp_ns, jpeg)).payload

        return change

    small = rewritten(recording, tmp_path / "small.mcap", resized("hc"))
    with pytest.raises(FileInputError, match=r"64x48, calibrated is 1280x960 \(.*small\.mcap"):
        track_recording(small, site=site, robot=robot, database=database)
    strange = rewritten(recording, tmp_path / "strange.mcap", resized("kinect"))
    with pytest.raises(FileInputError, match="unknown camera 'kinect'; available: hc, mako"):
        track_recording(strange, site=site, robot=robot, database=database)


def test_recordings_without_motion_still_give_a_pose_per_image(
    recording: Path, loaded: Loaded, tmp_path: Path
) -> None:
    site, robot, database = loaded
    still = rewritten(
        recording,
        tmp_path / "still.mcap",
        lambda m: None if m.topic.endswith(("/vio", "/tracked")) else m.payload,
    )
    report = track_recording(still, site=site, robot=robot, database=database)
    assert report["poses"] > 0
    assert report["objects"]["cage"]["state_s"]["bridged"] == 0.0


def test_bad_input_ends_with_one_line(
    recording: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def failure(*arguments: str) -> str:
        assert main(["track", *arguments]) == 2
        said = capsys.readouterr()
        assert said.out == ""
        assert said.err.count("\n") == 1
        return said.err

    assert "not in this build" in failure(str(recording), "--method", "apriltag2")
    assert "no such recording" in failure(str(tmp_path / "none.mcap"))
    text = tmp_path / "text.mcap"
    text.write_text("nothing", "utf-8")
    assert "recording" in failure(str(text))
    site = tmp_path / "other.toml"
    site.write_text(
        DEFAULT_SITE.read_text(encoding="utf-8").replace('name = "sam"', 'name = "lab"'), "utf-8"
    )
    assert "no images of site 'lab'" in failure(str(recording), "--site", str(site))
    assert "unknown object" in failure(str(recording), "--objects", str(tmp_path))
    cut = tmp_path / "cut.mcap"
    shutil.copy(recording, cut)
    with cut.open("r+b") as file:
        file.truncate(cut.stat().st_size // 2)
    assert "repair" in failure(str(cut))


class Drip:
    """Odometry that comes in two parts, the second when an image was looked at, then Ctrl-C."""

    def __init__(self, inner: Subscription, perception: TimedPerception) -> None:
        self._inner, self._perception = inner, perception
        self._rest: list[Sample] | None = None
        self.dropped = 0

    def take(self) -> list[Sample]:
        if self._rest is None:
            samples = self._inner.take()
            self._rest = samples[-20:]
            return samples[:-20]
        if not self._perception.run_times_ms:
            return []
        if not self._rest:
            raise KeyboardInterrupt
        samples, self._rest = self._rest, []
        return samples

    def wait(self, timeout_s: float) -> bool:
        return self._inner.wait(timeout_s)

    def close(self) -> None:
        self._inner.close()


class Replay(ListeningBus):
    """A bus on which a recording is played as soon as everything is subscribed."""

    def __init__(self, bus: MemoryBus, played: Path, perception: TimedPerception) -> None:
        super().__init__(bus, lambda _key, _payload: None)
        self._memory, self._played, self._perception = bus, played, perception
        self._left = 2 + 2 * len(perception.cameras)  # joints, motion; calibration, images

    def subscribe(self, key_expr: str, *, capacity: int, latched: bool = False) -> Subscription:
        subscription = super().subscribe(key_expr, capacity=capacity, latched=latched)
        self._left -= 1
        if self._left == 0:
            with Recording(self._played) as recording:
                for message in recording.iterate():
                    if not message.topic.endswith(("tracked", "track_report")):
                        key = Keys().of_topic(message.topic)
                        self._memory.publish(key, message.payload, schema=message.schema)
        return Drip(subscription, self._perception) if key_expr == Keys().vio else subscription


def test_a_live_tracker_listens_and_publishes_nothing(
    recording: Path, loaded: Loaded, capsys: pytest.CaptureFixture[str]
) -> None:
    site, robot, database = loaded
    perception = TimedPerception(site=site, robot=robot, database=database, method="joint")
    with MemoryBus() as bus, TrackLog() as log:
        others = bus.subscribe("live/**", capacity=10_000)
        replay = Replay(bus, recording, perception)
        run(replay, site.name, perception, log, clock=VirtualClock(), duration_s=60.0)
        heard = {sample.key for sample in others.take()}
        figures = log.figures()
    assert figures["poses"] > 0
    assert not heard & {Keys().tracked, Keys().track_report}
    assert "stopping" in capsys.readouterr().err
