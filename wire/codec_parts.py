"""Pieces every message is made of: stamps, poses, covariances, checked where they come in.

A pose on the wire is x y z [m] and w x y z; a 6x6 covariance its upper triangle, row by row.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np
from google.protobuf.message import DecodeError, Message
from google.protobuf.timestamp_pb2 import Timestamp

from spatial.errors import InputError, MessageError
from spatial.frames import Frame
from spatial.pose import Pose
from spatial.rotation import UNIT_TOLERANCE, Array
from spatial.stamp import NS_PER_S

MAX_MESSAGE_BYTES = 16 * 1024 * 1024
MAX_NAME = 128
MAX_TEXT = 2048
MAX_ITEMS = 512
MAX_MAGNITUDE = 1e9
"""No length, speed, force or pixel of a site is larger; its square still fits everywhere."""
MAX_COVARIANCE = 1e38
_MAX_STAMP_NS = 2**63
_UPPER = np.triu_indices(6)
_UPPER_FLAT = np.ravel_multi_index(_UPPER, (6, 6))
_LOWER_FLAT = np.ravel_multi_index((_UPPER[1], _UPPER[0]), (6, 6))
_DIAGONAL = np.arange(6) * 7

M = TypeVar("M", bound=Message)
A = TypeVar("A", bound=Frame)
B = TypeVar("B", bound=Frame)


class _Translation(Protocol):
    x: float
    y: float
    z: float


class _Quaternion(Protocol):
    x: float
    y: float
    z: float
    w: float


@dataclass(frozen=True, slots=True)
class Encoded:
    """A message as it lies on the bus and in a recording."""

    payload: bytes
    """The bytes."""
    schema: str
    """Full name of the message, `foxglove.X`, `telepresence.v1.X` or a JSON schema's."""


def parse(kind: type[M], payload: bytes) -> M:
    """Return the protobuf message in the bytes.

    Raises:
        MessageError: too large, or not bytes of this message.
    """
    name = kind.DESCRIPTOR.full_name
    if len(payload) > MAX_MESSAGE_BYTES:
        raise MessageError(f"{name} of {len(payload)} bytes, at most {MAX_MESSAGE_BYTES} allowed")
    try:
        return kind.FromString(payload)
    except DecodeError as error:
        raise MessageError(f"{len(payload)} bytes are no {name}: {error}") from error


def put_stamp(target: Timestamp, stamp_ns: int) -> None:
    """Write a stamp [ns] into Foxglove's seconds and nanoseconds."""
    target.seconds, target.nanos = divmod(stamp_ns, NS_PER_S)


def stamp_of(source: Timestamp) -> int:
    """Return the stamp [ns] in Foxglove's seconds and nanoseconds.

    Raises:
        MessageError: it is not positive or its nanoseconds are not below one second.
    """
    if not 0 <= source.nanos < NS_PER_S:
        raise MessageError(f"stamp with {source.nanos} ns past the second, expected 0 to 1e9")
    return checked_stamp(source.seconds * NS_PER_S + source.nanos)


def checked_stamp(stamp_ns: int) -> int:
    """Return a capture stamp [ns] that can be one.

    Raises:
        MessageError: it is not positive, or beyond 63 bits.
    """
    if 0 < stamp_ns < _MAX_STAMP_NS:
        return stamp_ns
    raise MessageError(f"stamp {stamp_ns} ns, expected nanoseconds since 1970")


def checked_name(what: str, name: str, *, limit: int = MAX_NAME) -> str:
    """Return a name of one to `limit` characters.

    Raises:
        MessageError: it is empty or longer.
    """
    if 0 < len(name) <= limit:
        return name
    raise MessageError(f"{what} of {len(name)} characters, expected 1 to {limit}")


def checked_text(what: str, text: str) -> str:
    """Return a text for people, not longer than people read.

    Raises:
        MessageError: it is longer.
    """
    if len(text) <= MAX_TEXT:
        return text
    raise MessageError(f"{what} of {len(text)} characters, at most {MAX_TEXT} allowed")


def checked_count(what: str, count: int) -> None:
    """Refuse a list that no site has.

    Raises:
        MessageError: more than `MAX_ITEMS` entries.
    """
    if count > MAX_ITEMS:
        raise MessageError(f"{count} {what}, at most {MAX_ITEMS} allowed")


def checked_number(what: str, value: float) -> float:
    """Return a finite number.

    Raises:
        MessageError: it is not finite.
    """
    if math.isfinite(value):
        return value
    raise MessageError(f"{what} is {value}, expected a finite number")


def vector(what: str, values: Iterable[float], size: int, *, limit: float = MAX_MAGNITUDE) -> Array:
    """Return a read-only vector (size,) of finite numbers.

    Raises:
        MessageError: another length, a number that is not finite or beyond the limit.
    """
    numbers = list(values)
    if len(numbers) != size:
        raise MessageError(f"{what} has {len(numbers)} numbers, expected {size}")
    if numbers and (
        not (min(numbers) >= -limit and max(numbers) <= limit) or math.isnan(math.fsum(numbers))
    ):
        raise MessageError(f"{what} {numbers} is not finite within {limit:g}")
    array = np.array(numbers, dtype=np.float64)
    array.flags.writeable = False
    return array


def pose_numbers(pose: Pose[A, B]) -> list[float]:
    """Return x y z w x y z of a pose."""
    numbers: list[float] = pose.translation.tolist()
    quaternion: list[float] = pose.quaternion_wxyz.tolist()
    return numbers + quaternion


def pose_of(what: str, numbers: Iterable[float]) -> Pose[A, B]:
    """Return the pose of x y z w x y z; the caller's annotation names the frames.

    Raises:
        MessageError: not seven finite numbers, or a quaternion that is not of unit length.
    """
    checked = vector(what, numbers, 7)
    try:
        return Pose.parse(checked[:3], checked[3:])
    except InputError as error:
        raise MessageError(f"{what}: {error}") from error


def unit_wxyz(numbers: Array) -> Array:
    """Return a quaternion (4,), wxyz, of exactly unit length with w >= 0.

    Raises:
        MessageError: it is not of unit length.
    """
    length = math.hypot(*numbers.tolist())
    if not abs(length - 1.0) < UNIT_TOLERANCE:
        raise MessageError(f"quaternion {numbers.tolist()} is not of unit length")
    return numbers / (length if numbers[0] >= 0.0 else -length)


def put_foxglove_pose(translation: _Translation, rotation: _Quaternion, pose: Pose[A, B]) -> None:
    """Write a pose into Foxglove's vector and its quaternion, which is x y z w."""
    translation.x, translation.y, translation.z = pose.translation.tolist()
    rotation.w, rotation.x, rotation.y, rotation.z = pose.quaternion_wxyz.tolist()


def foxglove_pose_of(what: str, position: _Translation, rotation: _Quaternion) -> Pose[A, B]:
    """Return the pose in Foxglove's vector and quaternion.

    Raises:
        MessageError: as `pose_of`.
    """
    translation = [position.x, position.y, position.z]
    return pose_of(what, [*translation, rotation.w, rotation.x, rotation.y, rotation.z])


def covariance_numbers(covariance: Array) -> list[float]:
    """Return the upper triangle (21) of a covariance (6, 6)."""
    numbers: list[float] = covariance.ravel()[_UPPER_FLAT].tolist()
    return numbers


def covariance_of(numbers: Iterable[float]) -> Array:
    """Return the read-only covariance (6, 6) of an upper triangle (21).

    Raises:
        MessageError: another length, not finite, or a negative variance.
    """
    triangle = vector("covariance", numbers, 21, limit=MAX_COVARIANCE)
    flat = np.zeros(36)
    flat[_UPPER_FLAT] = triangle
    flat[_LOWER_FLAT] = triangle
    if flat[_DIAGONAL].min() < 0.0:
        raise MessageError(f"covariance with the negative variance {flat[_DIAGONAL].min()}")
    flat.flags.writeable = False
    return flat.reshape(6, 6)
