"""A bounded queue between the thread that receives and the one that reads."""

from __future__ import annotations

from collections import deque
from threading import Condition

from spatial.errors import InputError
from wire.bus import Sample


class Mailbox:
    """Holds the newest `capacity` samples; putting never blocks, what falls out is counted."""

    def __init__(self, *, capacity: int) -> None:
        """Make an empty mailbox.

        Raises:
            InputError: a capacity below one.
        """
        if capacity < 1:
            raise InputError(f"capacity of a subscription is {capacity}, expected at least 1")
        self._samples: deque[Sample] = deque(maxlen=capacity)
        self._changed = Condition()
        self._dropped = 0
        self._closed = False

    @property
    def dropped(self) -> int:
        """Number of samples that fell out unread."""
        return self._dropped

    def put(self, sample: Sample) -> None:
        """Add the newest sample; once closed nothing is added."""
        with self._changed:
            if self._closed:
                return
            if len(self._samples) == self._samples.maxlen:
                self._dropped += 1
            self._samples.append(sample)
            self._changed.notify_all()

    def take(self) -> list[Sample]:
        """Return and remove everything, oldest first."""
        with self._changed:
            taken = list(self._samples)
            self._samples.clear()
            return taken

    def wait(self, timeout_s: float) -> bool:
        """Block until something is here, the box is closed or the time is over."""
        with self._changed:
            self._changed.wait_for(lambda: self._samples or self._closed, timeout_s)
            return bool(self._samples)

    def close(self) -> None:
        """Refuse further samples and wake the reader."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
