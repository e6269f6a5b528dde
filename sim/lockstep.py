"""The simulated site in lock-step: one thread, virtual time, the same bytes for the same seed.

    for every millisecond: step, read sensors, draw what exposes, deliver what is due, tick workers

Everything happens in a fixed order on one virtual clock, so a run depends on scenario, assets and
seed alone. Each message goes to the in-memory bus and, with its arrival time, to the sink; the
bytes are the same.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from typing import Protocol, Self

from sim.outlet import Outgoing, Outlet
from sim.render import Renderer
from sim.rig import STEP_NS, Rig, Staging, build_plant
from sim.sensors import STEPS_PER_S
from sim.video import VideoEncoder, image_sample
from spatial.samples import ImageSample
from wire.bus import Bus, Qos
from wire.clock import VirtualClock
from wire.codec import encode

Arrival = Callable[[int, str, bytes, str], None]
"""Takes arrival time [ns], key, payload and schema of every message of the site."""
_COMMANDS = 64


class Worker(Protocol):
    """Anything that lives beside the site: a tracker, an operator."""

    def tick(self, now_ns: int) -> None:
        """Do what is to be done at an instant [ns]."""
        ...


class LockstepSite:
    """A simulated site on a virtual clock; use it in a `with`."""

    def __init__(
        self,
        bus: Bus,
        *,
        staging: Staging,
        clock: VirtualClock,
        on_arrival: Arrival | None = None,
        quality: str = "lockstep",
        backend: str | None = None,
        rates_hz: Mapping[str, float] | None = None,
        video: bool = False,
    ) -> None:
        """Build the site at the clock's present instant.

        Args:
            bus: in-memory bus that workers share.
            staging: what the session is made of.
            clock: moved on by `run`.
            on_arrival: also takes every message, for a recording.
            quality: of the images, `lockstep` or `live`.
            backend: renderer, the best that works here when left out.
            rates_hz: frame rate by camera; the site's own when left out.
            video: whether the operator's video is made as well.
        """
        self._bus = bus
        self._staging = staging
        self._clock = clock
        self._on_arrival = on_arrival
        self._epoch_ns = clock.now_ns()
        self._outlet = Outlet(staging.scenario.streams, seed=staging.seed, sink=self._deliver)
        cameras = staging.site.cameras
        own = {name: camera.rate_hz for name, camera in cameras.items()}
        self._rates_hz = own if rates_hz is None else dict(rates_hz)
        plant = build_plant(staging)
        self.rig = Rig(plant, staging=staging, outlet=self._outlet, rates_hz=self._rates_hz)
        self._commands = bus.subscribe(staging.keys.all_commands, capacity=_COMMANDS)
        self._stack = ExitStack()
        self._renderers = {
            name: self._stack.enter_context(
                Renderer(plant, name, quality=quality, backend=backend, seed=staging.seed)
            )
            for name in self._rates_hz
        }
        self._videos = {
            name: VideoEncoder(camera=name, bit_s=staging.site.video_bit_s / 2, rate_hz=rate)
            for name, rate in self._rates_hz.items()
            if video
        }
        for key, message in self.rig.latched(self._epoch_ns).items():
            self._hand_out(
                self._epoch_ns, key, message.payload, schema=message.schema, qos=Qos.LATCHED
            )

    @property
    def renderer(self) -> str:
        """Backend that draws."""
        return next((r.backend for r in self._renderers.values()), "none")

    def run(self, duration_s: float, *, workers: tuple[Worker, ...] = ()) -> None:
        """Advance by `duration_s` [s], whole milliseconds, ticking workers after each."""
        for _ in range(round(duration_s * STEPS_PER_S)):
            now_ns = self._clock.now_ns() + STEP_NS
            for sample in self._commands.take():
                self.rig.hear(sample.payload, now_ns=now_ns)
            due = self.rig.step(stamp_ns=now_ns)
            self._clock.set(now_ns)
            for camera in due:
                self._draw(camera)
            self._outlet.flush(now_ns)
            for worker in workers:
                worker.tick(now_ns)

    def close(self) -> None:
        """Give the renderers back."""
        self._stack.close()
        self._commands.close()

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close."""
        self.close()

    def _draw(self, camera: str) -> None:
        renderer, keys = self._renderers[camera], self._staging.keys
        picture = renderer.render()
        stamp_ns = self._epoch_ns + round(renderer.time_s * 1e6) * 1000
        image = image_sample(picture, camera=camera, stamp_ns=stamp_ns)
        self._put("image", keys.image(camera), image)
        if camera in self._videos:
            video = self._videos[camera].encode(picture, stamp_ns=stamp_ns)
            self._put("video", keys.video(camera), video)

    def _put(self, stream: str, key: str, image: ImageSample) -> None:
        message = encode(image)
        self._outlet.put(
            stream,
            key=key,
            payload=message.payload,
            schema=message.schema,
            captured_ns=image.stamp_ns,
        )

    def _deliver(self, message: Outgoing) -> None:
        qos = Qos.IMAGE if message.stream in ("image", "video") else Qos.STATE
        arrived_ns = max(message.due_ns, self._epoch_ns)
        self._hand_out(arrived_ns, message.key, message.payload, schema=message.schema, qos=qos)

    def _hand_out(
        self, arrived_ns: int, key: str, payload: bytes, *, schema: str, qos: Qos
    ) -> None:
        self._bus.publish(key, payload, schema=schema, qos=qos)
        if self._on_arrival is not None:
            self._on_arrival(arrived_ns, key, payload, schema)
