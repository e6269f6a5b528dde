"""The bus between processes: any order, any restart, no reader stops another, no truth leaks."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator

import pytest

from spatial.errors import InputError, MissingError, StateError
from wire.bus import Bus, Qos, Sample, Subscription
from wire.hub import Hub, new_truth_password
from wire.zenoh_bus import ZenohBus
from wire.zenoh_session import split_endpoint

POSE, IMAGE, URDF = "live/sam/tracked", "live/sam/camera/hc/image", "live/sam/robot_description"

PUBLISHER = """
import sys, time
from wire.bus import Qos
from wire.zenoh_bus import ZenohBus
with ZenohBus.connect(sys.argv[1]) as bus:
    bus.publish("live/sam/robot_description", sys.argv[2].encode(), schema="a/b",
                qos=Qos.LATCHED)
    for index in range(100_000):
        bus.publish("live/sam/tracked", f"{sys.argv[2]} {index}".encode(), schema="s")
        time.sleep(0.01)
"""
HUB = """
import sys, threading
from wire.hub import Hub
with Hub(listen=sys.argv[1]) as hub:
    print(hub.endpoint, flush=True)
    threading.Event().wait()
"""
IMAGE_READER = """
import sys, time
from wire.zenoh_bus import ZenohBus
with ZenohBus.connect(sys.argv[1]) as bus:
    images = bus.subscribe("live/*/camera/*/image", capacity=1)
    while not images.wait(1.0):
        pass
    print("reading", flush=True)
    time.sleep(600)
"""
RAISES = """
import sys
from wire.zenoh_bus import ZenohBus
with ZenohBus.connect(sys.argv[1]) as bus:
    bus.subscribe("**", capacity=1, latched=True)
    bus.wait_connected(10.0)
    raise SystemExit(7)
"""
FORGETS_TO_CLOSE = """
import sys
from wire.zenoh_bus import ZenohBus
bus = ZenohBus.connect(sys.argv[1])
bus.subscribe("**", capacity=1)
bus.wait_connected(10.0)
raise SystemExit(7)
"""


@contextlib.contextmanager
def running(script: str, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """Start a Python process; kill it at the end, however that comes."""
    command = [sys.executable, "-c", script, *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.send_signal(signal.SIGCONT)
            process.kill()


def said(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline().strip()


def gather(
    subscription: Subscription, until: Callable[[list[Sample]], object], *, timeout_s: float = 15.0
) -> list[Sample]:
    """Take samples until they satisfy a condition."""
    end = time.monotonic() + timeout_s
    taken: list[Sample] = []
    while not until(taken):
        assert time.monotonic() < end, f"only {[(s.key, s.payload[:20]) for s in taken[-5:]]}"
        subscription.wait(0.1)
        taken += subscription.take()
    return taken


def has(payload: bytes) -> Callable[[list[Sample]], bool]:
    return lambda samples: any(payload in sample.payload for sample in samples)


def shake_hands(*buses: ZenohBus) -> None:
    """Wait until what one publishes reaches the others: declarations have crossed."""
    for bus in buses:
        assert bus.wait_connected(10.0)
    subscriptions = [bus.subscribe("hello", capacity=1) for bus in buses]
    for subscription in subscriptions:
        end = time.monotonic() + 10.0
        while not subscription.wait(0.05):
            assert time.monotonic() < end
            buses[0].publish("hello", b"hello", schema="s")
        subscription.close()


def send_image_until_seen(bus: Bus, images: Subscription, payload: bytes) -> Sample:
    """Images are repeated by nature; the first ones may fall while their session opens."""
    end = time.monotonic() + 10.0
    while not images.wait(0.1):
        assert time.monotonic() < end
        bus.publish(IMAGE, payload, schema="foxglove.CompressedImage", qos=Qos.IMAGE)
    return images.take()[0]


@pytest.fixture
def free_endpoint() -> str:
    with Hub() as hub:
        return hub.endpoint


@pytest.fixture
def hub() -> Iterator[Hub]:
    with Hub() as hub:
        yield hub


def test_bytes_key_and_schema_arrive_unchanged(hub: Hub) -> None:
    with ZenohBus.connect(hub.endpoint) as a, ZenohBus.connect(hub.endpoint) as b:
        subscription = b.subscribe("live/*/camera/**", capacity=10)
        shake_hands(a, b)
        payload = os.urandom(300_000)
        a.publish(POSE, b"not this one", schema="s")
        a.publish("live/sam/camera/hc/x", b"", schema="std_msgs/msg/String")
        assert gather(subscription, len) == [
            Sample("live/sam/camera/hc/x", b"", "std_msgs/msg/String")
        ]
        assert send_image_until_seen(a, subscription, payload) == Sample(
            IMAGE, payload, "foxglove.CompressedImage"
        )


def test_hub_listens_on_loopback_and_says_where(hub: Hub) -> None:
    protocol, host, port = split_endpoint(hub.endpoint)
    assert (protocol, host) == ("tcp", "127.0.0.1")
    assert port > 0


def test_taken_port_is_named(hub: Hub) -> None:
    with pytest.raises(MissingError, match=hub.endpoint.replace("/", ".")):
        Hub(listen=hub.endpoint)


@pytest.mark.parametrize("bad", ["", "127.0.0.1:7447", "tcp/:1", "tcp/a:99999", "tcp/a:1?prio=1"])
def test_endpoint_of_another_form_is_refused(bad: str) -> None:
    with pytest.raises(InputError, match="endpoint"):
        ZenohBus.connect(bad)
    with pytest.raises(InputError, match="endpoint"):
        Hub(listen=bad)


def test_missing_hub_blocks_nobody_and_unsent_is_counted(free_endpoint: str) -> None:
    start = time.monotonic()
    with ZenohBus.connect(free_endpoint) as bus:
        subscription = bus.subscribe("**", capacity=1)
        for _ in range(3):
            bus.publish(POSE, b"", schema="s")
        bus.publish(URDF, b"", schema="a/b", qos=Qos.LATCHED)
        assert bus.unsent == 3
        assert not bus.connected
        assert subscription.take() == []
    assert time.monotonic() - start < 5.0
    with pytest.raises(StateError, match="closed"):
        bus.publish(POSE, b"", schema="s")
    with pytest.raises(StateError, match="closed"):
        bus.subscribe("**", capacity=1)


def test_too_large_a_message_is_refused_where_it_is_made(hub: Hub) -> None:
    with ZenohBus.connect(hub.endpoint) as bus, pytest.raises(InputError, match="at most"):
        bus.publish(IMAGE, bytes(17 * 1024 * 1024), schema="s")


def test_late_joiner_gets_the_last_latched_once(hub: Hub) -> None:
    with ZenohBus.connect(hub.endpoint) as a, ZenohBus.connect(hub.endpoint) as b:
        a.publish(URDF, b"old", schema="a/b", qos=Qos.LATCHED)
        a.publish(URDF, b"new", schema="a/b", qos=Qos.LATCHED)
        early = b.subscribe("live/**", capacity=100, latched=True)
        plain = b.subscribe("live/**", capacity=100)
        gather(early, has(b"new"))
        late = b.subscribe("live/*/robot_description", capacity=100, latched=True)
        assert [s.payload for s in gather(late, has(b"new"))] == [b"new"]
        a.publish(POSE, b"end", schema="s")
        assert [s.payload for s in gather(early, has(b"end"))] == [b"end"]
        assert [s.payload for s in gather(plain, has(b"end"))][-1:] == [b"end"]


def test_truth_reaches_only_those_with_the_password() -> None:
    secret = new_truth_password()
    with (
        Hub(truth_password=secret) as hub,
        ZenohBus.connect(hub.endpoint, truth_password=secret) as site,
        ZenohBus.connect(hub.endpoint, truth_password=secret) as metrics,
        ZenohBus.connect(hub.endpoint) as operator,
        ZenohBus.connect(hub.endpoint) as other,
    ):
        seen = metrics.subscribe("live/**", capacity=100, latched=True)
        readers = [
            operator.subscribe(expression, capacity=100, latched=True)
            for expression in ("**", "live/**", "live/truth/**", "live/truth/poses", "*/*/poses")
        ]
        shake_hands(site, metrics, operator, other)
        for _ in range(3):
            other.publish("live/truth/poses", b"forged", schema="s")
        site.publish("live/truth/poses", b"true", schema="s")
        site.publish("live/truth/poses", b"true too", schema="s", qos=Qos.LATCHED)
        site.publish("live/sam/poses", b"end", schema="s")
        taken = gather(seen, lambda s: has(b"end")(s) and has(b"true too")(s))
        assert {s.payload for s in taken} == {b"true", b"true too", b"end"}
        for reader in (readers[0], readers[1], readers[4]):
            assert {s.payload for s in gather(reader, has(b"end"))} <= {b"hello", b"end"}
        assert all(reader.take() == [] for reader in readers)


def test_wrong_password_is_no_entry(hub: Hub) -> None:
    with ZenohBus.connect(hub.endpoint, truth_password="guessed") as bus:  # noqa: S106  # a test
        assert not bus.wait_connected(0.6)


def test_site_hub_and_station_hub_meet_over_two_links_in_any_order(free_endpoint: str) -> None:
    with (
        Hub(dial=free_endpoint) as site_hub,
        ZenohBus.connect(site_hub.endpoint) as site,
        Hub(listen=free_endpoint) as station_hub,
        ZenohBus.connect(station_hub.endpoint) as station,
    ):
        site.publish(URDF, b"urdf", schema="a/b", qos=Qos.LATCHED)
        subscription = station.subscribe("live/**", capacity=9, latched=True)
        gather(subscription, has(b"urdf"))
        end = time.monotonic() + 5.0
        while site_hub.links < 3 and time.monotonic() < end:
            time.sleep(0.05)
        assert site_hub.links == 3  # two to the other hub, one to the client
        shake_hands(site, station)
        send_image_until_seen(site, subscription, bytes(200_000))
        site.publish(POSE, b"pose", schema="s")
        gather(subscription, has(b"pose"))


def test_reader_that_sleeps_loses_its_own_messages_only(hub: Hub) -> None:
    with ZenohBus.connect(hub.endpoint) as a, ZenohBus.connect(hub.endpoint) as b:
        sleeper = b.subscribe("live/**", capacity=2)
        reader = b.subscribe("live/**", capacity=1000)
        shake_hands(a, b)
        for index in range(200):
            a.publish(POSE, str(index).encode(), schema="s")
            time.sleep(0.001)
        assert [int(s.payload) for s in gather(reader, has(b"199"))] == list(range(200))
        assert [int(s.payload) for s in sleeper.take()] == [198, 199]
        assert sleeper.dropped == 198


def test_closed_subscription_is_silent_and_others_go_on(hub: Hub) -> None:
    with ZenohBus.connect(hub.endpoint) as a, ZenohBus.connect(hub.endpoint) as b:
        closed = b.subscribe("live/**", capacity=9, latched=True)
        other = b.subscribe("live/**", capacity=9)
        shake_hands(a, b)
        closed.close()
        a.publish(POSE, b"1", schema="s")
        gather(other, has(b"1"))
        assert closed.take() == []


@pytest.mark.processes
def test_killed_publisher_is_back_with_its_latched_messages(hub: Hub) -> None:
    with ZenohBus.connect(hub.endpoint) as bus:
        subscription = bus.subscribe("live/**", capacity=1000, latched=True)
        with running(PUBLISHER, hub.endpoint, "first") as process:
            gather(subscription, has(b"first 3"))
            process.send_signal(signal.SIGKILL)
        subscription.take()
        with running(PUBLISHER, hub.endpoint, "second"):
            taken = gather(subscription, has(b"second 3"))
        assert b"second" in [s.payload for s in taken if s.key == URDF]
        assert not has(b"first")(taken)


@pytest.mark.processes
def test_killed_hub_is_back_and_everything_flows_again() -> None:
    with running(HUB, "tcp/127.0.0.1:0") as process:
        endpoint = said(process)
        with ZenohBus.connect(endpoint) as a, ZenohBus.connect(endpoint) as b:
            subscription = b.subscribe("live/**", capacity=100, latched=True)
            shake_hands(a, b)
            a.publish(URDF, b"before", schema="a/b", qos=Qos.LATCHED)
            gather(subscription, has(b"before"))
            process.send_signal(signal.SIGKILL)
            process.wait(10.0)
            while a.connected:
                time.sleep(0.02)
            a.publish(URDF, b"meanwhile", schema="a/b", qos=Qos.LATCHED)
            with running(HUB, endpoint) as second:
                assert said(second) == endpoint
                start = time.monotonic()
                gather(subscription, has(b"meanwhile"))
                shake_hands(a, b)
                assert time.monotonic() - start < 10.0
                a.publish(POSE, b"after", schema="s")
                gather(subscription, has(b"after"))
                late = b.subscribe("live/**", capacity=9, latched=True)
                assert [s.payload for s in gather(late, has(b"meanwhile"))] == [b"meanwhile"]


@pytest.mark.processes
def test_stopped_image_reader_stops_no_pose(free_endpoint: str) -> None:
    with (
        running(HUB, free_endpoint),
        ZenohBus.connect(free_endpoint) as site,
        ZenohBus.connect(free_endpoint) as viewer,
        running(IMAGE_READER, free_endpoint) as reader,
    ):
        poses = viewer.subscribe(POSE, capacity=2000)
        images = viewer.subscribe(IMAGE, capacity=1)
        shake_hands(site, viewer)
        stop, picture = threading.Event(), os.urandom(400_000)

        def send_images() -> None:
            while not stop.is_set():
                site.publish(IMAGE, picture, schema="s", qos=Qos.IMAGE)
                stop.wait(0.02)

        sender = threading.Thread(target=send_images)
        sender.start()
        try:
            assert said(reader) == "reading"
            reader.send_signal(signal.SIGSTOP)
            ages = watch_poses(site, poses, count=300)
            images.take()
            received = images.wait(5.0)
            reader.send_signal(signal.SIGCONT)
        finally:
            stop.set()
            sender.join(10.0)
        assert len(ages) == 300, "a pose was lost"
        assert sorted(ages)[int(0.9 * len(ages))] < 0.1
        assert received, "the other image reader starves"


def watch_poses(bus: Bus, poses: Subscription, *, count: int) -> list[float]:
    """Publish poses at 100 Hz and return the ages [s] of those that arrive."""
    ages: list[float] = []
    sent: list[float] = []

    def receive() -> None:
        end = time.monotonic() + 15.0
        while len(ages) < count and time.monotonic() < end:
            poses.wait(0.1)
            now = time.monotonic()
            ages.extend(now - sent[int(sample.payload)] for sample in poses.take())

    receiver = threading.Thread(target=receive)
    receiver.start()
    for index in range(count):
        sent.append(time.monotonic())
        bus.publish(POSE, str(index).encode(), schema="s")
        time.sleep(0.01)
    receiver.join(20.0)
    return ages


@pytest.mark.processes
@pytest.mark.parametrize("script", [RAISES, FORGETS_TO_CLOSE])
def test_process_with_a_subscriber_exits_promptly(hub: Hub, script: str) -> None:
    with running(script, hub.endpoint) as process:
        assert process.wait(15.0) == 7
