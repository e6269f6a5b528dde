import math
from itertools import pairwise

import numpy as np
import pytest

from scene.database import load_database
from scene.robot import load_robot
from scene.site import DEFAULT_SITE, load_site
from sim.hand import Grip, Hand, HandModel, T_tcp_wrist
from sim.operator import Operator
from sim.plan import AWAY, PICK, PLANS, goal
from spatial.frames import Base, Cam, Object, Tcp
from spatial.pose import Pose
from spatial.samples import JointSample, ToolCommand
from spatial.tracked import TrackedObject, TrackedObjects, TrackState
from wire.bus import Subscription
from wire.clock import VirtualClock
from wire.codec import decode_command, encode
from wire.keys import Keys
from wire.memory_bus import MemoryBus

KEYS = Keys()
DT_S = 0.02
START: Pose[Base, Tcp] = Pose.translated(0.5, 0.0, 1.1)
HANDLE: Pose[Base, Tcp] = Pose.translated(0.6, 0.1, 1.2)
FRAMES = {
    "grasp": HANDLE,
    "below": HANDLE @ Pose.translated(0.0, 0.0, 0.1),
    "beside": HANDLE @ Pose.translated(-0.13, 0.0, 0.1),
    "above": HANDLE @ Pose.translated(-0.13, 0.0, -0.15),
}
GRIPPED: Pose[Grip, Tcp] = Pose(START.matrix)
STEADY = HandModel(tremor_m=0.0)


def wrist(T_base_tcp: Pose[Base, Tcp] | Pose[Grip, Tcp]) -> np.ndarray:
    return np.asarray((T_base_tcp @ T_tcp_wrist).translation)


def test_the_hand_starts_after_its_reaction_time_and_arrives() -> None:
    hand = Hand(STEADY, start=GRIPPED, seed=0)
    there: Pose[Grip, Tcp] = Pose.translated(0.55, 0.0, 1.1)
    path = [hand.step(there, now_s=i * DT_S, dt_s=DT_S).translation[0] for i in range(200)]
    moved = next(i for i, x in enumerate(path) if x > 0.501) * DT_S
    assert 0.15 <= moved <= 0.35
    assert path[-1] == pytest.approx(0.55, abs=1e-3)


def test_the_hand_is_never_faster_than_it_is_allowed() -> None:
    hand = Hand(HandModel(), start=GRIPPED, seed=1)
    far: Pose[Grip, Tcp] = Pose.translated(-0.5, 0.5, 0.5) @ Pose.exp((0, 0, 0, 1.5, 0, 0))
    poses = [hand.step(far, now_s=i * DT_S, dt_s=DT_S) for i in range(300)]
    # over half a second, so that the tremor does not count as speed
    far_m = [np.linalg.norm(wrist(b) - wrist(a)) for a, b in zip(poses, poses[25:], strict=False)]
    assert max(far_m) < 0.5 * 0.1 + 0.01
    turns = [a.distance_to(b)[1] for a, b in pairwise(poses)]
    assert max(turns) <= 0.7 * DT_S + 1e-9


def test_the_hand_keeps_its_place_when_it_holds_on_to_something_else() -> None:
    hand = Hand(STEADY, start=GRIPPED, seed=0)
    goal_pose: Pose[Grip, Tcp] = Pose.translated(0.7, 0.0, 1.1)
    for i in range(50):
        before = hand.step(goal_pose, now_s=i * DT_S, dt_s=DT_S)
    T_new_old: Pose[Grip, Grip] = Pose.exp((0.3, -0.2, 0.1, 0.4, 0.2, -0.3))
    hand.regrip(T_new_old)
    after = hand.step(T_new_old @ goal_pose, now_s=1.0, dt_s=DT_S)
    far, _ = (T_new_old @ before).distance_to(after)
    assert far < 1.5 * 0.1 * DT_S


def test_tremor_is_that_of_a_hand() -> None:
    hand = Hand(HandModel(), start=GRIPPED, seed=3)
    at = np.array([hand.step(GRIPPED, now_s=i * DT_S, dt_s=DT_S).translation for i in range(2000)])
    assert 0.001 <= float(np.sqrt(((at - at.mean(axis=0)) ** 2).sum(axis=1).mean())) <= 0.002


def test_for_over_five_seconds_between_15_and_30_the_hand_looks_away() -> None:
    away_s = [t for t in np.arange(0.0, 60.0, 0.1).tolist() if PICK.at(t) is AWAY]
    assert away_s[0] >= 15.0
    assert away_s[-1] <= 30.0 - 4.0  # the demo may start the operator some seconds late
    turning_s = math.radians(65.0) / HandModel().turn_rad_s + HandModel().reaction_s
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
        assert np.linalg.norm(wrist(pose) - wrist(START) - phase.shift_m) < 0.1


def test_turning_away_turns_the_camera_out_of_its_field_of_view() -> None:
    pose = goal(AWAY, time_s=0.0, T_base_tcp_start=START, Ts_base_frame={})
    half_diagonal = math.atan(math.hypot(640, 480) / 1078)
    assert START.distance_to(pose)[1] > half_diagonal + math.radians(25)


class ListeningBus(MemoryBus):
    """A bus that remembers what was asked of it."""

    def __init__(self) -> None:
        super().__init__()
        self.asked: list[str] = []

    def subscribe(self, key_expr: str, *, capacity: int, latched: bool = False) -> Subscription:
        self.asked.append(key_expr)
        return super().subscribe(key_expr, capacity=capacity, latched=latched)


class Bench:
    """An operator at a bus on which the test plays site and tracker."""

    def __init__(self) -> None:
        self.site = load_site(DEFAULT_SITE)
        self.robot = load_robot(self.site.robot, visuals=False)
        self.database = load_database(self.site.objects_dir)
        self.bus = ListeningBus()
        self.clock = VirtualClock()
        self.operator = Operator(
            self.bus,
            keys=KEYS,
            clock=self.clock,
            site=self.site,
            robot=self.robot,
            database=self.database,
            seed=1,
        )
        self.commands = self.bus.subscribe(KEYS.all_commands, capacity=10_000)
        self.bus.asked.remove(KEYS.all_commands)

    def joints(self) -> None:
        names = ("A1", "A2", "E1", "A3", "A4", "A5", "A6")
        positions = np.array([0.0, 0.25, 0.0, 2.2, 0.0, 1.4, 0.0])
        sample = JointSample(self.clock.now_ns(), names, positions, np.zeros(7), np.zeros(7))
        message = encode(sample)
        self.bus.publish(KEYS.joints, message.payload, schema=message.schema)

    def tracked(self, T_cam_object: Pose[Cam, Object]) -> None:
        now_ns = self.clock.now_ns()
        item = TrackedObject(
            slug=self.site.target,
            revision=1,
            camera="hc",
            state=TrackState.TRACKED,
            T_cam_object=T_cam_object,
            xi_w_cam_cam=np.zeros(6),
            covariance=1e-6 * np.eye(6),
            seen_ns=now_ns,
            motion_ns=now_ns,
            reset_count=0,
            reason="",
        )
        message = encode(TrackedObjects(now_ns, (item,)))
        self.bus.publish(KEYS.tracked, message.payload, schema=message.schema)

    def run(self, duration_s: float, *, T_cam_object: Pose[Cam, Object] | None = None) -> None:
        for _ in range(round(duration_s * 100)):
            self.clock.advance(10_000_000)
            self.joints()
            if T_cam_object is not None:
                self.tracked(T_cam_object)
            self.operator.tick(self.clock.now_ns())

    def heard(self) -> list[ToolCommand]:
        return [decode_command(sample.payload) for sample in self.commands.take()]


def test_the_operator_hears_what_the_page_shows_and_nothing_else() -> None:
    bench = Bench()
    assert set(bench.bus.asked) == {KEYS.tracked, KEYS.joints}


def test_the_operator_commands_at_50_hz_with_rising_numbers_and_living_stamps() -> None:
    bench = Bench()
    bench.run(2.0)
    commands = bench.heard()
    assert len(commands) == pytest.approx(100, abs=2)
    assert [c.sequence for c in commands] == list(range(1, len(commands) + 1))
    assert bench.clock.now_ns() - commands[-1].stamp_ns <= 20_000_000
    assert commands[0].ttl_ns > 0


def test_without_joints_nothing_is_commanded_and_garbage_is_counted() -> None:
    bench = Bench()
    bench.bus.publish(KEYS.joints, b"garbage", schema="?")
    bench.bus.publish(KEYS.tracked, b"\xff\xff", schema="?")
    bench.clock.advance(100_000_000)
    bench.operator.tick(bench.clock.now_ns())
    assert bench.heard() == []
    assert bench.operator.refused == 2


def test_the_operator_goes_where_the_tracker_says_the_handle_is() -> None:
    bench = Bench()
    seen: Pose[Cam, Object] = Pose.of(np.diag([1.0, -1.0, -1.0]), (0.0, 0.05, 0.6))
    bench.run(14.0, T_cam_object=seen)
    last = bench.heard()[-1].T_base_tcp
    links = bench.robot.fk(
        dict(
            zip(
                ("A1", "A2", "E1", "A3", "A4", "A5", "A6"),
                (0.0, 0.25, 0.0, 2.2, 0.0, 1.4, 0.0),
                strict=True,
            )
        )
    )
    above = bench.database.entry("cage").frames["above"].T_object_frame
    T_base_hc: Pose[Base, Cam] = Pose((links["base"].inverse() @ links["hc"]).matrix)
    expected = T_base_hc @ seen @ above
    assert np.linalg.norm(last.translation - expected.translation) < 0.03
