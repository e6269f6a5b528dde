"""Sub-pixel corners from edges: lines fitted to gradient centroids, neighbours intersected.

Across each edge k of a marker (corner k to k + 1, outward normal n_k) the image is sampled on
short profiles. On a profile the edge lies at the centroid of its outward rise

    d = sum(w_j o_j) / sum(w_j),   w_j = max(I'(o_j) - threshold, 0)

and along the edge d(s) = d_0 + (d_1 - d_0) s is fitted by reweighted least squares (Tukey), so a
shadow that crosses the edge loses its votes. A first coarse pass sums profiles over each half of
an edge: it finds the edge from up to `search_px` away. Curvature by lens distortion is followed by
bending the sampled edges, never by bending the image. All markers go through as one array.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from spatial.camera import PinholeCamera
from spatial.rotation import Array

Gray = NDArray[np.uint8]

SEARCH_PX = 6.0
"""Farthest an edge is looked for from where it is expected [px]."""
_FINE_SAMPLES, _FINE_REACH, _STEP = 20, 8.0, 0.5
_COARSE_SAMPLES = 12
_MIN_CONTRAST = 14.0
"""Weakest rise across an edge [grey] that is still one."""
_MIN_INLIERS = 0.5
_MAX_SHIFT_CELLS = 1.6
"""Beyond it [cells of the marker] the inner pattern would be mistaken for the outer edge."""


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """Result of `refine_corners` for n markers."""

    corners_px: Array
    """Corners (n, 4, 2) TL TR BR BL [px]; as given where `ok` is False."""
    ok: NDArray[np.bool_]
    """Which markers (n,) have four edges."""
    noise_px: Array
    """Scatter (n,) of the edge points about their lines [px]."""


def refine_corners(
    gray: Gray,
    *,
    corners_px: Array,
    sides: NDArray[np.int64],
    camera: PinholeCamera | None = None,
    search_px: float | Array = SEARCH_PX,
) -> Refined:
    """Refine the corners of markers that are roughly known.

    Args:
        gray: image (H, W) uint8.
        corners_px: rough corners (n, 4, 2) TL TR BR BL [px].
        sides: cells along each marker's black square (n,).
        camera: bends the edges of large markers as its lens does; straight when `None`.
        search_px: how far off an edge may be [px], one value or (n,).
    """
    rough = np.asarray(corners_px, dtype=np.float64)
    if not len(rough):
        return Refined(rough.reshape(0, 4, 2), np.zeros(0, bool), np.zeros(0))
    cell = edge_lengths(rough).min(axis=1) / np.asarray(sides)
    reach = np.clip(_MAX_SHIFT_CELLS * cell, 2.0, search_px)
    coarse = _moved(rough, *_normals(rough), _coarse_offsets(gray, rough, reach, camera))
    offsets, ok, noise = _fine_offsets(gray, coarse, cell, camera)
    fine = _moved(coarse, *_normals(coarse), offsets)
    shift = np.abs(fine - rough).max(axis=(1, 2))
    ok = ok & (shift < 1.5 * reach + 1.0) & np.isfinite(fine).all(axis=(1, 2))
    return Refined(np.where(ok[:, None, None], fine, rough), ok, noise)


def edge_lengths(corners_px: Array) -> Array:
    """Return the four edge lengths (n, 4) [px] of quads (n, 4, 2)."""
    return np.asarray(np.linalg.norm(np.roll(corners_px, -1, axis=1) - corners_px, axis=2))


def _normals(corners: Array) -> tuple[Array, Array]:
    """Return unit normals out of (n, 4, 2) edges, and the edges' ends (n, 4, 2)."""
    ends = np.roll(corners, -1, axis=1)
    along = ends - corners
    along = along / np.maximum(np.linalg.norm(along, axis=2, keepdims=True), 1e-9)
    return np.stack((along[..., 1], -along[..., 0]), axis=-1), ends


def _edge_points(corners: Array, shares: Array, camera: PinholeCamera | None) -> Array:
    """Return points (n, 4, s, 2) [px] along the edges of quads, bent as the lens bends them."""
    bent = camera is not None and any(camera.distortion)
    start = camera.normalise(corners) if camera is not None and bent else corners
    stop = np.roll(start, -1, axis=1)
    points = start[:, :, None] + shares[:, None] * (stop - start)[:, :, None]
    if camera is None or not bent:
        return np.asarray(points)
    return camera.project(np.concatenate((points, np.ones_like(points[..., :1])), axis=-1))


def _profiles(
    gray: Gray,
    corners: Array,
    camera: PinholeCamera | None,
    *,
    shares: Array,
    offsets: Array,
) -> NDArray[np.float32]:
    """Return grey values (n, 4, s, o) on profiles across the edges."""
    base = _edge_points(corners, shares, camera).astype(np.float32)
    normals = _normals(corners)[0].astype(np.float32)
    steps = offsets.astype(np.float32)
    x = base[..., :1] + steps * normals[:, :, None, :1]
    y = base[..., 1:] + steps * normals[:, :, None, 1:]
    flat = (-1, x.shape[-1])
    values = cv2.remap(
        gray, x.reshape(flat), y.reshape(flat), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return values.reshape(x.shape).astype(np.float32)


def _coarse_offsets(
    gray: Gray, corners: Array, reach: Array, camera: PinholeCamera | None
) -> Array:
    """Return offsets (n, 4, 2) [px] of the edges' two ends, to about half a pixel."""
    top = float(reach.max())
    offsets = np.arange(-np.ceil(top) - 1.0, np.ceil(top) + 1.5)
    shares = np.linspace(0.08, 0.92, _COARSE_SAMPLES)
    values = _profiles(gray, corners, camera, shares=shares, offsets=offsets)
    rise = values[..., 2:] - values[..., :-2]
    half = _COARSE_SAMPLES // 2
    votes = np.stack((rise[:, :, :half].sum(axis=2), rise[:, :, half:].sum(axis=2)), axis=2)
    places = offsets[1:-1]
    votes = np.where(np.abs(places) <= reach[:, None, None, None], votes, -np.inf)
    found = places[votes.argmax(axis=3)]
    a, b = shares[:half].mean(), shares[half:].mean()
    slope = (found[..., 1] - found[..., 0]) / (b - a)
    start = found[..., 0] - a * slope
    return np.stack((start, start + slope), axis=-1)


def _fine_offsets(
    gray: Gray, corners: Array, cell: Array, camera: PinholeCamera | None
) -> tuple[Array, NDArray[np.bool_], Array]:
    """Return end offsets (n, 4, 2) [px], which markers are good (n,) and their scatter (n,)."""
    shares = np.linspace(0.08, 0.92, _FINE_SAMPLES)
    offsets = np.arange(-_FINE_REACH, _FINE_REACH + _STEP, _STEP)
    values = _profiles(gray, corners, camera, shares=shares, offsets=offsets)
    rise = np.diff(values, axis=-1)
    places = (offsets[:-1] + _STEP / 2.0).astype(np.float32)
    centre, half = _windows(rise.mean(axis=2), places, cell)
    inside = np.abs(places - centre[..., None]) <= half[..., None]
    weights = np.maximum(rise, 0.0) * inside[:, :, None]
    contrast = weights.sum(axis=-1)
    centroid = (weights @ places) / np.maximum(contrast, 1e-6)
    return _fit_lines(centroid.astype(np.float64), contrast > _MIN_CONTRAST, shares)


def _windows(
    rise: NDArray[np.float32], places: NDArray[np.float32], cell: Array
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return centre and half-width (n, 4) [px] of the edge in mean profiles (n, 4, o).

    The width follows the blur of the edge, up to the cell next to it.
    """
    positive = np.maximum(rise, 0.0)
    near = np.abs(places) <= 2.5
    centre = places[np.where(near, positive, -1.0).argmax(axis=-1)]
    limit = np.clip(cell, 1.5, _FINE_REACH - 1.0).astype(np.float32)[:, None]
    half = limit * np.ones_like(centre)
    for _ in range(3):
        distance = places - centre[..., None]
        weights = positive * (np.abs(distance) <= half[..., None])
        total = np.maximum(weights.sum(axis=-1), 1e-6)
        spread = np.sqrt((weights * distance**2).sum(axis=-1) / total)
        centre = centre + (weights * distance).sum(axis=-1) / total
        half = np.clip(3.2 * spread, 1.5, limit)
    return centre, half


def _fit_lines(
    centroid: Array, valid: NDArray[np.bool_], shares: Array
) -> tuple[Array, NDArray[np.bool_], Array]:
    """Fit d(s) per edge robustly to centroids (n, 4, s)."""
    weight = valid.astype(np.float64)
    s = shares - 0.5
    scale = np.full((*centroid.shape[:2], 1), 2.0)
    level = np.median(centroid, axis=-1)
    slope = np.zeros_like(level)
    for _ in range(5):
        residual = centroid - level[..., None] - slope[..., None] * s
        robust = valid * np.maximum(1.0 - (residual / scale) ** 2, 0.0) ** 2
        w, ws = robust.sum(axis=-1), (robust * s).sum(axis=-1)
        wss, wd = (robust * s * s).sum(axis=-1), (robust * centroid).sum(axis=-1)
        wsd = (robust * s * centroid).sum(axis=-1)
        det = np.maximum(w * wss - ws * ws, 1e-9)
        level, slope = (wss * wd - ws * wsd) / det, (w * wsd - ws * wd) / det
        spread = np.sqrt((robust * residual**2).sum(axis=-1) / np.maximum(w, 1e-9))
        scale = np.clip(3.0 * spread, 0.15, 2.0)[..., None]
        weight = robust
    residual = centroid - level[..., None] - slope[..., None] * s
    inlier = weight > 0.05
    enough = inlier.mean(axis=-1) >= _MIN_INLIERS
    count = np.maximum(inlier.sum(axis=(1, 2)), 1)
    noise = np.sqrt((inlier * residual**2).sum(axis=(1, 2)) / count)
    ends = np.stack((level - 0.5 * slope, level + 0.5 * slope), axis=-1)
    return ends, enough.all(axis=1), noise


def _moved(corners: Array, normals: Array, stops: Array, offsets: Array) -> Array:
    """Return corners (n, 4, 2) where the edges, moved by end offsets (n, 4, 2), intersect."""
    a = corners + normals * offsets[..., :1]
    along = stops + normals * offsets[..., 1:] - a
    b, back = np.roll(a, 1, axis=1), np.roll(along, 1, axis=1)
    cross = along[..., 0] * back[..., 1] - along[..., 1] * back[..., 0]
    cross = np.where(np.abs(cross) < 1e-9, np.nan, cross)
    gap = b - a
    share = (gap[..., 0] * back[..., 1] - gap[..., 1] * back[..., 0]) / cross
    return np.asarray(a + share[..., None] * along)
