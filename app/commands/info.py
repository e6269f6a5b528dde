"""`telepresence info`: what is in a recording."""

from __future__ import annotations

from pathlib import Path

import click

from app.report import print_json, say
from wire.recording import info

EXAMPLE = """Summarise a recording: streams, rates, duration, attachments.

Example: telepresence info session.mcap --json
"""


@click.command(help=EXAMPLE)
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="One line of JSON.")
def command(*, file: Path, as_json: bool) -> None:
    """Run the command."""
    report = info(file)
    if as_json:
        print_json(report)
        return
    state = "whole" if report["whole"] else "DAMAGED"
    say(f"{file}: {report['duration_s']:.1f} s, {state}")
    for stream in report["streams"]:
        rate = "-" if stream["hz"] is None else f"{stream['hz']:.1f} Hz"
        say(f"{stream['key']:32} {stream['count']:8} {rate:>10}  {stream['schema']}")
    for name in report["attachments"]:
        say(f"attached: {name}")
    for warning in report["warnings"]:
        say(f"warning: {warning}")
