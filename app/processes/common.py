"""What processes share: joining the bus, reading the site, saying how they are, keeping pace."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path

from app.processes.config import BusConfig, SiteFiles
from scene.database import Database, load_database
from scene.robot import Robot, load_robot
from scene.site import Site, load_site
from spatial.errors import InputError
from spatial.samples import HealthSample
from spatial.stamp import Clock
from wire.bus import Bus
from wire.codec import encode
from wire.keys import Keys
from wire.zenoh_bus import ZenohBus

HEALTH_EVERY_S = 0.5


def connect(config: BusConfig) -> ZenohBus:
    """Join the bus; returns at once, the connection follows."""
    return ZenohBus.connect(config.endpoint, truth_password=config.truth_password)


def load(files: SiteFiles) -> tuple[Site, Robot, Database]:
    """Read site, robot and database.

    Raises:
        InputError: one of them is missing or wrong, or an object the site names is refused.
    """
    site = load_site(Path(files.site))
    database = load_database(site.objects_dir)
    wanted = {item.slug for item in site.objects}
    for problem in database.problems:
        if problem.slug in wanted:
            raise InputError(problem.message)
    return site, load_robot(site.robot), database


class HealthVoice:
    """Says twice a second that a process lives and what it suffers from."""

    def __init__(self, bus: Bus, keys: Keys, clock: Clock, *, component: str) -> None:
        """Speak for one component."""
        self._bus = bus
        self._key = keys.health(component)
        self._component = component
        self._clock = clock
        self._next_s = 0.0

    def tick(self, values: dict[str, float], *, worry: str = "") -> None:
        """Publish figures, and a worry when there is one, as often as is due."""
        now_s = time.monotonic()
        if now_s < self._next_s:
            return
        self._next_s = now_s + HEALTH_EVERY_S
        sample = HealthSample(
            stamp_ns=self._clock.now_ns(),
            component=self._component,
            level="warning" if worry else "ok",
            text=worry,
            values=values,
        )
        message = encode(sample)
        self._bus.publish(self._key, message.payload, schema=message.schema)


def pace(stop: threading.Event, *, rate_hz: float, tick: Callable[[], object]) -> None:
    """Call `tick` at a steady rate until `stop` is set; late ticks are skipped, not caught up."""
    period_s = 1.0 / rate_hz
    due_s = time.monotonic()
    while not stop.wait(max(0.0, due_s - time.monotonic())):
        tick()
        due_s = max(due_s + period_s, time.monotonic())
