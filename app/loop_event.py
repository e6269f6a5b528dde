"""An event that any thread may set: waiters are only ever woken by their own loop.

viser pulses its buffer's `asyncio.Event` from the writing thread and again, through
`call_soon_threadsafe`, from its loop. The first pulse walks the waiters while the loop may add
one: under load the writer dies of "deque mutated during iteration". Here the first pulse raises
the flag and leaves waking to the second.
"""

from __future__ import annotations

import asyncio


class LoopEvent:
    """Stands in for `asyncio.Event` where other threads set it too."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        """Belong to a loop; may be made in any thread."""
        self._loop = loop
        self._flag = False
        self._event = asyncio.Event()

    def is_set(self) -> bool:
        """Return whether it was set since it was last cleared, by whichever thread."""
        return self._flag

    def set(self) -> None:
        """Raise the flag; in the loop's own thread also wake who waits."""
        self._flag = True
        try:
            inside = asyncio.get_running_loop() is self._loop
        except RuntimeError:  # no loop runs in this thread
            inside = False
        if inside:
            self._event.set()

    def clear(self) -> None:
        """Lower the flag; from the loop's thread only."""
        self._flag = False
        self._event.clear()

    async def wait(self) -> bool:
        """Wait until it is set from the loop's thread."""
        return await self._event.wait()
