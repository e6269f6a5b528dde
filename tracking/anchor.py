"""Fuse fixes into the pose of an object that stands still in its reference (w, or the camera).

    P = P + Q(dt),   d = log(inv(T) @ T_fix),   S = P + R
    refused when d^T inv(S + F) d > GATE, accepted after `CONFIRMED` in a row that agree,
    and where a lone tag says that something static has moved, not before `LONE_NS`
    K = P inv(S),   T <- T exp(K d),   P <- (I - K) P

F is what no covariance knows: errors of calibration, map and time. It widens the gate and every
covariance told, and stays out of the gain, so that the newest fix rules at close range. A fix
moves the shown pose over `blend_ns`, never in a leap: shown = T exp(share(t) xi).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from spatial.frames import Object, W
from spatial.pose import Pose
from spatial.rotation import Array
from spatial.stamp import NS_PER_S, nanoseconds
from tracking.model import Anchor, Blend
from tracking.propagation import HELD, MOBILE, STATIC, UNMOVED, MotionNoise, growth

GATE = 35.0
"""Largest squared Mahalanobis distance of a fix that is believed at once."""
CONFIRMED = 3
"""Refused fixes in a row, agreeing with each other, that are right where the anchor is wrong."""
LONE_NS = NS_PER_S
"""What covers a part of a lone tag's edge bends its pose alike in every image; it passes [ns]."""
FLOOR_M, FLOOR_PER_M, FLOOR_RAD = 0.001, 0.001, 0.004
"""Error no covariance knows [m], [m per m of distance], [rad]."""
_DIRECT_M, _DIRECT_RAD = 0.003, 0.02
"""Corrections up to here are shown at once."""
_BLEND_M_S = 1.4
"""Fastest a correction is shown [m/s]: 7 mm per sample of a 200 Hz odometry."""
_BLEND_MAX_M = 1.5
"""A farther correction is a new place, not a correction [m]."""

_NOISES = {"static": STATIC, "held": HELD, "mobile": MOBILE}


def noise_of(motion: str, *, in_world: bool) -> MotionNoise:
    """Return how fast a kind of motion makes a pose uncertain, in w or in the camera."""
    return UNMOVED if motion == "static" and not in_world else _NOISES[motion]


def floor(distance_m: float) -> Array:
    """Return the diagonal (6,) of F at a distance from the camera [m]."""
    shift, turn = (FLOOR_M + FLOOR_PER_M * distance_m) ** 2, FLOOR_RAD**2
    return np.array([shift, shift, shift, turn, turn, turn])


def fused(
    anchor: Anchor | None,
    *,
    fix: Anchor,
    motion: str,
    distance_m: float,
    doubt_m2: float = 0.0,
    tags: int = 2,
) -> tuple[Anchor, str]:
    """Return the anchor after a fix, and why the fix was refused (empty when it was not).

    Args:
        anchor: before; `None` before the first fix.
        fix: the fix in the same form, with its own covariance.
        motion: `static`, `held` or `mobile`.
        distance_m: camera to object [m].
        doubt_m2: variance that jumps of the odometry have added since the anchor's stamp.
        tags: number of tags behind the fix.
    """
    if (
        anchor is None
        or anchor.in_world != fix.in_world
        or anchor.reset_count != fix.reset_count
        or fix.stamp_ns <= anchor.stamp_ns
    ):
        return fix, ""
    off, grown, away = _apart(anchor, fix, motion=motion, distance_m=distance_m, doubt_m2=doubt_m2)
    spread = grown + fix.covariance
    if away > GATE:
        rival, refused = fix, 1
        if anchor.rival is not None and anchor.rival.stamp_ns < fix.stamp_ns:
            agreed = _apart(anchor.rival, fix, motion=motion, distance_m=distance_m)[2] <= GATE
            if agreed:
                rival, refused = anchor.rival, anchor.refused + 1
        lone = motion == "static" and tags < 2
        if refused >= CONFIRMED and not (lone and fix.stamp_ns - rival.stamp_ns < LONE_NS):
            return fix, ""
        why = f"{float(np.sqrt(away)):.0f} sigma from the prediction, waiting for another"
        return replace(anchor, refused=refused, rival=rival), why
    gain = grown @ np.linalg.inv(spread)
    covariance = (np.eye(6) - gain) @ grown
    T_ref_object: Pose[W, Object] = anchor.T_ref_object @ Pose[Object, Object].exp(gain @ off)
    return replace(fix, T_ref_object=T_ref_object, covariance=0.5 * (covariance + covariance.T)), ""


def _apart(
    anchor: Anchor, fix: Anchor, *, motion: str, distance_m: float, doubt_m2: float = 0.0
) -> tuple[Array, Array, float]:
    """Return the step to a later fix (6,), the anchor's covariance then, squared Mahalanobis."""
    grown = anchor.covariance + np.diag(
        growth(
            duration_ns=fix.stamp_ns - anchor.stamp_ns,
            noise=noise_of(motion, in_world=fix.in_world),
            distance_m=distance_m,
            doubt_m2=doubt_m2,
        )
    )
    off = (anchor.T_ref_object.inverse() @ fix.T_ref_object).log()
    spread = grown + fix.covariance + np.diag(floor(distance_m))
    return off, grown, float(off @ np.linalg.solve(spread, off))


def blended(before: Blend | None, *, off: Array, instant_ns: int, blend_ns: int) -> Blend | None:
    """Return how a correction is shown.

    Args:
        before: the correction being shown so far.
        off: tangent (6,) from the new pose to the one shown, both at `instant_ns`.
        instant_ns: instant of the correction [ns].
        blend_ns: shortest time to show it [ns].
    """
    distance = float(np.linalg.norm(off[:3]))
    small = distance <= _DIRECT_M and float(np.linalg.norm(off[3:])) <= _DIRECT_RAD
    if small or distance > _BLEND_MAX_M:
        return None
    share = 0.0 if before is None else before.share(instant_ns)
    if before is not None and share > 0.0:
        rest = share * float(np.linalg.norm(before.xi[:3]))
        if distance <= rest + _DIRECT_M and share > 0.1:
            return replace(before, xi=off / share)
    return Blend(off, instant_ns, max(blend_ns, nanoseconds(distance / _BLEND_M_S)))
