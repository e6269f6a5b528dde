"""How far the tracker is from the truth, object by object: the figures of `demo`.

    e_i = t_est - t_true,   rmse_m = sqrt(mean |e_i|^2)
    rmse_rad = sqrt(mean |log(R_true^T R_est)|^2)
    step residual = |(t_est,i - t_est,i-1) - (t_true,i - t_true,i-1)|,   all in the carrying camera

Compared are `T_cam_object` of the camera that carries the object and the truth at the same stamp,
while the object is within `RANGE_M` of that camera. In sight = TRACKED, bridged = BRIDGED, whole =
every state after the first fix. A freeze is the longest time a pose claimed to be alive (TRACKED
or BRIDGED) was shown unchanged, or not renewed at all, while the true one moved.

Everything is a running sum: memory does not grow with the session.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from sim.truth import T_cam_object_of, TruthSample, blend, decode_truth
from spatial.errors import StampError
from spatial.frames import Cam, Object
from spatial.pose import Pose
from spatial.rotation import Array, log_so3
from spatial.stamp import NS_PER_MS, NS_PER_S, StampedBuffer, seconds
from spatial.tracked import TrackedObject, TrackedObjects, TrackState

RANGE_M = 1.5
"""Errors count while the object is within this distance of its camera [m]."""
UNCHANGED_M = 1e-6
"""A shown pose that moved less than this [m] did not move."""
MOVED_M = 1e-3
"""A freeze counts when the true pose moved more than this [m] in it."""
TRUTH_SPAN_NS = 10 * NS_PER_S
"""Truth is kept for this long [ns]."""
PENDING = 4000
"""Tracked samples that wait for their truth, at most."""
ALIVE = frozenset({TrackState.TRACKED, TrackState.BRIDGED})


class Histogram:
    """Percentiles of a stream of times, one bin per half millisecond, without keeping them."""

    BIN_MS = 0.5
    """Width of a bin [ms]."""
    BINS = 40_000
    """Number of bins; what lies beyond counts in the last one."""

    def __init__(self) -> None:
        """Make an empty one."""
        self._counts = np.zeros(self.BINS, dtype=np.int64)

    def put(self, value_ms: float) -> None:
        """Count one time [ms]."""
        index = min(max(int(value_ms / self.BIN_MS), 0), self.BINS - 1)
        self._counts[index] += 1

    def percentile(self, share: float) -> float | None:
        """Return the time [ms] below which a share in [0, 1] lies, `None` when empty."""
        cumulated = np.cumsum(self._counts)
        total = int(cumulated[-1])
        if total == 0:
            return None
        index = int(np.searchsorted(cumulated, share * total, side="left"))
        return (index + 0.5) * self.BIN_MS

    def figures(self) -> dict[str, float | None]:
        """Return p50 and p95 [ms]."""
        return {"p50": self.percentile(0.5), "p95": self.percentile(0.95)}


@dataclass(slots=True)
class MeanSquare:
    """Running root mean square."""

    total: float = 0.0
    """Sum of squares."""
    count: int = 0
    """Number of squares."""

    def put(self, square: float) -> None:
        """Add one square."""
        self.total += square
        self.count += 1

    def root(self) -> float | None:
        """Return the root of the mean, `None` without a sample."""
        return math.sqrt(self.total / self.count) if self.count else None


@dataclass(frozen=True, slots=True, eq=False)
class _Shown:
    """A pose near its camera, and since when it has been shown unchanged."""

    t_est: Array
    t_true: Array
    since_ns: int
    t_true_since: Array


@dataclass(slots=True)
class ObjectErrors:
    """Running figures of one object."""

    state_s: dict[str, float] = field(default_factory=lambda: {s.value: 0.0 for s in TrackState})
    """Time in each state [s]."""
    seen: Histogram = field(default_factory=Histogram)
    """Stamp of the sample minus capture of the newest image behind it."""
    predicted: Histogram = field(default_factory=Histogram)
    """Arrival of the sample minus its newest motion sample."""
    in_sight: MeanSquare = field(default_factory=MeanSquare)
    """Position error while TRACKED [m]."""
    bridged: MeanSquare = field(default_factory=MeanSquare)
    """Position error while BRIDGED [m]."""
    whole: MeanSquare = field(default_factory=MeanSquare)
    """Position error in every state [m]."""
    whole_turn: MeanSquare = field(default_factory=MeanSquare)
    """Angular error in every state [rad]."""
    axes: Array = field(default_factory=lambda: np.zeros(6))
    """Sums of squares of x, y, z [m] and roll, pitch, yaw [rad] in every state."""
    max_step_m: float = 0.0
    """Largest step residual [m]."""
    freeze_ns: int = 0
    """Longest freeze [ns]."""
    samples: int = 0
    """Distinct stamps."""
    stamp_ns: int = 0
    """Stamp of the newest sample [ns]."""
    state: TrackState = TrackState.LOST
    """State in it."""
    shown: _Shown | None = None
    """Its pose, `None` before the first fix and far away."""

    def put(self, tracked: TrackedObject, *, truth: TruthSample, arrival_ns: int | None) -> None:
        """Add one object of one sample, with the truth at its stamp."""
        if self.samples:
            self.state_s[self.state.value] += seconds(truth.stamp_ns - self.stamp_ns)
        self.samples += 1
        if arrival_ns is not None and tracked.motion_ns:
            self.predicted.put((arrival_ns - tracked.motion_ns) / NS_PER_MS)
        if tracked.seen_ns:
            self.seen.put((truth.stamp_ns - tracked.seen_ns) / NS_PER_MS)
        true = T_cam_object_of(truth, camera=tracked.camera, slug=tracked.slug)
        pose = tracked.T_cam_object
        if true is None or pose is None or float(np.linalg.norm(true.translation)) > RANGE_M:
            self.shown = None
        else:
            self._compare(tracked.state, pose, true)
            self.shown = self._follow(truth.stamp_ns, pose.translation, true.translation)
        self.stamp_ns, self.state = truth.stamp_ns, tracked.state

    def _compare(
        self, state: TrackState, shown: Pose[Cam, Object], true: Pose[Cam, Object]
    ) -> None:
        error = shown.translation - true.translation
        square = float(error @ error)
        R_error = true.rotation.T @ shown.rotation
        turn = log_so3(R_error)
        self.whole.put(square)
        self.whole_turn.put(float(turn @ turn))
        self.axes[:3] += error**2
        self.axes[3:] += euler_xyz(R_error) ** 2
        if state is TrackState.TRACKED:
            self.in_sight.put(square)
        elif state is TrackState.BRIDGED:
            self.bridged.put(square)

    def _follow(self, stamp_ns: int, t_est: Array, t_true: Array) -> _Shown:
        """Compare the step with the sample before; lengthen or end a freeze."""
        before = self.shown
        if before is None:
            return _Shown(t_est, t_true, stamp_ns, t_true)
        step = t_est - before.t_est
        residual = step - (t_true - before.t_true)
        self.max_step_m = max(self.max_step_m, math.sqrt(float(residual @ residual)))
        moved = t_true - before.t_true_since
        if self.state in ALIVE and float(moved @ moved) > MOVED_M**2:
            self.freeze_ns = max(self.freeze_ns, stamp_ns - before.since_ns)
        if float(step @ step) < UNCHANGED_M**2:
            return _Shown(t_est, t_true, before.since_ns, before.t_true_since)
        return _Shown(t_est, t_true, stamp_ns, t_true)

    def figures(self) -> dict[str, Any]:
        """Return the figures of `demo` for this object; `None` where there is no sample."""
        names = ("x_m", "y_m", "z_m", "roll_rad", "pitch_rad", "yaw_rad")
        count = self.whole.count
        axes = [math.sqrt(a / count) if count else None for a in self.axes.tolist()]
        return {
            "samples": count,
            "state_s": {name: round(s, 3) for name, s in self.state_s.items()},
            "seen_ms": self.seen.figures(),
            "predicted_ms": self.predicted.figures(),
            "rmse_in_sight_m": self.in_sight.root(),
            "rmse_bridged_m": self.bridged.root(),
            "rmse_whole_m": self.whole.root(),
            "rmse_whole_rad": self.whole_turn.root(),
            "max_step_residual_m": self.max_step_m if count else None,
            "longest_freeze_ms": self.freeze_ns / NS_PER_MS if count else None,
            **{f"rmse_{name}": value for name, value in zip(names, axes, strict=True)},
        }


class Metrics:
    """Pairs tracked samples with the truth of the same stamp and keeps the figures."""

    def __init__(self) -> None:
        """Start without a sample."""
        self._truth: StampedBuffer[TruthSample] = StampedBuffer(name="truth", span_ns=TRUTH_SPAN_NS)
        self._pending: deque[tuple[TrackedObjects, int | None]] = deque()
        self._objects: dict[str, ObjectErrors] = {}
        self._first_ns = 0
        self._last_ns = 0
        self._unmatched = 0

    def put_truth(self, sample: TruthSample) -> None:
        """Take true poses; tracked samples that waited for them are weighed."""
        self._truth.put(sample.stamp_ns, sample)
        self._settle()

    def hear_truth(self, payload: bytes) -> None:
        """Take true poses as they are on the bus and in a recording.

        Raises:
            MessageError: bytes that are no true poses.
        """
        self.put_truth(decode_truth(payload))

    def put_tracked(self, tracked: TrackedObjects, *, arrival_ns: int | None = None) -> None:
        """Take a tracker's sample.

        Args:
            tracked: the sample; one older than the newest or repeated is ignored.
            arrival_ns: when it arrived, on the site's clock [ns]; `None` on a recording.
        """
        self._pending.append((tracked, arrival_ns))
        if len(self._pending) > PENDING:
            self._pending.popleft()
            self._unmatched += 1
        self._settle()

    def figures(self) -> dict[str, Any]:
        """Return `tracker_hz`, `unmatched` and `objects{slug: figures}` as `demo` prints them."""
        span_s = seconds(self._last_ns - self._first_ns)
        most = max((o.samples for o in self._objects.values()), default=0)
        return {
            "tracker_hz": (most - 1) / span_s if span_s > 0.0 else None,
            "unmatched": self._unmatched,
            "objects": {slug: errors.figures() for slug, errors in self._objects.items()},
        }

    def _settle(self) -> None:
        newest = self._truth.newest
        while newest is not None and self._pending:
            tracked, arrival_ns = self._pending[0]
            if tracked.stamp_ns > newest.stamp_ns:
                return
            self._pending.popleft()
            self._weigh(tracked, arrival_ns)

    def _weigh(self, tracked: TrackedObjects, arrival_ns: int | None) -> None:
        if tracked.stamp_ns <= self._last_ns:
            return
        try:
            truth = self._truth.interpolate(tracked.stamp_ns, blend)
        except StampError:
            self._unmatched += 1
            return
        self._first_ns = self._first_ns or tracked.stamp_ns
        self._last_ns = tracked.stamp_ns
        for item in tracked.objects:
            errors = self._objects.get(item.slug)
            if errors is None:
                errors = self._objects[item.slug] = ObjectErrors()
            errors.put(item, truth=truth, arrival_ns=arrival_ns)


def euler_xyz(rotation: Array) -> Array:
    """Return roll, pitch, yaw (3,) [rad] with R = Rz(yaw) Ry(pitch) Rx(roll), of R (3, 3)."""
    roll = math.atan2(rotation[2, 1], rotation[2, 2])
    pitch = math.asin(min(1.0, max(-1.0, -float(rotation[2, 0]))))
    yaw = math.atan2(rotation[1, 0], rotation[0, 0])
    return np.array([roll, pitch, yaw])


def merge_display(figures: Mapping[str, Any], *, ages: Mapping[str, Any]) -> dict[str, Any]:
    """Return the figures with `seen_ms` and `predicted_ms` as the display measured them.

    Args:
        figures: what `Metrics.figures` gave.
        ages: `{slug: {"seen_ms": {...}, "predicted_ms": {...}}}` of the probe.
    """
    objects = {
        slug: {**own, **{k: v for k, v in ages.get(slug, {}).items() if k in own}}
        for slug, own in figures["objects"].items()
    }
    return {**figures, "objects": objects}
