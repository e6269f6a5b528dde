"""From streams to tracked objects: one tracker per camera, one answer for all objects.

Knows no bus and starts no thread, so that live, lock-step and re-tracking share it. A live
process may call `observe` for each camera from a thread of that camera while another thread
calls the rest: a tracker's state is immutable and only its `observe` replaces it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np

from scene.carried import CarriedCamera
from scene.database import Database
from scene.robot import Robot
from scene.site import Site
from spatial.camera import PinholeCamera
from spatial.errors import InputError, MessageError, StampError, unknown
from spatial.marker import MarkedObject
from spatial.samples import CalibrationSample, ImageSample, JointSample, MotionSample
from spatial.stamp import NS_PER_S, StampedBuffer
from spatial.tracked import PoseMeasurement, TrackedObject, TrackedObjects, TrackReport
from tracking.motion import MotionHistory
from tracking.tracker import (
    GrayImage,
    TrackerModel,
    TrackerState,
    initial_state,
    observe,
    predict,
)

JOINT_SPAN_NS = 2 * NS_PER_S
JOINT_WAIT_NS = 30_000_000
"""Joints may be this much older than a motion sample; their velocity carries them on [ns]."""
UNPAIRED = 512
"""Motion samples that wait for their joints, at most."""


@dataclass(slots=True, eq=False)
class CameraTracker:
    """A camera, its motion and its tracker."""

    model: TrackerModel
    """What it tracks and how."""
    state: TrackerState
    """What it knows; replaced by every observation."""
    motion: MotionHistory
    """Motion of this camera."""
    carried: CarriedCamera | None
    """How its motion follows from the odometry; `None` for the camera that has it."""


class Perception:
    """Trackers of all cameras of a site."""

    def __init__(
        self,
        *,
        site: Site,
        robot: Robot,
        database: Database,
        method: str,
        intrinsics: Mapping[str, PinholeCamera] | None = None,
    ) -> None:
        """Prepare the trackers.

        Args:
            site: cameras, who carries which object, limits.
            robot: kinematics of the cameras that have no odometry.
            database: what the objects look like.
            method: one of the contract's methods.
            intrinsics: calibrations that replace those of the site file, by camera.

        Raises:
            InputError: an object of the site that is not in the database.
        """
        self._site = site
        self._joints: StampedBuffer[JointSample] = StampedBuffer(
            name="joints", span_ns=JOINT_SPAN_NS
        )
        self._unpaired: deque[MotionSample] = deque(maxlen=UNPAIRED)
        self.cameras: dict[str, CameraTracker] = {}
        for name, camera in site.cameras.items():
            objects = tuple(marked_objects(site, database, camera=name))
            model = TrackerModel(
                camera=(intrinsics or {}).get(name, camera.intrinsics),
                camera_name=name,
                objects=objects,
                method=method,
                limits=site.limits,
            )
            has_odometry = name == site.vio_camera
            self.cameras[name] = CameraTracker(
                model=model,
                state=initial_state(model),
                motion=MotionHistory(),
                carried=None
                if has_odometry
                else CarriedCamera(robot=robot, vio=site.cameras[site.vio_camera], carried=camera),
            )

    @property
    def has_motion(self) -> bool:
        """Whether odometry ever came."""
        return self.cameras[self._site.vio_camera].motion.newest is not None

    @property
    def unpaired(self) -> int:
        """Odometry samples that still wait for joints of their instant."""
        return len(self._unpaired)

    def put_calibration(self, sample: CalibrationSample) -> None:
        """Take the intrinsics a camera tells of itself; they replace the site file's.

        Raises:
            InputError: a camera the site does not have.
        """
        tracker = self._tracker(sample.camera)
        if tracker.model.camera != sample.intrinsics:
            tracker.model = replace(tracker.model, camera=sample.intrinsics)

    def put_joints(self, sample: JointSample) -> None:
        """Store a joint sample; odometry that waited for it moves the carried cameras."""
        self._joints.put(sample.stamp_ns, sample)
        self._pair()

    def put_motion(self, sample: MotionSample) -> None:
        """Store an odometry sample, and what it means for the cameras the robot carries."""
        self.cameras[self._site.vio_camera].motion.put(sample)
        if len(self.cameras) > 1:
            self._unpaired.append(sample)
            self._pair()

    def observe(
        self, image: ImageSample
    ) -> tuple[tuple[PoseMeasurement, ...], tuple[TrackReport, ...]]:
        """Look at one image.

        Raises:
            MessageError: an image that does not decode, or of another size than calibrated.
            InputError: a camera the site does not have.
        """
        tracker = self._tracker(image.camera)
        model = tracker.model
        gray = decode_gray(image, model.camera)
        tracker.state, measurements, reports = observe(model, tracker.state, gray, tracker.motion)
        return measurements, reports

    def predict(self) -> TrackedObjects | None:
        """Return all objects at the newest motion sample.

        Where no motion ever came, at the newest image; `None` before the first of either.
        """
        newest = self.cameras[self._site.vio_camera].motion.newest
        if newest is not None:
            return self._predict(newest.stamp_ns)
        images_ns = max(tracker.state.image_ns for tracker in self.cameras.values())
        return self._predict(images_ns) if images_ns else None

    def _predict(self, instant_ns: int) -> TrackedObjects:
        objects: dict[str, TrackedObject] = {}
        for tracker in self.cameras.values():
            if not tracker.model.objects:
                continue
            to_ns, newest = instant_ns, tracker.motion.newest
            if newest is not None:  # beyond the horizon a pose is held, not carried
                to_ns = min(to_ns, newest.stamp_ns + tracker.model.limits.horizon_ns)
            tracked = predict(
                tracker.model, tracker.state, tracker.motion, now_ns=instant_ns, to_ns=to_ns
            )
            objects.update((item.slug, item) for item in tracked.objects)
        ordered = [objects[o.slug] for o in self._site.objects if o.slug in objects]
        return TrackedObjects(stamp_ns=instant_ns, objects=tuple(ordered))

    def _tracker(self, camera: str) -> CameraTracker:
        if camera not in self.cameras:
            raise InputError(unknown("camera", camera, self.cameras))
        return self.cameras[camera]

    def _pair(self) -> None:
        """Move the carried cameras by every odometry sample whose joints are known."""
        while self._unpaired:
            motion = self._unpaired[0]
            try:
                joints = self._joints_at(motion.stamp_ns)
            except StampError as error:
                held = error.available_ns
                if held is None or motion.stamp_ns > held[1]:
                    return  # its joints are still to come
            else:
                for tracker in self.cameras.values():
                    if tracker.carried is not None:
                        tracker.motion.put(tracker.carried.motion(motion, joints))
            self._unpaired.popleft()

    def _joints_at(self, stamp_ns: int) -> JointSample:
        newest = self._joints.newest
        if newest is not None and 0 < stamp_ns - newest.stamp_ns <= JOINT_WAIT_NS:
            ahead_s = (stamp_ns - newest.stamp_ns) / NS_PER_S
            return _moved(newest.value, stamp_ns=stamp_ns, by_s=ahead_s)
        return self._joints.interpolate(stamp_ns, _blend)


def marked_objects(site: Site, database: Database, *, camera: str) -> Iterable[MarkedObject]:
    """Yield what the tracker of one camera looks for.

    Raises:
        InputError: an object of the site that is not in the database.
    """
    for item in site.objects:
        if item.slug not in database.entries:
            raise InputError(unknown("object", item.slug, database.entries))
        if item.camera == camera:
            entry = database.entries[item.slug].marked()
            yield MarkedObject(
                slug=entry.slug,
                revision=entry.revision,
                target=entry.target,
                markers=entry.markers,
                motion=item.motion,
            )


def decode_gray(image: ImageSample, camera: PinholeCamera) -> GrayImage:
    """Decode an image to gray levels.

    Raises:
        MessageError: it does not decode, or its size is not the calibration's.
    """
    try:
        pixels = cv2.imdecode(np.frombuffer(image.jpeg, np.uint8), cv2.IMREAD_GRAYSCALE)
    except cv2.error:  # what it raises for nothing at all, and for sizes beyond reason
        pixels = None
    if pixels is None:
        raise MessageError(f"image of camera {image.camera!r} is not a JPEG")
    if pixels.shape != (camera.height, camera.width):
        raise MessageError(
            f"image of camera {image.camera!r} is {pixels.shape[1]}x{pixels.shape[0]}, "
            f"calibrated is {camera.width}x{camera.height}"
        )
    return GrayImage(stamp_ns=image.stamp_ns, pixels=np.asarray(pixels, dtype=np.uint8))


def _blend(older: JointSample, younger: JointSample, share: float) -> JointSample:
    stamp_ns = older.stamp_ns + round(share * (younger.stamp_ns - older.stamp_ns))
    return JointSample(
        stamp_ns=stamp_ns,
        names=younger.names,
        positions_rad=(1 - share) * older.positions_rad + share * younger.positions_rad,
        velocities_rad_s=(1 - share) * older.velocities_rad_s + share * younger.velocities_rad_s,
        torques_nm=younger.torques_nm,
    )


def _moved(sample: JointSample, *, stamp_ns: int, by_s: float) -> JointSample:
    return JointSample(
        stamp_ns=stamp_ns,
        names=sample.names,
        positions_rad=sample.positions_rad + by_s * sample.velocities_rad_s,
        velocities_rad_s=sample.velocities_rad_s,
        torques_nm=sample.torques_nm,
    )
