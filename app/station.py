"""The operator station's loop: streams in, one scene state per tick, drawn and told to all tabs.

Live and playback run this same object; only the session prefix and the clock differ.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

from app.live import LiveChannel
from app.stage import Stage
from app.status import status_of
from app.time_source import TimeSource
from scene.builder import SceneBuilder
from scene.database import Database
from scene.graph import SceneState
from scene.site import Site
from spatial.errors import MessageError
from spatial.samples import HealthSample, ImageSample
from wire.bus import Bus, Subscription
from wire.codec import (
    decode_health,
    decode_image,
    decode_joints,
    decode_motion,
    decode_report,
    decode_tracked,
)
from wire.keys import Keys

LINK_LOST_MS = 500.0
"""Joint states older than this mean that nothing comes from the site [ms]."""
FIFO = 512
"""Two seconds of the fastest stream."""
T = TypeVar("T")
log = logging.getLogger("station")


@dataclass(slots=True, eq=False)
class Inlet:
    """One subscription and what its bytes mean."""

    subscription: Subscription
    """Where bytes come from."""
    take: Callable[[bytes], None]
    """Decodes and stores one message."""
    refused: int = 0
    """Messages that did not decode."""


class Station:
    """Everything between the bus and the page; `tick` from one thread."""

    def __init__(
        self,
        *,
        bus: Bus,
        keys: Keys,
        time_source: TimeSource,
        site: Site,
        database: Database,
        builder: SceneBuilder,
        stage: Stage,
        live: LiveChannel,
    ) -> None:
        """Subscribe to the streams of the site.

        Args:
            bus: the bus.
            keys: of the session to show.
            time_source: the site's clock, or the player's.
            site: whose cameras and objects are shown.
            database: names of the objects.
            builder: makes states.
            stage: draws them.
            live: tells tabs.
        """
        self._time = time_source
        self._site = site
        self._builder = builder
        self._stage = stage
        self._live = live
        self._health: dict[str, HealthSample] = {}
        self._names = {slug: entry.name for slug, entry in database.entries.items()}

        def inlet(key: str, take: Callable[[bytes], None], *, capacity: int = FIFO) -> Inlet:
            return Inlet(bus.subscribe(key, capacity=capacity), take)

        self._inlets = [
            inlet(keys.joints, _then(decode_joints, builder.put_joints)),
            # The newest of these says all that the ones before it said.
            inlet(keys.vio, _then(decode_motion, builder.put_motion), capacity=1),
            inlet(keys.tracked, _then(decode_tracked, builder.put_tracked), capacity=1),
            inlet(keys.track_report, _then(decode_report, builder.put_report)),
            inlet(keys.all_health, _then(decode_health, self._hear), capacity=64),
            *(
                inlet(keys.video(name), _then(decode_image, self._look), capacity=1)
                for name in site.cameras
            ),
        ]

    def tick(self) -> SceneState:
        """Take what came, build the state of this instant, draw it and tell it."""
        for inlet in self._inlets:
            for sample in inlet.subscription.take():
                try:
                    inlet.take(sample.payload)
                except MessageError as error:
                    inlet.refused += 1
                    log.debug("dropped from %s: %s", sample.key, error)
        state = self._builder.build(self._time.clock.now_ns())
        if self._stage.show(state):
            self._live.offer_status(self._status(state))
        return state

    @property
    def refused(self) -> int:
        """Messages that did not decode, since the start."""
        return sum(inlet.refused for inlet in self._inlets)

    def close(self) -> None:
        """End the subscriptions."""
        for inlet in self._inlets:
            inlet.subscription.close()

    def _look(self, image: ImageSample) -> None:
        if image.camera in self._site.cameras:
            self._live.offer_frame(
                image.camera,
                stamp_ns=image.stamp_ns,
                jpeg=image.jpeg,
                T_base_cam=self._builder.camera_at(image.camera, image.stamp_ns),
            )

    def _hear(self, health: HealthSample) -> None:
        self._health[health.component] = health

    def _status(self, state: SceneState) -> dict[str, Any]:
        silent = state.robot_ms is None or state.robot_ms > LINK_LOST_MS
        worries = [h.text for h in self._health.values() if h.level != "ok" and h.text]
        return status_of(
            state,
            site=self._site.name,
            target=self._site.target,
            names=self._names,
            replay=self._time.replay is not None,
            rate=self._rate(),
            clock_bound_ms=self._time.bound_ms,
            link="lost" if silent else "ok",
            note="; ".join(worries),
        )

    def _rate(self) -> float:
        """How fast T* runs against the wall clock."""
        state = self._time.replay.state if self._time.replay is not None else None
        if state is None:
            return 1.0
        return state.speed if state.playing else 0.0


def _then(decode: Callable[[bytes], T], use: Callable[[T], None]) -> Callable[[bytes], None]:
    return lambda payload: use(decode(payload))
