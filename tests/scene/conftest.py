"""A small site: two joints, a camera on the arm, one on the platform, three objects."""

from __future__ import annotations

from pathlib import Path

import pytest

from scene.robot import Robot, load_robot
from scene.site import Site, load_site

URDF = """<robot name="two">
  <link name="platform"/><link name="base"/><link name="link_1"/><link name="link_2"/>
  <link name="tcp"/><link name="hc"/><link name="mako"/>
  <joint name="mount" type="fixed"><parent link="platform"/><child link="base"/>
    <origin xyz="0 0 -0.2" rpy="3.14159265358979 0 0"/></joint>
  <joint name="A1" type="revolute"><parent link="base"/><child link="link_1"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" velocity="2" effort="100"/></joint>
  <joint name="A2" type="revolute"><parent link="link_1"/><child link="link_2"/>
    <origin xyz="0 0 0.4"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" velocity="2" effort="100"/></joint>
  <joint name="tool" type="fixed"><parent link="link_2"/><child link="tcp"/>
    <origin xyz="0 0 0.5"/></joint>
  <joint name="eye" type="fixed"><parent link="link_2"/><child link="hc"/>
    <origin xyz="0.1 0 0.3" rpy="0 0 1.5707963"/></joint>
  <joint name="look" type="fixed"><parent link="platform"/><child link="mako"/>
    <origin xyz="0.5 0 0.1" rpy="2.6 0 -1.5707963"/></joint>
</robot>
"""

SITE = """schema = 1
name = "lab"
robot = "robot.urdf"
objects = "objects"

[[camera]]
name = "hc"
parent = "tcp"
rate_hz = 25
width = 1280
height = 960
fx = 1078.0
fy = 1078.0
cx = 639.5
cy = 479.5

[[camera]]
name = "mako"
parent = "base"
rate_hz = 30
width = 1292
height = 964
fx = 1100.0
fy = 1100.0
cx = 645.5
cy = 481.5

[vio]
camera = "hc"
rate_hz = 200

[[object]]
slug = "cage"
camera = "hc"
hierarchy = "nested"

[[object]]
slug = "pipe"
camera = "mako"
hierarchy = "flat"

[[object]]
slug = "peg"
camera = "hc"
hierarchy = "nested"
motion = "held"
"""


@pytest.fixture
def site_file(tmp_path: Path) -> Path:
    (tmp_path / "robot.urdf").write_text(URDF)
    for slug in ("cage", "pipe", "peg"):
        folder = tmp_path / "objects" / slug
        folder.mkdir(parents=True)
        (folder / "object.toml").touch()
    path = tmp_path / "site.toml"
    path.write_text(SITE)
    return path


@pytest.fixture
def site(site_file: Path) -> Site:
    return load_site(site_file)


@pytest.fixture
def robot(site: Site) -> Robot:
    return load_robot(site.robot, visuals=False)
