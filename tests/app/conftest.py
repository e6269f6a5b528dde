from __future__ import annotations

from pathlib import Path

import pytest

from app.commands.track import load
from app.lockstep import record_lockstep
from app.processes.config import BusConfig, SiteConfig, SiteFiles
from scene.database import Database
from scene.robot import Robot
from scene.site import DEFAULT_SITE, Site

DURATION_S = 1.5
RATES_HZ = {"hc": 6.0, "mako": 5.0}


def record(path: Path, *, seed: int = 1, duration_s: float = DURATION_S) -> Path:
    """Record a painted session of a few images."""
    config = SiteConfig(
        bus=BusConfig(endpoint="", site="sam"),
        files=SiteFiles(site=str(DEFAULT_SITE)),
        scenario="pick",
        seed=seed,
    )
    record_lockstep(
        config,
        path=path,
        duration_s=duration_s,
        with_truth=True,
        backend="painter",
        rates_hz=RATES_HZ,
    )
    return path


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A painted session with the truth in it."""
    return record(tmp_path_factory.mktemp("lockstep") / "session.mcap")


@pytest.fixture(scope="session")
def loaded() -> tuple[Site, Robot, Database]:
    """Site, robot and objects as shipped."""
    return load(DEFAULT_SITE, objects=None)
