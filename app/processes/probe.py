"""The probe's process: a tab without a browser."""

from __future__ import annotations

import asyncio
import threading

from app import child
from app.probe import Probe
from app.processes.config import ProbeConfig
from wire.clock import SystemClock


def main(config: ProbeConfig, stop: threading.Event) -> None:
    """Measure until asked to stop, then tell the figures."""
    child.give_way()
    probe = Probe(config.url, clock=SystemClock())

    async def measure() -> None:
        ended = asyncio.Event()
        task = asyncio.create_task(probe.run(ended))
        child.tell("ready")
        await asyncio.to_thread(stop.wait)
        ended.set()
        await task

    asyncio.run(measure())
    child.tell("figures", figures=probe.figures.summary())


if __name__ == "__main__":
    child.run(ProbeConfig, main)
