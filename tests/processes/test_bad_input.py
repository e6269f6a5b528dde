"""Bad input at the command line: one line that says what is wrong, exit code 2, nobody left."""

from __future__ import annotations

import shutil
import socket
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

from app.__main__ import main
from app.sides import free_endpoint
from wire.clock import VirtualClock
from wire.keys import Keys
from wire.memory_bus import MemoryBus
from wire.recorder import Recorder

pytestmark = pytest.mark.processes

ASSETS = Path(__file__).parents[2] / "assets"
Refusal = Callable[..., str]


@pytest.fixture
def refusal(capfd: pytest.CaptureFixture[str]) -> Refusal:
    """Run a command that must be refused and return the line it says, children's words included."""

    def run(*arguments: str) -> str:
        code = main(list(arguments))
        said = capfd.readouterr()
        assert code == 2, said.err
        assert said.out == ""
        assert said.err.count("\n") == 1, said.err
        assert psutil.Process().children(recursive=True) == []
        return said.err

    return run


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A site of one's own, with its robot and objects."""
    for name in ("objects", "robots"):
        shutil.copytree(ASSETS / name, tmp_path / name)
    shutil.copy(ASSETS / "sites" / "sam.toml", tmp_path / "sam.toml")
    return tmp_path


def replace(path: Path, old: str, new: str) -> int:
    """Change a text for another where it first occurs; return its line."""
    text = path.read_text("utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), "utf-8")
    return text[: text.index(old)].count("\n") + 1


def view(site: Path) -> tuple[str, ...]:
    endpoint = free_endpoint()
    return ("view", "--no-browser", "--port", "0", "--listen", endpoint, "--site", str(site))


@pytest.mark.parametrize("command", ["demo", "view", "play"])
def test_a_busy_port_is_named(command: str, tmp_path: Path, refusal: Refusal) -> None:
    more = {
        "view": ("--listen", free_endpoint()),
        "play": (str(recording(tmp_path)), "--no-browser"),
        "demo": ("--headless", "--json"),
    }
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = str(other.getsockname()[1])
        assert f"port {port}" in refusal(command, "--port", port, *more[command])


def test_a_busy_endpoint_is_named(refusal: Refusal) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        endpoint = f"tcp/127.0.0.1:{other.getsockname()[1]}"
        assert endpoint in refusal("view", "--no-browser", "--port", "0", "--listen", endpoint)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("demo", "--scenario", "dance"), ("dance", "pick")),
        (("demo", "--method", "guess"), ("guess", "joint", "algorithm1")),
        (("site", "--vio", "perfect"), ("perfect", "nominal")),
        (("site", "--delay-ms", "smell=3"), ("smell", "image", "vio")),
        (("site", "--delay-ms", "image"), ("STREAM=MS", "image")),
        (("site", "--delay-ms", "image=-3"), ("image=-3",)),
        (("site", "--delay-ms", "image=1e300"), ("image=1e300",)),
        (("site", "--lock-step"), ("--record",)),
        (("site", "--connect", "here:80"), ("here:80", "tcp/127.0.0.1:7447")),
        (("view", "--listen", "tcp/127.0.0.1:99999"), ("99999",)),
        (("view", "--site", "no-such-site.toml"), ("no-such-site.toml",)),
        (("play", "no-such.mcap"), ("no-such.mcap",)),
        (("info", "no-such.mcap"), ("no-such.mcap",)),
        (("repair", "no-such.mcap"), ("no-such.mcap",)),
        (("record", "no-such-folder/a.mcap"), ("no-such-folder",)),
        (("demo", "--record", "no-such-folder/a.mcap"), ("no-such-folder",)),
        (("demo", "--port", "70000"), ("70000",)),
        (("robot", "no-such.urdf"), ("no-such.urdf",)),
    ],
)
def test_what_does_not_exist_is_named_with_what_does(
    arguments: tuple[str, ...], words: tuple[str, ...], refusal: Refusal
) -> None:
    said = refusal(*arguments)
    assert all(word in said for word in words), said


@pytest.mark.parametrize(
    ("file", "change", "words"),
    [
        ("sam.toml", ("fx = 1078.0", 'fx = "wide"'), ("camera[0].fx", "number", "wide")),
        ("sam.toml", ("fx = 1078.0", "fx = "), ("TOML",)),
        ("sam.toml", ('slug = "cage"', 'slug = "cave"'), ("cave", "hole_plate", "object[0].slug")),
        ("sam.toml", ("sam/robot.urdf", "sam/bender.urdf"), ("bender.urdf", "robot.urdf")),
        ("objects/cage/object.toml", ("mass_kg =", 'mass_kg = "a lot" #'), ("mass_kg", "a lot")),
        ("objects/cage/object.toml", ("mass_kg =", "mass_kg"), ("TOML",)),
        ("robots/sam/robot.urdf", ('<parent link="', '<parent link="no'), ("unknown link", "tcp")),
        ("robots/sam/robot.urdf", ("</robot>", ""), ("XML",)),
    ],
)
def test_a_broken_file_is_named_with_the_line_or_key(
    file: str, change: tuple[str, str], words: tuple[str, ...], folder: Path, refusal: Refusal
) -> None:
    line = replace(folder / file, *change)
    said = refusal(*view(folder / "sam.toml"))
    assert all(word in said for word in words), said
    assert str(folder / file) in said or "bender" in said
    if "XML" not in words:  # known only where the file ends
        assert f"line {line}" in said


def test_a_missing_or_broken_mesh_names_its_file(folder: Path, refusal: Refusal) -> None:
    mesh = folder / "objects" / "cage" / "mesh.glb"
    mesh.write_bytes(mesh.read_bytes()[:1000])
    assert str(mesh) in refusal(*view(folder / "sam.toml"))
    mesh.unlink()
    assert "mesh.glb" in refusal(*view(folder / "sam.toml"))


def test_a_package_folder_that_is_none_is_refused(refusal: Refusal) -> None:
    urdf = str(ASSETS / "robots" / "sam" / "robot.urdf")
    assert "no-such-folder" in refusal("robot", urdf, "--package", "arm=no-such-folder")


def recording(folder: Path) -> Path:
    """Write a small recording and return its path."""
    path, keys = folder / "session.mcap", Keys()
    with (
        MemoryBus() as bus,
        Recorder(bus, path, keys=keys, clock=VirtualClock()) as recorder,
    ):
        for number in range(2000):
            bus.publish(keys.vio, bytes([number % 256]) * 200, schema="foxglove.Odometry")
        recorder.tick()
    return path


def test_what_is_no_whole_recording_is_not_played(tmp_path: Path, refusal: Refusal) -> None:
    path = recording(tmp_path)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    assert "repair" in refusal("play", str(path), "--no-browser")
    path.write_bytes(b"no recording at all")
    assert str(path) in refusal("play", str(path), "--no-browser")
    assert str(path) in refusal("repair", str(path))
    assert path.read_bytes() == b"no recording at all"


def test_a_recording_is_never_written_over(tmp_path: Path, refusal: Refusal) -> None:
    path = recording(tmp_path)
    before = path.read_bytes()
    for command in (("record", str(path)), ("demo", "--headless", "--record", str(path))):
        assert str(path) in refusal(*command)
    assert path.read_bytes() == before
