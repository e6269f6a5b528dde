"""Meshes as binary glTF 2.0, written from checked arrays alone.

One node per part; vertices as they are in `MeshData` (metres, Z up), which the extras say. Same
mesh, same bytes.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from typing import Any

import cv2
import numpy as np
import trimesh

from scene.mesh import MeshData, MeshPart
from spatial.rotation import Array

CREASE_RAD = float(np.radians(35.0))
"""Faces that meet at a larger angle are shaded as an edge."""
EXTRAS = {"up": "Z", "units": "m"}
_FLOAT, _UINT = 5126, 5125
_VERTICES, _INDICES = 34962, 34963


def to_glb(mesh: MeshData, *, extras: Mapping[str, Any] | None = None) -> bytes:
    """Return a binary glTF of a mesh.

    Edges sharper than `CREASE_RAD` stay edges where a part brings no normals of its own.

    Args:
        mesh: parts with their materials.
        extras: entries added to the scene's extras.
    """
    file = _File()
    for index, part in enumerate(mesh.parts):
        file.add(part, name=part.name or f"part_{index}")
    return file.finish({**EXTRAS, **(extras or {})})


class _File:
    """A glTF under construction."""

    def __init__(self) -> None:
        self.tree: dict[str, list[dict[str, Any]]] = {
            key: []
            for key in (
                "nodes",
                "meshes",
                "materials",
                "textures",
                "images",
                "accessors",
                "bufferViews",
            )
        }
        self.binary = bytearray()

    def add(self, part: MeshPart, *, name: str) -> None:
        """Append one part as a node with a mesh of its own."""
        vertices, normals, faces, uv = shaded(part)
        attributes = {
            "POSITION": self._array(vertices, bounds=True),
            "NORMAL": self._array(normals),
        }
        if uv is not None and part.material.texture is not None:
            attributes["TEXCOORD_0"] = self._array(uv * (1.0, -1.0) + (0.0, 1.0))
        if part.face_colors is not None:
            attributes["COLOR_0"] = self._array(_corner_colors(part))
        primitive = {
            "attributes": attributes,
            "indices": self._array(faces.reshape(-1), target=_INDICES),
            "material": self._material(part, name=name),
        }
        mesh = self._append("meshes", {"name": name, "primitives": [primitive]})
        self._append("nodes", {"name": name, "mesh": mesh})

    def finish(self, extras: Mapping[str, Any]) -> bytes:
        """Return the finished file."""
        tree = {key: items for key, items in self.tree.items() if items}
        scene = {"nodes": list(range(len(self.tree["nodes"]))), "extras": dict(extras)}
        head = {
            "asset": {"version": "2.0", "generator": "telepresence"},
            "scene": 0,
            "scenes": [scene],
            **tree,
            "buffers": [{"byteLength": len(self.binary)}],
        }
        text = json.dumps(head, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        chunks = struct.pack("<I4s", len(text), b"JSON") + text
        chunks += struct.pack("<I4s", len(self.binary), b"BIN\0") + self.binary
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks

    def _append(self, key: str, item: dict[str, Any]) -> int:
        self.tree[key].append(item)
        return len(self.tree[key]) - 1

    def _view(self, data: bytes, target: int | None = None) -> int:
        view = {"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data)}
        if target is not None:
            view["target"] = target
        self.binary += data + b"\0" * (-len(data) % 4)
        return self._append("bufferViews", view)

    def _array(self, array: Array, *, bounds: bool = False, target: int = _VERTICES) -> int:
        whole = array.ndim == 1
        stored = np.ascontiguousarray(array, "<u4" if whole else "<f4")
        accessor: dict[str, Any] = {
            "bufferView": self._view(stored.tobytes(), target),
            "componentType": _UINT if whole else _FLOAT,
            "count": len(stored),
            "type": "SCALAR" if whole else f"VEC{stored.shape[1]}",
        }
        if bounds:
            accessor["min"] = stored.min(axis=0).tolist()
            accessor["max"] = stored.max(axis=0).tolist()
        return self._append("accessors", accessor)

    def _material(self, part: MeshPart, *, name: str) -> int:
        look = part.material
        textured = look.texture is not None and part.uv is not None
        plain = textured or part.face_colors is not None
        pbr: dict[str, Any] = {
            "baseColorFactor": [1, 1, 1, 1] if plain else linear(look.color),
            "metallicFactor": round(look.metallic, 4),
            "roughnessFactor": round(look.roughness, 4),
        }
        if textured:
            assert look.texture is not None
            pbr["baseColorTexture"] = {"index": self._texture(look.texture)}
        material: dict[str, Any] = {"name": name, "pbrMetallicRoughness": pbr}
        if look.color[3] < 255 and not plain:
            material["alphaMode"] = "BLEND"
        return self._append("materials", material)

    def _texture(self, pixels: Any) -> int:
        done, png = cv2.imencode(".png", np.ascontiguousarray(pixels[..., ::-1]))
        assert done, "an 8-bit image always encodes"
        image = {"bufferView": self._view(png.tobytes()), "mimeType": "image/png"}
        return self._append("textures", {"source": self._append("images", image)})


def linear(color: tuple[int, int, int, int]) -> list[float]:
    """Return glTF's linear colour of an sRGB colour of 0 to 255; alpha is linear already."""
    srgb = np.array(color[:3]) / 255.0
    low = srgb <= 0.04045
    rgb = np.where(low, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
    return [*np.round(rgb, 6).tolist(), round(color[3] / 255.0, 6)]


def shaded(part: MeshPart) -> tuple[Array, Array, Any, Array | None]:
    """Return vertices, normals, faces and texture coordinates, split where edges are sharp."""
    if part.normals is not None and part.face_colors is None:
        return part.vertices, part.normals, part.faces, part.uv
    if part.uv is not None or part.face_colors is not None:
        corners = part.faces.reshape(-1)
        vertices = part.vertices[corners]
        faces = np.arange(len(corners)).reshape(-1, 3)
        uv = None if part.uv is None else part.uv[corners]
        return vertices, np.repeat(_face_normals(vertices[faces]), 3, axis=0), faces, uv
    mesh: Any = trimesh.Trimesh(part.vertices, part.faces, process=False)
    mesh.merge_vertices()
    smooth = trimesh.graph.smooth_shade(mesh, angle=CREASE_RAD)
    return (
        np.asarray(smooth.vertices),
        np.asarray(smooth.vertex_normals),
        np.asarray(smooth.faces),
        None,
    )


def _corner_colors(part: MeshPart) -> Array:
    assert part.face_colors is not None
    colors = [linear((int(r), int(g), int(b), int(a))) for r, g, b, a in part.face_colors]
    return np.repeat(np.array(colors), 3, axis=0)


def _face_normals(triangles: Array) -> Array:
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return normals / np.where(length > 0, length, 1.0)
