"""From a rendered picture to what travels: full quality for the tracker, a budget for the operator.

The video holds a bit rate by its JPEG quality, and by its size where quality is not enough: after
a frame of b bytes the quality moves against ln(b / budget per frame); at the lowest quality the
picture shrinks by a step, at a middling one it grows again.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from spatial.samples import ImageSample

IMAGE_QUALITY = 85
"""JPEG quality of the tracker's images: its corners move by under 0.04 px."""
VIDEO_QUALITY = 60
"""JPEG quality the video starts with."""
QUALITY_RANGE = (20, 85)
"""Lowest and highest JPEG quality of the video."""
VIDEO_WIDTHS = (640, 480, 360, 256)
"""Widths of the video [px], widest first."""
_GAIN = 12.0


def encode_jpeg(rgb: np.ndarray, *, quality: int) -> bytes:
    """Return the JPEG of an RGB picture (H, W, 3) uint8."""
    good, data = cv2.imencode(
        ".jpg", cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality]
    )
    assert good  # any 8-bit picture can be encoded
    return bytes(data)


def image_sample(rgb: np.ndarray, *, camera: str, stamp_ns: int) -> ImageSample:
    """Return the tracker's image of an RGB picture (H, W, 3) uint8."""
    return ImageSample(camera, stamp_ns, encode_jpeg(rgb, quality=IMAGE_QUALITY))


class VideoEncoder:
    """Keeps one camera's video within its share of the link."""

    def __init__(self, *, camera: str, bit_s: float, rate_hz: float) -> None:
        """Start at the middling quality.

        Args:
            camera: name of the camera.
            bit_s: bit rate it may take [bit/s].
            rate_hz: frames per second.
        """
        self._camera = camera
        self._budget = bit_s / 8.0 / rate_hz
        self._quality = float(VIDEO_QUALITY)
        self._size = 0

    @property
    def quality(self) -> int:
        """JPEG quality of the next frame."""
        return round(self._quality)

    def encode(self, rgb: np.ndarray, *, stamp_ns: int) -> ImageSample:
        """Return the operator's image of an RGB picture (H, W, 3) uint8."""
        height, width = rgb.shape[:2]
        scale = min(1.0, VIDEO_WIDTHS[self._size] / width)
        size = (round(scale * width), round(scale * height))
        data = encode_jpeg(_shrunk(rgb, size=size), quality=self.quality)
        self._adapt(math.log(len(data) / self._budget))
        return ImageSample(self._camera, stamp_ns, data)

    def _adapt(self, excess: float) -> None:
        """Answer a frame that is exp(excess) times its budget."""
        low, high = QUALITY_RANGE
        if excess > 0.0 and self._quality == low and self._size + 1 < len(VIDEO_WIDTHS):
            self._size += 1
        elif excess < 0.0 and self._quality > VIDEO_QUALITY and self._size > 0:
            self._size -= 1
            self._quality = VIDEO_QUALITY / 2
        step = min(max(-_GAIN * excess, -10.0), 2.0)
        self._quality = min(max(self._quality + step, low), high)


def _shrunk(rgb: np.ndarray, *, size: tuple[int, int]) -> np.ndarray:
    """Return a picture of a size (width, height): halved first where it can be.

    Halving by linear interpolation is the mean of four pixels, at a seventh of the price of a mean
    over areas; down to half the size linear interpolation misses no pixel either.
    """
    height, width = rgb.shape[:2]
    if size[0] <= width / 2.0:
        rgb = cv2.resize(rgb, (width // 2, height // 2), interpolation=cv2.INTER_LINEAR)
    if rgb.shape[1::-1] != size:
        how = cv2.INTER_LINEAR if size[0] >= rgb.shape[1] / 2.0 else cv2.INTER_AREA
        rgb = cv2.resize(rgb, size, interpolation=how)
    return np.asarray(rgb)
