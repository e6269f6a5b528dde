"""Motion of a camera: a buffer of odometry samples in a frame that never jumps.

The odometry reports T_w_cam, and now and then its world w leaps. Each new step is compared with
the twist the odometry itself measured:

    predicted = exp(dt (xi_k-1 + xi_k) / 2),    actual = inv(T_w_cam_k-1) @ T_w_cam_k

A step that contradicts the twist by more than `JUMP_M` or `JUMP_RAD`, and one the odometry has
flagged, is replaced by the predicted one from then on, so every stored pose is

    T_w_cam_k := J_k @ T_w_cam_k,    J_k = T_w_cam_k-1 @ predicted @ inv(raw T_w_cam_k)  on a jump

and the added doubt is summed beside it. A new world of the odometry (`reset_count`) is joined the
same way, with large doubt: whoever needs a world that is really one compares reset counts.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from threading import Lock

import numpy as np

from spatial.errors import StampError
from spatial.frames import Cam, W
from spatial.pose import Pose, interpolate
from spatial.samples import MotionSample
from spatial.stamp import NS_PER_MS, NS_PER_S, StampedBuffer, seconds

SPAN_NS = 10 * NS_PER_S
"""How long samples are kept [ns]."""
HORIZON_NS = 100 * NS_PER_MS
"""Longest extrapolation by twist and acceleration [ns]."""
JUMP_M, JUMP_RAD = 0.006, 0.006
"""Contradiction between step and twist that is a jump [m], [rad]."""
GAP_NS = 100 * NS_PER_MS
"""Over a longer gap the pose is believed and not the twist [ns]."""
_ACCELERATION_M_S2 = 3.0
"""What twists at both ends of a step leave open [m/s^2]; matters only over gaps."""
_BRIDGED_M, _GAP_JUMP_M, _RESET_M_S = 0.001, 0.03, 0.3


@dataclass(frozen=True, slots=True, eq=False)
class _Entry:
    sample: MotionSample
    T_cont_w: Pose[W, W]
    doubt_m2: float


class MotionHistory:
    """Samples of one camera, the newest last; one thread may put while others read."""

    def __init__(self, *, span_ns: int = SPAN_NS) -> None:
        """Make an empty history that keeps `span_ns` behind the newest sample."""
        self._buffer: StampedBuffer[_Entry] = StampedBuffer(name="camera motion", span_ns=span_ns)
        self._lock = Lock()
        self.jumps = 0
        """Jumps replaced so far, flagged or found."""

    @property
    def newest(self) -> MotionSample | None:
        """The sample with the largest stamp, its pose freed of jumps."""
        with self._lock:
            held = self._buffer.newest
        return None if held is None else held.value.sample

    def put(self, sample: MotionSample) -> bool:
        """Store a sample; return False for one already held or too old."""
        with self._lock:
            return self._put(sample)

    def at(self, stamp_ns: int, *, horizon_ns: int = HORIZON_NS) -> MotionSample:
        """Return the motion at a stamp: interpolated, or carried on from the newest sample.

        Raises:
            StampError: older than what is held, or more than `horizon_ns` beyond it.
        """
        newest = self.newest
        if newest is None or stamp_ns - newest.stamp_ns > horizon_ns:
            raise StampError(
                "camera motion", requested_ns=stamp_ns, available_ns=self._buffer.interval_ns
            )
        if stamp_ns >= newest.stamp_ns:
            return extrapolate(newest, stamp_ns=stamp_ns, horizon_ns=horizon_ns)
        with self._lock:
            return self._buffer.interpolate(stamp_ns, _blend).sample

    def doubt_m2(self, *, since_ns: int) -> float:
        """Return the variance [m^2] that jumps replaced after a stamp have added."""
        with self._lock:
            newest = self._buffer.newest
            if newest is None:
                return 0.0
            try:
                then = self._buffer.at_or_before(since_ns)
            except StampError:
                return newest.value.doubt_m2
            return newest.value.doubt_m2 - then.value.doubt_m2

    def _put(self, sample: MotionSample) -> bool:
        newest = self._buffer.newest
        if newest is None:
            return self._buffer.put(sample.stamp_ns, _Entry(sample, Pose.identity(), 0.0))
        if sample.stamp_ns > newest.stamp_ns:
            return self._buffer.put(sample.stamp_ns, self._joined(newest.value, sample))
        try:
            older = self._buffer.at_or_before(sample.stamp_ns).value
        except StampError:
            return False
        return self._buffer.put(sample.stamp_ns, _placed(sample, older.T_cont_w, older.doubt_m2))

    def _joined(self, last: _Entry, sample: MotionSample) -> _Entry:
        dt_ns = sample.stamp_ns - last.sample.stamp_ns
        dt_s = seconds(dt_ns)
        plain = _placed(sample, last.T_cont_w, last.doubt_m2)
        reset = sample.reset_count != last.sample.reset_count
        step_s = min(dt_s, seconds(HORIZON_NS)) if reset else dt_s
        twist = 0.5 * (last.sample.xi_w_cam_cam + sample.xi_w_cam_cam)
        T_cont_cam: Pose[W, Cam] = last.sample.T_w_cam @ Pose[Cam, Cam].exp(step_s * twist)
        if not reset:
            if dt_ns > GAP_NS:
                doubt = _GAP_JUMP_M**2 if sample.jump_flagged else 0.0
                return replace(plain, doubt_m2=plain.doubt_m2 + doubt)
            off_m, off_rad = T_cont_cam.distance_to(plain.sample.T_w_cam)
            slack = 0.5 * _ACCELERATION_M_S2 * dt_s**2
            if not sample.jump_flagged and off_m < JUMP_M + slack and off_rad < JUMP_RAD + slack:
                return plain
        self.jumps += 1
        doubt = (_RESET_M_S * (dt_s + 0.1)) ** 2 if reset else _BRIDGED_M**2
        T_cont_w: Pose[W, W] = T_cont_cam @ sample.T_w_cam.inverse()
        return _placed(sample, T_cont_w, last.doubt_m2 + doubt)


def extrapolate(sample: MotionSample, *, stamp_ns: int, horizon_ns: int) -> MotionSample:
    """Carry a sample on: T exp(dt xi + dt^2/2 (a, 0)), with dt clamped to the horizon."""
    dt_s = seconds(min(max(stamp_ns - sample.stamp_ns, 0), horizon_ns))
    if dt_s == 0.0:
        return sample if stamp_ns == sample.stamp_ns else replace(sample, stamp_ns=stamp_ns)
    xi = dt_s * sample.xi_w_cam_cam
    xi[:3] += 0.5 * dt_s**2 * sample.acceleration_cam
    T_w_cam: Pose[W, Cam] = sample.T_w_cam @ Pose[Cam, Cam].exp(xi)
    return replace(sample, stamp_ns=stamp_ns, T_w_cam=T_w_cam)


def _placed(sample: MotionSample, T_cont_w: Pose[W, W], doubt_m2: float) -> _Entry:
    moved = replace(sample, T_w_cam=T_cont_w @ sample.T_w_cam)
    return _Entry(moved, T_cont_w, doubt_m2)


def _blend(older: _Entry, younger: _Entry, share: float) -> _Entry:
    a, b = older.sample, younger.sample
    sample = replace(
        b,
        stamp_ns=a.stamp_ns + round(share * (b.stamp_ns - a.stamp_ns)),
        T_w_cam=interpolate(a.T_w_cam, b.T_w_cam, share),
        xi_w_cam_cam=(1.0 - share) * a.xi_w_cam_cam + share * b.xi_w_cam_cam,
        acceleration_cam=np.asarray(
            (1.0 - share) * a.acceleration_cam + share * b.acceleration_cam
        ),
        reset_count=b.reset_count if share >= 1.0 else a.reset_count,
    )
    return replace(older, sample=sample)
