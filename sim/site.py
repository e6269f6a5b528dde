"""The simulated site as a process: physics at wall pace, pictures beside it, everything on the bus.

Three threads and no more: physics with sensors and commands, pictures (the GL context is theirs),
and the sender of pictures, because a full link may block it and must not block a pose. Time is the
site's clock; when the machine is too slow, time since the start slips and health says by how much.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping

import numpy as np

from sim.camera_thread import CameraThread
from sim.outlet import Outgoing, Outlet
from sim.rig import STEP_NS, Rig, Staging, build_plant
from sim.sensors import STEPS_PER_S
from spatial.errors import StateError
from spatial.samples import HealthSample
from spatial.stamp import NS_PER_MS, NS_PER_S, Clock, nanoseconds, seconds
from wire.bus import Bus, Qos
from wire.clock import ClockResponder, SkewedClock
from wire.codec import encode

log = logging.getLogger(__name__)

LIVE_BASE_CAMERA_HZ = 10.0
"""Rate of a camera on the base when live [Hz]: cores are short, the arm's camera goes first."""
PAUSE_S = 0.002
"""Sleep between two batches of physics steps [s]."""
MAX_BATCH = 25
"""Physics steps in a batch, at most: commands and departures are looked after in between."""
MAX_BEHIND_NS = 200 * NS_PER_MS
"""Further behind than this, the site lets time slip instead of racing after it [ns]."""
HEALTH_PERIOD_NS = NS_PER_S // 2
"""Health is told twice a second [ns]."""
SEND_PAUSE_S = 0.02
"""The sender of pictures looks up at least this often [s]."""
PICTURES = frozenset({"image", "video"})
"""Streams that may block."""
_COMMANDS = 64


def live_rates(staging: Staging) -> dict[str, float]:
    """Return the frame rate by camera when live [Hz]."""
    return {
        name: camera.rate_hz if camera.parent == "tcp" else min(camera.rate_hz, LIVE_BASE_CAMERA_HZ)
        for name, camera in staging.site.cameras.items()
    }


class LiveSite:
    """A simulated site on a bus, until it is told to stop."""

    def __init__(
        self,
        bus: Bus,
        *,
        staging: Staging,
        clock: Clock,
        backend: str | None = None,
        rates_hz: Mapping[str, float] | None = None,
    ) -> None:
        """Build the site; nothing moves yet.

        Args:
            bus: where it speaks, and hears commands and clock probes.
            staging: what the session is made of.
            clock: the site's clock.
            backend: renderer, the best that works here when left out.
            rates_hz: frame rate by camera; `live_rates` when left out.
        """
        rates = live_rates(staging) if rates_hz is None else dict(rates_hz)
        streams, seed = staging.scenario.streams, staging.seed
        self._bus = bus
        self._clock = clock
        self._keys = staging.keys
        self._fast = Outlet(streams, seed=seed, sink=self._publish)
        self._slow = Outlet(streams, seed=seed, sink=self._publish)
        plant = build_plant(staging)
        self.rig = Rig(plant, staging=staging, outlet=self._fast, rates_hz=rates)
        self._cameras = CameraThread(
            plant,
            staging=staging,
            rates_hz=rates,
            backend=backend,
            stamp_of=self._stamp_of,
            outlet=self._slow,
        )
        self._commands = bus.subscribe(staging.keys.all_commands, capacity=_COMMANDS)
        self._responder = ClockResponder(bus, keys=staging.keys, clock=clock)
        self._epoch_ns = 0
        self._slipped_ns = 0
        self._late_ns = 0
        self._told_ns = 0
        self._failure: BaseException | None = None

    @property
    def renderer(self) -> str:
        """Renderer of the images; empty until the first context is open."""
        return self._cameras.renderer

    def run(self, stop: threading.Event) -> None:
        """Run until `stop` is set or something fails.

        Raises:
            MissingError: the renderer asked for does not work here.
            StateError: a thread of the site died; its error is the cause.
        """
        self._epoch_ns = self._told_ns = self._clock.now_ns()
        for key, message in self.rig.latched(self._epoch_ns).items():
            self._bus.publish(key, message.payload, schema=message.schema, qos=Qos.LATCHED)
        ended = threading.Event()
        threads = [
            threading.Thread(target=self._guarded, args=(body, ended), name=name, daemon=True)
            for name, body in (("cameras", self._cameras.run), ("sender", self._send))
        ]
        for thread in threads:
            thread.start()
        try:
            while not (stop.is_set() or ended.is_set()):
                self._turn()
                stop.wait(PAUSE_S)
        finally:
            ended.set()
            for thread in threads:
                thread.join(timeout=5.0)
        if self._failure is not None:
            raise StateError(f"the simulated site stopped: {self._failure}") from self._failure

    def _turn(self) -> None:
        """Catch up with the clock, hear commands, let go what is due."""
        now_ns = self._clock.now_ns()
        behind_ns = now_ns - self._stamp(self.rig.steps)
        if behind_ns > MAX_BEHIND_NS:
            self._epoch_ns += behind_ns
            self._slipped_ns += behind_ns
            behind_ns = 0
        self._late_ns = max(self._late_ns, behind_ns)
        for sample in self._commands.take():
            self.rig.hear(sample.payload, now_ns=now_ns)
        for _ in range(min(behind_ns // STEP_NS, MAX_BATCH)):
            due = self.rig.step(stamp_ns=self._stamp(self.rig.steps + 1))
            self._cameras.expose(due)
        now_ns = self._clock.now_ns()
        self._fast.flush(now_ns)
        self._responder.tick()
        if now_ns - self._told_ns >= HEALTH_PERIOD_NS:
            self._tell(now_ns)

    def _stamp(self, steps: int) -> int:
        return self._epoch_ns + steps * STEP_NS

    def _stamp_of(self, time_s: float) -> int:
        """Return the stamp [ns] of a time since the start [s]."""
        return self._stamp(0) + round(time_s * STEPS_PER_S) * STEP_NS

    def _send(self, ended: threading.Event) -> None:
        while not ended.wait(SEND_PAUSE_S / 4):
            self._slow.flush(self._clock.now_ns())

    def _guarded(self, body: Callable[[threading.Event], None], ended: threading.Event) -> None:
        """Run the body of a thread; its end ends the site."""
        try:
            body(ended)
        except BaseException as error:  # noqa: BLE001 -- re-raised by `run` in the main thread
            self._failure = error
        finally:
            ended.set()

    def _publish(self, message: Outgoing) -> None:
        qos = Qos.IMAGE if message.stream in PICTURES else Qos.STATE
        self._bus.publish(message.key, message.payload, schema=message.schema, qos=qos)

    def _tell(self, now_ns: int) -> None:
        """Say how the site is: pace, frame rates, what was lost or refused."""
        lasted_s = seconds(now_ns - self._told_ns)
        slipped_s = seconds(self._slipped_ns)
        rates = self._cameras.rates(lasted_s)
        values = {
            "real_time_factor": max(0.0, 1.0 - slipped_s / lasted_s),
            "late_ms": self._late_ns / NS_PER_MS,
            "lost": float(self._fast.lost + self._slow.lost),
            "commands_refused": float(self.rig.refused),
            **{f"{name}_hz": rate for name, rate in rates.items()},
        }
        slow = values["real_time_factor"] < 0.95
        health = HealthSample(
            stamp_ns=now_ns,
            component="site",
            level="warning" if slow else "ok",
            text="this machine is too slow for the simulation" if slow else "",
            values=values,
        )
        message = encode(health)
        key = self._keys.health("site")
        self._bus.publish(key, message.payload, schema=message.schema)
        self._told_ns, self._late_ns, self._slipped_ns = now_ns, 0, 0


def site_clock(staging: Staging, base: Clock) -> Clock:
    """Return the site's clock: wrong by up to what the scenario says where it is measured."""
    scenario = staging.scenario
    if staging.site.clock_mode != "measured":
        return base
    offset, skew = np.random.default_rng((staging.seed, 1)).uniform(-1.0, 1.0, 2).tolist()
    return SkewedClock(
        base,
        offset_ns=nanoseconds(offset * scenario.clock_offset_s),
        skew_ppm=skew * scenario.clock_skew_ppm,
    )


def run_site(
    bus: Bus,
    *,
    staging: Staging,
    clock: Clock,
    stop: threading.Event,
    backend: str | None = None,
) -> None:
    """Simulate a site until `stop` is set: the body of the site's process.

    Args:
        bus: where it speaks.
        staging: what the session is made of.
        clock: this machine's clock; the site's own is made of it by `site_clock`.
        stop: ends it.
        backend: renderer, the best that works here when left out.

    Raises:
        MissingError: the renderer asked for does not work here.
        StateError: a thread of the site died; its error is the cause.
    """
    site = LiveSite(bus, staging=staging, clock=site_clock(staging, clock), backend=backend)
    site.run(stop)
