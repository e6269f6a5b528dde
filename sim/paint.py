"""Looks, and marker prints, as geoms of a MuJoCo model.

A mesh of several colours becomes a geom for each: a palette texture would need one draw call
only, but texturing costs twice the rest of an image where software draws.

A marker is a square of `cells + 2` cells edge with its quiet zone. Its texture has a power of two
of pixels per cell, so that every mip level keeps cells on pixel borders: misaligned levels shift
edges (0.078 px instead of 0.018 px).
"""

from __future__ import annotations

import re
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from scene.mesh import MeshData
from spatial.marker import Marker
from spatial.pose import Pose
from spatial.rotation import Array
from tracking.families import cells

BLACK, WHITE = 12, 235
"""Grey of marker cells; white stays below saturation, which would move edges."""
CELL_PX = 32
"""Texture pixels per marker cell."""
QUIET_CELLS = 1
"""White cells around the black square."""

_PAINT = "paint"
_PRINT = re.compile(r"tag_\d+")


class Paints:
    """Adds looks and prints to bodies of a model under construction."""

    def __init__(self, spec: mujoco.MjSpec) -> None:
        """Start with the one material of everything that is painted."""
        self._spec = spec
        self._spec.add_material(name=_PAINT, specular=0.25, shininess=0.35)

    def add_look(
        self,
        body: mujoco.MjsBody,
        name: str,
        mesh: MeshData,
        *,
        pose: Pose[Any, Any],
        opacity: float,
    ) -> None:
        """Show a mesh on a body, a geom for each of its colours."""
        colors, of_face = np.unique(mesh.face_colors[:, :3], axis=0, return_inverse=True)
        given = [part.normals for part in mesh.parts if part.normals is not None]
        smooth = np.concatenate(given) if len(given) == len(mesh.parts) else None
        for index, rgb in enumerate(colors.tolist()):
            faces = mesh.faces[of_face.ravel() == index]
            used, compact = np.unique(faces, return_inverse=True)
            asset = _mesh(self._spec, f"{name}/{index}", mesh.vertices[used], compact)
            if smooth is not None:
                asset.usernormal = smooth[used].ravel()
                asset.userfacenormal = compact.ravel()
            body.add_geom(
                type=mujoco.mjtGeom.mjGEOM_MESH,
                meshname=f"{name}/{index}",
                material=_PAINT,
                rgba=[*(np.array(rgb) / 255.0), opacity],
                mass=0.0,
                pos=pose.translation,
                quat=pose.quaternion_wxyz,
            )

    def add_print(self, body: mujoco.MjsBody, marker: Marker, *, pose: Pose[Any, Any]) -> None:
        """Stick the print of a marker on a body."""
        name = f"print/{marker.family}/{marker.id}"
        side = cells(marker.family, marker.id).shape[0]
        half = marker.size_m * (side + 2 * QUIET_CELLS) / side / 2.0
        corners = half * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
        asset = _mesh(self._spec, name, corners, np.array([0, 2, 1, 0, 3, 2]))
        asset.usertexcoord = np.array([0, 0, 1, 0, 1, 1, 0, 1.0])
        grey = marker_image(marker)
        texture = self._spec.add_texture(
            name=name,
            type=mujoco.mjtTexture.mjTEXTURE_2D,
            width=grey.shape[1],
            height=grey.shape[0],
            nchannel=3,
        )
        texture.data = np.repeat(grey[:, :, None], 3, axis=2).tobytes()
        material = self._spec.add_material(name=name, specular=0.0, shininess=0.0)
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=name,
            material=name,
            mass=0.0,
            pos=pose.translation,
            quat=pose.quaternion_wxyz,
        )


def unprinted(mesh: MeshData) -> MeshData:
    """Return the mesh of an object without its printed markers, parts named `tag_<id>`."""
    return MeshData.of(tuple(p for p in mesh.parts if not _PRINT.fullmatch(p.name)))


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
