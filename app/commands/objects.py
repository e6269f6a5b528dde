"""`telepresence objects`: the object database without a browser."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from app.report import print_json, say
from scene.database import Database, load_database
from scene.site import ASSETS

EXAMPLE = """Look after the object database without a browser.

Example: telepresence objects check --json
"""
objects_option = click.option(
    "--objects",
    "folder",
    type=click.Path(path_type=Path),
    default=ASSETS / "objects",
    help="Folder with one folder per object; the project's own by default.",
)
json_option = click.option("--json", "as_json", is_flag=True, help="One line of JSON.")


@click.group(help=EXAMPLE)
def command() -> None:
    """Hold the subcommands."""


@command.command("list")
@objects_option
@json_option
def list_objects(*, folder: Path, as_json: bool) -> None:
    """List the objects with their markers and extents.

    Example: telepresence objects list
    """
    database = load_database(folder)
    rows: list[dict[str, Any]] = [
        {
            "name": slug,
            "title": entry.name,
            "revision": entry.revision,
            "markers": [marker.id for marker in entry.markers],
            "extents_m": list(entry.extents_m),
            "fixtures": [fixture.name for fixture in entry.fixtures],
        }
        for slug, entry in sorted(database.entries.items())
    ]
    if as_json:
        print_json({"objects": rows})
        return
    for row in rows:
        size = " x ".join(f"{1e3 * value:.0f}" for value in row["extents_m"])
        say(f"{row['name']:18} {size:>18} mm  tags {row['markers']}")


@command.command("check")
@objects_option
@json_option
@click.pass_context
def check_objects(ctx: click.Context, *, folder: Path, as_json: bool) -> None:
    """Check every object; exit with 2 when one is refused.

    Example: telepresence objects check --json
    """
    rows = check(load_database(folder))
    if as_json:
        print_json({"objects": rows})
    for row in [] if as_json else rows:
        say(f"{row['name']:18} {'ok' if row['accepted'] else 'REFUSED: ' + row['reason']}")
    if any(not row["accepted"] for row in rows):
        ctx.exit(2)


def check(database: Database) -> list[dict[str, Any]]:
    """Return one row per object: whether it is accepted, and why not."""
    refused = {problem.slug: problem.message for problem in database.problems}
    names = sorted({*database.entries, *refused})
    return [
        {
            "name": name,
            "accepted": name not in refused,
            "reason": refused.get(name, ""),
            "warnings": [],
        }
        for name in names
    ]
