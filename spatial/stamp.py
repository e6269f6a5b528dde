"""Time: integer nanoseconds since the Unix epoch, on the clock of the remote site."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from dataclasses import dataclass
from typing import TYPE_CHECKING, Generic, Protocol, TypeVar

from spatial.errors import StampError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

NS_PER_S = 1_000_000_000
NS_PER_MS = 1_000_000

T = TypeVar("T")


class Clock(Protocol):
    """The one source of time, injected everywhere; its implementations live in `wire.clock`."""

    def now_ns(self) -> int:
        """Return the present stamp [ns]."""
        ...


def seconds(duration_ns: float) -> float:
    """Convert a duration [ns] to [s]."""
    return duration_ns / NS_PER_S


def nanoseconds(duration_s: float) -> int:
    """Convert a duration [s] to whole [ns]."""
    return round(duration_s * NS_PER_S)


@dataclass(frozen=True, slots=True, eq=False)
class Stamped(Generic[T]):
    """A value and the instant it was true at."""

    stamp_ns: int
    """Capture stamp [ns]."""
    value: T
    """The value."""


class StampedBuffer(Generic[T]):
    """Values ordered by stamp, bounded by age: late ones are sorted in, repeated ones dropped."""

    def __init__(self, *, name: str, span_ns: int) -> None:
        """Make an empty buffer.

        Args:
            name: what it holds, for error messages.
            span_ns: how far behind the newest stamp a value is kept [ns].
        """
        self._name = name
        self._span_ns = span_ns
        self._stamps: list[int] = []
        self._values: list[T] = []

    def __len__(self) -> int:
        """Return the number of values held."""
        return len(self._stamps)

    def __iter__(self) -> Iterator[Stamped[T]]:
        """Iterate from the oldest to the newest."""
        return (Stamped(s, v) for s, v in zip(self._stamps, self._values, strict=True))

    @property
    def interval_ns(self) -> tuple[int, int] | None:
        """Oldest and newest stamp [ns], `None` when empty."""
        return (self._stamps[0], self._stamps[-1]) if self._stamps else None

    @property
    def newest(self) -> Stamped[T] | None:
        """The value with the largest stamp."""
        return Stamped(self._stamps[-1], self._values[-1]) if self._stamps else None

    def put(self, stamp_ns: int, value: T) -> bool:
        """Insert in order; return False for a stamp already held or older than the span."""
        if not self._stamps or stamp_ns > self._stamps[-1]:
            self._stamps.append(stamp_ns)
            self._values.append(value)
            self._forget()
            return True
        if stamp_ns < self._stamps[-1] - self._span_ns:
            return False
        index = bisect_left(self._stamps, stamp_ns)
        if self._stamps[index] == stamp_ns:
            return False
        self._stamps.insert(index, stamp_ns)
        self._values.insert(index, value)
        return True

    def copy(self) -> StampedBuffer[T]:
        """Return a buffer of its own with the same values, for a reader in another thread."""
        twin: StampedBuffer[T] = StampedBuffer(name=self._name, span_ns=self._span_ns)
        twin._stamps = self._stamps.copy()
        twin._values = self._values.copy()
        return twin

    def clear(self) -> None:
        """Forget everything."""
        self._stamps.clear()
        self._values.clear()

    def at_or_before(self, stamp_ns: int) -> Stamped[T]:
        """Return the newest value that is not younger than `stamp_ns`.

        Raises:
            StampError: everything held is younger, or nothing is held.
        """
        index = bisect_right(self._stamps, stamp_ns) - 1
        if index < 0:
            raise self._error(stamp_ns)
        return Stamped(self._stamps[index], self._values[index])

    def after(self, stamp_ns: int) -> list[Stamped[T]]:
        """Return every value younger than `stamp_ns`, oldest first."""
        start = bisect_right(self._stamps, stamp_ns)
        pairs = zip(self._stamps[start:], self._values[start:], strict=True)
        return [Stamped(s, v) for s, v in pairs]

    def interpolate(self, stamp_ns: int, blend: Callable[[T, T, float], T]) -> T:
        """Return the value at a stamp, blended between its two neighbours.

        Args:
            stamp_ns: instant asked for [ns]; must lie within `interval_ns`.
            blend: `blend(a, b, s)` with s in [0, 1] from a to b.

        Raises:
            StampError: the stamp lies outside; nothing is extrapolated silently.
        """
        index = bisect_left(self._stamps, stamp_ns)
        if index < len(self._stamps) and self._stamps[index] == stamp_ns:
            return self._values[index]
        if index in (0, len(self._stamps)):
            raise self._error(stamp_ns)
        older, younger = self._stamps[index - 1], self._stamps[index]
        share = (stamp_ns - older) / (younger - older)
        return blend(self._values[index - 1], self._values[index], share)

    def _forget(self) -> None:
        limit = self._stamps[-1] - self._span_ns
        if self._stamps[0] < limit:
            keep = bisect_left(self._stamps, limit)
            del self._stamps[:keep]
            del self._values[:keep]

    def _error(self, stamp_ns: int) -> StampError:
        return StampError(self._name, requested_ns=stamp_ns, available_ns=self.interval_ns)
