"""A swaying camera before painted objects, odometry with errors, delays, and the truth."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache

import cv2
import numpy as np

from sim.painter import Painted, Painter
from spatial.camera import PinholeCamera
from spatial.frames import Cam, Object, Tag, W
from spatial.marker import MarkedObject, Marker
from spatial.pose import Pose
from spatial.samples import MotionSample
from spatial.tracked import PoseMeasurement, TrackedObjects, TrackReport, TrackState
from tracking.model import GrayImage, TrackerModel
from tracking.motion import MotionHistory
from tracking.tracker import initial_state, observe, predict

MS = 1_000_000
START_NS = 1_000_000_000_000
CAMERA = PinholeCamera(1280, 960, 1078.0, 1078.0, 639.5, 479.5)
FACING = np.diag([1.0, -1.0, -1.0])


def plate(first_id: int = 0, *, slug: str = "plate", motion: str = "static") -> MarkedObject:
    places = ((0, 0, 0.06), (-0.1, 0.08, 0.05), (0.1, 0.08, 0.05), (-0.1, -0.08, 0.05))
    markers = [
        Marker("tag36h11", first_id + i, size, Pose.translated(x, y, 0.0))
        for i, (x, y, size) in enumerate((*places, (0.1, -0.08, 0.05)))
    ]
    return MarkedObject(slug, 3, markers[0].key, tuple(markers), motion)


def cage(first_id: int = 20, *, back: bool = False) -> MarkedObject:
    """Three tags that lean outwards, and one on the far side when asked."""
    turn = [(0, 0.0), (1, math.pi / 2), (2, -math.pi / 2)]
    markers = []
    for i, yaw in turn:
        out = Pose[Object, Tag].exp([0, 0, 0, 0, yaw * 0.5, 0])
        shift = out.rotation @ np.array([0.0, 0.0, 0.12])
        markers.append(Marker("tag36h11", first_id + i, 0.06, Pose.of(out.rotation, shift)))
    if back:
        behind = Pose[Object, Tag].of(FACING, (0.0, 0.0, -0.1))
        markers.append(Marker("tag36h11", first_id + 3, 0.06, behind))
    return MarkedObject("cage", 1, markers[0].key, tuple(markers))


@dataclass(slots=True, eq=False)
class Row:
    """One output sample against the truth."""

    time_s: float
    slug: str
    state: TrackState
    off_m: float
    off_rad: float
    step_m: float
    sigma3_m: float
    reason: str


@dataclass(slots=True, eq=False)
class Run:
    """Everything a sequence gave."""

    rows: list[Row] = field(default_factory=list)
    reports: list[TrackReport] = field(default_factory=list)
    measurements: list[PoseMeasurement] = field(default_factory=list)
    outputs: list[TrackedObjects] = field(default_factory=list)
    observe_s: list[float] = field(default_factory=list)

    def of(self, state: TrackState, slug: str = "plate", *, after_s: float = 0.0) -> list[Row]:
        return [r for r in self.rows if r.state is state and r.slug == slug and r.time_s >= after_s]

    def rmse_m(self, state: TrackState, slug: str = "plate", *, after_s: float = 0.0) -> float:
        off = [r.off_m for r in self.of(state, slug, after_s=after_s)]
        return float(np.sqrt(np.mean(np.square(off))))


def T_w_cam_true(t: float) -> Pose[W, Cam]:
    """A double pendulum seen from the arm: .25 m/s, .25 rad/s, looking down along -z."""
    position = (
        0.10 * math.sin(2.2 * t),
        0.08 * math.sin(1.7 * t + 1.0),
        0.75 + 0.04 * math.sin(0.9 * t),
    )
    turn = (0.10 * math.sin(1.7 * t), 0.12 * math.sin(2.2 * t + 0.4), 0.15 * math.sin(0.8 * t))
    return Pose.of(Pose[W, Cam].exp([0, 0, 0, *turn]).rotation @ FACING, position)


def true_twist(t: float) -> np.ndarray:
    h = 1e-4
    step: Pose[Cam, Cam] = T_w_cam_true(t - h).inverse() @ T_w_cam_true(t + h)
    return step.log() / (2 * h)


@dataclass(slots=True, eq=False)
class Odometry:
    """Drift as an Ornstein-Uhlenbeck velocity error, yaw bias, white noise, jumps on demand."""

    seed: int = 0
    velocity_m_s: float = 0.003
    yaw_rad_s: float = 3e-4
    white_m: float = 2e-4
    jumps: dict[int, np.ndarray] = field(default_factory=dict)
    resets: frozenset[int] = frozenset()
    _rng: np.random.Generator = field(init=False)
    _v: np.ndarray = field(init=False)
    _T_w_true: Pose[W, W] = field(init=False)
    _reset: int = field(init=False, default=0)

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)
        self._v = self._rng.normal(size=3) * self.velocity_m_s
        self._T_w_true = Pose.identity()

    def sample(self, index: int, t: float, dt: float) -> MotionSample:
        keep = math.exp(-dt / 2.0)
        noise = self._rng.normal(size=3) * self.velocity_m_s * math.sqrt(1 - keep**2)
        self._v = keep * self._v + noise
        drift = np.array([*(self._v * dt), 0.0, 0.0, self.yaw_rad_s * dt])
        self._T_w_true = Pose[W, W].exp(drift) @ self._T_w_true
        if index in self.jumps:
            self._T_w_true = Pose[W, W].exp(self.jumps[index]) @ self._T_w_true
        if index in self.resets:
            self._T_w_true = Pose[W, W].exp([1.0, 2.0, -0.5, 0, 0, 1.0])
            self._reset += 1
        white = np.array([*(self._rng.normal(size=3) * self.white_m), 0, 0, 0])
        twist_noise = np.array([*([5e-3] * 3), *([2.4e-3] * 3)]) * self._rng.normal(size=6)
        return MotionSample(
            stamp_ns=START_NS + round(t * 1e9),
            T_w_cam=self._T_w_true @ T_w_cam_true(t) @ Pose[Cam, Cam].exp(white),
            xi_w_cam_cam=true_twist(t) + twist_noise,
            acceleration_cam=np.zeros(3),
            reset_count=self._reset,
        )


@dataclass(slots=True, eq=False)
class Theatre:
    """Plays a sequence to a tracker: images late by `image_ms`, odometry by `motion_ms`."""

    objects: tuple[MarkedObject, ...]
    Ts_w_object: dict[str, Pose[W, Object]]
    camera: PinholeCamera = CAMERA
    image_ms: int = 100
    noise: float = 1.5
    odometry: Odometry = field(default_factory=Odometry)
    hidden: Callable[[float, str], bool] = lambda t, slug: False  # noqa: ARG005 - a default
    motion_stops_s: float = math.inf

    def T_cam_object(self, slug: str, stamp_ns: int) -> Pose[Cam, Object]:
        return T_w_cam_true((stamp_ns - START_NS) / 1e9).inverse() @ self.Ts_w_object[slug]

    def material(self, *, count: int) -> tuple[MotionHistory, list[GrayImage]]:
        """Some images 40 ms apart and the motion over them."""
        painter, rng, motion = self._painter(), np.random.default_rng(9), MotionHistory()
        for index in range(8 * count + 20):
            motion.put(self.odometry.sample(index, index / 200.0, 1 / 200.0))
        return motion, [self._image(painter, 0.04 * i, rng) for i in range(count)]

    def _painter(self) -> Painter:
        things = {o.slug: Painted.of(o, **_board(o)) for o in self.objects}
        return Painter(self.camera, things=things)

    def play(self, *, duration_s: float, method: str = "joint") -> Run:
        model = TrackerModel(CAMERA, "hc", self.objects, method)
        painter = self._painter()
        state, motion, run = initial_state(model), MotionHistory(), Run()
        rng = np.random.default_rng(9)
        waiting: list[tuple[int, GrayImage]] = []
        last: dict[str, tuple[Pose[Cam, Object], Pose[Cam, Object]]] = {}
        for index in range(round(duration_s * 200)):
            t = index / 200.0
            if index % 8 == 0:
                image = self._image(painter, t, rng)
                waiting.append((index + self.image_ms // 5, image))
            sample = self.odometry.sample(index, t, 1 / 200.0)
            if t < self.motion_stops_s:
                motion.put(sample)
            while waiting and waiting[0][0] <= index:
                started = _cpu()
                state, found, reports = observe(model, state, waiting.pop(0)[1], motion)
                run.observe_s.append(_cpu() - started)
                run.measurements += found
                run.reports += reports
            now_ns = START_NS + round(t * 1e9)
            output = predict(model, state, motion, now_ns=now_ns)
            run.outputs.append(output)
            self._compare(run, output, last)
        return run

    def _image(self, painter: Painter, t: float, rng: np.random.Generator) -> GrayImage:
        T_cam_w = T_w_cam_true(t).inverse()
        shown = {s: T_cam_w @ T for s, T in self.Ts_w_object.items() if not self.hidden(t, s)}
        gray = cv2.cvtColor(painter.render(shown), cv2.COLOR_RGB2GRAY).astype(np.float32)
        gray += np.roll(_grain(), int(rng.integers(1 << 20))) * self.noise
        return GrayImage(START_NS + round(t * 1e9), np.clip(gray, 0, 255).astype(np.uint8))

    def _compare(
        self,
        run: Run,
        output: TrackedObjects,
        last: dict[str, tuple[Pose[Cam, Object], Pose[Cam, Object]]],
    ) -> None:
        t = (output.stamp_ns - START_NS) / 1e9
        for item in output.objects:
            if item.T_cam_object is None:
                continue
            truth = T_w_cam_true(t).inverse() @ self.Ts_w_object[item.slug]
            off_m, off_rad = truth.distance_to(item.T_cam_object)
            step = 0.0
            if item.slug in last:
                shown, true = last[item.slug]
                moved = item.T_cam_object.translation - shown.translation
                step = float(np.linalg.norm(moved - (truth.translation - true.translation)))
            last[item.slug] = (item.T_cam_object, truth)
            sigma3 = 3 * math.sqrt(float(np.linalg.eigvalsh(item.covariance[:3, :3])[-1]))
            run.rows.append(
                Row(t, item.slug, item.state, off_m, off_rad, step, sigma3, item.reason)
            )


@cache
def _grain() -> np.ndarray:
    shape = (CAMERA.height, CAMERA.width)
    return np.random.default_rng(1).standard_normal(shape, dtype=np.float32)


def _cpu() -> float:
    return time.process_time()


def _board(item: MarkedObject) -> dict[str, np.ndarray]:
    if item.slug == "cage":
        return {}
    v = np.array([[-0.18, -0.15, 0], [0.18, -0.15, 0], [0.18, 0.15, 0], [-0.18, 0.15, 0]])
    return {"vertices": v, "faces": np.array([[0, 1, 2], [0, 2, 3]])}
