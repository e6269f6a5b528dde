"""The error tree.

    TelepresenceError              anything this project raises on purpose
    ├── InputError                 outside data that cannot be used: file, message, argument
    │   ├── FileInputError         ... a file, with its place in it
    │   └── MessageError           ... bytes from the bus
    ├── StampError                 a time outside what is stored
    ├── MissingError               a port, library, camera or asset this machine does not have
    └── StateError                 a call in a state that does not allow it

A message names the bad value, what was expected and what is available; the path comes last.
`MissingError` and `InputError` end a command with exit code 2, every other one with 1.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path


class TelepresenceError(Exception):
    """Root of every error this project raises on purpose."""


class InputError(TelepresenceError):
    """Outside data that cannot be used."""


class FileInputError(InputError):
    """A file that cannot be used, with the place of the fault."""

    def __init__(
        self, message: str, *, path: Path, key: str | None = None, line: int | None = None
    ) -> None:
        """Build the sentence `message (key K, line N, path)`.

        Args:
            message: what is wrong and what was expected.
            path: the file.
            key: dotted key of the faulty entry, where the format has keys.
            line: one-based line of the fault, where it is known.
        """
        where = [f"key {key}"] if key is not None else []
        where += [f"line {line}"] if line is not None else []
        super().__init__(f"{message} ({', '.join([*where, str(path)])})")
        self.path = path
        self.key = key
        self.line = line


class MessageError(InputError):
    """Bytes from the bus that do not decode to a valid message."""


class StampError(TelepresenceError):
    """A stamp outside the stored interval."""

    def __init__(
        self, what: str, *, requested_ns: int, available_ns: tuple[int, int] | None
    ) -> None:
        """Say which stamp was asked of which series and what the series holds.

        Args:
            what: name of the series.
            requested_ns: the stamp asked for.
            available_ns: oldest and newest stamp held, `None` when the series is empty.
        """
        held = (
            "nothing is stored"
            if available_ns is None
            else f"stored is {available_ns[0]} to {available_ns[1]} ns"
        )
        super().__init__(f"{what} at {requested_ns} ns: {held}")
        self.requested_ns = requested_ns
        self.available_ns = available_ns


class MissingError(TelepresenceError):
    """Something this machine lacks: a free port, a library, a camera, an asset."""


class StateError(TelepresenceError):
    """A call in a state that does not allow it."""


def unknown(what: str, name: str, available: Iterable[str]) -> str:
    """Sentence for a name that does not exist, with the names that do."""
    names = ", ".join(sorted(available)) or "none"
    return f"unknown {what} {name!r}; available: {names}"
