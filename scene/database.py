"""The object database: a folder of object folders, read whole.

No index file: what lies there is what there is. A folder that cannot be used is a problem with a
sentence, never a crash, and never hides the others.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from scene.entry import ObjectEntry, load_object
from spatial.errors import FileInputError, InputError, unknown

__all__ = ["Database", "Problem", "load_database", "load_object"]


@dataclass(frozen=True, slots=True)
class Problem:
    """A folder that cannot be used."""

    slug: str
    """Name of the folder."""
    message: str
    """What is wrong, with file, key and line."""


@dataclass(frozen=True, slots=True, eq=False)
class Database:
    """All objects of a folder."""

    root: Path
    """The folder."""
    entries: Mapping[str, ObjectEntry]
    """Usable objects by slug."""
    problems: tuple[Problem, ...]
    """Folders that cannot be used."""

    def entry(self, slug: str) -> ObjectEntry:
        """Return one object.

        Raises:
            InputError: it does not exist, or cannot be used and why.
        """
        if slug in self.entries:
            return self.entries[slug]
        for problem in self.problems:
            if problem.slug == slug:
                raise InputError(f"object {slug!r} cannot be used: {problem.message}")
        raise InputError(f"{unknown('object', slug, self.entries)} ({self.root})")


def load_database(root: Path) -> Database:
    """Return every object below a folder.

    Two objects that share a marker are both refused: either could be taken for the other.

    Raises:
        FileInputError: the folder itself cannot be read.
    """
    try:
        folders = sorted(
            path
            for path in root.iterdir()
            if path.is_dir() and not path.name.startswith((".", "_"))
        )
    except OSError as error:
        message = f"the object folder cannot be read: {error.strerror}"
        raise FileInputError(message, path=root) from error
    entries: dict[str, ObjectEntry] = {}
    problems: list[Problem] = []
    for folder in folders:
        try:
            entries[folder.name] = load_object(folder)
        except FileInputError as error:
            problems.append(Problem(folder.name, str(error)))
    shared = _shared_markers(entries)
    problems += [Problem(slug, message) for slug, message in shared.items()]
    kept = {slug: entry for slug, entry in entries.items() if slug not in shared}
    return Database(root, kept, tuple(sorted(problems, key=lambda problem: problem.slug)))


def _shared_markers(entries: Mapping[str, ObjectEntry]) -> dict[str, str]:
    """Return a sentence for every object that has a marker in common with another one."""
    holders: dict[tuple[str, int], list[str]] = {}
    for slug, entry in entries.items():
        for marker in entry.markers:
            holders.setdefault(marker.key, []).append(slug)
    said: dict[str, str] = {}
    for (family, number), slugs in holders.items():
        for slug in slugs if len(slugs) > 1 else ():
            others = ", ".join(other for other in slugs if other != slug)
            path = entries[slug].folder / "object.toml"
            message = f"marker {family} {number} is also on {others}; ids are unique"
            said.setdefault(slug, str(FileInputError(message, path=path, key="marker")))
    return said
