"""The simulated site in lock-step, tracker and operator beside it, straight into a recording.

    every millisecond: site, then the tracker message by message as they arrive, then the operator

One thread and one virtual clock: the recording depends on scenario, assets and seed alone. Log
times are arrival times, so that tracking the recording again gives the same poses.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Self

import click

from app.perception import Perception
from app.processes.config import SiteConfig
from app.processes.recorder import attach
from app.processes.site import staging_of
from app.recorded import ABOUT
from app.report import say
from app.stepped import SteppedTracker
from sim.lockstep import LockstepSite
from sim.operator import Operator
from sim.rig import Staging
from spatial.stamp import NS_PER_MS
from spatial.tracked import TrackedObjects, TrackReport
from wire.clock import VirtualClock
from wire.codec import Encoded, encode
from wire.memory_bus import MemoryBus
from wire.recorder import Recorder

SLICE_S = 0.1
"""The progress bar moves this often [s of the site]."""


class Tape:
    """A recorder whose log times are what it is told."""

    def __init__(self, path: Path, *, staging: Staging, clock: VirtualClock, truth: bool) -> None:
        """Create the file.

        Args:
            path: the file, which must not exist.
            staging: what is recorded.
            clock: where time starts; the tape's own goes on from there.
            truth: whether the truth is recorded too.

        Raises:
            FileInputError: the file exists or cannot be written.
        """
        self._bus = MemoryBus()
        self._clock = VirtualClock(clock.now_ns())
        self._recorder = Recorder(
            self._bus, path, keys=staging.keys, clock=self._clock, with_truth=truth
        )

    def write(self, at_ns: int, key: str, message: Encoded) -> None:
        """Write a message; a time before the one before becomes that one."""
        self._clock.set(max(at_ns, self._clock.now_ns()))
        self._bus.publish(key, message.payload, schema=message.schema)
        self._recorder.tick()

    def describe(self, staging: Staging, about: str) -> None:
        """Attach site, robot and objects as a live recording has them, and how it was made."""
        attach(self._recorder, staging.site, staging.database)
        self._recorder.attach(ABOUT, about.encode(), media_type="application/json")

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Write the index."""
        self._recorder.stop()
        self._bus.close()


class TrackedSite:
    """What lives between a site in lock-step, its tracker and the tape."""

    def __init__(
        self, bus: MemoryBus, *, staging: Staging, tape: Tape, method: str, start_ns: int
    ) -> None:
        """Prepare the tracker.

        Args:
            bus: where the tracker's answers are heard.
            staging: what the session is made of.
            tape: takes every message, of the site and of the tracker.
            method: of the tracker.
            start_ns: instant of the start [ns].
        """
        self._bus = bus
        self._keys = staging.keys
        self._tape = tape
        self._last_ns = start_ns
        self.tracker = SteppedTracker(
            Perception(
                site=staging.site, robot=staging.robot, database=staging.database, method=method
            ),
            site=staging.keys.site,
            processing_ns=round(staging.scenario.processing_ms * NS_PER_MS),
            listener=self,
        )

    def arrive(self, arrived_ns: int, key: str, payload: bytes, schema: str) -> None:
        """Take a message of the site: an `Arrival` of `sim.lockstep`."""
        self._last_ns = max(self._last_ns, arrived_ns)
        self.tracker.advance(self._last_ns)
        self._tape.write(self._last_ns, key, Encoded(payload, schema))
        self.tracker.put(self._last_ns, self._keys.topic(key) or "", payload)

    def tracked(self, at_ns: int, tracked: TrackedObjects) -> None:
        """Publish and record all objects."""
        self._say(at_ns, self._keys.tracked, encode(tracked))

    def reports(self, at_ns: int, reports: tuple[TrackReport, ...]) -> None:
        """Publish and record what became of an image."""
        for report in reports:
            self._say(at_ns, self._keys.track_report, encode(report))

    def _say(self, at_ns: int, key: str, message: Encoded) -> None:
        self._bus.publish(key, message.payload, schema=message.schema)
        self._tape.write(at_ns, key, message)


def record_lockstep(
    config: SiteConfig,
    *,
    path: Path,
    duration_s: float,
    with_truth: bool,
    method: str = "joint",
    backend: str | None = None,
    rates_hz: Mapping[str, float] | None = None,
) -> None:
    """Simulate a session as fast as it goes and record it.

    Args:
        config: site, scenario and seed; its bus is not used.
        path: the recording, which must not exist.
        duration_s: length of the session [s].
        with_truth: whether the truth goes into the recording.
        method: of the tracker that the operator sees through.
        backend: renderer, the best that works here when left out.
        rates_hz: frame rate by camera; the site's own when left out.

    Raises:
        InputError: a scenario, file or level that does not exist; a recording that does.
        MissingError: a renderer that does not work here.
    """
    staging = staging_of(config)
    clock = VirtualClock()
    with ExitStack() as stack:
        bus = stack.enter_context(MemoryBus())
        tape = stack.enter_context(Tape(path, staging=staging, clock=clock, truth=with_truth))
        beside = TrackedSite(
            bus, staging=staging, tape=tape, method=method, start_ns=clock.now_ns()
        )
        operator = Operator(
            bus,
            keys=staging.keys,
            clock=clock,
            site=staging.site,
            robot=staging.robot,
            database=staging.database,
            plan=staging.scenario.operator,
            seed=staging.seed,
        )
        site = stack.enter_context(
            LockstepSite(
                bus,
                staging=staging,
                clock=clock,
                on_arrival=beside.arrive,
                backend=backend,
                rates_hz=rates_hz,
            )
        )
        tape.describe(staging, _about(staging, method=method, renderer=site.renderer))
        _run(site, operator, duration_s=duration_s)
    say(f"telepresence: {duration_s:g} s recorded, drawn by {site.renderer}: {path}")


def _about(staging: Staging, *, method: str, renderer: str) -> str:
    return json.dumps(
        {
            "scenario": staging.scenario.name,
            "seed": staging.seed,
            "vio": staging.scenario.vio,
            "method": method,
            "processing_ms": staging.scenario.processing_ms,
            "renderer": renderer,
        }
    )


def _run(site: LockstepSite, operator: Operator, *, duration_s: float) -> None:
    left_s = duration_s
    with click.progressbar(
        length=round(duration_s / SLICE_S),
        label="simulating",
        file=sys.stderr,
        hidden=not sys.stderr.isatty(),
    ) as bar:
        while left_s > 0.0:
            step_s = min(SLICE_S, left_s)
            site.run(step_s, workers=(operator,))
            left_s = round(left_s - step_s, 9)
            bar.update(1)
