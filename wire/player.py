"""Puts a recording back on the bus: the same bytes, under a session of its own.

    position = anchor + speed (t - t_anchor),   t monotonic

Everything recorded up to the position has been published; after a jump the last message of every
topic before it is published first, so that who looks sees the state of that instant. The playback
clock goes out on `Keys.clock` and is the source of time. Commands are never published, nor truth.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Event, RLock, Thread
from types import TracebackType
from typing import Self

from spatial.errors import FileInputError, InputError, unknown
from spatial.stamp import NS_PER_MS, NS_PER_S
from wire.bus import Bus, Qos
from wire.codec_time import PlaybackState, encode_playback
from wire.keys import Keys, is_command, is_truth, matches, qos_of
from wire.recording import Recorded, Recording

log = logging.getLogger(__name__)

SPEEDS = (0.1, 8.0)
LOOK_BACK_NS = 2 * NS_PER_S
"""A stream silent for longer shows nothing after a jump, as it did then."""
CLOCK_PERIOD_NS = 20 * NS_PER_MS
TICK_S = 0.005
JOIN_S = 5.0
_CLOCK_TOPIC = "*/clock"


class Player:
    """Plays one recording in one session; close it, best by `with`."""

    def __init__(
        self,
        path: Path,
        bus: Bus,
        *,
        keys: Keys,
        topics: tuple[str, ...] = ("**",),
        remap: dict[str, str] | None = None,
        loop: bool = False,
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """Open it, paused at its start; `start` or `tick` moves it.

        Args:
            path: the recording.
            bus: where it is played.
            keys: session and site; the session must begin with `replay`.
            topics: expressions of the topics wanted.
            remap: new topics by recorded topic.
            loop: start again at the end instead of pausing there.
            monotonic_ns: local time that drives it [ns].

        Raises:
            FileInputError: not a whole recording, or nothing to play inside.
            InputError: a session that could be taken for a live one, or a new topic that could
                move a robot.
        """
        if not keys.session.startswith("replay"):
            raise InputError(f"session {keys.session!r} of a playback must begin with 'replay'")
        self._recording = Recording(path)
        try:
            self._key_of = _keys_of(self._recording, topics, keys=keys, remap=remap or {})
        except InputError:
            self._recording.close()
            raise
        self._topics = list(self._key_of)
        self._bus = bus
        self._keys = keys
        self._monotonic_ns = monotonic_ns
        self._first_ns, self._last_ns = self._range_ns = self._recording.interval_ns
        self._loop = loop
        self._lock = RLock()
        self._speed = 1.0
        self._playing = False
        self._jumps = 0
        self._anchor_ns = self._first_ns
        self._anchored_ns = monotonic_ns()
        self._coming: Iterator[Recorded] = iter(())
        self._next: Recorded | None = None
        self._next_clock_ns = 0
        self._jump_ns: int | None = self._first_ns
        self._stop = Event()
        self._thread: Thread | None = None

    @property
    def state(self) -> PlaybackState:
        """Where it stands."""
        with self._lock:
            return PlaybackState(
                stamp_ns=max(1, self._position_ns()),
                speed=self._speed,
                playing=self._playing,
                first_ns=self._first_ns,
                last_ns=self._last_ns,
                jumps=self._jumps,
            )

    @property
    def topics(self) -> list[str]:
        """Topics it plays."""
        return list(self._topics)

    def play(self) -> None:
        """Go on; at the end, from the start."""
        with self._lock:
            if self._position_ns() >= self._range_ns[1]:
                self.seek(self._range_ns[0])
            self._anchor(playing=True)

    def pause(self) -> None:
        """Stand still."""
        with self._lock:
            self._anchor(playing=False)

    def seek(self, stamp_ns: int) -> None:
        """Jump to an instant [ns] of the recording; beyond its ends, to the end."""
        with self._lock:
            low, high = self._range_ns
            self._jump_ns = min(max(stamp_ns, low), high)
            self._anchor_ns = self._jump_ns
            self._anchored_ns = self._monotonic_ns()

    def set_speed(self, speed: float) -> None:
        """Set recorded seconds per second.

        Raises:
            InputError: outside 0.1 to 8.
        """
        if not SPEEDS[0] <= speed <= SPEEDS[1]:
            raise InputError(f"speed {speed}, expected {SPEEDS[0]} to {SPEEDS[1]}")
        with self._lock:
            self._anchor(playing=self._playing)
            self._speed = speed

    def set_loop(self, *, loop: bool, range_ns: tuple[int, int] | None = None) -> None:
        """Repeat, the whole recording or a part of it.

        Args:
            loop: whether to repeat.
            range_ns: the part [ns]; all of it without.

        Raises:
            InputError: the part is empty or lies outside the recording.
        """
        low, high = range_ns or (self._first_ns, self._last_ns)
        if range_ns and not self._first_ns <= low < high <= self._last_ns:
            held = f"{self._first_ns} to {self._last_ns} ns"
            raise InputError(f"loop from {low} to {high} ns, the recording holds {held}")
        with self._lock:
            self._loop = loop
            self._range_ns = (low, high)

    def start(self) -> None:
        """Play from a thread of its own until `close`."""
        if self._thread is None:
            self._thread = Thread(target=self._run, name="player", daemon=True)
            self._thread.start()

    def tick(self) -> None:
        """Publish everything up to the position, and the clock when it is time."""
        with self._lock:
            if self._jump_ns is not None:
                self._arrive(self._jump_ns)
            position_ns = min(self._position_ns(), self._range_ns[1])
            while self._next is not None and self._next.log_ns <= position_ns:
                self._publish(self._next)
                self._next = next(self._coming, None)
            if self._playing and position_ns >= self._range_ns[1]:
                self._end()
            if self._monotonic_ns() >= self._next_clock_ns:
                self._publish_clock()

    def close(self) -> None:
        """Stop and close the file; safe to call twice."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join(JOIN_S)
        with self._lock:
            self._recording.close()

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
        """Close."""
        self.close()

    def _run(self) -> None:
        while not self._stop.is_set():
            try:
                self.tick()
            except FileInputError:
                log.exception("playback ended")
                return
            self._stop.wait(TICK_S)

    def _position_ns(self) -> int:
        if not self._playing:
            return self._anchor_ns
        passed_ns = self._monotonic_ns() - self._anchored_ns
        return min(self._anchor_ns + math.floor(self._speed * passed_ns), self._range_ns[1])

    def _anchor(self, *, playing: bool) -> None:
        """Take the present position as the start of what comes."""
        self._anchor_ns = self._position_ns()
        self._anchored_ns = self._monotonic_ns()
        self._playing = playing
        self._next_clock_ns = 0

    def _arrive(self, stamp_ns: int) -> None:
        """Show the state of an instant: the clock first, so that nothing looks old."""
        self._jump_ns = None
        self._anchor_ns, self._anchored_ns = stamp_ns, self._monotonic_ns()
        self._jumps += 1
        self._publish_clock()
        for recorded in sorted(self._state_at(stamp_ns), key=lambda entry: entry.log_ns):
            self._publish(recorded)
        self._coming = self._recording.iterate(topics=self._topics, after_ns=stamp_ns)
        self._next = next(self._coming, None)
        self._anchored_ns = self._monotonic_ns()  # what reading took is not played over

    def _state_at(self, stamp_ns: int) -> Iterator[Recorded]:
        for topic in self._topics:
            within_ns = None if qos_of(topic) is Qos.LATCHED else LOOK_BACK_NS
            last = self._recording.last_before(topic, stamp_ns, within_ns=within_ns)
            if last is not None:
                yield last

    def _end(self) -> None:
        if self._loop:
            self.seek(self._range_ns[0])
        else:
            self._anchor(playing=False)

    def _publish(self, recorded: Recorded) -> None:
        self._bus.publish(
            self._key_of[recorded.topic],
            recorded.payload,
            schema=recorded.schema,
            qos=qos_of(recorded.topic),
        )

    def _publish_clock(self) -> None:
        encoded = encode_playback(self.state)
        self._bus.publish(self._keys.clock, encoded.payload, schema=encoded.schema)
        self._next_clock_ns = self._monotonic_ns() + CLOCK_PERIOD_NS


def _playable(topic: str, wanted: tuple[str, ...]) -> bool:
    if is_command(topic) or is_truth(topic) or matches(_CLOCK_TOPIC, topic):
        return False
    return any(matches(pattern, topic) for pattern in wanted)


def _keys_of(
    recording: Recording, wanted: tuple[str, ...], *, keys: Keys, remap: dict[str, str]
) -> dict[str, str]:
    """Return the key of every topic that is played."""
    topics = [topic for topic in recording.topics if _playable(topic, wanted)]
    if not topics:
        raise FileInputError("nothing to play in the recording", path=recording.path)
    for old, new in remap.items():
        if old not in topics:
            raise InputError(unknown("topic", old, topics))
        if not _playable(new, ("**",)):
            raise InputError(f"topic {new!r} is never played: a replay moves no robot")
    return {topic: keys.of_topic(remap.get(topic, topic)) for topic in topics}
