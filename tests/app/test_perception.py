"""`app.perception` and the motion of cameras the robot carries."""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import app.perception
import app.stepped
from app.perception import Perception, decode_gray
from app.processes.config import BusConfig, SiteConfig, SiteFiles
from app.processes.site import staging_of
from scene.carried import CarriedCamera
from scene.database import Database
from scene.robot import Robot
from scene.site import DEFAULT_SITE, Site
from sim.rig import build_plant
from spatial.camera import PinholeCamera
from spatial.errors import InputError, MessageError
from spatial.frames import Base, Cam, Tcp, W
from spatial.pose import Pose
from spatial.samples import CalibrationSample, ImageSample, JointSample, MotionSample
from spatial.stamp import NS_PER_MS

Loaded = tuple[Site, Robot, Database]
JOINTS = ("A1", "A2", "E1", "A3", "A4", "A5", "A6")
REST_RAD = np.array([0.0, 0.11, 0.0, 1.83, 0.0, 1.33, 0.0])
START_NS = 1_700_000_000_000_000_000


def carried(loaded: Loaded) -> CarriedCamera:
    site, robot, _ = loaded
    return CarriedCamera(robot=robot, vio=site.cameras["hc"], carried=site.cameras["mako"])


def joints_at(stamp_ns: int, positions: np.ndarray, velocities: np.ndarray) -> JointSample:
    return JointSample(stamp_ns, JOINTS, positions, velocities, np.zeros(7))


def motion_at(stamp_ns: int, T_w_cam: Pose[W, Cam], twist: np.ndarray) -> MotionSample:
    return MotionSample(stamp_ns, T_w_cam, twist, np.zeros(3))


def vectors(size: int, most: float) -> st.SearchStrategy[np.ndarray]:
    return st.lists(st.floats(-most, most), min_size=size, max_size=size).map(np.array)


@settings(max_examples=30, deadline=None)
@given(off=vectors(7, 0.6), speed=vectors(7, 1.0), twist=vectors(6, 0.5), start=vectors(6, 1.0))
def test_a_carried_cameras_twist_is_the_derivative_of_its_pose(
    loaded: Loaded, off: np.ndarray, speed: np.ndarray, twist: np.ndarray, start: np.ndarray
) -> None:
    camera, step_s = carried(loaded), 1e-4
    T_w_hc: Pose[W, Cam] = Pose.exp(start)

    def at(time_s: float) -> MotionSample:
        T_w_hc_then: Pose[W, Cam] = T_w_hc @ Pose[Cam, Cam].exp(time_s * twist)
        joints = joints_at(START_NS, REST_RAD + off + time_s * speed, speed)
        return camera.motion(motion_at(START_NS, T_w_hc_then, twist), joints)

    before, now, after = at(-step_s), at(0.0), at(step_s)
    moved = (before.T_w_cam.inverse() @ after.T_w_cam).log() / (2.0 * step_s)
    np.testing.assert_allclose(now.xi_w_cam_cam, moved, atol=5e-3)


def test_kinematics_carry_the_odometry_to_the_true_motion_of_the_other_camera(
    loaded: Loaded,
) -> None:
    """A swinging platform and a moving arm, nominal values true: nothing is left over."""
    camera = carried(loaded)
    staging = staging_of(
        SiteConfig(
            bus=BusConfig(endpoint="", site="sam"),
            files=SiteFiles(site=str(DEFAULT_SITE)),
            scenario="pick",
            seed=3,
        )
    )
    scenario = replace(staging.scenario, calibration_error=0.0, fast_sway_m=0.01)
    plant = build_plant(replace(staging, scenario=scenario))
    truth = plant.truth()
    T_w_base: Pose[W, Base] = Pose(truth["base"].matrix)
    T_w_tcp: Pose[W, Tcp] = Pose(truth["tcp"].matrix)
    start: Pose[Base, Tcp] = T_w_base.inverse() @ T_w_tcp
    fastest = 0.0
    for step in range(600):
        swing = 0.05 * np.sin(2.0 * np.pi * step / 500.0)
        plant.command_tool(start @ Pose[Tcp, Tcp].exp(np.array([swing, swing, 0, 0, swing, 0])))
        plant.step()
        if step % 50:
            continue
        truth = plant.truth()
        T_w_hc: Pose[W, Cam] = Pose(truth["hc"].matrix)
        names, positions, velocities, torques = plant.joints()
        joints = JointSample(START_NS, names, positions, velocities, torques)
        found = camera.motion(motion_at(START_NS, T_w_hc, plant.camera_twist("hc")[0]), joints)
        off_m, off_rad = found.T_w_cam.distance_to(Pose[W, Cam](truth["mako"].matrix))
        assert off_m < 1e-6
        assert off_rad < 1e-6
        np.testing.assert_allclose(found.xi_w_cam_cam, plant.camera_twist("mako")[0], atol=2e-3)
        fastest = max(fastest, float(np.abs(velocities).max()))
    assert fastest > 0.1


def perception(loaded: Loaded) -> Perception:
    site, robot, database = loaded
    return Perception(site=site, robot=robot, database=database, method="joint")


def test_odometry_waits_for_joints_that_come_late(loaded: Loaded) -> None:
    """However late joints are, the carried camera gets every sample, in order."""
    seen = perception(loaded)
    still = np.zeros(7)
    seen.put_joints(joints_at(START_NS, REST_RAD, still))
    for i in range(40):
        stamp_ns = START_NS + 5 * i * NS_PER_MS
        seen.put_motion(motion_at(stamp_ns, Pose.translated(0.001 * i, 0.0, 0.0), np.zeros(6)))
    mako = seen.cameras["mako"].motion
    assert mako.newest is not None
    assert mako.newest.stamp_ns == START_NS + 30 * NS_PER_MS  # as far as velocities reach
    assert seen.unpaired == 33
    seen.put_joints(joints_at(START_NS + 200 * NS_PER_MS, REST_RAD, still))
    assert seen.unpaired == 0
    assert mako.newest.stamp_ns == START_NS + 195 * NS_PER_MS


def test_without_joints_the_other_camera_holds_and_its_own_goes_on(loaded: Loaded) -> None:
    seen = perception(loaded)
    assert seen.predict() is None
    for i in range(3):
        seen.put_motion(motion_at(START_NS + i, Pose.identity(), np.zeros(6)))
    tracked = seen.predict()
    assert tracked is not None
    assert tracked.stamp_ns == START_NS + 2
    motion_ns = {item.slug: item.motion_ns for item in tracked.objects}
    assert motion_ns["cage"] == START_NS + 2
    assert motion_ns["pipe"] == 0
    assert list(motion_ns) == [item.slug for item in loaded[0].objects]


def test_a_camera_that_tells_its_calibration_is_believed(loaded: Loaded) -> None:
    seen = perception(loaded)
    told = replace(loaded[0].cameras["hc"].intrinsics, fx=1100.0)
    seen.put_calibration(CalibrationSample("hc", START_NS, told))
    assert seen.cameras["hc"].model.camera == told
    with pytest.raises(InputError, match="unknown camera 'eye'; available: hc, mako"):
        seen.put_calibration(CalibrationSample("eye", START_NS, told))


@pytest.mark.parametrize("jpeg", [b"", b"\xff\xd8\xff", b"text", bytes(1000)])
def test_what_is_no_image_is_a_message_error(jpeg: bytes) -> None:
    camera = PinholeCamera(64, 48, 50.0, 50.0, 31.5, 23.5)
    with pytest.raises(MessageError, match="camera 'hc' is not a JPEG"):
        decode_gray(ImageSample("hc", START_NS, jpeg), camera)


def test_images_must_be_of_a_known_camera_and_its_size(loaded: Loaded) -> None:
    seen = perception(loaded)
    jpeg = cv2.imencode(".jpg", np.zeros((48, 64), np.uint8))[1].tobytes()
    with pytest.raises(InputError, match="unknown camera 'eye'; available: hc, mako"):
        seen.observe(ImageSample("eye", START_NS, jpeg))
    with pytest.raises(MessageError, match="64x48, calibrated is 1280x960"):
        seen.observe(ImageSample("hc", START_NS, jpeg))


def test_the_truth_is_out_of_reach() -> None:
    for module in (app.perception, app.stepped):
        tree = ast.parse(Path(str(module.__file__)).read_text(encoding="utf-8"))
        roots = {
            name.split(".")[0]
            for node in ast.walk(tree)
            for name in (
                [node.module or ""]
                if isinstance(node, ast.ImportFrom)
                else [alias.name for alias in node.names]
                if isinstance(node, ast.Import)
                else []
            )
        }
        assert "sim" not in roots
