"""The gate: one loopback port in front of viser's own server, and the only way in.

viser answers anybody: no Host or Origin check, no token, every message of every client obeyed.
While `ViserServer` is built, `guarding` replaces `websockets.asyncio.server.serve`, so that the
server viser starts is ours: the port is bound here (a busy one is refused, never moved), each
request passes `_admit`, the page gets our own script and style, `/live` is our own WebSocket, and
of what browsers send to viser only camera messages come through.
"""

from __future__ import annotations

import gzip
import hmac
import http
import logging
import secrets
import socket
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol
from urllib.parse import parse_qsl, urlencode, urlsplit

from websockets.asyncio import server as ws_server
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from app.inbound import InboundFilter
from spatial.errors import MissingError

LOOPBACK = frozenset({"127.0.0.1", "localhost", "::1"})
MAX_MESSAGE_BYTES = 4 * 1024 * 1024
MAX_CONNECTIONS = 64
NOT_SENT_BYTES = 16 * 1024
PAGE_DIR = Path(__file__).parent / "page"
REFUSED_PARAMETERS = frozenset({"websocket", "playbackPath"})
"""With them viser's page obeys another server, or plays a recording, which may carry code."""
MIME = {".js": "text/javascript; charset=utf-8", ".css": "text/css; charset=utf-8"}
HEAD = (
    '<link rel="stylesheet" href="/page/page.css">'
    '<script src="/page/early.js"></script>'
    '<script type="module" src="/page/main.js"></script>'
)
SECURITY_HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; "
        "script-src 'self' 'unsafe-inline' 'unsafe-eval' 'wasm-unsafe-eval' blob:; "
        "style-src 'self' 'unsafe-inline'; img-src 'self' data: blob:; font-src data:; "
        "connect-src 'self' blob: data:; worker-src blob:; base-uri 'none'; "
        "form-action 'none'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}

Handler = Callable[[ServerConnection], Awaitable[None]]


class LiveHandler(Protocol):
    """Who speaks on `/live`."""

    async def handle(self, connection: ServerConnection) -> None:
        """Serve one client until it leaves."""
        ...


@dataclass(frozen=True, slots=True)
class GateSettings:
    """Where the gate listens and whom it lets in."""

    host: str = "127.0.0.1"
    """Address to bind. Anything but loopback needs a token; one is made when none is given."""
    port: int = 8080
    """Port to bind; 0 takes any free one."""
    token: str | None = None
    """Shared secret; `None` means none on loopback, a fresh one elsewhere."""
    names: tuple[str, ...] = ()
    """Further host names browsers may use in the address, without port."""


class GuardedConnection(ServerConnection):
    """A connection that hands on only the messages its filter lets through."""

    inbound: InboundFilter | None = None

    async def recv(self, decode: bool | None = None) -> Any:
        """Return the next message that may pass."""
        while True:
            data = await super().recv(decode)
            if self.inbound is None or self.inbound.passes(data):
                return data


class _QuietHandshakes(logging.Filter):
    """Plain HTTP answers are no failed handshakes; `websockets` logs them as such."""

    def filter(self, record: logging.LogRecord) -> bool:
        message = record.getMessage()
        return not message.startswith(("connection rejected", "opening handshake failed"))


class Gate:
    """Owns the port and decides on every request; knows nothing of viser but its page file."""

    def __init__(self, settings: GateSettings, *, client_html: Path, live: LiveHandler) -> None:
        """Bind the port.

        Args:
            settings: where to listen and whom to let in.
            client_html: viser's page.
            live: who answers on `/live`.

        Raises:
            MissingError: the port is taken or the address is not this machine's.
        """
        self._settings = settings
        self._live = live
        self._socket = _bind(settings.host, settings.port)
        self.port: int = self._socket.getsockname()[1]
        loopback = settings.host in LOOPBACK
        self.token = settings.token if loopback else settings.token or secrets.token_hex(24)
        self._cookie = f"telepresence-{self.port}"
        names = {*settings.names, *(LOOPBACK if loopback else {settings.host, *LOOPBACK})}
        self._hosts = frozenset(
            f"[{n}]:{self.port}" if ":" in n else f"{n}:{self.port}" for n in names
        )
        self._assets = _assets(client_html)
        self._open = 0
        self.refused = 0
        """Requests turned away since the start."""
        self.inbound_dropped = 0
        """Messages to viser that were not let through since the start."""

    @property
    def url(self) -> str:
        """Address to open, with the token where one is needed."""
        host = "127.0.0.1" if self._settings.host in LOOPBACK else self._settings.host
        address = f"http://{host}:{self.port}/"
        return address if self.token is None else f"{address}?token={self.token}"

    def close(self) -> None:
        """Give the port back."""
        self._socket.close()

    @contextmanager
    def guarding(self) -> Iterator[None]:
        """Make the server that is started inside this block ours."""
        original = ws_server.serve

        def serve(handler: Handler, _host: str, _port: int, **kwargs: Any) -> Any:
            logger = logging.getLogger("app.gate.connections")
            logger.addFilter(_QuietHandshakes())
            kwargs |= {
                "sock": self._socket,
                "create_connection": GuardedConnection,
                "process_request": self._admit,
                "max_size": MAX_MESSAGE_BYTES,
                "server_header": None,
                "logger": logger,
            }
            return original(self._route(handler), **kwargs)

        ws_server.serve = serve  # type: ignore[assignment, misc]  # put back below
        try:
            yield
        finally:
            ws_server.serve = original  # type: ignore[misc]

    def _route(self, viser_handler: Handler) -> Handler:
        async def route(connection: ServerConnection) -> None:
            assert connection.request is not None
            _keep_queue_short(connection)
            self._open += 1
            try:
                if urlsplit(connection.request.path).path == "/live":
                    await self._live.handle(connection)
                else:
                    assert isinstance(connection, GuardedConnection)
                    connection.inbound = InboundFilter(self._count_dropped)
                    await viser_handler(connection)
            finally:
                self._open -= 1

        return route

    def _count_dropped(self) -> None:
        self.inbound_dropped += 1

    def _admit(self, _connection: ServerConnection, request: Request) -> Response | None:
        """Answer a request, or return None to let a WebSocket in."""
        answer = self._decide(request)
        if answer is not None and answer.status_code >= http.HTTPStatus.BAD_REQUEST:
            self.refused += 1
        return answer

    def _decide(self, request: Request) -> Response | None:
        parts = urlsplit(request.path)
        refusal = self._refusal(request.headers)
        if refusal is None and parts.path == "/healthz":
            return _response(http.HTTPStatus.OK, b'{"ok": true}', mime="application/json")
        refusal = refusal or self._authorise(request, parts.path, parts.query)
        if refusal is not None:
            return refusal
        if request.headers.get("Upgrade", "").lower() == "websocket":
            return self._channel_refusal(parts.path)
        return self._asset(parts.path, gzipped="gzip" in request.headers.get("Accept-Encoding", ""))

    def _channel_refusal(self, path: str) -> Response | None:
        if path not in ("/", "/live"):
            return _plain(http.HTTPStatus.NOT_FOUND, "no such channel; there are / and /live")
        if self._open >= MAX_CONNECTIONS:
            return _plain(http.HTTPStatus.SERVICE_UNAVAILABLE, "too many connections")
        return None

    def _refusal(self, headers: Headers) -> Response | None:
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        if len(hosts) != 1 or hosts[0].lower() not in self._hosts:
            return _plain(http.HTTPStatus.MISDIRECTED_REQUEST, "this host name is not served here")
        for origin in origins:
            parts = urlsplit(origin)
            if parts.scheme not in ("http", "https") or parts.netloc.lower() != hosts[0].lower():
                return _plain(http.HTTPStatus.FORBIDDEN, "pages of other origins may not come in")
        return None

    def _authorise(self, request: Request, path: str, query_text: str) -> Response | None:
        try:
            query = parse_qsl(query_text, keep_blank_values=True, max_num_fields=16)
        except ValueError:
            return _plain(http.HTTPStatus.BAD_REQUEST, "too many parameters")
        if REFUSED_PARAMETERS & {key for key, _ in query}:
            return _plain(http.HTTPStatus.BAD_REQUEST, "the page speaks only to its own server")
        if self.token is None:
            return None
        given = [value for key, value in query if key == "token"]
        if given:
            rest = urlencode([pair for pair in query if pair[0] != "token"])
            return self._exchange(given[0], path=path, rest=rest)
        if _same(_cookies(request.headers).get(self._cookie, ""), self.token):
            return None
        return _plain(http.HTTPStatus.UNAUTHORIZED, "open the address with its token once")

    def _exchange(self, given: str, *, path: str, rest: str) -> Response:
        """Turn a token in the address into a cookie, and the address into one without it."""
        assert self.token is not None
        if not _same(given, self.token):
            return _plain(http.HTTPStatus.UNAUTHORIZED, "wrong token")
        # Only a path of our own: `//elsewhere` would leave this origin.
        local = "/" + path.lstrip("/") + (f"?{rest}" if rest else "")
        cookie = f"{self._cookie}={self.token}; HttpOnly; SameSite=Strict; Path=/"
        return _response(
            http.HTTPStatus.SEE_OTHER, b"", headers={"Location": local, "Set-Cookie": cookie}
        )

    def _asset(self, path: str, *, gzipped: bool) -> Response:
        found = self._assets.get(path)
        if found is None:
            return _plain(http.HTTPStatus.NOT_FOUND, "not found")
        mime, plain, packed = found
        if not gzipped:
            return _response(http.HTTPStatus.OK, plain, mime=mime)
        headers = {"Content-Encoding": "gzip", "Vary": "Accept-Encoding"}
        return _response(http.HTTPStatus.OK, packed, mime=mime, headers=headers)


def _bind(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((host, port))
    except OSError as error:
        listener.close()
        raise MissingError(
            f"port {port} on {host} cannot be bound ({error.strerror}); "
            "end the other process or choose another port with --port"
        ) from error
    return listener


def _keep_queue_short(connection: ServerConnection) -> None:
    """Let the kernel queue little that is not sent yet: what waits here can still be replaced."""
    option = getattr(socket, "TCP_NOTSENT_LOWAT", None)
    raw = connection.transport.get_extra_info("socket")
    if option is not None and raw is not None:
        raw.setsockopt(socket.IPPROTO_TCP, option, NOT_SENT_BYTES)


def _assets(client_html: Path) -> dict[str, tuple[str, bytes, bytes]]:
    """Return path -> (mime, content, gzipped content) of all that is served over HTTP."""
    html = client_html.read_text(encoding="utf-8")
    html = html.replace("<title>Viser</title>", "<title>Telepresence</title>", 1)
    html = html.replace("<head>", f"<head>{HEAD}", 1)
    files = {"/": ("text/html; charset=utf-8", html.encode())}
    for file in sorted(PAGE_DIR.iterdir()):
        if file.suffix in MIME:
            files[f"/page/{file.name}"] = (MIME[file.suffix], file.read_bytes())
    files["/index.html"] = files["/"]
    return {path: (mime, body, gzip.compress(body)) for path, (mime, body) in files.items()}


def _cookies(headers: Headers) -> dict[str, str]:
    pairs = (part.partition("=") for line in headers.get_all("Cookie") for part in line.split(";"))
    return {name.strip(): value.strip() for name, _, value in pairs}


def _same(given: str, expected: str) -> bool:
    return hmac.compare_digest(given.encode(), expected.encode())


def _plain(status: http.HTTPStatus, text: str) -> Response:
    return _response(status, f"{text}\n".encode())


def _response(
    status: http.HTTPStatus,
    body: bytes,
    *,
    mime: str = "text/plain; charset=utf-8",
    headers: dict[str, str] | None = None,
) -> Response:
    every = {
        **SECURITY_HEADERS,
        "Content-Type": mime,
        "Content-Length": str(len(body)),
        "Connection": "close",
        **(headers or {}),
    }
    return Response(status, status.phrase, Headers(every), body)
