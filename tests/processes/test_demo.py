"""`demo` as a user starts it: its report, its recording, and that it leaves nothing behind."""

from __future__ import annotations

import json
import re
import signal
import time
from pathlib import Path
from typing import Any

import pytest

from app.__main__ import main
from tests.processes.running import Running, Watch, eventually

pytestmark = [pytest.mark.processes, pytest.mark.timeout(240)]

PERCENTILES = {"p50", "p95"}
REPORT = {
    "tracker_hz",
    "tab_hz",
    "video_fps",
    "predicted_ms",
    "simulated_motion_delay_ms",
    "video_age_ms",
    "dropped",
    "renderer",
    "cpu_cores",
    "objects",
}
OBJECT = {
    "state_s",
    "seen_ms",
    "predicted_ms",
    "rmse_in_sight_m",
    "rmse_bridged_m",
    "rmse_whole_m",
    "rmse_whole_rad",
    "max_step_residual_m",
    "longest_freeze_ms",
}
STREAMS = (
    "sam/camera/hc/image",
    "sam/camera/hc/video",
    "sam/camera/mako/image",
    "sam/vio",
    "sam/joints",
    "sam/wrench",
    "sam/health/.*",
    "sam/tracked",
    "sam/track_report",
    "sam/robot_description",
)


def report_of(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    assert main([*arguments, "--json"]) == 0, capsys.readouterr().err
    found = json.loads(capsys.readouterr().out)
    assert isinstance(found, dict)
    return found


def missing(info: dict[str, Any]) -> list[str]:
    keys = [stream["key"] for stream in info["streams"] if stream["count"]]
    return [wanted for wanted in STREAMS if not any(re.fullmatch(wanted, key) for key in keys)]


def test_a_headless_demo_prints_one_line_of_figures_and_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "demo.mcap"
    options = ("--duration", "6", "--json", "--port", "0", "--record", str(file), "--with-truth")
    with Running("demo", "--headless", *options) as demo:
        assert eventually(lambda: len(demo.children()) == 8, within_s=90), demo.lines
        assert demo.finish(within_s=90) == 0, demo.lines
        assert eventually(lambda: not demo.left(), within_s=5), demo.left()
    assert demo.complaints() == []
    assert len(demo.out) == 1
    assert len(demo.out[0]) < 64 * 1024
    report = json.loads(demo.out[0])
    assert set(report) >= REPORT
    for name in ("predicted_ms", "video_age_ms"):
        assert set(report[name]) == PERCENTILES
    assert set(report["cpu_cores"]) >= {"hub", "site", "tracker", "viewer", "operator", "recorder"}
    assert set(report["video_fps"]) == {"hc", "mako"}
    for item in report["objects"].values():
        assert set(item) >= OBJECT
        assert set(item["state_s"]) == {"tracked", "bridged", "stale", "lost"}
        assert set(item["seen_ms"]) == set(item["predicted_ms"]) == PERCENTILES
    assert report["tracker_hz"] > 0
    assert report["tab_hz"] > 0
    assert any(item["state_s"]["tracked"] > 0 for item in report["objects"].values())
    recorded = report_of(capsys, "info", str(file))
    assert recorded["whole"]
    assert missing(recorded) == []
    assert any(stream["key"].startswith("truth/") for stream in recorded["streams"])
    assert "site.toml" in recorded["attachments"]


@pytest.mark.parametrize(
    ("number", "processes", "code"),
    [(signal.SIGINT, 2, 130), (signal.SIGTERM, 5, 130), (signal.SIGKILL, 5, -signal.SIGKILL)],
)
def test_a_signal_in_the_midst_of_starting_ends_all_within_five_seconds(
    number: int, processes: int, code: int
) -> None:
    with Running("demo", "--headless", "--json", "--port", "0") as demo:
        assert eventually(lambda: len(demo.children()) >= processes, within_s=90)
        assert demo.end(number) < 5.0
    assert demo.complaints() == []
    assert demo.process.returncode == code
    assert demo.out == []


def measures(demo: Running) -> bool:
    """Return whether the probe has opened its two sockets."""
    probe = demo.children().get("probe")
    return probe is not None and len(probe.net_connections("tcp")) >= 2


def test_ctrl_c_after_a_while_still_prints_the_figures() -> None:
    with Running("demo", "--headless", "--json", "--port", "0") as demo:
        assert eventually(lambda: measures(demo), within_s=90)
        with Watch(demo.wait_said(r"http://\S+")) as watch:
            watch.all_back(time.monotonic())
        assert demo.end(signal.SIGINT) < 10.0
    assert demo.process.returncode == 0
    assert demo.complaints() == []
    assert set(json.loads("".join(demo.out))) >= REPORT


WITH_EVERY_STREAM = 6_000_000
"""Bytes of a recording that is about two seconds long: every camera has sent an image by then."""


def test_a_recorder_that_is_killed_costs_no_more_than_its_last_moment(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, second = tmp_path / "demo.mcap", tmp_path / "demo-2.mcap"
    with Running("demo", "--no-browser", "--port", "0", "--record", str(file)) as demo:
        with Watch(demo.wait_said(r"http://\S+")) as watch:
            watch.all_back(time.monotonic())
            assert eventually(lambda: file.stat().st_size > WITH_EVERY_STREAM)
            recorder = demo.children()["recorder"]
            recorder.kill()
            assert eventually(lambda: second.exists() and second.stat().st_size > WITH_EVERY_STREAM)
        assert demo.end(signal.SIGTERM) < 5.0
    assert demo.complaints() == []
    assert not report_of(capsys, "info", str(file))["whole"]
    repaired = report_of(capsys, "repair", str(file))
    assert repaired["damaged"] is not None
    for path in (file, second):
        recorded = report_of(capsys, "info", str(path))
        assert recorded["whole"]
        assert missing(recorded) == []
        assert not any("truth" in stream["key"] for stream in recorded["streams"])
