"""Whole runs on painted images with truth: sway, noise, delays, loss of sight, bad odometry."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from spatial.tracked import TrackState

if TYPE_CHECKING:
    from tests.tracking.theatre import Run, Theatre

    Make = Callable[..., Theatre]

GAP = (0.8, 5.8)


def in_gap(t: float, _slug: str) -> bool:
    return GAP[0] < t < GAP[1]


def briefly(t: float, _slug: str) -> bool:
    return 0.5 < t < 1.3


def largest_step_m(run: Run, slug: str = "plate") -> float:
    return max(row.step_m for row in run.rows if row.slug == slug)


@pytest.fixture(scope="module")
def long_gap(theatre: Make) -> Run:
    return theatre(with_cage=True, hidden=in_gap).play(duration_s=6.8)


@pytest.mark.parametrize("slug", ["plate", "cage"])
def test_in_sight_it_is_good_to_a_millimetre_and_never_leaps(long_gap: Run, slug: str) -> None:
    before = [r for r in long_gap.of(TrackState.TRACKED, slug) if 0.2 < r.time_s < GAP[0]]
    assert np.sqrt(np.mean([r.off_m**2 for r in before])) < 0.0015
    assert long_gap.rmse_m(TrackState.TRACKED, slug) < 0.003
    assert largest_step_m(long_gap, slug) < 0.010


@pytest.mark.parametrize("slug", ["plate", "cage"])
def test_five_seconds_without_a_tag_are_bridged(long_gap: Run, slug: str) -> None:
    states = [r.state for r in long_gap.rows if r.slug == slug and r.time_s > 0.3]
    assert set(states) == {TrackState.TRACKED, TrackState.BRIDGED}
    bridged = long_gap.of(TrackState.BRIDGED, slug)
    assert 4.7 < len(bridged) / 200.0 < 5.2
    assert max(r.off_m for r in bridged) < 0.030
    assert "carried by camera motion" in bridged[-1].reason
    covered = [r.off_m < r.sigma3_m for r in long_gap.rows]
    assert np.mean(covered) > 0.99


def test_every_motion_sample_gives_an_output_of_all_objects(long_gap: Run) -> None:
    stamps = [output.stamp_ns for output in long_gap.outputs]
    assert set(np.diff(stamps)) == {5_000_000}
    assert all([o.slug for o in out.objects] == ["plate", "cage"] for out in long_gap.outputs)


def test_following_eight_tags_costs_a_few_milliseconds(long_gap: Run) -> None:
    assert np.median(long_gap.observe_s) < 0.016  # 4 ms on a free core


def test_algorithm1_initialises_bridges_and_compensates(theatre: Make) -> None:
    run = theatre(hidden=lambda t, _: 0.8 < t < 2.8).play(duration_s=3.4, method="algorithm1")
    assert run.rmse_m(TrackState.TRACKED) < 0.010
    assert run.of(TrackState.BRIDGED)
    assert run.rmse_m(TrackState.BRIDGED) < 0.025
    assert {m.source for m in run.measurements} == {"algorithm1"}


def test_algorithm1_says_how_many_tags_it_waits_for(theatre: Make) -> None:
    run = theatre(with_cage=True, back=True).play(duration_s=0.6, method="algorithm1")
    cage = run.outputs[-1].objects[1]
    assert cage.state is TrackState.LOST
    assert cage.reason == "not initialised: 3 of 4 tags seen"
    assert cage.T_cam_object is None
    assert run.outputs[-1].objects[0].state is TrackState.TRACKED


@pytest.mark.parametrize("method", ["multiart", "single"])
def test_baselines_without_odometry_lag_and_do_not_bridge(theatre: Make, method: str) -> None:
    run = theatre(hidden=lambda t, _: t > 0.5).play(duration_s=1.5, method=method)
    assert run.of(TrackState.TRACKED)
    assert not run.of(TrackState.BRIDGED)
    assert run.outputs[-1].objects[0].state is TrackState.LOST


@pytest.mark.parametrize("hidden", [briefly, lambda *_: False], ids=["out of sight", "in sight"])
def test_an_unflagged_jump_of_the_odometry_is_not_seen(theatre: Make, hidden: Any) -> None:
    run = theatre(hidden=hidden, jumps={200: np.array([0.04, 0.02, 0, 0, 0, 0.015])}).play(
        duration_s=1.8
    )
    assert largest_step_m(run) < 0.005
    assert max(r.off_m for r in run.rows) < 0.008


def test_a_new_world_of_the_odometry_is_lost_until_the_next_fix(theatre: Make) -> None:
    run = theatre(hidden=briefly, resets=frozenset({200})).play(duration_s=1.8)
    lost = [r for r in run.of(TrackState.LOST) if r.time_s > 0.3]
    assert lost[0].time_s == pytest.approx(1.0)
    assert lost[-1].time_s < 1.55
    assert "new world" in lost[0].reason
    assert run.outputs[-1].objects[0].state is TrackState.TRACKED
    assert largest_step_m(run) < 0.010


def test_without_motion_a_fix_counts_and_nothing_is_bridged(theatre: Make) -> None:
    in_sight = theatre(motion_stops_s=0.6).play(duration_s=1.4)
    assert in_sight.outputs[-1].objects[0].state is TrackState.TRACKED
    assert in_sight.rmse_m(TrackState.TRACKED) < 0.005
    gone = theatre(motion_stops_s=0.6, hidden=lambda t, _: t > 0.5).play(duration_s=1.8)
    last = gone.outputs[-1].objects[0]
    assert last.state is TrackState.LOST
    assert "no motion for 1.2 s" in last.reason


def test_a_mobile_object_is_compensated_in_sight_and_stale_at_once(theatre: Make) -> None:
    run = theatre(motion="mobile", hidden=lambda t, _: t > 0.6).play(duration_s=1.7)
    assert run.rmse_m(TrackState.TRACKED) < 0.004
    assert not run.of(TrackState.BRIDGED)
    stale = run.of(TrackState.STALE)
    assert stale[0].time_s < 0.9
    shown = [out.objects[0] for out in run.outputs]
    held = [o.T_cam_object for o in shown if o.state is TrackState.STALE and o.T_cam_object]
    assert held[0].distance_to(held[-1])[0] == pytest.approx(0.0, abs=1e-9)
    assert run.outputs[-1].objects[0].state is TrackState.LOST


def test_the_delay_of_the_images_is_measured_not_mistaken_for_loss(theatre: Make) -> None:
    run = theatre(image_ms=400).play(duration_s=1.2)
    assert {r.state for r in run.rows if r.time_s > 0.45} == {TrackState.TRACKED}
    assert run.rmse_m(TrackState.TRACKED) < 0.004
