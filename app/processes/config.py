"""What each process is told; light, so that a supervisor imports nothing it does not run."""

from __future__ import annotations

import msgspec

from wire.keys import Keys


class BusConfig(msgspec.Struct, frozen=True, kw_only=True):
    """How to reach the others."""

    endpoint: str
    """Endpoint of the hub of this side."""
    site: str
    """Name of the site."""
    session: str = "live"
    """Session prefix."""
    truth_password: str | None = None
    """The run's password for ground truth; only site, recorder and metrics have it."""

    @property
    def keys(self) -> Keys:
        """Keys of the session."""
        return Keys(session=self.session, site=self.site)


class SiteFiles(msgspec.Struct, frozen=True, kw_only=True):
    """Files that describe a site."""

    site: str
    """Path of site.toml."""


class HubConfig(msgspec.Struct, frozen=True, kw_only=True):
    """The hub."""

    listen: str
    """Endpoint to listen on."""
    dial: str | None = None
    """Hub of the other side to dial."""
    truth_password: str | None = None
    """Who knows it may read and write `truth/**`."""


class SiteConfig(msgspec.Struct, frozen=True, kw_only=True):
    """The simulated site."""

    bus: BusConfig
    """The bus, with the right to publish the truth."""
    files: SiteFiles
    """What the site is said to be."""
    scenario: str
    """What the session is like."""
    seed: int
    """Of everything random."""
    vio: str | None = None
    """Quality of the odometry, where it is not the scenario's."""
    delays_ms: dict[str, float] = msgspec.field(default_factory=dict)
    """Mean delays that replace the scenario's, by stream."""


class TrackerConfig(msgspec.Struct, frozen=True, kw_only=True):
    """The tracker."""

    bus: BusConfig
    """Where the bus is."""
    files: SiteFiles
    """What the site is."""
    method: str = "joint"
    """Method of tracking."""


class OperatorConfig(msgspec.Struct, frozen=True, kw_only=True):
    """The scripted operator."""

    bus: BusConfig
    """The bus, with the rights everybody has."""
    files: SiteFiles
    """What the site is said to be."""
    scenario: str
    """Whose plan is followed."""
    seed: int
    """Of hand and eye."""


class ViewerConfig(msgspec.Struct, frozen=True, kw_only=True):
    """The viewer."""

    bus: BusConfig
    """Where the bus is, and whose session is shown."""
    files: SiteFiles
    """What the site is."""
    host: str = "127.0.0.1"
    """Address to listen on."""
    port: int = 0
    """Port to listen on; 0 takes any."""
    token: str | None = None
    """Shared secret of the page, kept over restarts."""
    rate_hz: float = 40.0
    """Scene states per second."""
    replay: bool = False
    """Whether the session is a recording."""


class MetricsConfig(msgspec.Struct, frozen=True, kw_only=True):
    """The comparison with the truth."""

    bus: BusConfig
    """The bus, with the right to the truth."""


class ProbeConfig(msgspec.Struct, frozen=True, kw_only=True):
    """The tab without a browser."""

    url: str
    """Address of the page."""


class RecorderConfig(msgspec.Struct, frozen=True, kw_only=True):
    """The recorder."""

    bus: BusConfig
    """The bus, with the right to the truth when that is recorded."""
    files: SiteFiles
    """Attached, so that the recording replays with what it was made with."""
    path: str
    """File to write."""
    with_truth: bool = False
    """Whether `truth/**` is recorded."""
    topics: list[str] = msgspec.field(default_factory=lambda: ["**"])
    """Expressions of the topics wanted."""


class PlayerConfig(msgspec.Struct, frozen=True, kw_only=True):
    """The player."""

    bus: BusConfig
    """Where the bus is, and the session it publishes under."""
    path: str
    """Recording."""
    speed: float = 1.0
    """Playback seconds per second."""
    from_s: float = 0.0
    """Where to begin [s]."""
    loop: bool = False
    """Whether to begin again at the end."""
    paused: bool = False
    """Whether to wait for play."""
    topics: list[str] = msgspec.field(default_factory=lambda: ["**"])
    """Expressions of the topics wanted."""
    remap: dict[str, str] = msgspec.field(default_factory=dict)
    """New topics by recorded topic."""
