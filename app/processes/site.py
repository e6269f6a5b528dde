"""The simulated site's process."""

from __future__ import annotations

import os
import threading
from dataclasses import replace

from app import child
from app.processes.common import connect, load
from app.processes.config import SiteConfig
from sim.rig import Staging
from sim.scenario import load_scenario
from sim.site import LiveSite, site_clock
from wire.clock import SystemClock

POLL_S = 0.02


def staging_of(config: SiteConfig) -> Staging:
    """Return what the session is made of.

    Raises:
        InputError: a file, scenario, level or stream that is wrong or does not exist.
    """
    site, robot, database = load(config.files)
    scenario = load_scenario(config.scenario)
    if config.vio is not None:
        scenario = replace(scenario, vio=config.vio)
    if config.delays_ms:
        scenario = scenario.with_delays(config.delays_ms)
    return Staging(
        site=site,
        robot=robot,
        database=database,
        scenario=scenario,
        seed=config.seed,
        keys=config.bus.keys,
    )


def main(config: SiteConfig, stop: threading.Event) -> None:
    """Simulate until asked to stop."""
    # The camera thread rasterises itself: helpers of the software renderer, which it would start
    # at the first touch of the library, cost a fifth more and take the cores of the tracker.
    os.environ.setdefault("LP_NUM_THREADS", "0")
    staging = staging_of(config)
    with connect(config.bus) as bus:
        site = LiveSite(bus, staging=staging, clock=site_clock(staging, SystemClock()))
        threading.Thread(target=_announce, args=(site, stop), daemon=True).start()
        site.run(stop)


def _announce(site: LiveSite, stop: threading.Event) -> None:
    """Say that it is ready once it draws."""
    while not site.renderer:
        if stop.wait(POLL_S):
            return
    child.tell("ready", renderer=site.renderer)


if __name__ == "__main__":
    child.run(SiteConfig, main)
