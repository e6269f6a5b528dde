from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from spatial.errors import InputError
from spatial.frames import Object, W
from spatial.marker import MarkedObject, Marker
from spatial.pose import Pose
from spatial.tracked import TrackState
from tracking.anchor import CONFIRMED, blended, fused
from tracking.judge import Evidence, judged
from tracking.model import Anchor, Blend, GrayImage, StandardLimits, TrackerModel
from tracking.motion import MotionHistory
from tracking.tracker import initial_state, observe, predict

if TYPE_CHECKING:
    from tests.tracking.theatre import Theatre

MS = 1_000_000
SURE = Evidence(
    fix_age_ns=120 * MS,
    delay_ns=100 * MS,
    motion_age_ns=10 * MS,
    carrier="camera motion",
    sigma3_m=0.01,
    sigma3_before_m=0.01,
    same_world=True,
    tags=3,
)


@pytest.mark.parametrize(
    ("change", "state", "reason"),
    [
        ({}, TrackState.TRACKED, "fix from 3 tags"),
        ({"tags": 1}, TrackState.TRACKED, "fix from 1 tag"),
        ({"fix_age_ns": 250 * MS}, TrackState.TRACKED, "fix"),
        ({"fix_age_ns": 251 * MS}, TrackState.BRIDGED, "no tag for 0.3 s"),
        ({"fix_age_ns": 9000 * MS}, TrackState.BRIDGED, "carried by camera motion"),
        ({"fix_age_ns": 251 * MS, "carrier": ""}, TrackState.STALE, "may not carry"),
        ({"fix_age_ns": 751 * MS, "carrier": ""}, TrackState.LOST, "may not carry"),
        ({"fix_age_ns": 300 * MS, "motion_age_ns": 301 * MS}, TrackState.STALE, "no motion"),
        ({"fix_age_ns": 900 * MS, "motion_age_ns": 900 * MS}, TrackState.LOST, "no motion"),
        ({"fix_age_ns": 300 * MS, "motion_age_ns": None}, TrackState.STALE, "no motion"),
        ({"fix_age_ns": 9000 * MS, "sigma3_m": 0.061}, TrackState.STALE, "3 sigma 61 mm"),
        (
            {"fix_age_ns": 9000 * MS, "sigma3_m": 0.1, "sigma3_before_m": 0.061},
            TrackState.LOST,
            "3 sigma",
        ),
        ({"same_world": False}, TrackState.LOST, "new world"),
    ],
)
def test_states_follow_the_contract(
    change: dict[str, object], state: TrackState, reason: str
) -> None:
    verdict, why = judged(replace(SURE, **change), StandardLimits())  # type: ignore[arg-type] # cases
    assert verdict is state
    assert reason in why


def anchor(x: float = 0.0, *, ms: int = 0, sigma: float = 0.001, reset_count: int = 0) -> Anchor:
    T_w_object: Pose[W, Object] = Pose.translated(x, 0.0, 0.0)
    return Anchor(T_w_object, np.eye(6) * sigma**2, ms * MS, in_world=True, reset_count=reset_count)


def x_of(held: Anchor) -> float:
    return float(held.T_ref_object.translation[0])


def test_fusion_weighs_by_covariance_and_grows_surer() -> None:
    after, why = fused(
        anchor(sigma=0.004), fix=anchor(0.004, ms=1, sigma=0.004), motion="static", distance_m=0.5
    )
    assert why == ""
    assert 0.0019 < x_of(after) < 0.0022
    assert after.covariance[0, 0] < 0.004**2
    assert np.linalg.eigvalsh(after.covariance).min() > 0.0


def test_a_contradicting_fix_is_believed_only_when_it_is_confirmed() -> None:
    held = anchor()
    for i in range(CONFIRMED - 1):
        held, why = fused(held, fix=anchor(0.3, ms=40 * i + 40), motion="static", distance_m=0.5)
        assert "sigma from the prediction" in why
        assert x_of(held) == 0.0
    held, why = fused(held, fix=anchor(0.3, ms=200), motion="static", distance_m=0.5)
    assert x_of(held) == pytest.approx(0.3)
    assert why == ""


def test_a_fix_in_a_new_world_replaces_the_anchor() -> None:
    after, _ = fused(
        anchor(), fix=anchor(2.0, ms=40, reset_count=1), motion="static", distance_m=0.5
    )
    assert (x_of(after), after.reset_count) == (2.0, 1)


@pytest.mark.parametrize("size_m", [0.002, 0.03, 0.5])
def test_a_correction_is_shown_without_a_step_of_ten_millimetres(size_m: float) -> None:
    off = np.array([size_m, 0, 0, 0, 0, 0])
    blend = blended(None, off=off, instant_ns=0, blend_ns=200 * MS)
    if size_m <= 0.003:
        assert blend is None
        return
    assert blend is not None
    shown = [blend.share(5 * MS * i) * size_m for i in range(200)]
    assert shown[0] == size_m
    assert shown[-1] == 0.0
    assert np.abs(np.diff(shown)).max() < 0.010


def test_following_corrections_do_not_prolong_a_blend() -> None:
    blend = Blend(np.array([0.03, 0, 0, 0, 0, 0]), 0, 200 * MS)
    for ms in (40, 80, 120, 160):
        off = blend.share(ms * MS) * blend.xi
        again = blended(blend, off=off, instant_ns=ms * MS, blend_ns=200 * MS)
        assert again is not None
        assert again.share(ms * MS) * again.xi == pytest.approx(off)
        blend = again
    assert blend.share(200 * MS) == 0.0


def test_observe_and_predict_are_pure(theatre: Callable[..., Theatre]) -> None:
    stage = theatre(with_cage=True)
    model = TrackerModel(stage.camera, "hc", stage.objects)
    motion, images = stage.material(count=4)
    state = initial_state(model)
    for image in images[:-1]:
        state, _, _ = observe(model, state, image, motion)
    before = repr(state)
    first = observe(model, state, images[-1], motion)
    shown = predict(model, first[0], motion)
    second = observe(model, state, images[-1], motion)
    assert repr(state) == before
    assert repr(first) == repr(second)
    assert repr(predict(model, second[0], motion)) == repr(shown)
    assert len(first[1]) == 2
    ignored, none, nothing = observe(model, first[0], images[0], motion)
    assert ignored is first[0]
    assert (none, nothing) == ((), ())


def test_reports_say_what_became_of_every_tag(theatre: Callable[..., Theatre]) -> None:
    stage = theatre(with_cage=True)
    model = TrackerModel(stage.camera, "hc", stage.objects)
    motion, images = stage.material(count=3)
    state = initial_state(model)
    covered = images[-1].pixels.copy()
    x, y = stage.camera.project(
        stage.T_cam_object("plate", images[-1].stamp_ns).apply(
            model.objects[0].markers[2].corners_object.mean(axis=0)
        )
    ).astype(int)
    covered[y - 60 : y + 60, x - 60 : x + 60] = 90
    for image in (*images[:-1], GrayImage(images[-1].stamp_ns, covered)):
        state, _, (plate, _) = observe(model, state, image, motion)
    used = {tag.id: (tag.used, tag.reason) for tag in plate.tags}
    assert plate.expected_ids == (0, 1, 2, 3, 4)
    assert used[2][0] is False
    assert used[2][1].startswith(("edges not found", "bits agree"))
    assert [i for i, (fits, _) in sorted(used.items()) if fits] == [0, 1, 3, 4]
    assert plate.T_cam_object is not None
    assert plate.T_cam_object_prior is not None
    assert 0.0 < plate.residual_px < 0.2


def test_before_the_first_image_everything_is_lost(theatre: Callable[..., Theatre]) -> None:
    stage = theatre()
    model = TrackerModel(stage.camera, "hc", stage.objects)
    (plate,) = predict(model, initial_state(model), MotionHistory()).objects
    assert (plate.state, plate.T_cam_object, plate.reason) == (TrackState.LOST, None, "never seen")


def test_a_model_refuses_what_cannot_be_tracked(theatre: Callable[..., Theatre]) -> None:
    stage = theatre()
    plate = stage.objects[0]
    with pytest.raises(InputError, match=r"unknown method 'magic'.*joint"):
        TrackerModel(stage.camera, "hc", (plate,), "magic")
    with pytest.raises(InputError, match="already exists"):
        TrackerModel(stage.camera, "hc", (plate, replace(plate, slug="twin")))
    with pytest.raises(InputError, match=r"target .* is none of: tag36h11 0"):
        TrackerModel(stage.camera, "hc", (replace(plate, target=("tag36h11", 99)),))
    odd = Marker("artoolkitplus_simple", 1, 0.1, Pose.identity())
    with pytest.raises(InputError, match="unknown marker family"):
        TrackerModel(stage.camera, "hc", (MarkedObject("odd", 1, odd.key, (odd,)),))
