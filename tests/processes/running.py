"""What the tests of whole commands need: start them, watch their page, see who is left.

The page is observed by the probe of the demo, which enters through the gate like a tab: scene
states on the pose socket, frames and statuses on `/live`, each with its time of arrival.
"""

from __future__ import annotations

import asyncio
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self

import psutil
from websockets.asyncio.client import ClientConnection

from app.probe import Probe
from wire.clock import SystemClock

ROOT = Path(__file__).parents[2]
START_S = 60.0
"""A busy machine takes this long to start everything; a quiet one takes five seconds."""


def eventually(condition: Callable[[], object], *, within_s: float = START_S) -> bool:
    """Return whether a condition came true in time."""
    deadline = time.monotonic() + within_s
    while time.monotonic() < deadline:
        if condition():
            return True
        time.sleep(0.05)
    return False


class Running:
    """A command as a user starts it; ended, with all it started, at the end of the `with` block."""

    def __init__(self, *arguments: str) -> None:
        """Start `telepresence ARGUMENTS`."""
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-m", "app", *arguments],
            cwd=ROOT,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        self.lines: list[str] = []
        """Lines of standard error."""
        self.out: list[str] = []
        """Lines of standard output."""
        self.seen: dict[int, psutil.Process] = {}
        """Every child there ever was, by process id."""
        self._readers = [
            threading.Thread(target=lambda stream=stream, kept=kept: kept.extend(stream))
            for stream, kept in (
                (self.process.stderr, self.lines),
                (self.process.stdout, self.out),
            )
        ]
        for reader in self._readers:
            reader.start()

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """End it hard if it still runs; its children follow by themselves."""
        self.children()
        self.process.kill()
        self.finish()

    def children(self) -> dict[str, psutil.Process]:
        """Return the running children by the name of their module."""
        found = {}
        try:
            below = psutil.Process(self.process.pid).children(recursive=True)
        except psutil.NoSuchProcess:
            return {}
        for child in below:
            try:
                words = child.cmdline()
            except psutil.Error:
                continue
            if words and words[-1].startswith("app.processes."):
                found[words[-1].rpartition(".")[2]] = child
                self.seen[child.pid] = child
        return found

    def left(self) -> list[psutil.Process]:
        """Return the children that run, whoever their parent is now."""
        return [child for child in self.seen.values() if _runs(child)]

    def said(self, pattern: str) -> re.Match[str] | None:
        """Return the match of a pattern in what was said so far."""
        return re.search(pattern, "".join(self.lines))

    def wait_said(self, pattern: str, *, within_s: float = START_S) -> str:
        """Return the match of a pattern, waiting for it."""
        found = eventually(
            lambda: self.said(pattern) or self.process.poll() is not None, within_s=within_s
        )
        match = self.said(pattern)
        assert found, f"not said in {within_s} s: {pattern}: {self.lines}"
        assert match is not None, f"ended without saying {pattern}: {self.lines}"
        return match[0]

    def end(self, number: int = signal.SIGTERM) -> float:
        """Send a signal; return how long it took until it and all its children had ended [s]."""
        self.children()
        begun = time.monotonic()
        os.kill(self.process.pid, number)
        self.process.wait(timeout=30)
        assert eventually(lambda: not self.left(), within_s=30), self.left()
        took_s = time.monotonic() - begun
        self.finish()
        return took_s

    def finish(self, *, within_s: float = START_S) -> int:
        """Wait for the command to end by itself; return its exit code."""
        code = self.process.wait(timeout=within_s)
        for reader in self._readers:
            reader.join(timeout=30)
        for stream in (self.process.stdout, self.process.stderr):
            assert stream is not None
            stream.close()
        return code

    def complaints(self) -> list[str]:
        """Return lines that no user should see at an orderly end."""
        return [
            line
            for line in self.lines
            if re.search(r"Traceback|Error|FATAL|Exception|was killed|unexpected", line)
        ]


def _runs(process: psutil.Process) -> bool:
    try:
        return process.is_running() and process.status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


class Watch(Probe):
    """The demo's probe, keeping when everything came."""

    def __init__(self, url: str) -> None:
        """Enter through the gate, from a thread, again and again."""
        super().__init__(url, clock=SystemClock())
        self.states_s: list[float] = []
        """Monotonic arrival times of scene states [s]."""
        self.frames_s: dict[str, list[float]] = defaultdict(list)
        """Monotonic arrival times of frames by camera [s]."""
        self.statuses: list[tuple[float, dict[str, Any]]] = []
        """Statuses with their monotonic arrival times [s]."""
        self._loop = asyncio.new_event_loop()
        self._end = asyncio.Event()
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Leave."""
        self._loop.call_soon_threadsafe(self._end.set)
        self._thread.join(timeout=10)

    def state(self, after_s: float) -> float | None:
        """Return when the first scene state came after a time."""
        return next((t for t in self.states_s if t > after_s), None)

    def frame(self, after_s: float, *, camera: str = "hc") -> float | None:
        """Return when the first frame of a camera came after a time."""
        return next((t for t in self.frames_s[camera] if t > after_s), None)

    def tracked(self, after_s: float) -> float | None:
        """Return when an object was TRACKED on an image taken after a time."""
        return next(
            (t for t, said in self.statuses if t > after_s and _fresh(said, t, after_s)), None
        )

    def robot(self, after_s: float) -> float | None:
        """Return when the robot was shown by joint states younger than the time since `after_s`."""
        for came_s, said in self.statuses:
            age_ms = said["robot_ms"]
            if came_s > after_s and age_ms is not None and came_s - age_ms / 1e3 > after_s:
                return came_s
        return None

    def all_back(self, after_s: float, *, within_s: float = START_S) -> dict[str, float]:
        """Wait until states, robot, video and a fresh fix have come; return after how long [s]."""
        ways = {"state": self.state, "robot": self.robot, "frame": self.frame, "fix": self.tracked}
        assert eventually(
            lambda: all(way(after_s) is not None for way in ways.values()), within_s=within_s
        ), {
            "missing": [name for name, way in ways.items() if way(after_s) is None],
            "last": self.statuses[-1:],
        }
        return {name: round((way(after_s) or 0.0) - after_s, 2) for name, way in ways.items()}

    def _serve(self) -> None:
        self._loop.run_until_complete(self.run(self._end))
        self._loop.close()

    def _count_state(self, instant_ms: float) -> None:
        super()._count_state(instant_ms)
        self.states_s.append(time.monotonic())

    async def _hear(self, socket: ClientConnection, said: dict[str, Any]) -> None:
        await super()._hear(socket, said)
        if said["kind"] == "status":
            self.statuses.append((time.monotonic(), said))

    async def _look(self, socket: ClientConnection, data: bytes) -> None:
        counts = {camera: len(stamps) for camera, stamps in self.figures.frame_ns.items()}
        await super()._look(socket, data)
        for camera, stamps in self.figures.frame_ns.items():
            if len(stamps) > counts.get(camera, 0):
                self.frames_s[camera].append(time.monotonic())


def _fresh(said: dict[str, Any], came_s: float, after_s: float) -> bool:
    """Return whether an object is tracked on an image whose capture lies after a time."""
    return any(
        item["state"] == "tracked"
        and item["seen_ms"] is not None
        and came_s - item["seen_ms"] / 1e3 > after_s
        for item in said["objects"]
    )
