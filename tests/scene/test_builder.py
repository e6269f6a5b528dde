"""One instant: the builder against a world that swings, with streams late, lost and broken."""

from __future__ import annotations

import dataclasses
import math
import time
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from scene.builder import SceneBuilder
from scene.database import Database
from scene.entry import ObjectEntry
from scene.graph import ObjectNode, SceneState
from scene.robot import Robot
from scene.routes import camera_in_base
from scene.site import Site
from spatial.errors import InputError
from spatial.frames import Base, Cam, Object, Tcp, W
from spatial.pose import Pose
from spatial.rotation import Array
from spatial.samples import JointSample, MotionSample
from spatial.stamp import NS_PER_MS, seconds
from spatial.tracked import TrackedObject, TrackedObjects, TrackReport, TrackState

START = 1_700_000_000_000_000_000
MS = NS_PER_MS
T_w_cage: Pose[W, Object] = Pose.exp([0.3, 0.1, -1.2, 0.1, 0.2, 0.3])
STEP_S = 1e-5


class World:
    """Truth: a platform that swings, an arm that moves at constant joint speed."""

    def __init__(self, site: Site, robot: Robot) -> None:
        self.site, self.robot = site, robot

    def positions(self, stamp_ns: int) -> Array:
        t = seconds(stamp_ns - START)
        return np.array([0.3 + 0.4 * t, -0.2 + 0.3 * t])

    def T_w_base(self, stamp_ns: int) -> Pose[W, Base]:
        t = seconds(stamp_ns - START)
        swing = 0.05 * math.sin(2.0 * t)
        return Pose.exp([0.2 * t, 0.1 * math.sin(3.0 * t), 0.0, math.pi + swing, 0.2 * swing, 0.0])

    def T_base_cam(self, camera: str, stamp_ns: int) -> Pose[Base, Cam]:
        a1, a2 = self.positions(stamp_ns).tolist()
        links = self.robot.fk({"A1": a1, "A2": a2})
        T_base_tcp: Pose[Base, Tcp] = Pose((links["base"].inverse() @ links["tcp"]).matrix)
        return camera_in_base(self.site.cameras[camera], T_base_tcp=T_base_tcp)

    def T_w_cam(self, camera: str, stamp_ns: int) -> Pose[W, Cam]:
        return self.T_w_base(stamp_ns) @ self.T_base_cam(camera, stamp_ns)

    def xi(self, camera: str, stamp_ns: int) -> Array:
        half = round(STEP_S * 1e9)
        before, after = (self.T_w_cam(camera, stamp_ns + dt) for dt in (-half, half))
        return (before.inverse() @ after).log() / (2.0 * STEP_S)

    def T_cam_object(self, camera: str, stamp_ns: int) -> Pose[Cam, Object]:
        return self.T_w_cam(camera, stamp_ns).inverse() @ T_w_cage

    def T_base_object(self, stamp_ns: int) -> Pose[Base, Object]:
        return self.T_w_base(stamp_ns).inverse() @ T_w_cage

    def joints(self, stamp_ns: int) -> JointSample:
        speed = np.array([0.4, 0.3])
        return JointSample(stamp_ns, ("A1", "A2"), self.positions(stamp_ns), speed, np.zeros(2))

    def motion(self, stamp_ns: int) -> MotionSample:
        T_w_hc, xi = self.T_w_cam("hc", stamp_ns), self.xi("hc", stamp_ns)
        return MotionSample(stamp_ns, T_w_hc, xi, np.zeros(3))

    def said(
        self, slug: str, stamp_ns: int, state: TrackState = TrackState.TRACKED
    ) -> TrackedObject:
        camera = self.site.object(slug).camera
        return TrackedObject(
            slug=slug,
            revision=1,
            camera=camera,
            state=state,
            T_cam_object=self.T_cam_object(camera, stamp_ns),
            xi_w_cam_cam=self.xi(camera, stamp_ns),
            covariance=np.diag([1e-6, 4e-6, 9e-6, 1e-5, 1e-5, 1e-5]),
            seen_ns=stamp_ns - 70 * MS,
            motion_ns=stamp_ns - 3 * MS,
            reset_count=0,
            reason="from the world",
        )

    def tracked(self, stamp_ns: int, state: TrackState = TrackState.TRACKED) -> TrackedObjects:
        return TrackedObjects(
            stamp_ns, tuple(self.said(o.slug, stamp_ns, state) for o in self.site.objects)
        )


@pytest.fixture
def world(site: Site, robot: Robot) -> World:
    return World(site, robot)


@pytest.fixture
def builder(site: Site, robot: Robot) -> SceneBuilder:
    entry = cast("ObjectEntry", SimpleNamespace(revision=4))  # the builder reads nothing else
    entries = {o.slug: entry for o in site.objects}
    return SceneBuilder(site, robot, Database(site.objects_dir, entries, ()))


def feed(builder: SceneBuilder, world: World, *, until_ns: int, every_ms: int = 4) -> None:
    for stamp in range(until_ns - 200 * MS, until_ns + 1, every_ms * MS):
        builder.put_joints(world.joints(stamp))
        builder.put_motion(world.motion(stamp))


def node(state: SceneState, slug: str) -> ObjectNode:
    return next(n for n in state.objects if n.slug == slug)


def off(one: Pose[Base, Object] | None, other: Pose[Base, Object] | None) -> float:
    assert one is not None
    assert other is not None
    return one.distance_to(other)[0]


def test_before_any_sample_everything_is_lost_and_the_robot_is_there(builder: SceneBuilder) -> None:
    state = builder.build(START)
    assert [n.state for n in state.objects] == [TrackState.LOST] * 3
    assert all(n.T_base_object is None and n.seen_ms is None for n in state.objects)
    assert (state.robot_ms, state.T_base_w, state.tick) == (None, None, 1)
    np.testing.assert_allclose(state.Ts_base_link["base"].matrix, np.eye(4), atol=1e-12)
    assert node(state, "cage").reason == "the tracker has not reported it"


@pytest.mark.parametrize("slug", ["cage", "pipe"])  # one by each camera
@pytest.mark.parametrize("late_ms", [0, 8, 40, 90])
def test_late_samples_meet_at_one_instant(
    builder: SceneBuilder, world: World, slug: str, late_ms: int
) -> None:
    newest = START + 500 * MS
    feed(builder, world, until_ns=newest)
    builder.put_tracked(world.tracked(newest))
    instant = newest + late_ms * MS
    shown = node(builder.build(instant), slug)
    # what remains is the change of the twist within the delay
    assert (
        off(shown.T_base_object, world.T_base_object(instant)) < 1e-5 + 1.5 * (1e-3 * late_ms) ** 2
    )
    if late_ms:
        assert off(shown.T_base_object, world.T_base_object(newest)) > 1e-3  # it did move


def test_joints_younger_than_the_pose_are_interpolated_back(
    builder: SceneBuilder, world: World
) -> None:
    feed(builder, world, until_ns=START + 500 * MS)
    builder.put_tracked(world.tracked(START + 470 * MS))
    between = START + 471 * MS + 1234
    shown = node(builder.build(between), "cage")
    assert off(shown.T_base_object, world.T_base_object(between)) < 1e-5


def test_the_world_frame_gives_gravity_at_the_instant(builder: SceneBuilder, world: World) -> None:
    newest = START + 500 * MS
    feed(builder, world, until_ns=newest)
    state = builder.build(newest + 20 * MS)
    assert state.T_base_w is not None
    metres, radians = state.T_base_w.inverse().distance_to(world.T_w_base(newest + 20 * MS))
    assert metres < 1e-3
    assert radians < 1e-3


def test_both_ages_are_differences_of_stamps(builder: SceneBuilder, world: World) -> None:
    newest = START + 500 * MS
    feed(builder, world, until_ns=newest)
    builder.put_tracked(world.tracked(newest))
    state = builder.build(newest + 25 * MS)
    shown = node(state, "cage")
    assert shown.seen_ms == pytest.approx(95.0)
    assert shown.predicted_ms == pytest.approx(28.0)
    assert state.robot_ms == pytest.approx(25.0)
    assert (shown.revision, shown.reason, shown.camera) == (4, "from the world", "hc")


def test_covariance_is_turned_into_base_axes(builder: SceneBuilder, world: World) -> None:
    newest = START + 500 * MS
    feed(builder, world, until_ns=newest)
    builder.put_tracked(world.tracked(newest))
    shown = node(builder.build(newest), "cage")
    assert shown.T_base_object is not None
    R_base_object = shown.T_base_object.rotation
    along = R_base_object[:, 2]  # the object's z, the most uncertain axis
    assert along @ shown.covariance_base @ along == pytest.approx(9e-6)
    np.testing.assert_allclose(np.linalg.eigvalsh(shown.covariance_base), [1e-6, 4e-6, 9e-6])


def test_a_silent_tracker_leaves_objects_in_place_then_stale_then_lost(
    builder: SceneBuilder, world: World
) -> None:
    last = START + 500 * MS
    feed(builder, world, until_ns=last)
    builder.put_tracked(world.tracked(last))
    states, poses = [], []
    for late_ms in range(0, 1000, 20):
        feed(builder, world, until_ns=last + late_ms * MS, every_ms=20)
        shown = node(builder.build(last + late_ms * MS), "cage")
        states.append(shown.state)
        poses.append(shown.T_base_object)
    assert states.index(TrackState.STALE) * 20 == 320
    assert states.index(TrackState.LOST) * 20 == 820
    assert states[-1] is TrackState.LOST
    for late, pose in enumerate(poses[6:], start=6):  # beyond the horizon it no longer moves
        assert off(pose, poses[5]) == 0.0, late * 20
    assert "no word from the tracker" in shown.reason


def test_joints_that_stop_make_what_the_arm_sees_stale_but_not_the_rest(
    builder: SceneBuilder, world: World
) -> None:
    last = START + 500 * MS
    feed(builder, world, until_ns=last)
    now = last + 400 * MS
    builder.put_tracked(world.tracked(now))
    state = builder.build(now)
    assert node(state, "cage").state is TrackState.STALE
    assert node(state, "cage").reason == "no joint states for 400 ms"
    assert node(state, "pipe").state is TrackState.TRACKED


def test_without_joints_nothing_is_placed_by_a_camera_on_the_arm(
    builder: SceneBuilder, world: World
) -> None:
    builder.put_tracked(world.tracked(START))
    state = builder.build(START + 5 * MS)
    assert node(state, "cage").T_base_object is None
    assert node(state, "cage").reason == "no joint states yet"
    assert node(state, "pipe").T_base_object is not None


def test_a_stale_object_holds_its_pose_in_the_base(builder: SceneBuilder, world: World) -> None:
    good = START + 500 * MS
    feed(builder, world, until_ns=good)
    builder.put_tracked(world.tracked(good))
    held = node(builder.build(good), "cage").T_base_object
    states = []
    for late_ms in range(20, 700, 20):
        now = good + late_ms * MS
        feed(builder, world, until_ns=now, every_ms=20)
        builder.put_tracked(world.tracked(now, TrackState.STALE))
        shown = node(builder.build(now), "cage")
        states.append(shown.state)
        assert off(shown.T_base_object, held) == 0.0
    assert states[0] is TrackState.STALE
    assert states[-1] is TrackState.LOST
    builder.put_tracked(world.tracked(good + 700 * MS))
    again = node(builder.build(good + 700 * MS), "cage")
    assert again.state is TrackState.TRACKED
    assert off(again.T_base_object, held) > 1e-3


def test_lost_does_not_turn_stale_again_when_a_silent_tracker_says_stale(
    builder: SceneBuilder, world: World
) -> None:
    feed(builder, world, until_ns=START)
    builder.put_tracked(world.tracked(START))
    now = START + 2000 * MS
    feed(builder, world, until_ns=now)
    assert node(builder.build(now), "cage").state is TrackState.LOST
    builder.put_tracked(world.tracked(now, TrackState.STALE))
    assert node(builder.build(now), "cage").state is TrackState.LOST


def test_a_held_object_moves_with_the_tool_even_when_stale(
    builder: SceneBuilder, world: World
) -> None:
    good = START + 500 * MS
    feed(builder, world, until_ns=good)
    builder.put_tracked(world.tracked(good))
    first = builder.build(good)
    held = node(first, "peg").T_base_object
    assert held is not None
    T_tcp_peg = first.T_base_tcp.inverse() @ held
    now = good + 200 * MS
    feed(builder, world, until_ns=now)
    for state in TrackState.TRACKED, TrackState.STALE:
        if state is TrackState.STALE:
            builder.put_tracked(world.tracked(now, state))
        later = builder.build(now)
        T_base_peg = later.T_base_tcp @ T_tcp_peg
        assert off(node(later, "peg").T_base_object, T_base_peg) < 1e-9


def test_regrouping_moves_nothing(builder: SceneBuilder, world: World) -> None:
    newest = START + 500 * MS
    feed(builder, world, until_ns=newest)
    builder.put_tracked(world.tracked(newest))
    before = builder.build(newest + 30 * MS)
    builder.regroup("cage", "flat")
    builder.regroup("pipe", "nested")
    after = builder.build(newest + 30 * MS)
    for slug, hierarchy in (("cage", "flat"), ("pipe", "nested")):
        assert node(after, slug).hierarchy == hierarchy
        moved = off(node(after, slug).T_base_object, node(before, slug).T_base_object)
        assert moved == 0.0
    with pytest.raises(InputError, match="unknown object 'moon'; available: cage, peg, pipe"):
        builder.regroup("moon", "flat")
    with pytest.raises(InputError, match="unknown hierarchy 'deep'; available: flat, nested"):
        builder.regroup("cage", "deep")


def test_the_raw_pose_is_the_measured_one_with_the_arm_as_it_was(
    builder: SceneBuilder, world: World
) -> None:
    feed(builder, world, until_ns=START + 500 * MS)
    shot = START + 420 * MS
    report = TrackReport(
        camera="hc",
        slug="cage",
        stamp_ns=shot,
        method="joint",
        tags=(),
        expected_ids=(),
        T_cam_object=world.T_cam_object("hc", shot),
        T_cam_object_prior=None,
        hypotheses=1,
        residual_px=0.1,
        reason="",
    )
    builder.put_report(report)
    builder.put_report(dataclasses.replace(report, stamp_ns=shot + 1, T_cam_object=None))
    builder.put_report(dataclasses.replace(report, stamp_ns=shot - 1, slug="moon"))
    raw = node(builder.build(START + 500 * MS), "cage").T_base_object_raw
    assert off(raw, world.T_base_object(shot)) < 1e-6
    broken = Pose[Cam, Object](np.full((4, 4), math.nan))
    builder.put_report(dataclasses.replace(report, stamp_ns=shot + 2, T_cam_object=broken))
    assert builder.refused.reports == 1
    assert off(node(builder.build(START + 500 * MS), "cage").T_base_object_raw, raw) == 0.0


def test_where_a_camera_was_is_known_once_the_arm_is(builder: SceneBuilder, world: World) -> None:
    assert builder.camera_at("hc", START) is None
    assert builder.camera_at("mako", START) is not None
    feed(builder, world, until_ns=START + 500 * MS)
    T_base_hc = builder.camera_at("hc", START + 421 * MS)
    assert T_base_hc is not None
    assert T_base_hc.distance_to(world.T_base_cam("hc", START + 421 * MS))[0] < 1e-6
    with pytest.raises(InputError, match="unknown camera 'eye'; available: hc, mako"):
        builder.camera_at("eye", START)


UNSOUND = {
    "nan": np.full((4, 4), math.nan),
    "scaled": np.diag([1.1, 1.1, 1.1, 1.0]),
    "two kilometres away": Pose.translated(0.0, 0.0, 2e3).matrix,
}


@pytest.mark.parametrize("bad", UNSOUND)
def test_unsound_poses_stop_at_the_gate_and_the_last_good_one_holds(
    builder: SceneBuilder, world: World, bad: str
) -> None:
    good = START + 500 * MS
    feed(builder, world, until_ns=good + 40 * MS)
    builder.put_tracked(world.tracked(good))
    said = dataclasses.replace(
        world.said("cage", good + 20 * MS), T_cam_object=Pose(UNSOUND[bad].copy())
    )
    builder.put_tracked(TrackedObjects(good + 20 * MS, (said,)))
    builder.put_motion(
        dataclasses.replace(world.motion(good + 50 * MS), T_w_cam=Pose(UNSOUND[bad].copy()))
    )
    state = builder.build(good + 40 * MS)
    shown = node(state, "cage")
    assert off(shown.T_base_object, world.T_base_object(good + 40 * MS)) < 5e-3
    assert (builder.refused.objects, builder.refused.motion) == (1, 1)
    assert state.T_base_w is not None
    assert state.T_base_w.is_finite()


def test_bad_joints_are_counted_and_missing_ones_keep_their_place(
    builder: SceneBuilder, world: World
) -> None:
    good = world.joints(START)
    builder.put_joints(good)
    nan = np.array([math.nan, 0.0])
    later = START + 4 * MS
    for sample in (
        dataclasses.replace(good, stamp_ns=later, positions_rad=nan),
        dataclasses.replace(good, stamp_ns=later, velocities_rad_s=nan),
        dataclasses.replace(good, stamp_ns=later, positions_rad=np.zeros(3)),
        dataclasses.replace(good, stamp_ns=later, names=("B1", "B2")),
    ):
        builder.put_joints(sample)
    assert builder.refused.joints == 4
    before = builder.build(START).Ts_base_link["tcp"]
    none = np.zeros(0)
    partial = JointSample(later, ("gripper", "A2"), np.array([9.0, -0.2]), none, none)
    builder.put_joints(partial)
    assert builder.refused.joints == 4
    after = builder.build(later).Ts_base_link["tcp"]
    np.testing.assert_allclose(after.matrix, before.matrix, atol=1e-12)


def test_a_stamp_from_the_future_or_a_replay_that_goes_back_blocks_nothing(
    builder: SceneBuilder, world: World
) -> None:
    feed(builder, world, until_ns=START + 90_000 * MS)
    builder.put_tracked(world.tracked(START + 90_000 * MS))
    builder.build(START)  # now time is back here
    feed(builder, world, until_ns=START + 20 * MS)
    builder.put_tracked(world.tracked(START + 20 * MS))
    state = builder.build(START + 20 * MS)
    assert node(state, "cage").state is TrackState.TRACKED
    assert off(node(state, "cage").T_base_object, world.T_base_object(START + 20 * MS)) < 1e-6
    assert state.robot_ms == 0.0


def test_late_words_do_not_overtake_newer_ones(builder: SceneBuilder, world: World) -> None:
    newest = START + 500 * MS
    feed(builder, world, until_ns=newest)
    builder.put_tracked(world.tracked(newest))
    builder.put_tracked(world.tracked(newest - 50 * MS, TrackState.STALE))
    assert node(builder.build(newest), "cage").state is TrackState.TRACKED


def test_objects_of_another_site_and_unknown_cameras_are_passed_over(
    builder: SceneBuilder, world: World
) -> None:
    strange = dataclasses.replace(world.said("cage", START), slug="moon")
    nowhere = dataclasses.replace(world.said("cage", START), camera="eye")
    builder.put_tracked(TrackedObjects(START, (strange, nowhere)))
    assert node(builder.build(START), "cage").reason == "the tracker has not reported it"


def test_an_object_the_database_lacks_is_refused(site: Site, robot: Robot) -> None:
    with pytest.raises(InputError, match="unknown object 'cage'; available: none"):
        SceneBuilder(site, robot, Database(site.objects_dir, {}, ()))


def test_a_build_costs_less_than_a_tenth_of_a_frame(builder: SceneBuilder, world: World) -> None:
    newest = START + 500 * MS
    feed(builder, world, until_ns=newest)
    builder.put_tracked(world.tracked(newest))
    builds = 200
    before = time.process_time()
    for index in range(builds):
        builder.build(newest + index * 100_000)
    assert (time.process_time() - before) / builds < 2e-3  # CPU time of this process [s]
