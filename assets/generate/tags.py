"""Printed markers on the objects: a white plate and a quad with the picture, named `tag_<id>`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from assets.generate.shapes import Array, Body, bevelled_box, look
from scene.marker_image import marker_pixels, side_cells
from scene.mesh import Material, MeshPart

FAMILY = "tag36h11"
PLATE_M = 0.002
"""Thickness of the plate a marker is printed on."""
PLATE = look("tag_plate", (244, 245, 246), roughness=0.75)


@dataclass(frozen=True, slots=True)
class Tag:
    """A marker on an object."""

    id: int
    """Number in tag36h11."""
    size_m: float
    """Edge of the outer black square [m]."""
    surface: tuple[float, float, float]
    """Point of the object's surface below its centre [m]."""
    normal: tuple[float, float, float]
    """Outward normal of the surface."""
    up: tuple[float, float, float]
    """Direction of the picture's upper edge, across the normal."""
    target: bool = False
    """Whether it is the paper's x."""

    @property
    def rotation(self) -> Array:
        """R_object_marker (3, 3): x right, y up, z out."""
        z = _unit(self.normal)
        y = _unit(np.asarray(self.up) - z * (z @ np.asarray(self.up)))
        return np.stack((np.cross(y, z), y, z), axis=1)

    @property
    def centre(self) -> Array:
        """Centre (3,) of the printed face in the object [m]."""
        return np.round(np.asarray(self.surface) + PLATE_M * _unit(self.normal), 6)


def add_tags(body: Body, tags: tuple[Tag, ...]) -> None:
    """Put plates and pictures of markers on a body."""
    for tag in tags:
        edge = tag.size_m * (side_cells(FAMILY) + 2) / side_cells(FAMILY)
        plate = bevelled_box((edge, edge, PLATE_M - 0.0003), 0.0005)
        matrix = np.eye(4)
        matrix[:3, :3] = tag.rotation
        matrix[:3, 3] = tag.centre - tag.rotation[:, 2] * (0.0003 + (PLATE_M - 0.0003) / 2)
        plate.apply_transform(matrix)
        body.add(PLATE, plate)
        body.extra.append(_quad(tag, edge))


def _quad(tag: Tag, edge: float) -> MeshPart:
    corners = 0.5 * edge * np.array([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], np.float64)
    vertices = np.round(corners @ tag.rotation.T + tag.centre, 7) + 0.0
    pixels = marker_pixels(FAMILY, tag.id)
    return MeshPart(
        name=f"tag_{tag.id}",
        vertices=vertices,
        faces=np.array([(0, 1, 2), (0, 2, 3)], np.int64),
        material=Material(roughness=0.8, texture=np.repeat(pixels[..., None], 3, axis=2)),
        uv=np.array([(0, 0), (1, 0), (1, 1), (0, 1)], np.float64),
        normals=np.tile(tag.rotation[:, 2], (4, 1)),
    )


def _unit(vector: ArrayLike) -> Array:
    v = np.asarray(vector, dtype=np.float64)
    return v / np.linalg.norm(v)
