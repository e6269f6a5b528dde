"""One tab that watches `/live`: what it asked for, what is on its way, what it may get next.

Video is newest-only. A frame is sent when fewer than `window` frames are unacknowledged and their
bytes fit the budget B = max(64 kB, rate * 0.25 s), where the rate is measured from acknowledged
bytes; so a thin link sees fewer frames, never older ones. The window grows by one when frames come
back within 120 ms and shrinks to one when they take longer than 300 ms.
"""

from __future__ import annotations

import itertools
import json
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

MIN_BUDGET_BYTES = 64 * 1024
BUDGET_S = 0.25
FAST_S, SLOW_S = 0.12, 0.30
MAX_WINDOW = 3
FORGET_S = 2.0
"""A frame without acknowledgement counts as gone after this."""
STATUS_INTERVAL_S = 1.0 / 30.0
RATE_GAIN = 0.2
MAX_TEXT = 1024
_HEADER = struct.Struct("<I")


class Variant(Enum):
    """How a frame is prepared for a tab."""

    OFF = "off"
    FULL = "full"
    """As the camera sent it."""
    HALF = "half"
    """Half the size, for a docked panel."""
    QUARTER = "quarter"
    """A quarter of the size, for thin links."""
    OVERLAY = "overlay"
    """Full size without lens distortion, to lay over the scene."""


@dataclass(frozen=True, slots=True, eq=False)
class VideoFrame:
    """An encoded image and what the page must know of it."""

    camera: str
    """Name of the camera."""
    number: int
    """Counts the frames of this camera since the start of the station."""
    stamp_ns: int
    """Capture stamp [ns]."""
    jpeg: bytes
    """Image."""
    meta: Mapping[str, Any] = field(default_factory=dict)
    """Size, and of overlays `K` (fx, fy, cx, cy) and `T_base_cam` (16, row-major)."""
    variant: Variant = Variant.FULL
    """How it was prepared."""

    def message(self, *, sent_id: int, dropped: int) -> bytes:
        """Return bytes: length of the header (u32), header (JSON), JPEG.

        Args:
            sent_id: what the tab acknowledges.
            dropped: frames of this camera that this tab did not get since the one before.
        """
        header = {
            "camera": self.camera,
            "id": sent_id,
            "frame": self.number,
            "stamp_ms": self.stamp_ns / 1e6,
            "variant": self.variant.value,
            "dropped": dropped,
            **self.meta,
        }
        text = json.dumps(header, separators=(",", ":"), allow_nan=False).encode()
        return _HEADER.pack(len(text)) + text + self.jpeg


@dataclass(slots=True)
class _Flight:
    size: int
    sent_s: float


class Spectator:
    """State of one tab; no clock and no socket of its own."""

    def __init__(self) -> None:
        """Start with nothing subscribed."""
        self.wishes: dict[str, Variant] = {}
        """Variant wanted, by camera."""
        self.dropped: dict[str, int] = {}
        """Frames that a newer one replaced before they were sent, by camera."""
        self.sent: dict[str, int] = {}
        """Frames sent, by camera."""
        self.rate_bytes_s = 0.0
        """Measured throughput of video [bytes/s]; 0 before the first acknowledgement."""
        self.window = 2
        """Frames that may be unacknowledged."""
        self.bad_messages = 0
        """Messages of the tab that made no sense."""
        self._pending: dict[str, VideoFrame] = {}
        self._last_sent: dict[str, int] = {}
        self._flights: dict[int, _Flight] = {}
        self._ids = itertools.count(1)
        self._status: str | None = None
        self._next_status_s = 0.0
        self._served: dict[str, int] = {}

    def hear(self, text: str | bytes, *, now_s: float, cameras: frozenset[str]) -> None:
        """Take a message of the tab: `subscribe` or `ack`; anything else is counted and dropped."""
        try:
            message = json.loads(text) if isinstance(text, str) and len(text) <= MAX_TEXT else {}
            if message["kind"] == "subscribe":
                self._subscribe(message["camera"], Variant(message["mode"]), cameras)
            elif message["kind"] == "ack":
                self._acknowledge(int(message["id"]), now_s)
            else:
                self.bad_messages += 1
        except (ValueError, KeyError, TypeError, RecursionError, OverflowError):
            self.bad_messages += 1

    def offer(self, frame: VideoFrame) -> None:
        """Keep a frame as the newest of its camera, if this tab wants that variant of it."""
        if self.wanted(frame.camera) is not frame.variant:
            return
        if frame.camera in self._pending:
            self.dropped[frame.camera] = self.dropped.get(frame.camera, 0) + 1
        self._pending[frame.camera] = frame

    def offer_status(self, text: str) -> None:
        """Keep a status as the newest."""
        self._status = text

    def wanted(self, camera: str) -> Variant:
        """Return the variant this tab gets: what it asked for, smaller on a thin link."""
        wish = self.wishes.get(camera, Variant.OFF)
        thin = 0.0 < self.rate_bytes_s < 250_000.0 and self.window == 1
        return Variant.QUARTER if thin and wish in (Variant.FULL, Variant.HALF) else wish

    def next_status(self, *, now_s: float) -> str | None:
        """Return a status to send now, at most 30 a second."""
        if self._status is None or now_s < self._next_status_s:
            return None
        text, self._status = self._status, None
        self._next_status_s = now_s + STATUS_INTERVAL_S
        return text

    def next_frame(self, *, now_s: float) -> bytes | None:
        """Return the message of a frame to send now, `None` when nothing may go."""
        self._forget(now_s)
        if not self._pending or not self._room():
            return None
        camera = min(self._pending, key=lambda name: self._served.get(name, 0))
        frame = self._pending.pop(camera)
        missed = max(0, frame.number - self._last_sent.get(camera, frame.number - 1) - 1)
        self._last_sent[camera] = frame.number
        self.sent[camera] = self.sent.get(camera, 0) + 1
        sent_id = next(self._ids)
        self._served[camera] = sent_id
        message = frame.message(sent_id=sent_id, dropped=missed)
        self._flights[sent_id] = _Flight(len(message), now_s)
        return message

    def wait_s(self, *, now_s: float) -> float | None:
        """Return after how long something may go without a new event [s], `None` for never."""
        waits = []
        if self._status is not None:
            waits.append(max(0.0, self._next_status_s - now_s))
        if self._pending and self._flights:
            oldest = min(flight.sent_s for flight in self._flights.values())
            waits.append(max(0.0, oldest + FORGET_S - now_s))
        return min(waits) if waits else None

    @property
    def in_flight_bytes(self) -> int:
        """Bytes of frames sent and not acknowledged."""
        return sum(flight.size for flight in self._flights.values())

    def _subscribe(self, camera: Any, variant: Variant, cameras: frozenset[str]) -> None:
        if camera not in cameras:
            self.bad_messages += 1
            return
        self.wishes[camera] = variant
        self._pending.pop(camera, None)
        self._last_sent.pop(camera, None)

    def _acknowledge(self, sent_id: int, now_s: float) -> None:
        flight = self._flights.pop(sent_id, None)
        if flight is None:
            return
        took = now_s - flight.sent_s
        if took > SLOW_S:
            self.window = 1
        elif took < FAST_S:
            self.window = min(MAX_WINDOW, self.window + 1)
        # What one frame took is a lower bound of the link, smoothed.
        rate = flight.size / max(took, 1e-3)
        self.rate_bytes_s += RATE_GAIN * (rate - self.rate_bytes_s) if self.rate_bytes_s else rate

    def _forget(self, now_s: float) -> None:
        for sent_id in [i for i, f in self._flights.items() if now_s - f.sent_s > FORGET_S]:
            del self._flights[sent_id]
            self.window = 1

    def _room(self) -> bool:
        if not self._flights:
            return True
        budget = max(MIN_BUDGET_BYTES, self.rate_bytes_s * BUDGET_S)
        return len(self._flights) < self.window and self.in_flight_bytes < budget
