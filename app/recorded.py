"""Run a tracker on a recording: its sensor streams in order of arrival, faster than real time.

The tracker gets what a live one gets, when it got it, and nothing else. Truth is opened when it
has finished, for `sim.metrics` alone.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from app.stepped import SteppedTracker
from app.tracklog import TimedPerception, TrackLog, pooled_rmse, run_time_figures
from scene.database import Database
from scene.robot import Robot
from scene.site import Site
from sim.metrics import Metrics
from spatial.errors import FileInputError
from spatial.stamp import NS_PER_MS, seconds
from spatial.tracked import TrackedObjects
from wire.keys import Keys, is_truth
from wire.recording import Recording

ABOUT = "lockstep.json"
"""Attachment of a recording made in lock-step."""
PROCESSING_MS = 15.0
"""Time an image takes where a recording does not say it [ms]."""
_STEPS = 200


def track_recording(
    path: Path,
    *,
    site: Site,
    robot: Robot,
    database: Database,
    method: str = "joint",
    out: Path | None = None,
) -> dict[str, Any]:
    """Return the report of `telepresence track` on a recording.

    Args:
        path: the recording.
        site: cameras, who carries which object, limits.
        robot: its robot.
        database: its objects.
        method: of the tracker.
        out: table of every pose; none when left out.

    Raises:
        FileInputError: not a whole recording, without images of the site, or none of use.
        InputError: an object of the site that is not in the database.
    """
    with Recording(path) as recording, TrackLog(out) as log:
        perception = TimedPerception(site=site, robot=robot, database=database, method=method)
        tracker = SteppedTracker(
            perception, site=site.name, processing_ns=_processing_ns(recording), listener=log
        )
        _feed(recording, tracker, _wanted(recording, tracker, site))
        if not tracker.frames and tracker.reasons:
            raise FileInputError(f"no image could be used: {tracker.reasons[0]}", path=path)
        report = {
            "method": method,
            "file": str(path),
            "frames": tracker.frames,
            **log.figures(),
            "skipped": tracker.skipped,
            "refused": tracker.refused,
            "run_time_ms": run_time_figures(perception.run_times_ms),
            "warnings": tracker.reasons,
        }
        return _compared(report, recording, log)


def _processing_ns(recording: Recording) -> int:
    """Return what an image took where the recording was made [ns]."""
    try:
        about = json.loads(recording.attachments()[ABOUT])
        return round(float(about["processing_ms"]) * NS_PER_MS)
    except (KeyError, TypeError, ValueError):
        return round(PROCESSING_MS * NS_PER_MS)


def _wanted(recording: Recording, tracker: SteppedTracker, site: Site) -> list[str]:
    keys, inside = Keys(site=site.name), recording.topics
    images = [keys.topic(keys.image(camera)) for camera in site.cameras]
    if not set(images) & set(inside):
        raise FileInputError(
            f"no images of site {site.name!r}: expected {' or '.join(map(str, images))}; "
            f"inside: {', '.join(inside) or 'nothing'}",
            path=recording.path,
        )
    return [topic for topic in tracker.topics if topic in inside]


def _feed(recording: Recording, tracker: SteppedTracker, topics: list[str]) -> None:
    first_ns, last_ns = recording.interval_ns
    step_ns = max(1, (last_ns - first_ns) // _STEPS)
    with click.progressbar(
        length=_STEPS, label="tracking", file=sys.stderr, hidden=not sys.stderr.isatty()
    ) as bar:
        shown = 0
        for message in recording.iterate(topics=topics):
            tracker.put(message.log_ns, message.topic, message.payload)
            steps = (message.log_ns - first_ns) // step_ns
            bar.update(steps - shown)
            shown = steps
    tracker.finish()


def _compared(report: dict[str, Any], recording: Recording, log: TrackLog) -> dict[str, Any]:
    """Return the report with errors, where the recording holds the truth."""
    topics = [topic for topic in recording.topics if is_truth(topic)]
    if not topics:
        return report
    metrics, said = Metrics(), log.said()
    pending = _offer(metrics, said, next(said, None), until_ns=0)
    for message in recording.iterate(topics=topics):
        metrics.hear_truth(message.payload)
        pending = _offer(metrics, said, pending, until_ns=message.stamp_ns)
    figures = metrics.figures()
    objects = {
        slug: {**own, **figures["objects"].get(slug, {})} for slug, own in report["objects"].items()
    }
    return {
        **report,
        **pooled_rmse(figures["objects"]),
        "tracker_hz": figures["tracker_hz"],
        "objects": objects,
        "duration_s": seconds(recording.interval_ns[1] - recording.interval_ns[0]),
    }


def _offer(
    metrics: Metrics,
    said: Iterator[tuple[int, TrackedObjects]],
    pending: tuple[int, TrackedObjects] | None,
    *,
    until_ns: int,
) -> tuple[int, TrackedObjects] | None:
    """Hand over everything up to a stamp [ns]; return the first one beyond it."""
    while pending is not None and pending[1].stamp_ns <= until_ns:
        metrics.put_tracked(pending[1], arrival_ns=pending[0])
        pending = next(said, None)
    return pending
