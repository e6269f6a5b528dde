"""A scenario: what a simulated session is like, in one file beside the world it plays in.

    name, world, operator, vio, shade, loose, calibration_error, processing_ms
    [sway]               slow_m, fast_m              amplitudes, where they differ from the world's
    [clock]              offset_s, skew_ppm          the site's clock, where site.toml measures it
    [errors]             how far true values lie from the nominal ones of site.toml (ranges)
    [stream.NAME]        delay_ms, jitter_ms, loss, reorder    NAME is one of STREAMS

True values are drawn per seed around the nominal ones: `true = nominal @ exp(error)`, the error's
length uniform within its range, its direction uniform on the sphere, all of it scaled by
`calibration_error`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from scene.table import TableReader, read_toml
from sim.outlet import StreamDelay
from sim.vio import LEVELS
from spatial.errors import InputError, unknown

SCENARIOS = Path(__file__).parent / "scenarios"
"""Folder of the scenarios that come with the simulator."""

STREAMS = {
    # exposure, read-out, rectification, transfer, encoding, radio
    "image": StreamDelay(90.0, 6.0),
    "video": StreamDelay(60.0, 5.0),
    "vio": StreamDelay(10.0, 2.0),
    "joints": StreamDelay(3.0, 0.5),
    "wrench": StreamDelay(3.0, 0.5),
}
"""Streams with a delay of their own, and the delay where a scenario names none."""
MAX_DELAY_MS = 10_000.0
"""Longest delay that can be asked for [ms]: what waits is kept."""
OPERATORS = ("pick", "idle")
"""Plans a scripted operator knows."""

Range = tuple[float, float]


@dataclass(frozen=True, slots=True)
class ErrorRanges:
    """Least and greatest length of each error of calibration."""

    focal: Range = (0.001, 0.002)
    """Relative error of the focal length [1]."""
    principal_px: Range = (0.3, 1.0)
    """Shift of the principal point [px]."""
    hand_eye_m: Range = (0.002, 0.005)
    """Shift of a camera on the tool [m]."""
    hand_eye_deg: Range = (0.3, 0.5)
    """Turn of a camera on the tool [deg]."""
    base_m: Range = (0.002, 0.005)
    """Shift of a camera on the base [m]."""
    base_deg: Range = (0.1, 0.3)
    """Turn of a camera on the base [deg]."""
    tag_m: Range = (0.0005, 0.001)
    """Shift of a marker on its object [m]."""
    tag_deg: Range = (0.0, 0.2)
    """Turn of a marker on its object [deg]."""


@dataclass(frozen=True, slots=True)
class Scenario:
    """What a simulated session is like."""

    name: str
    """Name of the scenario."""
    world: str
    """World it plays in, a file of `sim/worlds`."""
    operator: str = "idle"
    """Plan of the scripted operator, one of `OPERATORS`."""
    vio: str = "nominal"
    """Quality level of the odometry."""
    shade: bool = True
    """Whether hard shadows lie across tags."""
    loose: bool = True
    """Whether contact can move what the world calls free; else everything stays in place."""
    slow_sway_m: float | None = None
    """Amplitude of the cable's swing [m]; the world's where left out."""
    fast_sway_m: float | None = None
    """Amplitude of the platform's rocking [m]; the world's where left out."""
    calibration_error: float = 1.0
    """Scales every error of calibration; 0 makes the nominal values true."""
    processing_ms: float = 15.0
    """Time a tracker takes for an image, in lock-step [ms]."""
    clock_offset_s: float = 60.0
    """The site's clock is off by at most this [s], where site.toml says it is measured."""
    clock_skew_ppm: float = 20.0
    """... and drifts by at most this [1e-6]."""
    errors: ErrorRanges = field(default_factory=ErrorRanges)
    """How far true values lie from the nominal ones."""
    streams: Mapping[str, StreamDelay] = field(default_factory=lambda: dict(STREAMS))
    """Delay, jitter and loss by stream."""

    @property
    def motion_delay_ms(self) -> float:
        """Mean delay of the odometry [ms]: `simulated_motion_delay_ms` of `demo`."""
        return self.streams["vio"].delay_ms

    def with_delays(self, overrides: Mapping[str, float]) -> Scenario:
        """Return the scenario with other mean delays [ms] by stream.

        Raises:
            InputError: an unknown stream or an impossible delay.
        """
        streams = dict(self.streams)
        for name, delay_ms in overrides.items():
            if name not in streams:
                raise InputError(unknown("stream", name, streams))
            streams[name] = replace(streams[name], delay_ms=delay_ms)
        return replace(self, streams=streams)


def load_scenario(name: str, *, folder: Path = SCENARIOS) -> Scenario:
    """Return the scenario of file `folder/name.toml`.

    Raises:
        InputError: no scenario of that name; those that exist are named.
        FileInputError: a key that is missing, unknown or out of range.
    """
    available = sorted(p.stem for p in folder.glob("*.toml"))
    if name not in available:
        raise InputError(unknown("scenario", name, available))
    path = folder / f"{name}.toml"
    reader = TableReader(read_toml(path), path=path)
    clock = reader.table("clock", optional=True)
    sway = reader.table("sway", optional=True)
    scenario = Scenario(
        name=reader.text("name"),
        world=reader.text("world"),
        operator=reader.choice("operator", OPERATORS, default="idle"),
        vio=reader.choice("vio", tuple(LEVELS), default="nominal"),
        shade=reader.flag("shade", default=True),
        loose=reader.flag("loose", default=True),
        slow_sway_m=sway.number("slow_m", least=0.0) if "slow_m" in sway else None,
        fast_sway_m=sway.number("fast_m", least=0.0) if "fast_m" in sway else None,
        calibration_error=reader.number("calibration_error", default=1.0, least=0.0),
        processing_ms=reader.number("processing_ms", default=15.0, least=0.0),
        clock_offset_s=clock.number("offset_s", default=60.0, least=0.0),
        clock_skew_ppm=clock.number("skew_ppm", default=20.0, least=0.0),
        errors=_errors(reader.table("errors", optional=True)),
        streams=_streams(reader.table("stream", optional=True)),
    )
    clock.finish()
    sway.finish()
    reader.finish()
    return scenario


def parse_delays(options: tuple[str, ...]) -> dict[str, float]:
    """Return mean delays [ms] by stream, of options `STREAM=MS`.

    Raises:
        InputError: not of that form, an unknown stream, or not a time.
    """
    delays: dict[str, float] = {}
    for option in options:
        name, _, text = option.partition("=")
        if name not in STREAMS:
            raise InputError(unknown("stream", name, STREAMS))
        try:
            delay_ms = float(text)
        except ValueError:
            delay_ms = math.nan
        if not 0.0 <= delay_ms <= MAX_DELAY_MS:
            msg = f"a delay is STREAM=MS with 0 to {MAX_DELAY_MS:g} milliseconds, got {option!r}"
            raise InputError(msg)
        delays[name] = delay_ms
    return delays


def _errors(reader: TableReader) -> ErrorRanges:
    standard = ErrorRanges()

    def pair(name: str, default: Range) -> Range:
        low, high = reader.numbers(name, 2, default=default)
        if not 0.0 <= low <= high:
            reader.fail(name, f"{name} must be [least, greatest] from 0 up, got {[low, high]}")
        return low, high

    ranges = ErrorRanges(
        focal=pair("focal", standard.focal),
        principal_px=pair("principal_px", standard.principal_px),
        hand_eye_m=pair("hand_eye_m", standard.hand_eye_m),
        hand_eye_deg=pair("hand_eye_deg", standard.hand_eye_deg),
        base_m=pair("base_m", standard.base_m),
        base_deg=pair("base_deg", standard.base_deg),
        tag_m=pair("tag_m", standard.tag_m),
        tag_deg=pair("tag_deg", standard.tag_deg),
    )
    reader.finish()
    return ranges


def _streams(reader: TableReader) -> dict[str, StreamDelay]:
    streams = {
        name: reader.table(name, optional=True).guarded(partial(_stream, standard=standard))
        for name, standard in STREAMS.items()
    }
    reader.finish()
    return streams


def _stream(reader: TableReader, *, standard: StreamDelay) -> StreamDelay:
    shape = StreamDelay(
        delay_ms=reader.number("delay_ms", default=standard.delay_ms),
        jitter_ms=reader.number("jitter_ms", default=standard.jitter_ms),
        loss=reader.number("loss", default=standard.loss),
        reorder=reader.flag("reorder", default=standard.reorder),
    )
    reader.finish()
    return shape
