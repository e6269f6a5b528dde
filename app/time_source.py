"""Where T* comes from: the site's clock live, the player's in a recording."""

from __future__ import annotations

from threading import Event

from spatial.stamp import NS_PER_MS, Clock
from wire.bus import Bus
from wire.clock import ReplayClock, SiteClock, SystemClock
from wire.keys import Keys

FOLLOW_S = 0.05


class TimeSource:
    """The clock of the session shown, live or replayed."""

    def __init__(self, bus: Bus, keys: Keys, *, mode: str, replay: bool) -> None:
        """Choose the source of time."""
        self.site = None if replay else SiteClock(bus, keys=keys, local=SystemClock(), mode=mode)
        self.replay = ReplayClock(bus.subscribe(keys.clock, capacity=64)) if replay else None

    @property
    def clock(self) -> Clock:
        """The source of T*."""
        clock = self.site or self.replay
        assert clock is not None
        return clock

    def tick(self) -> None:
        """Ask the site for its time, where that is how it is known."""
        if self.site is not None:
            self.site.tick()

    def follow(self, stop: Event) -> None:
        """Keep asking until told to stop; run it in a thread where nothing else ticks."""
        while not stop.wait(FOLLOW_S):
            self.tick()

    @property
    def bound_ms(self) -> float | None:
        """How far T* may be wrong [ms]; `None` when it cannot be, or is not known."""
        bound_ns = self.site.bound_ns if self.site is not None else 0
        return None if not bound_ns else bound_ns / NS_PER_MS
