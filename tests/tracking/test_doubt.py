"""Fixes that cannot be right: half hidden tags, and contradictions that do not agree."""

from __future__ import annotations

import numpy as np
import pytest

from spatial.camera import PinholeCamera
from spatial.frames import Cam, Object, W
from spatial.marker import Marker
from spatial.pose import Pose
from tracking.anchor import CONFIRMED, LONE_NS, fused
from tracking.joint import Prior, SeenTag, solve_joint
from tracking.model import Anchor

CAMERA = PinholeCamera(1280, 960, 1078.0, 1078.0, 639.5, 479.5)
MARKER = Marker("tag36h11", 11, 0.09, Pose.identity())
T_cam_object: Pose[Cam, Object] = Pose[Cam, Object].translated(0.05, -0.02, 0.66) @ Pose[
    Object, Object
].exp(np.array([0, 0, 0, 2.8, 0.3, 0.2]))
EVERY_NS = 40_000_000


def seen(*, bent_px: float, noise_px: float = 0.2) -> SeenTag:
    """A lone tag, one corner of which an occluder has drawn aside."""
    corners = CAMERA.project(T_cam_object.apply(MARKER.corners_object))
    corners[2, 1] -= bent_px
    return SeenTag(MARKER, corners, noise_px)


@pytest.mark.parametrize("prior", [None, Prior(T_cam_object, 1e-6 * np.eye(6))])
@pytest.mark.parametrize("noise_px", [0.1, 0.5, 2.0])
@pytest.mark.parametrize("bent_px", [10.0, 15.0])
def test_a_lone_tag_that_is_no_square_gives_no_pose(
    bent_px: float, noise_px: float, prior: Prior | None
) -> None:
    assert solve_joint(CAMERA, tags=[seen(bent_px=0.0)], prior=prior) is not None
    bent = [seen(bent_px=bent_px, noise_px=noise_px)]
    assert solve_joint(CAMERA, tags=bent, prior=prior) is None


def fix(at: int, *shift_m: float) -> Anchor:
    return Anchor(
        T_ref_object=Pose[W, Object].translated(*shift_m),
        covariance=1e-6 * np.eye(6),
        stamp_ns=EVERY_NS * (1 + at),
        in_world=True,
        reset_count=0,
    )


def told(
    anchor: Anchor, fixes: list[Anchor], *, motion: str = "static", tags: int = 3
) -> list[str]:
    """Return why each of some fixes was refused, empty where it was not."""
    reasons = []
    for one in fixes:
        anchor, why = fused(anchor, fix=one, motion=motion, distance_m=0.7, tags=tags)
        reasons.append(why)
    return reasons


def test_contradictions_move_the_anchor_when_they_agree() -> None:
    reasons = told(fix(0, 0, 0, 0), [fix(1 + i, 0.3, 0.001 * i, 0) for i in range(CONFIRMED)])
    assert all(reasons[:-1])
    assert reasons[-1] == ""


def test_contradictions_that_disagree_never_do() -> None:
    rng = np.random.default_rng(5)
    scattered = [fix(1 + i, *rng.uniform(0.2, 2.0, 3)) for i in range(20)]
    assert all(told(fix(0, 0, 0, 0), scattered))


def test_a_lone_tag_moves_what_is_static_only_after_a_while() -> None:
    """Half hidden by a handle for half a second, it says the same wrong thing in every image."""
    bent = [fix(1 + i, 0.05, 0, 0) for i in range(40)]
    reasons = told(fix(0, 0, 0, 0), bent, tags=1)
    first = reasons.index("")
    assert LONE_NS <= first * EVERY_NS <= LONE_NS + 2 * EVERY_NS
    assert told(fix(0, 0, 0, 0), bent, tags=2).index("") == CONFIRMED - 1
    assert told(fix(0, 0, 0, 0), bent, tags=1, motion="mobile").index("") < CONFIRMED


def test_a_good_fix_ends_a_row_of_contradictions() -> None:
    bad = [fix(1, 0.3, 0, 0), fix(2, 0.3, 0, 0)]
    again = [fix(4, 0.3, 0, 0), fix(5, 0.3, 0, 0)]
    reasons = told(fix(0, 0, 0, 0), [*bad, fix(3, 0, 0, 0), *again])
    assert [bool(why) for why in reasons] == [True, True, False, True, True]
