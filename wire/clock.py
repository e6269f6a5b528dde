"""Every clock of the project; the protocol is `spatial.stamp.Clock`.

Stamps are of the site's clock. A station's own clock may be off by a minute and drift; `SiteClock`
asks the site over the bus and states how far it may be wrong.
"""

from __future__ import annotations

import logging
import random
import time
from collections.abc import Callable
from threading import Event, RLock

from spatial.errors import InputError, MessageError, StateError
from spatial.stamp import NS_PER_MS, NS_PER_S, Clock
from wire.bus import Bus, Qos, Subscription
from wire.clock_offset import Estimate, OffsetEstimator, RoundTrip
from wire.codec_time import (
    PLAYBACK_SCHEMA,
    PROBE_SCHEMA,
    ClockProbe,
    PlaybackState,
    decode_playback,
    decode_probe,
    encode_probe,
)
from wire.keys import Keys

log = logging.getLogger(__name__)

CLOCK_MODES = ("shared", "ptp", "measured")
LOCKSTEP_EPOCH_NS = 1_700_000_000 * NS_PER_S
"""Where lock-step time starts."""
PTP_BOUND_NS = NS_PER_MS
FAST_PROBES = 20
FAST_PERIOD_NS = 50 * NS_PER_MS
SLOW_PERIOD_NS = 500 * NS_PER_MS
STEP_NS = 100 * NS_PER_MS
PROBE_CAPACITY = 256
WAIT_S = 0.05


class SystemClock:
    """The machine's clock; when that is set back, it goes on without a step."""

    def __init__(
        self,
        *,
        wall_ns: Callable[[], int] = time.time_ns,
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """Start at the wall clock.

        Args:
            wall_ns: nanoseconds since the Unix epoch; may be set by somebody.
            monotonic_ns: nanoseconds of a clock nobody sets.
        """
        self._wall_ns = wall_ns
        self._monotonic_ns = monotonic_ns
        self._lock = RLock()
        self._last_ns = wall_ns()
        self._last_monotonic_ns = monotonic_ns()

    def now_ns(self) -> int:
        """Return the present stamp [ns], never less than before."""
        with self._lock:
            wall, monotonic = self._wall_ns(), self._monotonic_ns()
            if wall < self._last_ns:
                wall = self._last_ns + monotonic - self._last_monotonic_ns
            self._last_ns, self._last_monotonic_ns = wall, monotonic
            return wall


class VirtualClock:
    """Time that moves only when told, for lock-step and tests."""

    def __init__(self, start_ns: int = LOCKSTEP_EPOCH_NS) -> None:
        """Stand still at a stamp [ns]."""
        self._now_ns = start_ns

    def now_ns(self) -> int:
        """Return the present stamp [ns]."""
        return self._now_ns

    def advance(self, duration_ns: int) -> None:
        """Move on.

        Raises:
            InputError: a negative duration.
        """
        self.set(self._now_ns + duration_ns)

    def set(self, stamp_ns: int) -> None:
        """Move to a stamp [ns].

        Raises:
            InputError: it lies before the present one.
        """
        if stamp_ns < self._now_ns:
            raise InputError(f"virtual time can not go back by {self._now_ns - stamp_ns} ns")
        self._now_ns = stamp_ns


class SkewedClock:
    """A clock that is wrong on purpose: off by a constant and running too fast or slow."""

    def __init__(self, base: Clock, *, offset_ns: int = 0, skew_ppm: float = 0.0) -> None:
        """Read another clock wrongly.

        Args:
            base: the clock it is derived from.
            offset_ns: how far it is ahead at the start [ns].
            skew_ppm: how much faster it runs, in parts per million.
        """
        self._base = base
        self._start_ns = base.now_ns()
        self._offset_ns = offset_ns
        self._skew = skew_ppm * 1e-6

    def now_ns(self) -> int:
        """Return the present stamp [ns] of the wrong clock."""
        now_ns = self._base.now_ns()
        return now_ns + self._offset_ns + round(self._skew * (now_ns - self._start_ns))


class ReplayClock:
    """Time of a playback, read from the bus; between two messages it runs at their speed."""

    def __init__(
        self,
        subscription: Subscription,
        *,
        start_ns: int = 1,
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        """Follow a playback.

        Args:
            subscription: of the session's `Keys.clock`.
            start_ns: stamp before the first message [ns].
            monotonic_ns: local clock that carries the time between two messages.
        """
        self._subscription = subscription
        self._monotonic_ns = monotonic_ns
        self._state: PlaybackState | None = None
        self._heard_ns = 0
        self._last_ns = start_ns
        self._lock = RLock()
        self.refused = 0

    @property
    def state(self) -> PlaybackState | None:
        """Newest message of the player, `None` before the first."""
        with self._lock:
            self._listen()
            return self._state

    def now_ns(self) -> int:
        """Return the instant shown [ns]; it goes back only where the player jumped back."""
        with self._lock:
            self._listen()
            if self._state is not None:
                self._last_ns = max(self._last_ns, self._carried_ns(self._state))
            return self._last_ns

    def _listen(self) -> None:
        for sample in self._subscription.take():
            if sample.schema != PLAYBACK_SCHEMA:
                continue
            try:
                self._follow(decode_playback(sample.payload))
            except MessageError:
                self.refused += 1
                log.debug("playback clock refused", exc_info=True)

    def _follow(self, state: PlaybackState) -> None:
        """Anchor on a message, unless an older one of the same run came with less delay."""
        if (known := self._state) is None or state.jumps != known.jumps:
            self._last_ns = state.stamp_ns
        elif (state.speed, state.playing) == (known.speed, known.playing):
            behind_ns = self._carried_ns(known) - state.stamp_ns
            if 0 <= behind_ns < STEP_NS:
                return
        self._state = state
        self._heard_ns = self._monotonic_ns()

    def _carried_ns(self, state: PlaybackState) -> int:
        passed = self._monotonic_ns() - self._heard_ns if state.playing else 0
        return min(state.stamp_ns + round(state.speed * passed), state.last_ns)


class ClockResponder:
    """The site's side: answers probes with its own clock."""

    def __init__(self, bus: Bus, *, keys: Keys, clock: Clock) -> None:
        """Listen for questions on `Keys.clock`.

        Args:
            bus: the bus.
            keys: names of the site.
            clock: the site's clock.
        """
        self._bus = bus
        self._key = keys.clock
        self._clock = clock
        self._subscription = bus.subscribe(keys.clock, capacity=PROBE_CAPACITY)
        self.refused = 0

    def tick(self) -> None:
        """Answer every question that has come."""
        for sample in self._subscription.take():
            if sample.schema != PROBE_SCHEMA:
                continue
            heard_ns = self._clock.now_ns()
            try:
                probe = decode_probe(sample.payload)
            except MessageError:
                self.refused += 1
                log.debug("clock probe refused", exc_info=True)
                continue
            if not probe.is_answer:
                self._answer(probe, heard_ns)

    def serve(self, stop: Event) -> None:
        """Answer until told to stop; run it in a thread of its own."""
        while not stop.is_set():
            self._subscription.wait(WAIT_S)
            self.tick()

    def _answer(self, probe: ClockProbe, heard_ns: int) -> None:
        now_ns = max(self._clock.now_ns(), heard_ns)
        answer = ClockProbe(probe.asker, probe.sequence, probe.asked_ns, heard_ns, now_ns)
        encoded = encode_probe(answer)
        self._bus.publish(self._key, encoded.payload, schema=encoded.schema, qos=Qos.STATE)


class SiteClock:
    """The site's clock as a station knows it."""

    def __init__(
        self,
        bus: Bus,
        *,
        keys: Keys,
        local: Clock,
        mode: str = "measured",
        asker: int | None = None,
    ) -> None:
        """Take time from the site.

        Args:
            bus: the bus.
            keys: names of the site.
            local: this machine's clock.
            mode: `shared` (same machine), `ptp` (disciplined to one master within 1 ms) or
                `measured` (asked over the bus).
            asker: number of this asker, random without one.

        Raises:
            InputError: another mode.
        """
        if mode not in CLOCK_MODES:
            raise InputError(f"clock mode {mode!r}, expected one of {', '.join(CLOCK_MODES)}")
        self._bus = bus
        self._key = keys.clock
        self._local = local
        self._mode = mode
        self._asker = asker or random.getrandbits(63) | 1
        self._lock = RLock()
        self._estimator = OffsetEstimator()
        self._sequence = 0
        self._next_probe_ns = local.now_ns()
        self._last_ns = 0
        self._subscription = (
            bus.subscribe(keys.clock, capacity=PROBE_CAPACITY) if mode == "measured" else None
        )
        self.refused = 0

    @property
    def mode(self) -> str:
        """How the time is known: `shared`, `ptp` or `measured`."""
        return self._mode

    @property
    def estimate(self) -> Estimate | None:
        """Offset, skew and bound of `measured`; `None` before the first answer."""
        return self._estimator.estimate

    @property
    def bound_ns(self) -> int | None:
        """How far the time may be wrong [ns]; `None` when that is not known."""
        if self._mode != "measured":
            return PTP_BOUND_NS if self._mode == "ptp" else 0
        estimate = self._estimator.estimate
        return None if estimate is None else estimate.bound_at(self._local.now_ns())

    def now_ns(self) -> int:
        """Return the site's time [ns]; before the first answer the local one.

        Small corrections never turn it back; another clock at the site, more than 100 ms away,
        is followed at once.
        """
        local_ns = self._local.now_ns()
        estimate = self._estimator.estimate
        now_ns = local_ns if estimate is None else local_ns + estimate.offset_at(local_ns)
        with self._lock:
            if 0 < self._last_ns - now_ns < STEP_NS:
                return self._last_ns
            self._last_ns = now_ns
            return now_ns

    def tick(self) -> None:
        """Take answers in and ask when it is time."""
        if self._subscription is None:
            return
        for sample in self._subscription.take():
            arrived_ns = self._local.now_ns()
            if sample.schema == PROBE_SCHEMA:
                self._hear(sample.payload, arrived_ns)
        now_ns = self._local.now_ns()
        if now_ns >= self._next_probe_ns:
            self._ask(now_ns)

    def follow(self, stop: Event) -> None:
        """Ask and listen until told to stop; run it in a thread of its own.

        Raises:
            StateError: the mode asks nobody.
        """
        if self._subscription is None:
            raise StateError(f"clock mode {self._mode!r} has nothing to follow")
        while not stop.is_set():
            self.tick()
            self._subscription.wait(WAIT_S)

    def _ask(self, now_ns: int) -> None:
        self._sequence += 1
        fast = self._sequence < FAST_PROBES or self._estimator.estimate is None
        self._next_probe_ns = now_ns + (FAST_PERIOD_NS if fast else SLOW_PERIOD_NS)
        encoded = encode_probe(ClockProbe(self._asker, self._sequence, self._local.now_ns()))
        self._bus.publish(self._key, encoded.payload, schema=encoded.schema, qos=Qos.STATE)

    def _hear(self, payload: bytes, arrived_ns: int) -> None:
        try:
            probe = decode_probe(payload)
        except MessageError:
            self.refused += 1
            log.debug("clock answer refused", exc_info=True)
            return
        if probe.asker != self._asker or not probe.is_answer:
            return
        there = probe.heard_ns - probe.asked_ns
        back = probe.answered_ns - arrived_ns
        trip = RoundTrip(
            local_ns=(probe.asked_ns + arrived_ns) // 2,
            offset_ns=(there + back) // 2,
            round_trip_ns=there - back,
        )
        self._estimator.put(trip)
