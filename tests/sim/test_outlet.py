import numpy as np
import pytest

from sim.outlet import Outgoing, Outlet, StreamDelay
from spatial.errors import InputError

MS = 1_000_000


def run(
    shape: StreamDelay, *, seed: int = 1, count: int = 500, period_ms: int = 5
) -> list[Outgoing]:
    got: list[Outgoing] = []
    outlet = Outlet({"vio": shape}, seed=seed, sink=got.append)
    for i in range(count):
        now_ns = i * period_ms * MS
        outlet.put("vio", key="k", payload=str(i).encode(), schema="s", captured_ns=now_ns)
        outlet.flush(now_ns)
    outlet.flush(10**15)
    return got


def lateness_ms(messages: list[Outgoing], *, period_ms: int = 5) -> np.ndarray:
    return np.array([m.due_ns / MS - period_ms * int(m.payload) for m in messages])


def test_mean_and_jitter_are_what_was_asked_for() -> None:
    late = lateness_ms(
        run(StreamDelay(90.0, 8.0, reorder=True), count=4000, period_ms=40), period_ms=40
    )
    assert late.mean() == pytest.approx(90.0, abs=0.5)
    assert late.std() == pytest.approx(8.0, rel=0.05)
    assert np.abs(late - 90.0).max() <= 24.0 + 1e-6


def test_nothing_leaves_before_it_is_due() -> None:
    got: list[Outgoing] = []
    outlet = Outlet({"a": StreamDelay(10.0)}, seed=0, sink=got.append)
    outlet.put("a", key="k", payload=b"", schema="s", captured_ns=0)
    assert outlet.next_due_ns == 10 * MS
    assert outlet.flush(10 * MS - 1) == 0
    assert outlet.flush(10 * MS) == 1
    assert outlet.next_due_ns is None


def test_an_ordered_stream_keeps_its_order_and_a_reordered_one_does_not() -> None:
    ordered = [int(m.payload) for m in run(StreamDelay(20.0, 10.0))]
    mixed = [int(m.payload) for m in run(StreamDelay(20.0, 10.0, reorder=True))]
    assert ordered == sorted(ordered) == list(range(500))
    assert mixed != sorted(mixed)
    assert sorted(mixed) == ordered


def test_loss_is_as_frequent_as_asked() -> None:
    assert len(run(StreamDelay(loss=0.2), count=4000)) == pytest.approx(3200, abs=100)
    assert run(StreamDelay(loss=1.0)) == []


def test_the_same_seed_gives_the_same_stream_and_streams_do_not_disturb_each_other() -> None:
    shape = StreamDelay(20.0, 5.0, 0.1)
    alone = [(m.due_ns, m.payload) for m in run(shape, seed=3)]
    assert alone == [(m.due_ns, m.payload) for m in run(shape, seed=3)]
    assert alone != [(m.due_ns, m.payload) for m in run(shape, seed=4)]
    got: list[Outgoing] = []
    outlet = Outlet({"vio": shape, "joints": shape}, seed=3, sink=got.append)
    for i in range(500):
        outlet.put("joints", key="j", payload=b"", schema="s", captured_ns=i * 5 * MS)
        outlet.put("vio", key="k", payload=str(i).encode(), schema="s", captured_ns=i * 5 * MS)
    outlet.flush(10**15)
    assert [(m.due_ns, m.payload) for m in got if m.stream == "vio"] == alone


def test_an_unnamed_stream_passes_at_once() -> None:
    got: list[Outgoing] = []
    outlet = Outlet({}, seed=0, sink=got.append)
    outlet.put("health", key="k", payload=b"x", schema="s", captured_ns=7)
    outlet.flush(7)
    assert [m.due_ns for m in got] == [7]


@pytest.mark.parametrize(
    ("delay_ms", "jitter_ms", "loss"), [(-1.0, 0, 0), (0, float("nan"), 0), (0, 0, 1.5)]
)
def test_impossible_delays_are_refused(delay_ms: float, jitter_ms: float, loss: float) -> None:
    with pytest.raises(InputError, match="must"):
        StreamDelay(delay_ms, jitter_ms, loss)
