"""Immutable state of the scene at one instant T*: what the page draws, and nothing else.

Everything is in `base`, the display root; the stage turns it into another root where asked.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from spatial.frames import Base, Cam, Frame, Object, Platform, Tcp, W
from spatial.pose import Pose
from spatial.rotation import Array
from spatial.tracked import TrackState


@dataclass(frozen=True, slots=True, eq=False)
class ObjectNode:
    """One object of the scene."""

    slug: str
    """Name in the database."""
    revision: int
    """Revision of the database entry."""
    state: TrackState
    """How much to trust the pose."""
    hierarchy: str
    """`nested` (driven by the tcp, Eq. 1) or `flat` (Eq. 4)."""
    T_base_object: Pose[Base, Object] | None
    """Delay-compensated pose at T*; the last one held when STALE or LOST; `None` if never seen."""
    T_base_object_raw: Pose[Base, Object] | None
    """Newest measured pose, neither bridged nor compensated; `None` if never seen."""
    covariance_base: Array
    """Covariance (3, 3) of the position, in base axes [m^2]."""
    seen_ms: float | None
    """T* minus capture of the newest image behind it [ms]; `None` if never seen."""
    predicted_ms: float | None
    """T* minus the newest motion sample under it [ms]; `None` without motion."""
    camera: str
    """Camera that carries it."""
    reason: str
    """Why the state is what it is."""


@dataclass(frozen=True, slots=True, eq=False)
class SceneState:
    """The scene at T*."""

    instant_ns: int
    """T* [ns]: joints, anchors and motion are evaluated at this one instant."""
    tick: int
    """Counts the states of this viewer from its start: the page's heartbeat."""
    Ts_base_link: Mapping[str, Pose[Base, Frame]]
    """Pose of every link of the robot in base."""
    T_base_tcp: Pose[Base, Tcp]
    """Tool centre point."""
    T_base_platform: Pose[Base, Platform]
    """Platform, rigid to the base."""
    T_base_w: Pose[Base, W] | None
    """Odometry world, the gravity direction; `None` before the first motion sample."""
    Ts_base_cam: Mapping[str, Pose[Base, Cam]]
    """Pose of every camera in base."""
    objects: tuple[ObjectNode, ...]
    """Objects, in the order of `site.toml`."""
    robot_ms: float | None
    """Age of the newest joint sample [ms]; `None` before the first."""
