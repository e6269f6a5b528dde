"""Images and camera motion in, tracked objects out; two pure functions over immutable state.

    observe   image at t:  corners (search.py) -> joint pose (joint.py) -> anchor (anchor.py)
              and, for the baselines, the same corners -> Algorithm 1 (algorithm1.py)
    predict   newest motion sample T*:  T_cam_object = T_cam_w(T*) @ T_w_object      (Eq. 2, Eq. 3)

The anchor T_w_object of a static object holds between images and through loss of sight; its chain
ends at the newest motion sample, so nothing is extrapolated that was measured. Every method gets
its corners at the predictions of the same anchor: only the pose made of them differs.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from spatial.errors import StampError
from spatial.frames import Cam, Object, W
from spatial.pose import Pose
from spatial.samples import MotionSample
from spatial.stamp import NS_PER_MS, NS_PER_S
from spatial.tracked import PoseMeasurement, TagUse, TrackReport
from tracking.anchor import blended, floor, fused, noise_of
from tracking.baselines import baseline_fix
from tracking.joint import JointSolution, Prior, SeenTag, solve_joint
from tracking.model import (
    Anchor,
    Fix,
    GrayImage,
    ObjectState,
    StandardLimits,
    TrackerModel,
    TrackerState,
)
from tracking.motion import MotionHistory
from tracking.output import predict, raw_poses
from tracking.propagation import growth
from tracking.search import (
    MAX_REGION,
    SMALL_REGION,
    Expected,
    Sighting,
    expected_markers,
    follow,
    search_image,
    search_region,
)

__all__ = [
    "GrayImage",
    "StandardLimits",
    "TrackerModel",
    "TrackerState",
    "initial_state",
    "observe",
    "predict",
]

DELAYS = 51
"""Images over which the delay of the stream is the median."""
REGION_NS = 80 * NS_PER_MS
"""Shortest time between two searches of large regions [ns]."""
IDLE_NS = NS_PER_S
"""Shortest time between searches of the whole image for what a sharp prediction puts elsewhere."""


def initial_state(model: TrackerModel) -> TrackerState:
    """Return the state before the first image."""
    return TrackerState(objects=tuple(ObjectState() for _ in model.objects))


def observe(
    model: TrackerModel, state: TrackerState, image: GrayImage, motion: MotionHistory
) -> tuple[TrackerState, tuple[PoseMeasurement, ...], tuple[TrackReport, ...]]:
    """Look at one image.

    Args:
        model: what is tracked; constant.
        state: what is remembered; left as it is.
        image: with its capture stamp; one not younger than the last is ignored.
        motion: of the same camera; only read.

    Returns:
        The new state, a measurement per object with a fix, a report per object.
    """
    if image.stamp_ns <= state.image_ns:
        return state, (), ()
    at_image = _motion_at(motion, image.stamp_ns)
    priors = _priors(model, state, image.stamp_ns, motion, at_image)
    expected = expected_markers(model.camera, table=model.table, priors=priors)
    sighting, state = _sighted(model, state, image, expected, priors)
    objects, measurements, reports = [], [], []
    for index, before in enumerate(state.objects):
        rows = np.flatnonzero(model.table.owner == index).tolist()
        tags = sighting.of(rows)
        solution = solve_joint(model.camera, tags=tags, prior=priors.get(index))
        after, why = _updated(
            model,
            index,
            before,
            tags=tags,
            solution=solution,
            stamp_ns=image.stamp_ns,
            at_image=at_image,
            motion=motion,
        )
        objects.append(after)
        if after.seen_ns == image.stamp_ns and after.fix is not None:
            measurements.append(_measurement(model, index, after.fix))
        report = _report(
            model,
            index,
            rows=rows,
            sighting=sighting,
            expected=expected,
            solution=solution,
            stamp_ns=image.stamp_ns,
        )
        reports.append(
            replace(
                report,
                T_cam_object=after.fix.T_cam_object
                if after.fix is not None and after.seen_ns == image.stamp_ns
                else None,
                T_cam_object_prior=priors[index].T_cam_object if index in priors else None,
                reason=why,
            )
        )
    after_all = replace(
        state,
        objects=tuple(objects),
        image_ns=image.stamp_ns,
        delays_ns=_delays(state, image.stamp_ns, motion),
    )
    return _blended(model, state, after_all, motion), tuple(measurements), tuple(reports)


def _motion_at(motion: MotionHistory, stamp_ns: int) -> MotionSample | None:
    try:
        return motion.at(stamp_ns)
    except StampError:
        return None


def _delays(state: TrackerState, stamp_ns: int, motion: MotionHistory) -> tuple[int, ...]:
    if motion.newest is None:
        return state.delays_ns
    return (*state.delays_ns, motion.newest.stamp_ns - stamp_ns)[-DELAYS:]


def _priors(
    model: TrackerModel,
    state: TrackerState,
    stamp_ns: int,
    motion: MotionHistory,
    at_image: MotionSample | None,
) -> dict[int, Prior]:
    """Return the anchors as this image should see them, by index of the object."""
    priors: dict[int, Prior] = {}
    for index, item in enumerate(state.objects):
        anchor = item.anchor
        if anchor is None or (anchor.in_world and at_image is None):
            continue
        T_cam_object: Pose[Cam, Object] = Pose(anchor.T_ref_object.matrix)
        doubt = 0.0
        if anchor.in_world and at_image is not None:
            T_cam_object = at_image.T_w_cam.inverse() @ anchor.T_ref_object
            doubt = motion.doubt_m2(since_ns=anchor.stamp_ns)
        grown = growth(
            duration_ns=stamp_ns - anchor.stamp_ns,
            noise=noise_of(model.objects[index].motion, in_world=anchor.in_world),
            distance_m=float(np.linalg.norm(T_cam_object.translation)),
            doubt_m2=doubt,
        )
        priors[index] = Prior(T_cam_object, anchor.covariance + np.diag(grown))
    return priors


def _sighted(
    model: TrackerModel,
    state: TrackerState,
    image: GrayImage,
    expected: Expected,
    priors: dict[int, Prior],
) -> tuple[Sighting, TrackerState]:
    """Find markers, and note when regions and the whole image were searched."""
    camera, table, gray = model.camera, model.table, image.pixels
    sighting = Sighting()
    follow(gray, camera=camera, table=table, expected=expected, sighting=sighting)
    missing = _without_tags(model, sighting)
    in_view = {int(i) for i in table.owner[expected.index]}
    if missing & in_view:
        rested = image.stamp_ns - state.region_ns >= REGION_NS
        if search_region(
            gray,
            camera=camera,
            table=table,
            expected=expected,
            owners=missing & in_view,
            largest=MAX_REGION if rested else SMALL_REGION,
            sighting=sighting,
        ):
            state = replace(state, region_ns=image.stamp_ns)
        missing = _without_tags(model, sighting)
    limit = model.limits.bridged_sigma_m / 3.0
    sharp = {i for i in priors if float(np.diag(priors[i].covariance)[:3].max()) < limit**2}
    pause = IDLE_NS if missing <= sharp - in_view else model.search_ns
    if missing and image.stamp_ns - state.searched_ns >= pause:
        state = replace(state, searched_ns=image.stamp_ns)
        search_image(gray, camera=camera, table=table, sighting=sighting)
    return sighting, state


def _without_tags(model: TrackerModel, sighting: Sighting) -> set[int]:
    seen = {int(model.table.owner[row]) for row in sighting.tags}
    return set(range(len(model.objects))) - seen


def _updated(
    model: TrackerModel,
    index: int,
    before: ObjectState,
    *,
    tags: list[SeenTag],
    solution: JointSolution | None,
    stamp_ns: int,
    at_image: MotionSample | None,
    motion: MotionHistory,
) -> tuple[ObjectState, str]:
    """Return the state of an object after an image, and why there is no fix."""
    item = model.objects[index]
    anchor, why = before.anchor, "no tag fits a pose" if tags else "no tag found"
    if solution is not None:
        distance = float(np.linalg.norm(solution.T_cam_object.translation))
        raw = _fix_anchor(solution, stamp_ns, at_image, held=item.motion == "held")
        doubt = 0.0 if anchor is None else motion.doubt_m2(since_ns=anchor.stamp_ns)
        anchor, why = fused(
            anchor,
            fix=raw,
            motion=item.motion,
            distance_m=distance,
            doubt_m2=doubt,
            tags=int(solution.used.sum()),
        )
    after = replace(before, anchor=anchor)
    xi = np.zeros(6) if at_image is None else at_image.xi_w_cam_cam
    if model.method == "joint":
        if solution is None or why:
            return after, why
        fix = Fix(stamp_ns, solution.T_cam_object, _told(solution), xi)
        count, memory = int(solution.used.sum()), before.memory
    else:
        memory, found, why, count = baseline_fix(
            model, index, before, tags=tags, stamp_ns=stamp_ns, at_image=at_image
        )
        after = replace(after, memory=memory, note=why or before.note)
        if found is None:
            return after, why
        fix = found
        if why:  # carried by Eq. 2: a pose, but not from pixels
            return replace(after, fix=fix), why
    reset = before.reset_count if at_image is None else at_image.reset_count
    return replace(
        after, fix=fix, memory=memory, seen_ns=stamp_ns, reset_count=reset, tags=count
    ), ""


def _told(solution: JointSolution) -> np.ndarray:
    distance = float(np.linalg.norm(solution.T_cam_object.translation))
    return np.asarray(solution.covariance + np.diag(floor(distance)))


def _fix_anchor(
    solution: JointSolution, stamp_ns: int, at_image: MotionSample | None, *, held: bool
) -> Anchor:
    T_ref_object: Pose[W, Object] = Pose(solution.T_cam_object.matrix)
    if at_image is not None and not held:
        T_ref_object = at_image.T_w_cam @ solution.T_cam_object
    return Anchor(
        T_ref_object=T_ref_object,
        covariance=solution.covariance,
        stamp_ns=stamp_ns,
        in_world=at_image is not None and not held,
        reset_count=0 if at_image is None else at_image.reset_count,
    )


def _blended(
    model: TrackerModel, before: TrackerState, after: TrackerState, motion: MotionHistory
) -> TrackerState:
    """Let corrections of the shown pose fade in instead of leaping."""
    if model.method != "joint":
        return after
    instant_ns = after.image_ns if motion.newest is None else motion.newest.stamp_ns
    bare = replace(after, objects=tuple(replace(o, blend=None) for o in after.objects))
    shown = raw_poses(model, before, motion, instant_ns=instant_ns)
    wanted = raw_poses(model, bare, motion, instant_ns=instant_ns)
    objects = []
    for item, old, new in zip(after.objects, shown, wanted, strict=True):
        blend = item.blend
        if old is not None and new is not None and item.seen_ns == after.image_ns:
            off = (new.inverse() @ old).log()
            blend = blended(blend, off=off, instant_ns=instant_ns, blend_ns=model.blend_ns)
        objects.append(replace(item, blend=blend))
    return replace(after, objects=tuple(objects))


def _measurement(model: TrackerModel, index: int, fix: Fix) -> PoseMeasurement:
    return PoseMeasurement(
        camera=model.camera_name,
        slug=model.objects[index].slug,
        stamp_ns=fix.stamp_ns,
        T_cam_object=fix.T_cam_object,
        covariance=fix.covariance,
        source=model.method,
    )


def _report(
    model: TrackerModel,
    index: int,
    *,
    rows: list[int],
    sighting: Sighting,
    expected: Expected,
    solution: JointSolution | None,
    stamp_ns: int,
) -> TrackReport:
    """Return what became of the tags of an object; pose, prior and reason are filled in later."""
    found = [row for row in rows if row in sighting.tags]
    uses: list[TagUse] = []
    for i, row in enumerate(found):
        tag, fits = sighting.tags[row], solution is not None and bool(solution.used[i])
        residual = 0.0 if solution is None else float(solution.residuals_px[i])
        why = "" if fits else f"contradicts the other tags by {residual:.1f} px"
        if solution is None:
            why = "not the corners of a square"
        uses.append(TagUse(tag.marker.family, tag.marker.id, tag.corners_px, fits, why, residual))
    for row in rows:
        if row in sighting.refused and row not in sighting.tags:
            marker, (corners, why) = model.table.markers[row], sighting.refused[row]
            uses.append(TagUse(marker.family, marker.id, corners, False, why, 0.0))
    good = [use.residual_px for use in uses if use.used]
    own = set(rows)
    return TrackReport(
        camera=model.camera_name,
        slug=model.objects[index].slug,
        stamp_ns=stamp_ns,
        method=model.method,
        tags=tuple(uses),
        expected_ids=tuple(model.table.markers[r].id for r in expected.index.tolist() if r in own),
        T_cam_object=None,
        T_cam_object_prior=None,
        hypotheses=0 if solution is None else solution.hypotheses,
        residual_px=float(np.sqrt(np.mean(np.square(good)))) if good else 0.0,
        reason="",
    )
