"""The cameras of a live site: one thread draws them all, because the GL context is its own.

A camera that exposes leaves a mark; the thread takes marks one by one, the camera on the tool
first. A mark that is still there at the next exposure is a frame that this machine had no time
for: it is skipped and counted, and the other cameras are the first to miss theirs: one of them is
drawn only where the first camera's next frame would still be done before the one after it,

    now + 2 d <= last exposure + 2 / rate,   d: time the last picture took,

or when it has waited for `PATIENCE` frames of the first.
"""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack

from sim.outlet import Outlet
from sim.plant import Plant
from sim.render import Image, Renderer
from sim.rig import Staging
from sim.video import VideoEncoder, image_sample
from spatial.samples import ImageSample
from wire.codec import encode

PATIENCE = 5
"""After so many frames of the first camera in a row, a waiting other one has its turn."""
_WAIT_S = 0.1


class CameraThread:
    """Draws, compresses and hands to the outlet whatever cameras have exposed."""

    def __init__(
        self,
        plant: Plant,
        *,
        staging: Staging,
        rates_hz: Mapping[str, float],
        backend: str | None,
        stamp_of: Callable[[float], int],
        outlet: Outlet,
    ) -> None:
        """Prepare; the renderers are made in the thread.

        Args:
            plant: what is drawn.
            staging: names, keys and video budget.
            rates_hz: frame rate by camera [Hz].
            backend: renderer, `None` for the best that works here.
            stamp_of: stamp [ns] of a time since the start [s].
            outlet: where images and video leave.
        """
        self._plant = plant
        self._staging = staging
        self._backend = backend
        self._stamp_of = stamp_of
        self._outlet = outlet
        site = staging.site
        first = site.vio_camera
        self._order = (first, *(name for name in rates_hz if name != first))
        total_hz = sum(rates_hz.values())
        self._videos = {
            name: VideoEncoder(camera=name, bit_s=site.video_bit_s * rate / total_hz, rate_hz=rate)
            for name, rate in rates_hz.items()
        }
        self._exposed: set[str] = set()
        self._change = threading.Condition()
        self._drawn: Counter[str] = Counter()
        self._in_a_row = 0
        self._period_s = 1.0 / rates_hz[first]
        self._exposed_s = 0.0  # when the first camera did last, on the monotonic clock
        self._took_s = 0.0
        self._compressing: Future[None] | None = None
        self.skipped: Counter[str] = Counter()
        self.renderer = ""

    def expose(self, cameras: Iterable[str]) -> None:
        """Mark cameras that expose now."""
        names = set(cameras)
        if not names:
            return
        with self._change:
            self.skipped.update(names & self._exposed)
            self._exposed |= names
            if self._order[0] in names:
                self._exposed_s = time.monotonic()
            self._change.notify()

    def run(self, ended: threading.Event) -> None:
        """Draw until `ended` is set.

        Raises:
            MissingError: the renderer asked for does not work here.
        """
        with ExitStack() as stack:
            renderers = {
                name: stack.enter_context(
                    Renderer(self._plant, name, quality="live", backend=self._backend)
                )
                for name in self._order
            }
            encoder = stack.enter_context(ThreadPoolExecutor(1, thread_name_prefix="encoder"))
            self.renderer = next(iter(renderers.values())).backend
            while not ended.is_set():
                name = self._next()
                if name is not None:
                    self._draw(name, renderers[name], encoder)

    def rates(self, lasted_s: float) -> dict[str, float]:
        """Return frames per second [Hz] by camera since the last call, `lasted_s` [s] ago."""
        with self._change:
            rates = {name: self._drawn[name] / lasted_s for name in self._order}
            self._drawn.clear()
        return rates

    def _next(self) -> str | None:
        """Return the camera whose turn it is, `None` after a while without one."""
        first = self._order[0]
        with self._change:
            others = [name for name in self._order[1:] if name in self._exposed]
            late = self._in_a_row >= PATIENCE
            if others and (late or (first not in self._exposed and self._has_time())):
                name = others[0]
            elif first in self._exposed:
                name = first
            else:
                self._change.wait(_WAIT_S)
                return None
            self._in_a_row = self._in_a_row + 1 if name == first else 0
            self._exposed.discard(name)
        return name

    def _has_time(self) -> bool:
        """Return whether another picture costs the first camera none."""
        done_s = time.monotonic() + 2.0 * self._took_s
        return done_s <= self._exposed_s + 2.0 * self._period_s

    def _draw(self, name: str, renderer: Renderer, encoder: ThreadPoolExecutor) -> None:
        """Draw a picture; it is compressed beside the drawing of the next one."""
        began_s = time.monotonic()
        picture = renderer.render()
        stamp_ns = self._stamp_of(renderer.time_s)
        if self._compressing is not None:
            self._compressing.result()
        self._compressing = encoder.submit(self._hand_out, name, picture, stamp_ns)
        with self._change:
            self._drawn[name] += 1
            self._took_s = time.monotonic() - began_s

    def _hand_out(self, name: str, picture: Image, stamp_ns: int) -> None:
        keys = self._staging.keys
        image = image_sample(picture, camera=name, stamp_ns=stamp_ns)
        self._put("image", keys.image(name), image)
        video = self._videos[name].encode(picture, stamp_ns=stamp_ns)
        self._put("video", keys.video(name), video)

    def _put(self, stream: str, key: str, image: ImageSample) -> None:
        message = encode(image)
        self._outlet.put(
            stream,
            key=key,
            payload=message.payload,
            schema=message.schema,
            captured_ns=image.stamp_ns,
        )
