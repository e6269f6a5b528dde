"""From what streams say to one immutable scene at one instant T*.

    t = T* clamped to the stamp of the message and a horizon behind it
    T_base_object(t) = T_base_cam(t) @ exp(-(t - stamp) xi_w_cam_cam) @ T_cam_object(stamp)
    T_base_w(t) = T_base_hc(t) @ (T_w_hc(stamp) @ exp((t - stamp) xi_w_hc_hc))^-1

While streams flow t is T*; when one stops, its objects stay where they were at t instead of
riding on a moving camera, and turn STALE, then LOST, by T* alone. A held object has no twist of
its own in the tool: its pose in the tcp is kept, and Eq. 1 gives the rest.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from scene.arm import ArmHistory, Links
from scene.database import Database
from scene.graph import ObjectNode, SceneState
from scene.robot import Robot
from scene.routes import camera_in_base, carried
from scene.site import HIERARCHIES, Site, SiteObject
from spatial.errors import InputError, unknown
from spatial.frames import Base, Cam, Object, Tcp, W
from spatial.pose import ROTATION_TOLERANCE, Pose
from spatial.rotation import Array
from spatial.samples import JointSample, MotionSample
from spatial.stamp import NS_PER_MS, NS_PER_S, seconds
from spatial.tracked import TrackedObject, TrackedObjects, TrackReport, TrackState

FARTHEST_M = 1000.0
"""A pose farther away than this is not a pose [m]."""
FUTURE_NS = NS_PER_S
"""A sample this far ahead of T* belongs to another time: replay went back [ns]."""
_SHOWN = (TrackState.TRACKED, TrackState.BRIDGED)


@dataclass(frozen=True, slots=True)
class Refused:
    """What the gate stopped since the start."""

    joints: int = 0
    """Joint samples."""
    motion: int = 0
    """Motion samples."""
    objects: int = 0
    """Poses of objects in tracked messages."""
    reports: int = 0
    """Raw poses in reports."""


@dataclass(slots=True, eq=False)
class _Track:
    """Working state of one object."""

    site: SiteObject
    """Its entry in the site file."""
    hierarchy: str
    """How it is grouped now."""
    said: TrackedObject | None = None
    """Newest usable word of the tracker."""
    said_ns: int = 0
    """Instant of that word [ns]."""
    broken_ns: int | None = None
    """Since when the pose is not to be trusted [ns]."""
    T_base_object: Pose[Base, Object] | None = None
    """Last pose shown."""
    T_tcp_object: Pose[Tcp, Object] | None = None
    """The same in the tool, kept for a held object."""
    T_base_object_raw: Pose[Base, Object] | None = None
    """Newest measured pose."""
    raw_ns: int = 0
    """Capture stamp of that [ns]."""
    covariance_base: Array = field(default_factory=lambda: np.zeros((3, 3)))
    """Covariance (3, 3) of the last pose shown [m^2]."""


class SceneBuilder:
    """Collects samples of all streams; `build` evaluates them. For one thread."""

    def __init__(self, site: Site, robot: Robot, database: Database) -> None:
        """Start with every object LOST.

        Args:
            site: the site.
            robot: its robot, with links `base`, `tcp` and `platform`.
            database: objects; it must have every one of the site.

        Raises:
            InputError: an object or link that does not exist.
        """
        for link in ("base", "tcp", "platform"):
            if link not in robot.links:
                raise InputError(unknown("link", link, robot.links))
        self._site = site
        self._revisions = {e.slug: database.entry(e.slug).revision for e in site.objects}
        self._arm = ArmHistory(robot, horizon_ns=site.limits.horizon_ns)
        self._tracks = {e.slug: _Track(e, e.hierarchy) for e in site.objects}
        self._motion: MotionSample | None = None
        self._T_base_w: Pose[Base, W] | None = None
        self._tick = 0
        self.refused = Refused()

    def put_joints(self, sample: JointSample) -> None:
        """Take joint positions; unusable ones are counted and dropped."""
        if not self._arm.put(sample):
            self.refused = replace(self.refused, joints=self.refused.joints + 1)

    def put_motion(self, sample: MotionSample) -> None:
        """Take motion of the camera with odometry; unusable samples are counted and dropped."""
        if not (is_sound(sample.T_w_cam) and np.isfinite(sample.xi_w_cam_cam).all()):
            self.refused = replace(self.refused, motion=self.refused.motion + 1)
        elif self._motion is None or sample.stamp_ns > self._motion.stamp_ns:
            self._motion = sample

    def put_tracked(self, message: TrackedObjects) -> None:
        """Take a tracker's word on its objects; those of other sites are passed over."""
        for said in message.objects:
            track = self._tracks.get(said.slug)
            if track is None or said.camera not in self._site.cameras:
                continue
            if not _is_usable(said):
                self.refused = replace(self.refused, objects=self.refused.objects + 1)
            elif message.stamp_ns > track.said_ns:
                self._hear(track, said, message.stamp_ns)

    def _hear(self, track: _Track, said: TrackedObject, stamp_ns: int) -> None:
        if said.state in _SHOWN:
            track.broken_ns = None
        elif track.broken_ns is None:  # a silence before counts, or LOST would turn STALE again
            silent_ns = track.said_ns + self._site.limits.bridged_motion_ns
            track.broken_ns = min(stamp_ns, silent_ns) if track.said else stamp_ns
        track.said, track.said_ns = said, stamp_ns

    def put_report(self, report: TrackReport) -> None:
        """Take the measured pose of an image: where the raw ghost is, with the arm as it was."""
        track = self._tracks.get(report.slug)
        camera = report.camera
        if track is None or report.T_cam_object is None or camera not in self._site.cameras:
            return
        if not is_sound(report.T_cam_object):
            self.refused = replace(self.refused, reports=self.refused.reports + 1)
        elif report.stamp_ns > track.raw_ns and self._is_placed(camera):
            T_base_cam = self._camera(camera, self._arm.links(report.stamp_ns))
            track.T_base_object_raw = T_base_cam @ report.T_cam_object
            track.raw_ns = report.stamp_ns

    def regroup(self, slug: str, hierarchy: str) -> None:
        """Hang an object under the tool (`nested`) or the base (`flat`); it stays where it is.

        Raises:
            InputError: no such object or hierarchy.
        """
        if slug not in self._tracks:
            raise InputError(unknown("object", slug, self._tracks))
        if hierarchy not in HIERARCHIES:
            raise InputError(unknown("hierarchy", hierarchy, HIERARCHIES))
        self._tracks[slug].hierarchy = hierarchy

    def build(self, instant_ns: int) -> SceneState:
        """Return the scene at an instant T* [ns]."""
        self._forget_the_future(instant_ns)
        links = self._arm.links(instant_ns)
        T_base_tcp: Pose[Base, Tcp] = Pose(links["tcp"].matrix)
        self._place_world(instant_ns)
        self._tick += 1
        joints_ns = self._arm.newest_ns
        return SceneState(
            instant_ns=instant_ns,
            tick=self._tick,
            Ts_base_link=links,
            T_base_tcp=T_base_tcp,
            T_base_platform=Pose(links["platform"].matrix),
            T_base_w=self._T_base_w,
            Ts_base_cam={
                name: camera_in_base(camera, T_base_tcp=T_base_tcp)
                for name, camera in self._site.cameras.items()
            },
            objects=tuple(
                self._node(track, instant_ns, T_base_tcp) for track in self._tracks.values()
            ),
            robot_ms=None if joints_ns is None else (instant_ns - joints_ns) / NS_PER_MS,
        )

    def camera_at(self, name: str, stamp_ns: int) -> Pose[Base, Cam] | None:
        """Return where a camera was at an image's stamp, `None` before the first joint states.

        Raises:
            InputError: no such camera.
        """
        if name not in self._site.cameras:
            raise InputError(unknown("camera", name, self._site.cameras))
        if not self._is_placed(name):
            return None
        return self._camera(name, self._arm.links(stamp_ns))

    def _node(self, track: _Track, instant_ns: int, T_base_tcp: Pose[Base, Tcp]) -> ObjectNode:
        state, reason = self._state(track, instant_ns)
        if state in _SHOWN or track.T_base_object is None:
            self._place(track, instant_ns)
        elif track.T_tcp_object is not None:
            track.T_base_object = T_base_tcp @ track.T_tcp_object
        said = track.said
        return ObjectNode(
            slug=track.site.slug,
            revision=self._revisions[track.site.slug],
            state=state,
            hierarchy=track.hierarchy,
            T_base_object=track.T_base_object,
            T_base_object_raw=track.T_base_object_raw,
            covariance_base=track.covariance_base,
            seen_ms=_age_ms(instant_ns, 0 if said is None else said.seen_ns),
            predicted_ms=_age_ms(instant_ns, 0 if said is None else said.motion_ns),
            camera=track.site.camera if said is None else said.camera,
            reason=reason,
        )

    def _state(self, track: _Track, instant_ns: int) -> tuple[TrackState, str]:
        """Return the state at T*: the tracker's word, made worse by what T* alone shows."""
        said = track.said
        if said is None:
            return TrackState.LOST, "the tracker has not reported it"
        if said.state is TrackState.LOST:
            return said.state, said.reason
        broken_ns, reason = track.broken_ns, said.reason
        for what, newest_ns in self._sources(track, said):
            limit_ns = newest_ns + self._site.limits.bridged_motion_ns
            if instant_ns > limit_ns:
                silent_ms = (instant_ns - newest_ns) // NS_PER_MS
                reason = f"no {what} for {silent_ms} ms" if newest_ns else f"no {what} yet"
                broken_ns = limit_ns if broken_ns is None else min(broken_ns, limit_ns)
        if broken_ns is None:
            return said.state, reason
        lost = instant_ns - broken_ns > self._site.limits.lost_after_ns
        return (TrackState.LOST if lost else TrackState.STALE), reason

    def _sources(self, track: _Track, said: TrackedObject) -> tuple[tuple[str, int], ...]:
        """Return what an object's pose hangs on, with the newest stamp of each."""
        tracker = ("word from the tracker", track.said_ns)
        if self._site.cameras[said.camera].parent != "tcp":
            return (tracker,)
        return tracker, ("joint states", self._arm.newest_ns or 0)

    def _place(self, track: _Track, instant_ns: int) -> None:
        """Evaluate an object's pose at T*, or as near to it as the horizon allows."""
        said = track.said
        if said is None or said.T_cam_object is None or not self._is_placed(said.camera):
            return
        held = track.site.motion == "held"
        at_ns = track.said_ns if held else self._within(instant_ns, track.said_ns)
        links = self._arm.links(at_ns)
        dt_s = seconds(at_ns - track.said_ns)
        T_cam_object = carried(said.T_cam_object, xi_w_cam_cam=said.xi_w_cam_cam, dt_s=dt_s)
        T_base_object = self._camera(said.camera, links) @ T_cam_object
        if held:
            T_base_tcp_then: Pose[Base, Tcp] = Pose(links["tcp"].matrix)
            T_base_tcp_now: Pose[Base, Tcp] = Pose(self._arm.links(instant_ns)["tcp"].matrix)
            track.T_tcp_object = T_base_tcp_then.inverse() @ T_base_object
            T_base_object = T_base_tcp_now @ track.T_tcp_object
        rotation = T_base_object.rotation
        track.T_base_object = T_base_object
        track.covariance_base = rotation @ said.covariance[:3, :3] @ rotation.T

    def _place_world(self, instant_ns: int) -> None:
        sample = self._motion
        if sample is None or not self._is_placed(self._site.vio_camera):
            return
        at_ns = self._within(instant_ns, sample.stamp_ns)
        step: Pose[Cam, Cam] = Pose.exp(seconds(at_ns - sample.stamp_ns) * sample.xi_w_cam_cam)
        T_base_cam = self._camera(self._site.vio_camera, self._arm.links(at_ns))
        self._T_base_w = T_base_cam @ (sample.T_w_cam @ step).inverse()

    def _camera(self, name: str, links: Links) -> Pose[Base, Cam]:
        return camera_in_base(self._site.cameras[name], T_base_tcp=Pose(links["tcp"].matrix))

    def _is_placed(self, camera: str) -> bool:
        """Return whether it is known where a camera is: one on the arm needs joint states."""
        return self._arm.newest_ns is not None or self._site.cameras[camera].parent != "tcp"

    def _within(self, instant_ns: int, stamp_ns: int) -> int:
        horizon_ns = self._site.limits.horizon_ns
        return stamp_ns + max(-horizon_ns, min(horizon_ns, instant_ns - stamp_ns))

    def _forget_the_future(self, instant_ns: int) -> None:
        """Drop samples of another time: one bad stamp, or a replay that went back, blocks none."""
        limit_ns = instant_ns + FUTURE_NS
        if (self._arm.newest_ns or 0) > limit_ns:
            self._arm.forget()
        if self._motion is not None and self._motion.stamp_ns > limit_ns:
            self._motion = None
        for track in self._tracks.values():
            if track.said_ns > limit_ns:
                track.said, track.said_ns, track.broken_ns = None, 0, None
            if track.raw_ns > limit_ns:
                track.raw_ns = 0


def is_sound(pose: Pose[Cam, Object] | Pose[W, Cam]) -> bool:
    """Return whether a pose is finite, rigid and within a kilometre: others never get through."""
    matrix = pose.matrix
    rotation = matrix[:3, :3]
    error = np.abs(rotation.T @ rotation - np.eye(3)).max()  # NaN fails the comparison below
    return bool(error < ROTATION_TOLERANCE and np.abs(matrix[:3, 3]).max() < FARTHEST_M)


def _is_usable(said: TrackedObject) -> bool:
    if said.T_cam_object is None:
        return said.state is TrackState.LOST
    if said.state in _SHOWN and not np.isfinite(said.covariance[:3, :3]).all():
        return False
    return is_sound(said.T_cam_object) and bool(np.isfinite(said.xi_w_cam_cam).all())


def _age_ms(instant_ns: int, stamp_ns: int) -> float | None:
    return (instant_ns - stamp_ns) / NS_PER_MS if stamp_ns else None
