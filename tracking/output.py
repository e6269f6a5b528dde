"""Poses of all objects at one instant, from what the tracker remembers and the camera's motion.

    joint         T_cam_object(T*) = T_cam_w(T*) @ T_w_object @ exp(share xi)     Eq. 2 and Eq. 3
    algorithm1    T_cam_object(T*) = exp(-(T* - t) xi(t)) @ T_cam_object(t)       Eq. 3 by the twist
    others        T_cam_object(t), held

All objects share the camera's motion, so their covariances grow in one array operation.
"""

from __future__ import annotations

import math

import numpy as np

from spatial.errors import StampError
from spatial.frames import Cam, Object, W
from spatial.pose import Pose
from spatial.rotation import Array
from spatial.samples import MotionSample
from spatial.stamp import seconds
from spatial.tracked import TrackedObject, TrackedObjects, TrackState
from tracking.anchor import floor, noise_of
from tracking.judge import Evidence, judged
from tracking.model import ObjectState, TrackerModel, TrackerState
from tracking.motion import MotionHistory
from tracking.propagation import TURN_PER_DOUBT, propagate

SWAY_M_S2 = 0.6
"""Acceleration a twist does not know: what Eq. 3 over t_d is uncertain by [m/s^2]."""
UNKNOWN = np.diag([1.0] * 3 + [1.0] * 3)
"""Covariance (6, 6) told of an object never seen."""


def predict(
    model: TrackerModel,
    state: TrackerState,
    motion: MotionHistory,
    *,
    now_ns: int | None = None,
    to_ns: int | None = None,
) -> TrackedObjects:
    """Return all objects at one instant: the newest motion sample, or `to_ns`.

    Args:
        model: what is tracked.
        state: what is remembered.
        motion: of the camera; only read.
        now_ns: present instant [ns], which ages the motion; the instant shown when `None`.
        to_ns: instant to predict to instead [ns], at most the horizon past the newest sample.
    """
    newest = motion.newest
    instant_ns = _instant(model, state, motion) if to_ns is None else to_ns
    poses = raw_poses(model, state, motion, instant_ns=instant_ns)
    covariances, before = _covariances(model, state, motion, poses, instant_ns)
    sigmas = _sigma3(covariances)
    sigmas_before = _sigma3(before)
    now = instant_ns if now_ns is None else max(now_ns, instant_ns)
    age = None if newest is None else now - newest.stamp_ns
    objects = []
    for i, (item, memory) in enumerate(zip(model.objects, state.objects, strict=True)):
        evidence = Evidence(
            fix_age_ns=_fix_age(model, memory.seen_ns, newest, instant_ns=instant_ns, now_ns=now),
            delay_ns=state.delay_ns,
            motion_age_ns=age,
            carrier=_carrier(model, item.motion, memory),
            sigma3_m=float(sigmas[i]),
            sigma3_before_m=float(sigmas_before[i]),
            same_world=newest is None or newest.reset_count == memory.reset_count,
            tags=memory.tags,
        )
        verdict, reason = (
            judged(evidence, model.limits) if memory.seen_ns else (TrackState.LOST, memory.note)
        )
        objects.append(
            TrackedObject(
                slug=item.slug,
                revision=item.revision,
                camera=model.camera_name,
                state=verdict,
                T_cam_object=poses[i],
                xi_w_cam_cam=_twist(model, item.motion, newest, verdict),
                covariance=covariances[i],
                seen_ns=memory.seen_ns,
                motion_ns=0 if newest is None else newest.stamp_ns,
                reset_count=memory.reset_count,
                reason=reason,
            )
        )
    return TrackedObjects(stamp_ns=instant_ns, objects=tuple(objects))


def raw_poses(
    model: TrackerModel, state: TrackerState, motion: MotionHistory, *, instant_ns: int
) -> list[Pose[Cam, Object] | None]:
    """Return the pose of every object in the camera at an instant, `None` if never seen."""
    T_cam_w = _world_in_camera(motion, instant_ns, model.limits.horizon_ns)
    return [
        _pose(
            model,
            index,
            item,
            motion=motion,
            instant_ns=instant_ns,
            delay_ns=state.delay_ns,
            T_cam_w=T_cam_w,
        )
        for index, item in enumerate(state.objects)
    ]


def _instant(model: TrackerModel, state: TrackerState, motion: MotionHistory) -> int:
    """Return the newest motion stamp, or the newest fix where motion stays out."""
    fixes = max((item.seen_ns for item in state.objects), default=0)
    if motion.newest is None:
        return max(fixes, state.image_ns)
    newest = motion.newest.stamp_ns
    return newest if fixes - newest <= model.limits.horizon_ns else fixes


def _world_in_camera(
    motion: MotionHistory, instant_ns: int, horizon_ns: int
) -> Pose[Cam, W] | None:
    newest = motion.newest
    if newest is not None and newest.stamp_ns == instant_ns:
        return newest.T_w_cam.inverse()
    try:
        return motion.at(instant_ns, horizon_ns=horizon_ns).T_w_cam.inverse()
    except StampError:
        return None


def _pose(
    model: TrackerModel,
    index: int,
    item: ObjectState,
    *,
    motion: MotionHistory,
    instant_ns: int,
    delay_ns: int,
    T_cam_w: Pose[Cam, W] | None,
) -> Pose[Cam, Object] | None:
    if item.fix is None or not item.seen_ns:
        return None
    if model.method != "joint":
        held = delay_ns + model.limits.bridged_motion_ns
        ahead_s = seconds(min(instant_ns - item.fix.stamp_ns, held))
        moved = Pose[W, Cam].exp(ahead_s * item.fix.xi_w_cam_cam)
        return propagate(item.fix.T_cam_object, T_w_cam_then=Pose.identity(), T_w_cam_now=moved)
    anchor = item.anchor
    if anchor is None:
        return item.fix.T_cam_object
    T_cam_object: Pose[Cam, Object] = Pose(anchor.T_ref_object.matrix)
    if anchor.in_world:
        if model.objects[index].motion != "static":
            # without a fix it may be anywhere in w: what was shown last is held in the camera
            last_ns = item.seen_ns + delay_ns + model.limits.tracked_ns
            if instant_ns > last_ns:
                T_cam_w = _world_in_camera(motion, last_ns, model.limits.horizon_ns)
        if T_cam_w is None:
            return item.fix.T_cam_object
        T_cam_object = T_cam_w @ anchor.T_ref_object
    share = 0.0 if item.blend is None else item.blend.share(instant_ns)
    if item.blend is None or share == 0.0:
        return T_cam_object
    return T_cam_object @ Pose[Object, Object].exp(share * item.blend.xi)


def _fix_age(
    model: TrackerModel,
    seen_ns: int,
    newest: MotionSample | None,
    *,
    instant_ns: int,
    now_ns: int,
) -> int:
    """Return the age of the last fix [ns].

    The instant shown stands still when motion stops, so that time is added; before a fix that is
    younger than all motion, only the clock can age it, less a delay nobody has measured.
    """
    slack = model.limits.bridged_motion_ns
    if newest is None or seen_ns > newest.stamp_ns:
        return max(now_ns - seen_ns - slack, 0)
    return instant_ns - seen_ns + max(now_ns - newest.stamp_ns - slack, 0)


def _carrier(model: TrackerModel, motion: str, memory: ObjectState) -> str:
    """Return what may carry the object without a fix: Eq. 2, or the tool its camera is on."""
    if model.method not in ("joint", "algorithm1") or motion == "mobile":
        return ""
    if motion == "held":
        return "the tool"
    in_world = memory.anchor is not None and memory.anchor.in_world
    return "camera motion" if in_world or model.method == "algorithm1" else ""


def _twist(
    model: TrackerModel, motion: str, newest: MotionSample | None, state: TrackState
) -> Array:
    """Return the twist that carries a pose on: none where the camera's motion does not."""
    carried = model.method in ("joint", "algorithm1") and (
        motion == "static" or (motion == "mobile" and state is TrackState.TRACKED)
    )
    return newest.xi_w_cam_cam if newest is not None and carried else np.zeros(6)


def _covariances(
    model: TrackerModel,
    state: TrackerState,
    motion: MotionHistory,
    poses: list[Pose[Cam, Object] | None],
    instant_ns: int,
) -> tuple[Array, Array]:
    """Return covariances (n, 6, 6) at the instant, and `lost_after_ns` before it."""
    count = len(poses)
    base, doubts = np.zeros((count, 6, 6)), np.zeros(count)
    grown, grown_before = np.zeros((count, 6)), np.zeros((count, 6))
    for i, (item, pose) in enumerate(zip(state.objects, poses, strict=True)):
        if pose is None or item.fix is None:
            base[i] = UNKNOWN
            continue
        distance = math.sqrt(float(pose.translation @ pose.translation))
        joint = model.method == "joint" and item.anchor is not None
        since_ns = item.anchor.stamp_ns if joint and item.anchor is not None else item.seen_ns
        base[i] = (
            item.anchor.covariance if joint and item.anchor is not None else item.fix.covariance
        )
        base[i][np.diag_indices(6)] += floor(distance)
        in_world = item.anchor is not None and item.anchor.in_world
        noise = noise_of(model.objects[i].motion, in_world=in_world)
        age = max(seconds(instant_ns - since_ns), 0.0)
        earlier = max(age - seconds(model.limits.lost_after_ns), 0.0)
        grown[i] = np.repeat(noise.variances(age, distance_m=distance), 3)
        grown_before[i] = np.repeat(noise.variances(earlier, distance_m=distance), 3)
        doubts[i] = motion.doubt_m2(since_ns=since_ns)
        if not joint:
            base[i] += _extrapolated(instant_ns - item.fix.stamp_ns)
        if item.blend is not None:
            shown = item.blend.share(instant_ns) * item.blend.xi
            base[i] += np.outer(shown, shown)
    doubt = np.array([1.0, 1.0, 1.0, *[TURN_PER_DOUBT] * 3]) * doubts[:, None]
    diagonal = np.eye(6)
    now = base + diagonal * (grown + doubt)[:, None]
    return now, base + diagonal * (grown_before + doubt)[:, None]


def _extrapolated(duration_ns: int) -> Array:
    """Return what Eq. 3 over a time adds to a covariance (6, 6)."""
    dt = seconds(max(duration_ns, 0))
    return np.diag([(0.5 * SWAY_M_S2 * dt**2) ** 2] * 3 + [(0.5 * dt**2) ** 2] * 3)


def _sigma3(covariances: Array) -> Array:
    """Return the largest positional 3 sigma (n,) [m] of covariances (n, 6, 6)."""
    if not len(covariances):
        return np.zeros(0)
    largest = np.linalg.eigvalsh(covariances[:, :3, :3])[:, -1]
    return np.asarray(3.0 * np.sqrt(np.maximum(largest, 0.0)))
