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


@dataclass(frozen=True, slots=True, eq=False)
class Detection:
    """A marker found in an image."""

    family: str
    """Family of the marker."""
    id: int
    """Number within the family."""
    corners_px: Array
    """Corners (4, 2) TL TR BR BL [px]."""
    noise_px: float = 0.25
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
    if gray.ndim != 2 or gray.dtype != np.uint8:
        raise InputError(f"an image is (H, W) uint8, got {gray.shape} {gray.dtype}")
    quads, ids, _ = _engine(family, subpixel=refine == "subpix").detectMarkers(gray)
    if ids is None or not len(ids):
        return ()
    corners = np.asarray(quads, dtype=np.float64).reshape(-1, 4, 2)
    noise = np.full(len(corners), 0.25)
    if refine == "edges":
        sides = np.full(len(corners), side_cells(family))
        refined = refine_corners(
            gray, corners_px=corners, sides=sides, camera=camera, search_px=EDGE_SEARCH_PX
        )
        corners = refined.corners_px
        noise = np.where(refined.ok, refined.noise_px, 1.0)
    found = zip(np.ravel(ids).tolist(), corners, noise.tolist(), strict=True)
    detections = (Detection(family, int(i), c, float(n)) for i, c, n in found)
    return tuple(sorted(detections, key=lambda d: d.id))


@lru_cache(maxsize=16)
def _engine(family: str, *, subpixel: bool) -> cv2.aruco.ArucoDetector:
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = (
        cv2.aruco.CORNER_REFINE_SUBPIX if subpixel else cv2.aruco.CORNER_REFINE_NONE
    )
    return cv2.aruco.ArucoDetector(dictionary(family), parameters)
