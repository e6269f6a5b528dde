"""Taps the bus into a file: the bytes as they are, as they come.

Flushed five times a second, so a process killed at once loses the last 0.3 s at most. What comes
faster than the disk takes it is dropped, counted and said.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path
from threading import Event, RLock, Thread
from types import TracebackType
from typing import Self

from spatial.errors import FileInputError, StateError
from spatial.stamp import NS_PER_MS, Clock
from wire.bus import Bus, Sample
from wire.codec_time import EventMark, encode_event
from wire.keys import Keys, is_truth, matches
from wire.mcap_writer import finish, flush, open_writer
from wire.peek import capture_stamp_ns
from wire.schemas import is_json, schema_data

log = logging.getLogger(__name__)

CAPACITY = 20_000
FLUSH_NS = 200 * NS_PER_MS
WAIT_S = 0.05
JOIN_S = 10.0


@dataclass(frozen=True, slots=True)
class RecorderStatus:
    """Where a recording stands."""

    messages: int
    """Messages written."""
    payload_bytes: int
    """Bytes of their payloads."""
    dropped: int
    """Messages lost because the disk was too slow."""
    error: str
    """Why it ended by itself; empty while it runs."""


class Recorder:
    """Records one session; stop it, best by `with`, or the file has no index."""

    def __init__(
        self,
        bus: Bus,
        path: Path,
        *,
        keys: Keys,
        clock: Clock,
        with_truth: bool = False,
        topics: tuple[str, ...] = ("**",),
        overwrite: bool = False,
        capacity: int = CAPACITY,
    ) -> None:
        """Create the file and listen; nothing is written before `start` or `tick`.

        Args:
            bus: what is tapped.
            path: the file.
            keys: the session; topics are keys without it.
            clock: arrival times, on the site's clock so that they compare with stamps.
            with_truth: also record ground truth, as the opaque bytes it is here.
            topics: expressions of the topics wanted.
            overwrite: replace a file that exists.
            capacity: messages that may wait for the disk.

        Raises:
            FileInputError: the file exists or cannot be written.
        """
        self._keys = keys
        self._bus = bus
        self._clock = clock
        self._with_truth = with_truth
        self._topics = topics
        self._path = path
        try:
            self._file = path.open("wb" if overwrite else "xb")
        except OSError as error:
            reason = error.strerror or str(error)
            raise FileInputError(f"cannot record into the file: {reason}", path=path) from error
        self._writer = open_writer(self._file)
        self._writer.add_metadata("telepresence", {"session": keys.session, "site": keys.site})
        self._file.flush()
        self._schemas: dict[str, int] = {}
        self._channels: dict[tuple[str, str], int] = {}
        self._counts: dict[int, int] = {}
        self._lock = RLock()
        self._last_ns = 0
        self._next_flush_ns = 0
        self._messages = self._bytes = 0
        self._error = ""
        self._finished = False
        self._stop = Event()
        self._thread: Thread | None = None
        self._subscription = bus.subscribe(keys.all, capacity=capacity, latched=True)

    @property
    def status(self) -> RecorderStatus:
        """Where it stands."""
        return RecorderStatus(self._messages, self._bytes, self._subscription.dropped, self._error)

    def start(self) -> None:
        """Record from a thread of its own until `stop`."""
        if self._thread is None:
            self._thread = Thread(target=self._run, name="recorder", daemon=True)
            self._thread.start()

    def tick(self) -> None:
        """Write everything that has come, and flush when it is time."""
        samples = self._subscription.take()
        with self._lock:
            if self._finished or self._error:
                return
            try:
                for sample in samples:
                    self._write(sample)
                if self._clock.now_ns() >= self._next_flush_ns:
                    flush(self._writer)
                    self._next_flush_ns = self._clock.now_ns() + FLUSH_NS
            except OSError as error:
                self._error = f"recording ended: {error.strerror or error}"
                log.error("%s (%s)", self._error, self._path)  # noqa: TRY400  # no traceback

    def attach(self, name: str, data: bytes, *, media_type: str = "text/plain") -> None:
        """Put a file into the recording: the site, the objects, a report.

        Raises:
            StateError: the recording has ended.
        """
        with self._lock:
            self._refuse_when_over()
            now_ns = self._now_ns()
            flush(self._writer)
            self._writer.add_attachment(now_ns, now_ns, name, media_type, data)
            self._file.flush()

    def mark(self, name: str, text: str = "") -> None:
        """Mark this instant, for everybody on the bus; it comes back into the recording.

        Raises:
            StateError: the recording has ended.
        """
        self._refuse_when_over()
        encoded = encode_event(EventMark(self._clock.now_ns(), name, text))
        self._bus.publish(self._keys.events, encoded.payload, schema=encoded.schema)

    def stop(self) -> RecorderStatus:
        """Write what is pending, then the index; safe to call twice."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join(JOIN_S)
        self.tick()
        self._subscription.close()
        with self._lock:
            if not self._finished:
                self._finished = True
                self._finish()
        return self.status

    def __enter__(self) -> Self:
        """Start and return itself."""
        self.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop."""
        self.stop()

    def _run(self) -> None:
        while not self._stop.is_set() and not self._error:
            self._subscription.wait(WAIT_S)
            self.tick()

    def _write(self, sample: Sample) -> None:
        topic = self._keys.topic(sample.key)
        if topic is None or (is_truth(topic) and not self._with_truth):
            return
        if not any(matches(pattern, topic) for pattern in self._topics):
            return
        log_ns = self._now_ns()
        channel = self._channel(topic, sample.schema)
        self._counts[channel] += 1
        self._writer.add_message(
            channel_id=channel,
            log_time=log_ns,
            data=sample.payload,
            publish_time=capture_stamp_ns(sample.payload, sample.schema) or log_ns,
            sequence=self._counts[channel] & 0xFFFFFFFF,
        )
        self._messages += 1
        self._bytes += len(sample.payload)

    def _channel(self, topic: str, schema: str) -> int:
        channel = self._channels.get((topic, schema))
        if channel is None:
            if schema not in self._schemas:
                self._schemas[schema] = self._writer.register_schema(schema, *schema_data(schema))
            channel = self._writer.register_channel(
                topic, "json" if is_json(schema) else "protobuf", self._schemas[schema]
            )
            self._channels[topic, schema] = channel
            self._counts[channel] = 0
        return channel

    def _now_ns(self) -> int:
        """Return the arrival time [ns], never less than the one before."""
        self._last_ns = max(self._last_ns, self._clock.now_ns(), 0)
        return self._last_ns

    def _finish(self) -> None:
        try:
            finish(self._writer)
            self._file.close()
        except OSError as error:
            self._error = self._error or f"recording has no index: {error.strerror or error}"
            log.error("%s (%s)", self._error, self._path)  # noqa: TRY400  # no traceback

    def _refuse_when_over(self) -> None:
        if self._finished or self._error:
            raise StateError(self._error or "the recording has ended")
