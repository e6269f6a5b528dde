"""A tab without a browser: enters through the gate and measures what a tab would get.

It fetches the page, opens the page's two sockets with the page's own handshake, and counts: scene
states on the pose socket, frames and statuses on `/live`, ages at the moment of arrival.
"""

from __future__ import annotations

import asyncio
import importlib.metadata
import json
import struct
from collections import defaultdict
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlsplit

import msgspec.msgpack
import numpy as np
import websockets
import zstandard
from websockets.asyncio.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

from spatial.stamp import NS_PER_MS, Clock, seconds

HEARTBEAT = "/heartbeat"
HEARTBEAT_WRAP_MS = 1_000_000
RETRY_S = 0.5
CAMERA_MODE = "half"


@dataclass(slots=True)
class TabFigures:
    """What the tab got."""

    started_ns: int = 0
    """First state seen [ns]; 0 before it."""
    last_ns: int = 0
    """Newest state seen [ns]."""
    ticks: int = 0
    """Distinct scene states on the pose socket."""
    scene_ms: list[float] = field(default_factory=list)
    """Arrival minus T*, by state [ms]."""
    predicted_ms: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    """Arrival minus the newest motion sample, by object [ms]."""
    seen_ms: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    """T* minus the newest image behind the pose, by object [ms]."""
    frame_ns: dict[str, list[int]] = field(default_factory=lambda: defaultdict(list))
    """Arrival stamps of frames, by camera [ns]."""
    video_ms: list[float] = field(default_factory=list)
    """Arrival minus capture, by frame [ms]."""
    dropped: int = 0
    """Frames that a newer one replaced before they were sent."""
    reconnects: int = 0
    """Sockets that had to be opened again."""

    def summary(self) -> dict[str, Any]:
        """Return the probe's part of the demo's JSON."""
        duration_s = max(seconds(self.last_ns - self.started_ns), 1e-3)
        merged = [value for values in self.predicted_ms.values() for value in values]
        return {
            "tab_hz": self.ticks / duration_s,
            "video_fps": {n: len(stamps) / duration_s for n, stamps in self.frame_ns.items()},
            "predicted_ms": percentiles(merged),
            "video_age_ms": percentiles(self.video_ms),
            "scene_age_ms": percentiles(self.scene_ms),
            "dropped": self.dropped,
            "reconnects": self.reconnects,
            "objects": {
                slug: {
                    "seen_ms": percentiles(self.seen_ms[slug]),
                    "predicted_ms": percentiles(self.predicted_ms[slug]),
                }
                for slug in self.predicted_ms
            },
        }


def percentiles(values: list[float]) -> dict[str, float | None]:
    """Return the median and the 95th percentile, null without values."""
    if not values:
        return {"p50": None, "p95": None}
    p50, p95 = np.percentile(values, (50, 95))
    return {"p50": float(p50), "p95": float(p95)}


class Probe:
    """Measures until it is stopped."""

    def __init__(self, url: str, *, clock: Clock) -> None:
        """Aim at a viewer's address."""
        parts = urlsplit(url)
        self._host = parts.netloc
        self._token = parts.query
        self._clock = clock
        self.figures = TabFigures()

    async def run(self, stop: asyncio.Event) -> None:
        """Hold both sockets open, reopening what breaks, until `stop` is set."""
        tasks = [
            asyncio.create_task(self._keep(self._poses)),
            asyncio.create_task(self._keep(self._live)),
        ]
        await stop.wait()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _keep(self, session: Any) -> None:
        while True:
            try:
                await session()
            except (OSError, websockets.WebSocketException):
                self.figures.reconnects += 1
            await asyncio.sleep(RETRY_S)

    def _connect(self, path: str, subprotocol: str | None = None) -> connect:
        protocols = [Subprotocol(subprotocol)] if subprotocol is not None else None
        query = f"?{self._token}" if self._token else ""
        return connect(
            f"ws://{self._host}{path}{query}",
            origin=Origin(f"http://{self._host}"),
            subprotocols=protocols,
            max_size=None,
            compression=None,
        )

    async def _poses(self) -> None:
        async with self._connect("/", f"viser-v{importlib.metadata.version('viser')}") as socket:
            last = -1.0
            async for data in socket:
                for tick, instant_ms in heartbeats(data):
                    if tick != last:
                        last = tick
                        self._count_state(instant_ms)

    def _count_state(self, instant_ms: float) -> None:
        now_ns = self._clock.now_ns()
        figures = self.figures
        figures.started_ns = figures.started_ns or now_ns
        figures.last_ns = now_ns
        figures.ticks += 1
        age_ms = (now_ns / NS_PER_MS - instant_ms) % HEARTBEAT_WRAP_MS
        figures.scene_ms.append(age_ms)

    async def _live(self) -> None:
        async with self._connect("/live") as socket:
            async for data in socket:
                if isinstance(data, str):
                    await self._hear(socket, json.loads(data))
                else:
                    await self._look(socket, data)

    async def _hear(self, socket: ClientConnection, said: dict[str, Any]) -> None:
        if said["kind"] == "hello":
            for camera in said["cameras"]:
                wish = {"kind": "subscribe", "camera": camera, "mode": CAMERA_MODE}
                await socket.send(json.dumps(wish))
        elif said["kind"] == "status":
            since_ms = self._clock.now_ns() / NS_PER_MS - said["instant_ms"]
            for item in said["objects"]:
                if item["predicted_ms"] is not None:
                    self.figures.predicted_ms[item["slug"]].append(item["predicted_ms"] + since_ms)
                if item["seen_ms"] is not None:
                    self.figures.seen_ms[item["slug"]].append(item["seen_ms"])

    async def _look(self, socket: ClientConnection, data: bytes) -> None:
        (size,) = struct.unpack_from("<I", data)
        header = json.loads(data[4 : 4 + size])
        await socket.send(json.dumps({"kind": "ack", "id": header["id"]}))
        now_ns = self._clock.now_ns()
        self.figures.frame_ns[header["camera"]].append(now_ns)
        self.figures.video_ms.append(now_ns / NS_PER_MS - header["stamp_ms"])
        self.figures.dropped += header["dropped"]


def heartbeats(data: bytes | str) -> list[tuple[float, float]]:
    """Return (tick, T* in ms modulo 10^6) of every heartbeat in one batch of the pose socket."""
    if isinstance(data, str) or len(data) < 16:
        return []
    size, packed = struct.unpack_from("<QQ", data)
    inner = zstandard.ZstdDecompressor().decompress(data[16 : 16 + packed], max_output_size=size)
    batch = msgspec.msgpack.decode(inner)
    return [
        (float(message["position"][0]), float(message["position"][1]))
        for message in batch["messages"]
        if message.get("type") == "SetPositionMessage" and message.get("name") == HEARTBEAT
    ]
