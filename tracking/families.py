"""Marker families: the cells of every marker, from OpenCV's dictionaries.

A marker is a grid of `side` x `side` cells whose outermost ring is black; outside it lies a white
quiet zone at least one cell wide. Rows run downwards from the top edge TL-TR. OpenCV turns
AprilTag families by 180 degrees against the AprilTag library: a map made there does not fit here.
"""

from __future__ import annotations

from functools import cache, lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from spatial.errors import InputError, unknown

DICTIONARIES = {
    "tag36h11": cv2.aruco.DICT_APRILTAG_36h11,
    "tag25h9": cv2.aruco.DICT_APRILTAG_25h9,
    "tag16h5": cv2.aruco.DICT_APRILTAG_16h5,
    "aruco4x4": cv2.aruco.DICT_4X4_1000,
    "aruco5x5": cv2.aruco.DICT_5X5_1000,
    "aruco6x6": cv2.aruco.DICT_6X6_1000,
    "aruco7x7": cv2.aruco.DICT_7X7_1000,
    "aruco_mip_36h12": cv2.aruco.DICT_ARUCO_MIP_36h12,
}
"""Families this build reads; the ids of OpenCV's smaller ArUco sets are the first of these."""


@cache
def dictionary(family: str) -> cv2.aruco.Dictionary:
    """Return OpenCV's dictionary of a family.

    Raises:
        InputError: a family this build cannot read, with those it can.
    """
    if family not in DICTIONARIES:
        raise InputError(unknown("marker family", family, DICTIONARIES))
    return cv2.aruco.getPredefinedDictionary(DICTIONARIES[family])


def side_cells(family: str) -> int:
    """Return the number of cells along the outer black square of a family."""
    return int(dictionary(family).markerSize) + 2


@lru_cache(maxsize=4096)
def cells(family: str, marker_id: int) -> NDArray[np.bool_]:
    """Return the cells (side, side) of a marker, black ring included; True is white.

    Raises:
        InputError: an unknown family, or an id it does not have.
    """
    table = dictionary(family)
    count = len(table.bytesList)
    if not 0 <= marker_id < count:
        raise InputError(f"marker id {marker_id} is not in {family}, which has 0 to {count - 1}")
    side = side_cells(family)
    pattern = cv2.aruco.generateImageMarker(table, marker_id, side) > 127
    pattern.flags.writeable = False
    return pattern
