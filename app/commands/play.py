"""`telepresence play`: shows a recording in a viewer of its own."""

from __future__ import annotations

import secrets
from pathlib import Path

import click

from app import sides
from app.commands.demo import announce, run_for
from app.processes.config import BusConfig, PlayerConfig
from app.supervisor import Supervisor
from scene.site import DEFAULT_SITE, load_site
from spatial.errors import InputError
from wire.recording import Recording

EXAMPLE = """Play a recording in a viewer of its own; it never publishes a command.

Example: telepresence play session.mcap --speed 0.5 --from 12
"""


@click.command(help=EXAMPLE)
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--speed", type=click.FloatRange(0.1, 8.0), default=1.0, show_default=True)
@click.option(
    "--from", "from_s", type=click.FloatRange(min=0), default=0.0, help="Begin there [s]."
)
@click.option("--loop", is_flag=True, help="Begin again at the end.")
@click.option("--paused", is_flag=True, help="Wait at the start.")
@click.option("--topics", multiple=True, help="Only these, with * and **.")
@click.option("--remap", multiple=True, metavar="A:=B", help="Play topic A as B.")
@click.option("--site", "path", type=click.Path(path_type=Path), default=DEFAULT_SITE)
@click.option(
    "--port", type=click.IntRange(0, 65535), default=sides.DEFAULT_PORT, show_default=True
)
@click.option("--no-browser", is_flag=True, help="Print the address instead of opening it.")
@click.option("--duration", type=click.FloatRange(min=0.1), help="End by itself [s].")
def command(
    *,
    file: Path,
    speed: float,
    from_s: float,
    loop: bool,
    paused: bool,
    topics: tuple[str, ...],
    remap: tuple[str, ...],
    path: Path,
    port: int,
    no_browser: bool,
    duration: float | None,
) -> None:
    """Run the command."""
    with Recording(file):
        pass  # a file that cannot be played is refused before anything starts
    name = load_site(path).name
    session = sides.Session(site_path=path, site_name=name, endpoint=sides.free_endpoint())
    prefix = f"replay-{secrets.token_hex(4)}"
    config = PlayerConfig(
        bus=BusConfig(endpoint=session.endpoint, site=name, session=prefix),
        path=str(file),
        speed=speed,
        from_s=from_s,
        loop=loop,
        paused=paused,
        topics=list(topics or ("**",)),
        remap=dict(map(_pair, remap)),
    )
    with Supervisor() as supervisor:
        sides.start_hub(supervisor, session)
        url = sides.start_viewer(supervisor, session, port=port, replay=prefix)
        sides.start_player(supervisor, config)
        announce(url, headless=False, no_browser=no_browser)
        run_for(supervisor, duration)


def _pair(text: str) -> tuple[str, str]:
    old, sign, new = text.partition(":=")
    if not sign or not old or not new:
        raise InputError(f"expected A:=B, got {text!r}")
    return old, new
