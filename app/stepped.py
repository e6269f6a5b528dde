"""A `Perception` on virtual time: messages in order of arrival in, tracked objects out.

    an image is looked at for `processing_ns` from its arrival, or from the end of the look before;
    of the images that arrive meanwhile the newest is next, as in a live process;
    every odometry sample is answered at its arrival with all objects

Lock-step and re-tracking share it, so a recording tracked again gives the poses it was made with.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from app.perception import Perception
from spatial.errors import InputError
from spatial.samples import ImageSample
from spatial.tracked import TrackedObjects, TrackReport
from wire.codec import decode_calibration, decode_image, decode_joints, decode_motion
from wire.keys import Keys

MAX_REASONS = 3
"""Different reasons for refused messages that are remembered."""


class Listener(Protocol):
    """Takes what a tracker says."""

    def tracked(self, at_ns: int, tracked: TrackedObjects) -> None:
        """Take all objects, said at `at_ns` [ns]."""
        ...

    def reports(self, at_ns: int, reports: tuple[TrackReport, ...]) -> None:
        """Take what became of an image, said at `at_ns` [ns]."""
        ...


@dataclass(slots=True, eq=False)
class _Look:
    """The worker of one camera."""

    image: ImageSample | None = None
    done_ns: int = 0
    waiting: ImageSample | None = None


class SteppedTracker:
    """Feeds a `Perception` from messages and says when each answer was ready."""

    def __init__(
        self, perception: Perception, *, site: str, processing_ns: int, listener: Listener
    ) -> None:
        """Wait for messages.

        Args:
            perception: what is fed.
            site: name of the site, as topics begin.
            processing_ns: virtual time an image takes [ns].
            listener: takes the answers.
        """
        self._perception = perception
        self._processing_ns = processing_ns
        self._listener = listener
        self._looks = {camera: _Look() for camera in perception.cameras}
        self._said_ns = 0
        self._handlers = self._handled(Keys(site=site))
        self.frames = 0
        """Images looked at."""
        self.skipped = 0
        """Images that a younger one overtook."""
        self.refused = 0
        """Messages that could not be used."""
        self.reasons: list[str] = []
        """Why, each reason once and the first few only."""

    @property
    def topics(self) -> list[str]:
        """Topics it listens to."""
        return sorted(self._handlers)

    def advance(self, now_ns: int) -> None:
        """End every look that is over by `now_ns` [ns]."""
        while True:
            busy = [look for look in self._looks.values() if look.image is not None]
            first = min(busy, key=lambda look: look.done_ns, default=None)
            if first is None or first.done_ns > now_ns:
                return
            self._end(first)

    def put(self, arrived_ns: int, topic: str, payload: bytes) -> None:
        """Take one message; those of other topics only pass the time.

        Args:
            arrived_ns: when it arrived, not earlier than the one before [ns].
            topic: its key without the session.
            payload: its bytes.
        """
        self.advance(arrived_ns)
        handler = self._handlers.get(topic)
        if handler is None:
            return
        try:
            handler(arrived_ns, payload)
        except InputError as error:
            self._refuse(error)
        self.advance(arrived_ns)

    def finish(self) -> None:
        """End every look that has begun."""
        while any(look.image is not None for look in self._looks.values()):
            self.advance(max(look.done_ns for look in self._looks.values()))

    def _handled(self, keys: Keys) -> dict[str, Callable[[int, bytes], None]]:
        perception = self._perception
        by_key: dict[str, Callable[[int, bytes], None]] = {
            keys.vio: self._put_motion,
            keys.joints: lambda _, payload: perception.put_joints(decode_joints(payload)),
        }
        for camera in perception.cameras:
            by_key[keys.image(camera)] = self._put_image
            by_key[keys.calibration(camera)] = lambda _, payload: perception.put_calibration(
                decode_calibration(payload)
            )
        return {keys.topic(key) or key: handler for key, handler in by_key.items()}

    def _put_motion(self, arrived_ns: int, payload: bytes) -> None:
        self._perception.put_motion(decode_motion(payload))
        self._say(arrived_ns)

    def _say(self, at_ns: int) -> None:
        tracked = self._perception.predict()
        if tracked is not None and tracked.stamp_ns > self._said_ns:
            self._said_ns = tracked.stamp_ns
            self._listener.tracked(at_ns, tracked)

    def _put_image(self, arrived_ns: int, payload: bytes) -> None:
        image = decode_image(payload)
        if image.camera not in self._looks:
            self._perception.observe(image)  # says which cameras there are
            return
        look = self._looks[image.camera]
        if look.image is None:
            look.image, look.done_ns = image, arrived_ns + self._processing_ns
            return
        self.skipped += look.waiting is not None
        look.waiting = image

    def _end(self, look: _Look) -> None:
        image, at_ns = look.image, look.done_ns
        assert image is not None
        look.image, look.waiting = look.waiting, None
        look.done_ns += self._processing_ns
        try:
            _, reports = self._perception.observe(image)
        except InputError as error:
            self._refuse(error)
            return
        self.frames += 1
        self._listener.reports(at_ns, reports)
        if not self._perception.has_motion:
            self._say(at_ns)

    def _refuse(self, error: InputError) -> None:
        self.refused += 1
        reason = str(error)
        if reason not in self.reasons and len(self.reasons) < MAX_REASONS:
            self.reasons.append(reason)
