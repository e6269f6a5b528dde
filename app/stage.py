"""The stage: the only writer of the scene. It turns each SceneState into node moves.

    /site                       display root: base, turned so that up is up
      /robot/<link>/body        every link
      /objects/<slug>           pose at T*
        /tracked /bridged /stale /lost     one of them shown: the state
        /walls/<fixture>        translucent surface and edges
      /raw/<slug>/outline       newest measured pose, neither bridged nor compensated
      /cameras/<name>/frustum   cameras
      /tool/axes                tool centre point
      /ground/grid              level with the lowest object, still in the odometry's world
    /heartbeat                  x: tick, y: T* in ms modulo 10^6: what the page's watchdog watches

Nothing is decided here: what is shown follows from the state alone. Nodes that did not move are
not sent again, and no more than 60 states a second are.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from app.looks import ObjectLook, StageLook
from app.viser_port import ScenePort
from app.walls import EDGE_COLORS
from scene.graph import ObjectNode, SceneState
from spatial.camera import PinholeCamera
from spatial.frames import Base
from spatial.pose import Pose
from spatial.rotation import Array
from spatial.tracked import TrackState

MAX_HZ = 60.0
UNMOVED = 1e-6
"""Largest change of a matrix entry that is not sent ([m] or of a unit vector)."""
RAW_SHOWN_M, RAW_HIDDEN_M = 0.003, 0.002
"""The raw outline appears beside a body from the first distance on, until the second [m]."""
WORLD_JUMP_M = 0.5
"""The odometry's world started anew when it moves further than this in a tick [m]."""
FRUSTUM_DEPTH_M = 0.16
AXIS_M = 0.07
HEARTBEAT_MS = 1_000_000
STATE_NODES = {state: state.value for state in TrackState}
AXIS_COLORS = ((206, 104, 104), (110, 178, 122), (104, 146, 214))
FRUSTUM_COLOR = (112, 128, 144)
RAW_COLOR = (150, 196, 232)
LOST_COLOR = (226, 96, 96)
BRIDGED_EDGE_COLOR = (240, 190, 104)


class Stage:
    """Builds the nodes once, then shows states."""

    def __init__(
        self, port: ScenePort, look: StageLook, *, seconds: Callable[[], float] = time.monotonic
    ) -> None:
        """Make every node, hidden until something is known of it.

        Args:
            port: where to write.
            look: what to draw.
            seconds: monotonic time for the pace.
        """
        self._port = port
        self._look = look
        self._seconds = seconds
        self._next_s = -np.inf
        self._sent: dict[str, Array] = {}
        self._shown: dict[str, bool] = {}
        self._ground = _Ground({o.slug: o.corners for o in look.objects})
        self.refused_poses = 0
        """Poses that were not finite or not rigid; their nodes kept what they showed."""
        self._build()

    def show(self, state: SceneState) -> bool:
        """Draw a state; return False when it came sooner than the pace allows."""
        now = self._seconds()
        if now < self._next_s:
            return False
        self._next_s = max(self._next_s + 1.0 / MAX_HZ, now - 1.0 / MAX_HZ)
        poses: dict[str, Pose[Any, Any]] = {"/site": _display(state)}
        shown: dict[str, bool] = {}
        self._place_robot(state, poses, shown)
        for node in state.objects:
            self._place_object(node, poses, shown)
        T_base_ground = self._ground.update(state)
        shown["/site/ground"] = T_base_ground is not None
        if T_base_ground is not None:
            poses["/site/ground"] = T_base_ground
        instant_ms = (state.instant_ns // 1000 % (HEARTBEAT_MS * 1000)) / 1000.0
        # Last of all, so that it never runs ahead of the poses it stands for.
        poses["/heartbeat"] = Pose.translated(float(state.tick % HEARTBEAT_MS), instant_ms, 0.0)
        self._write(poses, shown)
        self._port.flush()
        return True

    def _write(self, poses: dict[str, Pose[Any, Any]], shown: dict[str, bool]) -> None:
        moved = {n: p for n, p in poses.items() if n in self._shown and self._moved(n, p)}
        changed = {n: s for n, s in shown.items() if self._shown.get(n, s) != s}
        self.refused_poses += self._port.update(moved, changed)
        self._sent.update({n: p.matrix for n, p in moved.items() if p.is_finite()})
        self._shown.update(changed)

    def _moved(self, name: str, pose: Pose[Any, Any]) -> bool:
        sent = self._sent.get(name)
        # Written so that a NaN counts as moved: the port refuses and counts it.
        return sent is None or not bool(np.abs(pose.matrix - sent).max() <= UNMOVED)

    def _place_robot(
        self, state: SceneState, poses: dict[str, Pose[Any, Any]], shown: dict[str, bool]
    ) -> None:
        known = state.robot_ms is not None
        for link, T_base_link in state.Ts_base_link.items():
            poses[f"/site/robot/{link}"] = T_base_link
        for camera, T_base_cam in state.Ts_base_cam.items():
            poses[f"/site/cameras/{camera}"] = T_base_cam
        poses["/site/tool"] = state.T_base_tcp
        for name in ("/site/robot", "/site/cameras", "/site/tool"):
            shown[name] = known

    def _place_object(
        self, node: ObjectNode, poses: dict[str, Pose[Any, Any]], shown: dict[str, bool]
    ) -> None:
        name, raw = f"/site/objects/{node.slug}", f"/site/raw/{node.slug}"
        shown[name] = node.T_base_object is not None
        if node.T_base_object is not None:
            poses[name] = node.T_base_object
        for state, child in STATE_NODES.items():
            shown[f"{name}/{child}"] = state is node.state
        shown[raw] = _raw_differs(node, shown=self._shown.get(raw, False))
        if node.T_base_object_raw is not None:
            poses[raw] = node.T_base_object_raw

    def _build(self) -> None:
        self._group("/site")
        for parent in ("robot", "objects", "raw", "cameras", "tool", "ground"):
            self._group(f"/site/{parent}")
        self._group("/heartbeat")
        for link in self._look.links:
            self._group(f"/site/robot/{link.link}")
            self._port.add_glb(f"/site/robot/{link.link}/body", link.glb)
        for name, camera in self._look.cameras.items():
            self._group(f"/site/cameras/{name}")
            self._port.add_lines(
                f"/site/cameras/{name}/frustum",
                frustum(camera, depth_m=FRUSTUM_DEPTH_M),
                color=FRUSTUM_COLOR,
                width_px=1.25,
            )
        for axis, color in enumerate(AXIS_COLORS):
            tip = np.eye(3)[axis] * AXIS_M
            self._port.add_lines(
                f"/site/tool/axis_{'xyz'[axis]}",
                np.array([[np.zeros(3), tip]]),
                color=color,
                width_px=2.0,
            )
        self._port.add_grid("/site/ground/grid", size_m=24.0)
        for look in self._look.objects:
            self._build_object(look)
        self._port.update({}, {name: False for name, shown in self._shown.items() if not shown})

    def _build_object(self, look: ObjectLook) -> None:
        name = f"/site/objects/{look.slug}"
        self._group(name, shown=False)
        for child in ("tracked", "bridged", "stale", "lost"):
            self._group(f"{name}/{child}", shown=False)
        self._port.add_glb(f"{name}/tracked/body", look.solid)
        self._port.add_glb(f"{name}/bridged/body", look.bridged)
        self._port.add_glb(f"{name}/stale/body", look.stale)
        if len(look.outline):
            self._port.add_lines(
                f"{name}/bridged/edges", look.outline, color=BRIDGED_EDGE_COLOR, width_px=1.25
            )
            self._port.add_lines(f"{name}/lost/edges", look.outline, color=LOST_COLOR, width_px=1.5)
        self._group(f"{name}/walls")
        for wall in look.walls:
            self._port.add_glb(f"{name}/walls/{wall.name}", wall.glb)
            self._port.add_lines(
                f"{name}/walls/{wall.name}/edges",
                wall.edges,
                color=EDGE_COLORS[wall.role],
                width_px=1.25,
            )
        self._group(f"/site/raw/{look.slug}", shown=False)
        if len(look.outline):
            self._port.add_lines(
                f"/site/raw/{look.slug}/outline", look.outline, color=RAW_COLOR, width_px=1.0
            )

    def _group(self, name: str, *, shown: bool = True) -> None:
        self._port.add_group(name)
        self._shown[name] = shown


class _Ground:
    """Level of the lowest object seen, in the odometry's world: the ground, as far as known."""

    def __init__(self, corners: dict[str, Array]) -> None:
        self._corners = corners
        self._level_m = np.inf
        self._centre: tuple[float, float] = (0.0, 0.0)
        self._T_base_w: Pose[Any, Any] | None = None

    def update(self, state: SceneState) -> Pose[Any, Any] | None:
        """Return the pose of the ground in base, `None` while nothing is known of it."""
        T_base_w = state.T_base_w
        if T_base_w is None or not T_base_w.is_finite():
            return None
        previous, self._T_base_w = self._T_base_w, T_base_w
        if previous is not None and previous.distance_to(T_base_w)[0] > WORLD_JUMP_M:
            self._level_m = np.inf
        T_w_base = T_base_w.inverse()
        for node in state.objects:
            if node.state is TrackState.TRACKED and node.T_base_object is not None:
                corners = self._corners.get(node.slug)
                if corners is not None and node.T_base_object.is_finite():
                    points_w = (T_w_base @ node.T_base_object).apply(corners)
                    self._lower_to(float(points_w[:, 2].min()), T_w_base)
        if not np.isfinite(self._level_m):
            return None
        return T_base_w @ Pose.translated(*self._centre, self._level_m)

    def _lower_to(self, level_m: float, T_w_base: Pose[Any, Base]) -> None:
        if level_m < self._level_m - 0.02:  # not with the noise of every fix
            self._level_m = level_m
            x, y, _ = T_w_base.translation
            self._centre = (float(x), float(y))


def _display(state: SceneState) -> Pose[Any, Any]:
    """Base with the platform's up as up: an arm that hangs is seen hanging."""
    return Pose.of(state.T_base_platform.rotation.T, np.zeros(3))


def _raw_differs(node: ObjectNode, *, shown: bool) -> bool:
    if node.T_base_object_raw is None or node.T_base_object is None:
        return False
    if node.state not in (TrackState.TRACKED, TrackState.BRIDGED):
        return False
    distance = np.linalg.norm(node.T_base_object_raw.translation - node.T_base_object.translation)
    return bool(distance > (RAW_HIDDEN_M if shown else RAW_SHOWN_M))


def frustum(camera: PinholeCamera, *, depth_m: float) -> Array:
    """Return segments (8, 2, 3) of a camera's pyramid, in its optical frame [m]."""
    w, h = camera.width - 0.5, camera.height - 0.5
    pixels = np.array([(-0.5, -0.5), (w, -0.5), (w, h), (-0.5, h)])
    rays = camera.undistorted().normalise(pixels)
    corners = np.column_stack((rays, np.ones(4))) * depth_m
    rim = np.stack((corners, np.roll(corners, -1, axis=0)), axis=1)
    spokes = np.stack((np.zeros_like(corners), corners), axis=1)
    return np.concatenate((rim, spokes))
