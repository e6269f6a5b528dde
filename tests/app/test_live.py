"""`/live`: status and newest-only video; what a slow tab does not take is dropped, never queued."""

from __future__ import annotations

import json
import struct
import time
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.sync.connection import Connection

from app.audience import MIN_BUDGET_BYTES, Spectator, Variant, VideoFrame
from app.darkroom import Darkroom
from app.gate import GateSettings
from app.live import LiveChannel
from app.viser_port import ViserPort
from spatial.camera import PinholeCamera
from spatial.errors import InputError
from spatial.pose import Pose

STRAIGHT = PinholeCamera(320, 240, 300.0, 301.0, 160.0, 120.0)
BENT = PinholeCamera(320, 240, 300.0, 301.0, 160.0, 120.0, (-0.28, 0.09, 0.0, 0.0, 0.0))
NAMES = frozenset({"hc"})


def frame(number: int, *, size: int = 1000, variant: Variant = Variant.FULL) -> VideoFrame:
    return VideoFrame("hc", number, number * 40_000_000, bytes(size), {}, variant)


def header_of(message: bytes) -> dict[str, Any]:
    length = struct.unpack_from("<I", message)[0]
    return dict(json.loads(message[4 : 4 + length]))


def watching(mode: str = "full") -> Spectator:
    tab = Spectator()
    tab.hear(
        json.dumps({"kind": "subscribe", "camera": "hc", "mode": mode}), now_s=0, cameras=NAMES
    )
    return tab


def acknowledge(tab: Spectator, message: bytes, *, now_s: float) -> None:
    text = json.dumps({"kind": "ack", "id": header_of(message)["id"]})
    tab.hear(text, now_s=now_s, cameras=NAMES)


def test_nobody_gets_what_they_did_not_ask_for() -> None:
    tab = Spectator()
    tab.offer(frame(1))
    assert tab.next_frame(now_s=0.0) is None
    tab = watching("half")
    tab.offer(frame(1))
    assert tab.next_frame(now_s=0.0) is None


def test_only_the_newest_frame_waits_and_the_others_are_counted() -> None:
    tab = watching()
    tab.window = 1
    tab.offer(frame(1))
    first = tab.next_frame(now_s=0.0)
    assert first is not None
    for number in (2, 3, 4, 5):
        tab.offer(frame(number))
    assert tab.next_frame(now_s=0.01) is None, "one is on its way"
    acknowledge(tab, first, now_s=0.05)
    second = tab.next_frame(now_s=0.05)
    assert second is not None
    assert (header_of(second)["frame"], header_of(second)["dropped"]) == (5, 3)
    assert tab.dropped == {"hc": 3}


def test_bytes_in_flight_are_bounded_by_what_the_link_carries() -> None:
    tab = watching()
    tab.window = 3
    size = MIN_BUDGET_BYTES
    for number in range(1, 5):
        tab.offer(frame(number, size=size))
        tab.next_frame(now_s=0.0)
    assert tab.in_flight_bytes < 2 * size


def test_a_slow_link_gets_one_frame_at_a_time_and_smaller_ones() -> None:
    tab = watching("half")
    now = 0.0
    for number in range(1, 6):
        tab.offer(frame(number, size=40_000, variant=tab.wanted("hc")))
        message = tab.next_frame(now_s=now)
        assert message is not None
        now += 0.5
        acknowledge(tab, message, now_s=now)
    assert tab.window == 1
    assert tab.wanted("hc") is Variant.QUARTER


def test_a_lost_acknowledgement_does_not_stop_the_video_for_good() -> None:
    tab = watching()
    tab.window = 1
    tab.offer(frame(1))
    assert tab.next_frame(now_s=0.0)
    tab.offer(frame(2))
    wait = tab.wait_s(now_s=0.5)
    assert wait is not None
    assert tab.next_frame(now_s=0.5 + wait + 0.01)


def test_cameras_take_turns() -> None:
    tab = Spectator()
    for camera in ("a", "b"):
        text = json.dumps({"kind": "subscribe", "camera": camera, "mode": "full"})
        tab.hear(text, now_s=0.0, cameras=frozenset({"a", "b"}))
    got = []
    for number in range(1, 7):
        for camera in ("a", "b"):
            tab.offer(VideoFrame(camera, number, 0, b"x", {}, Variant.FULL))
        message = tab.next_frame(now_s=number * 0.1)
        assert message is not None
        got.append(header_of(message)["camera"])
        acknowledge(tab, message, now_s=number * 0.1 + 0.01)
    assert got.count("a") == got.count("b") == 3


def test_status_comes_at_most_thirty_times_a_second_and_newest() -> None:
    tab = Spectator()
    sent = []
    for i in range(200):
        tab.offer_status(str(i))
        text = tab.next_status(now_s=i * 0.005)
        if text is not None:
            sent.append(int(text))
    assert 27 <= len(sent) <= 31
    assert sent == sorted(sent)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{",
        "[]",
        "null",
        '{"kind": "ack"}',
        '{"kind": "ack", "id": null}',
        '{"kind": "ack", "id": 1e999}',
        '{"kind": "subscribe", "camera": "x", "mode": "full"}',
        '{"kind": "subscribe", "camera": ["hc"], "mode": "full"}',
        '{"kind": "subscribe", "camera": "hc", "mode": "huge"}',
        '{"kind": "launch"}',
        "[" * 5000,
        b"\x00",
    ],
)
def test_nonsense_is_counted_and_changes_nothing(text: str | bytes) -> None:
    tab = Spectator()
    tab.hear(text, now_s=0.0, cameras=NAMES)
    assert tab.bad_messages == 1
    assert not tab.wishes


@pytest.fixture(scope="module")
def station() -> Iterator[tuple[LiveChannel, ViserPort]]:
    live = LiveChannel({"hc": BENT, "mako": STRAIGHT})
    with ViserPort(GateSettings(port=0), live=live) as port:
        yield live, port
    live.close()


def tab_of(port: ViserPort) -> Connection:
    return connect(f"ws://127.0.0.1:{port.gate.port}/live", open_timeout=10)


def jpeg(camera: PinholeCamera) -> bytes:
    image = np.full((camera.height, camera.width, 3), 90, np.uint8)
    cv2.rectangle(image, (20, 20), (300, 220), (200, 200, 200), 3)
    return cv2.imencode(".jpg", image)[1].tobytes()


def next_video(tab: Connection) -> tuple[dict[str, Any], np.ndarray]:
    while True:
        message = tab.recv(timeout=10)
        if isinstance(message, bytes):
            header = header_of(message)
            tab.send(json.dumps({"kind": "ack", "id": header["id"]}))
            start = 4 + struct.unpack_from("<I", message)[0]
            image = cv2.imdecode(np.frombuffer(message[start:], np.uint8), cv2.IMREAD_COLOR)
            assert image is not None
            return header, image


def test_a_tab_hears_of_the_cameras_then_the_newest_status(
    station: tuple[LiveChannel, ViserPort],
) -> None:
    live, port = station
    live.offer_status({"tick": 5})
    with tab_of(port) as tab:
        hello = json.loads(tab.recv(timeout=5))
        assert (hello["kind"], hello["cameras"]) == ("hello", ["hc", "mako"])
        assert json.loads(tab.recv(timeout=5)) == {"kind": "status", "tick": 5}
        live.offer_status({"tick": 6})
        assert json.loads(tab.recv(timeout=5))["tick"] == 6


@pytest.mark.parametrize(
    ("mode", "size"), [("full", (320, 240)), ("half", (160, 120)), ("quarter", (80, 60))]
)
def test_a_tab_gets_the_size_it_asked_for(
    station: tuple[LiveChannel, ViserPort], mode: str, size: tuple[int, int]
) -> None:
    live, port = station
    with tab_of(port) as tab:
        tab.send(json.dumps({"kind": "subscribe", "camera": "mako", "mode": mode}))
        live.offer_frame("mako", stamp_ns=1_760_000_000_000_000_000, jpeg=jpeg(STRAIGHT))
        header, image = next_video(tab)
    assert (header["width"], header["height"]) == size
    assert image.shape[1::-1] == size
    assert header["stamp_ms"] == 1_760_000_000_000.0


def test_an_image_of_before_greets_whoever_subscribes_later(
    station: tuple[LiveChannel, ViserPort],
) -> None:
    live, port = station
    live.offer_frame("mako", stamp_ns=77_000_000, jpeg=jpeg(STRAIGHT))
    with tab_of(port) as tab:
        tab.send(json.dumps({"kind": "subscribe", "camera": "mako", "mode": "full"}))
        assert next_video(tab)[0]["stamp_ms"] == 77.0


def test_an_overlay_is_undistorted_and_tells_where_the_camera_was(
    station: tuple[LiveChannel, ViserPort],
) -> None:
    live, port = station
    T_base_cam: Any = Pose.translated(0.1, 0.2, 0.3)
    with tab_of(port) as tab:
        tab.send(json.dumps({"kind": "subscribe", "camera": "hc", "mode": "overlay"}))
        live.offer_frame("hc", stamp_ns=10, jpeg=jpeg(BENT), T_base_cam=T_base_cam)
        header, image = next_video(tab)
    assert header["K"] == [300.0, 301.0, 160.0, 120.0]
    assert np.reshape(header["T_base_cam"], (4, 4))[:3, 3].tolist() == [0.1, 0.2, 0.3]
    # The straight line at row 20 of the distorted image bends outward in the corners.
    original = cv2.imdecode(np.frombuffer(jpeg(BENT), np.uint8), cv2.IMREAD_COLOR)
    assert original is not None
    assert np.abs(image.astype(int) - original).max() > 60


def test_a_tab_that_does_not_read_holds_nobody_up(station: tuple[LiveChannel, ViserPort]) -> None:
    live, port = station
    noise = np.random.default_rng(1).integers(0, 255, (240, 320, 3), np.uint8)
    data = cv2.imencode(".jpg", noise, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
    with tab_of(port) as idle, tab_of(port) as eager:
        for tab in (idle, eager):
            tab.send(json.dumps({"kind": "subscribe", "camera": "mako", "mode": "full"}))
        time.sleep(0.2)
        numbers = []
        for number in range(30):
            live.offer_frame("mako", stamp_ns=1000 + number, jpeg=data)
            numbers.append(next_video(eager)[0]["frame"])
        assert numbers == sorted(numbers)
        assert len(numbers) == 30
        idle_frames = 0
        while idle_frames < 10:
            try:
                idle_frames += isinstance(idle.recv(timeout=0.3), bytes)
            except (TimeoutError, ConnectionClosed):
                break
        assert idle_frames <= 4


def test_an_unreadable_image_is_counted_and_the_next_one_comes(
    station: tuple[LiveChannel, ViserPort],
) -> None:
    live, port = station
    with tab_of(port) as tab:
        tab.send(json.dumps({"kind": "subscribe", "camera": "mako", "mode": "half"}))
        time.sleep(0.2)
        before = live.unreadable
        live.offer_frame("mako", stamp_ns=1, jpeg=b"not a jpeg")
        time.sleep(0.2)
        live.offer_frame("mako", stamp_ns=2, jpeg=jpeg(STRAIGHT))
        while next_video(tab)[0]["stamp_ms"] != 2e-6:
            pass
        assert live.unreadable == before + 1


@pytest.mark.parametrize("data", [b"", b"\xff\xd8\xff", b"x" * 5000])
def test_what_is_no_image_is_told_so(data: bytes) -> None:
    for variant in (Variant.HALF, Variant.QUARTER, Variant.OVERLAY):
        assert Darkroom(BENT).develop(data, variant) is None


def test_an_image_of_another_size_than_the_camera_is_refused() -> None:
    other = PinholeCamera(640, 480, 300.0, 300.0, 320.0, 240.0)
    assert Darkroom(BENT).develop(jpeg(other), Variant.HALF) is None
    assert Darkroom(BENT).develop(jpeg(BENT), Variant.HALF) is not None


def test_an_image_within_the_videos_budget_passes_untouched() -> None:
    small = BENT.scaled(BENT.width // 2, BENT.height // 2)
    printed = Darkroom(BENT).develop(jpeg(small), Variant.HALF)
    assert printed is not None
    assert printed.jpeg == jpeg(small)
    assert (printed.camera.width, printed.camera.height) == (small.width, small.height)


def test_intrinsics_of_an_overlay_are_those_of_its_pixels() -> None:
    small = BENT.scaled(BENT.width // 2, BENT.height // 2)
    printed = Darkroom(BENT).develop(jpeg(small), Variant.OVERLAY)
    assert printed is not None
    ray = np.array([0.1, -0.05, 1.0])
    whole = BENT.undistorted().project(ray)
    np.testing.assert_allclose(2.0 * (printed.camera.project(ray) + 0.5) - 0.5, whole, atol=1e-9)
    assert not any(printed.camera.distortion)


def test_unknown_cameras_and_nan_are_refused_where_they_are_offered(
    station: tuple[LiveChannel, ViserPort],
) -> None:
    live, _ = station
    with pytest.raises(InputError, match="available: hc, mako"):
        live.offer_frame("thermal", stamp_ns=1, jpeg=b"")
    with pytest.raises(ValueError, match="JSON"):
        live.offer_status({"robot_ms": float("nan")})
