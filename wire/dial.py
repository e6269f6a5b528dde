"""A zenoh session of a client, opened in the background for as long as it takes."""

from __future__ import annotations

import logging
from collections.abc import Callable
from threading import Event, RLock, Thread

import zenoh

from spatial.errors import InputError, StateError
from wire.zenoh_session import (
    CLIENT_BLOCK_S,
    RETRY_FIRST_S,
    RETRY_LONGEST_S,
    Credentials,
    close_session,
    session_config,
)

log = logging.getLogger(__name__)

JOIN_S = 2.0


class Dial:
    """Dials a hub until it answers; from then on zenoh itself dials again after a lost link."""

    def __init__(
        self,
        endpoint: str,
        *,
        credentials: Credentials,
        opened: Callable[[zenoh.Session], None] | None = None,
    ) -> None:
        """Start dialling.

        Args:
            endpoint: where the hub listens.
            credentials: who dials.
            opened: called once, by the dialling thread, with the new session.
        """
        self._endpoint = endpoint
        self._config = session_config(
            "client",
            listen=[],
            connect=[endpoint],
            credentials=credentials,
            block_s=CLIENT_BLOCK_S,
            more={"connect/timeout_ms": 0},  # try once: a thread stuck in open() cannot be ended
        )
        self._opened = opened
        self._lock = RLock()
        self._stop = Event()
        self._session: zenoh.Session | None = None
        self.ready = Event()
        self._thread = Thread(target=self._dial, name="zenoh-dial", daemon=True)
        self._thread.start()

    @property
    def session(self) -> zenoh.Session | None:
        """The session, `None` before the hub answered for the first time."""
        return self._session

    @property
    def linked(self) -> bool:
        """Whether the hub is there now."""
        session = self._session
        return session is not None and not session.is_closed() and bool(session.info.routers_zid())

    def close(self) -> None:
        """Stop dialling and close the session with all that is declared on it."""
        self._stop.set()
        self._thread.join(JOIN_S)
        with self._lock:
            if self._session is not None:
                close_session(self._session)

    def _dial(self) -> None:
        pause_s = RETRY_FIRST_S
        while not self._stop.is_set():
            try:
                session = zenoh.open(self._config)
            except zenoh.ZError as error:
                if pause_s == RETRY_FIRST_S:
                    log.info("waiting for the hub at %s", self._endpoint)
                log.debug("no hub: %s", error)
                self._stop.wait(pause_s)
                pause_s = min(1.5 * pause_s, RETRY_LONGEST_S)
                continue
            self._begin(session)
            return

    def _begin(self, session: zenoh.Session) -> None:
        with self._lock:
            if self._stop.is_set():
                close_session(session)
                return
            self._session = session
        if self._opened is not None:
            self._opened(session)
        self.ready.set()


class Publishers:
    """Publishers of one kind on one session, declared at their first message."""

    def __init__(
        self, *, priority: zenoh.Priority, congestion_control: zenoh.CongestionControl
    ) -> None:
        """Have none.

        Args:
            priority: class of traffic; never express, which would lose messages under load.
            congestion_control: what happens when the link is full.
        """
        self._priority = priority
        self._congestion_control = congestion_control
        self._publishers: dict[str, zenoh.Publisher] = {}
        self._lock = RLock()

    def put(
        self,
        session: zenoh.Session,
        key: str,
        payload: bytes,
        *,
        encoding: str,
        attachment: bytes | None,
    ) -> None:
        """Send; a full link may block here, and then only who publishes the like.

        Raises:
            InputError: the session does not take the key.
            StateError: the session is closed.
        """
        with self._lock:
            publisher = self._publishers.get(key)
            if publisher is None:
                publisher = self._publishers[key] = self._declare(session, key)
        try:
            publisher.put(payload, encoding=encoding, attachment=attachment)
        except zenoh.ZError as error:
            raise StateError(f"cannot publish on {key}: {error}") from error

    def _declare(self, session: zenoh.Session, key: str) -> zenoh.Publisher:
        try:
            return session.declare_publisher(
                key,
                priority=self._priority,
                congestion_control=self._congestion_control,
                express=False,
            )
        except zenoh.ZError as error:
            raise InputError(f"cannot declare {key}: {error}") from error
