"""How much a pose may be trusted: the contract's four states.

TRACKED  last fix at most `tracked_ns` older than the measured delay of the image stream
BRIDGED  no fix, static or held, motion at most `bridged_motion_ns` old, 3 sigma within its limit
STALE    otherwise; the pose is held
LOST     STALE for over `lost_after_ns`, never seen, or another world of the odometry
"""

from __future__ import annotations

from dataclasses import dataclass

from spatial.stamp import seconds
from spatial.tracked import TrackState
from tracking.model import Limits

_MM = 1e3


@dataclass(frozen=True, slots=True)
class Evidence:
    """What the state of one object follows from."""

    fix_age_ns: int
    """Instant shown minus the image of the last fix, and what stopped motion adds [ns]."""
    delay_ns: int
    """Measured delay of the image stream [ns]."""
    motion_age_ns: int | None
    """Age of the newest motion sample [ns]; `None` without motion."""
    carrier: str
    """What carries it without a fix, `camera motion` or `the tool`; empty when nothing may."""
    sigma3_m: float
    """Largest positional 3 sigma [m]."""
    sigma3_before_m: float
    """The same `lost_after_ns` earlier [m]."""
    same_world: bool
    """Whether the fix lies in the present world of the odometry."""
    tags: int
    """Tags behind the last fix."""


def judged(evidence: Evidence, limits: Limits) -> tuple[TrackState, str]:
    """Return the state and one sentence that says why."""
    since_s = seconds(max(evidence.fix_age_ns, 0))
    late = evidence.fix_age_ns - evidence.delay_ns - limits.tracked_ns
    if not evidence.same_world:
        return TrackState.LOST, "the odometry began a new world, not seen since"
    if late <= 0:
        tags = "1 tag" if evidence.tags == 1 else f"{evidence.tags} tags"
        return TrackState.TRACKED, f"fix from {tags}"
    age_ns = evidence.motion_age_ns
    stopped = 0 if age_ns is None else max(age_ns - limits.bridged_motion_ns, 0)
    ended = late > limits.lost_after_ns
    if not evidence.carrier or age_ns is None:
        what = "and no motion" if evidence.carrier else "and motion may not carry it"
        return _stale(lost=ended), f"no tag for {since_s:.1f} s {what}"
    why = f"no tag for {since_s:.1f} s"
    if stopped > 0:
        why += f" and no motion for {seconds(age_ns):.1f} s"
        return _stale(lost=ended and stopped > limits.lost_after_ns), why
    if evidence.sigma3_m > limits.bridged_sigma_m:
        why += f", 3 sigma {_MM * evidence.sigma3_m:.0f} mm"
        return _stale(lost=ended and evidence.sigma3_before_m > limits.bridged_sigma_m), why
    return TrackState.BRIDGED, f"{why}, carried by {evidence.carrier}"


def _stale(*, lost: bool) -> TrackState:
    return TrackState.LOST if lost else TrackState.STALE
