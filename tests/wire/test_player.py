"""Playback: same bytes, own session, own time, and nothing that moves a robot."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from spatial.errors import FileInputError, InputError
from spatial.stamp import NS_PER_MS, NS_PER_S
from spatial.tracked import TrackedObjects
from wire import codec
from wire.bus import Qos, Sample
from wire.clock import LOCKSTEP_EPOCH_NS, ReplayClock, VirtualClock
from wire.keys import Keys
from wire.memory_bus import MemoryBus
from wire.player import Player
from wire.recorder import Recorder

MS = NS_PER_MS
LIVE, REPLAY = Keys(), Keys(session="replay-7")
START = LOCKSTEP_EPOCH_NS


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four seconds: poses at 100 Hz, one command, one truth, a probe, a URDF, a short stream."""
    file = tmp_path_factory.mktemp("player") / "a.mcap"
    bus, clock = MemoryBus(), VirtualClock(START)
    recorder = Recorder(bus, file, keys=LIVE, clock=clock, with_truth=True)
    bus.publish(LIVE.robot_description, b"{}", schema="std_msgs/msg/String", qos=Qos.LATCHED)
    bus.publish(LIVE.command("tool"), b"c", schema="telepresence.v1.ToolCommand")
    bus.publish(LIVE.truth("poses"), b"t", schema="telepresence.v1.NamedPoses")
    bus.publish(LIVE.clock, b"p", schema="telepresence.v1.ClockProbe")
    bus.publish(LIVE.wrench, b"w", schema="telepresence.v1.Wrench")
    for _ in range(400):
        encoded = codec.encode(TrackedObjects(clock.now_ns(), ()))
        bus.publish(LIVE.tracked, encoded.payload, schema=encoded.schema)
        recorder.tick()
        clock.advance(10 * MS)
    recorder.stop()
    return file


class Table:
    """A player on a table: local time moves by hand."""

    def __init__(self, path: Path, **more: object) -> None:
        self.local_ns = 0
        self.bus = MemoryBus()
        self.heard = self.bus.subscribe("**", capacity=10_000)
        self.clock = ReplayClock(
            self.bus.subscribe(REPLAY.clock, capacity=64), monotonic_ns=lambda: self.local_ns
        )
        self.player = Player(
            path,
            self.bus,
            keys=REPLAY,
            monotonic_ns=lambda: self.local_ns,
            **more,  # type: ignore[arg-type]  # options of one test each
        )

    def run(self, seconds: float, *, step_ns: int = 5 * MS) -> list[Sample]:
        """Tick for a while and return what was published, clocks left out."""
        for _ in range(round(seconds * NS_PER_S / step_ns)):
            self.player.tick()
            self.local_ns += step_ns
        self.player.tick()
        return [s for s in self.heard.take() if s.key != REPLAY.clock]


Make = Callable[..., Table]


@pytest.fixture
def make(path: Path) -> Iterator[Make]:
    tables: list[Table] = []

    def one(**more: object) -> Table:
        tables.append(Table(path, **more))
        return tables[-1]

    yield one
    for made in tables:
        made.player.close()


def stamps(samples: list[Sample]) -> list[int]:
    """Stamps of the poses [ms since the start]."""
    return [
        (codec.decode_tracked(s.payload).stamp_ns - START) // MS
        for s in samples
        if s.key == REPLAY.tracked
    ]


def test_everything_comes_back_once_in_order_under_the_replay_session(make: Make) -> None:
    table = make()
    table.player.play()
    samples = table.run(5.0)
    assert stamps(samples) == list(range(0, 4000, 10))
    assert {s.key for s in samples} == {REPLAY.tracked, REPLAY.robot_description, REPLAY.wrench}
    assert not table.player.state.playing  # it stands at its end


def test_commands_truth_and_probes_are_never_played(make: Make) -> None:
    table = make()
    assert table.player.topics == ["sam/robot_description", "sam/tracked", "sam/wrench"]
    with pytest.raises(InputError, match="moves no robot"):
        make(remap={"sam/tracked": "sam/cmd/tool"})


@pytest.mark.parametrize("session", ["live", "Replay", "x"])
def test_session_of_a_playback_can_not_be_taken_for_live(path: Path, session: str) -> None:
    with pytest.raises(InputError, match="replay"):
        Player(path, MemoryBus(), keys=Keys(session=session))


@pytest.mark.parametrize(("speed", "expected"), [(0.5, 50), (1.0, 100), (4.0, 399)])
def test_speed_is_recorded_seconds_per_second(make: Make, speed: float, expected: int) -> None:
    table = make()
    table.player.set_speed(speed)
    table.player.play()
    assert len(stamps(table.run(1.0))) == pytest.approx(expected, abs=2)


def test_change_of_speed_does_not_jump(make: Make) -> None:
    table = make()
    table.player.play()
    table.run(1.0)
    before = table.player.state
    table.player.set_speed(2.0)
    after = table.player.state
    assert after.stamp_ns == before.stamp_ns
    assert after.jumps == before.jumps


@pytest.mark.parametrize("speed", [0.0, 0.05, 9.0, -1.0, float("nan")])
def test_impossible_speed_is_refused(make: Make, speed: float) -> None:
    with pytest.raises(InputError, match="speed"):
        make().player.set_speed(speed)


def test_paused_player_shows_its_instant_and_stands(make: Make) -> None:
    table = make()
    assert stamps(table.run(1.0)) == [0]
    table.player.play()
    table.run(0.5)
    table.player.pause()
    here = table.player.state.stamp_ns
    assert table.run(1.0) == []
    assert table.player.state.stamp_ns == here
    assert table.clock.now_ns() == here


def test_backward_seek_shows_the_state_of_that_instant_with_what_is_latched(make: Make) -> None:
    table = make()
    table.player.play()
    table.run(3.0)
    table.player.pause()
    table.player.seek(START + 1234 * MS)
    samples = table.run(0.1)
    assert stamps(samples) == [1230]
    assert REPLAY.robot_description in {s.key for s in samples}
    assert REPLAY.wrench in {s.key for s in samples}
    assert table.clock.now_ns() == START + 1234 * MS
    table.player.play()
    assert stamps(table.run(0.05))[:2] == [1240, 1250]


def test_stream_that_had_fallen_silent_is_silent_after_a_seek(make: Make) -> None:
    table = make()
    table.run(0.1)
    table.player.seek(START + 3500 * MS)
    keys = {s.key for s in table.run(0.1)}
    assert keys == {REPLAY.tracked, REPLAY.robot_description}


def test_seek_beyond_the_ends_stops_at_them(make: Make) -> None:
    table = make()
    table.player.seek(START + 3600 * NS_PER_S)
    assert stamps(table.run(0.1)) == [3990]
    table.player.seek(1)
    assert stamps(table.run(0.1)) == [0]
    table.player.seek(START + 3600 * NS_PER_S)
    table.player.play()  # at the end: from the start
    assert stamps(table.run(0.1))[:3] == [0, 10, 20]


def test_loop_repeats_its_part_and_says_that_it_jumped(make: Make) -> None:
    table = make()
    table.player.set_loop(loop=True, range_ns=(START + 1000 * MS, START + 1200 * MS))
    table.player.seek(0)
    table.player.play()
    jumps = table.player.state.jumps
    played = stamps(table.run(1.0))
    assert set(played) == set(range(1000, 1201, 10))
    assert played.count(1100) in (4, 5, 6)
    assert table.player.state.jumps - jumps >= 4
    with pytest.raises(InputError, match="holds"):
        table.player.set_loop(loop=True, range_ns=(5, 6))


def test_time_of_a_replay_is_the_players(make: Make) -> None:
    table = make()
    table.player.play()
    table.run(0.1)  # the clock anchors on the message with the least delay
    table.clock.now_ns()
    for _ in range(100):
        newest = stamps(table.run(0.01))[-1]
        age_ms = (table.clock.now_ns() - START) / MS - newest
        assert 0 <= age_ms <= 10


def test_wanted_topics_and_remapping(make: Make) -> None:
    table = make(topics=("*/tracked",), remap={"sam/tracked": "sam/recorded"})
    assert {s.key for s in table.run(0.1)} == {"replay-7/sam/recorded"}
    with pytest.raises(InputError, match="available: sam/tracked"):
        make(topics=("*/tracked",), remap={"sam/vio": "x"})
    with pytest.raises(FileInputError, match="nothing to play"):
        make(topics=("sam/cmd/**",))


def test_thread_plays_on_its_own(path: Path) -> None:
    bus = MemoryBus()
    heard = bus.subscribe(REPLAY.tracked, capacity=1000)
    with Player(path, bus, keys=REPLAY) as player:
        player.set_speed(8.0)
        player.play()
        taken: list[Sample] = []
        for _ in range(200):
            heard.wait(0.1)
            taken += heard.take()
            if len(taken) == 400:
                break
    assert stamps(taken) == list(range(0, 4000, 10))
