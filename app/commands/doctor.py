"""`telepresence doctor`: what works on this machine, and what to install where it does not."""

from __future__ import annotations

import ctypes.util
import importlib.metadata
import os
import platform
import shutil
import socket
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from app.report import print_json, say

PACKAGES = (
    "viser",
    "trimesh",
    "yourdfpy",
    "numpy",
    "opencv-python-headless",
    "eclipse-zenoh",
    "mcap",
    "mujoco-core",
)
DEFAULT_PORT = 8080

EXAMPLE = """Say what works on this machine and what to install.

Example: telepresence doctor --json
"""
Finding = tuple[bool, str]


@click.command(help=EXAMPLE)
@click.option("--json", "as_json", is_flag=True, help="One line of JSON.")
def command(*, as_json: bool) -> None:
    """Run the command."""
    checks: dict[str, Callable[[], Finding]] = {
        "python": _python,
        "packages": _packages,
        "gl": _gl,
        "chromium": _chromium,
        "port": _port,
        "cameras": _cameras,
        "clock": _clock,
        "cores": _cores,
    }
    findings = {name: check() for name, check in checks.items()}
    if as_json:
        rows: dict[str, Any] = {n: {"ok": ok, "text": text} for n, (ok, text) in findings.items()}
        print_json(rows)
        return
    for name, (ok, text) in findings.items():
        say(f"{'ok  ' if ok else 'MISS'} {name:9} {text}")


def _python() -> Finding:
    return sys.version_info >= (3, 11), f"{platform.python_version()}, 3.11 or newer is needed"


def _packages() -> Finding:
    found, missing = [], []
    for name in PACKAGES:
        try:
            found.append(f"{name} {importlib.metadata.version(name)}")
        except importlib.metadata.PackageNotFoundError:
            missing.append(name)
    text = ", ".join(found) + (f"; missing: {', '.join(missing)}" if missing else "")
    return not missing, text


def _gl() -> Finding:
    if ctypes.util.find_library("EGL") is not None:
        return True, "EGL renders the simulated cameras"
    if ctypes.util.find_library("OSMesa") is not None:
        return True, "OSMesa renders the simulated cameras"
    return False, "the painter draws simple images; better: apt-get install libegl1 libgl1-mesa-dri"


def _chromium() -> Finding:
    path = shutil.which("chromium") or shutil.which("google-chrome")
    if path is not None:
        return (
            True,
            f"{Path(path).name} for the browser tests; any browser with WebGL 2 shows the page",
        )
    return False, "only the browser tests need it: apt-get install chromium"


def _port() -> Finding:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", DEFAULT_PORT))
        except OSError as error:
            return False, f"{DEFAULT_PORT} is taken ({error.strerror}); choose another with --port"
    return True, f"{DEFAULT_PORT} is free on loopback"


def _cameras() -> Finding:
    devices = sorted(str(path) for path in Path("/dev").glob("video*"))
    return True, ", ".join(devices) or "none attached; the simulated site needs none"


def _clock() -> Finding:
    disciplined = any(
        Path(p).exists() for p in ("/run/chrony", "/run/systemd/timesync/synchronized")
    )
    text = "disciplined" if disciplined else "free running: use clock = measured for a remote site"
    return True, text


def _cores() -> Finding:
    count = os.cpu_count() or 1
    return count >= 2, f"{count}; the demo wants two"
