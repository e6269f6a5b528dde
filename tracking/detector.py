"""Full-frame search for markers with OpenCV; corners refined by our own edge fit.

Corners are TL TR BR BL of the outer black square, pixel centres at integers.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from spatial.camera import PinholeCamera
from spatial.errors import InputError, unknown
from spatial.rotation import Array
from tracking.edges import refine_corners
from tracking.families import dictionary, side_cells

Refinement = Literal["edges", "subpix", "none"]
REFINEMENTS: tuple[Refinement, ...] = ("edges", "subpix", "none")
EDGE_SEARCH_PX = 4.0
"""OpenCV's raw corners are a pixel or two off; farther out is another edge [px]."""
RAW_NOISE_PX = 1.0
"""Said of corners without refined edges [px]."""


@dataclass(frozen=True, slots=True, eq=False)
class Detection:
    """A marker found in an image."""

    family: str
    """Family of the marker."""
    id: int
    """Number within the family."""
    corners_px: Array
    """Corners (4, 2) TL TR BR BL [px]."""
    noise_px: float = RAW_NOISE_PX
    """Scatter of the edge points behind the corners [px]."""

    @property
    def key(self) -> tuple[str, int]:
        """Family and id."""
        return self.family, self.id


def detect(
    gray: NDArray[np.uint8],
    *,
    family: str = "tag36h11",
    refine: Refinement = "edges",
    camera: PinholeCamera | None = None,
) -> tuple[Detection, ...]:
    """Return the markers of one family in an image (H, W) uint8, by id.

    Args:
        gray: the image.
        family: one of `tracking.families.DICTIONARIES`.
        refine: `edges` (ours, default), `subpix` (OpenCV's corners), `none` (raw).
        camera: lets `edges` follow edges the lens has bent.

    Raises:
        InputError: an unknown family or refinement, or an image that is not (H, W) uint8.
    """
    if refine not in REFINEMENTS:
        raise InputError(unknown("refinement", refine, REFINEMENTS))
    ids, corners = search(gray, family=family, subpixel=refine == "subpix")
    noise = np.full(len(corners), RAW_NOISE_PX)
    if refine == "edges":
        sides = np.full(len(corners), side_cells(family))
        refined = refine_corners(
            gray, corners_px=corners, sides=sides, camera=camera, search_px=EDGE_SEARCH_PX
        )
        corners = refined.corners_px
        noise = np.where(refined.ok, refined.noise_px, RAW_NOISE_PX)
    found = zip(ids, corners, noise.tolist(), strict=True)
    detections = (Detection(family, i, c, float(n)) for i, c, n in found)
    return tuple(sorted(detections, key=lambda d: d.id))


def search(
    gray: NDArray[np.uint8], *, family: str, subpixel: bool = False
) -> tuple[list[int], Array]:
    """Return ids and raw corners (n, 4, 2) [px] that OpenCV finds in an image (H, W) uint8.

    Raises:
        InputError: an unknown family, or an image that is not (H, W) uint8.
    """
    if gray.ndim != 2 or gray.dtype != np.uint8:
        raise InputError(f"an image is (H, W) uint8, got {gray.shape} {gray.dtype}")
    quads, ids, _ = _engine(family, subpixel=subpixel).detectMarkers(gray)
    if ids is None or not len(ids):
        return [], np.zeros((0, 4, 2))
    return [int(i) for i in np.ravel(ids)], np.asarray(quads, dtype=np.float64).reshape(-1, 4, 2)


@lru_cache(maxsize=16)
def _engine(family: str, *, subpixel: bool) -> cv2.aruco.ArucoDetector:
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = (
        cv2.aruco.CORNER_REFINE_SUBPIX if subpixel else cv2.aruco.CORNER_REFINE_NONE
    )
    return cv2.aruco.ArucoDetector(dictionary(family), parameters)
