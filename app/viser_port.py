"""The only importer of viser: every write is typed, finite and named, and goes out in one batch.

Poses bypass viser's setters (42 us a call, and they drop moves below 1e-5 of the coordinate): the
messages are queued directly, inside `atomic` blocks no larger than one window of viser's sender,
then flushed, so that a browser applies a tick as a whole and 5 ms later instead of 18.
"""

from __future__ import annotations

import contextlib
import io
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Protocol, Self

import numpy as np
import viser
from viser import _messages as viser_messages

from app.gate import Gate, GateSettings, LiveHandler
from app.loop_event import LoopEvent
from spatial.errors import InputError, unknown
from spatial.pose import Pose
from spatial.rotation import Array

MAX_ATOMIC_NODES = 60
"""Two messages a node; viser's sender takes 128 messages in one batch."""
ROTATION_TOLERANCE = 1e-3
LIGHT_PROFILES = ("soft", "rich")
_NAME = re.compile(r"(/[A-Za-z0-9][A-Za-z0-9_.-]{0,63}){1,8}")
Color = tuple[int, int, int]


class ScenePort(Protocol):
    """What the stage needs of a renderer; tests have a twin in memory."""

    def add_group(self, name: str) -> None:
        """Make a node that carries others."""
        ...

    def add_glb(self, name: str, data: bytes, *, visible: bool = True) -> None:
        """Make a mesh of binary glTF, in metres."""
        ...

    def add_lines(
        self, name: str, segments: Array, *, color: Color, width_px: float, visible: bool = True
    ) -> None:
        """Make lines of segments (n, 2, 3) [m]."""
        ...

    def add_grid(self, name: str, *, size_m: float, visible: bool = True) -> None:
        """Make a ground grid in the plane z = 0 of its node."""
        ...

    def update(self, poses: Mapping[str, Pose[Any, Any]], visible: Mapping[str, bool]) -> int:
        """Move and show nodes; return how many poses were refused."""
        ...

    def flush(self) -> None:
        """Send what is queued now."""
        ...


class ViserPort:
    """viser's server behind the gate, and the writes to its scene."""

    def __init__(
        self, settings: GateSettings, *, live: LiveHandler, light_profile: str = "soft"
    ) -> None:
        """Bind the port and start to serve.

        Args:
            settings: where to listen and whom to let in.
            live: who answers on `/live`.
            light_profile: `soft` (no shadows, no environment map: fit for software rendering) or
                `rich`.

        Raises:
            MissingError: the port is taken.
            InputError: an unknown light profile.
        """
        if light_profile not in LIGHT_PROFILES:
            raise InputError(unknown("light profile", light_profile, LIGHT_PROFILES))
        html = Path(viser.__file__).parent / "client" / "build" / "index.html"
        self.gate = Gate(settings, client_html=html, live=live)
        try:
            with self.gate.guarding(), contextlib.redirect_stdout(io.StringIO()):
                self._server = viser.ViserServer(settings.host, self.gate.port, verbose=False)
        except BaseException:
            self.gate.close()
            raise
        self._kinds: dict[str, str] = {}
        self.refused_poses = 0
        """Poses that were not finite or not rigid, since the start."""
        self._close_tunnel()
        self._guard_writes()
        self._server.gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False)
        self._light(light_profile)

    @property
    def url(self) -> str:
        """Address to open in a browser."""
        return self.gate.url

    @property
    def clients(self) -> int:
        """Number of tabs that see the scene."""
        return len(self._server.get_clients())

    def close(self) -> None:
        """Stop serving and give the port back."""
        with contextlib.redirect_stdout(io.StringIO()):
            self._server.stop()
        self.gate.close()

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(self, *_exc: object) -> None:
        """Close."""
        self.close()

    def add_group(self, name: str) -> None:
        """Make a node that carries others."""
        self._register(name, "group")
        self._server.scene.add_frame(name, show_axes=False)

    def add_glb(self, name: str, data: bytes, *, visible: bool = True) -> None:
        """Make a mesh of binary glTF, in metres."""
        self._register(name, "mesh")
        shadow = self._shadows
        self._server.scene.add_glb(
            name, data, visible=visible, cast_shadow=shadow, receive_shadow=shadow
        )

    def add_lines(
        self, name: str, segments: Array, *, color: Color, width_px: float, visible: bool = True
    ) -> None:
        """Make lines of segments (n, 2, 3) [m]."""
        points = np.asarray(segments, dtype=np.float32)
        if points.ndim != 3 or points.shape[1:] != (2, 3) or not np.isfinite(points).all():
            raise InputError(f"lines {name} need finite segments (n, 2, 3), got {points.shape}")
        self._register(name, "lines")
        self._server.scene.add_line_segments(
            name,
            points,
            _color(color),
            thickness=float(width_px),
            thickness_units="screen",
            visible=visible,
        )

    def add_grid(self, name: str, *, size_m: float, visible: bool = True) -> None:
        """Make a ground grid in the plane z = 0 of its node."""
        self._register(name, "grid")
        self._server.scene.add_grid(
            name,
            size_m,
            size_m,
            cell_size=0.25,
            cell_color=(44, 52, 60),
            cell_thickness=0.6,
            section_size=1.0,
            section_color=(68, 80, 92),
            section_thickness=1.0,
            fade_distance=14.0,
            fade_strength=2.0,
            shadow_opacity=0.0,
            visible=visible,
        )

    def update(self, poses: Mapping[str, Pose[Any, Any]], visible: Mapping[str, bool]) -> int:
        """Move and show nodes in as few batches as fit; return how many poses were refused.

        A refused pose leaves its node where it is and what it shows.
        """
        good = [(name, pose) for name, pose in poses.items() if _is_rigid(pose.matrix)]
        refused = len(poses) - len(good)
        self.refused_poses += refused
        messages: list[tuple[Any, ...]] = [
            (viser_messages.SetSceneNodeVisibilityMessage(name, bool(shown)),)
            for name, shown in visible.items()
        ]
        messages += [_pose_messages(*item) for item in good]
        for name in (*poses, *visible):
            self._check_known(name)
        scene = self._server.scene
        for block in _blocks(messages, MAX_ATOMIC_NODES):
            with self._server.atomic():
                for message in block:
                    scene._queue_scene_message(message)  # noqa: SLF001 - contract-tested hook
        return refused

    def flush(self) -> None:
        """Send what is queued now instead of at the end of viser's window."""
        self._server.flush()

    def disconnect_all(self) -> None:
        """Drop every browser's pose connection; they come back by themselves."""
        self._server._websock_server.disconnect_all_clients()  # noqa: SLF001 - contract-tested hook

    def _register(self, name: str, kind: str) -> None:
        if not _NAME.fullmatch(name):
            raise InputError(f"scene node {name!r} needs a path of plain names, like /site/objects")
        self._kinds[name] = kind

    def _check_known(self, name: str) -> None:
        if name not in self._kinds:
            raise InputError(unknown("scene node", name, self._kinds))

    def _close_tunnel(self) -> None:
        server = self._server._websock_server  # noqa: SLF001 - contract-tested hook
        server.unregister_handler(viser_messages.ShareUrlRequest)
        server.unregister_handler(viser_messages.ShareUrlDisconnect)

    def _guard_writes(self) -> None:
        """Let this process's threads write while tabs come and go."""
        buffer = self._server._websock_server._broadcast_buffer  # noqa: SLF001 - contract-tested hook
        buffer.message_event = LoopEvent(buffer.event_loop)  # type: ignore[assignment] # same methods

    @property
    def _shadows(self) -> bool:
        return self._profile == "rich"

    def _light(self, profile: str) -> None:
        self._profile = profile
        scene = self._server.scene
        rich = profile == "rich"
        scene.configure_default_lights(enabled=rich, cast_shadow=rich)
        scene.configure_environment_map(
            "studio" if rich else None, environment_intensity=0.35 if rich else 0.0
        )
        if rich:
            return
        scene.add_light_hemisphere(
            "/lights/sky", sky_color=(206, 220, 236), ground_color=(74, 70, 66), intensity=1.6
        )
        for name, position, color, intensity in (
            ("key", (2.5, -2.0, 4.0), (255, 246, 232), 2.1),
            ("fill", (-3.0, -1.0, 1.5), (176, 204, 240), 0.7),
            ("rim", (-1.0, 3.5, 2.0), (214, 230, 255), 1.1),
        ):
            scene.add_light_directional(
                f"/lights/{name}", position=position, color=color, intensity=intensity
            )


def _is_rigid(matrix: Array) -> bool:
    rotation = matrix[:3, :3]
    if not np.isfinite(matrix).all():
        return False
    return bool(np.abs(rotation.T @ rotation - np.eye(3)).max() < ROTATION_TOLERANCE)


def _pose_messages(name: str, pose: Pose[Any, Any]) -> tuple[Any, Any]:
    x, y, z = pose.translation.tolist()
    w, i, j, k = pose.quaternion_wxyz.tolist()
    return (
        viser_messages.SetPositionMessage(name, (x, y, z)),
        viser_messages.SetOrientationMessage(name, (w, i, j, k)),
    )


def _blocks(messages: list[tuple[Any, ...]], nodes: int) -> Iterator[list[Any]]:
    for start in range(0, len(messages), nodes):
        yield [message for group in messages[start : start + nodes] for message in group]


def _color(color: Color) -> Color:
    if len(color) != 3 or any(not 0 <= int(c) <= 255 for c in color):
        raise InputError(f"a colour is three numbers from 0 to 255, got {color}")
    return int(color[0]), int(color[1]), int(color[2])
