"""Seeded output stage of the site: delays, jitters, loses and reorders, and never touches a stamp.

    due = captured + max(0, delay + jitter n),   n ~ N(0, 1) cut at 3

A stream without `reorder` is a stream over TCP: a late message holds back those behind it. Each
stream draws its own random numbers, so the order in which streams are fed changes nothing.
"""

from __future__ import annotations

import heapq
import threading
import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from spatial.errors import InputError
from spatial.stamp import NS_PER_MS

CUT = 3.0
"""Jitter is cut at this many standard deviations."""


@dataclass(frozen=True, slots=True)
class StreamDelay:
    """What the way from sensor to bus does to one stream."""

    delay_ms: float = 0.0
    """Mean time from capture to arrival [ms]."""
    jitter_ms: float = 0.0
    """Standard deviation of that time [ms]."""
    loss: float = 0.0
    """Share of messages lost, 0 to 1."""
    reorder: bool = False
    """Whether a late message may be overtaken."""

    def __post_init__(self) -> None:
        """Refuse what cannot be.

        Raises:
            InputError: a time that is negative or not finite, or a share outside 0 to 1.
        """
        times = (self.delay_ms, self.jitter_ms)
        if not all(0.0 <= t < float("inf") for t in times):
            msg = f"delay_ms and jitter_ms must be finite and not negative, got {times}"
            raise InputError(msg)
        if not 0.0 <= self.loss <= 1.0:
            msg = f"loss must lie in 0 to 1, got {self.loss}"
            raise InputError(msg)


@dataclass(frozen=True, slots=True, order=True)
class Outgoing:
    """A message on its way out."""

    due_ns: int
    """When it arrives, on the site's clock [ns]."""
    order: int
    """Breaks ties: messages of equal `due_ns` leave in the order they were put."""
    key: str = field(compare=False)
    """Key on the bus."""
    payload: bytes = field(compare=False)
    """Encoded message."""
    schema: str = field(compare=False)
    """Name of its schema."""
    stream: str = field(compare=False)
    """Stream it belongs to."""


Sink = Callable[[Outgoing], None]
"""Takes a message that is due."""


@dataclass(slots=True)
class _Stream:
    shape: StreamDelay
    rng: np.random.Generator
    last_due_ns: int = 0


class Outlet:
    """Holds messages back until they are due; safe to feed from several threads."""

    def __init__(self, streams: Mapping[str, StreamDelay], *, seed: int, sink: Sink) -> None:
        """Make an empty stage.

        Args:
            streams: delay of each stream by name; a stream not named passes at once.
            seed: seeds every random number.
            sink: takes each message when it is due, called by `flush` in order of `due_ns`.
        """
        self._shapes = dict(streams)
        self._seed = seed
        self._sink = sink
        self._streams: dict[str, _Stream] = {}
        self._heap: list[Outgoing] = []
        self._count = 0
        self._lost = 0
        self._lock = threading.Lock()

    @property
    def lost(self) -> int:
        """Messages lost on purpose so far."""
        return self._lost

    def put(self, stream: str, *, key: str, payload: bytes, schema: str, captured_ns: int) -> None:
        """Take a message captured at `captured_ns` [ns]; it leaves with a later `flush`."""
        with self._lock:
            state = self._stream(stream)
            shape = state.shape
            jitter = min(max(float(state.rng.standard_normal()), -CUT), CUT) * shape.jitter_ms
            lost = float(state.rng.random()) < shape.loss
            if lost:
                self._lost += 1
                return
            due_ns = captured_ns + round(max(0.0, shape.delay_ms + jitter) * NS_PER_MS)
            if not shape.reorder:
                due_ns = max(due_ns, state.last_due_ns)
                state.last_due_ns = due_ns
            self._count += 1
            message = Outgoing(due_ns, self._count, key, payload, schema, stream)
            heapq.heappush(self._heap, message)

    def flush(self, now_ns: int) -> int:
        """Hand every message due by `now_ns` to the sink, in order; return how many."""
        due: list[Outgoing] = []
        with self._lock:
            while self._heap and self._heap[0].due_ns <= now_ns:
                due.append(heapq.heappop(self._heap))
        for message in due:
            self._sink(message)
        return len(due)

    @property
    def next_due_ns(self) -> int | None:
        """When the next message is due [ns], `None` when none waits."""
        with self._lock:
            return self._heap[0].due_ns if self._heap else None

    def _stream(self, name: str) -> _Stream:
        if name not in self._streams:
            rng = np.random.default_rng((self._seed, zlib.crc32(name.encode())))
            self._streams[name] = _Stream(self._shapes.get(name, StreamDelay()), rng)
        return self._streams[name]
