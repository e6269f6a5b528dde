"""The player's process: a recording back onto the bus, under a session of its own."""

from __future__ import annotations

import threading
from pathlib import Path

from app import child
from app.processes.common import connect
from app.processes.config import PlayerConfig
from spatial.stamp import nanoseconds
from wire.player import Player


def main(config: PlayerConfig, stop: threading.Event) -> None:
    """Play until asked to stop."""
    with (
        connect(config.bus) as bus,
        Player(
            Path(config.path),
            bus,
            keys=config.bus.keys,
            topics=tuple(config.topics),
            remap=config.remap,
            loop=config.loop,
        ) as player,
    ):
        player.set_speed(config.speed)
        player.seek(player.state.first_ns + nanoseconds(config.from_s))
        player.start()
        if not config.paused:
            player.play()
        child.tell("ready")
        stop.wait()


if __name__ == "__main__":
    child.run(PlayerConfig, main)
