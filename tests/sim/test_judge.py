import numpy as np
import pytest

from sim.judge import Judge
from sim.truth import TruthSample, encode_truth
from spatial.pose import Pose
from spatial.tracked import TrackedObject, TrackedObjects, TrackState
from wire.clock import VirtualClock
from wire.codec import encode
from wire.keys import Keys
from wire.memory_bus import MemoryBus

KEYS = Keys()


def test_the_judge_pairs_truth_and_tracker_on_the_bus_and_counts_garbage() -> None:
    clock = VirtualClock()
    with MemoryBus() as bus:
        judge = Judge(bus, keys=KEYS, clock=clock)
        bus.publish(KEYS.truth("poses"), b"garbage", schema="?")
        bus.publish(KEYS.tracked, b"\xff\xff", schema="?")
        for _ in range(11):
            stamp_ns = clock.now_ns()
            true = TruthSample(
                stamp_ns, {"hc": Pose.identity(), "object/cage": Pose.translated(0.0, 0.0, 0.8)}
            )
            message = encode_truth(true)
            bus.publish(KEYS.truth("poses"), message.payload, schema=message.schema)
            item = TrackedObject(
                slug="cage",
                revision=1,
                camera="hc",
                state=TrackState.TRACKED,
                T_cam_object=Pose.translated(0.003, 0.0, 0.8),
                xi_w_cam_cam=np.zeros(6),
                covariance=np.eye(6),
                seen_ns=stamp_ns - 90_000_000,
                motion_ns=stamp_ns,
                reset_count=0,
                reason="",
            )
            said = encode(TrackedObjects(stamp_ns, (item,)))
            clock.advance(5_000_000)
            bus.publish(KEYS.tracked, said.payload, schema=said.schema)
            judge.tick(clock.now_ns())
        figures = judge.figures()
    assert figures["refused"] == 2
    assert figures["unmatched"] == 0
    assert figures["tracker_hz"] == pytest.approx(200.0)
    assert figures["objects"]["cage"]["rmse_in_sight_m"] == pytest.approx(0.003)
    assert figures["objects"]["cage"]["predicted_ms"]["p50"] == pytest.approx(5.0, abs=0.5)
