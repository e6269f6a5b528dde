"""`/live`: status and video to tabs, on a socket of its own so that video never delays a pose.

Server to tab: text, JSON with `kind` `hello`, `status` (at most 30 a second, newest wins); binary,
video frames (see `audience.VideoFrame.message`). Tab to server: text, JSON
`{"kind": "subscribe", "camera": NAME, "mode": off|full|half|quarter|overlay}` and
`{"kind": "ack", "id": ID}` for each frame, once it is decoded.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import threading
import time
from collections import deque
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from app.audience import Spectator, Variant, VideoFrame
from app.darkroom import Darkroom
from spatial.camera import PinholeCamera
from spatial.errors import InputError, unknown
from spatial.frames import Base, Cam
from spatial.pose import Pose

PROTOCOL = 1
FPS_SPAN_S = 2.0


@dataclass(frozen=True, slots=True, eq=False)
class _Shot:
    camera: str
    number: int
    stamp_ns: int
    jpeg: bytes
    T_base_cam: Pose[Base, Cam] | None


@dataclass(slots=True, eq=False)
class _Tab:
    spectator: Spectator
    wake: asyncio.Event
    loop: asyncio.AbstractEventLoop

    def post(self, item: VideoFrame | str) -> None:
        """Hand over a frame or a status, from any thread."""
        with contextlib.suppress(RuntimeError):  # its loop has ended: the server is stopping
            self.loop.call_soon_threadsafe(self._take, item)

    def _take(self, item: VideoFrame | str) -> None:
        if isinstance(item, str):
            self.spectator.offer_status(item)
        else:
            self.spectator.offer(item)
        self.wake.set()


class LiveChannel:
    """Takes newest frames and statuses from any thread and gives them to all tabs."""

    def __init__(self, cameras: Mapping[str, PinholeCamera]) -> None:
        """Serve the named cameras; intrinsics tell their sizes and distortion."""
        self._cameras = dict(cameras)
        self._rooms = {name: Darkroom(camera) for name, camera in cameras.items()}
        self._lock = threading.Lock()
        self._tabs: set[_Tab] = set()
        self._latest: dict[str, _Shot] = {}
        self._requested: set[str] = set()
        self._numbers = dict.fromkeys(cameras, 0)
        self._status: str | None = None
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="darkroom")
        self._arrivals: dict[str, deque[float]] = {n: deque(maxlen=256) for n in cameras}
        self.unreadable = 0
        """Frames that could not be decoded."""

    @property
    def clients(self) -> int:
        """Number of tabs."""
        return len(self._tabs)

    def offer_frame(
        self,
        camera: str,
        *,
        stamp_ns: int,
        jpeg: bytes,
        T_base_cam: Pose[Base, Cam] | None = None,
    ) -> None:
        """Offer a newer image; returns at once.

        Args:
            camera: name of a camera.
            stamp_ns: capture stamp [ns].
            jpeg: the image as it came.
            T_base_cam: pose of the camera at that stamp, for overlays.

        Raises:
            InputError: an unknown camera.
        """
        if camera not in self._cameras:
            raise InputError(unknown("camera", camera, self._cameras))
        with self._lock:
            self._numbers[camera] += 1
            self._arrivals[camera].append(time.monotonic())
            self._latest[camera] = _Shot(camera, self._numbers[camera], stamp_ns, jpeg, T_base_cam)
        self._request(camera)

    def offer_status(self, status: Mapping[str, Any]) -> None:
        """Offer a newer status; NaN and other non-JSON values raise ValueError or TypeError."""
        text = json.dumps({"kind": "status", **status}, separators=(",", ":"), allow_nan=False)
        with self._lock:
            self._status = text
            tabs = tuple(self._tabs)
        for tab in tabs:
            tab.post(text)

    def video_figures(self) -> dict[str, dict[str, float]]:
        """Return the rate at which frames came in, by camera: `{"hc": {"fps": 24.9}}`."""
        now = time.monotonic()
        with self._lock:
            return {
                name: {"fps": round(sum(now - t < FPS_SPAN_S for t in times) / FPS_SPAN_S, 1)}
                for name, times in self._arrivals.items()
            }

    def close(self) -> None:
        """Stop preparing frames; tabs end with the server."""
        self._worker.shutdown(wait=False, cancel_futures=True)

    async def handle(self, connection: ServerConnection) -> None:
        """Serve one tab until it leaves."""
        tab = _Tab(Spectator(), asyncio.Event(), asyncio.get_running_loop())
        with self._lock:
            self._tabs.add(tab)
            if self._status is not None:
                tab.spectator.offer_status(self._status)
        tab.wake.set()
        speaker = asyncio.create_task(self._speak(connection, tab))
        try:
            async for message in connection:
                self._hear(tab, message)
        except ConnectionClosed:
            pass  # how tabs leave
        finally:
            with self._lock:
                self._tabs.discard(tab)
            speaker.cancel()
            await asyncio.gather(speaker, return_exceptions=True)

    async def _speak(self, connection: ServerConnection, tab: _Tab) -> None:
        hello = {"kind": "hello", "protocol": PROTOCOL, "cameras": sorted(self._cameras)}
        try:
            await connection.send(json.dumps(hello))
            while True:
                wait_s = tab.spectator.wait_s(now_s=time.monotonic())
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(tab.wake.wait(), wait_s)
                tab.wake.clear()
                await self._send_due(connection, tab.spectator)
        except ConnectionClosed:
            return

    async def _send_due(self, connection: ServerConnection, spectator: Spectator) -> None:
        while True:
            now = time.monotonic()
            status = spectator.next_status(now_s=now)
            frame = None if status is not None else spectator.next_frame(now_s=now)
            if status is None and frame is None:
                return
            await connection.send(status if status is not None else frame or b"")

    def _hear(self, tab: _Tab, message: str | bytes) -> None:
        before = dict(tab.spectator.wishes)
        tab.spectator.hear(message, now_s=time.monotonic(), cameras=frozenset(self._cameras))
        for camera, wish in tab.spectator.wishes.items():
            if before.get(camera) is not wish:
                self._request(camera)  # a picture at once, even when the stream rests
        tab.wake.set()

    def _request(self, camera: str) -> None:
        """Have the newest shot prepared, unless nobody wants it or that is about to happen."""
        with self._lock:
            wanted = any(t.spectator.wanted(camera) is not Variant.OFF for t in self._tabs)
            if not wanted or camera in self._requested or camera not in self._latest:
                return
            self._requested.add(camera)
        with contextlib.suppress(RuntimeError):  # closed meanwhile
            self._worker.submit(self._develop, camera)

    def _develop(self, camera: str) -> None:
        """Prepare the newest shot in every variant a tab wants (worker thread)."""
        with self._lock:
            self._requested.discard(camera)
            shot = self._latest[camera]
            tabs = tuple(self._tabs)
        wanted = {tab.spectator.wanted(camera) for tab in tabs} - {Variant.OFF}
        for variant in sorted(wanted, key=lambda v: v.value):
            frame = self._frame(shot, variant)
            if frame is None:
                self.unreadable += 1
                continue
            for tab in tabs:
                tab.post(frame)

    def _frame(self, shot: _Shot, variant: Variant) -> VideoFrame | None:
        developed = self._rooms[shot.camera].develop(shot.jpeg, variant)
        if developed is None:
            return None
        c = developed.camera
        meta: dict[str, Any] = {"width": c.width, "height": c.height}
        if variant is Variant.OVERLAY:
            meta["K"] = [c.fx, c.fy, c.cx, c.cy]
            if shot.T_base_cam is not None and shot.T_base_cam.is_finite():
                meta["T_base_cam"] = shot.T_base_cam.matrix.ravel().tolist()
        return VideoFrame(shot.camera, shot.number, shot.stamp_ns, developed.jpeg, meta, variant)


def _deliver(tab: _Tab, frame: VideoFrame) -> None:
    tab.spectator.offer(frame)
    tab.wake.set()
