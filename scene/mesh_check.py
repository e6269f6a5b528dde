"""What is checked of a mesh file before a parser sees it.

The parsers behind `scene.mesh` drop non-finite faces silently, allocate what a header claims and
read archives of any size; so size, magic, claimed counts and non-finite numbers are looked at
here, in the raw bytes.
"""

from __future__ import annotations

import json
import re
import struct
from pathlib import Path
from typing import Any

import numpy as np

from spatial.errors import FileInputError

FORMATS = ("glb", "stl", "obj", "ply", "dae")
MAX_BYTES = 100_000_000
MAX_FACES = 1_000_000
MAX_PARTS = 256
MAX_MATERIALS = 64
MAX_TEXTURE_PX = 4096
MAX_DEPTH = 32

_NOT_FINITE = re.compile(rb"(?<![A-Za-z_])[+-]?(nan|inf|infinity)(?![A-Za-z_])", re.IGNORECASE)
_COMPONENT_BYTES = {5120: 1, 5121: 1, 5122: 2, 5123: 2, 5125: 4, 5126: 4}
_COMPONENTS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT2": 4, "MAT3": 9, "MAT4": 16}


def read_bytes(path: Path) -> bytes:
    """Return the bytes of a file of bounded size."""
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            message = f"is {size} bytes; a mesh has at most {MAX_BYTES}"
            raise FileInputError(message, path=path)
        return path.read_bytes()
    except OSError as error:
        raise FileInputError(f"cannot be read: {error.strerror or error}", path=path) from error


def check_bytes(data: bytes, kind: str, *, path: Path) -> None:
    """Refuse bytes that are not what the format promises.

    Raises:
        FileInputError: with what was found and what was expected.
    """
    try:
        _CHECKS[kind](data)
    except (_BadMeshError, RecursionError) as error:
        message = f"is not a valid {kind.upper()} mesh: {str(error)[:200]}"
        raise FileInputError(message, path=path) from error


def check_image(size_px: tuple[int, int], *, path: Path) -> None:
    """Refuse a texture larger than `MAX_TEXTURE_PX`, before its pixels are decoded."""
    if max(size_px) > MAX_TEXTURE_PX:
        message = f"has a texture of {size_px[0]} x {size_px[1]} px; at most {MAX_TEXTURE_PX}"
        raise FileInputError(message, path=path)


class _BadMeshError(Exception):
    """What is wrong with the bytes; `check_bytes` adds the file."""


def _check_stl(data: bytes) -> None:
    if data[:5].lower() == b"solid" and b"facet" in data[:4096]:
        _check_text(data)
        return
    if len(data) < 84:
        raise _BadMeshError(f"{len(data)} bytes; a binary STL has at least 84")
    (count,) = struct.unpack_from("<I", data, 80)
    if len(data) != 84 + 50 * count:
        raise _BadMeshError(
            f"{len(data)} bytes; a binary STL of {count} triangles has {84 + 50 * count}"
        )
    layout = np.dtype([("numbers", "<f4", (12,)), ("attribute", "<u2")])
    numbers = np.frombuffer(data, dtype=layout, offset=84)["numbers"]
    if not np.isfinite(numbers[:, 3:]).all():
        raise _BadMeshError("a vertex is not finite")


def _check_text(data: bytes) -> None:
    if b"\x00" in data[:4096]:
        raise _BadMeshError("binary bytes where text was expected")
    if found := _NOT_FINITE.search(data):
        line = data.count(b"\n", 0, found.start()) + 1
        raise _BadMeshError(f"line {line} holds {found.group().decode()!r}, not a finite number")


def _check_obj(data: bytes) -> None:
    _check_text(data)
    if (uses := data.count(b"usemtl")) > MAX_MATERIALS * 4:
        raise _BadMeshError(f"{uses} changes of material; at most {MAX_MATERIALS * 4}")
    vertices = len(re.findall(rb"^\s*v\s", data, re.MULTILINE))
    for face in re.finditer(rb"^\s*f\s+([^\r\n#]+)", data, re.MULTILINE):
        for corner in face.group(1).split():
            index = corner.split(b"/", 1)[0]
            good = re.fullmatch(rb"-?\d{1,9}", index) and 1 <= abs(int(index)) <= vertices
            if not good:
                line = data.count(b"\n", 0, face.start()) + 1
                shown = corner[:20].decode(errors="replace")
                raise _BadMeshError(f"line {line}: corner {shown!r}; vertices are 1 to {vertices}")


def _check_ply(data: bytes) -> None:
    head, separator, _ = data.partition(b"end_header")
    if not data.startswith(b"ply") or not separator:
        raise _BadMeshError("no 'ply' header")
    claimed = sum(int(n) for n in re.findall(rb"^element\s+\w+\s+(\d{1,18})", head, re.MULTILINE))
    if claimed > len(data):
        raise _BadMeshError(f"{claimed} elements claimed in {len(data)} bytes")
    if re.search(rb"^format\s+ascii", head, re.MULTILINE):
        _check_text(data)


def _check_dae(data: bytes) -> None:
    if b"<!DOCTYPE" in data or b"<!ENTITY" in data:
        raise _BadMeshError("a document type definition is not accepted")
    if b"COLLADA" not in data[:4096]:
        raise _BadMeshError("no COLLADA element")
    _check_text(data)


def base_colors(data: bytes) -> dict[str, list[float]]:
    """Return the linear base colour factors of a checked GLB by the name of the material.

    The parser rounds them to 8 bits before the turn to sRGB, which shifts dark colours.
    """
    colors = {}
    for material in _list(_glb_tree(data), "materials"):
        pbr = material.get("pbrMetallicRoughness", {})
        factor = pbr.get("baseColorFactor", [1, 1, 1, 1]) if isinstance(pbr, dict) else None
        if not isinstance(factor, list) or len(factor) != 4:
            continue
        if all(isinstance(v, int | float) for v in factor) and np.isfinite(factor).all():
            colors[str(material.get("name", ""))] = [float(v) for v in factor]
    return colors


def _check_glb(data: bytes) -> None:
    tree = _glb_tree(data)
    _check_claims(tree, len(data))
    _check_nodes(_list(tree, "nodes"))


def _glb_tree(data: bytes) -> dict[str, Any]:
    if len(data) < 20 or data[:4] != b"glTF":
        raise _BadMeshError(f"starts with {data[:4]!r}; expected b'glTF'")
    version, length, json_length, json_kind = struct.unpack_from("<IIII", data, 4)
    if version != 2 or length != len(data):
        raise _BadMeshError(f"version {version}, {length} bytes; expected 2 and {len(data)}")
    if json_kind != 0x4E4F534A or 20 + json_length > len(data):
        raise _BadMeshError("the first chunk is not JSON")
    try:
        tree = json.loads(data[20 : 20 + json_length])
    except ValueError as error:
        raise _BadMeshError(f"its JSON: {error}") from error
    if not isinstance(tree, dict):
        raise _BadMeshError("its JSON is not an object")
    return tree


def _check_claims(tree: dict[str, Any], size: int) -> None:
    """Nothing outside the file, and no accessor that claims more than the file holds."""
    for key in ("buffers", "images"):
        if any("uri" in item for item in _list(tree, key)):
            raise _BadMeshError(f"an entry of {key!r} points outside the file; embed it")
    if len(materials := _list(tree, "materials")) > MAX_MATERIALS:
        raise _BadMeshError(f"{len(materials)} materials; at most {MAX_MATERIALS}")
    claimed = 0
    for accessor in _list(tree, "accessors"):
        count = accessor.get("count", 0)
        if not isinstance(count, int) or count < 0:
            raise _BadMeshError(f"an accessor with count {str(count)[:20]}")
        each = _COMPONENT_BYTES.get(_plain(accessor.get("componentType")), 4)
        claimed += count * each * _COMPONENTS.get(str(accessor.get("type")), 1)
    if claimed > 4 * size:
        raise _BadMeshError(f"accessors claim {claimed} bytes in a file of {size}")


def _check_nodes(nodes: list[dict[str, Any]]) -> None:
    """Few nodes, no deep chain, no cycle."""
    if len(nodes) > MAX_PARTS:
        raise _BadMeshError(f"{len(nodes)} nodes; at most {MAX_PARTS}")
    level = dict.fromkeys(range(len(nodes)), 0)
    settled = False
    while not settled:
        settled = True
        for index, node in enumerate(nodes):
            children = node.get("children", [])
            for child in children if isinstance(children, list) else []:
                if _plain(child) not in level:
                    raise _BadMeshError(f"node {index} has a child {str(child)[:20]}")
                if level[child] <= level[index]:
                    level[child] = level[index] + 1
                    settled = False
                if level[child] > MAX_DEPTH:
                    raise _BadMeshError(f"nodes nest deeper than {MAX_DEPTH}, or in a circle")


def _list(tree: dict[str, Any], key: str) -> list[dict[str, Any]]:
    items = tree.get(key, [])
    if not isinstance(items, list) or not all(isinstance(item, dict) for item in items):
        raise _BadMeshError(f"{key!r} is not a list of objects")
    return items


def _plain(value: object) -> int:
    return value if isinstance(value, int) and not isinstance(value, bool) else -1


_CHECKS = {
    "stl": _check_stl,
    "obj": _check_obj,
    "ply": _check_ply,
    "dae": _check_dae,
    "glb": _check_glb,
}
