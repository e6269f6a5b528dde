"""`telepresence track`: run a tracker on a recording, or beside a live site."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from app.report import print_json, say
from app.sides import DEFAULT_LISTEN
from scene.database import Database, load_database
from scene.robot import Robot, load_robot
from scene.site import DEFAULT_SITE, Site, load_site
from spatial.errors import FileInputError, InputError, MissingError

METHODS = ("joint", "algorithm1", "multiart", "single", "apriltag2")
LIVE = "live:"
EXAMPLE = """Run a tracker on a recording and write every pose with its state and covariance.

INPUT is a recording, or live:SITE for a site that is running; what a live tracker finds is
reported and goes nowhere else, and it ends with Ctrl-C or after --duration. Errors are printed
where the recording holds the simulator's truth.

Example: telepresence track session.mcap --method joint --out poses.csv --json
"""


@click.command(help=EXAMPLE)
@click.argument("source", metavar="INPUT")
@click.option("--method", type=click.Choice(METHODS), default="joint", show_default=True)
@click.option("--objects", type=click.Path(path_type=Path), help="Other object database.")
@click.option("--site", type=click.Path(path_type=Path), help="Other site file.")
@click.option("--out", type=click.Path(path_type=Path), help="Table of every pose, CSV.")
@click.option("--connect", default=DEFAULT_LISTEN, show_default=True, help="Hub of a live site.")
@click.option("--duration", type=click.FloatRange(min=0.1), help="End live tracking after [s].")
@click.option("--json", "as_json", is_flag=True, help="One line of JSON.")
def command(
    *,
    source: str,
    method: str,
    objects: Path | None,
    site: Path | None,
    out: Path | None,
    connect: str,
    duration: float | None,
    as_json: bool,
) -> None:
    """Run the command."""
    if method == "apriltag2":
        known = ", ".join(name for name in METHODS if name != method)
        raise MissingError(f"method apriltag2 is not in this build; available: {known}")
    loaded, robot, database = load(site or DEFAULT_SITE, objects=objects)
    if source.startswith(LIVE):
        from app.tracklive import track_live  # noqa: PLC0415 - a recording needs no bus

        report = track_live(
            replace(loaded, name=source.removeprefix(LIVE)),
            robot=robot,
            database=database,
            method=method,
            out=out,
            endpoint=connect,
            duration_s=duration,
        )
    else:
        from app.recorded import track_recording  # noqa: PLC0415 - a live site needs no truth

        if not Path(source).is_file():
            raise FileInputError("no such recording; a live site is live:SITE", path=Path(source))
        report = track_recording(
            Path(source), site=loaded, robot=robot, database=database, method=method, out=out
        )
    if as_json:
        print_json(report)
    else:
        summarise(report)


def load(path: Path, *, objects: Path | None) -> tuple[Site, Robot, Database]:
    """Read a site file, its robot and its objects.

    Args:
        path: the site file.
        objects: folder of objects that replaces the site's.

    Raises:
        InputError: one of them is missing or wrong, or an object the site names is refused.
    """
    site = load_site(path)
    if objects is not None:
        site = replace(site, objects_dir=objects)
    database = load_database(site.objects_dir)
    wanted = {item.slug for item in site.objects}
    for problem in database.problems:
        if problem.slug in wanted:
            raise InputError(problem.message)
    return site, load_robot(site.robot), database


def summarise(report: dict[str, Any]) -> None:
    """Say the figures that matter in a few lines."""
    mean = report["run_time_ms"]["mean"]
    cost = "" if mean is None else f", {mean:.1f} ms each"
    say(f"{report['method']}: {report['frames']} images{cost}, {report['poses']} poses")
    for slug, item in report["objects"].items():
        states = ", ".join(f"{name} {s:.1f} s" for name, s in item["state_s"].items() if s)
        errors = (item.get("rmse_in_sight_m"), item.get("rmse_bridged_m"))
        shown = ["-" if e is None else f"{1e3 * e:.1f} mm" for e in errors]
        told = f"; in sight {shown[0]}, bridged {shown[1]}" if "samples" in item else ""
        say(f"{slug:12} {states}{told}")
    for warning in report["warnings"]:
        say(f"warning: {warning}")
