"""`telepresence view`: the operator station alone; sites dial in."""

from __future__ import annotations

from pathlib import Path

import click

from app import sides
from app.commands.demo import announce, run_for
from app.report import say
from app.supervisor import Supervisor
from scene.site import DEFAULT_SITE, load_site

EXAMPLE = """Start the operator station with its hub; a site dials in.

A host other than loopback needs the token in the printed address.

Example: telepresence view --listen tcp/127.0.0.1:7447
"""


@click.command(help=EXAMPLE)
@click.option("--site", "path", type=click.Path(path_type=Path), default=DEFAULT_SITE)
@click.option(
    "--listen", default=sides.DEFAULT_LISTEN, show_default=True, help="For the site's hub."
)
@click.option("--host", default="127.0.0.1", show_default=True, help="For browsers.")
@click.option(
    "--port", type=click.IntRange(0, 65535), default=sides.DEFAULT_PORT, show_default=True
)
@click.option("--no-browser", is_flag=True, help="Print the address instead of opening it.")
@click.option("--track-at", type=click.Choice(["site", "station"]), default="site")
@click.option("--duration", type=click.FloatRange(min=0.1), help="End by itself [s].")
def command(
    *,
    path: Path,
    listen: str,
    host: str,
    port: int,
    no_browser: bool,
    track_at: str,
    duration: float | None,
) -> None:
    """Run the command."""
    site = load_site(path)
    session = sides.Session(site_path=path, site_name=site.name, endpoint=listen)
    with Supervisor() as supervisor:
        sides.start_hub(supervisor, session)
        url = sides.start_viewer(supervisor, session, host=host, port=port)
        if track_at == "station":
            sides.start_tracker(supervisor, session, method="joint")
        say(f"telepresence: a site dials in with: telepresence site --connect {listen}")
        announce(url, headless=False, no_browser=no_browser)
        run_for(supervisor, duration)
