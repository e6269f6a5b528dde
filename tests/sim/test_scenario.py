from pathlib import Path

import pytest

from sim.scenario import SCENARIOS, load_scenario, parse_delays
from spatial.errors import FileInputError, InputError


def written(folder: Path, text: str) -> Path:
    (folder / "mine.toml").write_text('name = "mine"\nworld = "yard"\n' + text)
    return folder


@pytest.mark.parametrize("name", [p.stem for p in SCENARIOS.glob("*.toml")])
def test_every_scenario_loads_and_bears_the_name_of_its_file(name: str) -> None:
    assert load_scenario(name).name == name


def test_pick_has_the_latencies_of_the_budget() -> None:
    streams = load_scenario("pick").streams
    assert streams["image"].delay_ms == 90.0
    assert streams["vio"].delay_ms == 10.0
    assert streams["joints"].delay_ms == 3.0


def test_an_unknown_scenario_names_those_that_exist() -> None:
    with pytest.raises(InputError, match=r"unknown scenario 'pikc'; available: .*pick"):
        load_scenario("pikc")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('vio = "superb"', "bad, degraded, good, nominal"),
        ("calibration_error = -1.0", "calibration_error"),
        ("speed = 3", "unknown key 'speed'"),
        ("[errors]\nfocal = [0.2, 0.1]", r"errors.focal"),
        ("[stream.smell]\ndelay_ms = 3.0", "unknown key 'smell'; available: image"),
        ("[stream.vio]\ndelay_ms = -3.0", r"stream.vio"),
        ("[stream.vio]\nloss = 2.0", r"loss must lie in 0 to 1"),
        ("[stream.vio]\ndelay = 3.0", r"unknown key 'delay'"),
        ("vio = \nshade = true", "line 3"),
    ],
)
def test_a_broken_scenario_names_key_and_file(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(FileInputError, match=message) as caught:
        load_scenario("mine", folder=written(tmp_path, text))
    assert "mine.toml" in str(caught.value)


def test_delays_are_overridden_by_stream_and_only_those() -> None:
    pick = load_scenario("pick")
    changed = pick.with_delays(parse_delays(("image=490", "vio=12.5")))
    assert changed.streams["image"].delay_ms == 490.0
    assert changed.streams["image"].jitter_ms == pick.streams["image"].jitter_ms
    assert changed.streams["vio"].delay_ms == 12.5
    assert changed.streams["joints"] == pick.streams["joints"]


@pytest.mark.parametrize("option", ["smell=3", "vio", "vio=", "vio=-1", "vio=nan", "vio=soon"])
def test_impossible_delay_options_are_refused(option: str) -> None:
    with pytest.raises(InputError, match=r"unknown stream|STREAM=MS"):
        parse_delays((option,))
