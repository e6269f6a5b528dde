"""The baselines of Table 1 on the tracker's corners: `algorithm1`, `multiart` and `single`.

algorithm1   Algorithm 1 whole (algorithm1.py)
multiart     the same without Eq. 2 and Eq. 3: tags, consensus, average
single       the better planar pose of the target tag alone
"""

from __future__ import annotations

import numpy as np

from spatial.marker import MarkedObject
from spatial.pose import Pose
from spatial.samples import MotionSample
from tracking.algorithm1 import Memory, Task, step
from tracking.joint import SeenTag
from tracking.marker_pose import planar_poses
from tracking.model import Fix, ObjectState, TrackerModel

SIGMA_M, SIGMA_RAD = 0.004, 0.02
"""Least uncertainty told of an averaged pose [m], [rad]."""


def task_of(item: MarkedObject) -> Task:
    """Return what Algorithm 1 may know of an object."""
    target = next(m for m in item.markers if m.key == item.target)
    return Task(
        target=item.target,
        others=tuple(m.key for m in item.markers if m.key != item.target),
        T_x_object=Pose(target.T_object_marker.inverse().matrix),
    )


def baseline_fix(
    model: TrackerModel,
    index: int,
    before: ObjectState,
    *,
    tags: list[SeenTag],
    stamp_ns: int,
    at_image: MotionSample | None,
) -> tuple[Memory, Fix | None, str, int]:
    """Return the memory, the pose, why it is not from pixels (empty when it is), and the tags.

    Args:
        model: what is tracked.
        index: the object.
        before: its state before this image.
        tags: its tags found in this image.
        stamp_ns: of the image [ns].
        at_image: motion of the camera at the image.
    """
    item = model.objects[index]
    task = task_of(item)
    if model.method == "single":
        tags = [tag for tag in tags if tag.marker.key == task.target]
        task = Task(task.target, (), task.T_x_object)
    poses = {}
    for tag in tags:
        found = planar_poses(tag.corners_px, size_m=tag.marker.size_m, camera=model.camera)
        if found:
            poses[tag.marker.key] = found[0]
    carries = model.method == "algorithm1" and item.motion == "static"
    T_w_cam = at_image.T_w_cam if carries and at_image is not None else None
    memory = step(task, before.memory, tags=poses, T_w_cam=T_w_cam)
    if memory.branch == "waiting":
        return (
            memory,
            None,
            f"not initialised: {memory.seen} of {1 + len(task.others)} tags seen",
            0,
        )
    if memory.T_cam_x is None or memory.branch == "held":
        return memory, None, "no tag found", 0
    sigma = max(SIGMA_M, memory.spread_m)
    compensates = model.method == "algorithm1" and item.motion != "held"
    fix = Fix(
        stamp_ns=stamp_ns,
        T_cam_object=memory.T_cam_x @ task.T_x_object,
        covariance=np.diag([sigma**2] * 3 + [SIGMA_RAD**2] * 3),
        xi_w_cam_cam=at_image.xi_w_cam_cam if compensates and at_image is not None else np.zeros(6),
    )
    return memory, fix, "" if memory.fixed else "no tag found, carried by Eq. 2", memory.supporters
