"""The bus between processes: a zenoh client of one hub.

The session is opened in the background, so a missing hub blocks nobody; what is published before
it is there is dropped and counted, latched messages excepted. Receiving puts bytes away and no
more: a ring that zenoh fills without Python, a thread that empties it, a mailbox the reader takes
from. A reader that sleeps loses its own messages and delays no other's.

Images leave over a session of their own. A hub that must wait with an image, for a slow link or a
stopped reader, stops reading from the link it came over, and poses would wait behind it.
"""

from __future__ import annotations

import atexit
import logging
import weakref
from threading import Event, RLock, Thread
from types import TracebackType
from typing import Self

import zenoh

from spatial.errors import InputError, StateError
from wire.bus import Qos, Sample, Subscription
from wire.codec_parts import MAX_MESSAGE_BYTES
from wire.dial import Dial, Publishers
from wire.keys import checked_expression, checked_key
from wire.latch import LatchBook, LatchFilter, latch_token
from wire.mailbox import Mailbox
from wire.schemas import is_json
from wire.zenoh_session import Credentials, credentials_of, split_endpoint, undeclare

log = logging.getLogger(__name__)

RING = 1024
"""Messages zenoh holds between two sweeps; in the mailbox the reader's capacity rules."""
SWEEP_S = 0.1
JOIN_S = 2.0


def _publishers() -> dict[Qos, Publishers]:
    """Three kinds; no two share a priority, or one that drops would wait for one that blocks."""
    priority, congestion = zenoh.Priority, zenoh.CongestionControl
    return {
        Qos.STATE: Publishers(priority=priority.REAL_TIME, congestion_control=congestion.DROP),
        Qos.LATCHED: Publishers(priority=priority.DATA_HIGH, congestion_control=congestion.BLOCK),
        Qos.IMAGE: Publishers(
            priority=priority.DATA_LOW, congestion_control=congestion.BLOCK_FIRST
        ),
    }


class ZenohBus:
    """A client of a hub; make it with `connect`, close it, best by `with`."""

    def __init__(self, endpoint: str, *, credentials: Credentials) -> None:
        """Start dialling; see `connect`."""
        split_endpoint(endpoint)
        self._endpoint = endpoint
        self._credentials = credentials
        self._lock = RLock()
        self._closed = Event()
        self._publishers = _publishers()
        self._subscriptions: list[_ZenohSubscription] = []
        self._latches = LatchBook(send=self._put)
        self._images: Dial | None = None
        self.unsent = 0
        self._dial = Dial(endpoint, credentials=credentials, opened=self._begin)
        self._sweeper = Thread(target=self._sweep, name="zenoh-sweep", daemon=True)
        self._sweeper.start()
        _open_buses.add(self)

    @classmethod
    def connect(cls, endpoint: str, *, truth_password: str | None = None) -> ZenohBus:
        """Dial a hub in the background, for as long as it takes, again whenever the link is lost.

        Args:
            endpoint: where the hub listens, `tcp/127.0.0.1:7447`.
            truth_password: the run's password for ground truth; only the site, the recorder and
                the metrics have it.

        Raises:
            InputError: an endpoint of another form.
        """
        return cls(endpoint, credentials=credentials_of(truth_password))

    @property
    def connected(self) -> bool:
        """Whether a hub is there now."""
        return self._dial.linked

    def wait_connected(self, timeout_s: float) -> bool:
        """Block until the hub was there for the first time; return whether it was."""
        return self._dial.ready.wait(timeout_s)

    def publish(self, key: str, payload: bytes, *, schema: str, qos: Qos = Qos.STATE) -> None:
        """Send; see `wire.bus.Bus`. Before the hub is there it is dropped and counted in `unsent`.

        Raises:
            InputError: a bad key, or more than 16 MiB.
            StateError: the bus is closed.
        """
        if len(payload) > MAX_MESSAGE_BYTES:
            raise InputError(f"{len(payload)} bytes on {key}, at most {MAX_MESSAGE_BYTES} allowed")
        sample = Sample(checked_key(key), bytes(payload), schema)
        self._refuse_when_closed()
        if qos is Qos.LATCHED:
            self._latches.publish(sample)
        else:
            self._put(sample, qos, None)

    def subscribe(self, key_expr: str, *, capacity: int, latched: bool = False) -> Subscription:
        """Receive, also before the hub is there; see `wire.bus.Bus`."""
        checked_expression(key_expr)
        subscription = _ZenohSubscription(self, key_expr, capacity=capacity, latched=latched)
        with self._lock:
            self._refuse_when_closed()
            self._subscriptions.append(subscription)
            if self._dial.session is not None:
                subscription.declare(self._dial.session)
        return subscription

    def close(self) -> None:
        """End every subscription and leave; safe to call twice."""
        with self._lock:
            self._closed.set()
            images = self._images
            subscriptions, self._subscriptions = self._subscriptions, []
        self._dial.close()
        if images is not None:
            images.close()
        self._latches.close()
        for subscription in subscriptions:
            subscription.end()
        self._sweeper.join(JOIN_S)
        _open_buses.discard(self)

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

    def _sweep(self) -> None:
        """Empty the rings of readers that are late: only so is what they lose counted."""
        while not self._closed.wait(SWEEP_S):
            with self._lock:
                subscriptions = list(self._subscriptions)
            for subscription in subscriptions:
                subscription.sweep()

    def _begin(self, session: zenoh.Session) -> None:
        with self._lock:
            if not self._closed.is_set():
                for subscription in self._subscriptions:
                    subscription.declare(session)
        self._latches.begin(session)

    def _put(self, sample: Sample, qos: Qos, attachment: bytes | None) -> None:
        session = self._image_session() if qos is Qos.IMAGE else self._dial.session
        if session is None:
            self.unsent += qos is not Qos.LATCHED
            return
        kind = "json" if is_json(sample.schema) else "protobuf"
        self._publishers[qos].put(
            session,
            sample.key,
            sample.payload,
            encoding=f"application/{kind};{sample.schema}",
            attachment=attachment,
        )

    def _image_session(self) -> zenoh.Session | None:
        if self._images is None:
            with self._lock:
                self._refuse_when_closed()
                if self._images is None:
                    self._images = Dial(self._endpoint, credentials=self._credentials)
        return self._images.session

    def _refuse_when_closed(self) -> None:
        if self._closed.is_set():
            raise StateError("the bus is closed")

    def _forget(self, subscription: _ZenohSubscription) -> None:
        with self._lock:
            if subscription in self._subscriptions:
                self._subscriptions.remove(subscription)


class _ZenohSubscription:
    """A ring inside zenoh and a mailbox.

    Who only ever takes, takes from the ring: at hundreds of messages a second a thread that hands
    over each of them costs more than the message. Who waits gets such a thread, from then on.
    """

    def __init__(self, bus: ZenohBus, key_expr: str, *, capacity: int, latched: bool) -> None:
        self._bus = bus
        self._key_expr = key_expr
        self._box = Mailbox(capacity=capacity)
        self._filter = LatchFilter(latched=latched)
        self._latched = latched
        self._subscriber: zenoh.Subscriber[zenoh.handlers.Handler[zenoh.Sample]] | None = None
        self._token: zenoh.LivelinessToken | None = None
        self._ring: zenoh.handlers.Handler[zenoh.Sample] | None = None
        self._pull = RLock()
        self._waited = False
        self._thread: Thread | None = None

    @property
    def dropped(self) -> int:
        return self._box.dropped

    def take(self) -> list[Sample]:
        self.sweep()
        return self._box.take()

    def sweep(self) -> None:
        """Move what has come into the mailbox, unless a thread does."""
        with self._pull:
            if self._thread is None and self._ring is not None:
                self._drain(self._ring)

    def wait(self, timeout_s: float) -> bool:
        with self._pull:
            self._waited = True
            self._start_pump()
        return self._box.wait(timeout_s)

    def close(self) -> None:
        self._bus._forget(self)  # noqa: SLF001  # one module
        if self._token is not None:
            undeclare(self._token)
        if self._subscriber is not None:
            undeclare(self._subscriber)
        self.end()

    def declare(self, session: zenoh.Session) -> None:
        """Subscribe; after that the token asks publishers for what they keep."""
        ring: zenoh.handlers.RingChannel[zenoh.Sample] = zenoh.handlers.RingChannel(RING)
        self._subscriber = session.declare_subscriber(self._key_expr, ring)
        with self._pull:
            self._ring = self._subscriber.handler
            self._start_pump()
        if self._latched:
            self._token = session.liveliness().declare_token(latch_token(self._key_expr))

    def end(self) -> None:
        """Wake the reader and see the thread off; its ring is already closed."""
        self._box.close()
        if self._thread is not None:
            self._thread.join(JOIN_S)

    def _start_pump(self) -> None:
        if self._waited and self._thread is None and self._ring is not None:
            self._thread = Thread(
                target=self._pump, args=(self._ring,), name="zenoh-ring", daemon=True
            )
            self._thread.start()

    def _pump(self, ring: zenoh.handlers.Handler[zenoh.Sample]) -> None:
        while True:
            try:
                self._receive(ring.recv())
            except zenoh.ZError:  # how zenoh says that the subscription has ended
                log.debug("subscription to %s ended", self._key_expr)
                return
            self._drain(ring)

    def _drain(self, ring: zenoh.handlers.Handler[zenoh.Sample]) -> None:
        try:
            sample: zenoh.Sample | None = ring.try_recv()
            while sample is not None:
                self._receive(sample)
                sample = ring.try_recv()
        except zenoh.ZError:
            log.debug("subscription to %s has ended", self._key_expr)

    def _receive(self, sample: zenoh.Sample) -> None:
        if sample.kind != zenoh.SampleKind.PUT:
            return
        attachment = sample.attachment
        key = str(sample.key_expr)
        if attachment is not None and not self._filter.accepts(key, bytes(attachment)):
            return
        _, _, schema = str(sample.encoding).partition(";")
        self._box.put(Sample(key, bytes(sample.payload), schema))


_open_buses: weakref.WeakSet[ZenohBus] = weakref.WeakSet()


@atexit.register
def _close_all() -> None:
    """Close what nobody closed: a thread inside zenoh at the end of Python aborts the process."""
    for bus in list(_open_buses):
        bus.close()
