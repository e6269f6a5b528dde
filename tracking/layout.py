"""Marker-to-marker poses learnt while running: the paper's `tag_init` and `tag_init_update`.

    T_y_x = inv(T_cam_y) @ T_cam_x          one estimate per image in which all n + 1 tags are seen

Every estimate is saved; the layout holds, per tag, the consensus of its saved estimates.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from spatial.frames import Cam, Tag, Target
from spatial.pose import Pose
from tracking.consensus import consensus

MarkerKey = tuple[str, int]

SAVED = 20
"""Estimates kept per tag."""


@dataclass(frozen=True, slots=True, eq=False)
class Estimate:
    """One estimate of a marker-to-marker pose."""

    T_y_x: Pose[Tag, Target]
    """Target in the tag."""
    reprojection_px: float
    """Sum of the reprojection errors of both [px]."""


@dataclass(frozen=True, slots=True, eq=False)
class MarkerLayout:
    """Where the target is, seen from every other tag."""

    Ts_y_x: Mapping[MarkerKey, Pose[Tag, Target]]
    """Pose of the target in tag y, by tag."""
    saved: Mapping[MarkerKey, tuple[Estimate, ...]]
    """Estimates behind it, oldest first."""

    @classmethod
    def initialised(cls, estimates: Mapping[MarkerKey, Estimate]) -> MarkerLayout:
        """Return the layout of one image in which all tags are seen (`tag_init`)."""
        return cls(
            {key: e.T_y_x for key, e in estimates.items()},
            {key: (e,) for key, e in estimates.items()},
        )

    def updated(self, estimates: Mapping[MarkerKey, Estimate]) -> MarkerLayout:
        """Return the layout after another such image (`tag_init_update`)."""
        saved = {key: (*self.saved[key], e)[-SAVED:] for key, e in estimates.items()}
        agreed = {
            key: consensus(
                [e.T_y_x for e in held], reprojections_px=[e.reprojection_px for e in held]
            ).pose
            for key, held in saved.items()
        }
        return MarkerLayout(agreed, saved)


def layout_estimates(
    Ts_cam_y: Mapping[MarkerKey, tuple[Pose[Cam, Tag], float]],
    *,
    T_cam_x: Pose[Cam, Target],
    reprojection_px: float,
) -> dict[MarkerKey, Estimate]:
    """Return an estimate per tag from one image.

    Args:
        Ts_cam_y: pose and reprojection error [px] of every other tag.
        T_cam_x: pose of the target.
        reprojection_px: its reprojection error [px].
    """
    return {
        key: Estimate(T_cam_y.inverse() @ T_cam_x, error + reprojection_px)
        for key, (T_cam_y, error) in Ts_cam_y.items()
    }
