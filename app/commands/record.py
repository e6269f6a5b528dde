"""`telepresence record`: taps a running session into a file."""

from __future__ import annotations

from pathlib import Path

import click

from app import sides
from app.commands.demo import run_for
from app.processes.config import BusConfig, RecorderConfig, SiteFiles
from app.report import say
from app.supervisor import Supervisor
from scene.site import DEFAULT_SITE, load_site

EXAMPLE = """Record a running session until Ctrl-C.

Example: telepresence record session.mcap --connect tcp/127.0.0.1:7447
"""


@click.command(help=EXAMPLE)
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--connect", default=sides.DEFAULT_LISTEN, show_default=True, help="The hub.")
@click.option("--site", "path", type=click.Path(path_type=Path), default=DEFAULT_SITE)
@click.option("--topics", multiple=True, help="Only these, with * and **.")
@click.option("--max-duration", type=click.FloatRange(min=0.1), help="End by itself [s].")
def command(
    *,
    file: Path,
    connect: str,
    path: Path,
    topics: tuple[str, ...],
    max_duration: float | None,
) -> None:
    """Run the command."""
    sides.refuse_target(file)
    config = RecorderConfig(
        bus=BusConfig(endpoint=connect, site=load_site(path).name),
        files=SiteFiles(site=str(path)),
        path=str(file),
        topics=list(topics or ("**",)),
    )
    with Supervisor() as supervisor:
        supervisor.start("recorder", "app.processes.recorder", config, restart=False)
        supervisor.wait_event("recorder", "ready", timeout_s=sides.READY_S)
        say(f"telepresence: recording {connect} into {file}, Ctrl-C ends it")
        run_for(supervisor, max_duration)
        supervisor.stop("recorder")
        figures = supervisor.wait_event("recorder", "figures", timeout_s=5.0)["figures"]
    say(f"telepresence: {figures['messages']} messages, {figures['dropped']} dropped")
