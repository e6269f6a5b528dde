"""The gate: who gets in, what comes through, and the private names of viser it stands on."""

from __future__ import annotations

import contextlib
import http.client
import secrets
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import psutil
import pytest
import viser
import zstandard
from viser import _messages as viser_messages
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from websockets.sync.connection import Connection
from websockets.typing import Origin, Subprotocol

from app.gate import Gate, GateSettings
from app.live import LiveChannel
from app.viser_port import ViserPort
from spatial.camera import PinholeCamera
from spatial.errors import InputError, MissingError
from spatial.pose import Pose

CLIENT_HTML = Path(viser.__file__).parent / "client" / "build" / "index.html"
SUBPROTOCOL = Subprotocol(f"viser-v{viser.__version__}")
CAMERA: dict[str, Any] = {
    "type": "ViewerCameraMessage",
    "wxyz": [1.0, 0.0, 0.0, 0.0],
    "position": [1.0, 2.0, 3.0],
    "fov": 1.0,
    "near": 0.01,
    "far": 100.0,
    "image_height": 480,
    "image_width": 640,
    "look_at": [0.0, 0.0, 0.0],
    "up_direction": [0.0, 0.0, 1.0],
}


SECRET = secrets.token_hex(8)


def channel() -> LiveChannel:
    return LiveChannel({"hc": PinholeCamera(64, 48, 60.0, 60.0, 31.5, 23.5)})


@pytest.fixture(scope="module")
def port() -> Iterator[ViserPort]:
    with ViserPort(GateSettings(port=0), live=channel()) as opened:
        yield opened


@pytest.fixture(scope="module")
def locked() -> Iterator[ViserPort]:
    with ViserPort(GateSettings(port=0, token=SECRET), live=channel()) as opened:
        yield opened


def get(port: ViserPort, path: str, **headers: str) -> tuple[int, http.client.HTTPMessage, bytes]:
    connection = http.client.HTTPConnection("127.0.0.1", port.gate.port, timeout=10)
    try:
        connection.request(
            "GET", path, headers={k.replace("_", "-"): v for k, v in headers.items()}
        )
        response = connection.getresponse()
        return response.status, response.headers, response.read()
    finally:
        connection.close()


def upgrade(port: ViserPort, path: str, **options: Any) -> Connection:
    return connect(f"ws://127.0.0.1:{port.gate.port}{path}", open_timeout=10, **options)


def eventually(condition: Any, *, timeout_s: float = 5.0) -> bool:
    end = time.monotonic() + timeout_s
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.02)
    return bool(condition())


def test_the_page_carries_our_script_and_is_not_called_viser(port: ViserPort) -> None:
    status, headers, body = get(port, "/")
    assert status == 200
    assert b'<script type="module" src="/page/main.js">' in body
    assert body.index(b"/page/early.js") < body.index(b"<script data-p")
    assert b"<title>Telepresence</title>" in body
    assert headers["Content-Type"].startswith("text/html")


def test_every_script_and_style_the_page_imports_is_served(port: ViserPort) -> None:
    for file in sorted((Path(__file__).parents[2] / "app" / "page").iterdir()):
        status, headers, body = get(port, f"/page/{file.name}")
        assert (status, body) == (200, file.read_bytes()), file.name
        assert "charset=utf-8" in headers["Content-Type"]


@pytest.mark.parametrize("path", ["/", "/page/page.css", "/healthz", "/nothing"])
def test_every_answer_has_the_security_headers(port: ViserPort, path: str) -> None:
    _, headers, _ = get(port, path)
    policy = headers["Content-Security-Policy"]
    assert "connect-src 'self'" in policy
    assert "frame-ancestors 'none'" in policy
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert headers["Referrer-Policy"] == "no-referrer"


@pytest.mark.parametrize(
    "path", ["/nothing", "/page/", "/page/../gate.py", "/page/%2e%2e/gate.py", "/../../etc/passwd"]
)
def test_only_known_paths_exist(port: ViserPort, path: str) -> None:
    assert get(port, path)[0] == 404


def test_health_is_told_without_a_token(locked: ViserPort) -> None:
    assert get(locked, "/healthz")[0] == 200


@pytest.mark.parametrize(
    "host", ["evil.example", "127.0.0.1", "127.0.0.1:1", "localhost.evil.example"]
)
def test_a_host_name_that_is_not_ours_is_refused(port: ViserPort, host: str) -> None:
    assert get(port, "/", Host=host)[0] == 421
    assert get(port, "/healthz", Host=host)[0] == 421


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:1", "file://"])
@pytest.mark.parametrize("path", ["/", "/live"])
def test_a_page_of_another_origin_gets_neither_page_nor_socket(
    port: ViserPort, path: str, origin: str
) -> None:
    assert get(port, "/", Origin=origin)[0] == 403
    with pytest.raises(InvalidStatus) as refused:
        upgrade(port, path, origin=Origin(origin), subprotocols=[SUBPROTOCOL])
    assert refused.value.response.status_code == 403


def test_our_own_page_gets_its_sockets(port: ViserPort) -> None:
    origin = Origin(f"http://127.0.0.1:{port.gate.port}")
    with upgrade(port, "/", origin=origin, subprotocols=[SUBPROTOCOL]) as socket:
        assert isinstance(socket.recv(timeout=5), bytes)
    with upgrade(port, "/live", origin=origin) as socket:
        assert isinstance(socket.recv(timeout=5), str)


def test_other_channels_do_not_exist(port: ViserPort) -> None:
    with pytest.raises(InvalidStatus) as refused:
        upgrade(port, "/elsewhere")
    assert refused.value.response.status_code == 404


@pytest.mark.parametrize(
    "query", ["websocket=ws://evil.example", "playbackPath=x.viser", "a=1&websocket="]
)
def test_the_page_is_not_served_with_parameters_that_make_it_obey_others(
    port: ViserPort, query: str
) -> None:
    assert get(port, f"/?{query}")[0] == 400
    assert get(port, "/?fixedDpr=1")[0] == 200


def test_a_token_is_exchanged_for_a_cookie_and_leaves_the_address(locked: ViserPort) -> None:
    assert get(locked, "/")[0] == 401
    assert get(locked, "/?token=wrong")[0] == 401
    status, headers, _ = get(locked, f"/?token={SECRET}&fixedDpr=1")
    assert (status, headers["Location"]) == (303, "/?fixedDpr=1")
    cookie = headers["Set-Cookie"]
    assert cookie.startswith(f"telepresence-{locked.gate.port}=")
    assert "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie
    pair = cookie.split(";")[0]
    assert get(locked, "/", Cookie=f"other=1; {pair}")[0] == 200
    assert get(locked, "/", Cookie=f"telepresence-1={locked.gate.token}")[0] == 401


def test_the_redirect_stays_on_this_host(locked: ViserPort) -> None:
    status, headers, _ = get(locked, f"//evil.example/?token={SECRET}")
    assert status == 303
    assert headers["Location"].startswith("/")
    assert not headers["Location"].startswith("//")


@pytest.mark.parametrize("path", ["/", "/live"])
def test_sockets_need_the_cookie_too(locked: ViserPort, path: str) -> None:
    with pytest.raises(InvalidStatus) as refused:
        upgrade(locked, path, subprotocols=[SUBPROTOCOL])
    assert refused.value.response.status_code == 401


def test_an_address_beyond_loopback_always_has_a_token() -> None:
    gate = Gate(GateSettings(host="127.0.0.2", port=0), client_html=CLIENT_HTML, live=channel())
    try:
        assert gate.token is not None
        assert len(gate.token) >= 32
        assert gate.token in gate.url
    finally:
        gate.close()


def test_a_taken_port_is_named_and_not_replaced_by_the_next(port: ViserPort) -> None:
    taken = port.gate.port
    with pytest.raises(MissingError, match=str(taken)):
        ViserPort(GateSettings(port=taken), live=channel())


def test_the_process_listens_on_loopback_only(port: ViserPort) -> None:
    listening = [
        c.laddr.ip
        for c in psutil.Process().net_connections("tcp")
        if c.status == psutil.CONN_LISTEN
    ]
    assert port.gate.port
    assert set(listening) <= {"127.0.0.1", "::1"}


HOSTILE: list[dict[str, Any]] = [
    {"type": "ShareUrlRequest"},
    {"type": "ShareUrlDisconnect"},
    {"type": "GuiUpdateMessage", "uuid": "x", "updates": {"removed": True}},
    {"type": "RunJavascriptMessage", "source": "1"},
    {"type": "FileTransferStartUpload", "source_component_uuid": "x"},
    {"type": "CommandTriggerMessage", "uuid": "x"},
    {"type": "NoSuchMessage"},
    {**CAMERA, "position": [float("nan"), 0.0, 0.0]},
]


def test_browsers_can_say_where_they_look_from_and_nothing_else(port: ViserPort) -> None:
    before = port.gate.inbound_dropped
    clients = port.clients
    with upgrade(port, "/", subprotocols=[SUBPROTOCOL]) as socket:
        for message in HOSTILE:
            socket.send(msgspec.msgpack.encode(message))
        socket.send(b"\xff\xff not msgpack")
        socket.send("text")
        socket.send(b"\x81" * 5000)
        assert eventually(lambda: port.gate.inbound_dropped == before + len(HOSTILE) + 3)
        assert port.clients == clients
        socket.send(msgspec.msgpack.encode(CAMERA))
        assert eventually(lambda: port.clients == clients + 1)


def test_a_flood_of_camera_messages_is_cut(port: ViserPort) -> None:
    before = port.gate.inbound_dropped
    with upgrade(port, "/", subprotocols=[SUBPROTOCOL]) as socket:
        for _ in range(600):
            socket.send(msgspec.msgpack.encode(CAMERA))
        assert eventually(lambda: port.gate.inbound_dropped > before + 100)


def test_a_message_over_the_cap_ends_its_own_connection_only(port: ViserPort) -> None:
    with upgrade(port, "/live") as other, upgrade(port, "/live") as socket:
        with contextlib.suppress(ConnectionClosed):
            socket.send("x" * (5 * 1024 * 1024))
        with pytest.raises(ConnectionClosed):
            [socket.recv(timeout=5) for _ in range(100)]
        assert other.ping().wait(timeout=5)
    assert get(port, "/healthz")[0] == 200


def test_the_share_tunnel_is_gone(port: ViserPort) -> None:
    handlers = port._server._websock_server._incoming_handlers
    assert viser_messages.ShareUrlRequest not in handlers
    assert viser_messages.ShareUrlDisconnect not in handlers


def test_the_private_names_of_viser_are_where_we_use_them() -> None:
    assert viser.__version__ == "1.1.1"
    assert callable(viser.SceneApi._queue_scene_message)
    for message, fields in (
        (viser_messages.SetPositionMessage, {"name", "position", "owner"}),
        (viser_messages.SetOrientationMessage, {"name", "wxyz", "owner"}),
        (viser_messages.SetSceneNodeVisibilityMessage, {"name", "visible", "owner"}),
    ):
        assert set(message.__dataclass_fields__) == fields
    client = CLIENT_HTML.parent.parent / "src"
    app = (client / "App.tsx").read_text()
    context = (client / "ViewerContext.ts").read_text()
    assert "w.__viserMutable = mutable.current" in app
    for name in ("nodeRefFromName", "nodePoseData", "requestRender", "cameraControl", "canvas:"):
        assert name in context


def messages_of(raw: bytes) -> list[dict[str, Any]]:
    size = int.from_bytes(raw[8:16], "little")
    return list(msgspec.msgpack.decode(zstandard.decompress(raw[16 : 16 + size]))["messages"])


def test_a_tick_reaches_a_browser_whole_and_bad_poses_do_not(port: ViserPort) -> None:
    port.add_group("/crowd")
    names = [f"/crowd/n{i}" for i in range(40)]
    for name in names:
        port.add_group(name)
    nan: Pose[Any, Any] = Pose(np.full((4, 4), np.nan))
    skewed: Pose[Any, Any] = Pose(np.diag([2.0, 1.0, 1.0, 1.0]))
    with upgrade(port, "/", subprotocols=[SUBPROTOCOL]) as socket:
        time.sleep(0.3)
        moves: dict[str, Pose[Any, Any]] = {
            n: Pose.translated(i, 0, 0.5) for i, n in enumerate(names)
        }
        assert port.update({**moves, names[0]: nan, names[1]: skewed}, {}) == 2
        port.flush()
        for _ in range(100):
            raw = socket.recv(timeout=5)
            assert isinstance(raw, bytes)
            batch = messages_of(raw)
            moved = [m for m in batch if m["type"] == "SetPositionMessage" and m["name"] in names]
            moved = [m for m in moved if m["position"][2] == 0.5]
            if moved:
                break
    assert {m["name"] for m in moved} == set(names[2:])


@pytest.mark.parametrize("name", ["site", "/", "/a b", "/<img>", "/a//b", "/" + "x" * 80])
def test_only_plain_node_names_are_taken(port: ViserPort, name: str) -> None:
    with pytest.raises(InputError, match="scene node"):
        port.add_group(name)
    with pytest.raises(InputError, match="unknown scene node"):
        port.update({name: Pose.identity()}, {})
