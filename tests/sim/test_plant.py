from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from scene.robot import Robot
from sim.plant import Plant
from sim.world import Prop, PropFrame, Sway
from spatial.errors import InputError
from spatial.frames import Base, Frame, Object, Tcp, W
from spatial.pose import Pose
from spatial.rotation import Array

MakePlant = Callable[..., Plant]
STILL = Sway(slow_m=0.0, fast_m=0.0)


def run(plant: Plant, seconds: float) -> None:
    for _ in range(round(1000 * seconds)):
        plant.step()


def tool_in_base(plant: Plant) -> Pose[Base, Tcp]:
    truth = plant.truth()
    return Pose((truth["base"].inverse().matrix @ truth["tcp"].matrix).copy())


def amplitude(track: Array, *, low_hz: float, high_hz: float, step_s: float) -> Array:
    """Amplitude per axis of what a track (n, k) does in a band."""
    spectrum = np.fft.rfft(track - track.mean(axis=0), axis=0)
    hz = np.fft.rfftfreq(len(track), step_s)
    band = (hz >= low_hz) & (hz < high_hz)
    power = 2.0 * (np.abs(spectrum[band]) ** 2).sum(axis=0) / len(track) ** 2
    return np.asarray(np.sqrt(2.0 * power))


def test_one_seed_is_one_history(make_plant: MakePlant, board_in_view: Pose[W, Object]) -> None:
    digests = []
    for seed in (3, 3, 4):
        plant = make_plant(seed=seed, board_at=board_in_view, free=True)
        plant.command_tool(tool_in_base(plant) @ Pose.translated(0.05, 0.0, 0.0))
        run(plant, 1.0)
        digests.append(plant.digest())
    assert digests[0] == digests[1]
    assert digests[0] != digests[2]


def test_kinematics_are_those_of_the_description(make_plant: MakePlant, robot: Robot) -> None:
    plant = make_plant()
    run(plant, 0.7)
    names, positions, _, _ = plant.joints()
    links = robot.fk(dict(zip(names, positions.tolist(), strict=True)))
    truth = plant.truth()
    T_w_platform = truth["platform"].matrix
    for frame in ("base", "tcp", "hc", "mako"):
        expected = T_w_platform @ links[frame].matrix
        assert np.abs(truth[frame].matrix - expected).max() < 1e-6, frame


def test_the_platform_sways_as_the_world_says(make_plant: MakePlant) -> None:
    plant = make_plant()
    run(plant, 5.0)
    track = []
    for _ in range(2500):
        run(plant, 0.01)
        track.append(plant.truth()["platform"].translation)
    slow = amplitude(np.array(track)[:, :2], low_hz=0.08, high_hz=0.3, step_s=0.01)
    fast = amplitude(np.array(track)[:, :2], low_hz=0.9, high_hz=1.6, step_s=0.01)
    assert slow == pytest.approx([0.05, 0.05], rel=0.35)
    assert fast == pytest.approx([0.01, 0.01], rel=0.5)


def test_in_still_air_the_robot_comes_to_rest_level(make_plant: MakePlant) -> None:
    plant = make_plant(sway=STILL)
    run(plant, 0.5)
    start = plant.truth()["tcp"]
    run(plant, 3.0)
    end = plant.truth()
    assert np.linalg.norm(end["tcp"].translation - start.translation) < 1e-3
    assert end["platform"].rotation[2, 2] > np.cos(np.radians(0.3))


def test_the_tool_goes_where_it_is_told_at_limited_speed(make_plant: MakePlant) -> None:
    plant = make_plant(sway=STILL)
    start = tool_in_base(plant)
    goal: Pose[Base, Tcp] = start @ Pose.exp([0.15, 0.1, 0.05, 0.1, -0.2, 0.3])
    plant.command_tool(goal)
    fastest, before = 0.0, start.translation
    for _ in range(250):
        run(plant, 0.01)
        now = tool_in_base(plant).translation
        fastest = max(fastest, float(np.linalg.norm(now - before)) / 0.01)
        before = now
    error = (goal.inverse() @ tool_in_base(plant)).log()
    assert np.linalg.norm(error[:3]) < 0.003
    assert np.linalg.norm(error[3:]) < 0.02
    assert fastest < 0.4


def test_camera_twist_and_acceleration_are_derivatives_of_the_truth(make_plant: MakePlant) -> None:
    plant = make_plant()
    plant.command_tool(tool_in_base(plant) @ Pose.exp([0.1, 0.05, 0.0, 0.0, 0.2, 0.1]))
    run(plant, 1.2)
    poses: list[Pose[W, Frame]] = []
    twists, accelerations = [], []
    for _ in range(5):
        poses.append(plant.truth()["hc"])
        twist, acceleration = plant.camera_twist("hc")
        twists.append(twist)
        accelerations.append(acceleration)
        run(plant, 0.001)
    step: Pose[Frame, Frame] = poses[1].inverse() @ poses[3]
    assert step.log() / 0.002 == pytest.approx(twists[2], abs=3e-3)
    velocity = [pose.rotation @ t[:3] for pose, t in zip(poses, twists, strict=True)]
    measured = poses[2].rotation.T @ (velocity[3] - velocity[1]) / 0.002
    assert measured == pytest.approx(accelerations[2], abs=0.15)
    assert np.linalg.norm(accelerations[2]) < 3.0  # gravity is not in it


def test_a_floor_pushes_back_upwards_through_the_tool(make_plant: MakePlant) -> None:
    plant = make_plant(sway=STILL)
    start = plant.truth()["tcp"].translation
    top = float(start[2]) - 0.05
    table: Pose[W, PropFrame] = Pose.translated(float(start[0]), float(start[1]), top - 0.1)
    plant = make_plant(
        sway=STILL, props=(Prop("table", "box", (0.6, 0.6, 0.2), (0.5, 0.5, 0.5), table),)
    )
    down = plant.truth()["base"].inverse().rotate(np.array([0.0, 0.0, -0.07]))
    start_tool = tool_in_base(plant)
    assert np.linalg.norm(plant.wrench()[0]) == 0.0
    plant.command_tool(Pose.of(start_tool.rotation, start_tool.translation + down))
    run(plant, 2.5)
    force_tcp, _ = plant.wrench()
    force_w = plant.truth()["tcp"].rotate(force_tcp)
    assert 15.0 < force_w[2] < 80.0


def test_a_free_object_stands_and_a_fixed_one_stays(make_plant: MakePlant) -> None:
    ground: Pose[W, Frame] = Pose.translated(0.9, 0.6, 0.0115)
    for free in (True, False):
        plant = make_plant(board_at=Pose(ground.matrix.copy()), free=free)
        run(plant, 0.6)
        moved = plant.truth()["object/board"].translation - ground.translation
        assert np.abs(moved[:2]).max() < 1e-4
        assert (abs(moved[2] + 0.0015) < 5e-4) if free else (moved[2] == 0.0)


def test_what_does_not_exist_is_named(make_plant: MakePlant) -> None:
    plant = make_plant()
    with pytest.raises(InputError, match="unknown camera 'nose'; available: hc, mako"):
        plant.camera_twist("nose")
