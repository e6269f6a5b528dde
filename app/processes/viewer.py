"""The viewer's process: the station's loop, the gate and the page."""

from __future__ import annotations

import logging
import sys
import threading

from app import child
from app.gate import GateSettings
from app.live import LiveChannel
from app.looks import StageLook, link_looks, object_look
from app.processes.common import HealthVoice, connect, load, pace
from app.processes.config import ViewerConfig
from app.stage import Stage
from app.station import Station
from app.time_source import TimeSource
from app.viser_port import ViserPort
from scene.builder import SceneBuilder
from scene.database import Database
from scene.robot import Robot
from scene.site import Site

SWITCH_S = 0.001
log = logging.getLogger("viewer")


def stage_look(site: Site, robot: Robot, database: Database) -> StageLook:
    """Return everything the stage draws of a site."""
    entries = [database.entries[item.slug] for item in site.objects]
    return StageLook(
        links=link_looks(robot),
        objects=tuple(
            object_look(
                entry.slug,
                entry.mesh,
                name=entry.name,
                fixtures=entry.fixtures if site.fixtures else (),
            )
            for entry in entries
        ),
        cameras={name: camera.intrinsics for name, camera in site.cameras.items()},
    )


def main(config: ViewerConfig, stop: threading.Event) -> None:
    """Run until asked to stop."""
    sys.setswitchinterval(SWITCH_S)
    site, robot, database = load(config.files)
    for warning in robot.warnings:
        log.warning("%s (%s)", warning, site.robot)
    keys = config.bus.keys
    live = LiveChannel({name: camera.intrinsics for name, camera in site.cameras.items()})
    settings = GateSettings(host=config.host, port=config.port, token=config.token)
    with ViserPort(settings, live=live) as port, connect(config.bus) as bus:
        child.tell("ready", url=port.url, port=port.gate.port)
        time_source = TimeSource(bus, keys, mode=site.clock_mode, replay=config.replay)
        station = Station(
            bus=bus,
            keys=keys,
            time_source=time_source,
            site=site,
            database=database,
            builder=SceneBuilder(site, robot, database),
            stage=Stage(port, stage_look(site, robot, database)),
            live=live,
        )
        voice = HealthVoice(bus, keys, time_source.clock, component="viewer")

        def tick() -> None:
            time_source.tick()
            station.tick()
            voice.tick({"tabs": float(port.clients), "refused": float(station.refused)})

        pace(stop, rate_hz=config.rate_hz, tick=tick)
        station.close()
        live.close()


if __name__ == "__main__":
    child.run(ViewerConfig, main)
