"""The command line as a user meets it: what is printed where, and how it ends."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from app.__main__ import COMMANDS, main

ROOT = Path(__file__).parents[2]
URDF = ROOT / "assets" / "robots" / "sam" / "robot.urdf"


def run_json(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    assert main([*arguments, "--json"]) == 0, capsys.readouterr().err
    out = capsys.readouterr().out
    assert out.count("\n") == 1
    report = json.loads(out)
    assert isinstance(report, dict)
    return report


def failure(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(list(arguments)) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert "Traceback" not in captured.err
    return captured.err


@pytest.fixture
def photo(tmp_path: Path) -> Path:
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    page = np.full((480, 640), 235, dtype=np.uint8)
    page[140:300, 200:360] = cv2.aruco.generateImageMarker(dictionary, 7, 160)
    path = tmp_path / "photo.png"
    cv2.imwrite(str(path), page)
    return path


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_every_command_explains_itself_with_an_example(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([name, "--help"]) == 0
    assert f"telepresence {name}" in capsys.readouterr().out.replace("\n  ", " ")


def test_the_list_of_commands_is_complete() -> None:
    folder = ROOT / "app" / "commands"
    modules = {path.stem for path in folder.glob("*.py")} - {"__init__"}
    assert modules == set(COMMANDS)


def test_detect_finds_a_marker_where_it_was_drawn(
    photo: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    image = run_json(capsys, "detect", str(photo))["images"][0]
    assert (image["width"], image["height"]) == (640, 480)
    (marker,) = image["markers"]
    assert (marker["id"], marker["family"]) == (7, "tag36h11")
    drawn = np.array([[199.5, 139.5], [359.5, 139.5], [359.5, 299.5], [199.5, 299.5]])
    np.testing.assert_allclose(marker["corners_px"], drawn, atol=0.1)


def test_detect_with_a_camera_gives_poses(
    photo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    camera = tmp_path / "camera.toml"
    camera.write_text("width=640\nheight=480\nfx=500\nfy=500\ncx=279.5\ncy=219.5\n", "utf-8")
    report = run_json(capsys, "detect", str(photo), "--camera", str(camera), "--size-m", "0.16")
    poses = report["images"][0]["markers"][0]["poses"]
    np.testing.assert_allclose(poses[0]["translation_m"], [0, 0, 0.5], atol=2e-3)
    assert poses[0]["reprojection_px"] < 0.2


def test_detect_says_what_is_wrong_with_its_input(
    photo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "no such image" in failure(capsys, "detect", str(tmp_path / "none.png"))
    text = tmp_path / "text.png"
    text.write_text("not an image", "utf-8")
    assert "not an image" in failure(capsys, "detect", str(text))
    assert "go together" in failure(capsys, "detect", str(photo), "--size-m", "0.1")
    camera = tmp_path / "camera.toml"
    camera.write_text("width = 640\n", "utf-8")
    said = failure(capsys, "detect", str(photo), "--size-m", "0.1", "--camera", str(camera))
    assert "key height" in said
    assert str(camera) in said


def test_robot_prints_the_published_flange_height(capsys: pytest.CaptureFixture[str]) -> None:
    report = run_json(capsys, "robot", str(URDF))
    assert report["warnings"] == []
    base = np.array(report["poses"]["base"]["translation_m"])
    last = np.array(report["poses"]["link_7"]["translation_m"])
    assert {"platform", "tcp", "hc", "mako"} <= set(report["links"])
    assert 1.0 < np.linalg.norm(last - base) < 1.1786


def test_robot_warns_about_values_outside_limits(capsys: pytest.CaptureFixture[str]) -> None:
    report = run_json(capsys, "robot", str(URDF), "--joints", "A2=9", "A4=0.1")
    assert ["A2 = 9" in warning for warning in report["warnings"]] == [True]
    assert "unknown joint 'B1'" in failure(capsys, "robot", str(URDF), "--joints", "B1=0")
    assert "not a number" in failure(capsys, "robot", str(URDF), "--joints", "A1=x")


def test_objects_lists_and_checks_the_database(capsys: pytest.CaptureFixture[str]) -> None:
    rows = run_json(capsys, "objects", "list")["objects"]
    assert {"cage", "hole_plate", "pipe", "peg"} <= {row["name"] for row in rows}
    assert all(row["accepted"] for row in run_json(capsys, "objects", "check")["objects"])


def test_objects_check_refuses_a_broken_object(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "thing"
    folder.mkdir()
    (folder / "object.toml").write_text("schema = 1\nname = \n", "utf-8")
    assert main(["objects", "check", "--objects", str(tmp_path), "--json"]) == 2
    (row,) = json.loads(capsys.readouterr().out)["objects"]
    assert row["name"] == "thing"
    assert not row["accepted"]
    assert "line 2" in row["reason"]


def test_doctor_reports_every_check(capsys: pytest.CaptureFixture[str]) -> None:
    report = run_json(capsys, "doctor")
    assert report["python"]["ok"]
    assert {"gl", "chromium", "packages", "port"} <= set(report)


def test_unknown_command_and_scenario_name_what_exists(capsys: pytest.CaptureFixture[str]) -> None:
    failure(capsys, "nonsense")
    assert "pick" in failure(capsys, "demo", "--scenario", "none")
