"""The operator's page in a real Chromium, by its pixels and its nodes, off the network."""

from __future__ import annotations

import importlib.util
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import cv2
import numpy as np
import pytest
from playwright.sync_api import BrowserContext, Page, sync_playwright

from app.gate import GateSettings
from spatial.pose import Pose
from spatial.tracked import TrackState

pytestmark = pytest.mark.browser

HERE = Path(__file__).parent
CHROMIUM = "/usr/bin/chromium"
FLAGS = [
    "--headless=new",
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--proxy-server=127.0.0.1:9",  # nothing answers there: off the network but for loopback
    "--proxy-bypass-list=127.0.0.1",
]
SIZE = {"width": 640, "height": 480}
READY = "window.telepresence?.page?._framed === true"
PAGE = "window.telepresence.page"


def load_station() -> ModuleType:
    spec = importlib.util.spec_from_file_location("fake_station", HERE / "fake_station.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["fake_station"] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def station() -> Iterator[Any]:
    made = load_station().FakeStation()
    thread = threading.Thread(target=made.run, daemon=True, kwargs={"hz": 20.0, "film_hz": 6.0})
    thread.start()
    yield made
    made.stop()
    thread.join(timeout=5)
    made.close()


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[BrowserContext]:
    if not Path(CHROMIUM).exists():
        pytest.fail("the page is tested in Chromium: apt-get install chromium")
    with sync_playwright() as playwright:
        context = playwright.chromium.launch_persistent_context(
            tmp_path_factory.mktemp("profile"),
            executable_path=CHROMIUM,
            args=FLAGS,
            ignore_default_args=["--headless"],
            viewport=SIZE,  # type: ignore[arg-type]  # a dict of the two sizes
            device_scale_factor=1,
        )
        yield context
        context.close()


@pytest.fixture(scope="module")
def tab(browser: BrowserContext, station: Any) -> Iterator[Page]:
    opened = open_page(browser, station.port.url)
    opened.evaluate(
        f"""() => {{
        window.hide = [];
        {PAGE}.viser.beforeRender(() => {{
          for (const n of window.hide.map(n => {PAGE}.viser.node(n))) if (n) n.visible = false;
        }});
        }}"""
    )
    yield opened
    opened.close()


@pytest.fixture
def page(tab: Page, station: Any) -> Page:
    """One tab for all tests, put back as it was at the start."""
    station.scene.still = False
    tab.bring_to_front()
    tab.evaluate(
        f"""() => {{
        window.hide = [];
        document.querySelectorAll('style.bare').forEach(e => e.remove());
        {PAGE}.view.go('free', {{smooth: false}});
        {PAGE}.view.frameAll();
        }}"""
    )
    return tab


def open_page(browser: BrowserContext, url: str, *, hash_text: str = "") -> Page:
    opened = browser.new_page()
    opened.goto(f"{url}?fixedDpr=1{hash_text}")
    opened.wait_for_function(READY, timeout=40_000)
    return opened


def settle(page: Page, frames: int = 3) -> None:
    """Wait until so many more pictures were drawn."""
    now = page.evaluate(f"{PAGE}.viser.requestRender(), {PAGE}.viser.frames")
    page.wait_for_function(f"{PAGE}.viser.frames >= {now + frames}", timeout=20_000)


def shot(page: Page) -> np.ndarray:
    image = cv2.imdecode(np.frombuffer(page.screenshot(), np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return image.astype(np.int32)


def bare(page: Page) -> None:
    """Leave only the picture."""
    page.evaluate(
        """() => {
        const style = document.createElement('style');
        style.className = 'bare';
        style.textContent = '.tp-hud{display:none} body{background:#000!important}';
        document.head.append(style);
        }"""
    )


def green_centre(image: np.ndarray) -> np.ndarray:
    b, g, r = image[..., 0], image[..., 1], image[..., 2]
    found = np.argwhere((g > 60) & (g > 1.6 * b) & (g > 1.6 * r))
    assert len(found) > 20, "the green mark is in the picture"
    return np.asarray(found.mean(axis=0)[::-1])


def test_the_page_loads_from_its_own_server_alone(browser: BrowserContext, station: Any) -> None:
    urls: list[str] = []
    errors: list[str] = []
    opened = browser.new_page()
    opened.on("request", lambda request: urls.append(request.url))
    opened.on("pageerror", lambda error: errors.append(str(error)))
    opened.goto(f"{station.port.url}?fixedDpr=1")
    opened.wait_for_function(READY, timeout=40_000)
    own = (station.port.url, f"ws://127.0.0.1:{station.port.gate.port}/", "blob:", "data:")
    assert [url for url in urls if not url.startswith(own)] == []
    assert errors == []
    opened.close()


def test_nothing_of_visers_widgets_is_seen(page: Page) -> None:
    visible = page.evaluate(
        "[...document.querySelectorAll('#root *')]"
        ".filter(e => getComputedStyle(e).visibility === 'visible').map(e => e.tagName)"
    )
    assert set(visible) <= {"CANVAS"}
    page.keyboard.press("Control+k")
    page.wait_for_timeout(200)
    assert page.evaluate(
        "[...document.body.children].filter(e => e.checkVisibility({visibilityProperty: true})"
        " && !/^tp-/.test(e.className)).map(e => e.id)"
    ) in ([], ["root"])


@pytest.mark.parametrize(("width", "height"), [(1280, 800), (1920, 1080)])
def test_the_parts_of_the_page_do_not_overlap(page: Page, width: int, height: int) -> None:
    page.wait_for_function(f"{PAGE}.panels._panels.size === 2")
    page.evaluate("document.querySelector('#root').style.display = 'none'")  # rest: it is slow
    page.set_viewport_size({"width": width, "height": height})
    page.wait_for_timeout(100)
    names = [".tp-header", ".tp-objects-card", ".tp-panels", ".tp-bar"]
    boxes = [page.locator(name).bounding_box() for name in names]
    for i, a in enumerate(boxes):
        assert a is not None
        assert a["x"] >= 0
        assert a["x"] + a["width"] <= width
        assert a["y"] + a["height"] <= height
        for b in boxes[:i]:
            assert b is not None
            apart = (
                a["x"] >= b["x"] + b["width"]
                or b["x"] >= a["x"] + a["width"]
                or a["y"] >= b["y"] + b["height"]
                or b["y"] >= a["y"] + a["height"]
            )
            assert apart, (a, b)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    page.set_viewport_size(SIZE)  # type: ignore[arg-type]  # a dict of the two sizes
    page.evaluate("document.querySelector('#root').style.display = ''")


def test_the_robot_moves(page: Page) -> None:
    bare(page)
    matrix = f"{PAGE}.viser.node('/site/robot/link_6').matrixWorld.toArray()"
    before, first = page.evaluate(matrix), shot(page)
    page.wait_for_timeout(1200)
    settle(page)
    after, second = page.evaluate(matrix), shot(page)
    assert np.abs(np.subtract(before, after)).max() > 0.01
    assert (np.abs(first - second).max(axis=2) > 40).sum() > 200


def test_every_object_says_its_state_in_words_and_both_ages(page: Page, station: Any) -> None:
    words = {
        slug: page.locator(f'[data-slug="{slug}"] .tp-word').inner_text()
        for slug in station.scene.states
    }
    assert words == {s: state.value.capitalize() for s, state in station.scene.states.items()}
    ages = page.locator('[data-slug="cage"] .tp-ages').inner_text()
    assert "seen 2." in ages
    assert "pred " in ages
    reason = page.locator('[data-slug="cage"] .tp-reason').inner_text()
    assert reason.startswith("no camera sees a tag")


def test_remote_text_stays_text(page: Page, station: Any) -> None:
    names = station.names
    station.names = {**names, "peg": "<img src=x onerror=alert(1)>"}
    try:
        page.wait_for_function(
            "document.querySelector('[data-slug=\"peg\"] .tp-name').textContent.startsWith('<img')"
        )
        assert page.locator(".tp-hud img").count() == 0
    finally:
        station.names = names


def test_panels_show_live_images_with_their_age(page: Page) -> None:
    page.wait_for_function(
        "[...document.querySelectorAll('.tp-panel')].length === 2 &&"
        "[...document.querySelectorAll('.tp-panel')].every(p => p.dataset.frames > 3)",
        timeout=20_000,
    )
    figures = page.evaluate(f"{PAGE}.live.figures('hc')")
    assert 40 <= figures["ageMs"] < 2000
    colour = page.evaluate(
        "[...document.querySelector('[data-camera=hc] canvas')"
        ".getContext('2d').getImageData(30, 30, 1, 1).data]"
    )
    assert 30 <= colour[0] <= 170
    assert page.locator("[data-camera=hc] .tp-age").inner_text().endswith(("ms", "s"))


AZIMUTHS = range(0, 360, 45)


def test_a_ghost_behind_walls_is_seen_from_every_side(page: Page, station: Any) -> None:
    station.scene.still = True
    states = dict(station.scene.states)
    station.scene.states["peg"] = TrackState.BRIDGED
    bare(page)
    page.wait_for_function(f"{PAGE}.viser.node('/site/objects/peg/bridged').visible")
    others = [f"/site/objects/{s}" for s in states if s not in ("peg", "plate")]
    others += [f"/site/{n}" for n in ("robot", "tool", "ground", "raw", "cameras")]
    others += ["/site/objects/plate/tracked"]
    peg, walls = "/site/objects/peg", "/site/objects/plate/walls"

    def picture(*hidden: str) -> np.ndarray:
        page.evaluate(f"window.hide = {[*others, *hidden]!r}")
        settle(page)
        return shot(page)

    try:
        for azimuth in AZIMUTHS:
            turn = np.radians(azimuth + 7)
            page.evaluate(
                f"""() => {{
                const v = {PAGE}.view, p = {PAGE}.viser.position('{peg}');
                const root = {PAGE}.viser.node('').matrixWorld.clone().invert();
                const c = p.applyMatrix4(root);
                v.pose = [c.x + {np.cos(turn)}, c.y + {np.sin(turn)}, c.z + 0.25,
                          c.x, c.y, c.z].join(',');
                }}"""
            )
            alone = np.abs(picture(walls) - picture(walls, peg)).max(axis=2) > 8
            behind = np.abs(picture() - picture(peg)).max(axis=2) > 8
            assert alone.sum() > 500
            assert (alone & behind).sum() > 0.9 * alone.sum(), f"hidden from {azimuth} degrees"
    finally:
        station.scene.states.update(states)


def test_a_second_tab_has_its_own_view(page: Page, browser: BrowserContext, station: Any) -> None:
    page.keyboard.press("7")
    other = open_page(browser, station.port.url, hash_text="#view=top")
    settle(other, 2)
    camera = f"[...{PAGE}.viser.camera.matrixWorld.elements]"
    first, second = page.evaluate(camera), other.evaluate(camera)
    assert np.abs(np.subtract(first, second)).max() > 0.5
    assert page.evaluate(f"{PAGE}.view.preset.id") == "front"
    assert other.evaluate(f"{PAGE}.view.preset.id") == "top"
    other.close()


def test_a_view_can_be_shared_by_its_address(
    page: Page, browser: BrowserContext, station: Any
) -> None:
    page.evaluate(f"{PAGE}.view.pose = '1.5,-1.2,0.3,0.1,0.2,-0.9'")
    settle(page)
    page.wait_for_function("location.hash.includes('from=1.500,-1.200,0.300,0.100,0.200,-0.900')")
    other = open_page(browser, station.port.url, hash_text=page.evaluate("location.hash"))
    settle(other)
    here, there = page.evaluate(f"{PAGE}.view.pose"), other.evaluate(f"{PAGE}.view.pose")
    assert np.allclose(
        [float(x) for x in here.split(",")], [float(x) for x in there.split(",")], atol=2e-3
    )
    other.close()


def test_following_the_tool_keeps_it_in_place_and_leaves_orbit_free(page: Page) -> None:
    page.keyboard.press("2")
    page.wait_for_timeout(500)
    offset = f"""() => {{
      const v = {PAGE}.viser, p = v.position('/site/tool');
      return p.applyMatrix4(v.camera.matrixWorldInverse).toArray();
    }}"""
    settle(page, 3)
    before = page.evaluate(offset)
    page.wait_for_timeout(1000)
    settle(page, 3)
    after = page.evaluate(offset)
    assert np.abs(np.subtract(before, after)).max() < 0.02
    page.mouse.move(320, 240)
    page.mouse.down()
    page.mouse.move(420, 240, steps=4)
    page.mouse.up()
    settle(page, 4)
    turned = page.evaluate(offset)
    assert page.evaluate(f"{PAGE}.view.preset.id") == "tool"
    assert np.abs(np.subtract(after, turned)).max() < 0.05, "the pivot stays in the middle"
    assert abs(page.evaluate(f"{PAGE}.viser.controls.azimuthAngle")) > 0.1


def in_front_of_the_hand(station: Any) -> None:
    state = station.scene.at(0.0)
    station.scene.tick -= 1
    ahead: Pose[Any, Any] = state.Ts_base_cam["hc"] @ Pose.translated(0.06, -0.05, 0.55)
    station.scene.places["mark"] = tuple(ahead.translation)


def test_the_image_lies_on_the_scene_to_the_pixel(page: Page, station: Any) -> None:
    station.scene.still = True
    in_front_of_the_hand(station)
    page.keyboard.press("4")
    bare(page)
    hidden = [f"/site/{n}" for n in ("robot", "tool", "raw", "ground")]
    hidden += [f"/site/objects/{s}" for s in station.scene.states if s != "mark"]
    page.evaluate(f"window.hide = {hidden!r}")
    page.wait_for_function(f"{PAGE}.overlay.header?.camera === 'hc'", timeout=20_000)
    page.wait_for_timeout(1500)
    centres = []
    for alpha in (0, 1):
        page.evaluate(f"{PAGE}.setAlpha({alpha})")
        settle(page, 3)
        centres.append(green_centre(shot(page)))
    assert np.abs(centres[0] - centres[1]).max() < 1.5, centres


def test_the_scene_under_the_image_is_of_the_same_stamp(page: Page, station: Any) -> None:
    in_front_of_the_hand(station)
    page.keyboard.press("4")
    page.wait_for_function(f"{PAGE}.overlay.header?.T_base_cam !== undefined", timeout=20_000)
    page.wait_for_timeout(800)
    errors = []
    for _ in range(4):
        settle(page, 2)
        drawn, header = page.evaluate(
            f"""() => {{
            const v = {PAGE}.viser, h = {PAGE}.overlay.header;
            const p = v.position('/site/objects/mark').applyMatrix4(v.camera.matrixWorldInverse);
            return [p.toArray(), h];
            }}"""
        )
        seconds = (header["stamp_ms"] - 1_760_000_000_000.0) / 1e3
        true = station.scene.at(seconds)
        station.scene.tick -= 1
        mark = next(n for n in true.objects if n.slug == "mark")
        p = (true.Ts_base_cam["hc"].inverse() @ mark.T_base_object).translation
        errors.append(np.abs(np.array(drawn) - p * (1, -1, -1)).max())
    assert max(errors) < 0.004, errors


def test_taking_hold_of_a_locked_view_frees_it_where_it_is(page: Page) -> None:
    page.keyboard.press("5")
    page.wait_for_function(f"{PAGE}.overlay.header?.camera === 'mako'", timeout=20_000)
    page.wait_for_timeout(500)
    settle(page)
    where = f"[...{PAGE}.viser.camera.matrixWorld.elements].slice(12, 15)"
    before = page.evaluate(where)
    page.mouse.move(330, 250)
    page.mouse.down()
    page.mouse.up()
    settle(page)
    assert page.evaluate(f"{PAGE}.view.preset.id") == "free"
    assert np.abs(np.subtract(page.evaluate(where), before)).max() < 0.05
    assert page.evaluate("document.querySelector('.tp-overlay').style.opacity") == "0"


def test_a_pose_that_is_not_finite_never_hides_an_object(page: Page, station: Any) -> None:
    visible = f"{PAGE}.viser.node('/site/objects/peg/tracked')?.visible"
    assert page.evaluate(visible)
    refused = station.port.refused_poses
    station.scene.broken.add("peg")
    try:
        page.wait_for_timeout(800)
        settle(page)
        assert station.port.refused_poses > refused
        where = page.evaluate(f"{PAGE}.viser.position('/site/objects/peg').toArray()")
        assert np.isfinite(where).all()
        assert page.evaluate(visible)
        assert page.locator(".tp-alarm").is_hidden()
    finally:
        station.scene.broken.clear()


@pytest.fixture
def process() -> Iterator[tuple[subprocess.Popen[str], str]]:
    started = start_station(0)
    yield started
    started[0].send_signal(signal.SIGCONT)
    end(started[0])


def start_station(port: int) -> tuple[subprocess.Popen[str], str]:
    process = subprocess.Popen(
        [sys.executable, str(HERE / "fake_station.py"), str(port)],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(HERE.parents[1])},
    )
    assert process.stdout is not None
    return process, process.stdout.readline().strip()


def end(process: subprocess.Popen[str]) -> None:
    process.kill()
    process.wait()
    assert process.stdout is not None
    process.stdout.close()


def test_a_frozen_station_is_never_mistaken_for_a_still_one(
    browser: BrowserContext, process: tuple[subprocess.Popen[str], str]
) -> None:
    station, url = process
    opened = open_page(browser, url)
    alarm = opened.locator(".tp-alarm")
    opened.wait_for_timeout(1500)
    assert alarm.is_hidden()
    station.send_signal(signal.SIGSTOP)
    start = time.monotonic()
    alarm.wait_for(state="visible", timeout=4000)
    assert time.monotonic() - start > 0.3
    assert "frozen" in alarm.inner_text()
    assert opened.locator(".tp-views button").first.is_disabled()
    opened.keyboard.press("6")
    assert opened.evaluate(f"{PAGE}.view.preset.id") == "free"
    station.send_signal(signal.SIGCONT)
    alarm.wait_for(state="hidden", timeout=4000)
    assert opened.locator(".tp-views button").first.is_enabled()
    opened.close()


def test_a_tab_without_focus_comes_back_when_the_station_does(
    browser: BrowserContext,
) -> None:
    first, url = start_station(0)
    second = None
    try:
        opened = open_page(browser, url)
        cover = browser.new_page()
        cover.bring_to_front()
        first.kill()
        first.wait()
        opened.locator(".tp-alarm").wait_for(state="visible", timeout=5000)
        second, _ = start_station(int(url.rsplit(":", 1)[1].strip("/")))
        opened.locator(".tp-alarm").wait_for(state="hidden", timeout=15_000)
        opened.wait_for_function(f"{PAGE}.viser.node('/site/robot/link_3/body') !== undefined")
        cover.close()
        opened.close()
    finally:
        for process in (first, second):
            if process is not None:
                end(process)


def test_a_replay_wears_its_badge(browser: BrowserContext) -> None:
    made = load_station().FakeStation(settings=GateSettings(port=0))
    done = threading.Event()

    def play() -> None:
        start = time.monotonic()
        while not done.wait(0.05):
            made.step(time.monotonic() - start, replay=True)

    thread = threading.Thread(target=play, daemon=True)
    thread.start()
    try:
        opened = open_page(browser, made.port.url)
        assert opened.locator(".tp-badge").inner_text().upper() == "REPLAY"
        assert opened.locator(".tp-badge").is_visible()
        opened.close()
    finally:
        done.set()
        thread.join(timeout=5)
        made.close()
