"""What a browser may say to viser: where its camera is, and nothing else.

Our page uses no viser widget, yet viser's server would obey a raw message that presses buttons,
sets attributes or starts a public tunnel. The filter stands in front of its decoder.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable
from typing import Any

import msgspec

ALLOWED = frozenset({"ViewerCameraMessage", "FileTransferPartAck"})
MAX_BYTES = 4096
MAX_PER_SECOND = 200
_LOG = logging.getLogger(__name__)


class InboundFilter:
    """Judges the messages of one connection, with its rate."""

    def __init__(self, on_drop: Callable[[], None]) -> None:
        """Remember whom to tell of each message that is dropped."""
        self._on_drop = on_drop
        self._window_start = time.monotonic()
        self._in_window = 0

    def passes(self, data: object) -> bool:
        """Return whether a message may reach viser."""
        if self._slow_enough() and _is_harmless(data):
            return True
        self._on_drop()
        return False

    def _slow_enough(self) -> bool:
        now = time.monotonic()
        if now - self._window_start >= 1.0:
            self._window_start, self._in_window = now, 0
        self._in_window += 1
        return self._in_window <= MAX_PER_SECOND


def _is_harmless(data: object) -> bool:
    if not isinstance(data, bytes) or len(data) > MAX_BYTES:
        return False
    try:
        message = msgspec.msgpack.decode(data)
    except (msgspec.DecodeError, UnicodeDecodeError) as error:
        _LOG.debug("unreadable message from a browser: %s", error)
        return False
    return isinstance(message, dict) and message.get("type") in ALLOWED and _finite(message)


def _finite(value: Any) -> bool:
    if isinstance(value, dict):
        return all(_finite(v) for v in value.values())
    if isinstance(value, list):
        return all(_finite(v) for v in value)
    return not isinstance(value, float) or math.isfinite(value)
