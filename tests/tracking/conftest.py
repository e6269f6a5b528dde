"""The stage the tracker is tried on."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from spatial.frames import Object, W
from spatial.marker import MarkedObject
from spatial.pose import Pose
from tests.tracking.theatre import Odometry, Theatre, cage, plate


@pytest.fixture(scope="session")
def theatre() -> Callable[..., Theatre]:
    """Make a theatre: a plate below the camera, and a cage beside it when asked."""

    def make(
        *,
        with_cage: bool = False,
        back: bool = False,
        motion: str = "static",
        jumps: dict[int, np.ndarray] | None = None,
        resets: frozenset[int] = frozenset(),
        **options: object,
    ) -> Theatre:
        objects: tuple[MarkedObject, ...] = (plate(motion=motion),)
        poses: dict[str, Pose[W, Object]] = {"plate": Pose.translated(0.02, -0.03, 0.0)}
        if with_cage:
            objects += (cage(back=back),)
            poses["cage"] = Pose.translated(-0.26, 0.05, 0.0)
        odometry = Odometry(jumps=jumps or {}, resets=resets)
        return Theatre(objects, poses, odometry=odometry, **options)  # type: ignore[arg-type] # options of a test

    return make
