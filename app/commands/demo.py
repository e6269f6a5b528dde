"""`telepresence demo`: the main job on one machine, live or headless with figures."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import click

from app import sides
from app.processes.config import SiteConfig
from app.report import print_json, say
from app.supervisor import Supervisor
from scene.site import DEFAULT_SITE, load_site
from sim.metrics import merge_display
from sim.scenario import load_scenario
from spatial.errors import StateError

METHODS = ("joint", "algorithm1", "multiart", "single")
EXAMPLE = """Start the simulated site, the tracker and the viewer, and open the browser tab.

Example: telepresence demo --scenario pick --duration 60 --headless --json
"""


@click.command(help=EXAMPLE)
@click.option("--scenario", default="pick", show_default=True, help="What is simulated.")
@click.option("--seed", type=int, default=1, show_default=True, help="Of everything random.")
@click.option("--method", type=click.Choice(METHODS), default="joint", show_default=True)
@click.option("--with-truth", is_flag=True, help="Record the simulator's truth too.")
@click.option("--track-at", type=click.Choice(["site", "station"]), default="site")
@click.option("--duration", type=click.FloatRange(min=1), help="End by itself after this long [s].")
@click.option("--headless", is_flag=True, help="No browser: a probe stands in for the tab.")
@click.option("--no-browser", is_flag=True, help="Print the address instead of opening it.")
@click.option(
    "--port", type=click.IntRange(0, 65535), default=sides.DEFAULT_PORT, show_default=True
)
@click.option("--record", type=click.Path(path_type=Path), help="Record the session.")
@click.option("--json", "as_json", is_flag=True, help="One line of JSON at the end.")
def command(
    *,
    scenario: str,
    seed: int,
    method: str,
    with_truth: bool,
    track_at: str,
    duration: float | None,
    headless: bool,
    no_browser: bool,
    port: int,
    record: Path | None,
    as_json: bool,
) -> None:
    """Run the command."""
    del track_at  # one machine: beside the cameras and at the station are the same place
    plan = load_scenario(scenario)
    if record is not None:
        sides.refuse_target(record)
    session = sides.Session(
        site_path=DEFAULT_SITE,
        site_name=load_site(DEFAULT_SITE).name,
        endpoint=sides.free_endpoint(),
    )
    with Supervisor() as supervisor:
        sides.start_hub(supervisor, session)
        url = sides.start_viewer(supervisor, session, port=port)
        config = SiteConfig(
            bus=session.truth_bus, files=session.files, scenario=scenario, seed=seed
        )
        sides.start_tracker(supervisor, session, method=method)
        renderer = sides.start_simulation(supervisor, session, config)
        if record is not None:
            sides.start_recorder(supervisor, session, record, with_truth=with_truth)
        announce(url, headless=headless, no_browser=no_browser)
        if headless or as_json:
            sides.start_metrics(supervisor, session)
            sides.start_probe(supervisor, url)
        run_for(supervisor, duration)
        if not (headless or as_json):
            return
        report = collect(supervisor)
    report["renderer"] = renderer
    report["simulated_motion_delay_ms"] = plan.streams["vio"].delay_ms
    report |= {"scenario": scenario, "seed": seed, "method": method}
    if as_json:
        print_json(report)
    else:
        summarise(report)


def announce(url: str, *, headless: bool, no_browser: bool) -> None:
    """Say where the page is, and open it when wanted and possible."""
    say(f"telepresence: the page is at {url}")
    has_screen = bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))
    if not (headless or no_browser) and has_screen:
        sides.open_browser(url)


def run_for(supervisor: Supervisor, duration_s: float | None) -> None:
    """Wait for the duration, for Ctrl-C, or for a process that cannot be kept alive.

    Raises:
        StateError: a process died too often.
    """
    deadline = None if duration_s is None else time.monotonic() + duration_s
    try:
        while deadline is None or time.monotonic() < deadline:
            time.sleep(0.1)
            failure = supervisor.failed()
            if failure is not None:
                raise StateError(failure)
    except KeyboardInterrupt:
        say("telepresence: stopping")


def collect(supervisor: Supervisor) -> dict[str, Any]:
    """Stop the measuring processes and put their figures together."""
    cores = supervisor.cpu_cores()
    figures: dict[str, Any] = {}
    for name in ("probe", "metrics"):
        supervisor.stop(name)
        figures[name] = supervisor.wait_event(name, "figures", timeout_s=5.0)["figures"]
    ages = figures["probe"].pop("objects")
    merged = merge_display(figures["metrics"], ages=ages)
    return {**merged, **figures["probe"], "cpu_cores": cores}


def summarise(report: dict[str, Any]) -> None:
    """Say the figures that matter in a few lines."""
    say(f"tracker {report['tracker_hz']:.0f} Hz, tab {report['tab_hz']:.0f} Hz")
    for slug, item in report["objects"].items():
        errors = (item["rmse_in_sight_m"], item["rmse_bridged_m"])
        shown = ["-" if e is None else f"{1e3 * e:.1f} mm" for e in errors]
        say(f"{slug:12} in sight {shown[0]}, bridged {shown[1]}")
