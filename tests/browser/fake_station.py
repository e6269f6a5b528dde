"""A station without a site: shows a made-up scene through the real gate, stage and live channel.

Run as a script (`fake_station.py PORT`) it serves until it is killed; tests import its parts.
"""

from __future__ import annotations

import sys
import threading
import time
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from app.gate import GateSettings
from app.live import LiveChannel
from app.looks import ObjectLook, StageLook, link_looks, object_look
from app.stage import Stage
from app.status import status_of
from app.viser_port import ViserPort
from scene.fixture import Fixture
from scene.graph import ObjectNode, SceneState
from scene.mesh import box_mesh, cylinder_mesh
from scene.robot import Robot, load_robot
from spatial.camera import PinholeCamera
from spatial.frames import Base, Cam, Object
from spatial.pose import Pose
from spatial.solids import Box, Cylinder, Plane
from spatial.tracked import TrackState

ROBOT = Path(__file__).parents[2] / "assets" / "robots" / "sam" / "robot.urdf"
CAMERAS = {
    "hc": PinholeCamera(1280, 960, 1078.0, 1078.0, 639.5, 479.5),
    "mako": PinholeCamera(1292, 964, 1100.0, 1100.0, 645.5, 481.5),
}
START_NS = 1_760_000_000_000_000_000
REST = {"A1": 0.3, "A2": 0.5, "E1": 0.0, "A3": -1.2, "A4": 0.0, "A5": 0.9, "A6": 0.0}
STATES = {
    "plate": TrackState.TRACKED,
    "peg": TrackState.TRACKED,
    "cage": TrackState.BRIDGED,
    "wheel": TrackState.STALE,
    "crawler": TrackState.LOST,
    "mark": TrackState.TRACKED,
}
REASONS = {
    "cage": "no camera sees a tag; carried by the motion of hc",
    "wheel": "motion 412 ms old",
    "crawler": "moved out of sight",
}
PLACES = {
    "plate": (0.45, 0.25, 1.32),
    "peg": (0.45, 0.25, 1.15),
    "cage": (0.10, -0.45, 1.30),
    "wheel": (-0.40, 0.35, 1.25),
    "crawler": (-0.35, -0.35, 1.38),
    "mark": (-0.6, 0.0, 1.38),
}


def looks() -> tuple[ObjectLook, ...]:
    """Return plain bodies, the plate with walls around the peg."""
    fixtures = (
        Fixture("channel", "inside", Box((0.20, 0.20, 0.30)), Pose.translated(0.0, 0.0, -0.17)),
        Fixture("seat", "inside", Cylinder(0.05, 0.18), Pose.translated(0.0, 0.0, -0.10)),
        Fixture("guard", "forbidden", Plane((0.5, 0.4)), Pose.translated(0.0, 0.0, -0.03)),
    )
    grey, yellow, blue = (150, 156, 164, 255), (214, 176, 72, 255), (92, 132, 170, 255)
    return (
        object_look(
            "plate",
            box_mesh(np.array([0.4, 0.4, 0.03])).coloured(grey),
            name="Hole plate",
            fixtures=fixtures,
        ),
        object_look("peg", cylinder_mesh(0.03, 0.16).coloured(yellow), name="Peg"),
        object_look("cage", box_mesh(np.array([0.3, 0.3, 0.2])).coloured(yellow), name="Cage"),
        object_look("wheel", cylinder_mesh(0.12, 0.04).coloured(blue), name="Valve wheel"),
        object_look("mark", box_mesh(np.full(3, 0.02)).coloured((40, 220, 40, 255)), name="Mark"),
        object_look("crawler", box_mesh(np.array([0.3, 0.18, 0.1])).coloured(blue), name="Crawler"),
    )


def stage_look(robot: Robot) -> StageLook:
    """Return the looks of the made-up scene."""
    return StageLook(link_looks(robot), looks(), CAMERAS)


class FakeScene:
    """Makes states: the arm sways, the peg goes round."""

    def __init__(self, robot: Robot) -> None:
        """Remember the robot; states may be overridden by tests."""
        self.robot = robot
        self.tick = 0
        self.still = False
        self.states = dict(STATES)
        self.places: dict[str, tuple[float, float, float]] = dict(PLACES)
        self.broken: set[str] = set()

    def at(self, seconds: float) -> SceneState:
        """Return the state at a time [s] after the start."""
        self.tick += 1
        phase = 0.0 if self.still else seconds
        joints = {
            name: q + 0.25 * np.sin(0.7 * phase + i) for i, (name, q) in enumerate(REST.items())
        }
        Ts_root_link = self.robot.fk(joints)
        # Links are known by name only; which frame each stands for is not in its type.
        T_base_root: Any = Ts_root_link["base"].inverse()
        Ts_base: dict[str, Any] = {name: T_base_root @ T for name, T in Ts_root_link.items()}
        tilt: Any = Pose.exp((0, 0, 0, 0.02 * np.sin(phase), 0.02 * np.cos(phase), 0))
        return SceneState(
            instant_ns=START_NS + int(seconds * 1e9),
            tick=self.tick,
            Ts_base_link=Ts_base,
            T_base_tcp=Ts_base["tcp"],
            T_base_platform=Ts_base["platform"],
            T_base_w=Ts_base["platform"] @ tilt,
            Ts_base_cam={name: Ts_base[name] for name in CAMERAS},
            objects=tuple(self._object(slug, phase) for slug in self.states),
            robot_ms=6.0,
        )

    def _object(self, slug: str, phase: float) -> ObjectNode:
        pose: Pose[Base, Object] = Pose.translated(*self.places[slug])
        if slug == "peg":
            x, y, z = self.places[slug]
            pose = Pose.translated(x + 0.03 * np.cos(phase), y + 0.03 * np.sin(phase), z)
        if slug in self.broken:
            pose = Pose(np.full((4, 4), np.nan))
        state = self.states[slug]
        seen = {"tracked": 48.0, "bridged": 2400.0, "stale": 7300.0, "lost": 61_000.0}
        raw: Pose[Base, Object] = pose @ Pose.translated(0.012, -0.008, 0.0)
        return ObjectNode(
            slug=slug,
            revision=1,
            state=state,
            hierarchy="flat" if slug == "crawler" else "nested",
            T_base_object=pose,
            T_base_object_raw=raw,
            covariance_base=np.eye(3) * (0.004 if state is TrackState.BRIDGED else 0.0008) ** 2,
            seen_ms=seen[state.value],
            predicted_ms=31.0,
            camera="mako" if slug == "crawler" else "hc",
            reason=REASONS.get(slug, ""),
        )


def picture(camera: str, seconds: float, scene: FakeScene | None = None) -> bytes:
    """Return a JPEG with a test pattern: a ramp, a moving bar, a disc where the mark is."""
    intrinsics = CAMERAS[camera]
    ramp = np.linspace(40, 90, intrinsics.width, dtype=np.uint8)
    image = np.dstack([np.tile(ramp, (intrinsics.height, 1))] * 3)
    x = int(seconds * 200) % intrinsics.width
    cv2.rectangle(image, (x, 0), (x + 24, intrinsics.height), (150, 150, 150), -1)
    if scene is not None:
        state = scene.at(seconds)
        scene.tick -= 1
        mark = next(node for node in state.objects if node.slug == "mark")
        assert mark.T_base_object is not None
        p = (state.Ts_base_cam[camera].inverse() @ mark.T_base_object).translation
        if p[2] > 0.05:
            u, v = intrinsics.project(p)
            centre = (round(float(u) * 16), round(float(v) * 16))
            cv2.circle(image, centre, 9 * 16, (40, 220, 40), -1, cv2.LINE_AA, 4)
    done, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 80])
    assert done
    return data.tobytes()


class FakeStation:
    """The parts of a station that face the browser."""

    def __init__(self, *, port: int = 0, settings: GateSettings | None = None) -> None:
        """Bind the port and build the scene."""
        robot = load_robot(ROBOT)
        self.scene = FakeScene(robot)
        self.live = LiveChannel(CAMERAS)
        self.port = ViserPort(settings or GateSettings(port=port), live=self.live)
        self.stage = Stage(self.port, stage_look(robot))
        self.names = {look.slug: look.name for look in looks()}
        self._stopped = threading.Event()

    def step(self, seconds: float, *, replay: bool = False) -> SceneState:
        """Show the state at a time, with its status."""
        state = self.scene.at(seconds)
        self.stage.show(state)
        status = status_of(state, site="sam", target="plate", names=self.names, replay=replay)
        self.live.offer_status({**status, "video": self.live.video_figures()})
        return state

    def film(self, seconds: float) -> None:
        """Offer an image of every camera, captured 60 ms ago."""
        then = max(0.0, seconds - 0.06)
        before = self.scene.at(then)
        self.scene.tick -= 1
        for camera in CAMERAS:
            T_base_cam: Pose[Base, Cam] = before.Ts_base_cam[camera]
            self.live.offer_frame(
                camera,
                stamp_ns=before.instant_ns,
                jpeg=picture(camera, then, self.scene),
                T_base_cam=T_base_cam,
            )

    def run(self, duration_s: float = 1e9, *, hz: float = 30.0, film_hz: float = 12.0) -> None:
        """Show and film in real time."""
        start = time.monotonic()
        next_film = 0.0
        while (now := time.monotonic() - start) < duration_s and not self._stopped.is_set():
            self.step(now)
            if now >= next_film:
                self.film(now)
                next_film = now + 1.0 / film_hz
            time.sleep(max(0.0, 1.0 / hz - (time.monotonic() - start - now)))

    def stop(self) -> None:
        """End `run`."""
        self._stopped.set()

    def close(self) -> None:
        """Give the port back."""
        self.live.close()
        self.port.close()


def main() -> None:
    """Serve until killed."""
    station = FakeStation(port=int(sys.argv[1]) if len(sys.argv) > 1 else 8091)
    sys.stdout.write(f"{station.port.url}\n")
    sys.stdout.flush()
    try:
        station.run()
    except KeyboardInterrupt:
        station.close()


if __name__ == "__main__":
    main()
