"""Latched messages over zenoh: late joiners get the last one of each key.

A reader that wants them declares a liveliness token with its key expression in it. Every
publisher watches these tokens and puts again what matches, whenever one appears: a new reader, a
hub or a link that came back; and a few times more, since across two hubs a token may overtake
the subscription it speaks for [5 of 12]. A number on each message lets readers drop what they know.
Nobody keeps anything but its publisher, so hub and readers may restart at will.
"""

from __future__ import annotations

import logging
import secrets
import time
from collections.abc import Callable
from itertools import accumulate
from threading import Event, RLock, Thread

import zenoh

from wire.bus import Qos, Sample
from wire.keys import matches

log = logging.getLogger(__name__)

TOKEN_PREFIX = "latch-reader"  # noqa: S105  # a key, no secret
RING = 1024
ID_BYTES = 8
NUMBER_BYTES = 8
JOIN_S = 2.0
AGAIN_AFTER_S = (0.0, 0.2, 0.8, 2.0)
"""Pauses before each answer to one token."""
POLL_S = 0.05
FIRST, AGAIN = b"\x00", b"\x01"


def latch_token(key_expr: str) -> str:
    """Return a token that asks for the latched messages of an expression."""
    return f"{TOKEN_PREFIX}/{secrets.token_hex(ID_BYTES)}/{key_expr.encode().hex()}"


def asked_for(token: str) -> str | None:
    """Return the expression in a token; `None` when it holds none."""
    try:
        return bytes.fromhex(token.rpartition("/")[2]).decode()
    except ValueError:
        return None


class LatchFilter:
    """Drops repetitions, by the publisher's random number and its count."""

    def __init__(self, *, latched: bool) -> None:
        """Remember nothing.

        Args:
            latched: whether the reader wants what was published before it came.
        """
        self._latched = latched
        self._newest: dict[str, tuple[bytes, int]] = {}

    def accepts(self, key: str, attachment: bytes) -> bool:
        """Return whether a message is new to this reader."""
        if len(attachment) != ID_BYTES + NUMBER_BYTES + len(FIRST):
            return True
        publisher = attachment[:ID_BYTES]
        number = int.from_bytes(attachment[ID_BYTES : ID_BYTES + NUMBER_BYTES], "big")
        known_publisher, known = self._newest.get(key, (b"", -1))
        if publisher == known_publisher and number <= known:
            return False
        if not self._latched and attachment.endswith(AGAIN) and publisher != known_publisher:
            return False
        self._newest[key] = (publisher, number)
        return True


class LatchBook:
    """What one bus has latched, sent again to whoever asks."""

    def __init__(self, *, send: Callable[[Sample, Qos, bytes | None], None]) -> None:
        """Keep nothing.

        Args:
            send: puts a message with an attachment on the bus, or drops it without one.
        """
        self._send = send
        self._publisher = secrets.token_bytes(ID_BYTES)
        self._kept: dict[str, tuple[Sample, int]] = {}
        self._count = 0
        self._lock = RLock()  # held while sending: an older message never follows a newer one
        self._session: zenoh.Session | None = None
        self._thread: Thread | None = None
        self._stop = Event()

    def publish(self, sample: Sample) -> None:
        """Keep a message and send it."""
        with self._lock:
            self._count += 1
            self._kept[sample.key] = (sample, self._count)
            self._put(sample, self._count, FIRST)
            self._watch()

    def begin(self, session: zenoh.Session) -> None:
        """Send what was kept while there was no session, and watch for readers."""
        with self._lock:
            self._session = session
            for sample, number in self._kept.values():
                self._put(sample, number, FIRST)
            self._watch()

    def close(self) -> None:
        """See the watching thread off; the session is already closed."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join(JOIN_S)

    def _watch(self) -> None:
        if self._session is None or self._thread is not None or not self._kept:
            return
        ring: zenoh.handlers.RingChannel[zenoh.Sample] = zenoh.handlers.RingChannel(RING)
        subscriber = self._session.liveliness().declare_subscriber(
            f"{TOKEN_PREFIX}/**", ring, history=True
        )
        self._thread = Thread(
            target=self._answer, args=(subscriber,), name="zenoh-latch", daemon=True
        )
        self._thread.start()

    def _answer(self, subscriber: zenoh.Subscriber[zenoh.handlers.Handler[zenoh.Sample]]) -> None:
        tokens = subscriber.handler
        pending: list[tuple[float, str]] = []  # when [s, monotonic] to answer which expression
        while True:
            try:
                token = tokens.try_recv() if pending else tokens.recv()
            except zenoh.ZError:  # how zenoh says that the subscription has ended
                log.debug("no more readers to latch for")
                return
            now = time.monotonic()
            wanted = asked_for(str(token.key_expr)) if token is not None else None
            if token is not None and token.kind == zenoh.SampleKind.PUT and wanted is not None:
                pending += [(now + after, wanted) for after in accumulate(AGAIN_AFTER_S)]
            due = {wanted for when, wanted in pending if when <= now}
            pending = [entry for entry in pending if entry[0] > now]
            for expression in due:
                self._send_again(expression)
            if token is None:
                self._stop.wait(POLL_S)

    def _send_again(self, wanted: str) -> None:
        with self._lock:
            for sample, number in self._kept.values():
                if matches(wanted, sample.key) and not self._stop.is_set():
                    self._put(sample, number, AGAIN)

    def _put(self, sample: Sample, number: int, flag: bytes) -> None:
        attachment = self._publisher + number.to_bytes(NUMBER_BYTES, "big") + flag
        self._send(sample, Qos.LATCHED, attachment)
