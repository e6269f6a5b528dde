"""Square fiducial markers as plain data."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from spatial.frames import Object, Tag
from spatial.pose import Pose
from spatial.rotation import Array

FAMILIES = (
    "tag36h11",
    "tag25h9",
    "tag16h5",
    "aruco4x4",
    "aruco5x5",
    "aruco6x6",
    "aruco7x7",
    "aruco_mip_36h12",
    "artoolkitplus_simple",
    "artoolkitplus_bch",
)
"""Names of the marker families, the same in files, messages and commands."""

UNIT_CORNERS = np.array([[-0.5, 0.5, 0.0], [0.5, 0.5, 0.0], [0.5, -0.5, 0.0], [-0.5, -0.5, 0.0]])
"""Corners (4, 3) of a marker of unit size in its own frame: TL, TR, BR, BL."""


@dataclass(frozen=True, slots=True, eq=False)
class Marker:
    """A marker mounted on an object."""

    family: str
    """One of `FAMILIES`."""
    id: int
    """Number within the family."""
    size_m: float
    """Edge of the outer black square [m]."""
    T_object_marker: Pose[Object, Tag]
    """Pose in the object: x right, y up, z out of the printed face."""

    @property
    def key(self) -> tuple[str, int]:
        """Family and id: unique over all objects of a database."""
        return self.family, self.id

    @property
    def corners_tag(self) -> Array:
        """Corners (4, 3) [m] in the marker's frame: TL, TR, BR, BL."""
        return self.size_m * UNIT_CORNERS

    @property
    def corners_object(self) -> Array:
        """Corners (4, 3) [m] in the object's frame: TL, TR, BR, BL."""
        return self.T_object_marker.apply(self.corners_tag)


@dataclass(frozen=True, slots=True, eq=False)
class MarkedObject:
    """What a tracker knows of an object."""

    slug: str
    """Name in the database."""
    revision: int
    """Revision of the database entry it was taken from."""
    target: tuple[str, int]
    """Family and id of the target marker, the paper's x."""
    markers: tuple[Marker, ...]
    """Every marker on the object, the target among them."""
    motion: str = "static"
    """`static`, `held` or `mobile` (contract: only a static one uses Eq. 2)."""
