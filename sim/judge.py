"""The process that compares the tracker with the truth while both are on the bus.

It and the recorder are the only ones that hear `truth/**`; nothing it finds goes back to the bus.
"""

from __future__ import annotations

import logging
from threading import Event
from typing import Any

from sim.metrics import Metrics
from sim.truth import decode_truth
from spatial.errors import MessageError
from spatial.stamp import Clock
from wire.bus import Bus
from wire.codec import decode_tracked
from wire.keys import Keys

log = logging.getLogger(__name__)

CAPACITY = 1024
"""Messages kept for it, five seconds' worth."""
PAUSE_S = 0.05
"""It looks up this often [s]."""


class Judge:
    """Feeds `Metrics` from the bus; `tick` it from a thread or in lock-step."""

    def __init__(self, bus: Bus, *, keys: Keys, clock: Clock) -> None:
        """Listen.

        Args:
            bus: the bus.
            keys: names of site and session.
            clock: the site's clock, as a station knows it.
        """
        self._clock = clock
        self._truth = bus.subscribe(keys.all_truth, capacity=CAPACITY)
        self._tracked = bus.subscribe(keys.tracked, capacity=CAPACITY)
        self._metrics = Metrics()
        self.refused = 0

    def tick(self, now_ns: int) -> None:
        """Take what has come by `now_ns` [ns]."""
        for sample in self._truth.take():
            try:
                self._metrics.put_truth(decode_truth(sample.payload))
            except MessageError:
                self._refuse()
        for sample in self._tracked.take():
            try:
                self._metrics.put_tracked(decode_tracked(sample.payload), arrival_ns=now_ns)
            except MessageError:
                self._refuse()

    def figures(self) -> dict[str, Any]:
        """Return the figures of `demo` so far; see `Metrics.figures`."""
        dropped = self._truth.dropped + self._tracked.dropped
        return {**self._metrics.figures(), "refused": self.refused, "unheard": dropped}

    def serve(self, stop: Event) -> dict[str, Any]:
        """Compare until told to stop; return the figures."""
        while not stop.is_set():
            self.tick(self._clock.now_ns())
            stop.wait(PAUSE_S)
        self.tick(self._clock.now_ns())
        return self.figures()

    def _refuse(self) -> None:
        self.refused += 1
        log.debug("message refused")
