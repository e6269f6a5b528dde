"""The tracker's process: images and motion from the bus, tracked objects back onto it."""

from __future__ import annotations

import logging
import sys
import threading
from collections.abc import Callable
from typing import TypeVar

from app import child
from app.perception import Perception
from app.processes.common import HealthVoice, connect, load
from app.processes.config import TrackerConfig
from spatial.errors import MessageError
from wire.bus import Bus, Subscription
from wire.clock import SystemClock
from wire.codec import decode_calibration, decode_image, decode_joints, decode_motion, encode
from wire.keys import Keys

FIFO = 512
"""Two seconds of the fastest stream."""
BEHIND = 8
"""With more odometry samples waiting than this, only the newest is answered."""
SWITCH_S = 0.001
"""How soon the motion thread gets its turn while an image is looked at [s]."""
T = TypeVar("T")
log = logging.getLogger("tracker")


class TrackerProcess:
    """Threads around a `Perception`: one per camera for images, one for motion."""

    def __init__(self, bus: Bus, keys: Keys, perception: Perception) -> None:
        """Subscribe to the sensors."""
        self._bus = bus
        self._keys = keys
        self._perception = perception
        self._joints = bus.subscribe(keys.joints, capacity=FIFO)
        self._motion = bus.subscribe(keys.vio, capacity=FIFO)
        self._calibrations = [
            bus.subscribe(keys.calibration(name), capacity=4, latched=True)
            for name in perception.cameras
        ]
        self._images = {n: bus.subscribe(keys.image(n), capacity=1) for n in perception.cameras}
        self._refused = 0
        self._looked = dict.fromkeys(perception.cameras, 0)

    def watch(self, camera: str, stop: threading.Event) -> None:
        """Look at the newest image of one camera, again and again."""
        subscription = self._images[camera]
        while not stop.is_set():
            if subscription.wait(0.1):
                for sample in subscription.take()[-1:]:
                    self._look(camera, sample.payload)

    def move(self) -> None:
        """Take calibrations, joints and odometry; answer every odometry sample."""
        for latched in self._calibrations:
            for calibration in self._decoded(latched, decode_calibration):
                self._perception.put_calibration(calibration)
        self._motion.wait(0.05)
        for joints in self._decoded(self._joints, decode_joints):
            self._perception.put_joints(joints)
        waiting = self._decoded(self._motion, decode_motion)
        for index, sample in enumerate(waiting):
            self._perception.put_motion(sample)
            if len(waiting) - index <= BEHIND:
                self._answer()

    def figures(self) -> dict[str, float]:
        """Return counters for the health message."""
        looked = {f"images_{name}": float(count) for name, count in self._looked.items()}
        dropped = {f"skipped_{name}": float(s.dropped) for name, s in self._images.items()}
        return {"refused": float(self._refused), **looked, **dropped}

    def _answer(self) -> None:
        tracked = self._perception.predict()
        if tracked is not None:
            message = encode(tracked)
            self._bus.publish(self._keys.tracked, message.payload, schema=message.schema)

    def _look(self, camera: str, payload: bytes) -> None:
        try:
            _, reports = self._perception.observe(decode_image(payload))
        except MessageError as error:
            self._refused += 1
            log.debug("image of %s dropped: %s", camera, error)
            return
        self._looked[camera] += 1
        for report in reports:
            message = encode(report)
            self._bus.publish(self._keys.track_report, message.payload, schema=message.schema)

    def _decoded(self, subscription: Subscription, decode: Callable[[bytes], T]) -> list[T]:
        values = []
        for sample in subscription.take():
            try:
                values.append(decode(sample.payload))
            except MessageError as error:
                self._refused += 1
                log.debug("dropped from %s: %s", sample.key, error)
        return values


def main(config: TrackerConfig, stop: threading.Event) -> None:
    """Run until asked to stop."""
    sys.setswitchinterval(SWITCH_S)
    site, robot, database = load(config.files)
    perception = Perception(site=site, robot=robot, database=database, method=config.method)
    clock = SystemClock()
    keys = config.bus.keys
    with connect(config.bus) as bus:
        process = TrackerProcess(bus, keys, perception)
        voice = HealthVoice(bus, keys, clock, component="tracker")
        watchers = [
            threading.Thread(target=process.watch, args=(camera, stop), daemon=True)
            for camera in perception.cameras
        ]
        for watcher in watchers:
            watcher.start()
        child.tell("ready")
        while not stop.is_set():
            process.move()
            voice.tick(process.figures())
        for watcher in watchers:  # they publish: the bus stays open until they have ended
            watcher.join()


if __name__ == "__main__":
    child.run(TrackerConfig, main)
