"""The recorder's process: everything of a session into one file."""

from __future__ import annotations

import itertools
import logging
import threading
from pathlib import Path

from app import child
from app.processes.common import HealthVoice, connect, load
from app.processes.config import RecorderConfig
from scene.database import Database
from scene.site import Site
from wire.clock import SystemClock
from wire.recorder import Recorder

POLL_S = 0.1
log = logging.getLogger("recorder")


def main(config: RecorderConfig, stop: threading.Event) -> None:
    """Record until asked to stop."""
    site, _, database = load(config.files)
    clock, keys = SystemClock(), config.bus.keys
    path = free_path(Path(config.path))
    if path != Path(config.path):
        log.warning("the recording goes on in %s", path)
    with (
        connect(config.bus) as bus,
        Recorder(
            bus,
            path,
            keys=keys,
            clock=clock,
            with_truth=config.with_truth,
            topics=tuple(config.topics),
        ) as recorder,
    ):
        attach(recorder, site, database)
        voice = HealthVoice(bus, keys, clock, component="recorder")
        child.tell("ready")
        while not stop.wait(POLL_S):
            status = recorder.status
            voice.tick(
                {"messages": float(status.messages), "dropped": float(status.dropped)},
                worry=status.error,
            )
    final = recorder.status
    child.tell("figures", figures={"messages": final.messages, "dropped": final.dropped})


def free_path(path: Path) -> Path:
    """Return a path, or `NAME-2` and so on where a recorder that died has left its file."""
    numbered = (path.with_stem(f"{path.stem}-{number}") for number in itertools.count(2))
    return next(p for p in itertools.chain((path,), numbered) if not p.exists())


def attach(recorder: Recorder, site: Site, database: Database) -> None:
    """Put in what the recording was made with: site file, robot, objects."""
    recorder.attach("site.toml", site.path.read_bytes(), media_type="application/toml")
    recorder.attach("robot.urdf", site.robot.read_bytes(), media_type="application/xml")
    for item in site.objects:
        entry = database.entries[item.slug]
        text = (entry.folder / "object.toml").read_bytes()
        recorder.attach(f"objects/{item.slug}/object.toml", text, media_type="application/toml")


if __name__ == "__main__":
    child.run(RecorderConfig, main)
