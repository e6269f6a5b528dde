"""The in-memory bus and its link: same meaning as the real one, misbehaving on demand."""

from __future__ import annotations

import itertools
import threading
import time

import pytest

from spatial.errors import InputError, StateError
from spatial.stamp import NS_PER_MS
from wire.bus import Bus, Qos, Sample
from wire.clock import VirtualClock
from wire.memory_bus import LinkShim, MemoryBus, MemoryLink

MS = NS_PER_MS


def number(samples: list[Sample]) -> list[int]:
    return [int(sample.payload) for sample in samples]


def send(bus: Bus, index: int, *, key: str = "live/sam/vio", qos: Qos = Qos.STATE) -> None:
    bus.publish(key, str(index).encode(), schema="s", qos=qos)


def test_subscriber_gets_what_is_published_after_it_came_in_order() -> None:
    with MemoryBus() as bus:
        send(bus, 0)
        subscription = bus.subscribe("live/*/vio", capacity=10)
        for index in (1, 2, 3):
            send(bus, index)
        send(bus, 4, key="live/sam/joints")
        assert subscription.take() == [Sample("live/sam/vio", b"%d" % i, "s") for i in (1, 2, 3)]
        assert subscription.take() == []


def test_full_ring_keeps_the_newest_and_counts() -> None:
    with MemoryBus() as bus:
        subscription = bus.subscribe("**", capacity=2)
        for index in range(5):
            send(bus, index)
        assert number(subscription.take()) == [3, 4]
        assert subscription.dropped == 3


def test_late_joiner_gets_the_last_latched_of_each_key_only_if_asked() -> None:
    with MemoryBus() as bus:
        send(bus, 1, key="live/a", qos=Qos.LATCHED)
        send(bus, 2, key="live/a", qos=Qos.LATCHED)
        send(bus, 3, key="live/b", qos=Qos.LATCHED)
        send(bus, 4, key="live/c")
        assert number(bus.subscribe("live/*", capacity=9, latched=True).take()) == [2, 3]
        assert bus.subscribe("live/*", capacity=9).take() == []


def test_wait_wakes_on_arrival_and_not_before() -> None:
    with MemoryBus() as bus:
        subscription = bus.subscribe("**", capacity=2)
        assert not subscription.wait(0.01)
        timer = threading.Timer(0.05, send, (bus, 1))
        timer.start()
        assert subscription.wait(10.0)
        timer.join()


def test_closed_bus_refuses_and_closed_subscription_is_silent() -> None:
    bus = MemoryBus()
    one, two = bus.subscribe("**", capacity=9), bus.subscribe("**", capacity=9)
    one.close()
    send(bus, 1)
    assert one.take() == []
    assert number(two.take()) == [1]
    bus.close()
    bus.close()
    with pytest.raises(StateError, match="closed"):
        send(bus, 2)
    with pytest.raises(StateError, match="closed"):
        bus.subscribe("**", capacity=1)
    assert not two.wait(10.0)  # returns at once: nothing can come any more


@pytest.mark.parametrize("key", ["live/**", "", "live//a"])
def test_publishing_on_an_expression_is_refused(key: str) -> None:
    with MemoryBus() as bus, pytest.raises(InputError, match="no key"):
        bus.publish(key, b"", schema="s")


def test_capacity_below_one_is_refused() -> None:
    with MemoryBus() as bus, pytest.raises(InputError, match="capacity"):
        bus.subscribe("**", capacity=0)


def test_each_direction_has_its_own_delay() -> None:
    clock = VirtualClock()
    site, station = MemoryBus(), MemoryBus()
    MemoryLink(
        site,
        station,
        clock=clock,
        a_to_b=LinkShim(delay_ns=40 * MS),
        b_to_a=LinkShim(delay_ns=5 * MS),
    )
    up, down = station.subscribe("up", capacity=9), site.subscribe("down", capacity=9)
    send(site, 1, key="up")
    send(station, 2, key="down")
    clock.advance(5 * MS)
    assert number(down.take()) == [2]
    assert up.take() == []
    clock.advance(35 * MS)
    assert number(up.take()) == [1]


def arrivals(shim: LinkShim, *, count: int = 400) -> tuple[list[int], int]:
    """Numbers in order of arrival over one direction, and how many the link says it lost."""
    clock = VirtualClock()
    site, station = MemoryBus(), MemoryBus()
    link = MemoryLink(site, station, clock=clock, a_to_b=shim)
    subscription = station.subscribe("**", capacity=count)
    taken: list[int] = []
    for index in range(count):
        send(site, index)
        clock.advance(5 * MS)
        taken += number(subscription.take())
    clock.advance(1000 * MS)
    return taken + number(subscription.take()), link.lost[0]


def test_jitter_keeps_the_order() -> None:
    taken, lost = arrivals(LinkShim(seed=1, delay_ns=MS, jitter_ns=30 * MS))
    assert taken == list(range(400))
    assert lost == 0


def test_detours_reorder_and_lose_nothing() -> None:
    taken, _ = arrivals(LinkShim(seed=1, reorder=0.2, detour_ns=12 * MS))
    assert sorted(taken) == list(range(400))
    overtaken = sum(b < a for a, b in itertools.pairwise(taken))
    assert 40 < overtaken < 120


def test_loss_is_the_share_asked_for_and_counted() -> None:
    taken, lost = arrivals(LinkShim(seed=1, loss=0.25))
    assert len(taken) + lost == 400
    assert 70 < lost < 130


def test_same_seed_same_arrivals_and_another_seed_others() -> None:
    shim = {"jitter_ns": 9 * MS, "loss": 0.1, "reorder": 0.1, "detour_ns": 20 * MS}
    first = arrivals(LinkShim(seed=3, **shim))  # type: ignore[arg-type]  # mixed dict
    assert first == arrivals(LinkShim(seed=3, **shim))  # type: ignore[arg-type]  # mixed dict
    assert first != arrivals(LinkShim(seed=4, **shim))  # type: ignore[arg-type]  # mixed dict


def test_latched_crosses_a_lossy_link_and_waits_for_late_joiners() -> None:
    clock = VirtualClock()
    site, station = MemoryBus(), MemoryBus()
    send(site, 1, key="live/urdf", qos=Qos.LATCHED)
    MemoryLink(site, station, clock=clock, a_to_b=LinkShim(loss=1.0, delay_ns=MS))
    send(site, 2, key="live/map", qos=Qos.LATCHED)
    clock.advance(MS)
    assert number(station.subscribe("**", capacity=9, latched=True).take()) == [1, 2]


def test_nothing_echoes_over_a_link() -> None:
    site, station = MemoryBus(), MemoryBus()
    MemoryLink(site, station, clock=VirtualClock())
    here, there = site.subscribe("**", capacity=9), station.subscribe("**", capacity=9)
    send(site, 1)
    assert number(there.take()) == [1]
    assert number(here.take()) == [1]
    assert number(there.take()) == []


def test_waiting_reader_is_woken_by_an_arrival_over_the_link() -> None:
    site, station = MemoryBus(), MemoryBus()
    clock = VirtualClock()
    MemoryLink(site, station, clock=clock, a_to_b=LinkShim(delay_ns=MS))
    subscription = station.subscribe("**", capacity=9)
    send(site, 1)
    timer = threading.Timer(0.03, clock.advance, (MS,))
    timer.start()
    start = time.monotonic()
    assert subscription.wait(10.0)
    assert time.monotonic() - start < 5.0
    timer.join()


def test_impossible_link_is_refused() -> None:
    with pytest.raises(InputError, match="shares"):
        LinkShim(loss=1.5)
