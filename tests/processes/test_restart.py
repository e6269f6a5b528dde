"""A running demo loses a process, or hears garbage, and its page goes on."""

from __future__ import annotations

import http.client
import random
import time
from collections.abc import Callable, Iterator
from http import HTTPStatus
from urllib.parse import parse_qs, urlsplit

import pytest

from app.sides import free_endpoint
from tests.processes.running import Running, Watch, eventually
from wire.codec import decode_health
from wire.keys import Keys
from wire.zenoh_bus import ZenohBus

pytestmark = [pytest.mark.processes, pytest.mark.timeout(240)]

BACK_S = 3.0
"""The promise on a machine that is not busy otherwise."""
BUSY = 6.0
"""Tests run on machines that are: this much longer is no failure."""


@pytest.fixture(scope="module")
def demo() -> Iterator[Running]:
    with Running("demo", "--no-browser", "--port", "0") as running:
        running.wait_said(r"http://\S+")
        yield running
        assert running.end() < 5.0
    assert running.complaints() == []


@pytest.fixture(scope="module")
def watch(demo: Running) -> Iterator[Watch]:
    with Watch(demo.wait_said(r"http://\S+")) as watching:
        watching.all_back(0.0)
        yield watching


@pytest.fixture(scope="module")
def ears(demo: Running) -> Iterator[ZenohBus]:
    with ZenohBus.connect(hub_of(demo)) as bus:
        yield bus


@pytest.mark.parametrize("name", ["tracker", "viewer", "operator", "site", "hub"])
def test_a_process_that_is_killed_is_back_in_the_picture(
    demo: Running,
    watch: Watch,
    ears: ZenohBus,
    name: str,
    record_property: Callable[[str, object], None],
) -> None:
    commands = ears.subscribe(Keys().all_commands, capacity=1)
    old = demo.children()[name]
    others = {n: child.pid for n, child in demo.children().items() if n != name}
    old.kill()
    old.wait(timeout=10)
    assert eventually(lambda: demo.children().get(name, old) != old, within_s=15)
    started_s = time.monotonic()
    after_s = watch.all_back(started_s)
    commands.take()
    assert eventually(commands.take, within_s=BACK_S * BUSY)  # the operator's hand is there too
    after_s["command"] = round(time.monotonic() - started_s, 2)
    record_property(f"{name}_back_s", after_s)
    assert max(after_s.values()) < BACK_S * BUSY
    now = {n: child.pid for n, child in demo.children().items() if n != name}
    assert now == others  # nobody else had to be started again
    assert watch.statuses[-1][1]["link"] == "ok"


def test_a_viewer_that_comes_back_has_its_port_and_its_token() -> None:
    options = ("--host", "127.0.0.2", "--port", "0", "--listen", free_endpoint())
    with Running("view", "--no-browser", *options) as view:
        address = urlsplit(view.wait_said(r"http://\S+"))
        assert parse_qs(address.query)["token"]
        assert answer(address.netloc, f"/?{address.query}") == HTTPStatus.SEE_OTHER
        old = view.children()["viewer"]
        old.kill()
        assert eventually(lambda: view.children().get("viewer", old) != old)
        assert eventually(lambda: answer(address.netloc, "/") is not None)
        assert answer(address.netloc, f"/?{address.query}") == HTTPStatus.SEE_OTHER
        assert answer(address.netloc, "/?token=guess") == HTTPStatus.UNAUTHORIZED
        assert answer(address.netloc, "/") == HTTPStatus.UNAUTHORIZED
        assert view.end() < 5.0
    assert view.complaints() == []


def answer(host: str, path: str) -> int | None:
    """Return the status of a page, `None` while nobody serves it."""
    connection = http.client.HTTPConnection(host, timeout=10)
    try:
        connection.request("GET", path)
        return connection.getresponse().status
    except OSError:
        return None
    finally:
        connection.close()


def test_garbage_on_every_key_is_counted_and_dropped(
    demo: Running, watch: Watch, ears: ZenohBus
) -> None:
    keys, noise = Keys(), random.Random(1)
    healths = {name: ears.subscribe(keys.health(name), capacity=8) for name in REFUSING}
    begun_s = time.monotonic()
    refused = dict.fromkeys(REFUSING, 0.0)

    def spread() -> bool:
        for key in targets(keys):
            ears.publish(key, noise.randbytes(noise.randrange(200)), schema="foxglove.Odometry")
        for name, subscription in healths.items():
            for sample in subscription.take():
                refused[name] = decode_health(sample.payload).values["refused"]
        return all(count >= 20 for count in refused.values())

    pids = {name: child.pid for name, child in demo.children().items()}
    assert eventually(spread, within_s=30), refused
    after_s = watch.all_back(begun_s + 1.0)  # in the midst of it
    assert max(after_s.values()) < BACK_S * BUSY
    assert {name: child.pid for name, child in demo.children().items()} == pids


REFUSING = ("tracker", "viewer")


def targets(keys: Keys) -> list[str]:
    """Return every key that somebody reads."""
    cameras = [way(name) for way in (keys.image, keys.video) for name in ("hc", "mako")]
    plain = [keys.vio, keys.joints, keys.wrench, keys.tracked, keys.track_report, keys.clock]
    return [*cameras, *plain, keys.health("x"), keys.command("tool"), keys.command("stop")]


def hub_of(demo: Running) -> str:
    """Return the endpoint the hub listens on."""
    (port,) = {
        c.laddr.port for c in demo.children()["hub"].net_connections("tcp") if c.status == "LISTEN"
    }
    return f"tcp/127.0.0.1:{port}"
