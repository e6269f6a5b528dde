"""Strict reading of a TOML table: every key is typed, named in errors, and none is left over."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import numpy as np

from spatial.errors import FileInputError, InputError, unknown
from spatial.frames import Frame
from spatial.pose import Pose
from spatial.rotation import Array

T = TypeVar("T")
A = TypeVar("A", bound=Frame)
B = TypeVar("B", bound=Frame)

_LINE = re.compile(r"\(?at line (\d+), column (\d+)\)?")


def read_toml(path: Path) -> dict[str, Any]:
    """Return the content of a TOML file.

    Raises:
        FileInputError: it cannot be read or is not TOML; the line is named.
    """
    try:
        return tomllib.loads(path.read_bytes().decode("utf-8"))
    except OSError as error:
        raise FileInputError(f"cannot be read: {error.strerror}", path=path) from error
    except UnicodeDecodeError as error:
        raise FileInputError("is not UTF-8 text", path=path) from error
    except tomllib.TOMLDecodeError as error:
        place = _LINE.search(str(error))
        line = int(place.group(1)) if place else None
        message = _LINE.sub("", str(error)).strip()
        raise FileInputError(f"is not TOML: {message}", path=path, line=line) from error
    except (ValueError, RecursionError) as error:  # endless digits, endless brackets
        raise FileInputError(f"is not TOML: {error}", path=path) from error


class TableReader:
    """Takes typed values out of one table; `finish` refuses what nobody took."""

    def __init__(self, table: Mapping[str, Any], *, path: Path, key: str = "") -> None:
        """Read a table.

        Args:
            table: the table as TOML gives it.
            path: the file it is in.
            key: dotted key of the table; empty for the whole file.
        """
        self._table = table
        self._path = path
        self._key = key
        self._taken: dict[str, None] = {}

    @property
    def values(self) -> Mapping[str, Any]:
        """The table as TOML gave it."""
        return self._table

    def __contains__(self, name: str) -> bool:
        """Return whether the table has a key."""
        return name in self._table

    def text(self, name: str, *, default: str | None = None) -> str:
        """Take a string that is not empty."""
        value = self._take(name, default)
        if not isinstance(value, str) or not value:
            self._wrong(name, value, "a text")
        return value

    def choice(self, name: str, options: Sequence[str], *, default: str | None = None) -> str:
        """Take one of some words."""
        value = self.text(name, default=default)
        if value not in options:
            self.fail(name, unknown(name, value, options))
        return value

    def flag(self, name: str, *, default: bool | None = None) -> bool:
        """Take true or false."""
        value = self._take(name, default)
        if not isinstance(value, bool):
            self._wrong(name, value, "true or false")
        return value

    def whole(self, name: str, *, default: int | None = None, least: int | None = None) -> int:
        """Take a whole number."""
        value = self._take(name, default)
        if not isinstance(value, int) or isinstance(value, bool):
            self._wrong(name, value, "a whole number")
        if least is not None and value < least:
            self._wrong(name, value, f"a whole number of at least {least}")
        return value

    def number(
        self,
        name: str,
        *,
        default: float | None = None,
        above: float | None = None,
        least: float | None = None,
    ) -> float:
        """Take a finite number, greater than `above`, not smaller than `least`."""
        value = self._take(name, default)
        if not _is_number(value):
            self._wrong(name, value, "a finite number")
        if above is not None and not value > above:
            self._wrong(name, value, f"a number greater than {above:g}")
        if least is not None and not value >= least:
            self._wrong(name, value, f"a number of at least {least:g}")
        return float(value)

    def numbers(
        self, name: str, count: int, *, default: tuple[float, ...] | None = None
    ) -> tuple[float, ...]:
        """Take a list of `count` finite numbers."""
        value = self._take(name, default)
        if (
            not isinstance(value, (list, tuple))
            or len(value) != count
            or not all(_is_number(v) for v in value)
        ):
            self._wrong(name, value, f"a list of {count} finite numbers")
        return tuple(float(v) for v in value)

    def rows(self, name: str, count: int) -> Array:
        """Take a list of lists of `count` finite numbers, as an array (n, count)."""
        value = self._take(name, None)
        if not isinstance(value, list) or not all(
            isinstance(row, list) and len(row) == count and all(_is_number(v) for v in row)
            for row in value
        ):
            self._wrong(name, value, f"a list of lists of {count} finite numbers")
        return np.array(value, dtype=np.float64).reshape(-1, count)

    def file(self, name: str) -> Path:
        """Take a file that lies in the folder of the table's own file."""
        text = self.text(name)
        folder = self._path.parent.resolve()
        found = (folder / text).resolve()
        if not found.is_relative_to(folder):
            self.fail(name, f"{text!r} leads out of the folder of this file")
        if not found.is_file():
            self.fail(name, unknown("file", text, (p.name for p in folder.iterdir())))
        return found

    def pose(self) -> Pose[A, B]:
        """Take `translation_m` and `quaternion_wxyz`; each is the identity where left out."""
        translation = self.numbers("translation_m", 3, default=(0.0, 0.0, 0.0))
        quaternion = self.numbers("quaternion_wxyz", 4, default=(1.0, 0.0, 0.0, 0.0))
        try:
            return Pose.parse(translation, quaternion)
        except InputError as error:
            self.fail("quaternion_wxyz", str(error), cause=error)

    def table(self, name: str, *, optional: bool = False) -> TableReader:
        """Take a sub-table; an absent optional one reads as empty."""
        value = self._take(name, {} if optional else None)
        if not isinstance(value, Mapping):
            self._wrong(name, value, "a table")
        return TableReader(value, path=self._path, key=self._dotted(name))

    def tables(self, name: str) -> list[TableReader]:
        """Take an array of tables; an absent one reads as none."""
        value = self._take(name, [])
        if not isinstance(value, list) or not all(isinstance(row, Mapping) for row in value):
            self._wrong(name, value, f"an array of tables [[{name}]]")
        key = self._dotted(name)
        return [
            TableReader(row, path=self._path, key=f"{key}[{index}]")
            for index, row in enumerate(value)
        ]

    def guarded(self, make: Callable[[TableReader], T]) -> T:
        """Return `make(self)`; an `InputError` without a place gets this table's."""
        try:
            return make(self)
        except FileInputError:
            raise
        except InputError as error:
            raise FileInputError(str(error), path=self._path, key=self._key or None) from error

    def finish(self) -> None:
        """Refuse keys nobody asked for: a misspelt option must not be ignored."""
        for name in self._table:
            if name not in self._taken:
                self.fail(name, unknown("key", name, self._taken))

    def fail(self, name: str, message: str, *, cause: Exception | None = None) -> NoReturn:
        """Raise a `FileInputError` at one key of this table."""
        raise FileInputError(message, path=self._path, key=self._dotted(name)) from cause

    def _dotted(self, name: str) -> str:
        return f"{self._key}.{name}" if self._key else name

    def _take(self, name: str, default: Any) -> Any:
        self._taken[name] = None
        if name in self._table:
            return self._table[name]
        if default is None:
            present = ", ".join(sorted(self._table)) or "none"
            self.fail(name, f"{name} is missing; present: {present}")
        return default

    def _wrong(self, name: str, value: Any, expected: str) -> NoReturn:
        self.fail(name, f"{name} must be {expected}, got {value!r}")


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
