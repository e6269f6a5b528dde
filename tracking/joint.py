"""One robust pose from all corners of an object.

    minimise over T:  sum_i rho_c( r_i(T)^2 / s_i^2 ),   r_i^2 = mean_k |u_ik - pi(T p_ik)|^2
    rho_c(x) = c^2 x / (c^2 + x)                          (Geman-McClure, one weight per tag)
    w_i = (c^2 / (c^2 + x_i))^2 / s_i^2
    T <- T exp(xi),  (J^T W J) xi = J^T W r,  J = d pi/d p  R [I, -hat(p)]

with c annealed from coarse to fine. Starts are both planar poses of every tag and the prediction.
A prediction chooses between minima, by its Mahalanobis distance, and never pulls the result. The
covariance is the inverse information matrix, scaled by the residuals when they exceed the noise.
A pose that no tag fits is none: half hidden edges bend a lone tag into what no square can be.
Four corners of a tag share one weight: a wrong entry in the marker map is wrong in all four.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from spatial.camera import PinholeCamera
from spatial.frames import Cam, Object
from spatial.marker import Marker
from spatial.pose import Pose
from spatial.rotation import Array
from tracking.marker_pose import planar_poses

REFUSED_WEIGHT = 0.15
"""A tag with a smaller robust weight did not shape the pose."""
CORNER_FLOOR_PX, CORNER_PER_SCATTER = 0.06, 0.6
"""Corner noise [px] = floor, plus this share of the scatter of the edge points."""
_SCORE_CAP_PX = 8.0
_SETTLED = 2e-6
"""A descent ends when no component of its step exceeds this [m or rad]."""
_COLD = (16.0, 8.0, 4.0, 2.0, *[1.0] * 8)
_WARM = (4.0, 2.0, *[1.0] * 6)
_SOFT_PX = 0.3
"""Differences in fit below it are noise: there the prediction decides [px]."""
_PRIOR_CAP = 40.0
_WIDEST = 0.5
"""Corner noise [px] up to which a noisier tag is given more room to fit."""
_CLEAR_PX = 1.5
"""Three tags and a clear majority that fit the prediction's descent this well [px] settle it."""


@dataclass(frozen=True, slots=True, eq=False)
class SeenTag:
    """A marker of an object and where it was found."""

    marker: Marker
    """The marker, with its place on the object."""
    corners_px: Array
    """Corners (4, 2) TL TR BR BL [px]."""
    noise_px: float = 0.1
    """Scatter of the edge points behind the corners [px]."""


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """A predicted pose."""

    T_cam_object: Pose[Cam, Object]
    """The prediction."""
    covariance: Array
    """(6, 6), right perturbation in the object frame."""


@dataclass(frozen=True, slots=True, eq=False)
class JointSolution:
    """Result of `solve_joint`."""

    T_cam_object: Pose[Cam, Object]
    """Pose of the object."""
    covariance: Array
    """(6, 6), translation [m] then rotation [rad], right perturbation in the object frame."""
    weights: Array
    """Robust weight (n,) of every tag, 0 to 1."""
    residuals_px: Array
    """RMS distance (n,) of each tag's corners from the projection [px]."""
    hypotheses: int
    """Number of starts weighed."""

    @property
    def used(self) -> NDArray[np.bool_]:
        """Which tags (n,) shaped the pose."""
        return np.asarray(self.weights >= REFUSED_WEIGHT)


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    points: Array
    rays: Array
    focal: Array
    sigma: Array


def solve_joint(
    camera: PinholeCamera, *, tags: Sequence[SeenTag], prior: Prior | None = None
) -> JointSolution | None:
    """Return the pose that explains the corners of all tags, `None` when there is none.

    Args:
        camera: intrinsics.
        tags: what was found of one object.
        prior: prediction for the instant of the image, where there is one.
    """
    if not tags:
        return None
    problem = _problem(camera, tags)
    if prior is not None and len(tags) > 2:
        pose = _descend(problem, prior.T_cam_object.matrix, _WARM)
        fits = int((_errors(problem, pose[None])[0] < _CLEAR_PX).sum())
        if fits > 2 and fits > 0.7 * len(tags):
            return _solution(problem, pose, 1)
    starts = [
        planar.T_cam_tag @ tag.marker.T_object_marker.inverse()
        for tag in tags
        for planar in planar_poses(tag.corners_px, size_m=tag.marker.size_m, camera=camera)
    ]
    if prior is not None:
        starts.append(prior.T_cam_object)
    if not starts:
        return None
    best: tuple[float, Array] | None = None
    for start, schedule in _chosen(problem, starts, prior):
        pose = _descend(problem, start, schedule)
        cost = _cost(problem, pose, prior)
        if np.isfinite(cost) and (best is None or cost < best[0]):
            best = cost, pose
    return None if best is None else _solution(problem, best[1], len(starts))


def _problem(camera: PinholeCamera, tags: Sequence[SeenTag]) -> _Problem:
    noise = np.array([tag.noise_px for tag in tags])
    return _Problem(
        points=np.array([tag.marker.corners_object for tag in tags]),
        rays=camera.normalise(np.array([tag.corners_px for tag in tags])),
        focal=np.array([camera.fx, camera.fy]),
        sigma=np.hypot(CORNER_FLOOR_PX, CORNER_PER_SCATTER * noise),
    )


def _chosen(
    problem: _Problem, starts: list[Pose[Cam, Object]], prior: Prior | None
) -> list[tuple[Array, tuple[float, ...]]]:
    """Return the starts worth descending: prediction, best, and best of another orientation."""
    stack = np.array([start.matrix for start in starts])
    errors = _errors(problem, stack)
    scores = np.minimum(errors, _SCORE_CAP_PX).sum(axis=1)
    order = np.argsort(scores, kind="stable")
    first = stack[order[0]]
    chosen: list[tuple[Array, tuple[float, ...]]] = [
        (first, _COLD if scores[order[0]] > len(errors[0]) else _WARM)
    ]
    trace = np.einsum("hij,ij->h", stack[order, :3, :3], first[:3, :3])
    others = order[trace < 2.94]  # more than 14 degrees away
    if len(others) and scores[others[0]] < 2.0 * scores[order[0]] + 1.0:
        chosen.append((stack[others[0]], _WARM))
    if prior is not None:
        chosen.append((stack[-1], _COLD))
    return chosen


def _errors(problem: _Problem, stack: Array) -> Array:
    """Return RMS corner errors (h, n) [px] of every tag under every pose (h, 4, 4)."""
    points = np.einsum("hij,nkj->hnki", stack[:, :3, :3], problem.points)
    points += stack[:, None, None, :3, 3]
    depth = points[..., 2:]
    with np.errstate(divide="ignore", invalid="ignore"):
        off = (points[..., :2] / depth - problem.rays) * problem.focal
    error = np.sqrt((off**2).sum(axis=-1).mean(axis=-1))
    return np.where((depth[..., 0] > 0.0).all(axis=-1), error, np.inf)


def _linearised(problem: _Problem, pose: Array) -> tuple[Array, Array]:
    """Return residuals (n, 8) [px] and their Jacobian (n, 8, 6) at a pose."""
    rotation = pose[:3, :3]
    p = problem.points
    q = p @ rotation.T + pose[:3, 3]
    inverse = 1.0 / q[..., 2:]
    uv = q[..., :2] * inverse
    residual = (problem.rays - uv) * problem.focal
    # d(uv)/dq R = (R_xy - uv R_z) / z
    turned = (rotation[:2] - uv[..., None] * rotation[2]) * inverse[..., None]
    turned = turned * problem.focal[:, None]
    jacobian = np.concatenate((turned, np.cross(p[:, :, None], turned)), axis=-1)
    n = len(p)
    return residual.reshape(n, 8), jacobian.reshape(n, 8, 6)


def _descend(problem: _Problem, start: Array, schedule: tuple[float, ...]) -> Array:
    """Gauss-Newton with annealed weights from a start (4, 4)."""
    pose = start
    for scale in schedule:
        residual, jacobian = _linearised(problem, pose)
        weight = _weights(problem, residual, scale) / problem.sigma**2
        weighted = jacobian * weight[:, None, None]
        information = np.einsum("nij,nik->jk", weighted, jacobian)
        gradient = np.einsum("nij,ni->j", weighted, residual)
        information[np.diag_indices(6)] *= 1.0 + 1e-9
        try:
            step = np.linalg.solve(information, gradient)
        except np.linalg.LinAlgError:
            return pose
        step *= min(1.0, 0.5 / max(float(np.abs(step).max()), 1e-12))
        pose = pose @ Pose[Object, Object].exp(step).matrix
        if scale <= 1.0 and np.abs(step).max() < _SETTLED:
            break
    return pose


def _weights(problem: _Problem, residual: Array, scale_px: float) -> Array:
    """Return Geman-McClure weights (n,) of tags with residuals (n, 8) [px]."""
    square = (residual**2).sum(axis=1) / 4.0
    limit = scale_px**2 + (3.0 * np.minimum(problem.sigma, _WIDEST)) ** 2
    return np.asarray((limit / (limit + square)) ** 2)


def _cost(problem: _Problem, pose: Array, prior: Prior | None) -> float:
    square = _errors(problem, pose[None])[0] ** 2
    cost = float((4.0 * square / (1.0 + square / 4.0) / (_SOFT_PX**2 + problem.sigma**2)).sum())
    if prior is None or not np.isfinite(cost):
        return cost if np.isfinite(square).all() else np.inf
    away = Pose[Object, Object](prior.T_cam_object.inverse().matrix @ pose).log()
    spread = prior.covariance + np.diag([1e-6] * 3 + [1e-3] * 3)
    return cost + min(float(away @ np.linalg.solve(spread, away)), _PRIOR_CAP)


def _solution(problem: _Problem, pose: Array, hypotheses: int) -> JointSolution | None:
    residual, jacobian = _linearised(problem, pose)
    weights = _weights(problem, residual, 1.0)
    if not (weights >= REFUSED_WEIGHT).any():
        return None
    scaled = jacobian * (weights / problem.sigma**2)[:, None, None]
    information = np.einsum("nij,nik->jk", scaled, jacobian)
    chi2 = float(((residual / problem.sigma[:, None]) ** 2 * weights[:, None]).sum())
    freedom = max(8.0 * float(weights.sum()) - 6.0, 2.0)
    try:
        covariance = np.linalg.inv(information) * max(1.0, chi2 / freedom)
    except np.linalg.LinAlgError:
        return None
    return JointSolution(
        T_cam_object=Pose(pose.copy()),
        covariance=0.5 * (covariance + covariance.T),
        weights=weights,
        residuals_px=np.sqrt((residual**2).sum(axis=1) / 4.0),
        hypotheses=hypotheses,
    )
