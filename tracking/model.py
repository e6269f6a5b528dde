"""What a tracker is given, and what it remembers: plain immutable data."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from spatial.camera import PinholeCamera
from spatial.errors import InputError, unknown
from spatial.frames import Cam, Object, W
from spatial.marker import MarkedObject, Marker
from spatial.pose import Pose
from spatial.rotation import Array
from spatial.stamp import NS_PER_MS
from tracking.algorithm1 import Memory
from tracking.families import cells

METHODS = ("joint", "algorithm1", "multiart", "single")
"""Methods of this tracker; `apriltag2` of the contract is a process of its own."""


class Limits(Protocol):
    """When a pose stops being trusted (contract: States)."""

    @property
    def tracked_ns(self) -> int:
        """A fix at most this much older than its stream's delay is TRACKED [ns]."""
        ...

    @property
    def bridged_motion_ns(self) -> int:
        """A bridged pose needs motion at most this old [ns]."""
        ...

    @property
    def bridged_sigma_m(self) -> float:
        """... and a largest positional 3 sigma of at most this [m]."""
        ...

    @property
    def lost_after_ns(self) -> int:
        """STALE for longer than this is LOST [ns]."""
        ...

    @property
    def horizon_ns(self) -> int:
        """Nothing is extrapolated for longer than this [ns]."""
        ...


@dataclass(frozen=True, slots=True)
class StandardLimits:
    """The contract's limits."""

    tracked_ns: int = 150 * NS_PER_MS
    """See `Limits`."""
    bridged_motion_ns: int = 300 * NS_PER_MS
    """See `Limits`."""
    bridged_sigma_m: float = 0.060
    """See `Limits`."""
    lost_after_ns: int = 500 * NS_PER_MS
    """See `Limits`."""
    horizon_ns: int = 100 * NS_PER_MS
    """See `Limits`."""


@dataclass(frozen=True, slots=True, eq=False)
class GrayImage:
    """A decoded image."""

    stamp_ns: int
    """Capture stamp [ns]."""
    pixels: NDArray[np.uint8]
    """Grey values (H, W)."""


@dataclass(frozen=True, slots=True, eq=False)
class MarkerTable:
    """All markers of a model as arrays, object after object."""

    markers: tuple[Marker, ...]
    """The markers (m)."""
    owner: NDArray[np.int64]
    """Index (m,) of each marker's object."""
    corners_object: Array
    """Corners (m, 4, 3) [m] in the object."""
    normals_object: Array
    """Unit normals (m, 3) out of the printed faces, in the object."""
    sides: NDArray[np.int64]
    """Cells (m,) along each black square."""

    @classmethod
    def of(cls, objects: tuple[MarkedObject, ...]) -> MarkerTable:
        """Return the table of some objects.

        Raises:
            InputError: a family this build cannot read, or an id that family does not have.
        """
        pairs = [(i, m) for i, item in enumerate(objects) for m in item.markers]
        markers = tuple(m for _, m in pairs)
        return cls(
            markers=markers,
            owner=np.array([i for i, _ in pairs], dtype=np.int64),
            corners_object=np.array([m.corners_object for m in markers]).reshape(-1, 4, 3),
            normals_object=np.array([m.T_object_marker.rotation[:, 2] for m in markers]).reshape(
                -1, 3
            ),
            sides=np.array([cells(m.family, m.id).shape[0] for m in markers], dtype=np.int64),
        )


@dataclass(frozen=True, slots=True, eq=False)
class TrackerModel:
    """What the tracker of one camera is given; constant."""

    camera: PinholeCamera
    """Intrinsics."""
    camera_name: str
    """Name of the camera."""
    objects: tuple[MarkedObject, ...]
    """Objects it carries."""
    method: str = "joint"
    """One of `METHODS`."""
    limits: Limits = field(default_factory=StandardLimits)
    """Limits of the states."""
    search_ns: int = 400 * NS_PER_MS
    """Shortest time between two searches of the whole image [ns]."""
    blend_ns: int = 200 * NS_PER_MS
    """A visible correction is shown over this time [ns]."""
    table: MarkerTable = field(init=False)
    """All markers as arrays."""

    def __post_init__(self) -> None:
        """Check and arrange the markers.

        Raises:
            InputError: an unknown method or family, a target no marker has, a marker twice.
        """
        if self.method not in METHODS:
            raise InputError(unknown("method", self.method, METHODS))
        keys: set[tuple[str, int]] = set()
        for item in self.objects:
            own = {m.key for m in item.markers}
            if item.target not in own:
                names = ", ".join(f"{family} {number}" for family, number in sorted(own))
                raise InputError(f"target {item.target} of {item.slug!r} is none of: {names}")
            if len(own) < len(item.markers) or own & keys:
                raise InputError(f"{item.slug!r} has a marker that already exists on an object")
            keys |= own
        object.__setattr__(self, "table", MarkerTable.of(self.objects))


@dataclass(frozen=True, slots=True, eq=False)
class Anchor:
    """Fused pose of an object: in the odometry's world, or in the camera."""

    T_ref_object: Pose[W, Object]
    """Pose in w (freed of jumps), or in the camera where `in_world` is False."""
    covariance: Array
    """(6, 6), right perturbation in the object frame, at `stamp_ns`."""
    stamp_ns: int
    """Image of the last fix fused [ns]."""
    in_world: bool
    """Whether the reference is w."""
    reset_count: int
    """Of the odometry's world, at the last fix."""
    refused: int = 0
    """Fixes in a row that contradicted it and agreed with each other."""
    rival: Anchor | None = None
    """The first of them."""


@dataclass(frozen=True, slots=True, eq=False)
class Blend:
    """A correction not yet wholly shown: shown = anchor @ exp(share xi)."""

    xi: Array
    """Tangent (6,) from the anchor to what was shown at the start."""
    start_ns: int
    """Instant it began [ns]."""
    duration_ns: int
    """Time it takes [ns]."""

    def share(self, instant_ns: int) -> float:
        """Return how much of it is still shown, 1 to 0."""
        return min(max(1.0 - (instant_ns - self.start_ns) / self.duration_ns, 0.0), 1.0)


@dataclass(frozen=True, slots=True, eq=False)
class Fix:
    """Pose from the newest image that gave one, as the method has it; Eq. 2 counts as one."""

    stamp_ns: int
    """Image [ns]."""
    T_cam_object: Pose[Cam, Object]
    """Pose of the object in the camera at that image, uncompensated."""
    covariance: Array
    """(6, 6), right perturbation in the object frame."""
    xi_w_cam_cam: Array
    """Body twist (6,) of the camera at that image, zero where unknown."""


@dataclass(frozen=True, slots=True, eq=False)
class ObjectState:
    """What is remembered of one object."""

    anchor: Anchor | None = None
    """Fused pose: predicts corners for every method, and is the answer of `joint`."""
    fix: Fix | None = None
    """Newest pose of the method."""
    memory: Memory = field(default_factory=Memory)
    """Of Algorithm 1."""
    blend: Blend | None = None
    """Correction being shown."""
    seen_ns: int = 0
    """Newest image in which the method had tags to go by [ns]; 0 before the first."""
    reset_count: int = 0
    """Of the odometry's world at that image."""
    tags: int = 0
    """Tags behind the newest fix."""
    note: str = "never seen"
    """Why there is no fix, until there is one."""


@dataclass(frozen=True, slots=True, eq=False)
class TrackerState:
    """What a tracker remembers; every observation makes a new one."""

    objects: tuple[ObjectState, ...]
    """One per object of the model, in its order."""
    image_ns: int = 0
    """Newest image looked at [ns]."""
    searched_ns: int = 0
    """Last search of the whole image [ns]."""
    region_ns: int = 0
    """Last search of a region [ns]."""
    delays_ns: tuple[int, ...] = ()
    """Newest motion stamp minus image stamp, at the last images [ns]."""

    @property
    def delay_ns(self) -> int:
        """Measured delay of the image stream: the running median [ns]."""
        middle = len(self.delays_ns) // 2
        return max(sorted(self.delays_ns)[middle], 0) if self.delays_ns else 0
