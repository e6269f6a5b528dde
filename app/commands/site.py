"""`telepresence site`: the simulated site alone, dialling a station or in lock-step."""

from __future__ import annotations

from pathlib import Path

import click

from app import sides
from app.commands.demo import METHODS, run_for
from app.processes.config import SiteConfig
from app.report import say
from app.supervisor import Supervisor
from scene.site import DEFAULT_SITE, load_site
from sim.scenario import load_scenario, parse_delays
from sim.vio import LEVELS
from spatial.errors import InputError

EXAMPLE = """Simulate a site with its hub and tracker, and dial a station.

With --lock-step it runs as fast as it can in one process, at full image quality, straight into a
recording; no station is involved.

Example: telepresence site --connect tcp/127.0.0.1:7447
"""


@click.command(help=EXAMPLE)
@click.option("--scenario", default="pick", show_default=True, help="What is simulated.")
@click.option("--seed", type=int, default=1, show_default=True, help="Of everything random.")
@click.option("--vio", type=click.Choice(sorted(LEVELS)), help="Quality of the odometry.")
@click.option("--delay-ms", "delays", multiple=True, metavar="STREAM=MS", help="Mean delay.")
@click.option("--connect", help="Endpoint of the station's hub.")
@click.option("--method", type=click.Choice(METHODS), default="joint", show_default=True)
@click.option("--lock-step", is_flag=True, help="As fast as possible, into a recording.")
@click.option("--record", type=click.Path(path_type=Path), help="Recording of --lock-step.")
@click.option("--with-truth", is_flag=True, help="Put the truth into that recording.")
@click.option("--duration", type=click.FloatRange(min=0.1), help="How long [s].")
def command(
    *,
    scenario: str,
    seed: int,
    vio: str | None,
    delays: tuple[str, ...],
    connect: str | None,
    method: str,
    lock_step: bool,
    record: Path | None,
    with_truth: bool,
    duration: float | None,
) -> None:
    """Run the command."""
    load_scenario(scenario)
    if lock_step != (record is not None):
        raise InputError("--lock-step and --record FILE go together")
    session = sides.Session(
        site_path=DEFAULT_SITE,
        site_name=load_site(DEFAULT_SITE).name,
        endpoint=sides.free_endpoint(),
    )
    config = SiteConfig(
        bus=session.truth_bus,
        files=session.files,
        scenario=scenario,
        seed=seed,
        vio=vio,
        delays_ms=parse_delays(delays),
    )
    if record is not None:
        from app.lockstep import record_lockstep  # noqa: PLC0415 - the live command needs none of it

        record_lockstep(
            config,
            path=record,
            duration_s=duration or 60.0,
            with_truth=with_truth,
            method=method,
        )
        return
    with Supervisor() as supervisor:
        sides.start_hub(supervisor, session, dial=connect)
        sides.start_tracker(supervisor, session, method=method)
        renderer = sides.start_simulation(supervisor, session, config)
        say(f"telepresence: site {session.site_name} at {session.endpoint}, drawn by {renderer}")
        run_for(supervisor, duration)
