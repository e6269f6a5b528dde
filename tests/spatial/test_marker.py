"""Corners of markers."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from spatial.errors import FileInputError, StampError, unknown
from spatial.marker import Marker
from spatial.pose import Pose


def test_corners_run_tl_tr_br_bl_seen_from_the_printed_side() -> None:
    marker = Marker("tag36h11", 4, 0.08, Pose.translated(0.0, 0.0, 0.1))
    tl, tr, br, bl = marker.corners_tag
    assert (tl[0], tl[1]) == (-0.04, 0.04)
    np.testing.assert_allclose(tr - tl, [0.08, 0.0, 0.0])
    np.testing.assert_allclose(bl - tl, [0.0, -0.08, 0.0])
    np.testing.assert_allclose(np.cross(tr - tl, bl - tl)[2], -(0.08**2))  # z is out of the face
    np.testing.assert_allclose(tl + br, tr + bl)
    np.testing.assert_allclose(marker.corners_object - marker.corners_tag, [[0.0, 0.0, 0.1]] * 4)
    assert marker.key == ("tag36h11", 4)


def test_errors_say_what_was_wrong_and_what_there_is() -> None:
    text = unknown("object", "peq", ["peg", "cage"])
    assert text == "unknown object 'peq'; available: cage, peg"
    assert unknown("object", "x", []).endswith("available: none")
    error = FileInputError("bad", path=Path("a.toml"), key="k[0].b", line=3)
    assert str(error) == "bad (key k[0].b, line 3, a.toml)"
    late = StampError("motion", requested_ns=5, available_ns=(7, 9))
    assert str(late) == "motion at 5 ns: stored is 7 to 9 ns"
