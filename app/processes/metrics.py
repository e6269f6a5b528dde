"""The metrics' process: reads the truth, which the product never sees, and the tracker's word."""

from __future__ import annotations

import threading

from app import child
from app.processes.common import connect
from app.processes.config import MetricsConfig
from sim.judge import Judge
from wire.clock import SystemClock


def main(config: MetricsConfig, stop: threading.Event) -> None:
    """Compare until asked to stop, then tell the figures."""
    child.give_way()
    clock = SystemClock()
    with connect(config.bus) as bus:
        judge = Judge(bus, keys=config.bus.keys, clock=clock)
        child.tell("ready")
        child.tell("figures", figures=judge.serve(stop))


if __name__ == "__main__":
    child.run(MetricsConfig, main)
