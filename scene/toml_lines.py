"""Lines of TOML keys: what a person needs to find a fault in a file."""

from __future__ import annotations

import re

from spatial.errors import FileInputError

_HEADER = re.compile(r"^\s*\[\[?\s*([^\[\]]+?)\s*\]\]?\s*(#.*)?$")
_ENTRY = re.compile(r"^\s*([A-Za-z0-9_.\"'-]+)\s*=")


def line_of(text: str, key: str) -> int | None:
    """Return the one-based line of a dotted key such as `marker[2].size_m`, or of its table.

    Understands what people write by hand: headers, arrays of tables and plain entries.
    """
    wanted = re.sub(r"\[0\]", "", key)
    counts: dict[str, int] = {}
    table, nearest = "", None
    for number, line in enumerate(text.splitlines(), start=1):
        if header := _HEADER.match(line):
            table = header.group(1)
            if line.lstrip().startswith("[["):
                index = counts[table] = counts.get(table, -1) + 1
                table = f"{table}[{index}]" if index else table
            if wanted == table or wanted.startswith(f"{table}."):
                nearest = number
        elif entry := _ENTRY.match(line):
            here = f"{table}.{entry.group(1)}" if table else entry.group(1)
            if here == wanted or wanted.startswith((f"{here}.", f"{here}[")):
                return number
    return nearest


def with_line(error: FileInputError, text: str) -> FileInputError:
    """Return an error of a TOML file with the line its key stands in."""
    if error.line is not None or error.key is None:
        return error
    message = str(error).removesuffix(f" (key {error.key}, {error.path})")
    return FileInputError(message, path=error.path, key=error.key, line=line_of(text, error.key))
