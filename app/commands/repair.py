"""`telepresence repair`: makes a recording whole that a crash cut short."""

from __future__ import annotations

from pathlib import Path

import click

from app.report import print_json, say
from wire.repair import repair

EXAMPLE = """Make a damaged recording whole; the damaged one is kept as FILE.damaged.

Example: telepresence repair session.mcap
"""


@click.command(help=EXAMPLE)
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path), help="Write the whole one there instead.")
@click.option("--json", "as_json", is_flag=True, help="One line of JSON.")
def command(*, file: Path, out: Path | None, as_json: bool) -> None:
    """Run the command."""
    done = repair(file, out=out)
    report = {
        "file": str(done.file),
        "damaged": None if done.damaged is None else str(done.damaged),
        "messages": done.messages,
        "lost_chunks": done.lost_chunks,
    }
    if as_json:
        print_json(report)
    elif done.damaged is None:
        say(f"{done.file} is whole already")
    else:
        say(f"{done.file}: {done.messages} messages kept, {done.lost_chunks} chunks lost")
