"""The site file: what it gives, and what a broken one says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from scene.mount import rigid_pose
from scene.robot import Robot, load_robot
from scene.site import DEFAULT_SITE, Site, StateLimits, load_site
from spatial.errors import FileInputError
from spatial.frames import Hc, Tcp
from spatial.pose import Pose


def edited(path: Path, old: str, new: str) -> Path:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    return path


def test_a_site_holds_what_its_file_says(site: Site, site_file: Path) -> None:
    assert (site.name, site.path, site.robot) == ("lab", site_file, site_file.parent / "robot.urdf")
    assert list(site.cameras) == ["hc", "mako"]
    assert site.cameras["mako"].intrinsics.width == 1292
    assert [entry.slug for entry in site.objects] == ["cage", "pipe", "peg"]
    assert site.object("peg").motion == "held"
    assert site.object("cage").motion == "static"
    assert (site.target, site.display_root, site.clock_mode) == ("cage", "base", "shared")
    assert site.limits == StateLimits()
    assert site.fixtures


def test_a_camera_sits_where_the_urdf_has_its_link(site: Site, robot: Robot) -> None:
    T_tcp_hc = site.cameras["hc"].T_parent_cam
    for positions in ({}, {"A1": 0.7, "A2": -1.1}):
        links = robot.fk(positions)
        expected = links["tcp"].inverse() @ links["hc"]
        np.testing.assert_allclose(T_tcp_hc.matrix, expected.matrix, atol=1e-12)


def test_a_pose_in_the_file_wins_over_the_urdf(site_file: Path) -> None:
    pose = 'mount = "pose"\ntranslation_m = [0.1, 0.2, 0.3]\nquaternion_wxyz = [0, 1, 0, 0]'
    site = load_site(edited(site_file, 'parent = "tcp"', f'parent = "tcp"\n{pose}'))
    T_tcp_hc = site.cameras["hc"].T_parent_cam
    np.testing.assert_allclose(T_tcp_hc.translation, [0.1, 0.2, 0.3])
    np.testing.assert_allclose(T_tcp_hc.rotation, np.diag([1.0, -1.0, -1.0]), atol=1e-12)


def test_limits_are_read_in_the_units_of_their_names(site_file: Path) -> None:
    limits = "[limits]\ntracked_ms = 200\nbridged_sigma_mm = 40\nhorizon_ms = 50\n\n[vio]"
    site = load_site(edited(site_file, "[vio]", limits))
    assert site.limits.tracked_ns == 200_000_000
    assert site.limits.bridged_sigma_m == pytest.approx(0.04)
    assert site.limits.horizon_ns == 50_000_000
    assert site.limits.lost_after_ns == StateLimits().lost_after_ns


BROKEN = {
    "syntax": ('name = "lab"', 'name = "lab', "is not TOML.*line 2"),
    "schema": ("schema = 1", "schema = 9", "schema is 9; this version reads 1.*line 1"),
    "misspelt key": ("rate_hz = 25", "rate_hz = 25\nratehz = 3", r"unknown key 'ratehz'.*line 10"),
    "missing key": ("fx = 1078.0\n", "", r"fx is missing; present: cx, .*key camera\[0\]\.fx"),
    "wrong type": ("rate_hz = 30", 'rate_hz = "30"', r"finite number, got '30'.*line 20"),
    "not finite": ("rate_hz = 30", "rate_hz = nan", r"finite number, got nan"),
    "no rate": ("rate_hz = 200", "rate_hz = 0", "greater than 0, got 0"),
    "bad focal length": ("fy = 1100.0", "fy = -1.0", r"must be positive.*key camera\[1\]"),
    "unknown camera": ('camera = "mako"', 'camera = "nako"', "unknown camera 'nako'.*hc, mako"),
    "unknown object": ('slug = "pipe"', 'slug = "pip"', "'pip'; available: cage, peg, pipe"),
    "twice": ('slug = "pipe"', 'slug = "cage"', "object 'cage' appears twice"),
    "unknown motion": ('"held"', '"carried"', "'carried'; available: held, mobile, static"),
    "no robot": ('"robot.urdf"', '"robots/none.urdf"', "unknown robot 'robots/none.urdf'"),
    "no link": ('name = "mako"', 'name = "nako"', "unknown link 'nako'; available: base, hc"),
    "not rigid": ('parent = "base"', 'parent = "tcp"', "'mako' is not rigid to 'tcp'.*moves"),
    "bad turn": (
        'parent = "tcp"',
        'parent = "tcp"\nmount = "pose"\nquaternion_wxyz = [1, 1, 0, 0]',
        "unit length.*quaternion_wxyz, line 10",
    ),
}


@pytest.mark.parametrize("case", BROKEN)
def test_a_broken_file_says_where_and_what_was_expected(case: str, site_file: Path) -> None:
    old, new, said = BROKEN[case]
    with pytest.raises(FileInputError, match=said) as caught:
        load_site(edited(site_file, old, new))
    assert caught.value.path in {site_file, site_file.parent / "robot.urdf"}


def test_a_file_that_is_not_there_says_so(tmp_path: Path) -> None:
    with pytest.raises(FileInputError, match="cannot be read: No such file"):
        load_site(tmp_path / "none.toml")
    (tmp_path / "latin.toml").write_bytes(b"name = '\xff'")
    with pytest.raises(FileInputError, match="UTF-8"):
        load_site(tmp_path / "latin.toml")


def test_the_default_site_is_valid_and_its_cameras_look_along_their_z() -> None:
    site = load_site(DEFAULT_SITE)
    assert site.name == "sam"
    robot = load_robot(site.robot, visuals=False)
    assert not robot.warnings
    T_tcp_hc: Pose[Tcp, Hc] = rigid_pose(robot, parent="tcp", child="hc")
    assert site.cameras["hc"].T_parent_cam.distance_to(T_tcp_hc) == (0.0, 0.0)  # type: ignore[arg-type]  # its frames are text in the file
    # the hand-eye camera sees the tool: the tcp lies in front of it
    assert T_tcp_hc.inverse().translation[2] > 0.0
