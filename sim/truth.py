"""True values of a simulated site: what is drawn around the nominal ones, and true poses.

    T_true = T_nominal @ exp(error),   f_true = f_nominal (1 + error)

Nothing outside `sim` imports this module; on the bus truth travels under `truth/**` only.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from scene.site import Site, SiteCamera
from sim.scenario import ErrorRanges, Range, Scenario
from sim.world import TrueCamera, TrueMarker
from spatial.camera import PinholeCamera
from spatial.frames import Cam, Frame, Object, Tag, W
from spatial.marker import MarkedObject
from spatial.pose import Pose, interpolate
from spatial.rotation import Array
from wire.codec import Encoded, decode_named_poses, encode_named_poses


@dataclass(frozen=True, slots=True, eq=False)
class TruthSample:
    """True poses of everything at one instant."""

    stamp_ns: int
    """Instant [ns]."""
    Ts_w: Mapping[str, Pose[W, Frame]]
    """Poses in the plant's world: `base`, `tcp`, `hc`, `mako`, `object/<slug>`, ..."""


def object_key(slug: str) -> str:
    """Return the name of an object among true poses."""
    return f"object/{slug}"


def T_cam_object_of(sample: TruthSample, *, camera: str, slug: str) -> Pose[Cam, Object] | None:
    """Return the true pose of an object in a camera, `None` where the truth holds neither."""
    T_w_cam, T_w_object = sample.Ts_w.get(camera), sample.Ts_w.get(object_key(slug))
    if T_w_cam is None or T_w_object is None:
        return None
    return Pose((T_w_cam.inverse() @ T_w_object).matrix)


def encode_truth(sample: TruthSample) -> Encoded:
    """Encode true poses."""
    poses = {name: (T.translation, T.quaternion_wxyz) for name, T in sample.Ts_w.items()}
    return encode_named_poses(sample.stamp_ns, poses)


def decode_truth(payload: bytes) -> TruthSample:
    """Decode true poses.

    Raises:
        MessageError: bytes that are no true poses.
    """
    stamp_ns, poses = decode_named_poses(payload)
    return TruthSample(stamp_ns, {name: Pose.parse(*pose) for name, pose in poses.items()})


def blend(older: TruthSample, younger: TruthSample, share: float) -> TruthSample:
    """Return the truth a share in [0, 1] of the way between two samples."""
    stamp_ns = older.stamp_ns + round(share * (younger.stamp_ns - older.stamp_ns))
    names = older.Ts_w.keys() & younger.Ts_w.keys()
    return TruthSample(
        stamp_ns, {n: interpolate(older.Ts_w[n], younger.Ts_w[n], share) for n in names}
    )


def true_cameras(site: Site, *, scenario: Scenario, seed: int) -> dict[str, TrueCamera]:
    """Return every camera as it really is, drawn around the site's nominal values."""
    return {
        name: _true_camera(camera, scenario=scenario, rng=_rng(seed, f"camera {name}"))
        for name, camera in site.cameras.items()
    }


def true_markers(
    objects: Iterable[MarkedObject], *, scenario: Scenario, seed: int
) -> tuple[TrueMarker, ...]:
    """Return where every marker really sits, drawn around the database's nominal values."""
    ranges, scale = scenario.errors, scenario.calibration_error
    drawn = []
    for marked in objects:
        rng = _rng(seed, f"tags {marked.slug}")
        for marker in marked.markers:
            error = _pose_error(rng, ranges.tag_m, ranges.tag_deg, scale)
            pose = marker.T_object_marker @ Pose[Tag, Tag].exp(error)
            drawn.append(TrueMarker(marked.slug, marker.key, pose))
    return tuple(drawn)


def _true_camera(camera: SiteCamera, *, scenario: Scenario, rng: np.random.Generator) -> TrueCamera:
    ranges, scale = scenario.errors, scenario.calibration_error
    on_tool = camera.parent == "tcp"
    error = _pose_error(
        rng,
        ranges.hand_eye_m if on_tool else ranges.base_m,
        ranges.hand_eye_deg if on_tool else ranges.base_deg,
        scale,
    )
    return TrueCamera(
        intrinsics=_true_intrinsics(camera.intrinsics, ranges=ranges, scale=scale, rng=rng),
        parent=camera.parent,
        T_parent_cam=Pose((camera.T_parent_cam @ Pose[Cam, Cam].exp(error)).matrix),
    )


def _true_intrinsics(
    nominal: PinholeCamera, *, ranges: ErrorRanges, scale: float, rng: np.random.Generator
) -> PinholeCamera:
    stretch = 1.0 + scale * float(rng.uniform(*ranges.focal) * rng.choice((-1.0, 1.0)))
    angle = rng.uniform(0.0, 2.0 * math.pi)
    shift = scale * rng.uniform(*ranges.principal_px)
    return replace(
        nominal,
        fx=nominal.fx * stretch,
        fy=nominal.fy * stretch,
        cx=nominal.cx + shift * math.cos(angle),
        cy=nominal.cy + shift * math.sin(angle),
    )


def _pose_error(rng: np.random.Generator, far_m: Range, turn_deg: Range, scale: float) -> Array:
    """Tangent vector (6,) of random direction, its two lengths uniform in their ranges."""
    shift = rng.uniform(*far_m) * _direction(rng)
    turn = math.radians(rng.uniform(*turn_deg)) * _direction(rng)
    return scale * np.concatenate((shift, turn))


def _direction(rng: np.random.Generator) -> Array:
    vector = rng.standard_normal(3)
    return np.asarray(vector / np.linalg.norm(vector), dtype=np.float64)


def _rng(seed: int, what: str) -> np.random.Generator:
    """Random numbers of one thing, whatever else is drawn before it."""
    return np.random.default_rng((seed, zlib.crc32(what.encode())))
