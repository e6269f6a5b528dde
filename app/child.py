"""A process under supervision: configuration in, events out, gone when its parent is.

The first line of standard input is the configuration as JSON, so that credentials never show in
a list of processes. Standard input then stays open as a lifeline: its end, like SIGTERM, asks
the process to stop. Events go to standard output, one JSON object on a line.
"""

from __future__ import annotations

import json
import logging
import os
import signal
import sys
import threading
from collections.abc import Callable
from typing import Any, TypeVar

import msgspec

from spatial.errors import TelepresenceError

C = TypeVar("C")

GRACE_S = 3.0
"""A process that has not ended this long after it was asked to is ended hard."""


def tell(event: str, **fields: Any) -> None:
    """Report an event to the supervisor."""
    sys.stdout.write(json.dumps({"event": event, **fields}) + "\n")
    sys.stdout.flush()


def run(config_type: type[C], main: Callable[[C, threading.Event], None]) -> None:
    """Read the configuration, run `main(config, stop)` and end the process with its exit code."""
    logging.basicConfig(level=logging.INFO, format="%(name)s: %(message)s", stream=sys.stderr)
    for chatty in ("OpenGL", "app.gate.connections"):
        logging.getLogger(chatty).setLevel(logging.WARNING)
    config = msgspec.json.decode(sys.stdin.readline(), type=config_type)
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    threading.Thread(target=_watch_lifeline, args=(stop,), daemon=True).start()
    try:
        main(config, stop)
    except TelepresenceError as error:
        tell("failed", message=str(error), kind=type(error).__name__)
        sys.exit(2)


def _watch_lifeline(stop: threading.Event) -> None:
    while sys.stdin.readline():
        pass
    stop.set()
    threading.Timer(GRACE_S, os._exit, (1,)).start()
