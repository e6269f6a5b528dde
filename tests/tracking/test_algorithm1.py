import math

import numpy as np
import pytest

from spatial.errors import InputError
from spatial.frames import Cam, Object, Tag, Target, W
from spatial.pose import Pose
from tracking.algorithm1 import Memory, Task, compensated, step
from tracking.consensus import consensus
from tracking.layout import SAVED, Estimate, MarkerLayout
from tracking.marker_pose import PlanarPose

X, Y1, Y2 = ("tag36h11", 0), ("tag36h11", 1), ("tag36h11", 2)
TASK = Task(X, (Y1, Y2), Pose.translated(0.01, 0.02, 0.03))
Ts_x_tag: dict[tuple[str, int], Pose[Tag, Tag]] = {
    X: Pose.identity(),
    Y1: Pose.exp([0.1, 0, 0, 0, 0.3, 0]),
    Y2: Pose.exp([0, 0.1, 0, 0.2, 0, 0.1]),
}
CAM0, CAM1 = Pose[W, Cam].exp([0.1, 0, 0, 0, 0, 0]), Pose[W, Cam].exp([0.13, 0.02, 0, 0, 0.1, 0])
T_w_x = Pose[W, Tag].exp([0, 0, 0.8, 0.1, 0.2, 0.3])


def tags(
    *keys: tuple[str, int], T_w_cam: Pose[W, Cam] = CAM0, error_px: float = 0.1
) -> dict[tuple[str, int], PlanarPose]:
    return {
        key: PlanarPose(T_w_cam.inverse() @ T_w_x @ Ts_x_tag[key], error_px + 0.01 * key[1])
        for key in keys
    }


def truth(T_w_cam: Pose[W, Cam]) -> Pose[Cam, Target]:
    return Pose((T_w_cam.inverse() @ T_w_x).matrix)


def begun() -> Memory:
    return step(TASK, Memory(), tags=tags(X, Y1, Y2), T_w_cam=CAM0)


def assert_near(memory: Memory, T_w_cam: Pose[W, Cam]) -> None:
    assert memory.T_cam_x is not None
    assert memory.T_cam_x.distance_to(truth(T_w_cam)) == pytest.approx((0, 0), abs=1e-6)


def test_it_waits_for_all_tags_in_one_image() -> None:
    memory = step(TASK, Memory(), tags=tags(X, Y2), T_w_cam=CAM0)
    assert (memory.branch, memory.seen, memory.layout, memory.T_cam_x) == ("waiting", 2, None, None)


def test_it_initialises_when_all_are_seen() -> None:
    memory = begun()
    assert (memory.branch, memory.supporters) == ("init", 3)
    assert_near(memory, CAM0)
    assert memory.layout is not None
    assert set(memory.layout.Ts_y_x) == {Y1, Y2}


@pytest.mark.parametrize(
    ("keys", "branch", "supporters"),
    [
        ((X, Y1, Y2), "all", 3),
        ((X, Y2), "with_x", 2),
        ((Y1, Y2), "without_x", 2),
        ((Y2,), "without_x", 1),
    ],
)
def test_branches_with_tags(
    keys: tuple[tuple[str, int], ...], branch: str, supporters: int
) -> None:
    memory = step(TASK, begun(), tags=tags(*keys, T_w_cam=CAM1), T_w_cam=CAM1)
    assert (memory.branch, memory.supporters, memory.fixed) == (branch, supporters, True)
    assert_near(memory, CAM1)


def test_only_a_whole_image_updates_the_layout() -> None:
    start = begun()
    assert start.layout is not None
    part = step(TASK, start, tags=tags(X, Y1), T_w_cam=CAM0)
    assert part.layout is start.layout
    whole = step(TASK, part, tags=tags(X, Y1, Y2), T_w_cam=CAM0)
    assert whole.layout is not None
    assert [len(whole.layout.saved[y]) for y in (Y1, Y2)] == [2, 2]
    for _ in range(2 * SAVED):
        whole = step(TASK, whole, tags=tags(X, Y1, Y2), T_w_cam=CAM0)
    assert whole.layout is not None
    assert len(whole.layout.saved[Y1]) == SAVED


def test_without_tags_equation_2_chains_from_the_uncompensated_pose() -> None:
    gone = step(TASK, begun(), tags={}, T_w_cam=CAM1)
    assert (gone.branch, gone.fixed) == ("eq2", False)
    assert_near(gone, CAM1)
    assert_near(step(TASK, gone, tags={}, T_w_cam=CAM0), CAM0)


def test_without_odometry_the_pose_stays_as_it_was() -> None:
    gone = step(TASK, begun(), tags={}, T_w_cam=None)
    assert gone.branch == "held"
    assert_near(gone, CAM0)


def test_equation_3_extrapolates_the_whole_delay_by_the_twist() -> None:
    xi = np.array([0.3, -0.1, 0.05, 0.1, 0.2, -0.3])
    T_cam_object = compensated(
        truth(CAM0), xi_w_cam_cam=xi, delay_s=0.4, T_x_object=TASK.T_x_object
    )
    later = CAM0 @ Pose[Cam, Cam].exp(0.4 * xi)
    expected: Pose[Cam, Object] = truth(later) @ TASK.T_x_object
    assert T_cam_object.distance_to(expected) == pytest.approx((0, 0), abs=1e-6)


def test_a_flipped_tag_is_outvoted() -> None:
    seen = tags(X, Y1, Y2)
    flip = Pose[Tag, Tag].exp([0, 0, 0, 0.9, 0, 0])
    seen[Y1] = PlanarPose(seen[Y1].T_cam_tag @ flip, 0.01)
    memory = step(TASK, begun(), tags=seen, T_w_cam=CAM0)
    assert memory.supporters == 2
    assert_near(memory, CAM0)


def test_consensus_passes_one_through_and_settles_two_by_reprojection() -> None:
    a, b = Pose[Cam, Tag].translated(0, 0, 1), Pose[Cam, Tag].translated(0, 0, 2)
    assert consensus([a], reprojections_px=[9.0]).pose.distance_to(a) == pytest.approx((0, 0))
    assert consensus([a, b], reprojections_px=[0.4, 0.2]).supporters == (1,)
    assert consensus([a, b], reprojections_px=[0.2, 0.4]).supporters == (0,)
    near = Pose[Cam, Tag].exp([0.01, 0, 0, 0, 0, 0.1])
    agreed = consensus([Pose.identity(), near, b], reprojections_px=[9.0, 9.0, 0.1])
    assert agreed.supporters == (0, 1)
    assert agreed.pose.translation == pytest.approx(near.translation / 2)
    assert agreed.pose.distance_to(Pose.identity())[1] == pytest.approx(0.05)
    with pytest.raises(InputError, match="0 candidates"):
        consensus([], reprojections_px=[])


def test_a_layout_outlier_is_outvoted_by_saved_estimates() -> None:
    good = Estimate(Pose.translated(0.1, 0, 0), 0.2)
    bad = Estimate(Pose.exp([0.4, 0, 0, 0, 0, math.pi / 2]), 0.1)
    layout = MarkerLayout.initialised({Y1: good}).updated({Y1: good}).updated({Y1: bad})
    assert layout.Ts_y_x[Y1].distance_to(good.T_y_x) == pytest.approx((0, 0), abs=1e-9)
