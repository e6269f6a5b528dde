"""Meshes, colours and marker prints as assets of a MuJoCo model.

One palette texture serves every mesh: a face's three texture coordinates are the same point, the
middle of its colour's cell, so that a link of many colours stays one mesh and one draw call.

A marker is a square of `cells + 2` cells edge with its quiet zone. Its texture has a power of two
of pixels per cell, so that every mip level keeps cells on pixel borders: misaligned levels shift
edges (0.078 px instead of 0.018 px).
"""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from scene.mesh import MeshData, MeshPart
from spatial.marker import Marker
from spatial.rotation import Array
from tracking.families import cells

BLACK, WHITE = 12, 235
"""Grey of marker cells; white stays below saturation, which would move edges."""
CELL_PX = 32
"""Texture pixels per marker cell."""
QUIET_CELLS = 1
"""White cells around the black square."""

_SWATCH_PX = 4
_COLUMNS = 64
_PAINT = "paint"


class Paints:
    """Adds meshes and prints to a model under construction; `finish` adds the palette."""

    def __init__(self, spec: mujoco.MjSpec) -> None:
        """Start with an empty palette."""
        self._spec = spec
        self._colors: dict[tuple[int, ...], int] = {}
        self._pending: list[tuple[mujoco.MjsMesh, NDArray[np.int64]]] = []
        self._material(_PAINT, texture="palette", specular=0.25, shininess=0.35)

    def add_mesh(self, name: str, mesh: MeshData) -> tuple[str, str]:
        """Add a mesh to look at; return the names of the mesh and its material."""
        asset = _mesh(self._spec, name, mesh.vertices, mesh.faces)
        if all(part.normals is not None for part in mesh.parts):
            asset.usernormal = np.concatenate([_normals(part) for part in mesh.parts]).ravel()
            asset.userfacenormal = mesh.faces.ravel()
        rgb, inverse = np.unique(mesh.face_colors[:, :3], axis=0, return_inverse=True)
        index = [self._colors.setdefault(tuple(c), len(self._colors)) for c in rgb.tolist()]
        self._pending.append((asset, np.array(index)[inverse.ravel()]))
        return name, _PAINT

    def add_print(self, name: str, marker: Marker) -> tuple[str, str]:
        """Add the print of a marker in its own frame; return names of mesh and material."""
        side = cells(marker.family, marker.id).shape[0]
        half = marker.size_m * (side + 2 * QUIET_CELLS) / side / 2.0
        corners = half * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
        asset = _mesh(self._spec, name, corners, np.array([[0, 2, 1], [0, 3, 2]]))
        asset.usertexcoord = np.array([0, 0, 1, 0, 1, 1, 0, 1.0])
        grey = marker_image(marker)
        self._texture(name, np.repeat(grey[:, :, None], 3, axis=2))
        self._material(name, texture=name, specular=0.0, shininess=0.0)
        return name, name

    def finish(self) -> None:
        """Add the palette, once every mesh is in."""
        rows = 1 << max(0, (len(self._colors) - 1) // _COLUMNS).bit_length()
        swatches = np.zeros((rows * _COLUMNS, 3), np.uint8)
        for color, index in self._colors.items():
            swatches[index] = color
        pixels = swatches.reshape(rows, _COLUMNS, 3)
        self._texture("palette", pixels.repeat(_SWATCH_PX, axis=0).repeat(_SWATCH_PX, axis=1))
        used = np.arange(max(1, len(self._colors)))
        uv = np.stack(((used % _COLUMNS + 0.5) / _COLUMNS, (used // _COLUMNS + 0.5) / rows), axis=1)
        for asset, of_face in self._pending:
            asset.usertexcoord = uv.ravel()
            asset.userfacetexcoord = of_face.repeat(3)

    def _texture(self, name: str, pixels: NDArray[np.uint8]) -> None:
        height, width = pixels.shape[:2]
        texture = self._spec.add_texture(
            name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, width=width, height=height, nchannel=3
        )
        texture.data = pixels.tobytes()

    def _material(
        self, name: str, *, texture: str, specular: float, shininess: float
    ) -> mujoco.MjsMaterial:
        material = self._spec.add_material(name=name, specular=specular, shininess=shininess)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = texture
        return material


def marker_image(marker: Marker) -> NDArray[np.uint8]:
    """Return the print of a marker with its quiet zone (h, w) in grey."""
    white = np.pad(cells(marker.family, marker.id), QUIET_CELLS, constant_values=True)
    grey = np.where(white, WHITE, BLACK).astype(np.uint8)
    return grey.repeat(CELL_PX, axis=0).repeat(CELL_PX, axis=1)


def add_hull(spec: mujoco.MjSpec, name: str, vertices: Array) -> str:
    """Add the convex hull of points (n, 3) as a mesh for contacts; return its name."""
    spec.add_mesh(name=name, uservert=vertices.ravel())
    return name


def _mesh(
    spec: mujoco.MjSpec, name: str, vertices: Array, faces: NDArray[np.int64]
) -> mujoco.MjsMesh:
    return spec.add_mesh(
        name=name,
        uservert=vertices.ravel(),
        userface=faces.ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,  # a look need not be closed
    )


def _normals(part: MeshPart) -> Array:
    assert part.normals is not None
    return part.normals
