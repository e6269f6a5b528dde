"""The scripted operator's process: sees what the page shows, moves the tool."""

from __future__ import annotations

import threading

from app import child
from app.processes.common import connect, load
from app.processes.config import OperatorConfig
from app.time_source import TimeSource
from sim.operator import run_operator
from sim.scenario import load_scenario


def main(config: OperatorConfig, stop: threading.Event) -> None:
    """Operate until asked to stop."""
    site, robot, database = load(config.files)
    keys = config.bus.keys
    with connect(config.bus) as bus:
        time_source = TimeSource(bus, keys, mode=site.clock_mode, replay=False)
        follower = threading.Thread(target=time_source.follow, args=(stop,), daemon=True)
        follower.start()
        child.tell("ready")
        run_operator(
            bus,
            keys=keys,
            clock=time_source.clock,
            site=site,
            robot=robot,
            database=database,
            stop=stop,
            plan=load_scenario(config.scenario).operator,
            seed=config.seed,
        )
        follower.join()  # it publishes: the bus stays open until it has ended


if __name__ == "__main__":
    child.run(OperatorConfig, main)
