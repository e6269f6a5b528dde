"""Starts the processes of a side, restarts what dies, ends all of them together."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import IO, Any, Self

import msgspec
import psutil

from spatial.errors import InputError, StateError

RESTART_AFTER_S = 0.5
RESTARTS_PER_MINUTE = 5
POLL_S = 0.05
STOP_GRACE_S = 4.0
ONE_THREAD = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OPENCV_FOR_THREADS_NUM"), "1")
"""Processes are what shares out the cores: pools of threads in each would only wait in line."""

Event = dict[str, Any]
log = logging.getLogger("supervisor")


@dataclass(slots=True)
class Child:
    """One supervised process and what is known of it."""

    name: str
    """Name in reports and log lines."""
    module: str
    """Module run with `python -m`."""
    config: msgspec.Struct
    """Configuration it reads from standard input."""
    restart: bool
    """Whether it is started again when it ends."""
    process: subprocess.Popen[str] | None = None
    """The running process."""
    started_s: float = 0.0
    """Monotonic time of the last start [s]."""
    ended_s: float | None = None
    """Monotonic time its end was noticed [s]; `None` while it runs."""
    starts: deque[float] = field(default_factory=lambda: deque(maxlen=RESTARTS_PER_MINUTE + 1))
    """Monotonic times of the last starts [s]."""
    cpu_s: float = 0.0
    """Processor time of the runs that have ended and of the present one [s]."""
    cpu_before_s: float = 0.0
    """Processor time of the runs that have ended [s]."""
    given_up: bool = False
    """It died too often."""

    @property
    def gone(self) -> bool:
        """Whether it has ended and will not come back."""
        ended = self.ended_s is not None and time.monotonic() - self.ended_s > RESTART_AFTER_S
        return self.given_up or (ended and not self.restart)


class Supervisor:
    """Owns child processes; use it in a `with` block: none survives it."""

    def __init__(self, *, on_event: Callable[[str, Event], None] | None = None) -> None:
        """Start nothing yet.

        Args:
            on_event: called with the child's name for each event it tells, from a thread.
        """
        self._children: dict[str, Child] = {}
        self._events: list[tuple[str, Event]] = []
        self._changed = threading.Condition()
        self._on_event = on_event
        self._closing = threading.Event()
        self._watcher = threading.Thread(target=self._watch, daemon=True)
        self._started_s = time.monotonic()

    def __enter__(self) -> Self:
        """Begin to watch."""
        self._watcher.start()
        return self

    def __exit__(self, *_: object) -> None:
        """End every child, last started first."""
        self.close()

    def start(
        self, name: str, module: str, config: msgspec.Struct, *, restart: bool = True
    ) -> None:
        """Start `python -m module` under a name."""
        child = Child(name=name, module=module, config=config, restart=restart)
        self._children[name] = child
        self._launch(child)

    def wait_event(self, name: str, event: str, *, timeout_s: float) -> Event:
        """Return the newest event of that kind a child told, waiting for it.

        Raises:
            InputError: the child refused what it was given.
            StateError: the child failed, ended for good, or said nothing in time.
        """
        deadline = time.monotonic() + timeout_s
        with self._changed:
            while True:
                for source, told in reversed(self._events):
                    if source == name and told["event"] == event:
                        return told
                    if source == name and told["event"] == "failed":
                        kind = InputError if told["bad_input"] else StateError
                        raise kind(f"{name}: {told['message']}")
                if self._children[name].gone:
                    raise StateError(f"{name} ended before it said {event!r}")
                left = deadline - time.monotonic()
                if left <= 0 or self._closing.is_set():
                    raise StateError(f"{name} did not say {event!r} within {timeout_s:g} s")
                self._changed.wait(min(left, 0.5))

    def wait_end(self, name: str, *, timeout_s: float) -> bool:
        """Wait for a child that is not restarted to end; return whether it did."""
        process = self._children[name].process
        assert process is not None
        try:
            process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            return False
        return True

    def failed(self) -> str | None:
        """Return a sentence when a child was given up, `None` while all is well."""
        lost = [child.name for child in self._children.values() if child.given_up]
        return (
            f"{', '.join(lost)} died more than {RESTARTS_PER_MINUTE} times a minute"
            if lost
            else None
        )

    def pids(self) -> dict[str, int]:
        """Return the process id of every running child by name."""
        running = {n: c.process for n, c in self._children.items()}
        return {n: p.pid for n, p in running.items() if p is not None and p.poll() is None}

    def cpu_cores(self) -> dict[str, float]:
        """Return the mean number of cores each child has used since it was first started."""
        for child in self._children.values():
            self._account(child)
        now = time.monotonic()
        return {
            name: child.cpu_s / max(now - child.starts[0], 1e-3)
            for name, child in self._children.items()
        }

    def stop(self, name: str) -> None:
        """End one child and do not start it again."""
        child = self._children[name]
        child.restart = False
        self._end([child])

    def close(self) -> None:
        """End every child, last started first, hard after a grace period."""
        if self._closing.is_set():
            return
        self._closing.set()
        for child in self._children.values():
            self._account(child)
        if self._watcher.is_alive():
            self._watcher.join(timeout=2.0)  # or it might start one more
        self._end(list(reversed(self._children.values())))

    def _end(self, children: list[Child]) -> None:
        running = [
            (c.name, c.process)
            for c in children
            if c.process is not None and c.process.poll() is None
        ]
        for _, process in running:
            process.terminate()
            _close_input(process)
        deadline = time.monotonic() + STOP_GRACE_S
        for name, process in running:
            try:
                process.wait(max(0.0, deadline - time.monotonic()))
            except subprocess.TimeoutExpired:
                log.warning("%s did not end in %g s and was killed", name, STOP_GRACE_S)
                process.kill()
                process.wait()
        for child in children:
            if child.process is not None:
                _close_input(child.process)  # also of those that ended by themselves

    def _launch(self, child: Child) -> None:
        child.process = subprocess.Popen(  # noqa: S603 - our own module, no shell
            [sys.executable, "-P", "-m", child.module],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=ONE_THREAD | os.environ,
            start_new_session=True,  # Ctrl-C is for the parent, which ends them in order
        )
        child.started_s = time.monotonic()
        child.starts.append(child.started_s)
        child.ended_s = None
        assert child.process.stdin is not None
        assert child.process.stdout is not None
        with contextlib.suppress(OSError):
            child.process.stdin.write(msgspec.json.encode(child.config).decode() + "\n")
            child.process.stdin.flush()
        reader = threading.Thread(
            target=self._read, args=(child.name, child.process.stdout), daemon=True
        )
        reader.start()

    def _read(self, name: str, stream: IO[str]) -> None:
        for line in stream:
            try:
                event = json.loads(line)
            except json.JSONDecodeError:
                log.info("%s: %s", name, line.rstrip())
                continue
            with self._changed:
                self._events.append((name, event))
                del self._events[:-1000]
                self._changed.notify_all()
            if self._on_event is not None:
                self._on_event(name, event)
        stream.close()

    def _account(self, child: Child) -> None:
        if child.process is None or child.process.poll() is not None:
            return
        with contextlib.suppress(psutil.Error):
            times = psutil.Process(child.process.pid).cpu_times()
            child.cpu_s = child.cpu_before_s + times.user + times.system

    def _watch(self) -> None:
        while not self._closing.wait(POLL_S):
            for child in list(self._children.values()):
                self._revive(child)

    def _revive(self, child: Child) -> None:
        now = time.monotonic()
        if child.process is None or child.process.poll() is None or child.given_up:
            return
        if child.ended_s is None:
            child.ended_s = now
            child.cpu_before_s = child.cpu_s
            _close_input(child.process)
            if child.restart:
                log.warning("%s ended with code %s", child.name, child.process.returncode)
        if not child.restart or now - child.ended_s < RESTART_AFTER_S:
            return
        full = len(child.starts) > RESTARTS_PER_MINUTE
        if full and now - child.starts[0] < 60.0:
            child.given_up = True
            with self._changed:
                self._changed.notify_all()
            return
        self._launch(child)


def _close_input(process: subprocess.Popen[str]) -> None:
    assert process.stdin is not None
    with contextlib.suppress(OSError):
        process.stdin.close()
