"""What a tracker said, for `track`: a table, figures by object, and the comparison with the truth.

Poses are spooled to disk, so memory does not grow with the recording, and the truth is opened
only after the tracker has finished.
"""

from __future__ import annotations

import csv
import hashlib
import math
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any, Self, TextIO

import numpy as np

from app.perception import Perception
from scene.database import Database
from scene.robot import Robot
from scene.site import Site
from spatial.errors import FileInputError
from spatial.samples import ImageSample
from spatial.stamp import NS_PER_MS, seconds
from spatial.tracked import (
    PoseMeasurement,
    TrackedObject,
    TrackedObjects,
    TrackReport,
    TrackState,
)
from wire.codec import decode_tracked, encode

_AXES = ("x", "y", "z", "rx", "ry", "rz")
_UPPER = [(i, j) for i in range(6) for j in range(i, 6)]
COLUMNS = (
    "stamp_ns",
    "object",
    "camera",
    "state",
    *("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"),
    *(f"cov_{_AXES[i]}_{_AXES[j]}" for i, j in _UPPER),
    *("seen_ns", "motion_ns", "reset_count", "reason"),
)
"""Columns of the table: `T_cam_object` at the stamp, covariance as in the contract."""
_NUMBER_BYTES = 8


class TimedPerception(Perception):
    """A `Perception` that measures how long it looks at images."""

    def __init__(self, *, site: Site, robot: Robot, database: Database, method: str) -> None:
        """Prepare the trackers; see `Perception`."""
        super().__init__(site=site, robot=robot, database=database, method=method)
        self.run_times_ms: list[float] = []
        """Time of every image looked at [ms]."""

    def observe(
        self, image: ImageSample
    ) -> tuple[tuple[PoseMeasurement, ...], tuple[TrackReport, ...]]:
        """Look at one image; see `Perception.observe`."""
        started_ns = time.perf_counter_ns()
        seen = super().observe(image)
        self.run_times_ms.append((time.perf_counter_ns() - started_ns) / NS_PER_MS)
        return seen


class TrackLog:
    """Takes what a tracker says; close it, best by `with`."""

    def __init__(self, out: Path | None = None) -> None:
        """Begin, with a table where `out` names a file.

        Raises:
            FileInputError: that file cannot be written.
        """
        self._spool = TemporaryFile()  # noqa: SIM115 - closed by close
        self._hash = hashlib.sha256()
        self._states: dict[str, Counter[str]] = {}
        self._last: dict[str, tuple[int, TrackState]] = {}
        self._out = _opened(out)
        self._table = csv.writer(self._out, lineterminator="\n") if self._out else None
        if self._table is not None:
            self._table.writerow(COLUMNS)
        self.poses = 0
        """Poses said so far, of all objects."""

    def tracked(self, at_ns: int, tracked: TrackedObjects) -> None:
        """Take all objects, said at `at_ns` [ns]."""
        payload = encode(tracked).payload
        self._hash.update(payload)
        for number in (at_ns, len(payload)):
            self._spool.write(number.to_bytes(_NUMBER_BYTES, "little"))
        self._spool.write(payload)
        for item in tracked.objects:
            self._count(item, tracked.stamp_ns)
            if item.T_cam_object is not None:
                self.poses += 1
                if self._table is not None:
                    self._table.writerow(_row(tracked.stamp_ns, item))

    def reports(self, at_ns: int, reports: tuple[TrackReport, ...]) -> None:
        """Ignore why: the poses say it."""

    def said(self) -> Iterator[tuple[int, TrackedObjects]]:
        """Yield everything said so far, with its time [ns]."""
        self._spool.seek(0)
        while head := self._spool.read(2 * _NUMBER_BYTES):
            at_ns = int.from_bytes(head[:_NUMBER_BYTES], "little")
            size = int.from_bytes(head[_NUMBER_BYTES:], "little")
            yield at_ns, decode_tracked(self._spool.read(size))

    def figures(self) -> dict[str, Any]:
        """Return `poses`, their hash, and seconds in each state, in all and by object."""
        total: Counter[str] = Counter()
        for states in self._states.values():
            total.update(states)
        return {
            "poses": self.poses,
            "poses_sha256": self._hash.hexdigest(),
            "state_s": _rounded(total),
            "objects": {
                slug: {"state_s": _rounded(states)} for slug, states in self._states.items()
            },
        }

    def close(self) -> None:
        """Close the table and the spool."""
        self._spool.close()
        if self._out is not None:
            self._out.close()

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close."""
        self.close()

    def _count(self, item: TrackedObject, stamp_ns: int) -> None:
        states = self._states.setdefault(item.slug, Counter())
        if item.slug in self._last:
            since_ns, state = self._last[item.slug]
            states[state.value] += stamp_ns - since_ns
        self._last[item.slug] = stamp_ns, item.state


def run_time_figures(times_ms: list[float]) -> dict[str, float | None]:
    """Return `p50`, `p95` and `mean` [ms] of some run times, `None` without one."""
    if not times_ms:
        return {"p50": None, "p95": None, "mean": None}
    p50, p95 = np.percentile(times_ms, (50, 95)).tolist()
    return {"p50": round(p50, 3), "p95": round(p95, 3), "mean": round(float(np.mean(times_ms)), 3)}


def pooled_rmse(objects: dict[str, dict[str, Any]]) -> dict[str, float | None]:
    """Return every `rmse_*` over all objects, weighed by their samples.

    Args:
        objects: figures by object, as `sim.metrics` gives them.
    """
    names = ("x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad")
    full = [figures for figures in objects.values() if figures["samples"]]
    count = sum(figures["samples"] for figures in full)
    pooled: dict[str, float | None] = {}
    for key in (f"rmse_{name}" for name in names):
        total = sum(figures["samples"] * figures[key] ** 2 for figures in full)
        pooled[key] = math.sqrt(total / count) if count else None
    return pooled


def _opened(out: Path | None) -> TextIO | None:
    if out is None:
        return None
    try:
        return out.open("w", encoding="utf-8", newline="")
    except OSError as error:
        reason = error.strerror or str(error)
        raise FileInputError(f"cannot write the table: {reason}", path=out) from error


def _row(stamp_ns: int, item: TrackedObject) -> list[object]:
    pose = item.T_cam_object
    assert pose is not None  # the caller writes poses alone
    numbers = [*pose.translation.tolist(), *pose.quaternion_wxyz.tolist()]
    spread = [float(item.covariance[i, j]) for i, j in _UPPER]
    return [
        *(stamp_ns, item.slug, item.camera, item.state.value),
        *(f"{number:.9g}" for number in numbers),
        *(f"{number:.6g}" for number in spread),
        *(item.seen_ns, item.motion_ns, item.reset_count, item.reason),
    ]


def _rounded(states: Counter[str]) -> dict[str, float]:
    return {state.value: round(seconds(states[state.value]), 3) for state in TrackState}
