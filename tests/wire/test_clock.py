"""Clocks: never back, and a site's clock that is a minute off and drifts is found."""

from __future__ import annotations

import itertools
import threading

import pytest

from spatial.errors import InputError, StateError
from spatial.stamp import NS_PER_MS, NS_PER_S
from wire.clock import (
    ClockResponder,
    ReplayClock,
    SiteClock,
    SkewedClock,
    SystemClock,
    VirtualClock,
)
from wire.clock_offset import OffsetEstimator, RoundTrip
from wire.codec_time import PlaybackState, encode_playback
from wire.keys import Keys
from wire.memory_bus import LinkShim, MemoryBus, MemoryLink

MS, S = NS_PER_MS, NS_PER_S
KEYS = Keys()


class Link:
    """A station and a site with a wrong clock, stepped at 100 Hz."""

    def __init__(
        self, *, up: LinkShim, down: LinkShim, offset_ns: int = 60 * S, skew_ppm: float = 20.0
    ) -> None:
        self.true = VirtualClock()
        self.site_bus, self.station_bus = MemoryBus(), MemoryBus()
        self.site_clock = SkewedClock(self.true, offset_ns=offset_ns, skew_ppm=skew_ppm)
        self.link = MemoryLink(
            self.site_bus, self.station_bus, clock=self.true, a_to_b=up, b_to_a=down
        )
        self.responder = ClockResponder(self.site_bus, keys=KEYS, clock=self.site_clock)
        self.clock = SiteClock(self.station_bus, keys=KEYS, local=self.true, asker=7)

    def run(self, seconds: float, *, step_ns: int = 2 * MS) -> None:
        for _ in range(round(seconds * S / step_ns)):
            self.responder.tick()
            self.clock.tick()
            self.true.advance(step_ns)

    @property
    def error_ns(self) -> int:
        return self.clock.now_ns() - self.site_clock.now_ns()


SYMMETRIC = LinkShim(seed=1, delay_ns=20 * MS, jitter_ns=10 * MS)


def test_clock_sixty_seconds_and_twenty_ppm_off_is_known_within_its_bound() -> None:
    link = Link(up=SYMMETRIC, down=LinkShim(seed=2, delay_ns=20 * MS, jitter_ns=10 * MS))
    link.run(2.0)
    for _ in range(10):
        link.run(4.0)
        bound = link.clock.bound_ns
        assert bound is not None
        assert abs(link.error_ns) <= bound
        assert 20 * MS <= bound < 25 * MS
    assert abs(link.error_ns) < 2 * MS
    estimate = link.clock.estimate
    assert estimate is not None
    assert estimate.skew == pytest.approx(20e-6, abs=estimate.drift)


def test_before_the_first_answer_no_bound_is_claimed() -> None:
    clock = SiteClock(MemoryBus(), keys=KEYS, local=VirtualClock())
    clock.tick()
    assert clock.bound_ns is None


def test_skew_is_found_on_a_quiet_link() -> None:
    link = Link(up=LinkShim(delay_ns=2 * MS), down=LinkShim(delay_ns=2 * MS))
    link.run(30.0)
    estimate = link.clock.estimate
    assert estimate is not None
    assert estimate.skew == pytest.approx(20e-6, abs=5e-6)
    assert abs(link.error_ns) < MS


def test_bound_holds_on_a_link_that_is_slow_in_one_direction_only() -> None:
    link = Link(up=LinkShim(delay_ns=80 * MS), down=LinkShim(delay_ns=2 * MS), skew_ppm=-20)
    link.run(20.0)
    bound = link.clock.bound_ns
    assert bound is not None
    assert 30 * MS < abs(link.error_ns) <= bound


def test_clock_survives_loss_and_reordering_of_its_probes() -> None:
    bad = {"delay_ns": 10 * MS, "loss": 0.3, "reorder": 0.3, "detour_ns": 40 * MS}
    link = Link(
        up=LinkShim(seed=5, **bad),  # type: ignore[arg-type]  # mixed dict
        down=LinkShim(seed=6, **bad),  # type: ignore[arg-type]  # mixed dict
    )
    link.run(15.0)
    assert abs(link.error_ns) < 3 * MS


def test_time_at_the_station_never_goes_back_while_the_estimate_improves() -> None:
    link = Link(up=LinkShim(seed=1, jitter_ns=60 * MS), down=LinkShim(seed=2, jitter_ns=60 * MS))
    link.run(1.0)
    times = []
    for _ in range(1000):
        link.run(0.01)
        times.append(link.clock.now_ns())
    assert all(a <= b for a, b in itertools.pairwise(times))


def test_restarted_site_with_another_clock_is_followed() -> None:
    link = Link(up=LinkShim(delay_ns=5 * MS), down=LinkShim(delay_ns=5 * MS))
    link.run(5.0)
    link.site_clock = SkewedClock(link.true, offset_ns=-30 * S)
    link.responder._clock = link.site_clock
    link.run(4.0)
    assert abs(link.error_ns) < 5 * MS


def test_probes_of_two_stations_do_not_mix() -> None:
    link = Link(up=LinkShim(delay_ns=5 * MS), down=LinkShim(delay_ns=5 * MS))
    other_local = SkewedClock(link.true, offset_ns=-7 * S)
    other = SiteClock(link.station_bus, keys=KEYS, local=other_local, asker=8)
    for _ in range(500):
        other.tick()
        link.run(0.002)
    assert abs(other.now_ns() - link.site_clock.now_ns()) < 5 * MS
    assert abs(link.error_ns) < 5 * MS


def test_garbage_on_the_clock_key_is_counted() -> None:
    link = Link(up=LinkShim(), down=LinkShim())
    link.site_bus.publish(KEYS.clock, b"\xff" * 9, schema="telepresence.v1.ClockProbe")
    link.run(0.5)
    assert link.responder.refused == 1
    assert link.clock.refused == 1
    assert abs(link.error_ns) < 5 * MS


def test_shared_and_ptp_ask_nobody_and_state_their_bound() -> None:
    bus, local = MemoryBus(), VirtualClock()
    heard = bus.subscribe("**", capacity=9)
    for mode, bound in (("shared", 0), ("ptp", MS)):
        clock = SiteClock(bus, keys=KEYS, local=local, mode=mode)
        clock.tick()
        assert clock.now_ns() == local.now_ns()
        assert clock.bound_ns == bound
        with pytest.raises(StateError, match="nothing to follow"):
            clock.follow(threading.Event())
    assert heard.take() == []


def test_unknown_mode_names_those_that_exist() -> None:
    with pytest.raises(InputError, match="shared, ptp, measured"):
        SiteClock(MemoryBus(), keys=KEYS, local=VirtualClock(), mode="gps")


def test_estimate_takes_the_lowest_round_trip_and_ignores_impossible_ones() -> None:
    estimator = OffsetEstimator()
    for i, (offset, trip) in enumerate([(30, 100), (5, 10), (-40, 90), (99, -1)]):
        estimator.put(RoundTrip(i * MS, offset * MS, trip * MS))
    assert estimator.estimate is not None
    assert estimator.estimate.offset_ns == 5 * MS
    assert estimator.estimate.bound_ns == 5 * MS


def test_system_clock_that_is_set_back_goes_on() -> None:
    wall, monotonic = [1000], [0]
    clock = SystemClock(wall_ns=lambda: wall[0], monotonic_ns=lambda: monotonic[0])
    wall[0], monotonic[0] = 1100, 100
    assert clock.now_ns() == 1100
    wall[0], monotonic[0] = 150, 150
    assert clock.now_ns() == 1150
    wall[0], monotonic[0] = 200, 200
    assert clock.now_ns() == 1200
    wall[0], monotonic[0] = 5000, 300
    assert clock.now_ns() == 5000


def test_virtual_clock_moves_only_forward() -> None:
    clock = VirtualClock(10)
    clock.advance(5)
    assert clock.now_ns() == 15
    with pytest.raises(InputError, match="back"):
        clock.set(14)


def test_replay_clock_runs_at_the_speed_of_the_player_and_jumps_only_with_it() -> None:
    bus, monotonic = MemoryBus(), [0]
    clock = ReplayClock(
        bus.subscribe("clock", capacity=8), start_ns=50, monotonic_ns=lambda: monotonic[0]
    )

    def say(stamp_ns: int, *, speed: float = 1.0, playing: bool = True, jumps: int = 0) -> None:
        state = PlaybackState(stamp_ns, speed, playing, 100, 10_000, jumps)
        encoded = encode_playback(state)
        bus.publish("clock", encoded.payload, schema=encoded.schema)

    assert clock.now_ns() == 50
    say(1000, speed=2.0)
    assert clock.now_ns() == 1000
    monotonic[0] = 100
    assert clock.now_ns() == 1200
    say(1190)
    assert clock.now_ns() == 1200  # late message: time stands, never back
    say(1300, playing=False)
    monotonic[0] = 900
    assert clock.now_ns() == 1300
    say(200, jumps=1)
    assert clock.now_ns() == 200
    monotonic[0] = 1_000_000
    assert clock.now_ns() == 10_000  # the end of the recording
    bus.publish("clock", b"\xff", schema="telepresence.v1.PlaybackClock")
    assert clock.now_ns() == 10_000
    assert clock.refused == 1


def test_site_and_station_find_each_other_from_threads() -> None:
    bus, local = MemoryBus(), SystemClock()
    site_clock = SkewedClock(local, offset_ns=-60 * S)
    responder = ClockResponder(bus, keys=KEYS, clock=site_clock)
    clock = SiteClock(bus, keys=KEYS, local=local)
    stop, synchronised = threading.Event(), threading.Event()
    threads = [threading.Thread(target=f, args=(stop,)) for f in (responder.serve, clock.follow)]
    for thread in threads:
        thread.start()
    for _ in range(200):
        if clock.bound_ns is not None:
            break
        synchronised.wait(0.02)
    stop.set()
    for thread in threads:
        thread.join(5.0)
    assert clock.bound_ns is not None
    assert abs(clock.now_ns() - site_clock.now_ns()) <= clock.bound_ns + 10 * MS
