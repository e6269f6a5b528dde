"""The bus within one process, and a link between two such buses that behaves badly on purpose.

Everything is done inside `publish`, `take` and `wait`, by the caller's thread and the injected
clock, so lock-step runs are reproducible: same seed and same calls, same deliveries.
"""

from __future__ import annotations

import heapq
import random
import time
from dataclasses import dataclass
from threading import RLock
from types import TracebackType
from typing import Self

from spatial.errors import InputError, StateError
from spatial.stamp import NS_PER_S, Clock
from wire.bus import Qos, Sample, Subscription
from wire.keys import checked_expression, checked_key, matches
from wire.mailbox import Mailbox

LINK_POLL_S = 0.005


@dataclass(frozen=True, slots=True)
class LinkShim:
    """How one direction of a link delays, reorders and drops."""

    seed: int = 0
    """Seed of its random numbers."""
    delay_ns: int = 0
    """Least time under way [ns]."""
    jitter_ns: int = 0
    """Added time, uniform from zero to this [ns]; the order is kept."""
    loss: float = 0.0
    """Share of messages lost; latched ones never are, they are sent again."""
    reorder: float = 0.0
    """Share of messages that take a detour while later ones pass them."""
    detour_ns: int = 0
    """Added time of a detour [ns]."""

    def __post_init__(self) -> None:
        """Refuse negative times and shares outside 0 to 1.

        Raises:
            InputError: such a value.
        """
        times = (self.delay_ns, self.jitter_ns, self.detour_ns)
        if min(times) < 0 or not (0 <= self.loss <= 1 and 0 <= self.reorder <= 1):
            raise InputError(f"link with negative times or shares outside 0 to 1: {self}")


class _Direction:
    """Messages under way in one direction."""

    def __init__(self, shim: LinkShim, clock: Clock) -> None:
        self._shim = shim
        self._clock = clock
        self._random = random.Random(shim.seed)
        self._under_way: list[tuple[int, int, Sample, Qos]] = []
        self._sent = 0
        self._last_due_ns = 0
        self._lock = RLock()
        self.lost = 0

    def push(self, sample: Sample, qos: Qos) -> None:
        """Send one message; the draws are the same whatever becomes of it."""
        shim = self._shim
        with self._lock:
            lost, jitter, detour = (self._random.random() for _ in range(3))
            if qos is not Qos.LATCHED and lost < shim.loss:
                self.lost += 1
                return
            due_ns = self._clock.now_ns() + shim.delay_ns + int(jitter * shim.jitter_ns)
            if qos is not Qos.LATCHED and detour < shim.reorder:
                due_ns += shim.detour_ns
            else:
                due_ns = self._last_due_ns = max(due_ns, self._last_due_ns)
            self._sent += 1
            heapq.heappush(self._under_way, (due_ns, self._sent, sample, qos))

    def due(self) -> list[tuple[Sample, Qos]]:
        """Return what has arrived by now."""
        arrived = []
        with self._lock:
            now_ns = self._clock.now_ns() if self._under_way else 0
            while self._under_way and self._under_way[0][0] <= now_ns:
                arrived.append(heapq.heappop(self._under_way)[2:])
        return arrived


class MemoryLink:
    """Joins two buses: what is published on one arrives on the other, each way shimmed apart."""

    def __init__(
        self,
        a: MemoryBus,
        b: MemoryBus,
        *,
        clock: Clock,
        a_to_b: LinkShim | None = None,
        b_to_a: LinkShim | None = None,
    ) -> None:
        """Join them; latched messages of each start on their way at once.

        Args:
            a: one bus, the site's by custom.
            b: the other bus.
            clock: what delays are measured on.
            a_to_b: behaviour of this direction; perfect without one.
            b_to_a: behaviour of the other direction, with a seed of its own.
        """
        self._a_to_b = _Direction(a_to_b or LinkShim(), clock)
        self._b_to_a = _Direction(b_to_a or LinkShim(), clock)
        a._attach(outgoing=self._a_to_b, incoming=self._b_to_a)  # noqa: SLF001  # one module
        b._attach(outgoing=self._b_to_a, incoming=self._a_to_b)  # noqa: SLF001  # one module

    @property
    def lost(self) -> tuple[int, int]:
        """Number of messages lost from a to b and from b to a."""
        return self._a_to_b.lost, self._b_to_a.lost


class MemoryBus:
    """A bus whose subscribers live in this process; any thread may use it."""

    def __init__(self) -> None:
        """Make a bus without subscribers."""
        self._lock = RLock()
        self._boxes: list[tuple[str, Mailbox]] = []
        self._latched: dict[str, Sample] = {}
        self._outgoing: list[_Direction] = []
        self._incoming: list[_Direction] = []
        self._closed = False

    def publish(self, key: str, payload: bytes, *, schema: str, qos: Qos = Qos.STATE) -> None:
        """Deliver at once here and send over every link; see `wire.bus.Bus`."""
        sample = Sample(checked_key(key), bytes(payload), schema)
        with self._lock:
            self._refuse_when_closed()
            self._deliver(sample, qos)
            for direction in self._outgoing:
                direction.push(sample, qos)

    def subscribe(self, key_expr: str, *, capacity: int, latched: bool = False) -> Subscription:
        """Receive from now on; see `wire.bus.Bus`."""
        checked_expression(key_expr)
        box = Mailbox(capacity=capacity)
        with self._lock:
            self._refuse_when_closed()
            self._pump()
            if latched:
                for sample in self._latched.values():
                    if matches(key_expr, sample.key):
                        box.put(sample)
            self._boxes.append((key_expr, box))
        return _MemorySubscription(self, box)

    def close(self) -> None:
        """End every subscription."""
        with self._lock:
            self._closed = True
            for _, box in self._boxes:
                box.close()
            self._boxes.clear()

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close."""
        self.close()

    def _attach(self, *, outgoing: _Direction, incoming: _Direction) -> None:
        with self._lock:
            for sample in self._latched.values():
                outgoing.push(sample, Qos.LATCHED)
            self._outgoing.append(outgoing)
            self._incoming.append(incoming)

    def _pump(self) -> bool:
        """Deliver what has arrived over links; return whether there are any."""
        with self._lock:
            for direction in self._incoming:
                for sample, qos in direction.due():
                    self._deliver(sample, qos)
            return bool(self._incoming)

    def _deliver(self, sample: Sample, qos: Qos) -> None:
        if qos is Qos.LATCHED:
            self._latched[sample.key] = sample
        for key_expr, box in self._boxes:
            if matches(key_expr, sample.key):
                box.put(sample)

    def _forget(self, box: Mailbox) -> None:
        with self._lock:
            self._boxes = [(expr, other) for expr, other in self._boxes if other is not box]
        box.close()

    def _refuse_when_closed(self) -> None:
        if self._closed:
            raise StateError("the bus is closed")


class _MemorySubscription:
    """A mailbox that looks at the links before it answers."""

    def __init__(self, bus: MemoryBus, box: Mailbox) -> None:
        self._bus = bus
        self._box = box

    @property
    def dropped(self) -> int:
        return self._box.dropped

    def take(self) -> list[Sample]:
        self._bus._pump()  # noqa: SLF001  # one module
        return self._box.take()

    def wait(self, timeout_s: float) -> bool:
        end_ns = time.monotonic_ns() + int(timeout_s * NS_PER_S)
        while True:
            linked = self._bus._pump()  # noqa: SLF001  # one module
            left_s = max(0.0, (end_ns - time.monotonic_ns()) / NS_PER_S)
            if self._box.wait(min(left_s, LINK_POLL_S) if linked else left_s):
                return True
            if left_s == 0.0 or not linked:
                return False

    def close(self) -> None:
        self._bus._forget(self._box)  # noqa: SLF001  # one module
