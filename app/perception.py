"""From streams to tracked objects: one tracker per camera, one answer for all objects.

Knows no bus and starts no thread, so that live, lock-step and re-tracking share it. A live
process may call `observe` for each camera from a thread of that camera while another thread
calls the rest: a tracker's state is immutable and only its `observe` replaces it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from scene.carried import CarriedCamera
from scene.database import Database
from scene.robot import Robot
from scene.site import Site
from spatial.camera import PinholeCamera
from spatial.errors import InputError, MessageError, StampError, unknown
from spatial.marker import MarkedObject
from spatial.samples import ImageSample, JointSample, MotionSample
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
        self.waiting = 0
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

    def put_joints(self, sample: JointSample) -> None:
        """Store a joint sample."""
        self._joints.put(sample.stamp_ns, sample)

    def put_motion(self, sample: MotionSample) -> None:
        """Store an odometry sample, and what it means for the cameras the robot carries."""
        for tracker in self.cameras.values():
            if tracker.carried is None:
                tracker.motion.put(sample)
                continue
            try:
                joints = self._joints_at(sample.stamp_ns)
            except StampError:
                self.waiting += 1
                continue
            tracker.motion.put(tracker.carried.motion(sample, joints))

    def observe(
        self, image: ImageSample
    ) -> tuple[tuple[PoseMeasurement, ...], tuple[TrackReport, ...]]:
        """Look at one image.

        Raises:
            MessageError: an image that does not decode, or of another size than calibrated.
            InputError: a camera the site does not have.
        """
        if image.camera not in self.cameras:
            raise InputError(unknown("camera", image.camera, self.cameras))
        tracker = self.cameras[image.camera]
        gray = decode_gray(image, tracker.model.camera)
        tracker.state, measurements, reports = observe(
            tracker.model, tracker.state, gray, tracker.motion
        )
        return measurements, reports

    def predict(self) -> TrackedObjects | None:
        """Return all objects at the newest motion sample; `None` before the first one."""
        newest = self.cameras[self._site.vio_camera].motion.newest
        if newest is None:
            return None
        objects: dict[str, TrackedObject] = {}
        for tracker in self.cameras.values():
            if tracker.model.objects and tracker.motion.newest is not None:
                tracked = predict(
                    tracker.model, tracker.state, tracker.motion, now_ns=newest.stamp_ns
                )
                objects.update((item.slug, item) for item in tracked.objects)
        ordered = [objects[o.slug] for o in self._site.objects if o.slug in objects]
        return TrackedObjects(stamp_ns=newest.stamp_ns, objects=tuple(ordered))

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
    data = np.frombuffer(image.jpeg, dtype=np.uint8)
    pixels = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE) if data.size else None
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
