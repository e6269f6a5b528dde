"""Pictures of square markers, as they are printed: first row on top, white quiet zone around."""

from __future__ import annotations

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
"""Families whose pictures OpenCV makes."""


def marker_pixels(
    family: str, marker_id: int, *, cells_px: int = 16, quiet_cells: int = 1
) -> NDArray[np.uint8]:
    """Return the picture (n, n) of a marker, 0 black and 255 white.

    Args:
        family: name of the family.
        marker_id: number within it.
        cells_px: edge of one cell [px].
        quiet_cells: width of the white zone around the black square, in cells.

    Raises:
        InputError: a family without pictures, or a number it does not have.
    """
    side = side_cells(family)
    dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARIES[family])
    if not 0 <= marker_id < family_size(family):
        last = family_size(family) - 1
        raise InputError(f"marker id {marker_id} is not in {family}; it has 0 to {last}")
    cells = cv2.aruco.generateImageMarker(dictionary, marker_id, side)
    padded = np.pad(cells, quiet_cells, constant_values=255)
    return np.kron(padded, np.ones((cells_px, cells_px), np.uint8)).astype(np.uint8)


def side_cells(family: str) -> int:
    """Return the number of cells along the edge of the outer black square."""
    if family not in DICTIONARIES:
        raise InputError(unknown("marker family", family, DICTIONARIES))
    return int(cv2.aruco.getPredefinedDictionary(DICTIONARIES[family]).markerSize) + 2


def family_size(family: str) -> int:
    """Return how many markers a family has; numbers are 0 to this less one."""
    if family not in DICTIONARIES:
        raise InputError(unknown("marker family", family, DICTIONARIES))
    return len(cv2.aruco.getPredefinedDictionary(DICTIONARIES[family]).bytesList)
