"""Robot descriptions (URDF): links, joints, looks and forward kinematics.

The only module that knows yourdfpy. Before it parses, `scene.urdf_tree` has checked the file;
meshes are read by `scene.mesh`, never from outside the robot's package folder.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yourdfpy

from scene.kinematics import Kinematics, Mimic, RobotJoint
from scene.mesh import MeshData, box_mesh, cylinder_mesh, load_mesh, sphere_mesh
from scene.packages import find_mesh
from scene.urdf_tree import MOVING, Element, read_tree, root_link
from spatial.errors import FileInputError
from spatial.frames import Base, Frame
from spatial.pose import Pose
from spatial.rotation import Array

Color = tuple[int, int, int, int]


@dataclass(frozen=True, slots=True, eq=False)
class Visual:
    """One thing to draw on a link."""

    link: str
    """Link it is fixed to."""
    mesh: MeshData
    """What to draw, in its own frame, already scaled and coloured."""
    color: Color | None
    """RGBA of the description's material, 0 to 255; `None` where the mesh has its own colours."""
    T_link_visual: Pose[Frame, Frame]
    """Pose of the mesh in the link."""


@dataclass(frozen=True, slots=True, eq=False)
class Collision:
    """A primitive solid of a link."""

    link: str
    """Link it is fixed to."""
    kind: str
    """`box`, `cylinder` (along z) or `sphere`."""
    size_m: Array
    """Edges (3,) of a box, radius and length (2,) of a cylinder, radius (1,) of a sphere [m]."""
    T_link_collision: Pose[Frame, Frame]
    """Pose of the solid's centre in the link."""


@dataclass(frozen=True, slots=True, eq=False)
class Inertial:
    """Mass of a link."""

    mass_kg: float
    """Mass [kg]."""
    inertia: Array
    """Inertia tensor (3, 3) about the centre of mass, in its axes [kg m^2]."""
    T_link_com: Pose[Frame, Frame]
    """Pose of the centre of mass and the tensor's axes in the link."""


@dataclass(frozen=True, slots=True, eq=False)
class Robot:
    """A robot: constant, shared by everyone."""

    name: str
    """Name in the description."""
    path: Path
    """The description."""
    root: str
    """Link everything hangs on; poses are given in it."""
    links: tuple[str, ...]
    """Names of the links, in the order of the file."""
    joints: tuple[RobotJoint, ...]
    """Joints, in the order of the file."""
    visuals: tuple[Visual, ...]
    """What to draw."""
    collisions: tuple[Collision, ...]
    """Primitive solids; meshes are not among them."""
    inertials: Mapping[str, Inertial]
    """Mass of the links that have one."""
    warnings: tuple[str, ...]
    """What was passed over: missing meshes, axes of odd length, joints that cannot move."""
    kinematics: Kinematics
    """Precomputed tree."""

    def fk(self, positions: Mapping[str, float]) -> dict[str, Pose[Base, Frame]]:
        """Return the pose of every link in the root link (see `Kinematics.fk`)."""
        return self.kinematics.fk(positions)


def load_robot(
    urdf: Path, *, packages: Mapping[str, Path] | None = None, visuals: bool = True
) -> Robot:
    """Return the robot of a description.

    Args:
        urdf: the file.
        packages: folders of `package://` names; others are looked up in the folders above.
        visuals: whether to read meshes.

    Raises:
        FileInputError: a description that is not one tree of valid links and joints, or a mesh
            outside the robot's package folder.
    """
    try:
        data = urdf.read_bytes()
    except OSError as error:
        raise FileInputError(f"cannot be read: {error.strerror or error}", path=urdf) from error
    tree = read_tree(data, path=urdf)
    model = _parse(tree, path=urdf)
    warnings: list[str] = []
    joints = tuple(_joint(joint, warnings) for joint in model.joints)
    root = root_link(tree)
    drawn = _visuals(model, tree, urdf, packages or {}, warnings) if visuals else ()
    return Robot(
        name=model.name or urdf.stem,
        path=urdf,
        root=root,
        links=tuple(link.name for link in model.links),
        joints=joints,
        visuals=drawn,
        collisions=tuple(_collisions(model)),
        inertials={
            link.name: _inertial(link.inertial)
            for link in model.links
            if link.inertial is not None and link.inertial.mass is not None
        },
        warnings=tuple(warnings),
        kinematics=Kinematics(root, joints),
    )


def _parse(tree: Element, *, path: Path) -> Any:
    try:
        urdf = yourdfpy.URDF.load(
            io.BytesIO(tree.xml().encode()),
            build_scene_graph=False,
            load_meshes=False,
        )
    except Exception as error:
        reason = f"{type(error).__name__}: {error}"[:200]
        raise FileInputError(f"is not a robot description: {reason}", path=path) from error
    return urdf.robot


def _joint(joint: Any, warnings: list[str]) -> RobotJoint:
    norm = float(np.linalg.norm(joint.axis))
    moves = joint.type in MOVING
    if moves and abs(norm - 1.0) > 1e-3:
        warnings.append(f"joint {joint.name!r} has an axis of length {norm:g}; made 1")
    if joint.type in {"floating", "planar"}:
        warnings.append(f"joint {joint.name!r} is {joint.type}; it is drawn at zero")
    limit = joint.limit
    bounded = joint.type in {"revolute", "prismatic"} and limit is not None
    if joint.type in {"revolute", "prismatic"} and limit is None:
        warnings.append(f"joint {joint.name!r} is {joint.type} and has no limit")
    mimic = joint.mimic
    return RobotJoint(
        name=joint.name,
        type=joint.type,
        parent=joint.parent,
        child=joint.child,
        lower=float(limit.lower or 0.0) if bounded else None,
        upper=float(limit.upper or 0.0) if bounded else None,
        velocity=None if limit is None else limit.velocity,
        effort=None if limit is None else limit.effort,
        mimic=None
        if mimic is None
        else Mimic(
            mimic.joint,
            1.0 if mimic.multiplier is None else mimic.multiplier,
            0.0 if mimic.offset is None else mimic.offset,
        ),
        axis=joint.axis / norm if norm else joint.axis,
        T_parent_joint=_pose(joint.origin),
    )


def _pose(matrix: Array | None) -> Pose[Frame, Frame]:
    return Pose.identity() if matrix is None else Pose.parse_matrix(matrix)


def _inertial(given: Any) -> Inertial:
    inertia = np.zeros((3, 3)) if given.inertia is None else np.asarray(given.inertia)
    return Inertial(float(given.mass), inertia, _pose(given.origin))


def _collisions(model: Any) -> list[Collision]:
    solids = []
    for link in model.links:
        for given in link.collisions:
            shape = given.geometry
            pose = _pose(given.origin)
            if shape.box is not None:
                solids.append(Collision(link.name, "box", np.asarray(shape.box.size), pose))
            elif shape.cylinder is not None:
                size = np.array([shape.cylinder.radius, shape.cylinder.length])
                solids.append(Collision(link.name, "cylinder", size, pose))
            elif shape.sphere is not None:
                size = np.array([shape.sphere.radius])
                solids.append(Collision(link.name, "sphere", size, pose))
    return solids


def _visuals(
    model: Any, tree: Element, urdf: Path, packages: Mapping[str, Path], warnings: list[str]
) -> tuple[Visual, ...]:
    palette = {material.name: material.color for material in model.materials}
    drawn = []
    for link, element in zip(model.links, tree.all("link"), strict=True):
        for given, at in zip(link.visuals, element.all("visual"), strict=True):
            mesh = _shape(given.geometry, urdf, packages, line=at.line)
            if isinstance(mesh, str):
                warnings.append(f"link {link.name!r}: {mesh}")
                continue
            color = _color(given.material, palette)
            if color is not None:
                mesh = mesh.coloured(color)
            drawn.append(Visual(link.name, mesh, color, _pose(given.origin)))
    return tuple(drawn)


def _shape(shape: Any, urdf: Path, packages: Mapping[str, Path], *, line: int) -> MeshData | str:
    """Return the mesh of a visual, or why there is none."""
    if shape.box is not None:
        return box_mesh(np.asarray(shape.box.size))
    if shape.cylinder is not None:
        return cylinder_mesh(shape.cylinder.radius, shape.cylinder.length)
    if shape.sphere is not None:
        return sphere_mesh(shape.sphere.radius)
    found = find_mesh(shape.mesh.filename, urdf=urdf, packages=packages, line=line)
    if isinstance(found, str):
        return found
    try:
        mesh = load_mesh(found)
    except FileInputError as error:
        return f"its mesh {error}"
    return mesh if shape.mesh.scale is None else mesh.scaled(np.asarray(shape.mesh.scale))


def _color(material: Any, palette: Mapping[str, Any]) -> Color | None:
    if material is None:
        return None
    given = material.color if material.color is not None else palette.get(material.name)
    if given is None:
        return None
    r, g, b, a = (int(v) for v in np.clip(np.rint(np.asarray(given.rgba) * 255), 0, 255))
    return r, g, b, a
