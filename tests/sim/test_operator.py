import math
from itertools import pairwise

import numpy as np
import pytest

from sim.hand import Hand, HandModel, T_tcp_wrist
from sim.plan import AWAY, PICK, PLANS, goal
from spatial.frames import Base, Tcp
from spatial.pose import Pose

DT_S = 0.02
START: Pose[Base, Tcp] = Pose.translated(0.5, 0.0, 1.1)
HANDLE: Pose[Base, Tcp] = Pose.translated(0.6, 0.1, 1.2)
FRAMES = {
    "grasp": HANDLE,
    "below": HANDLE @ Pose.translated(0.0, 0.0, 0.1),
    "beside": HANDLE @ Pose.translated(-0.13, 0.0, 0.1),
    "above": HANDLE @ Pose.translated(-0.13, 0.0, -0.15),
}
STEADY = HandModel(tremor_m=0.0)


def wrist(T_base_tcp: Pose[Base, Tcp]) -> np.ndarray:
    return np.asarray((T_base_tcp @ T_tcp_wrist).translation)


def test_the_hand_starts_after_its_reaction_time_and_arrives() -> None:
    hand = Hand(STEADY, start=START, seed=0)
    there: Pose[Base, Tcp] = Pose.translated(0.55, 0.0, 1.1)
    path = [hand.step(there, now_s=i * DT_S, dt_s=DT_S).translation[0] for i in range(200)]
    moved = next(i for i, x in enumerate(path) if x > 0.501) * DT_S
    assert 0.15 <= moved <= 0.35
    assert path[-1] == pytest.approx(0.55, abs=1e-3)


def test_the_hand_is_never_faster_than_it_is_allowed() -> None:
    hand = Hand(HandModel(), start=START, seed=1)
    far: Pose[Base, Tcp] = Pose.translated(-0.5, 0.5, 0.5) @ Pose.exp((0, 0, 0, 1.5, 0, 0))
    poses = [hand.step(far, now_s=i * DT_S, dt_s=DT_S) for i in range(300)]
    # over half a second, so that the tremor does not count as speed
    far_m = [np.linalg.norm(wrist(b) - wrist(a)) for a, b in zip(poses, poses[25:], strict=False)]
    assert max(far_m) < 0.5 * 0.1 + 0.01
    turns = [a.distance_to(b)[1] for a, b in pairwise(poses)]
    assert max(turns) <= 0.7 * DT_S + 1e-9


def test_the_hand_follows_a_slow_sway_better_than_its_reaction_time_allows() -> None:
    hand = Hand(STEADY, start=START, seed=0)
    errors = []
    for i in range(1500):
        t = i * DT_S
        target: Pose[Base, Tcp] = Pose.translated(
            0.5 + 0.05 * math.sin(2 * math.pi * 0.16 * t), 0.0, 1.1
        )
        command = hand.step(target, now_s=t, dt_s=DT_S)
        errors.append(command.translation[0] - target.translation[0])
    late = float(np.sqrt(np.mean(np.square(errors[500:]))))
    uncompensated = 0.05 / math.sqrt(2) * 2 * math.pi * 0.16 * 0.33
    assert late < 0.8 * uncompensated
    assert late < 0.01


def test_tremor_is_that_of_a_hand() -> None:
    hand = Hand(HandModel(), start=START, seed=3)
    at = np.array([hand.step(START, now_s=i * DT_S, dt_s=DT_S).translation for i in range(2000)])
    assert 0.001 <= float(np.sqrt(((at - at.mean(axis=0)) ** 2).sum(axis=1).mean())) <= 0.002


def test_for_over_five_seconds_between_15_and_30_the_hand_looks_away() -> None:
    away_s = [t for t in np.arange(0.0, 60.0, 0.1).tolist() if PICK.at(t) is AWAY]
    assert away_s[0] >= 15.0
    assert away_s[-1] <= 30.0 - 4.0  # the demo may start the operator some seconds late
    turning_s = math.radians(80.0) / HandModel().turn_rad_s + HandModel().reaction_s
    assert away_s[-1] - away_s[0] - turning_s > 5.0
    assert PICK.phases.count(AWAY) == 1


@pytest.mark.parametrize("name", PLANS)
def test_a_plan_goes_on_for_ever_and_never_stands_still(name: str) -> None:
    plan = PLANS[name]
    for t in np.arange(0.0, 300.0, 0.5).tolist():
        assert plan.at(t) in plan.phases
    places = [
        goal(plan.at(t), time_s=t, T_base_tcp_start=START, Ts_base_frame=FRAMES).translation
        for t in np.arange(200.0, 260.0, 0.5).tolist()
    ]
    assert np.ptp(np.array(places), axis=0).max() > 0.05


def test_at_the_target_the_goal_moves_with_the_shown_object() -> None:
    phase = next(p for p in PICK.phases if p.frame == "below")
    shift: Pose[Base, Base] = Pose.translated(0.03, 0.0, 0.0)
    moved = {name: shift @ pose for name, pose in FRAMES.items()}
    one = goal(phase, time_s=1.0, T_base_tcp_start=START, Ts_base_frame=FRAMES)
    two = goal(phase, time_s=1.0, T_base_tcp_start=START, Ts_base_frame=moved)
    assert np.allclose(two.translation - one.translation, (0.03, 0.0, 0.0))
    assert np.allclose(one.matrix, FRAMES["below"].matrix)


def test_without_a_handle_the_tool_stays_near_its_start() -> None:
    for phase in PICK.phases:
        pose = goal(phase, time_s=3.0, T_base_tcp_start=START, Ts_base_frame={})
        assert np.linalg.norm(wrist(pose) - wrist(START)) < 0.1


def test_turning_away_turns_the_camera_out_of_its_field_of_view() -> None:
    pose = goal(AWAY, time_s=0.0, T_base_tcp_start=START, Ts_base_frame={})
    half_diagonal = math.atan(math.hypot(640, 480) / 1078)
    assert START.distance_to(pose)[1] > 2 * half_diagonal - math.radians(5)
