"""Messages about time: clock probes, the playback clock, event marks."""

from __future__ import annotations

from dataclasses import dataclass

from spatial.errors import MessageError
from wire.codec_parts import (
    Encoded,
    checked_name,
    checked_number,
    checked_stamp,
    checked_text,
    parse,
)
from wire.generated.telepresence.v1 import telepresence_pb2 as pb

PROBE_SCHEMA = "telepresence.v1.ClockProbe"
PLAYBACK_SCHEMA = "telepresence.v1.PlaybackClock"
EVENT_SCHEMA = "telepresence.v1.EventMark"


@dataclass(frozen=True, slots=True)
class ClockProbe:
    """A question for the time of a site, or its answer."""

    asker: int
    """Random number of who asks."""
    sequence: int
    """Number of the question."""
    asked_ns: int
    """The asker's own clock when it asked [ns]."""
    heard_ns: int = 0
    """The site's clock when it heard the question [ns]; 0 in a question."""
    answered_ns: int = 0
    """The site's clock when it answered [ns]; 0 in a question."""

    @property
    def is_answer(self) -> bool:
        """Whether a site has filled it in."""
        return self.answered_ns > 0


@dataclass(frozen=True, slots=True)
class PlaybackState:
    """Where a playback stands: the source of time in a replay."""

    stamp_ns: int
    """Recorded instant shown now [ns]."""
    speed: float
    """Recorded seconds per second."""
    playing: bool
    """Whether it moves."""
    first_ns: int
    """First instant of the recording [ns]."""
    last_ns: int
    """Last instant of the recording [ns]."""
    jumps: int
    """Raised by one at every seek and every loop."""


@dataclass(frozen=True, slots=True)
class EventMark:
    """Something worth finding again in a recording."""

    stamp_ns: int
    """When it happened [ns]."""
    name: str
    """Kind of the event, short."""
    text: str
    """One sentence."""


def encode_probe(probe: ClockProbe) -> Encoded:
    """Encode a question or an answer."""
    message = pb.ClockProbe(
        stamp_ns=probe.answered_ns,
        asker=probe.asker,
        sequence=probe.sequence,
        asked_ns=probe.asked_ns,
        heard_ns=probe.heard_ns,
    )
    return Encoded(message.SerializeToString(), PROBE_SCHEMA)


def decode_probe(payload: bytes) -> ClockProbe:
    """Decode a question or an answer.

    Raises:
        MessageError: not such a message, or an answer given before the question was heard.
    """
    message = parse(pb.ClockProbe, payload)
    if message.asker == 0 or (message.heard_ns == 0) != (message.stamp_ns == 0):
        raise MessageError("clock probe without an asker or with half an answer")
    if message.stamp_ns < message.heard_ns:
        raise MessageError(f"probe answered {message.heard_ns - message.stamp_ns} ns before heard")
    return ClockProbe(
        asker=message.asker,
        sequence=message.sequence,
        asked_ns=message.asked_ns,
        heard_ns=message.heard_ns,
        answered_ns=message.stamp_ns,
    )


def encode_playback(state: PlaybackState) -> Encoded:
    """Encode where a playback stands."""
    message = pb.PlaybackClock(
        stamp_ns=state.stamp_ns,
        speed=state.speed,
        playing=state.playing,
        first_ns=state.first_ns,
        last_ns=state.last_ns,
        jumps=state.jumps,
    )
    return Encoded(message.SerializeToString(), PLAYBACK_SCHEMA)


def decode_playback(payload: bytes) -> PlaybackState:
    """Decode where a playback stands.

    Raises:
        MessageError: not such a message, a bad stamp, or a speed not finite.
    """
    message = parse(pb.PlaybackClock, payload)
    return PlaybackState(
        stamp_ns=checked_stamp(message.stamp_ns),
        speed=checked_number("speed", message.speed),
        playing=message.playing,
        first_ns=message.first_ns,
        last_ns=message.last_ns,
        jumps=message.jumps,
    )


def encode_event(event: EventMark) -> Encoded:
    """Encode an event mark."""
    message = pb.EventMark(stamp_ns=event.stamp_ns, name=event.name, text=event.text)
    return Encoded(message.SerializeToString(), EVENT_SCHEMA)


def decode_event(payload: bytes) -> EventMark:
    """Decode an event mark.

    Raises:
        MessageError: not such a message, no stamp, no name, or too long a text.
    """
    message = parse(pb.EventMark, payload)
    return EventMark(
        stamp_ns=checked_stamp(message.stamp_ns),
        name=checked_name("event", message.name),
        text=checked_text("event text", message.text),
    )
