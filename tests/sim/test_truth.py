from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from scene.site import Site, SiteCamera
from sim.scenario import load_scenario
from sim.truth import T_cam_object_of, TruthSample, blend, true_cameras, true_markers
from spatial.camera import PinholeCamera
from spatial.frames import Frame, W
from spatial.marker import MarkedObject, Marker
from spatial.pose import Pose

PICK = load_scenario("pick")
NOMINAL = PinholeCamera(1280, 960, 1078.0, 1078.0, 639.5, 479.5)
PLATE = MarkedObject(
    "plate",
    1,
    ("tag36h11", 0),
    tuple(Marker("tag36h11", i, 0.08, Pose.translated(0.1 * i, 0.0, 0.0)) for i in range(5)),
)


def site() -> Site:
    cameras = {
        name: SiteCamera(name, NOMINAL, parent, Pose.translated(0.0, 0.1, 0.2), 25.0)
        for name, parent in (("hc", "tcp"), ("mako", "base"))
    }
    return cast("Site", SimpleNamespace(path=Path("site.toml"), cameras=cameras))


@pytest.mark.parametrize("seed", range(5))
def test_true_cameras_lie_within_the_ranges_around_the_nominal_ones(seed: int) -> None:
    true = true_cameras(site(), scenario=PICK, seed=seed)
    stretch = true["hc"].intrinsics.fx / NOMINAL.fx - 1.0
    assert 0.001 <= abs(stretch) <= 0.002
    shift = np.hypot(true["hc"].intrinsics.cx - 639.5, true["hc"].intrinsics.cy - 479.5)
    assert 0.3 <= shift <= 1.0
    for name, turn_deg in (("hc", (0.3, 0.5)), ("mako", (0.1, 0.3))):
        nominal: Pose[Frame, Frame] = Pose(site().cameras[name].T_parent_cam.matrix)
        real: Pose[Frame, Frame] = Pose(true[name].T_parent_cam.matrix)
        far, turn = nominal.distance_to(real)
        assert 0.0019 <= far <= 0.0051
        assert turn_deg[0] <= np.degrees(turn) <= turn_deg[1]


def test_true_markers_lie_within_their_range_each_with_an_error_of_its_own() -> None:
    true = true_markers([PLATE], scenario=PICK, seed=1)
    errors = []
    for nominal, real in zip(PLATE.markers, true, strict=True):
        assert real.key == nominal.key
        far, turn = nominal.T_object_marker.distance_to(real.T_object_marker)
        assert 0.00049 <= far <= 0.00101
        assert np.degrees(turn) <= 0.2
        errors.append(far)
    assert len(set(errors)) == 5


def test_without_calibration_error_the_nominal_values_are_true() -> None:
    perfect = replace(PICK, calibration_error=0.0)
    true = true_cameras(site(), scenario=perfect, seed=1)
    assert true["hc"].intrinsics == NOMINAL
    assert np.array_equal(true["mako"].T_parent_cam.matrix, Pose.translated(0.0, 0.1, 0.2).matrix)
    for nominal, real in zip(
        PLATE.markers, true_markers([PLATE], scenario=perfect, seed=1), strict=True
    ):
        assert np.array_equal(nominal.T_object_marker.matrix, real.T_object_marker.matrix)


def test_a_seed_draws_the_same_whatever_else_is_drawn() -> None:
    alone = true_markers([PLATE], scenario=PICK, seed=3)
    other = replace(PLATE, slug="other")
    among = true_markers([other, PLATE], scenario=PICK, seed=3)[5:]
    for one, two in zip(alone, among, strict=True):
        assert np.array_equal(one.T_object_marker.matrix, two.T_object_marker.matrix)
    again = true_markers([PLATE], scenario=PICK, seed=4)
    assert not np.array_equal(alone[0].T_object_marker.matrix, again[0].T_object_marker.matrix)


def test_an_object_in_a_camera_is_what_both_poses_say() -> None:
    T_w_cam: Pose[W, Frame] = Pose[W, Frame].exp((0.1, 0.2, 2.0, 0.3, 0.1, 0.0))
    target: Pose[W, Frame] = T_w_cam @ Pose.translated(0.0, 0.0, 0.7)
    sample = TruthSample(5, {"hc": T_w_cam, "object/plate": target})
    pose = T_cam_object_of(sample, camera="hc", slug="plate")
    assert pose is not None
    assert np.allclose(pose.translation, (0.0, 0.0, 0.7))
    assert T_cam_object_of(sample, camera="mako", slug="plate") is None


def test_truth_between_two_samples_moves_evenly() -> None:
    older = TruthSample(0, {"hc": Pose.identity()})
    younger = TruthSample(10, {"hc": Pose.translated(1.0, 0.0, 0.0), "new": Pose.identity()})
    half = blend(older, younger, 0.3)
    assert half.stamp_ns == 3
    assert set(half.Ts_w) == {"hc"}
    assert half.Ts_w["hc"].translation[0] == pytest.approx(0.3)
