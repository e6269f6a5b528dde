"""From the ideal image a renderer draws to the image a camera delivers.

A renderer draws without distortion, on a canvas that holds every ray of the true image; one
remapping bends it: the pixel u of the camera comes from `K_canvas normalise(u)` of the canvas.
Exposure averages sub-frames; gain, offset and noise follow.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from spatial.camera import PinholeCamera
from spatial.rotation import Array

Image = NDArray[np.uint8]
Light = NDArray[np.float32]
_COARSE_PX = 4.0

Level = TypeVar("Level", np.uint8, np.float32)


@dataclass(frozen=True, slots=True)
class Sensor:
    """What a sensor does to light, and for how long it looks."""

    exposure_s: float = 0.006
    """Time the shutter is open [s]."""
    noise: float = 2.0
    """Standard deviation of a pixel [grey levels]."""
    gain_ripple: float = 0.03
    """Amplitude of the slow hunting of the automatic gain, relative."""
    gain_period_s: float = 7.0
    """Its period [s]."""
    offset: float = 3.0
    """Black level [grey levels]."""


class Lens:
    """Bends ideal images as a camera's lens does."""

    def __init__(self, camera: PinholeCamera) -> None:
        """Prepare the canvas and the maps of a camera."""
        self.canvas, self._maps = _canvas(camera)

    def bend(self, ideal: NDArray[Level]) -> NDArray[Level]:
        """Return the camera's image of an ideal image (H, W, 3) of the canvas."""
        if self._maps is None:
            return ideal
        bent = cv2.remap(ideal, self._maps[0], self._maps[1], cv2.INTER_LINEAR)
        return np.asarray(bent, dtype=ideal.dtype)


def expose(light: Light, sensor: Sensor, *, time_s: float, rng: np.random.Generator) -> Image:
    """Return the image (H, W, 3) of light (H, W, 3) in grey levels, with gain and noise."""
    ripple = sensor.gain_ripple * np.sin(2.0 * np.pi * time_s / sensor.gain_period_s)
    gain = np.float32(1.0 - sensor.gain_ripple + ripple)
    grain = rng.standard_normal(light.shape[:2], dtype=np.float32) * np.float32(sensor.noise)
    noisy = light * gain + (grain[:, :, None] + np.float32(sensor.offset))
    return np.asarray(np.clip(np.rint(noisy), 0.0, 255.0), dtype=np.uint8)


def _canvas(
    camera: PinholeCamera,
) -> tuple[PinholeCamera, tuple[NDArray[np.float32], NDArray[np.float32]] | None]:
    if not any(camera.distortion):
        return camera, None
    straight = camera.undistorted()
    pixels = _straightened(camera)
    low = np.floor(pixels.min(axis=(0, 1))) - 1.0
    width, height = (np.ceil(pixels.max(axis=(0, 1))) + 2.0 - low).astype(int).tolist()
    canvas = PinholeCamera(
        width, height, straight.fx, straight.fy, straight.cx - low[0], straight.cy - low[1]
    )
    moved = (pixels - low).astype(np.float32)
    return canvas, (np.ascontiguousarray(moved[..., 0]), np.ascontiguousarray(moved[..., 1]))


def _straightened(camera: PinholeCamera) -> Array:
    """Return where each pixel (H, W, 2) would be without distortion [px].

    Distortion is smooth: every fourth pixel is computed, the others are interpolated (1e-3 px).
    """
    u = np.arange(0.0, camera.width + _COARSE_PX, _COARSE_PX)
    v = np.arange(0.0, camera.height + _COARSE_PX, _COARSE_PX)
    rays = camera.normalise(np.stack(np.meshgrid(u, v), axis=-1))
    coarse = rays * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    x = np.arange(camera.width, dtype=np.float32) / np.float32(_COARSE_PX)
    y = np.arange(camera.height, dtype=np.float32) / np.float32(_COARSE_PX)
    at_x, at_y = np.meshgrid(x, y)
    return np.asarray(cv2.remap(coarse, at_x, at_y, cv2.INTER_LINEAR), dtype=np.float64)
