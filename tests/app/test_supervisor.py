"""Processes: restarted when they die, gone when their parent is."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import msgspec
import psutil
import pytest

from app.supervisor import Supervisor
from spatial.errors import InputError

ROOT = Path(__file__).parents[2]
PARENT = """
import time
import msgspec
from app.supervisor import Supervisor

class Config(msgspec.Struct):
    fail: bool = False

with Supervisor() as supervisor:
    supervisor.start("one", "{module}", Config())
    supervisor.wait_event("one", "ready", timeout_s=20)
    print(supervisor.pids()["one"], flush=True)
    time.sleep(60)
"""
pytestmark = pytest.mark.processes


class Config(msgspec.Struct, frozen=True, kw_only=True):
    fail: bool = False


def eventually(condition: Callable[[], bool], *, within_s: float = 10.0) -> bool:
    deadline = time.monotonic() + within_s
    while time.monotonic() < deadline:
        if condition():
            return True
        time.sleep(0.02)
    return False


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    (tmp_path / "sample_child.py").write_text(
        "import msgspec\n"
        "from app import child\n"
        "from spatial.errors import InputError\n"
        "class Config(msgspec.Struct):\n"
        "    fail: bool = False\n"
        "def main(config, stop):\n"
        "    if config.fail:\n"
        "        raise InputError('a bad thing, expected a good one')\n"
        "    child.tell('ready', port=7)\n"
        "    stop.wait()\n"
        "if __name__ == '__main__':\n"
        "    child.run(Config, main)\n",
        encoding="utf-8",
    )
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}{os.pathsep}{ROOT}")
    return "sample_child"


def test_a_killed_process_comes_back_and_all_end_together(module: str) -> None:
    with Supervisor() as supervisor:
        supervisor.start("one", module, Config())
        assert supervisor.wait_event("one", "ready", timeout_s=20)["port"] == 7
        first = supervisor.pids()["one"]
        os.kill(first, signal.SIGKILL)
        assert eventually(lambda: supervisor.pids().get("one", first) != first)
        last = supervisor.pids()["one"]
    assert not psutil.pid_exists(last)


def test_the_reason_of_a_failure_reaches_whoever_waits(module: str) -> None:
    with Supervisor() as supervisor:
        supervisor.start("one", module, Config(fail=True), restart=False)
        with pytest.raises(InputError, match="one: a bad thing, expected a good one"):
            supervisor.wait_event("one", "ready", timeout_s=20)


def test_children_die_with_a_parent_that_is_killed(module: str) -> None:
    parent = subprocess.Popen(
        [
            sys.executable,
            "-c",
            PARENT.format(module=module),
        ],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert parent.stdout is not None
    child = int(parent.stdout.readline())
    parent.kill()
    parent.wait()
    parent.stdout.close()
    assert eventually(lambda: not psutil.pid_exists(child) or _is_zombie(child))


def _is_zombie(pid: int) -> bool:
    try:
        return psutil.Process(pid).status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True
