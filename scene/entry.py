"""One object of the database: a folder with `object.toml` and its mesh.

schema = 1
slug = "peg"                        # name of the folder
name = "Peg"
revision = 1
mass_kg = 1.4                       # optional
motion = "static"                   # static | held | mobile

[mesh]
file = "mesh.glb"                   # object frame, metres, Z up

[appearance]                        # optional
color = [120, 130, 140]
opacity = 1.0

[[marker]]                          # exactly one has target = true
family = "tag36h11"
id = 7
size_m = 0.03                       # edge of the outer black square
translation_m = [0, 0, 0.1]         # T_object_marker: x right, y up, z out of the face
quaternion_wxyz = [1, 0, 0, 0]
target = true

[[frame]]                           # grasp | approach | axis | seat | tip | place
name = "tip"
kind = "tip"

[[fixture]]                         # see `scene.fixture`
"""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from scene.fixture import Fixture, parse_fixture
from scene.marker_image import DICTIONARIES, family_size
from scene.mesh import MeshData, load_mesh
from scene.table import TableReader, read_toml
from scene.toml_lines import with_line
from spatial.errors import FileInputError
from spatial.frames import Frame, Object
from spatial.marker import FAMILIES, MarkedObject, Marker
from spatial.pose import Pose
from spatial.rotation import Array

MAX_TOML_BYTES = 1_000_000
UNITS = ("m", "cm", "mm", "in")
MOTIONS = ("static", "held", "mobile")
FRAME_KINDS = ("grasp", "approach", "axis", "seat", "tip", "place")
SLUG = re.compile(r"[a-z][a-z0-9_-]{0,62}")
DEFAULT_COLOR = (180, 184, 190)


@dataclass(frozen=True, slots=True, eq=False)
class NamedFrame:
    """A place on an object that means something."""

    name: str
    """Unique within the object."""
    kind: str
    """`grasp`, `approach`, `axis`, `seat`, `tip` or `place`."""
    T_object_frame: Pose[Object, Frame]
    """Its pose in the object."""


@dataclass(frozen=True, slots=True, eq=False)
class ObjectEntry:
    """An object of the database, as it was read."""

    slug: str
    """Name of its folder."""
    name: str
    """Name for people."""
    revision: int
    """Counts the edits."""
    sha256: str
    """Digest of `object.toml` and the mesh: what this entry is, exactly."""
    folder: Path
    """Its folder."""
    mesh_path: Path
    """Its mesh file."""
    mesh: MeshData
    """Its mesh, in the object's frame; parts named `tag_<id>` are the printed markers."""
    color: tuple[int, int, int]
    """RGB for where one colour stands for the object, 0 to 255."""
    opacity: float
    """0 to 1."""
    mass_kg: float | None
    """Mass [kg]; `None` if unknown."""
    motion: str
    """`static`, `held` or `mobile`."""
    markers: tuple[Marker, ...]
    """Markers on it."""
    target: tuple[str, int] | None
    """Family and id of the target marker, the paper's x; `None` for an object without markers."""
    frames: Mapping[str, NamedFrame]
    """Named frames."""
    fixtures: tuple[Fixture, ...]
    """Guiding shapes attached to it."""
    diameter_m: float | None
    """Largest distance of two of its points [m]; `None` if not given."""
    symmetry_axis: Array | None
    """Axis (3,) of rotational symmetry of the shape without its markers; `None` without one."""

    @property
    def extents_m(self) -> Array:
        """Size (3,) of the mesh's bounding box [m]."""
        return self.mesh.extents_m

    def marked(self) -> MarkedObject:
        """Return what a tracker knows of the object.

        Raises:
            FileInputError: an object without markers.
        """
        if self.target is None:
            message = f"object {self.slug!r} has no marker; a tracker needs at least 1"
            raise FileInputError(message, path=self.folder / "object.toml", key="marker")
        return MarkedObject(self.slug, self.revision, self.target, self.markers, self.motion)


def load_object(folder: Path) -> ObjectEntry:
    """Return the object of a folder.

    Raises:
        FileInputError: with file, key and line of what cannot be used.
    """
    path = folder / "object.toml"
    text = _text(path)
    try:
        table = read_toml(path)
    except (ValueError, RecursionError) as error:
        raise FileInputError(f"is not TOML: {error}", path=path) from error
    try:
        return _entry(table, folder, text)
    except FileInputError as error:
        raise (with_line(error, text) if error.path == path else error) from error


def _text(path: Path) -> str:
    try:
        if path.stat().st_size > MAX_TOML_BYTES:
            raise FileInputError(f"is larger than {MAX_TOML_BYTES} bytes", path=path)
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise FileInputError(f"cannot be read: {error.strerror}", path=path) from error
    except UnicodeDecodeError as error:
        raise FileInputError("is not UTF-8 text", path=path) from error


def _entry(raw: Mapping[str, Any], folder: Path, text: str) -> ObjectEntry:
    reader = TableReader(raw, path=folder / "object.toml")
    if (schema := reader.whole("schema")) != 1:
        reader.fail("schema", f"schema {schema} is unknown; this program reads schema 1")
    slug = reader.text("slug")
    if not SLUG.fullmatch(slug) or slug != folder.resolve().name:
        reader.fail(
            "slug",
            f"slug {slug!r} must be the folder's name {folder.resolve().name!r}: "
            "a-z, then a-z 0-9 _ -",
        )
    name = reader.text("name")
    if len(name) > 80 or not name.isprintable():
        reader.fail("name", f"name {name[:80]!r} is not at most 80 printable characters")
    revision = reader.whole("revision", least=1)
    mass = reader.number("mass_kg", above=0.0) if "mass_kg" in reader else None
    motion = reader.choice("motion", MOTIONS, default="static")
    mesh_table = reader.table("mesh")
    mesh_path = mesh_table.file("file")
    mesh_table.finish()
    color, opacity = _appearance(reader.table("appearance", optional=True))
    diameter, axis = _symmetry(reader.table("symmetry", optional=True))
    reader.choice("units_of_source", UNITS, default="m")
    markers, target = _markers(reader)
    frames = _frames(reader)
    fixtures = _fixtures(reader, raw.get("fixture", []), frames, path=folder / "object.toml")
    reader.finish()
    digest = hashlib.sha256(text.encode() + mesh_path.read_bytes()).hexdigest()
    return ObjectEntry(
        slug=slug,
        name=name,
        revision=revision,
        sha256=digest,
        folder=folder,
        mesh_path=mesh_path,
        mesh=load_mesh(mesh_path),
        color=color,
        opacity=opacity,
        mass_kg=mass,
        motion=motion,
        markers=markers,
        target=target,
        frames=frames,
        fixtures=fixtures,
        diameter_m=diameter,
        symmetry_axis=axis,
    )


def _appearance(table: TableReader) -> tuple[tuple[int, int, int], float]:
    r, g, b = table.numbers("color", 3, default=DEFAULT_COLOR)
    if not all(0 <= value <= 255 for value in (r, g, b)):
        table.fail("color", f"color {[r, g, b]} is not three numbers from 0 to 255")
    opacity = table.number("opacity", default=1.0, above=0.0)
    if opacity > 1.0:
        table.fail("opacity", f"opacity {opacity:g} is not above 0 and at most 1")
    table.finish()
    return (round(r), round(g), round(b)), opacity


def _symmetry(table: TableReader) -> tuple[float | None, Array | None]:
    diameter = table.number("diameter_m", above=0.0) if "diameter_m" in table else None
    axis = None
    if "continuous_axis" in table:
        axis = np.array(table.numbers("continuous_axis", 3))
        if (length := float(np.linalg.norm(axis))) < 1e-6:
            table.fail("continuous_axis", f"continuous_axis {axis.tolist()} has no direction")
        axis /= length
    table.finish()
    return diameter, axis


def _markers(reader: TableReader) -> tuple[tuple[Marker, ...], tuple[str, int] | None]:
    markers: list[Marker] = []
    targets: list[tuple[str, int]] = []
    for table in reader.tables("marker"):
        family = table.choice("family", FAMILIES)
        number = table.whole("id", least=0)
        if family in DICTIONARIES and number >= family_size(family):
            last = family_size(family) - 1
            table.fail("id", f"id {number} is not in {family}, which has 0 to {last}")
        marker = Marker(
            family=family,
            id=number,
            size_m=table.number("size_m", above=0.0),
            T_object_marker=table.pose(),
        )
        if marker.key in {other.key for other in markers}:
            table.fail("id", f"marker {marker.family} {marker.id} is listed twice")
        if table.flag("target", default=False):
            targets.append(marker.key)
        markers.append(marker)
        table.finish()
    if markers and len(targets) != 1:
        listed = ", ".join(f"{family} {number}" for family, number in targets) or "none"
        reader.fail("marker", f"exactly one marker has target = true; found {listed}")
    return tuple(markers), targets[0] if targets else None


def _frames(reader: TableReader) -> dict[str, NamedFrame]:
    frames: dict[str, NamedFrame] = {}
    for table in reader.tables("frame"):
        name = table.text("name")
        if name in frames or name == "object":
            table.fail("name", f"frame {name!r} exists already; names are unique")
        frames[name] = NamedFrame(name, table.choice("kind", FRAME_KINDS), table.pose())
        table.finish()
    return frames


def _fixtures(
    reader: TableReader,
    raw: Sequence[Mapping[str, Any]],
    frames: Mapping[str, NamedFrame],
    *,
    path: Path,
) -> tuple[Fixture, ...]:
    reader.tables("fixture")
    poses = {name: frame.T_object_frame for name, frame in frames.items()}
    fixtures = tuple(
        parse_fixture(table, frames=poses, path=path, key=f"fixture[{index}]")
        for index, table in enumerate(raw)
    )
    counts = Counter(fixture.name for fixture in fixtures)
    if twice := [name for name, count in counts.items() if count > 1]:
        reader.fail("fixture", f"fixture {twice[0]!r} exists twice; names are unique")
    return fixtures
