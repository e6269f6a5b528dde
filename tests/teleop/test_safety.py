import math

import numpy as np
import pytest

from spatial.frames import Base, Tcp
from spatial.pose import Pose
from spatial.samples import ToolCommand
from teleop.safety import (
    TAKEN,
    GuardState,
    SafetyLimits,
    Verdict,
    accept,
    advance,
    initial_state,
)

LIMITS = SafetyLimits()
MS = 1_000_000
T_START: Pose[Base, Tcp] = Pose.translated(0.5, 0.0, 0.8)


def command(
    *,
    sequence: int = 1,
    stamp_ns: int = 0,
    ttl_ms: int = 200,
    T_base_tcp: Pose[Base, Tcp] = T_START,
) -> ToolCommand:
    return ToolCommand(stamp_ns, sequence, ttl_ms * MS, T_base_tcp)


def taken(state: GuardState, order: ToolCommand, *, now_ns: int = 0) -> GuardState:
    after, verdict = accept(LIMITS, state=state, command=order, now_ns=now_ns)
    assert verdict in TAKEN
    return after


def test_a_good_command_moves_the_goal_but_not_the_set_point_at_once() -> None:
    goal: Pose[Base, Tcp] = Pose.translated(0.6, 0.1, 0.7)
    state = taken(initial_state(T_START), command(T_base_tcp=goal))
    assert state.T_base_tcp is T_START
    assert state.T_base_tcp_goal is goal


@pytest.mark.parametrize(
    ("order", "now_ns", "verdict"),
    [
        (command(sequence=5), 0, Verdict.OLD_SEQUENCE),
        (command(sequence=4), 0, Verdict.OLD_SEQUENCE),
        (command(sequence=6), 200 * MS, Verdict.EXPIRED),
        (command(sequence=6, ttl_ms=60_000), 500 * MS, Verdict.EXPIRED),
        (command(sequence=6, stamp_ns=2000 * MS), 0, Verdict.FROM_FUTURE),
        (command(sequence=6, ttl_ms=0), 0, Verdict.NOT_FINITE),
        (
            command(sequence=6, T_base_tcp=Pose.translated(math.nan, 0.0, 0.0)),
            0,
            Verdict.NOT_FINITE,
        ),
    ],
)
def test_what_is_refused_leaves_the_state_as_it_was(
    order: ToolCommand, now_ns: int, verdict: Verdict
) -> None:
    state = taken(initial_state(T_START), command(sequence=5))
    after, said = accept(LIMITS, state=state, command=order, now_ns=now_ns)
    assert said is verdict
    assert after is state


def test_a_goal_outside_the_workspace_stops_at_its_edge() -> None:
    outside = command(T_base_tcp=Pose.translated(5.0, 0.0, -3.0))
    state, verdict = accept(LIMITS, state=initial_state(T_START), command=outside, now_ns=0)
    assert verdict is Verdict.SATURATED
    edge = [LIMITS.upper_base_m[0], 0.0, LIMITS.lower_base_m[2]]
    assert state.T_base_tcp_goal.translation.tolist() == edge


def test_the_set_point_never_exceeds_its_speeds_and_arrives() -> None:
    goal: Pose[Base, Tcp] = Pose.translated(0.4, 0.2, 0.7) @ Pose.exp((0, 0, 0, 0.3, -0.5, 0.2))
    state = initial_state(T_START)
    for i in range(400):
        now_ns = i * 10 * MS
        state = taken(state, command(sequence=i, stamp_ns=now_ns, T_base_tcp=goal), now_ns=now_ns)
        before = state.T_base_tcp
        state = advance(LIMITS, state=state, now_ns=now_ns, dt_s=0.01)
        far, turn = before.distance_to(state.T_base_tcp)
        # the path is a screw: its arc is a little longer than its chord
        assert far <= 1.01 * LIMITS.speed_m_s * 0.01 * 1.05
        assert turn <= 1.001 * LIMITS.turn_rad_s * 0.01
    assert np.allclose(state.T_base_tcp.matrix, goal.matrix)


def test_silence_holds_the_tool_where_it_is() -> None:
    far_goal: Pose[Base, Tcp] = Pose.translated(-0.5, 0.5, 0.4)
    state = taken(initial_state(T_START), command(T_base_tcp=far_goal))
    state = advance(LIMITS, state=state, now_ns=100 * MS, dt_s=0.1)
    where = state.T_base_tcp
    state = advance(LIMITS, state=state, now_ns=200 * MS, dt_s=0.1)
    assert state.holding
    assert state.T_base_tcp is where
    assert advance(LIMITS, state=state, now_ns=10**12, dt_s=1.0).T_base_tcp is where


def test_a_sender_that_restarts_is_heard_after_the_hold() -> None:
    state = taken(initial_state(T_START), command(sequence=900))
    state = advance(LIMITS, state=state, now_ns=300 * MS, dt_s=0.01)
    again = command(sequence=0, stamp_ns=300 * MS)
    assert not taken(state, again, now_ns=301 * MS).holding
