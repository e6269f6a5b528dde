"""Find the markers of objects in an image, cheapest way first.

1. Where a prediction is sharp, edges are refined around it and the bits verified.
2. Where it is not, or nothing was found, OpenCV searches the region it points to.
3. When allowed, OpenCV searches the whole image.

Every marker found in any way ends as edges refined on the whole image.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from spatial.camera import PinholeCamera
from spatial.rotation import Array
from tracking.bits import MIN_CELL_PX, MIN_SCORE, bit_scores
from tracking.detector import EDGE_SEARCH_PX, RAW_NOISE_PX, search
from tracking.edges import edge_lengths, refine_corners
from tracking.families import cells
from tracking.joint import Prior, SeenTag
from tracking.model import MarkerTable

SHARP_PX = 7.0
"""A prediction whose 3 sigma is larger [px] is followed by a search of its region."""
MIN_FACING = 0.12
"""Smallest cosine between a marker's normal and the line of sight."""
MAX_REGION, SMALL_REGION = 0.35, 0.20
"""Largest share of the image worth a search now and then, and in every image."""
_MARGIN_PX = 3.0

Gray = NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class Expected:
    """Markers that a prediction puts in view."""

    index: NDArray[np.int64]
    """Rows (e,) of the marker table."""
    corners_px: Array
    """Predicted corners (e, 4, 2) [px]."""
    sigma_px: Array
    """Standard deviation (e,) of their position [px]."""


@dataclass(slots=True, eq=False)
class Sighting:
    """Markers found so far in one image, by row of the marker table."""

    tags: dict[int, SeenTag] = field(default_factory=dict)
    """What was found."""
    refused: dict[int, tuple[Array, str]] = field(default_factory=dict)
    """Corners (4, 2) [px] of what was looked for and not believed, and why."""

    def of(self, rows: Iterable[int]) -> list[SeenTag]:
        """Return the tags found among some rows."""
        return [self.tags[row] for row in rows if row in self.tags]


def expected_markers(
    camera: PinholeCamera, *, table: MarkerTable, priors: Mapping[int, Prior]
) -> Expected:
    """Return which markers are in view, and where, by the predictions of some objects.

    Args:
        camera: intrinsics.
        table: all markers.
        priors: predictions by index of the object.
    """
    rows = np.flatnonzero(np.isin(table.owner, list(priors)))
    if not len(rows):
        return Expected(rows, np.zeros((0, 4, 2)), np.zeros(0))
    owners = table.owner[rows]
    poses = np.array([priors[int(i)].T_cam_object.matrix for i in owners])
    points = np.einsum("mij,mkj->mki", poses[:, :3, :3], table.corners_object[rows])
    points += poses[:, None, :3, 3]
    normals = np.einsum("mij,mj->mi", poses[:, :3, :3], table.normals_object[rows])
    centre = points.mean(axis=1)
    distance = np.linalg.norm(centre, axis=1)
    facing = -np.einsum("mi,mi->m", normals, centre) > MIN_FACING * distance
    front = points[..., 2].min(axis=1) > 0.02
    corners = camera.project(np.where(front[:, None, None], points, 1.0))
    inside = camera.contains(corners, margin=_MARGIN_PX).all(axis=1)
    large = edge_lengths(corners).min(axis=1) > MIN_CELL_PX * table.sides[rows]
    keep = facing & front & inside & large
    spread = np.array([priors[int(i)].covariance for i in owners])
    sigma = _sigma_px(camera, poses, table.corners_object[rows].mean(axis=1), spread)
    return Expected(rows[keep], corners[keep], sigma[keep])


def _sigma_px(camera: PinholeCamera, poses: Array, points: Array, spread: Array) -> Array:
    """Return the deviation (m,) [px] of points (m, 3) under covariances (m, 6, 6) of poses."""
    rotation = poses[:, :3, :3]
    q = np.einsum("mij,mj->mi", rotation, points) + poses[:, :3, 3]
    depth = np.maximum(q[:, 2], 0.02)[:, None, None]
    uv = q[:, :2, None] / depth
    turned = (rotation[:, :2] - uv * rotation[:, 2:]) / depth * camera.fx
    jacobian = np.concatenate((turned, np.cross(points[:, None], turned)), axis=-1)
    planar = jacobian @ spread @ jacobian.transpose(0, 2, 1)
    return np.asarray(np.sqrt(np.linalg.eigvalsh(planar)[:, -1]))


def follow(
    gray: Gray,
    *,
    camera: PinholeCamera,
    table: MarkerTable,
    expected: Expected,
    sighting: Sighting,
) -> None:
    """Add the markers whose edges and bits lie where sharp predictions put them."""
    sharp = 3.0 * expected.sigma_px <= SHARP_PX
    rows = expected.index[sharp]
    if not len(rows):
        return
    refined = refine_corners(
        gray,
        corners_px=expected.corners_px[sharp],
        sides=table.sides[rows],
        camera=camera,
        search_px=np.clip(3.0 * expected.sigma_px[sharp] + 2.0, 3.0, SHARP_PX),
    )
    scores = np.zeros(len(rows))
    for side in np.unique(table.sides[rows]):
        group = np.flatnonzero((table.sides[rows] == side) & refined.ok)
        if len(group):
            markers = [table.markers[rows[i]] for i in group]
            scores[group] = bit_scores(
                gray,
                corners_px=refined.corners_px[group],
                patterns=np.array([cells(m.family, m.id) for m in markers]),
                camera=camera,
            )
    for i, row in enumerate(rows.tolist()):
        if refined.ok[i] and scores[i] >= MIN_SCORE:
            sighting.tags[row] = SeenTag(
                table.markers[row], refined.corners_px[i], float(refined.noise_px[i])
            )
        else:
            why = f"bits agree {scores[i]:.0%}" if refined.ok[i] else "edges not found"
            sighting.refused[row] = refined.corners_px[i], why


def search_region(
    gray: Gray,
    *,
    camera: PinholeCamera,
    table: MarkerTable,
    expected: Expected,
    owners: set[int],
    largest: float,
    sighting: Sighting,
) -> bool:
    """Search where the predictions of some objects point.

    Returns False, and does not search, when that is a larger share of the image than `largest`.
    """
    chosen = np.isin(table.owner[expected.index], list(owners))
    if not chosen.any():
        return False
    corners = expected.corners_px[chosen]
    size = edge_lengths(corners).max(axis=1)
    reach = (3.0 * expected.sigma_px[chosen] + 0.3 * size + 12.0)[:, None, None]
    low = np.maximum(np.floor((corners - reach).min(axis=(0, 1))), 0).astype(int)
    high = np.ceil((corners + reach).max(axis=(0, 1))).astype(int) + 1
    high = np.minimum(high, (camera.width, camera.height))
    if np.prod(high - low) > largest * camera.width * camera.height:
        return False
    crop = np.ascontiguousarray(gray[low[1] : high[1], low[0] : high[0]])
    _add(gray, _search(crop, table, low), camera=camera, table=table, sighting=sighting)
    return True


def search_image(
    gray: Gray, *, camera: PinholeCamera, table: MarkerTable, sighting: Sighting
) -> None:
    """Search the whole image for markers not found yet."""
    found = _search(gray, table, np.zeros(2, dtype=np.int64))
    _add(gray, found, camera=camera, table=table, sighting=sighting)


def _search(gray: Gray, table: MarkerTable, low: NDArray[np.int64]) -> dict[int, Array]:
    """Return raw corners (4, 2) [px] by row; the largest where an id is seen twice."""
    rows = {marker.key: row for row, marker in enumerate(table.markers)}
    found: dict[int, Array] = {}
    for family in sorted({marker.family for marker in table.markers}):
        ids, corners = search(gray, family=family)
        sizes = edge_lengths(corners).sum(axis=1)
        for i in np.argsort(sizes, kind="stable"):
            row = rows.get((family, ids[i]))
            if row is not None:
                found[row] = corners[i] + low
    return found


def _add(
    gray: Gray,
    found: Mapping[int, Array],
    *,
    camera: PinholeCamera,
    table: MarkerTable,
    sighting: Sighting,
) -> None:
    rows = sorted(set(found) - set(sighting.tags))
    if not rows:
        return
    refined = refine_corners(
        gray,
        corners_px=np.array([found[row] for row in rows]),
        sides=table.sides[rows],
        camera=camera,
        search_px=EDGE_SEARCH_PX,
    )
    for i, row in enumerate(rows):
        noise = float(refined.noise_px[i]) if refined.ok[i] else RAW_NOISE_PX
        sighting.tags[row] = SeenTag(table.markers[row], refined.corners_px[i], noise)
        sighting.refused.pop(row, None)
