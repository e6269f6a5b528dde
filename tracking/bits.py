"""Does a marker with this id really lie here? Cells are compared with their neighbours.

Where two neighbouring cells of the expected pattern differ, the white one must be brighter than
the black one by a ratio. The score is the share of such pairs that agree. Only neighbours are
compared, so a shadow edge costs the few pairs it runs between, whatever its depth.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from spatial.camera import PinholeCamera
from spatial.rotation import Array

Gray = NDArray[np.uint8]

MIN_SCORE = 0.84
"""Share of agreeing pairs from which an id is believed."""
MIN_CELL_PX = 1.8
"""Cells smaller than this [px] cannot be read."""
_RATIO, _STEP_GREY = 1.2, 3.0
_INSIDE = (0.32, 0.68)


def homographies(quads: Array) -> Array:
    """Return maps (n, 3, 3) of the unit square (0,0) (1,0) (1,1) (0,1) to quads (n, 4, 2)."""
    p0, p1, p2, p3 = np.moveaxis(np.asarray(quads, dtype=np.float64), 1, 0)
    d1, d2, d3 = p1 - p2, p3 - p2, p0 - p1 + p2 - p3
    det = _cross(d1, d2)
    g, h = _cross(d3, d2) / det, _cross(d1, d3) / det
    out = np.ones((len(p0), 3, 3))
    out[:, :2, 0] = p1 - p0 + g[:, None] * p1
    out[:, :2, 1] = p3 - p0 + h[:, None] * p3
    out[:, :2, 2] = p0
    out[:, 2, 0], out[:, 2, 1] = g, h
    return out


def bit_scores(
    gray: Gray,
    *,
    corners_px: Array,
    patterns: NDArray[np.bool_],
    camera: PinholeCamera | None = None,
) -> Array:
    """Return the share (n,) of neighbouring cells that agree with the expected pattern.

    Args:
        gray: image (H, W) uint8.
        corners_px: refined corners (n, 4, 2) TL TR BR BL [px].
        patterns: expected cells (n, side, side), True is white, of one family's side.
        camera: bends large markers as its lens does; straight when `None`.
    """
    side = patterns.shape[1]
    grey = _cell_values(gray, corners_px, side, camera)
    agree, expected = np.zeros(len(grey)), np.zeros(len(grey))
    for axis in (1, 2):
        first, second = _pairs(grey, axis)
        a, b = _pairs(patterns, axis)
        white, black = np.where(a, first, second), np.where(a, second, first)
        differ = a != b
        seen = white > _RATIO * black + _STEP_GREY
        agree += (differ & seen).sum(axis=(1, 2))
        expected += differ.sum(axis=(1, 2))
    return np.asarray(agree / np.maximum(expected, 1.0))


def _cell_values(gray: Gray, corners: Array, side: int, camera: PinholeCamera | None) -> Array:
    """Return the mean grey (n, side, side) inside each cell."""
    bent = camera is not None and any(camera.distortion)
    quads = camera.normalise(corners) if camera is not None and bent else corners
    ticks = ((np.arange(side)[:, None] + _INSIDE) / side).ravel()
    u, v = np.meshgrid(ticks, ticks)
    grid = np.stack((u.ravel(), v.ravel(), np.ones(u.size)))
    mapped = homographies(quads) @ grid
    points = np.moveaxis(mapped[:, :2] / mapped[:, 2:], 1, 2)
    if camera is not None and bent:
        points = camera.project(np.concatenate((points, np.ones_like(points[..., :1])), axis=-1))
    points = points.astype(np.float32)
    values = cv2.remap(
        gray, points[..., 0], points[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    inside = values.reshape(-1, side, 2, side, 2).astype(np.float64)
    return np.asarray(inside.mean(axis=(2, 4)))


def _pairs(stack: NDArray[Any], axis: int) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return each cell and its neighbour along an axis, of greys or of booleans."""
    cut = stack.shape[axis] - 1
    first, second = np.split(stack, [cut], axis=axis)[0], np.split(stack, [1], axis=axis)[1]
    return first, second


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
