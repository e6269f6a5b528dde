"""Laws of the stamped buffer against a plain model of it."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from spatial.errors import StampError
from spatial.stamp import Stamped, StampedBuffer, nanoseconds, seconds

SPAN_NS = 100
stamps = st.lists(st.integers(0, 400), min_size=1, max_size=40)


def filled(order: list[int]) -> StampedBuffer[float]:
    buffer: StampedBuffer[float] = StampedBuffer(name="test", span_ns=SPAN_NS)
    for stamp in order:
        buffer.put(stamp, 2.0 * stamp)
    return buffer


def blend(a: float, b: float, share: float) -> float:
    return (1.0 - share) * a + share * b


@given(stamps)
def test_it_holds_exactly_the_span_behind_the_newest_in_order(order: list[int]) -> None:
    held = [item.stamp_ns for item in filled(order)]
    expected: set[int] = set()
    for stamp in order:  # what is too old at its arrival is never taken
        newest = max(expected, default=stamp)
        expected = {s for s in expected | {stamp} if s >= max(newest, stamp) - SPAN_NS}
    assert held == sorted(expected)


@given(stamps)
def test_order_of_arrival_does_not_matter_within_the_span(order: list[int]) -> None:
    near = [stamp % SPAN_NS for stamp in order]
    arrived, in_order = filled(near), filled(sorted(near))
    assert [(i.stamp_ns, i.value) for i in arrived] == [(i.stamp_ns, i.value) for i in in_order]


@given(stamps, st.integers(-50, 450))
def test_lookups_agree_with_the_list(order: list[int], stamp: int) -> None:
    buffer = filled(order)
    held = [item.stamp_ns for item in buffer]
    assert buffer.interval_ns == (held[0], held[-1])
    assert len(buffer) == len(held)
    assert [item.stamp_ns for item in buffer.after(stamp)] == [s for s in held if s > stamp]
    before = [s for s in held if s <= stamp]
    if before:
        assert buffer.at_or_before(stamp).stamp_ns == before[-1]
    else:
        with pytest.raises(StampError):
            buffer.at_or_before(stamp)


@given(stamps, st.integers(-50, 450))
def test_interpolation_is_exact_for_a_line_and_never_extrapolates(
    order: list[int], stamp: int
) -> None:
    buffer = filled(order)
    low, high = buffer.interval_ns or (0, 0)
    if low <= stamp <= high:
        assert buffer.interpolate(stamp, blend) == pytest.approx(2.0 * stamp)
    else:
        with pytest.raises(StampError, match=f"{stamp} ns: stored is {low} to {high}") as caught:
            buffer.interpolate(stamp, blend)
        assert caught.value.available_ns == (low, high)


def test_repeated_and_too_late_values_are_refused() -> None:
    buffer = filled([500])
    assert not buffer.put(500, 0.0)
    assert not buffer.put(399, 0.0)
    assert buffer.put(400, 1.0)
    assert not buffer.put(400, 2.0)
    assert buffer.at_or_before(450).value == 1.0


def test_an_empty_buffer_says_so() -> None:
    buffer = filled([5])
    buffer.clear()
    assert len(buffer) == 0
    assert buffer.newest is None
    assert buffer.interval_ns is None
    with pytest.raises(StampError, match="test at 7 ns: nothing is stored"):
        buffer.interpolate(7, blend)


def test_a_copy_lives_on_its_own() -> None:
    buffer = filled([10, 20])
    twin = buffer.copy()
    buffer.put(30, 60.0)
    twin.put(25, 50.0)
    assert [item.stamp_ns for item in buffer] == [10, 20, 30]
    assert [item.stamp_ns for item in twin] == [10, 20, 25]


def test_newest_is_the_largest_stamp_not_the_last_arrival() -> None:
    newest = filled([30, 10, 20]).newest
    assert isinstance(newest, Stamped)
    assert newest.stamp_ns == 30


@given(st.integers(-(10**18), 10**18))
def test_seconds_and_nanoseconds_agree(duration_ns: int) -> None:
    assert nanoseconds(seconds(duration_ns)) == pytest.approx(duration_ns, rel=1e-15, abs=1)
