"""The bus: one process publishes bytes under a key, any number take them, none can stop another.

`wire.zenoh_bus` carries it between processes, `wire.memory_bus` within one.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from types import TracebackType
from typing import Protocol, Self


class Qos(Enum):
    """How a message competes with others and who sees it."""

    STATE = "state"
    """Poses, joints, commands: first on the link, dropped rather than late."""
    IMAGE = "image"
    """Behind everything else; waits for the link instead of filling its buffers."""
    LATCHED = "latched"
    """Kept: a subscriber that comes later gets the last one of each key."""


@dataclass(frozen=True, slots=True)
class Sample:
    """One message as it came from the bus."""

    key: str
    """Key it was published on, with its session."""
    payload: bytes
    """Bytes of the message."""
    schema: str
    """Full name of its schema."""


class Subscription(Protocol):
    """A bounded queue of what arrives; when full the oldest is dropped and counted."""

    @property
    def dropped(self) -> int:
        """Number of messages dropped because nobody took them in time."""
        ...

    def take(self) -> list[Sample]:
        """Return everything pending, oldest first, and never block."""
        ...

    def wait(self, timeout_s: float) -> bool:
        """Block until something is pending or the time is over; return whether it is."""
        ...

    def close(self) -> None:
        """Stop receiving; what is pending can still be taken."""
        ...


class Bus(Protocol):
    """A connection to everybody else; close it, best by `with`."""

    def publish(self, key: str, payload: bytes, *, schema: str, qos: Qos = Qos.STATE) -> None:
        """Send bytes to every subscriber of the key.

        Raises:
            InputError: the key has wildcards or characters that keys do not have.
            StateError: the bus is closed.
        """
        ...

    def subscribe(self, key_expr: str, *, capacity: int, latched: bool = False) -> Subscription:
        """Receive what is published on an expression with `*` and `**`.

        Args:
            key_expr: the expression.
            capacity: number of messages kept for the reader; 1 means newest wins.
            latched: also get the last message of every matching latched key.

        Raises:
            InputError: a bad expression, or a capacity below one.
            StateError: the bus is closed.
        """
        ...

    def close(self) -> None:
        """End every subscription and leave; safe to call twice."""
        ...

    def __enter__(self) -> Self:
        """Return itself."""
        ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close."""
        ...
