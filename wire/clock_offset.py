"""Offset and skew of a remote clock from the round trips of probes.

    r = (t3 - t0) - (t2 - t1)            round trip without the site's own time
    o = ((t1 - t0) + (t2 - t3)) / 2      offset, true within r / 2 whatever the asymmetry
    offset(t) = o_m + s (t - t_m),       s from the line through the probes of lowest r

t0 asked and t3 answered on the local clock, t1 heard and t2 answered on the site's. The bound is
half the lowest round trip plus the drift since; Mills, RFC 5905, has the same quantities.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from spatial.stamp import NS_PER_MS, NS_PER_S

WINDOW_NS = 60 * NS_PER_S
MAX_PROBES = 256
MIN_SPAN_NS = 8 * NS_PER_S
MIN_FOR_SKEW = 8
MAX_SKEW = 200e-6
DRIFT_UNKNOWN = 50e-6
"""Assumed bound on skew before it is estimated; crystals of computers stay within it."""
DRIFT_KNOWN = 5e-6
"""What may be left once it is estimated."""
NEAR_LOWEST_NS = 200_000
CONTRADICTIONS = 3
"""So many probes in a row that exclude the estimate mean another clock answers now."""
CONTRADICTION_MARGIN_NS = 5 * NS_PER_MS


@dataclass(frozen=True, slots=True)
class RoundTrip:
    """What one answered probe says."""

    local_ns: int
    """Local clock in the middle of the round trip [ns]."""
    offset_ns: int
    """Site minus local clock [ns], true within half the round trip."""
    round_trip_ns: int
    """Time under way, both directions [ns]."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """Offset as a line over local time, with its bound."""

    reference_ns: int
    """Local instant the line is anchored at [ns]."""
    offset_ns: int
    """Site minus local clock at that instant [ns]."""
    skew: float
    """How much faster the site's clock runs, without unit: 1e-6 is one part per million."""
    bound_ns: int
    """Half the lowest round trip [ns]."""
    drift: float
    """How fast the bound grows with the distance from the reference, without unit."""

    def offset_at(self, local_ns: int) -> int:
        """Return the offset [ns] at a local instant."""
        return self.offset_ns + round(self.skew * (local_ns - self.reference_ns))

    def bound_at(self, local_ns: int) -> int:
        """Return the bound [ns] on the offset's error at a local instant."""
        return self.bound_ns + round(self.drift * abs(local_ns - self.reference_ns))


class OffsetEstimator:
    """Collects round trips of the last minute and keeps the estimate."""

    def __init__(self) -> None:
        """Know nothing."""
        self._trips: deque[RoundTrip] = deque(maxlen=MAX_PROBES)
        self._contradictions = 0
        self.resets = 0
        self.estimate: Estimate | None = None

    def put(self, trip: RoundTrip) -> Estimate | None:
        """Take one round trip in and return the new estimate; impossible ones are ignored."""
        if trip.round_trip_ns < 0:
            return self.estimate
        if self._contradicts(trip):
            self._contradictions += 1
            if self._contradictions < CONTRADICTIONS:
                return self.estimate
            self._trips.clear()
            self.resets += 1
        self._contradictions = 0
        self._trips.append(trip)
        while trip.local_ns - self._trips[0].local_ns > WINDOW_NS:
            self._trips.popleft()
        self.estimate = _fit(list(self._trips), now_ns=trip.local_ns)
        return self.estimate

    def _contradicts(self, trip: RoundTrip) -> bool:
        if self.estimate is None:
            return False
        distance = abs(trip.offset_ns - self.estimate.offset_at(trip.local_ns))
        allowed = trip.round_trip_ns / 2 + self.estimate.bound_at(trip.local_ns)
        return distance > allowed + CONTRADICTION_MARGIN_NS


def _fit(trips: list[RoundTrip], *, now_ns: int) -> Estimate:
    lowest = min(trip.round_trip_ns for trip in trips)
    near = [t for t in trips if t.round_trip_ns <= lowest + max(NEAR_LOWEST_NS, lowest // 4)]
    skew, drift = _skew(near)
    best = min(trips, key=lambda t: t.round_trip_ns / 2 + drift * (now_ns - t.local_ns))
    return Estimate(best.local_ns, best.offset_ns, skew, best.round_trip_ns // 2, drift)


def _skew(near: list[RoundTrip]) -> tuple[float, float]:
    """Return the slope of the offsets and three sigma of it; zero where it says nothing yet."""
    if len(near) < MIN_FOR_SKEW or near[-1].local_ns - near[0].local_ns < MIN_SPAN_NS:
        return 0.0, DRIFT_UNKNOWN
    x = np.array([t.local_ns - near[0].local_ns for t in near], dtype=np.float64)
    y = np.array([t.offset_ns - near[0].offset_ns for t in near], dtype=np.float64)
    x -= x.mean()
    y -= y.mean()
    slope = float(x @ y / (x @ x))
    rest = y - slope * x
    uncertain = 3.0 * float(np.sqrt(rest @ rest / (len(near) - 2) / (x @ x)))
    if uncertain > DRIFT_UNKNOWN or abs(slope) > MAX_SKEW:
        return 0.0, DRIFT_UNKNOWN
    return slope, max(DRIFT_KNOWN, uncertain)
