"""Agree on one pose among candidates: the paper's `ransac_avg`.

Every candidate is a hypothesis; its supporters lie within `near_m` and `near_rad`. The hypothesis
with most supporters wins, the lower mean reprojection of the supporters breaks a tie, and the
answer is their arithmetic mean translation and chordal mean rotation. One candidate passes through;
of two that disagree each has one supporter, so the lower reprojection wins.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from spatial.errors import InputError
from spatial.frames import Frame
from spatial.pose import Pose, mean_pose

A = TypeVar("A", bound=Frame)
B = TypeVar("B", bound=Frame)

NEAR_M, NEAR_RAD = 0.03, 0.20
"""Candidates closer than this support each other [m], [rad]."""


@dataclass(frozen=True, slots=True, eq=False)
class Consensus(Generic[A, B]):
    """Result of `consensus`."""

    pose: Pose[A, B]
    """Mean of the supporters."""
    supporters: tuple[int, ...]
    """Indices of the candidates it is the mean of."""
    spread_m: float
    """RMS distance of the supporters from the mean [m]."""


def consensus(
    Ts_a_b: Sequence[Pose[A, B]],
    *,
    reprojections_px: Sequence[float],
    near_m: float = NEAR_M,
    near_rad: float = NEAR_RAD,
) -> Consensus[A, B]:
    """Return what most candidates agree on.

    Args:
        Ts_a_b: at least one candidate.
        reprojections_px: reprojection error of each [px].
        near_m: largest distance between supporters [m].
        near_rad: largest angle between supporters [rad].

    Raises:
        InputError: no candidate, or not as many errors as candidates.
    """
    if not Ts_a_b or len(Ts_a_b) != len(reprojections_px):
        raise InputError(
            f"{len(Ts_a_b)} candidates with {len(reprojections_px)} reprojection errors"
        )
    stack = np.array([T.matrix for T in Ts_a_b])
    errors = np.asarray(reprojections_px, dtype=np.float64)
    distance = np.linalg.norm(stack[:, None, :3, 3] - stack[None, :, :3, 3], axis=2)
    trace = np.einsum("aij,bij->ab", stack[:, :3, :3], stack[:, :3, :3])
    angle = np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))
    support = (distance <= near_m) & (angle <= near_rad)
    support[np.diag_indices(len(Ts_a_b))] = True
    counts = support.sum(axis=1)
    means = support @ errors / counts
    winner = min(range(len(Ts_a_b)), key=lambda i: (-int(counts[i]), float(means[i]), i))
    chosen = np.flatnonzero(support[winner]).tolist()
    pose = mean_pose([Ts_a_b[i] for i in chosen])
    off = np.linalg.norm(stack[chosen, :3, 3] - pose.translation, axis=1)
    return Consensus(pose, tuple(chosen), float(np.sqrt((off**2).mean())))
