"""Prepares camera images for tabs: smaller for panels, without lens distortion for overlays.

Images may come smaller than the calibration says (the operator's video has a budget); their
intrinsics scale with them. What nobody asked for is not prepared, what needs no change passes
untouched, and decoding a JPEG straight to half its size costs a third of decoding it whole.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from app.audience import Variant
from spatial.camera import PinholeCamera

QUALITY = {Variant.HALF: 72, Variant.QUARTER: 60, Variant.OVERLAY: 75}
REDUCED = {1: cv2.IMREAD_COLOR, 2: cv2.IMREAD_REDUCED_COLOR_2, 4: cv2.IMREAD_REDUCED_COLOR_4}
SHARE = {Variant.HALF: 2, Variant.QUARTER: 4}
"""A variant is at most the calibrated size divided by this."""
FRAME_HEADERS = frozenset({0xC0, 0xC1, 0xC2})
"""JPEG markers of a frame header: baseline, extended, progressive."""


@dataclass(frozen=True, slots=True, eq=False)
class Print:
    """An image ready for a tab."""

    jpeg: bytes
    """The image."""
    camera: PinholeCamera
    """Intrinsics of this image, at its own size."""


class Darkroom:
    """Develops the images of one camera."""

    def __init__(self, camera: PinholeCamera) -> None:
        """Remember the intrinsics; tables are made when they are first needed."""
        self._camera = camera
        self._tables: dict[tuple[int, int], tuple[Any, Any]] = {}

    def develop(self, jpeg: bytes, variant: Variant) -> Print | None:
        """Return the image in a variant.

        `None` for what is no JPEG, or has not the shape the intrinsics say.
        """
        size = jpeg_size(jpeg)
        if size is None or not self._fits(*size):
            return None
        camera = self._camera.scaled(*size)
        if variant is Variant.OVERLAY and any(camera.distortion):
            return self._undistorted(jpeg, camera)
        factor = _factor(size[0], self._camera.width, SHARE.get(variant, 1))
        if factor == 1:
            return Print(jpeg, camera)
        image = _decode(jpeg, REDUCED[factor])
        return None if image is None else _print(image, camera, variant)

    def _fits(self, width: int, height: int) -> bool:
        """Return whether an image has the calibrated shape to within a pixel."""
        c = self._camera
        return width <= c.width and abs(width * c.height - height * c.width) <= max(
            c.width, c.height
        )

    def _undistorted(self, jpeg: bytes, camera: PinholeCamera) -> Print | None:
        image = _decode(jpeg, cv2.IMREAD_COLOR)
        if image is None:
            return None
        size = (camera.width, camera.height)
        if size not in self._tables:
            self._tables[size] = cv2.initUndistortRectifyMap(
                camera.K, np.array(camera.distortion), np.eye(3), camera.K, size, cv2.CV_16SC2
            )
        straight = cv2.remap(image, *self._tables[size], cv2.INTER_LINEAR)
        return _print(straight, camera.undistorted(), Variant.OVERLAY)


def jpeg_size(jpeg: bytes) -> tuple[int, int] | None:
    """Return width and height [px] from the header of a JPEG, `None` when it is none."""
    if jpeg[:2] != b"\xff\xd8":
        return None
    at = 2
    while at + 9 <= len(jpeg) and jpeg[at] == 0xFF:
        if jpeg[at + 1] in FRAME_HEADERS:
            height, width = (int.from_bytes(jpeg[at + i : at + i + 2], "big") for i in (5, 7))
            return (width, height) if width and height else None
        at += 2 + int.from_bytes(jpeg[at + 2 : at + 4], "big")
    return None


def _factor(width: int, calibrated: int, share: int) -> int:
    """Return by which of 1, 2 and 4 a width is divided to be at most its share."""
    return next((f for f in (1, 2) if width * share <= f * (calibrated + share)), 4)


def _print(image: Any, camera: PinholeCamera, variant: Variant) -> Print | None:
    done, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY[variant]])
    height, width = image.shape[:2]
    return Print(data.tobytes(), camera.scaled(width, height)) if done else None


def _decode(jpeg: bytes, flags: int) -> Any:
    try:
        return cv2.imdecode(np.frombuffer(jpeg, np.uint8), flags)
    except cv2.error:  # what it raises for nothing at all; otherwise it returns None
        return None
