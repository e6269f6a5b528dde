"""Prepares camera images for tabs: smaller for panels, without lens distortion for overlays.

Decoding a JPEG straight to half its size costs a third of decoding it whole; what nobody asked
for is not prepared; what needs no change passes untouched.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from app.audience import Variant
from spatial.camera import PinholeCamera

QUALITY = {Variant.HALF: 72, Variant.QUARTER: 60, Variant.OVERLAY: 75}
REDUCED = {Variant.HALF: cv2.IMREAD_REDUCED_COLOR_2, Variant.QUARTER: cv2.IMREAD_REDUCED_COLOR_4}
SCALE = {Variant.HALF: 2, Variant.QUARTER: 4}


class Darkroom:
    """Develops the images of one camera."""

    def __init__(self, camera: PinholeCamera) -> None:
        """Remember the intrinsics; tables are made when they are first needed."""
        self._camera = camera
        self._tables: tuple[Any, Any] | None = None

    def develop(self, jpeg: bytes, variant: Variant) -> tuple[bytes, int, int] | None:
        """Return image, width and height [px] of a variant.

        `None` for what is no image, or not of the size the intrinsics say.
        """
        camera = self._camera
        distorted = any(camera.distortion)
        if variant is Variant.FULL or (variant is Variant.OVERLAY and not distorted):
            return jpeg, camera.width, camera.height
        image = _decode(jpeg, REDUCED.get(variant, cv2.IMREAD_COLOR))
        scale = SCALE.get(variant, 1)
        expected = (-(-camera.height // scale), -(-camera.width // scale))
        if image is None or image.shape[:2] != expected:
            return None
        if variant is Variant.OVERLAY:
            image = cv2.remap(image, *self._undistortion(), cv2.INTER_LINEAR)
        options = [cv2.IMWRITE_JPEG_QUALITY, QUALITY[variant]]
        done, data = cv2.imencode(".jpg", image, options)
        height, width = image.shape[:2]
        return (data.tobytes(), width, height) if done else None

    def _undistortion(self) -> tuple[Any, Any]:
        if self._tables is None:
            c = self._camera
            self._tables = cv2.initUndistortRectifyMap(
                c.K, np.array(c.distortion), np.eye(3), c.K, (c.width, c.height), cv2.CV_16SC2
            )
        return self._tables


def _decode(jpeg: bytes, flags: int) -> Any:
    try:
        return cv2.imdecode(np.frombuffer(jpeg, np.uint8), flags)
    except cv2.error:  # what it raises for nothing at all; otherwise it returns None
        return None
