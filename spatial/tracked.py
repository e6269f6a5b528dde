"""What a tracker says of objects, as plain data."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from spatial.frames import Cam, Object
from spatial.pose import Pose
from spatial.rotation import Array


class TrackState(Enum):
    """How much a shown pose may be trusted; limits are in `site.toml`."""

    TRACKED = "tracked"
    """A fix from pixels, at most 150 ms older than the delay of the image stream."""
    BRIDGED = "bridged"
    """No fix, carried by camera motion (Eq. 2); positional 3 sigma at most 60 mm."""
    STALE = "stale"
    """Neither; the pose is held."""
    LOST = "lost"
    """STALE for over 0.5 s, never seen, or the world was reset."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseMeasurement:
    """Pose of one object from one image, between detection and fusion, whoever measured it."""

    camera: str
    """Name of the camera."""
    slug: str
    """Name of the object."""
    stamp_ns: int
    """Capture stamp of the image [ns]."""
    T_cam_object: Pose[Cam, Object]
    """Pose of the object in the camera at that stamp."""
    covariance: Array
    """(6, 6), translation [m] then rotation [rad], right perturbation in the object frame."""
    source: str
    """Method that measured it."""


@dataclass(frozen=True, slots=True, eq=False)
class TrackedObject:
    """One object at the instant of the message it is in."""

    slug: str
    """Name of the object."""
    revision: int
    """Revision of the database entry tracked with."""
    camera: str
    """Camera that carries it."""
    state: TrackState
    """How much to trust it."""
    T_cam_object: Pose[Cam, Object] | None
    """Pose in the camera at the message's stamp; `None` before the first fix."""
    xi_w_cam_cam: Array
    """Body twist (6,) of the camera in w, to carry the pose on by a few ms (Eq. 3)."""
    covariance: Array
    """(6, 6), translation [m] then rotation [rad], right perturbation in the object frame."""
    seen_ns: int
    """Capture stamp of the newest image behind it [ns]; 0 before the first fix."""
    motion_ns: int
    """Newest motion sample under it [ns]; 0 without motion."""
    reset_count: int
    """Of the odometry's world it is anchored in."""
    reason: str
    """One sentence: why the state is what it is."""


@dataclass(frozen=True, slots=True, eq=False)
class TrackedObjects:
    """All objects at the stamp of one motion sample."""

    stamp_ns: int
    """Instant the poses are predicted to [ns]."""
    objects: tuple[TrackedObject, ...]
    """One per object of the site."""


@dataclass(frozen=True, slots=True, eq=False)
class TagUse:
    """What became of one marker in one image."""

    family: str
    """Family of the marker."""
    id: int
    """Number within the family."""
    corners_px: Array
    """Corners (4, 2) TL TR BR BL [px]."""
    used: bool
    """Whether it shaped the pose."""
    reason: str
    """Why it was refused; empty when used."""
    residual_px: float
    """RMS distance between its corners and the pose's projection [px]."""


@dataclass(frozen=True, slots=True, eq=False)
class TrackReport:
    """Why the pose of one object is what it is, at one image."""

    camera: str
    """Name of the camera."""
    slug: str
    """Name of the object."""
    stamp_ns: int
    """Capture stamp of the image [ns]."""
    method: str
    """Method of the tracker."""
    tags: tuple[TagUse, ...]
    """Markers of this object found in the image."""
    expected_ids: tuple[int, ...]
    """Ids of the markers expected in view."""
    T_cam_object: Pose[Cam, Object] | None
    """Raw measured pose at the image's stamp; `None` without a fix."""
    T_cam_object_prior: Pose[Cam, Object] | None
    """Predicted pose at the image's stamp, before the image was looked at."""
    hypotheses: int
    """Number of candidate poses weighed."""
    residual_px: float
    """RMS reprojection residual of the used corners [px]; 0 without a fix."""
    reason: str
    """Why there is no fix; empty when there is one."""
