"""How every zenoh session of ours is configured; figures in brackets were measured.

Nobody scouts. Shared memory is off. A lost link is noticed within the lease (2 s) and dialled
again every 0.2 to 1 s [first pose 0.4 s after a cut of 3 s, and no backlog of stale ones].

A message that blocks must give up well before the lease ends. A hub whose blocked message meets
the end of a lease forwards nothing any more [a stopped image reader took every pose with it; with
0.3 s it is cut off, and poses come 5 ms late at most]. The price: an image link must carry 64 kB
in 0.3 s, 1.7 Mbit/s.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field
from typing import Any

import zenoh

from spatial.errors import InputError
from wire.codec_parts import MAX_MESSAGE_BYTES
from wire.keys import TRUTH

LEASE_MS = 2000
CLIENT_BLOCK_S = 1.0
"""A client waits longer than its hub, or one stopped reader would cut off every writer."""
HUB_BLOCK_S = 0.3
RETRY_FIRST_S = 0.2
RETRY_LONGEST_S = 1.0
TRUTH_EXPRESSION = f"*/{TRUTH}/**"
_ENDPOINT = re.compile(r"(tcp|tls|quic)/(\[[0-9a-fA-F:.]+\]|[^\s:/?#]+):(\d{1,5})")


@dataclass(frozen=True, slots=True)
class Credentials:
    """Who dials a hub."""

    user: str = "public"
    """`public`, which every process is, or `truth`."""
    password: str = field(default="public", repr=False)
    """The public one is no secret; that of `truth` is drawn for every run."""


PUBLIC = Credentials()


def credentials_of(truth_password: str | None) -> Credentials:
    """Return who a process is: with a password for the truth it is `truth`."""
    return PUBLIC if truth_password is None else Credentials("truth", truth_password)


def split_endpoint(endpoint: str) -> tuple[str, str, int]:
    """Return protocol, host and port of `tcp/127.0.0.1:7447`.

    Raises:
        InputError: another form.
    """
    match = _ENDPOINT.fullmatch(endpoint)
    if match is None or int(match[3]) > 65535:
        raise InputError(f"endpoint {endpoint!r}, expected one like tcp/127.0.0.1:7447")
    return match[1], match[2], int(match[3])


def session_config(
    mode: str,
    *,
    listen: list[str],
    connect: list[str],
    credentials: Credentials,
    block_s: float,
    more: dict[str, Any],
) -> zenoh.Config:
    """Return the configuration of a session.

    Args:
        mode: `client` or `router`.
        listen: endpoints to listen on.
        connect: endpoints to dial.
        credentials: who dials.
        block_s: how long a message may block before its link is cut [s].
        more: further settings by path.
    """
    retry = {
        "period_init_ms": int(RETRY_FIRST_S * 1000),
        "period_max_ms": int(RETRY_LONGEST_S * 1000),
        "period_increase_factor": 1.5,
    }
    settings: dict[str, Any] = {
        "mode": mode,
        "listen/endpoints": listen,
        "connect/endpoints": connect,
        "connect/retry": retry,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "scouting/delay": 0,
        "transport/shared_memory/enabled": False,
        "transport/link/tx/lease": LEASE_MS,
        "transport/link/tx/queue/congestion_control/block/wait_before_close": int(block_s * 1e6),
        "transport/link/rx/max_message_size": MAX_MESSAGE_BYTES + 4096,
        "transport/auth/usrpwd/user": credentials.user,
        "transport/auth/usrpwd/password": credentials.password,
        **more,
    }
    config = zenoh.Config()
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return config


def truth_rules() -> dict[str, Any]:
    """Return the access rules of a hub: user `public` neither writes nor reads the truth."""
    messages = [
        "put",
        "delete",
        "declare_subscriber",
        "query",
        "reply",
        "declare_queryable",
        "liveliness_token",
        "liveliness_query",
        "declare_liveliness_subscriber",
    ]
    rule = {
        "id": "no-truth",
        "permission": "deny",
        "messages": messages,
        "flows": ["ingress", "egress"],
        "key_exprs": [TRUTH_EXPRESSION],
    }
    return {
        "enabled": True,
        "default_permission": "allow",
        "rules": [rule],
        "subjects": [{"id": "everybody", "usernames": [PUBLIC.user]}],
        "policies": [{"rules": ["no-truth"], "subjects": ["everybody"]}],
    }


def close_session(session: zenoh.Session) -> None:
    """Close a session and everything declared on it; safe to call twice."""
    if not session.is_closed():
        session.close()  # type: ignore[no-untyped-call]  # zenoh's stub names no return type


def undeclare(declared: zenoh.Subscriber[Any] | zenoh.LivelinessToken) -> None:
    """Take back one declaration."""
    declared.undeclare()  # type: ignore[no-untyped-call]  # zenoh's stub names no return type
