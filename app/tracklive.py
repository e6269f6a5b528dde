"""Run a tracker beside a live site: it listens like the site's own tracker and publishes nothing.

Two trackers on one key would fight over every tab, so what this one says goes into a report.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from app.processes.tracker import TrackerProcess
from app.report import say
from app.tracklog import TimedPerception, TrackLog, run_time_figures
from scene.database import Database
from scene.robot import Robot
from scene.site import Site
from spatial.errors import StateError
from spatial.stamp import Clock
from wire.bus import Bus, Qos, Subscription
from wire.clock import SystemClock
from wire.codec import decode_tracked
from wire.keys import Keys
from wire.zenoh_bus import ZenohBus

SILENT_S = 10.0
"""A site that says nothing for so long at the start is not there [s]."""


class ListeningBus:
    """A bus that hears everything; what is published on it goes to one function."""

    def __init__(self, bus: Bus, heard: Callable[[str, bytes], None]) -> None:
        """Listen to `bus` and hand what is published to `heard(key, payload)`."""
        self._bus = bus
        self._heard = heard

    def publish(self, key: str, payload: bytes, *, schema: str, qos: Qos = Qos.STATE) -> None:
        """Hand over; nothing leaves."""
        del schema, qos
        self._heard(key, payload)

    def subscribe(self, key_expr: str, *, capacity: int, latched: bool = False) -> Subscription:
        """Receive; see `wire.bus.Bus`."""
        return self._bus.subscribe(key_expr, capacity=capacity, latched=latched)

    def close(self) -> None:
        """Close the bus."""
        self._bus.close()

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close."""
        self.close()


def track_live(
    site: Site,
    *,
    robot: Robot,
    database: Database,
    method: str = "joint",
    out: Path | None = None,
    endpoint: str,
    duration_s: float | None = None,
) -> dict[str, Any]:
    """Return the report of `telepresence track` on a live site, when it ends.

    Args:
        site: cameras, who carries which object, limits; its name is that on the bus.
        robot: its robot.
        database: its objects.
        method: of the tracker.
        out: table of every pose; none when left out.
        endpoint: hub to listen at.
        duration_s: ends by itself after this [s]; with Ctrl-C otherwise.

    Raises:
        StateError: the site said nothing.
    """
    perception = TimedPerception(site=site, robot=robot, database=database, method=method)
    with ZenohBus.connect(endpoint) as bus, TrackLog(out) as log:
        run(bus, site.name, perception, log, clock=SystemClock(), duration_s=duration_s)
        if not log.poses and not perception.run_times_ms and not perception.has_motion:
            raise StateError(f"nothing heard of site {site.name!r} at {endpoint}; is it running?")
        return {
            "method": method,
            "frames": len(perception.run_times_ms),
            **log.figures(),
            "run_time_ms": run_time_figures(perception.run_times_ms),
            "warnings": [],
        }


def run(
    bus: Bus,
    site: str,
    perception: TimedPerception,
    log: TrackLog,
    *,
    clock: Clock,
    duration_s: float | None,
) -> None:
    """Track until the time is over, Ctrl-C, or a silence at the start.

    Args:
        bus: where the site is heard.
        site: its name.
        perception: what looks.
        log: takes what is said.
        clock: when it is said.
        duration_s: for how long [s]; `None`: without end.
    """
    keys = Keys(site=site)

    def heard(key: str, payload: bytes) -> None:
        if key == keys.tracked:
            log.tracked(clock.now_ns(), decode_tracked(payload))

    process = TrackerProcess(ListeningBus(bus, heard), keys, perception)
    stop = threading.Event()
    watchers = [
        threading.Thread(target=process.watch, args=(camera, stop), daemon=True)
        for camera in perception.cameras
    ]
    for watcher in watchers:
        watcher.start()
    started_s = time.monotonic()
    end_s = float("inf") if duration_s is None else started_s + duration_s
    try:
        while (now_s := time.monotonic()) < end_s:
            process.move()
            if not perception.has_motion and now_s - started_s > SILENT_S:
                break
    except KeyboardInterrupt:
        say("telepresence: stopping")
    stop.set()
    for watcher in watchers:
        watcher.join()
