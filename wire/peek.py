"""The capture stamp of a message, read from its first bytes without decoding it.

Our messages have `fixed64 stamp_ns = 1`; Foxglove's have a Timestamp as field 1, FrameTransforms
a list of messages that have. Serialisation writes fields in order, so the stamp comes first.
"""

from __future__ import annotations

from wire.schemas import is_json

_FIXED64_FIELD_1 = 0x09
_MESSAGE_FIELD_1 = 0x0A
_SECONDS = 0x08
_NANOS = 0x10
_MAX_STAMP_NS = 2**63
_MAX_VARINT = 10
NESTED = frozenset({"foxglove.FrameTransforms"})


def capture_stamp_ns(payload: bytes, schema: str) -> int | None:
    """Return the capture stamp [ns] of a message; `None` where it is not in the first bytes."""
    if is_json(schema):
        return None
    try:
        stamp_ns = _stamp(payload, nested=schema in NESTED)
    except (IndexError, ValueError):  # not the bytes they claim to be: no stamp, no harm
        return None
    return stamp_ns if 0 < stamp_ns < _MAX_STAMP_NS else None


def _stamp(payload: bytes, *, nested: bool) -> int:
    if payload[0] == _FIXED64_FIELD_1 and len(payload) >= 9:
        return int.from_bytes(payload[1:9], "little")
    if payload[0] != _MESSAGE_FIELD_1:
        raise ValueError(payload[0])
    length, start = _varint(payload, 1)
    if start + length > len(payload):
        raise ValueError(length)
    if nested:
        return _stamp(payload[start : start + length], nested=False)
    return _timestamp(payload[start : start + length])


def _timestamp(payload: bytes) -> int:
    seconds = nanos = position = 0
    while position < len(payload):
        tag = payload[position]
        value, position = _varint(payload, position + 1)
        if tag == _SECONDS:
            seconds = value
        elif tag == _NANOS:
            nanos = value
        else:
            raise ValueError(tag)
    return seconds * 1_000_000_000 + nanos


def _varint(payload: bytes, position: int) -> tuple[int, int]:
    """Return a varint and the position behind it."""
    value = 0
    for index in range(_MAX_VARINT):
        byte = payload[position + index]
        value |= (byte & 0x7F) << (7 * index)
        if byte < 0x80:
            return value, position + index + 1
    raise ValueError(position)
