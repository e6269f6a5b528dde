"""Algorithm 1 of the paper: robust marker localisation.

    k tags of n + 1 seen at t                                                (x: target, y: others)
    not initialised, k == n + 1    T_y_x <- tag_init
    k == n + 1                     T_cam_x <- ransac_avg(T_cam_x, T_cam_y @ T_y_x); T_y_x updated
    0 < k < n + 1, x seen          T_cam_x <- ransac_avg(T_cam_x, T_cam_y @ T_y_x)
    0 < k < n + 1, x not seen      T_cam_x <- ransac_avg(T_cam_y @ T_y_x)
    k == 0                         T_cam_x <- T_cam_w(t) @ T_w_cam(t-1) @ T_cam_x(t-1)        Eq. 2
    always                         T_cam_x(t + t_d) = exp(-t_d xi) @ T_cam_x(t)               Eq. 3
                                   T_cam_object = T_cam_x(t + t_d) @ T_x_object

Eq. 2 chains from the uncompensated pose; Eq. 3 takes T_w_cam(t + t_d) from the twist of the
odometry at t, over the whole of t_d. Nothing is read of the object but x, the ids y and
`T_x_object`. Without odometry, or with Eq. 2 switched off, k == 0 leaves the pose as it was; that
is the baseline `multiart`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from spatial.frames import Cam, Object, Tag, Target, W
from spatial.pose import Pose
from spatial.rotation import Array
from tracking.consensus import consensus
from tracking.layout import MarkerKey, MarkerLayout, layout_estimates
from tracking.marker_pose import PlanarPose
from tracking.propagation import propagate


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """What Algorithm 1 knows of an object."""

    target: MarkerKey
    """The target marker x."""
    others: tuple[MarkerKey, ...]
    """The n other markers y."""
    T_x_object: Pose[Target, Object]
    """Pose of the object in the target marker."""


@dataclass(frozen=True, slots=True, eq=False)
class Memory:
    """What Algorithm 1 remembers from image to image."""

    layout: MarkerLayout | None = None
    """Marker-to-marker poses; `None` until initialised."""
    T_cam_x: Pose[Cam, Target] | None = None
    """Uncompensated pose of the target at the last image."""
    T_w_cam: Pose[W, Cam] | None = None
    """Camera in w at the last image, where odometry was."""
    branch: str = "waiting"
    """Branch of the last image: waiting, init, all, with_x, without_x, eq2 or held."""
    seen: int = 0
    """Tags seen in the last image."""
    supporters: int = 0
    """Candidates behind the last pose."""
    spread_m: float = 0.0
    """Their RMS distance from the mean [m]."""

    @property
    def fixed(self) -> bool:
        """Whether the last image gave a pose from tags."""
        return self.branch in ("init", "all", "with_x", "without_x")


def step(
    task: Task,
    memory: Memory,
    *,
    tags: Mapping[MarkerKey, PlanarPose],
    T_w_cam: Pose[W, Cam] | None,
) -> Memory:
    """Return what is remembered after one image.

    Args:
        task: the object.
        memory: from the image before.
        tags: pose of every tag of the object seen in this image.
        T_w_cam: camera in w at this image; `None` without odometry, or to switch Eq. 2 off.
    """
    seen = {key: tags[key] for key in (task.target, *task.others) if key in tags}
    now = replace(memory, seen=len(seen), T_w_cam=T_w_cam, supporters=0, spread_m=0.0)
    whole = len(seen) == 1 + len(task.others)
    if now.layout is None and not whole:
        return replace(now, branch="waiting")
    if not seen:
        return _carried(now, memory.T_w_cam)
    fresh = now.layout is None
    layout = now.layout or _layout(task, seen, None)
    poses, errors = _candidates(task, seen, layout)
    agreed = consensus(poses, reprojections_px=errors)
    if whole and not fresh:
        layout = _layout(task, seen, layout)
    partial = "with_x" if task.target in seen else "without_x"
    return replace(
        now,
        layout=layout,
        T_cam_x=agreed.pose,
        branch=("init" if fresh else "all") if whole else partial,
        supporters=len(agreed.supporters),
        spread_m=agreed.spread_m,
    )


def compensated(
    T_cam_x: Pose[Cam, Target],
    *,
    xi_w_cam_cam: Array,
    delay_s: float,
    T_x_object: Pose[Target, Object],
) -> Pose[Cam, Object]:
    """Return the object at t + t_d by Eq. 3.

    Args:
        T_cam_x: target at t.
        xi_w_cam_cam: body twist of the camera at t (6,).
        delay_s: t_d [s].
        T_x_object: object in the target.
    """
    still = Pose[W, Cam].identity()
    moved = Pose[W, Cam].exp(delay_s * xi_w_cam_cam)
    return propagate(T_cam_x, T_w_cam_then=still, T_w_cam_now=moved) @ T_x_object


def _carried(now: Memory, T_w_cam_then: Pose[W, Cam] | None) -> Memory:
    if now.T_cam_x is None or now.T_w_cam is None or T_w_cam_then is None:
        return replace(now, branch="held")
    T_cam_x = propagate(now.T_cam_x, T_w_cam_then=T_w_cam_then, T_w_cam_now=now.T_w_cam)
    return replace(now, branch="eq2", T_cam_x=T_cam_x)


def _target(pose: Pose[Cam, Tag]) -> Pose[Cam, Target]:
    return Pose[Cam, Target](pose.matrix)


def _candidates(
    task: Task, seen: Mapping[MarkerKey, PlanarPose], layout: MarkerLayout
) -> tuple[list[Pose[Cam, Target]], list[float]]:
    """Return the target as every seen tag has it (`trafo3d`), and reprojection errors [px]."""
    poses = [
        _target(found.T_cam_tag) if key == task.target else found.T_cam_tag @ layout.Ts_y_x[key]
        for key, found in seen.items()
    ]
    return poses, [found.reprojection_px for found in seen.values()]


def _layout(
    task: Task, seen: Mapping[MarkerKey, PlanarPose], before: MarkerLayout | None
) -> MarkerLayout:
    target = seen[task.target]
    estimates = layout_estimates(
        {key: (seen[key].T_cam_tag, seen[key].reprojection_px) for key in task.others},
        T_cam_x=_target(target.T_cam_tag),
        reprojection_px=target.reprojection_px,
    )
    return MarkerLayout.initialised(estimates) if before is None else before.updated(estimates)
