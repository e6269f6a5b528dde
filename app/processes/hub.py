"""The hub's process: everybody on one side of the radio meets here."""

from __future__ import annotations

import threading

from app import child
from app.processes.config import HubConfig
from wire.hub import Hub


def main(config: HubConfig, stop: threading.Event) -> None:
    """Run until asked to stop."""
    with Hub(listen=config.listen, dial=config.dial, truth_password=config.truth_password) as hub:
        child.tell("ready", endpoint=hub.endpoint)
        stop.wait()


if __name__ == "__main__":
    child.run(HubConfig, main)
