"""A camera drawn with OpenCV alone: no GL library, exact markers, painter's order.

Markers are warped at `SS` times the resolution and averaged down. With pixel centres at integers
a supersampled pixel s and a pixel u are tied by

    u = (s + 0.5) / SS - 0.5

and the texture level is the one whose texel is at least as large as a supersampled pixel, so that
every edge is a ramp the average integrates without bias (measured: a few hundredths of a pixel).
Things are drawn from far to near by the distance of their centre, each with its faces from far to
near and its markers on top; things that pierce each other are not resolved.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from spatial.camera import PinholeCamera
from spatial.frames import Cam, Object, Tag
from spatial.marker import UNIT_CORNERS, MarkedObject, Marker
from spatial.pose import Pose
from spatial.rotation import Array
from tracking.families import cells

Image = NDArray[np.uint8]

NEAR_M = 0.03
"""Nothing closer to the camera is drawn [m]."""
LIGHT_CAM = np.array([-0.35, -0.55, -0.76])
"""Direction to the light in camera axes."""
BLACK, WHITE = 22.0, 228.0
"""Grey of marker cells under full light; below 235 so that nothing clips."""
_TEXELS_PER_CELL = (32, 16, 8, 4, 2)
_SHIFT = 4


@dataclass(frozen=True, slots=True, eq=False)
class Painted:
    """Something the painter draws."""

    markers: tuple[Marker, ...] = ()
    """Markers on it, each with a quiet zone of one cell."""
    vertices: Array | None = None
    """Mesh vertices (n, 3) [m] in its own frame; `None` draws the markers alone."""
    faces: NDArray[np.int64] | None = None
    """Triangles (m, 3), counter-clockwise from outside; others are culled."""
    colors: NDArray[np.uint8] | None = None
    """Face colours (m, 3) RGB; grey when `None`."""

    @classmethod
    def of(
        cls,
        marked: MarkedObject,
        *,
        vertices: Array | None = None,
        faces: NDArray[np.int64] | None = None,
        colors: NDArray[np.uint8] | None = None,
    ) -> Painted:
        """Return a marked object with an optional mesh."""
        return cls(marked.markers, vertices, faces, colors)


@dataclass(frozen=True, slots=True, eq=False)
class Shade:
    """A dark translucent strip just above a thing: what a hard shadow does to an image."""

    name: str
    """Thing it moves with."""
    corners: Array
    """Corners (n, 3) [m] of a convex polygon in the thing's frame."""
    transmission: float = 0.28
    """Share of light that passes."""


class Painter:
    """A pinhole camera that paints named things."""

    backend = "painter"

    def __init__(
        self,
        camera: PinholeCamera,
        *,
        things: Mapping[str, Painted],
        shades: Sequence[Shade] = (),
        background: Image | None = None,
    ) -> None:
        """Make a painter.

        Args:
            camera: intrinsics; with distortion the image is bent by one remapping at the end.
            things: what may be drawn, by name.
            shades: strips drawn over everything, in order.
            background: image (H, W, 3) RGB behind all; a plain gradient when `None`.
        """
        self._camera = camera
        self._things = dict(things)
        self._shades = tuple(shades)
        self._canvas_camera, self._maps = _canvas_of(camera)
        size = (self._canvas_camera.width, self._canvas_camera.height)
        self._background = (
            _gradient(*size)
            if background is None
            else cv2.resize(background, size).astype(np.uint8)
        )
        self._textures = {
            m.key: _textures(m) for thing in self._things.values() for m in thing.markers
        }

    def render(self, Ts_cam_thing: Mapping[str, Pose[Cam, Object]]) -> Image:
        """Return the image (H, W, 3) uint8 RGB of the things named, at their poses in the camera.

        Raises:
            KeyError: a name the painter was not made with.
        """
        canvas = self._background.copy()
        for name in sorted(
            Ts_cam_thing, key=lambda n: self._depth(n, Ts_cam_thing[n]), reverse=True
        ):
            self._paint(canvas, self._things[name], Ts_cam_thing[name])
        for shade in self._shades:
            if shade.name in Ts_cam_thing:
                self._darken(canvas, shade, Ts_cam_thing[shade.name])
        if self._maps is None:
            return canvas
        return cv2.remap(canvas, *self._maps, cv2.INTER_LINEAR).astype(np.uint8, copy=False)

    def _depth(self, name: str, T_cam_thing: Pose[Cam, Object]) -> float:
        thing = self._things[name]
        if thing.vertices is not None and len(thing.vertices):
            centre = (thing.vertices.min(axis=0) + thing.vertices.max(axis=0)) / 2.0
        else:
            centre = np.mean([m.T_object_marker.translation for m in thing.markers], axis=0)
        return float(np.linalg.norm(T_cam_thing.apply(centre)))

    def _paint(self, canvas: Image, thing: Painted, T_cam_thing: Pose[Cam, Object]) -> None:
        if thing.vertices is not None and thing.faces is not None:
            self._paint_mesh(canvas, thing, T_cam_thing)
        seen = [(T_cam_thing @ m.T_object_marker, m) for m in thing.markers]
        for T_cam_marker, marker in sorted(seen, key=lambda pair: -pair[0].translation[2]):
            if T_cam_marker.rotation[:, 2] @ T_cam_marker.translation < 0.0:
                self._paint_marker(canvas, marker, T_cam_marker)

    def _paint_mesh(self, canvas: Image, thing: Painted, T_cam_thing: Pose[Cam, Object]) -> None:
        assert thing.vertices is not None
        assert thing.faces is not None
        points = T_cam_thing.apply(thing.vertices)
        corners = points[thing.faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        facing = np.einsum("ij,ij->i", normals, corners[:, 0]) < 0.0
        keep = np.flatnonzero(facing & (corners[:, :, 2].min(axis=1) > NEAR_M))
        pixels = self._canvas_camera.project(np.where(points[:, 2:] > NEAR_M, points, 1.0))
        order = keep[np.argsort(-corners[keep, :, 2].mean(axis=1))]
        polygons = np.round(pixels[thing.faces[order]] * (1 << _SHIFT))
        polygons = np.clip(polygons, -(1 << 20), 1 << 20).astype(np.int32)
        normals = normals[order] / np.linalg.norm(normals[order], axis=1, keepdims=True)
        base = 150.0 if thing.colors is None else thing.colors[order, :3].astype(np.float64)
        colors = (base * _light(normals)[:, None] * np.ones(3)).tolist()
        for polygon, color in zip(polygons, colors, strict=True):
            cv2.fillConvexPoly(canvas, polygon, color, cv2.LINE_8, _SHIFT)

    def _paint_marker(self, canvas: Image, marker: Marker, T_cam_marker: Pose[Cam, Tag]) -> None:
        levels = self._textures[marker.key]
        side = cells(marker.family, marker.id).shape[0]
        quad_cam = T_cam_marker.apply(UNIT_CORNERS * (marker.size_m * (side + 2) / side))
        if quad_cam[:, 2].min() < NEAR_M:
            return
        quad = self._canvas_camera.project(quad_cam)
        low = np.maximum(np.floor(quad.min(axis=0)).astype(int) - 1, 0)
        high = np.ceil(quad.max(axis=0)).astype(int) + 2
        high = np.minimum(high, (self._canvas_camera.width, self._canvas_camera.height))
        if (high <= low).any():
            return
        cell_px = np.linalg.norm(quad - np.roll(quad, -1, axis=0), axis=1).max() / (side + 2)
        scale = 4 if cell_px < 8 else 2
        patch = _warp(levels, quad, low, high, scale=scale, cell_px=cell_px)
        light = float(_light(T_cam_marker.rotation[:, 2][None])[0])
        view = canvas[low[1] : high[1], low[0] : high[0]]
        cover = 1.0 - patch[..., 1:] / np.float32(255.0)
        view[...] = np.rint(view * cover + patch[..., :1] * np.float32(light))

    def _darken(self, canvas: Image, shade: Shade, T_cam_thing: Pose[Cam, Object]) -> None:
        corners = T_cam_thing.apply(shade.corners)
        if corners[:, 2].min() < NEAR_M:
            return
        pixels = np.round(self._canvas_camera.project(corners) * (1 << _SHIFT)).astype(np.int32)
        mask = np.zeros(canvas.shape[:2], np.uint8)
        cv2.fillConvexPoly(mask, pixels, 255, cv2.LINE_AA, _SHIFT)
        x, y, w, h = cv2.boundingRect(mask)
        cover = mask[y : y + h, x : x + w, None] / np.float32(255.0)
        view = canvas[y : y + h, x : x + w]
        view[...] = np.rint(view * (1.0 - np.float32(1.0 - shade.transmission) * cover))


def _light(normals: Array) -> Array:
    """Return brightness (n,) of faces with unit normals (n, 3) in camera axes."""
    return np.asarray(0.55 + 0.45 * np.clip(normals @ LIGHT_CAM, 0.0, 1.0))


def _gradient(width: int, height: int) -> Image:
    """Return a sky over ground, dull enough not to be taken for a marker."""
    row = np.linspace(0.0, 1.0, height)[:, None, None]
    sky, ground = np.array([128.0, 138.0, 150.0]), np.array([84.0, 82.0, 78.0])
    return np.tile(np.rint(sky + (ground - sky) * row), (1, width, 1)).astype(np.uint8)


def _textures(marker: Marker) -> list[NDArray[np.float32]]:
    """Return grey and cover (T, T, 2) of a marker with its quiet zone, coarse levels last."""
    pattern = np.pad(cells(marker.family, marker.id), 1, constant_values=True)
    grey = np.where(pattern, WHITE, BLACK).astype(np.float32)
    levels = []
    for texels in _TEXELS_PER_CELL:
        fine = grey.repeat(texels, axis=0).repeat(texels, axis=1)
        levels.append(np.dstack((fine, np.full_like(fine, 255.0))))
    return levels


def _warp(
    levels: list[NDArray[np.float32]],
    quad: Array,
    low: NDArray[np.int64],
    high: NDArray[np.int64],
    *,
    scale: int,
    cell_px: float,
) -> NDArray[np.float32]:
    """Return grey and cover (h, w, 2) of a texture on a quad (4, 2) [px] of the canvas."""
    wanted = cell_px * scale
    index = next((i for i, t in enumerate(_TEXELS_PER_CELL) if t <= wanted), len(levels) - 1)
    texture = levels[index]
    edge = texture.shape[0] - 0.5
    source = np.array([[-0.5, -0.5], [edge, -0.5], [edge, edge], [-0.5, edge]], np.float32)
    target = ((quad - low + 0.5) * scale - 0.5).astype(np.float32)
    size = ((high - low) * scale).tolist()
    fine = cv2.warpPerspective(
        texture, cv2.getPerspectiveTransform(source, target), size, flags=cv2.INTER_LINEAR
    )
    small = cv2.resize(fine, (high - low).tolist(), interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.float32)


def _canvas_of(
    camera: PinholeCamera,
) -> tuple[PinholeCamera, tuple[NDArray[np.int16], NDArray[np.uint16]] | None]:
    """Return the undistorted camera painted with and the maps that bend its image."""
    if not any(camera.distortion):
        return camera, None
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = camera.normalise(np.stack((u, v), axis=-1).astype(np.float64))
    straight = rays * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    low = np.floor(straight.min(axis=(0, 1))) - 2.0
    size = (np.ceil(straight.max(axis=(0, 1))) + 3.0 - low).astype(int)
    canvas = PinholeCamera(
        int(size[0]), int(size[1]), camera.fx, camera.fy, camera.cx - low[0], camera.cy - low[1]
    )
    moved = (straight - low).astype(np.float32)
    maps = cv2.convertMaps(moved[..., 0], moved[..., 1], cv2.CV_16SC2)
    return canvas, (maps[0].astype(np.int16), maps[1].astype(np.uint16))
