"""The site file: everything a lab changes, and nowhere in code. `docs` explains each key.

Paths in it are relative to the file, else to the checkout's `assets`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from scene.mount import rigid_pose
from scene.robot import Robot, load_robot
from scene.table import TableReader, read_toml
from scene.toml_lines import with_line
from spatial.camera import PinholeCamera
from spatial.errors import FileInputError, unknown
from spatial.frames import Cam, Frame
from spatial.pose import Pose
from spatial.stamp import NS_PER_MS

ASSETS = Path(__file__).resolve().parents[1] / "assets"
"""Where relative paths lead that do not exist beside the site file."""
DEFAULT_SITE = ASSETS / "sites" / "sam.toml"
"""The site every command takes unless told otherwise."""

SCHEMA = 1
CLOCK_MODES = ("shared", "ptp", "measured")
PARENTS = ("tcp", "base")
HIERARCHIES = ("nested", "flat")
MOTIONS = ("static", "held", "mobile")
ROOTS = ("base", "w")


@dataclass(frozen=True, slots=True)
class StateLimits:
    """When a pose stops being trusted (contract: States)."""

    tracked_ns: int = 150 * NS_PER_MS
    """A fix at most this much older than its stream's delay is TRACKED [ns]."""
    bridged_motion_ns: int = 300 * NS_PER_MS
    """A bridged pose needs motion at most this old [ns]."""
    bridged_sigma_m: float = 0.060
    """... and a largest positional 3 sigma of at most this [m]."""
    lost_after_ns: int = 500 * NS_PER_MS
    """STALE for longer than this is LOST [ns]."""
    horizon_ns: int = 100 * NS_PER_MS
    """Nothing is extrapolated by a twist or joint velocity for longer than this [ns]."""


@dataclass(frozen=True, slots=True, eq=False)
class SiteCamera:
    """A camera of the site, as it is nominally."""

    name: str
    """Name in keys and messages: `hc`, `mako`."""
    intrinsics: PinholeCamera
    """Nominal intrinsics."""
    parent: str
    """Link it is rigid to: `tcp` (eye in hand) or `base` (eye to hand)."""
    T_parent_cam: Pose[Frame, Cam]
    """Nominal pose of its optical frame in that link."""
    rate_hz: float
    """Frame rate [Hz]."""


@dataclass(frozen=True, slots=True)
class SiteObject:
    """An object of the site and the stream it comes from."""

    slug: str
    """Name of its folder in the database."""
    camera: str
    """Name of the camera that carries it."""
    hierarchy: str
    """`nested`: driven by the tcp, Eq. 1; `flat`: Eq. 4."""
    motion: str
    """`static` in w, `held` by the tool or `mobile`."""


@dataclass(frozen=True, slots=True, eq=False)
class Site:
    """A remote site as its file describes it."""

    path: Path
    """The file."""
    name: str
    """Name in keys."""
    robot: Path
    """URDF of the robot."""
    objects_dir: Path
    """Folder of the object database."""
    clock_mode: str
    """`shared`, `ptp` or `measured`."""
    limits: StateLimits
    """Limits of the states."""
    cameras: Mapping[str, SiteCamera]
    """Cameras by name, in the order of the file."""
    vio_camera: str
    """Camera whose motion the odometry gives."""
    vio_rate_hz: float
    """Rate of the odometry [Hz]."""
    objects: tuple[SiteObject, ...]
    """Objects, in the order of the file."""
    display_root: str
    """Frame the page starts in: `base`, `w` or the slug of an object."""
    target: str
    """Slug of the object the tool goes to."""
    fixtures: bool
    """Whether fixtures start on in this session."""
    video_bit_s: float
    """Bit rate the operator's video may take at first [bit/s]."""

    def object(self, slug: str) -> SiteObject:
        """Return the entry of an object of this site."""
        return next(entry for entry in self.objects if entry.slug == slug)


def load_site(path: Path) -> Site:
    """Read and check a site file.

    Raises:
        FileInputError: a value that is missing, unknown or of the wrong kind, or a file it names
            that does not exist; file, line or key, the expected and the available are named.
    """
    table = read_toml(path)
    try:
        return _site(TableReader(table, path=path), path)
    except FileInputError as error:
        if error.path != path:
            raise
        raise with_line(error, path.read_text(encoding="utf-8")) from error


def _site(reader: TableReader, path: Path) -> Site:
    _check_schema(reader)
    name = reader.text("name")
    robot = _path(reader, "robot", path=path)
    objects_dir = _path(reader, "objects", path=path, default="objects")
    clock = reader.table("clock", optional=True)
    clock_mode = clock.choice("mode", CLOCK_MODES, default="shared")
    clock.finish()
    limits = _limits(reader.table("limits", optional=True))
    cameras = _cameras(reader, robot=robot)
    vio = reader.table("vio")
    vio_camera = vio.choice("camera", tuple(cameras))
    vio_rate_hz = vio.number("rate_hz", above=0.0)
    vio.finish()
    objects = _objects(reader, cameras=cameras, objects_dir=objects_dir)
    slugs = tuple(entry.slug for entry in objects)
    display = reader.table("display", optional=True)
    display_root = display.choice("root", (*ROOTS, *slugs), default="base")
    target = display.choice("target", slugs, default=slugs[0])
    fixtures = display.flag("fixtures", default=True)
    display.finish()
    network = reader.table("network", optional=True)
    video_bit_s = 1e6 * network.number("video_mbit_s", default=4.0, above=0.0)
    network.finish()
    reader.finish()
    return Site(
        path=path,
        name=name,
        robot=robot,
        objects_dir=objects_dir,
        clock_mode=clock_mode,
        limits=limits,
        cameras=cameras,
        vio_camera=vio_camera,
        vio_rate_hz=vio_rate_hz,
        objects=objects,
        display_root=display_root,
        target=target,
        fixtures=fixtures,
        video_bit_s=video_bit_s,
    )


def _check_schema(reader: TableReader) -> None:
    schema = reader.whole("schema")
    if schema != SCHEMA:
        reader.fail("schema", f"schema is {schema}; this version reads {SCHEMA}")


def _path(reader: TableReader, name: str, *, path: Path, default: str | None = None) -> Path:
    text = reader.text(name, default=default)
    beside = (path.parent / text).resolve()
    candidates = (beside, (ASSETS / text).resolve())
    for candidate in candidates:
        if candidate.exists():
            return candidate
    near = candidates[-1].parent
    names = (p.name for p in near.iterdir()) if near.is_dir() else ()
    return reader.fail(name, unknown(name, text, names))


def _limits(reader: TableReader) -> StateLimits:
    standard = StateLimits()

    def duration(name: str, default_ns: int) -> int:
        default_ms = default_ns / NS_PER_MS
        return round(reader.number(name, default=default_ms, above=0.0) * NS_PER_MS)

    sigma_mm = reader.number("bridged_sigma_mm", default=1e3 * standard.bridged_sigma_m, above=0.0)
    limits = StateLimits(
        tracked_ns=duration("tracked_ms", standard.tracked_ns),
        bridged_motion_ns=duration("bridged_motion_ms", standard.bridged_motion_ns),
        bridged_sigma_m=1e-3 * sigma_mm,
        lost_after_ns=duration("lost_after_ms", standard.lost_after_ns),
        horizon_ns=duration("horizon_ms", standard.horizon_ns),
    )
    reader.finish()
    return limits


def _cameras(reader: TableReader, *, robot: Path) -> Mapping[str, SiteCamera]:
    cameras: dict[str, SiteCamera] = {}
    model = load_robot(robot, visuals=False)
    for table in reader.tables("camera"):
        camera = _camera(table, robot=model)
        if camera.name in cameras:
            table.fail("name", f"camera {camera.name!r} appears twice")
        cameras[camera.name] = camera
    if not cameras:
        reader.fail("camera", "a site needs at least one [[camera]]")
    return MappingProxyType(cameras)


def _camera(reader: TableReader, *, robot: Robot) -> SiteCamera:
    name = reader.text("name")
    parent = reader.choice("parent", PARENTS)
    T_parent_cam: Pose[Frame, Cam]
    if reader.choice("mount", ("urdf", "pose"), default="urdf") == "urdf":
        T_parent_cam = rigid_pose(robot, parent=parent, child=name)
    else:
        T_parent_cam = reader.pose()
    camera = SiteCamera(
        name=name,
        intrinsics=reader.guarded(_intrinsics),
        parent=parent,
        T_parent_cam=T_parent_cam,
        rate_hz=reader.number("rate_hz", above=0.0),
    )
    reader.finish()
    return camera


def _intrinsics(reader: TableReader) -> PinholeCamera:
    k1, k2, p1, p2, k3 = reader.numbers("distortion", 5, default=(0.0,) * 5)
    return PinholeCamera(
        width=reader.whole("width", least=1),
        height=reader.whole("height", least=1),
        fx=reader.number("fx"),
        fy=reader.number("fy"),
        cx=reader.number("cx"),
        cy=reader.number("cy"),
        distortion=(k1, k2, p1, p2, k3),
    )


def _objects(
    reader: TableReader, *, cameras: Mapping[str, SiteCamera], objects_dir: Path
) -> tuple[SiteObject, ...]:
    folders = tuple(p.parent.name for p in objects_dir.glob("*/object.toml"))
    entries: dict[str, SiteObject] = {}
    for table in reader.tables("object"):
        entry = SiteObject(
            slug=table.choice("slug", folders),
            camera=table.choice("camera", tuple(cameras)),
            hierarchy=table.choice("hierarchy", HIERARCHIES),
            motion=table.choice("motion", MOTIONS, default="static"),
        )
        table.finish()
        if entry.slug in entries:
            table.fail("slug", f"object {entry.slug!r} appears twice")
        entries[entry.slug] = entry
    if not entries:
        reader.fail("object", "a site needs at least one [[object]]")
    return tuple(entries.values())
