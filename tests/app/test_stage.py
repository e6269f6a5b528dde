"""The stage writes what follows from the state, no more often than it may, and nothing twice."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from app.looks import StageLook, object_look
from app.stage import Stage, frustum
from app.status import status_of
from app.viser_port import Color
from scene.fixture import Fixture
from scene.graph import ObjectNode, SceneState
from scene.mesh import box_mesh
from spatial.camera import PinholeCamera
from spatial.pose import Pose
from spatial.rotation import Array
from spatial.solids import Plane
from spatial.tracked import TrackState

CAMERA = PinholeCamera(640, 480, 500.0, 500.0, 310.0, 250.0)


class FakePort:
    """A renderer that remembers."""

    def __init__(self) -> None:
        self.nodes: list[str] = []
        self.poses: dict[str, Pose[Any, Any]] = {}
        self.visible: dict[str, bool] = {}
        self.batches: list[set[str]] = []
        self.flushes = 0

    def add_group(self, name: str) -> None:
        self.nodes.append(name)

    def add_glb(self, name: str, data: bytes, *, visible: bool = True) -> None:
        assert data[:4] == b"glTF"
        assert visible
        self.nodes.append(name)

    def add_lines(
        self, name: str, segments: Array, *, color: Color, width_px: float, visible: bool = True
    ) -> None:
        assert segments.shape[1:] == (2, 3)
        assert color
        assert width_px > 0
        assert visible
        self.nodes.append(name)

    def add_grid(self, name: str, *, size_m: float, visible: bool = True) -> None:
        assert size_m > 0
        assert visible
        self.nodes.append(name)

    def update(self, poses: Mapping[str, Pose[Any, Any]], visible: Mapping[str, bool]) -> int:
        assert {*poses, *visible} <= set(self.nodes), "every node was made before it is moved"
        good = {n: p for n, p in poses.items() if p.is_finite()}
        self.poses |= good
        self.visible |= visible
        self.batches.append(set(good))
        return len(poses) - len(good)

    def flush(self) -> None:
        self.flushes += 1

    def shows(self, name: str) -> bool:
        parts = name.split("/")
        ancestors = ["/".join(parts[: i + 1]) for i in range(1, len(parts))]
        return all(self.visible.get(a, True) for a in ancestors)


def node(state: TrackState, **changes: Any) -> ObjectNode:
    pose: Any = Pose.translated(0.1, 0.2, 1.0)
    made = ObjectNode(
        slug="plate",
        revision=1,
        state=state,
        hierarchy="nested",
        T_base_object=pose,
        T_base_object_raw=pose,
        covariance_base=np.eye(3) * 1e-6,
        seen_ms=40.0,
        predicted_ms=20.0,
        camera="hc",
        reason="",
    )
    return replace(made, **changes)


def state(*objects: ObjectNode, tick: int = 1, **changes: Any) -> SceneState:
    hanging: Any = Pose.of(np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, -0.3))
    made = SceneState(
        instant_ns=1_760_000_000_123_456_789,
        tick=tick,
        Ts_base_link={"base": Pose.identity(), "platform": hanging},
        T_base_tcp=Pose.translated(0.0, 0.0, 0.8),
        T_base_platform=hanging,
        T_base_w=hanging,
        Ts_base_cam={"hc": Pose.translated(0.0, 0.1, 0.8)},
        objects=objects,
        robot_ms=5.0,
    )
    return replace(made, **changes)


@pytest.fixture
def now() -> list[float]:
    return [100.0]


@pytest.fixture
def port() -> FakePort:
    return FakePort()


@pytest.fixture
def stage(port: FakePort, now: list[float]) -> Stage:
    from app.looks import LinkLook
    from scene.glb import to_glb

    box = box_mesh(np.array([0.4, 0.4, 0.02]))
    wall = Fixture("guard", "forbidden", Plane((0.2, 0.2)), Pose.identity())
    links = (LinkLook("base", to_glb(box)), LinkLook("platform", to_glb(box)))
    look = StageLook(links, (object_look("plate", box, fixtures=(wall,)),), {"hc": CAMERA})
    return Stage(port, look, seconds=lambda: now[0])


@pytest.mark.parametrize("given", list(TrackState))
def test_exactly_one_body_shows_the_state(stage: Stage, port: FakePort, given: TrackState) -> None:
    stage.show(state(node(given)))
    shown = {s for s in TrackState if port.shows(f"/site/objects/plate/{s.value}")}
    assert shown == {given}


def test_what_was_never_seen_is_not_drawn(stage: Stage, port: FakePort) -> None:
    unseen = node(TrackState.LOST, T_base_object=None, T_base_object_raw=None, seen_ms=None)
    assert not port.shows("/site/objects/plate/lost")
    stage.show(state(unseen))
    assert not port.shows("/site/objects/plate/lost")
    assert not port.shows("/site/raw/plate/outline")


def test_the_robot_appears_with_its_first_joints(
    stage: Stage, port: FakePort, now: list[float]
) -> None:
    stage.show(state(robot_ms=None))
    assert not port.shows("/site/robot/base/body")
    now[0] += 0.1
    stage.show(state(tick=2))
    assert port.shows("/site/robot/base/body")


def test_up_is_up_though_the_arm_hangs(stage: Stage, port: FakePort) -> None:
    stage.show(state())
    up_base = -np.array([0.0, 0.0, 1.0])  # the platform's up, in the base of a hanging arm
    np.testing.assert_allclose(port.poses["/site"].rotate(up_base), [0, 0, 1], atol=1e-12)


def test_the_heartbeat_tells_tick_and_instant_and_goes_last(stage: Stage, port: FakePort) -> None:
    stage.show(state(tick=7))
    beat = port.poses["/heartbeat"].translation
    assert beat[0] == 7
    assert beat[1] == pytest.approx(1_760_000_000_123_456_789 / 1e6 % 1e6, abs=0.002)
    assert list(port.poses)[-1] == "/heartbeat"
    assert port.flushes == 1


def test_nothing_that_rests_is_sent_again(stage: Stage, port: FakePort, now: list[float]) -> None:
    stage.show(state(node(TrackState.TRACKED)))
    now[0] += 0.1
    moved: Any = Pose.translated(0.1, 0.2, 1.0001)
    stage.show(state(node(TrackState.TRACKED, T_base_object=moved), tick=2))
    assert port.batches[-1] == {"/site/objects/plate", "/heartbeat"}


def test_no_more_than_sixty_states_a_second_are_drawn(stage: Stage, now: list[float]) -> None:
    drawn = 0
    for tick in range(400):
        now[0] += 0.0025
        drawn += stage.show(state(node(TrackState.TRACKED), tick=tick))
    assert 57 <= drawn <= 62


def test_a_pose_that_is_not_finite_hides_nothing(
    stage: Stage, port: FakePort, now: list[float]
) -> None:
    stage.show(state(node(TrackState.TRACKED)))
    before = port.poses["/site/objects/plate"]
    for tick in (2, 3):
        now[0] += 0.1
        nan: Any = Pose(np.full((4, 4), np.nan))
        stage.show(state(node(TrackState.TRACKED, T_base_object=nan), tick=tick))
    assert stage.refused_poses == 2
    assert port.shows("/site/objects/plate/tracked")
    assert port.poses["/site/objects/plate"] is before
    now[0] += 0.1
    stage.show(state(node(TrackState.TRACKED), tick=4))
    assert port.poses["/heartbeat"].translation[0] == 4


def test_the_raw_pose_shows_where_it_differs(
    stage: Stage, port: FakePort, now: list[float]
) -> None:
    stage.show(state(node(TrackState.TRACKED)))
    assert not port.shows("/site/raw/plate/outline")
    now[0] += 0.1
    off: Any = Pose.translated(0.1, 0.21, 1.0)
    stage.show(state(node(TrackState.TRACKED, T_base_object_raw=off), tick=2))
    assert port.shows("/site/raw/plate/outline")
    np.testing.assert_allclose(port.poses["/site/raw/plate"].translation, [0.1, 0.21, 1.0])


def test_the_raw_outline_does_not_flicker(stage: Stage, port: FakePort, now: list[float]) -> None:
    shown = []
    for tick, off_mm in enumerate((2.5, 3.5, 2.5, 1.5, 2.5)):
        now[0] += 0.1
        raw: Any = Pose.translated(0.1, 0.2 + off_mm / 1000, 1.0)
        stage.show(state(node(TrackState.TRACKED, T_base_object_raw=raw), tick=tick))
        shown.append(port.shows("/site/raw/plate/outline"))
    assert shown == [False, True, True, False, False]


def test_the_ground_lies_under_the_lowest_object(stage: Stage, port: FakePort) -> None:
    stage.show(state(node(TrackState.TRACKED)))
    # The arm hangs: lower is further along base's z; the plate is 20 mm thick.
    assert port.poses["/site/ground"].translation[2] == pytest.approx(1.01, abs=1e-9)
    assert port.shows("/site/ground/grid")


def test_the_ground_is_not_drawn_before_it_is_known(stage: Stage, port: FakePort) -> None:
    stage.show(state(node(TrackState.STALE)))
    assert not port.shows("/site/ground/grid")


def test_an_object_the_stage_does_not_know_is_passed_over(stage: Stage, port: FakePort) -> None:
    stage.show(state(node(TrackState.TRACKED, slug="stranger")))
    assert not any("stranger" in name for name in port.poses)


def test_a_frustum_spans_the_image() -> None:
    lines = frustum(CAMERA, depth_m=0.5)
    rim = CAMERA.project(lines[:4, 0])
    np.testing.assert_allclose(rim, [(-0.5, -0.5), (639.5, -0.5), (639.5, 479.5), (-0.5, 479.5)])


def test_the_status_of_a_state_has_both_ages_and_is_json() -> None:
    import json

    nan = node(TrackState.LOST, covariance_base=np.full((3, 3), np.nan), seen_ms=float("nan"))
    status = status_of(state(node(TrackState.TRACKED), nan), site="sam", target="plate")
    json.dumps(status, allow_nan=False)
    first, second = status["objects"]
    assert (first["state"], first["seen_ms"], first["predicted_ms"]) == ("tracked", 40.0, 20.0)
    assert first["bound_mm"] == pytest.approx(3.0)
    assert (second["seen_ms"], second["bound_mm"]) == (None, None)
    assert status["instant_ms"] == pytest.approx(1_760_000_000_123.456, abs=0.01)
