"""The MuJoCo model of a site: crane, platform, arm, objects, scenery.

    crane tip --2 hinges--> cable --ball--> platform --7 hinges--> arm --> hook
    ground, props, fixed objects: rigid to the world; free objects: 6 degrees of freedom each

Two ball-like joints and rigid rods are the double pendulum of a load on a taut cable; its modes
lie near 0.16 and 1.2 Hz. Bodies are named `robot/<link>` and `object/<slug>`.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from scene.entry import ObjectEntry
from scene.kinematics import RobotJoint
from scene.robot import Inertial, Robot
from sim.paint import Paints, unprinted
from sim.scenery import add_scenery, add_shades
from sim.solids import add_solids, pieces_of
from sim.world import Crane, Placement, TrueCamera, TrueMarker, World
from spatial.errors import InputError, unknown
from spatial.frames import Object, Tag
from spatial.marker import Marker
from spatial.pose import Pose

TIMESTEP_S = 0.001
"""Physics step [s]."""
TOOL_FRAME = "tcp"
"""Link the impedance controller moves."""
PRINT_LIFT_M = 5e-5
"""A print lies this far above the surface it sticks to, so that depth can tell them apart [m]."""

_MASSLESS = Inertial(1.0, 0.01 * np.eye(3), Pose.identity())
_DEFAULT_OBJECT_KG = 2.0
_ARMATURE = (0.5, 0.1)
_PLATFORM_RADII_M = (0.30, 0.30, 0.42)


@dataclass(frozen=True, slots=True, eq=False)
class SiteModel:
    """A compiled model and the places of things in it."""

    model: mujoco.MjModel
    """The model; constant."""
    arm_joints: tuple[RobotJoint, ...]
    """Joints of the arm, base first."""
    arm_qpos: np.ndarray
    """Their places in qpos (n,)."""
    arm_dof: np.ndarray
    """Their places in qvel (n,)."""
    platform: int
    """Body of the platform: the robot's root."""
    base: int
    """Body of the arm's base."""
    tool: int
    """Body of the tool centre point."""
    tool_bodies: tuple[int, ...]
    """Bodies rigid to the tool, whose contacts are its wrench."""
    frames: Mapping[str, int]
    """Bodies of the frames truth speaks of: platform, base, tcp, object/<slug>."""
    camera_sites: Mapping[str, int]
    """Sites at the true optical frames."""
    Ts_object_marker: Mapping[tuple[str, int], Pose[Object, Tag]]
    """Where each print truly is on its object, by family and id."""


def build(
    robot: Robot,
    *,
    entries: Mapping[str, ObjectEntry],
    world: World,
    cameras: Mapping[str, TrueCamera],
    markers: Iterable[TrueMarker] = (),
) -> SiteModel:
    """Compile the model of a site.

    Args:
        robot: kinematics, masses and looks.
        entries: the object database.
        world: what stands where.
        cameras: true cameras by name.
        markers: true marker mounts; a marker not named sits where the database says.

    Raises:
        InputError: a placed object the database does not have, or links the robot lacks.
    """
    _check(robot, entries, world, cameras)
    spec = _empty_spec(world)
    paints = Paints(spec)
    platform = _add_crane(spec, world.crane)
    bodies = _add_robot(paints, robot, platform, world.crane)
    for name, camera in cameras.items():
        bodies[camera.parent].add_site(name=name, **_at(camera.T_parent_cam), rgba=[0, 0, 0, 0])
    prints: dict[tuple[str, int], Pose[Object, Tag]] = {}
    given = {(m.slug, m.key): m.T_object_marker for m in markers}
    for placement in world.placements:
        body = _add_object(spec, paints, entries[placement.slug], placement)
        for marker in entries[placement.slug].markers:
            true = given.get((placement.slug, marker.key), marker.T_object_marker)
            prints[marker.key] = _add_print(body, paints, marker, true)
    add_shades(spec, world)
    add_scenery(spec, world)  # last: what stands in front is drawn first and hides it cheaply
    return _located(spec.compile(), robot, world, cameras, prints)


def _check(
    robot: Robot,
    entries: Mapping[str, ObjectEntry],
    world: World,
    cameras: Mapping[str, TrueCamera],
) -> None:
    for placement in world.placements:
        if placement.slug not in entries:
            raise InputError(unknown("object", placement.slug, entries))
    for link in ("base", TOOL_FRAME, *(camera.parent for camera in cameras.values())):
        if link not in robot.links:
            raise InputError(unknown("link", link, robot.links))


def _empty_spec(world: World) -> mujoco.MjSpec:
    spec = mujoco.MjSpec()
    spec.modelname = world.name
    spec.compiler.degree = False
    option = spec.option
    option.timestep = TIMESTEP_S
    option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE  # 4.0.0: sparse Cholesky is wrong for Newton
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.default.geom.solref[0] = 0.01
    spec.default.geom.friction[0] = 0.6
    spec.default.geom.contype = 0
    spec.default.geom.conaffinity = 0
    return spec


def _add_crane(spec: mujoco.MjSpec, crane: Crane) -> mujoco.MjsBody:
    """Add cable and rigging; return the platform's body, hanging at rest."""
    rope = spec.worldbody.add_body(name="crane/rope", pos=[0.0, 0.0, crane.tip_m])
    for axis in ("x", "y"):
        direction = [float(axis == "x"), float(axis == "y"), 0.0]
        rope.add_joint(name=f"crane/{axis}", axis=direction, damping=1.0)
    low = [0.0, 0.0, -crane.cable_m]
    rope.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        fromto=[0.0, 0.0, 0.0, *low],
        size=[0.012, 0.0, 0.0],
        mass=1.5,
        rgba=[0.16, 0.16, 0.17, 1.0],
    )
    rope.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CYLINDER,
        pos=low,
        size=[0.05, 0.09, 0.0],
        mass=crane.hook_kg,
        rgba=[0.86, 0.62, 0.10, 1.0],
    )
    platform = rope.add_body(name="platform", pos=[0.0, 0.0, -crane.cable_m - crane.rigging_m])
    platform.add_joint(
        name="rigging", type=mujoco.mjtJoint.mjJNT_BALL, pos=[0, 0, crane.rigging_m], damping=1.0
    )
    return platform


def _add_robot(
    paints: Paints,
    robot: Robot,
    platform: mujoco.MjsBody,
    crane: Crane,
) -> dict[str, mujoco.MjsBody]:
    platform.name = f"robot/{robot.root}"
    _weigh(platform, robot.inertials.get(robot.root) or _plain_platform(crane))
    bodies = {robot.root: platform}
    pending = list(robot.joints)
    moving = [joint.name for joint in _arm(robot)]
    armatures = dict(zip(moving, np.linspace(*_ARMATURE, len(moving)), strict=True))
    while pending:
        joint = next(j for j in pending if j.parent in bodies)
        pending.remove(joint)
        bodies[joint.child] = _add_link(bodies[joint.parent], joint, robot, armatures)
    for index, visual in enumerate(robot.visuals):
        name = f"look/{visual.link}/{index}"
        paints.add_look(
            bodies[visual.link], name, visual.mesh, pose=visual.T_link_visual, opacity=1.0
        )
    tool = _rigid_to(robot, TOOL_FRAME)
    for solid in robot.collisions:
        if solid.link in tool:
            add_solids(bodies[solid.link], (solid,))
    return bodies


def _plain_platform(crane: Crane) -> Inertial:
    """Return the platform of a robot whose description does not weigh it."""
    inertia = crane.platform_kg * np.array(_PLATFORM_RADII_M) ** 2
    return Inertial(crane.platform_kg, np.diag(inertia), Pose.identity())


def _add_link(
    parent: mujoco.MjsBody, joint: RobotJoint, robot: Robot, armatures: Mapping[str, float]
) -> mujoco.MjsBody:
    body = parent.add_body(name=f"robot/{joint.child}", **_at(joint.T_parent_joint))
    inertial = robot.inertials.get(joint.child)
    if joint.name in armatures:
        slides = joint.type == "prismatic"
        limited = joint.lower is not None and joint.upper is not None
        body.add_joint(
            name=joint.name,
            type=mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE,
            axis=joint.axis,
            limited=limited,
            range=[joint.lower, joint.upper] if limited else [0.0, 0.0],
            armature=float(armatures[joint.name]),
            damping=0.5,
        )
        inertial = inertial or _MASSLESS
    if inertial is not None:
        _weigh(body, inertial)
    return body


def _add_object(
    spec: mujoco.MjSpec, paints: Paints, entry: ObjectEntry, placement: Placement
) -> mujoco.MjsBody:
    body = spec.worldbody.add_body(name=f"object/{entry.slug}", **_at(placement.T_w_object))
    look = unprinted(entry.mesh)
    pose: Pose[Object, Object] = Pose.identity()
    paints.add_look(body, f"look/object/{entry.slug}", look, pose=pose, opacity=entry.opacity)
    if placement.free:
        body.add_freejoint(name=f"free/{entry.slug}")
        _weigh(body, _box_inertial(entry))
    add_solids(body, pieces_of(spec, entry.slug, look))
    return body


def _box_inertial(entry: ObjectEntry) -> Inertial:
    """Return the mass of an object, spread over its bounding box."""
    mass = _DEFAULT_OBJECT_KG if entry.mass_kg is None else entry.mass_kg
    low, high = entry.mesh.vertices.min(axis=0), entry.mesh.vertices.max(axis=0)
    squares = (high - low) ** 2
    inertia = np.diag(mass / 12.0 * (squares.sum() - squares))
    return Inertial(mass, inertia, Pose.translated(*((low + high) / 2.0)))


def _add_print(
    body: mujoco.MjsBody, paints: Paints, marker: Marker, true: Pose[Object, Tag]
) -> Pose[Object, Tag]:
    """Stick a marker on; return where it is, which is never inside the object."""
    nominal = marker.T_object_marker
    depth = nominal.inverse().apply(true.apply(1.3 * marker.corners_tag))[:, 2].min()
    lift = max(0.0, PRINT_LIFT_M - float(depth))
    at: Pose[Object, Tag] = Pose.of(true.rotation, true.translation + lift * nominal.rotation[:, 2])
    paints.add_print(body, marker, pose=at)
    return at


def _weigh(body: mujoco.MjsBody, inertial: Inertial) -> None:
    body.explicitinertial = True
    body.mass = inertial.mass_kg
    body.ipos = inertial.T_link_com.translation
    body.iquat = inertial.T_link_com.quaternion_wxyz
    full = inertial.inertia
    body.fullinertia = [full[0, 0], full[1, 1], full[2, 2], full[0, 1], full[0, 2], full[1, 2]]


def _at(pose: Pose[Any, Any]) -> dict[str, np.ndarray]:
    return {"pos": pose.translation, "quat": pose.quaternion_wxyz}


def _arm(robot: Robot) -> list[RobotJoint]:
    """Return the driven joints between the root and the tool, root first."""
    by_child = {joint.child: joint for joint in robot.joints}
    chain, link = [], TOOL_FRAME
    while link in by_child:
        joint = by_child[link]
        link = joint.parent
        if joint.moves and joint.mimic is None:
            chain.append(joint)
    return chain[::-1]


def _rigid_to(robot: Robot, link: str) -> set[str]:
    """Return the links that no joint moves against a link."""
    fixed = [(j.parent, j.child) for j in robot.joints if not j.moves]
    found = {link}
    while True:
        more = {b for pair in fixed if found & set(pair) for b in pair} - found
        if not more:
            return found
        found |= more


def _located(
    model: mujoco.MjModel,
    robot: Robot,
    world: World,
    cameras: Mapping[str, TrueCamera],
    prints: Mapping[tuple[str, int], Pose[Object, Tag]],
) -> SiteModel:
    def body(name: str) -> int:
        return int(model.body(name).id)

    arm = tuple(_arm(robot))
    frames = {name: body(f"robot/{name}") for name in ("base", TOOL_FRAME)}
    frames["platform"] = body(f"robot/{robot.root}")
    frames |= {f"object/{p.slug}": body(f"object/{p.slug}") for p in world.placements}
    return SiteModel(
        model=model,
        arm_joints=arm,
        arm_qpos=np.array([model.joint(j.name).qposadr[0] for j in arm]),
        arm_dof=np.array([model.joint(j.name).dofadr[0] for j in arm]),
        platform=frames["platform"],
        base=frames["base"],
        tool=frames[TOOL_FRAME],
        tool_bodies=tuple(body(f"robot/{link}") for link in sorted(_rigid_to(robot, TOOL_FRAME))),
        frames=frames,
        camera_sites={name: int(model.site(name).id) for name in cameras},
        Ts_object_marker=dict(prints),
    )
