"""Names on the bus: as in the contract, matched as zenoh matches them."""

from __future__ import annotations

import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

from spatial.errors import InputError
from wire.keys import Keys, checked_expression, checked_key, is_command, is_truth, matches

CHUNKS = st.sampled_from(["a", "b", "cmd"])
KEYS = st.lists(CHUNKS, min_size=1, max_size=5).map("/".join)
PATTERNS = st.lists(st.sampled_from(["a", "b", "cmd", "*", "**"]), min_size=1, max_size=5)


def test_keys_are_those_of_the_contract() -> None:
    keys = Keys(session="live", site="sam")
    assert keys.image("hc") == "live/sam/camera/hc/image"
    assert keys.command("tool") == "live/sam/cmd/tool"
    assert keys.object("peg") == "live/station/objects/peg"
    assert keys.truth("poses") == "live/truth/poses"
    assert keys.all == "live/**"
    assert matches(keys.all_commands, keys.command("tool"))
    assert matches(keys.all_truth, keys.truth("poses"))
    assert not matches(keys.all_truth, keys.tracked)


def test_session_is_in_no_file_and_comes_back_with_another_prefix() -> None:
    topic = Keys().topic(Keys().vio)
    assert topic == "sam/vio"
    assert Keys(session="replay-7").of_topic(topic) == "replay-7/sam/vio"
    assert Keys(session="liv").topic(Keys().vio) is None


@pytest.mark.parametrize("bad", ["", "a b", "*", "a/b", "ü", "station", "truth"])
def test_site_that_is_no_chunk_is_refused(bad: str) -> None:
    with pytest.raises(InputError, match="name"):
        Keys(site=bad)


@pytest.mark.parametrize("bad", ["", "a//b", "/a", "a/", "a/*", "a/$*", "a#b", "a?b", "x" * 600])
def test_key_with_wildcards_or_holes_is_refused(bad: str) -> None:
    with pytest.raises(InputError, match="no key"):
        checked_key(bad)


def test_expression_with_a_wildcard_inside_a_chunk_is_refused() -> None:
    with pytest.raises(InputError, match="expression"):
        checked_expression("live/ca*")


def test_camera_name_can_not_smuggle_a_wildcard() -> None:
    with pytest.raises(InputError):
        Keys().image("**")


@given(PATTERNS.map("/".join), KEYS)
def test_matching_agrees_with_zenoh(pattern: str, key: str) -> None:
    expected = zenoh.KeyExpr.autocanonize(pattern).intersects(zenoh.KeyExpr(key))
    assert matches(pattern, key) is expected


def test_commands_and_truth_are_recognised_without_the_session() -> None:
    assert is_command("sam/cmd/tool")
    assert not is_command("sam/vio")
    assert is_truth("truth/poses")
    assert not is_truth("sam/tracked")
