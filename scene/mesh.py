"""Triangle meshes as validated arrays; every mesh the program shows went through here.

Meshes are in metres and in the frame of their owner. What is loaded is rebuilt from checked
arrays, so that no byte of a foreign file ever reaches a browser.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from scene.mesh_check import (
    FORMATS,
    MAX_FACES,
    MAX_PARTS,
    base_colors,
    check_bytes,
    check_image,
    read_bytes,
)
from spatial.errors import FileInputError, unknown
from spatial.rotation import Array

Bytes = NDArray[np.uint8]
Indices = NDArray[np.int64]
FARTHEST_M = 1e9
"""Coordinates beyond it are no place of anything, and overflow what a browser takes."""
GREY = (180, 184, 190, 255)


@dataclass(frozen=True, slots=True, eq=False)
class Material:
    """How a surface looks (metallic-roughness model of glTF)."""

    color: tuple[int, int, int, int] = GREY
    """Base colour RGBA, 0 to 255."""
    metallic: float = 0.0
    """0 to 1."""
    roughness: float = 0.6
    """0 to 1."""
    texture: Bytes | None = None
    """Base colour texture (h, w, 3), first row on top; needs texture coordinates."""


@dataclass(frozen=True, slots=True, eq=False)
class MeshPart:
    """Triangles of one material."""

    name: str
    """Name of the geometry in its file."""
    vertices: Array
    """(n, 3) [m]."""
    faces: Indices
    """(m, 3) indices into `vertices`, counter-clockwise seen from outside."""
    material: Material
    """How it looks."""
    uv: Array | None = None
    """Texture coordinates (n, 2), origin at the bottom left."""
    face_colors: Bytes | None = None
    """RGBA (m, 4) where faces differ in colour."""
    normals: Array | None = None
    """Unit normals (n, 3) for shading; `None` to have them made."""


@dataclass(frozen=True, slots=True, eq=False)
class MeshData:
    """A mesh of one or more parts, and the same as one array of triangles."""

    parts: tuple[MeshPart, ...]
    """Parts with their materials."""
    vertices: Array
    """All vertices (n, 3) [m]."""
    faces: Indices
    """All triangles (m, 3), indices into `vertices`."""
    face_colors: Bytes
    """RGBA (m, 4) of every triangle."""

    @classmethod
    def of(cls, parts: tuple[MeshPart, ...]) -> MeshData:
        """Join parts; at least one triangle is expected."""
        starts = np.cumsum([0, *(len(p.vertices) for p in parts)])
        vertices = np.concatenate([np.zeros((0, 3)), *(p.vertices for p in parts)])
        faces = [np.zeros((0, 3), np.int64)]
        faces += [p.faces + start for p, start in zip(parts, starts[:-1], strict=True)]
        colors = [np.zeros((0, 4), np.uint8), *(_colors(p) for p in parts)]
        return cls(
            parts,
            _frozen(vertices),
            _frozen(np.concatenate(faces)),
            _frozen(np.concatenate(colors)),
        )

    @property
    def extents_m(self) -> Array:
        """Size (3,) of the axis-aligned bounding box [m]."""
        return np.asarray(np.ptp(self.vertices, axis=0))

    @property
    def watertight(self) -> bool:
        """Whether the surface is closed, corners at one place taken as one."""
        whole: Any = trimesh.Trimesh(self.vertices, self.faces, process=False)
        whole.merge_vertices()
        return bool(whole.is_watertight)

    def without(self, prefix: str) -> MeshData:
        """Return the mesh less the parts whose name starts so (`tag_`: printed markers)."""
        return MeshData.of(tuple(p for p in self.parts if not p.name.startswith(prefix)))

    def scaled(self, factors: Array) -> MeshData:
        """Return the mesh scaled by (3,) factors; a mirrored one keeps its outside outside."""
        flip = bool(np.prod(factors) < 0)
        return MeshData.of(
            tuple(
                replace(
                    p,
                    vertices=_frozen(p.vertices * factors),
                    normals=None,
                    faces=_frozen(p.faces[:, ::-1].copy()) if flip else p.faces,
                )
                for p in self.parts
            )
        )

    def coloured(self, color: tuple[int, int, int, int]) -> MeshData:
        """Return the mesh in one colour."""
        material = Material(color=color)
        return MeshData.of(
            tuple(replace(p, material=material, face_colors=None, uv=None) for p in self.parts)
        )


def load_mesh(path: Path) -> MeshData:
    """Return the mesh of an STL, OBJ, PLY, GLB or DAE file.

    Raises:
        FileInputError: unreadable, of another format than its name says, too large, without a
            triangle, with a vertex that is not finite or an index out of range.
    """
    kind = path.suffix.lower().lstrip(".")
    if kind not in FORMATS:
        raise FileInputError(unknown("mesh format", path.suffix, FORMATS), path=path)
    data = read_bytes(path)
    check_bytes(data, kind, path=path)
    try:
        with np.errstate(invalid="ignore", over="ignore"):
            scene = trimesh.load_scene(io.BytesIO(data), file_type=kind, process=False)
            parts = _parts(scene, base_colors(data) if kind == "glb" else {}, path=path)
    except FileInputError:
        raise
    except (Exception, RecursionError, MemoryError) as error:
        reason = f"{type(error).__name__}: {error}"[:160]
        raise FileInputError(f"is not a valid {kind.upper()} mesh: {reason}", path=path) from error
    if not sum(len(part.faces) for part in parts):
        raise FileInputError("has no triangle; expected at least 1", path=path)
    return MeshData.of(parts)


def box_mesh(size: Array) -> MeshData:
    """Return a box of size (3,) [m], centred."""
    return _primitive(trimesh.creation.box(extents=size))


def cylinder_mesh(radius: float, length: float) -> MeshData:
    """Return a cylinder along z [m], centred."""
    return _primitive(trimesh.creation.cylinder(radius=radius, height=length, sections=32))


def sphere_mesh(radius: float) -> MeshData:
    """Return a sphere [m], centred."""
    return _primitive(trimesh.creation.icosphere(subdivisions=2, radius=radius))


def _primitive(mesh: trimesh.Trimesh) -> MeshData:
    part = MeshPart(
        "primitive",
        _frozen(np.array(mesh.vertices)),
        _frozen(np.array(mesh.faces, np.int64)),
        Material(),
    )
    return MeshData.of((part,))


def _parts(scene: Any, colors: Mapping[str, list[float]], *, path: Path) -> tuple[MeshPart, ...]:
    nodes = sorted(scene.graph.nodes_geometry)
    if len(nodes) > MAX_PARTS:
        raise FileInputError(f"has {len(nodes)} parts; at most {MAX_PARTS}", path=path)
    parts = []
    total = 0
    for node in nodes:
        T_mesh_part, name = scene.graph[node]
        geometry = scene.geometry[name]
        if isinstance(geometry, trimesh.Trimesh) and len(geometry.faces):
            total += len(geometry.faces)
            if total > MAX_FACES:
                raise FileInputError(f"has over {MAX_FACES} triangles", path=path)
            parts.append(
                _part(geometry, np.asarray(T_mesh_part), colors, name=str(name), path=path)
            )
    return tuple(parts)


def _part(
    geometry: Any,
    T_mesh_part: Array,
    linear: Mapping[str, list[float]],
    *,
    name: str,
    path: Path,
) -> MeshPart:
    faces = np.array(geometry.faces, dtype=np.int64)
    vertices = (
        np.array(geometry.vertices, dtype=np.float64) @ T_mesh_part[:3, :3].T + T_mesh_part[:3, 3]
    )
    if not (np.abs(vertices) < FARTHEST_M).all():
        message = f"part {name!r} has a vertex that is not finite and below {FARTHEST_M:g} m"
        raise FileInputError(message, path=path)
    if faces.min() < 0 or faces.max() >= len(vertices):
        message = f"part {name!r} has an index outside 0 to {len(vertices) - 1}"
        raise FileInputError(message, path=path)
    if np.linalg.det(T_mesh_part[:3, :3]) < 0:
        faces = faces[:, ::-1].copy()
    material, uv, colors = _look(geometry, linear, path=path)
    return MeshPart(
        name,
        _frozen(vertices),
        _frozen(faces),
        material,
        uv,
        colors,
        _normals(geometry, T_mesh_part),
    )


def _normals(geometry: Any, T_mesh_part: Array) -> Array | None:
    if "vertex_normals" not in geometry._cache:  # noqa: SLF001 - the only way to know they are the file's
        return None
    normals = np.asarray(geometry.vertex_normals, dtype=np.float64) @ T_mesh_part[:3, :3].T
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    if not np.isfinite(length).all() or (length < 1e-9).any():
        return None
    return _frozen(normals / length)


def _look(
    geometry: Any, linear: Mapping[str, list[float]], *, path: Path
) -> tuple[Material, Array | None, Bytes | None]:
    visual = geometry.visual
    if visual.kind == "texture":
        given = visual.material
        texture = _texture(given, path=path)
        uv = None if texture is None or visual.uv is None else np.array(visual.uv, np.float64)
        count = len(geometry.vertices)
        if uv is not None and (uv.shape != (count, 2) or not np.isfinite(uv).all()):
            uv = None
        material = Material(
            color=_base_color(given, linear),
            metallic=_unit(getattr(given, "metallicFactor", None), default=0.0),
            roughness=_unit(getattr(given, "roughnessFactor", None), default=0.6),
            texture=texture if uv is not None else None,
        )
        return material, uv, None
    if visual.kind in {"face", "vertex"}:
        colors = np.array(visual.face_colors, dtype=np.uint8)
        return Material(), None, _frozen(colors) if len(colors) == len(geometry.faces) else None
    return Material(), None, None


def _base_color(material: Any, linear: Mapping[str, list[float]]) -> tuple[int, int, int, int]:
    factor = linear.get(str(material.name))
    color = np.asarray(material.main_color).ravel()[:4] if factor is None else srgb(factor)
    if len(color) != 4:
        return GREY
    r, g, b, a = (int(c) for c in color)
    return r, g, b, a


def srgb(factor: list[float]) -> Bytes:
    """Return the sRGB colour RGBA (4,) of 0 to 255 of a linear one of 0 to 1."""
    values = np.clip(np.asarray(factor, dtype=np.float64), 0.0, 1.0)
    low = values[:3] <= 0.0031308
    values[:3] = np.where(low, 12.92 * values[:3], 1.055 * values[:3] ** (1 / 2.4) - 0.055)
    return np.rint(255.0 * values).astype(np.uint8)


def _texture(material: Any, *, path: Path) -> Bytes | None:
    """Return the embedded picture; only GLB embeds one, others would be files elsewhere."""
    image = getattr(material, "baseColorTexture", None)
    if image is None:
        return None
    check_image(image.size, path=path)
    return _frozen(np.array(image.convert("RGB"), dtype=np.uint8))


def _unit(value: float | None, *, default: float) -> float:
    return float(np.clip(value, 0.0, 1.0)) if value is not None and np.isfinite(value) else default


def _colors(part: MeshPart) -> Bytes:
    if part.face_colors is not None:
        return part.face_colors
    if part.material.texture is not None:
        mean = part.material.texture.reshape(-1, 3).mean(axis=0)
        return np.tile(np.array([*mean, 255], np.uint8), (len(part.faces), 1))
    return np.tile(np.array(part.material.color, np.uint8), (len(part.faces), 1))


def _frozen(array: NDArray[Any]) -> NDArray[Any]:
    array.flags.writeable = False
    return array
