"""A process under supervision: configuration in, events out, gone when its parent is.

The first line of standard input is the configuration as JSON, so that credentials never show in
a list of processes. Standard input then stays open as a lifeline: its end, like SIGTERM, asks
the process to stop. Events go to standard output, one JSON object on a line.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import select
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from spatial.errors import InputError, MissingError, TelepresenceError

C = TypeVar("C")
log = logging.getLogger("process")

NICE = 4
"""How far a measuring process steps back."""
GRACE_S = 3.0
"""A process that has not ended this long after it was asked to is ended hard."""


def tell(event: str, **fields: Any) -> None:
    """Report an event to the supervisor, if it is still there."""
    with contextlib.suppress(BrokenPipeError):
        sys.stdout.write(json.dumps({"event": event, **fields}) + "\n")
        sys.stdout.flush()


def give_way() -> None:
    """Let everybody else go first: what measures must not slow what it measures."""
    os.nice(NICE)
    # Where sessions are scheduled as groups, only the niceness of the group counts.
    with contextlib.suppress(OSError):
        Path("/proc/self/autogroup").write_text(str(NICE), encoding="ascii")


def run(config_type: type[C], main: Callable[[C, threading.Event], None]) -> None:
    """Read the configuration, run `main(config, stop)` and end the process with its exit code.

    The process ends without Python's own tidying up: what `main` opened it has closed, and a
    thread still inside a native library would be torn out of it, which aborts the process.
    """
    logging.basicConfig(level=logging.INFO, format="%(name)s: %(message)s", stream=sys.stderr)
    for chatty in ("OpenGL", "app.gate.connections"):
        logging.getLogger(chatty).setLevel(logging.WARNING)
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    line = sys.stdin.readline()
    if select.select([sys.stdin], [], [], 0)[0]:  # nothing follows the line: the parent is gone
        return
    config = msgspec.json.decode(line, type=config_type)
    threading.Thread(target=_watch_lifeline, args=(stop,), daemon=True).start()
    code = _code_of(lambda: main(config, stop))
    logging.shutdown()
    os._exit(code)


def _code_of(body: Callable[[], None]) -> int:
    try:
        body()
    except TelepresenceError as error:
        bad_input = isinstance(error, InputError | MissingError)
        tell("failed", message=str(error), bad_input=bad_input)
        return 2
    except Exception:
        log.exception("unexpected")
        return 1
    return 0


def _watch_lifeline(stop: threading.Event) -> None:
    while sys.stdin.readline():
        pass
    stop.set()
    threading.Timer(GRACE_S, os._exit, (1,)).start()
