"""The hub of one side: a zenoh session in router mode and nothing else.

Every process of a side dials its hub; the site's hub dials the station's, over two links, so that
images queue behind images and never in front of a pose [57 ms p99 on a full link, not 445].
Ground truth passes only between those who know the run's password.
"""

from __future__ import annotations

import secrets
import socket
import tempfile
from pathlib import Path
from types import TracebackType
from typing import Self

import zenoh

from spatial.errors import MissingError
from wire.zenoh_session import (
    HUB_BLOCK_S,
    PUBLIC,
    Credentials,
    close_session,
    credentials_of,
    session_config,
    split_endpoint,
    truth_rules,
)

DEFAULT_LISTEN = "tcp/127.0.0.1:0"
IMAGE_SEND_BUFFER = 131_072
FREE_PORT_TRIES = 5
MAX_LINKS = 2


def new_truth_password() -> str:
    """Draw the password with which site, recorder and metrics of one run reach the truth."""
    return secrets.token_urlsafe(24)


class Hub:
    """Forwards between everybody who dials it; close it, best by `with`."""

    def __init__(
        self,
        *,
        listen: str = DEFAULT_LISTEN,
        dial: str | None = None,
        truth_password: str | None = None,
        dial_truth_password: str | None = None,
    ) -> None:
        """Start at once; a hub to dial may come later and may come back.

        Args:
            listen: endpoint to listen on; port 0 takes a free one, see `endpoint`.
            dial: endpoint of another hub.
            truth_password: who knows it may read and write the truth here; nobody without one.
            dial_truth_password: password of the other hub, when the truth shall cross.

        Raises:
            InputError: an endpoint of another form.
            MissingError: the port is taken.
        """
        if dial is not None:
            split_endpoint(dial)
        users = [PUBLIC] if truth_password is None else [PUBLIC, credentials_of(truth_password)]
        self._session, self._endpoint = _open(
            listen, dial=dial, users=users, credentials=credentials_of(dial_truth_password)
        )

    @property
    def endpoint(self) -> str:
        """Where it listens: what its clients dial."""
        return self._endpoint

    @property
    def links(self) -> int:
        """Number of links open, two to another hub and one to each client."""
        return len(self._session.info.links())

    def close(self) -> None:
        """Cut every link; safe to call twice."""
        close_session(self._session)

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


def _open(
    listen: str, *, dial: str | None, users: list[Credentials], credentials: Credentials
) -> tuple[zenoh.Session, str]:
    protocol, host, port = split_endpoint(listen)
    connect = [] if dial is None else [f"{dial}?prio=1-3", _image_endpoint(dial)]
    with tempfile.TemporaryDirectory(prefix="hub-") as folder:  # readable by this user alone
        dictionary = Path(folder) / "users"
        dictionary.write_text("".join(f"{user.user}:{user.password}\n" for user in users))
        for attempt in range(FREE_PORT_TRIES if port == 0 else 1):
            endpoint = f"{protocol}/{host}:{port or _free_port(host)}"
            config = session_config(
                "router",
                listen=[endpoint],
                connect=connect,
                credentials=credentials,
                block_s=HUB_BLOCK_S,
                more={
                    "transport/unicast/max_links": MAX_LINKS,
                    "transport/auth/usrpwd/dictionary_file": str(dictionary),
                    "access_control": truth_rules(),
                },
            )
            try:
                return zenoh.open(config), endpoint
            except zenoh.ZError as error:
                if attempt + 1 == FREE_PORT_TRIES or port != 0:
                    raise MissingError(
                        f"no hub can listen on {endpoint}: is the port taken by another program?"
                    ) from error
    raise AssertionError  # the loop returns or raises


def _image_endpoint(dial: str) -> str:
    return f"{dial}?prio=4-7#so_sndbuf={IMAGE_SEND_BUFFER}"


def _free_port(host: str) -> int:
    """Return a port that is free now; zenoh does not say which one it takes for port 0."""
    family = socket.AF_INET6 if host.startswith("[") else socket.AF_INET
    with socket.socket(family) as probe:
        probe.bind((host.strip("[]"), 0))
        port: int = probe.getsockname()[1]
        return port
