"""The two sides of a session as supervised processes: a site, and an operator station."""

from __future__ import annotations

import contextlib
import secrets
import socket
import webbrowser
from dataclasses import dataclass, field
from pathlib import Path

from app.processes.config import (
    BusConfig,
    HubConfig,
    MetricsConfig,
    OperatorConfig,
    PlayerConfig,
    ProbeConfig,
    RecorderConfig,
    SiteConfig,
    SiteFiles,
    TrackerConfig,
    ViewerConfig,
)
from app.supervisor import Supervisor
from spatial.errors import FileInputError
from wire.hub import new_truth_password

DEFAULT_PORT = 8080
DEFAULT_LISTEN = "tcp/127.0.0.1:7447"
READY_S = 60.0


@dataclass(frozen=True, slots=True)
class Session:
    """What all processes of one side share."""

    site_path: Path
    """The site file."""
    site_name: str
    """Name of the site on the bus."""
    endpoint: str
    """Endpoint of this side's hub."""
    truth_password: str = field(default_factory=new_truth_password)
    """What opens `truth/**` at the hub; made anew for every run."""

    @property
    def files(self) -> SiteFiles:
        """Files of the site."""
        return SiteFiles(site=str(self.site_path))

    @property
    def bus(self) -> BusConfig:
        """The bus, with the rights everybody has."""
        return BusConfig(endpoint=self.endpoint, site=self.site_name)

    @property
    def truth_bus(self) -> BusConfig:
        """The bus, with the right to the truth."""
        return BusConfig(
            endpoint=self.endpoint,
            site=self.site_name,
            truth_password=self.truth_password,
        )


def free_port(host: str) -> int:
    """Return a port of an address that nobody listens on; any, where the address is not ours."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family) as probe_socket, contextlib.suppress(OSError):
        probe_socket.bind((host, 0))
        return int(probe_socket.getsockname()[1])
    return 0


def free_endpoint() -> str:
    """Return a loopback endpoint nobody listens on."""
    return f"tcp/127.0.0.1:{free_port('127.0.0.1')}"


def start_hub(supervisor: Supervisor, session: Session, *, dial: str | None = None) -> None:
    """Start the hub of a side and wait until it listens."""
    config = HubConfig(listen=session.endpoint, dial=dial, truth_password=session.truth_password)
    supervisor.start("hub", "app.processes.hub", config)
    supervisor.wait_event("hub", "ready", timeout_s=READY_S)


def start_tracker(supervisor: Supervisor, session: Session, *, method: str) -> None:
    """Start the tracker."""
    config = TrackerConfig(bus=session.bus, files=session.files, method=method)
    supervisor.start("tracker", "app.processes.tracker", config)


def start_simulation(supervisor: Supervisor, session: Session, config: SiteConfig) -> str:
    """Start the simulated site and its scripted operator; return the renderer's name."""
    supervisor.start("site", "app.processes.site", config)
    operator_config = OperatorConfig(
        bus=session.bus, files=session.files, scenario=config.scenario, seed=config.seed
    )
    supervisor.start("operator", "app.processes.operator", operator_config)
    return str(supervisor.wait_event("site", "ready", timeout_s=READY_S)["renderer"])


def start_viewer(
    supervisor: Supervisor,
    session: Session,
    *,
    host: str = "127.0.0.1",
    port: int = DEFAULT_PORT,
    replay: str | None = None,
) -> str:
    """Start the viewer; return the address of its page, with the token where one is needed."""
    bus = session.bus
    if replay is not None:
        bus = BusConfig(endpoint=bus.endpoint, site=bus.site, session=replay)
    config = ViewerConfig(
        bus=bus,
        files=session.files,
        host=host,
        port=port or free_port(host),  # the same after a restart: tabs come back by themselves
        token=None if host in ("127.0.0.1", "localhost", "::1") else secrets.token_urlsafe(24),
        replay=replay is not None,
    )
    supervisor.start("viewer", "app.processes.viewer", config)
    return str(supervisor.wait_event("viewer", "ready", timeout_s=READY_S)["url"])


def start_metrics(supervisor: Supervisor, session: Session) -> None:
    """Start the process that compares the tracker with the truth."""
    config = MetricsConfig(bus=session.truth_bus)
    supervisor.start("metrics", "app.processes.metrics", config, restart=False)
    supervisor.wait_event("metrics", "ready", timeout_s=READY_S)


def start_probe(supervisor: Supervisor, url: str) -> None:
    """Start a tab without a browser."""
    supervisor.start("probe", "app.processes.probe", ProbeConfig(url=url), restart=False)
    supervisor.wait_event("probe", "ready", timeout_s=READY_S)


def start_recorder(
    supervisor: Supervisor, session: Session, path: Path, *, with_truth: bool
) -> None:
    """Start recording everything of the session."""
    config = RecorderConfig(
        bus=session.truth_bus if with_truth else session.bus,
        files=session.files,
        path=str(path),
        with_truth=with_truth,
    )
    supervisor.start("recorder", "app.processes.recorder", config)
    supervisor.wait_event("recorder", "ready", timeout_s=READY_S)


def refuse_target(file: Path) -> None:
    """Refuse a name no recording can be written under.

    Raises:
        FileInputError: it exists already, or its folder does not.
    """
    if file.exists():
        raise FileInputError(
            "the file exists already; choose another name for the recording", path=file
        )
    if not file.absolute().parent.is_dir():
        raise FileInputError("no such folder for the recording", path=file)


def start_player(supervisor: Supervisor, config: PlayerConfig) -> None:
    """Start playing a recording."""
    supervisor.start("player", "app.processes.player", config)
    supervisor.wait_event("player", "ready", timeout_s=READY_S)


def open_browser(url: str) -> bool:
    """Open the page in the user's browser; return whether there is one."""
    try:
        return webbrowser.open(url)
    except webbrowser.Error:
        return False
