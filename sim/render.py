"""Camera images of the plant.

Pixel u of the image plane is tied to the GL frustum by half-pixel borders (an integer is the
middle of a pixel; the image spans -0.5 to W - 0.5):

    left = -n (cx + 0.5) / fx,  right = n (W - 0.5 - cx) / fx,  top = n (cy + 0.5) / fy, ...

`live` keeps wall pace: no shadow, no anti-aliasing, painted shadow strips. `lockstep` takes its
time: shadow map, exposure by four or eight sub-frames, lens, gain and noise. Sub-frames are shifted
by parts of a pixel, a rotated grid of mean zero, so that they smooth edges as well: four samples a
pixel at a third of what multi-sampling of every sub-frame costs. Backends: EGL, OSMesa, and the
painter of `sim.painter`, which needs no GL library.
"""

from __future__ import annotations

import copy
import importlib
from itertools import cycle
from types import TracebackType
from typing import Protocol, Self

import cv2
import mujoco
import numpy as np
from numpy.typing import NDArray

from sim.gl import PACKAGES, open_context, usable_backends
from sim.lens import Lens, Sensor, expose
from sim.picture import PaintedView
from sim.plant import Plant, Snapshot
from sim.scenery import LIVE_SHADE_GROUP, TRUE_SHADE_GROUP
from sim.solids import SOLID_GROUP
from spatial.camera import PinholeCamera
from spatial.errors import InputError, MissingError, unknown

Image = NDArray[np.uint8]

QUALITIES = ("live", "lockstep")
"""How much work goes into an image."""
BACKENDS = (*PACKAGES, "painter")
"""What can draw, best first."""
NEAR_M, FAR_M = 0.03, 40.0
"""Distances between which things are drawn [m]."""
SUBFRAMES = (4, 8)
"""Images averaged for an exposure, of little and of much motion."""
MUCH_MOTION_PX = 2.5
"""From so much motion within an exposure on, the larger number is used."""
GRID_PX = ((0.125, 0.375), (-0.375, 0.125), (0.375, -0.125), (-0.125, -0.375))
"""Shifts of sub-frames, in turn: their mean is zero, so nothing is moved."""
SHADOW_PX = 1024
"""Size of the shadow map [px]."""
LIVE_QUADS, LIVE_STACKS = 1, 4
"""Pieces of a side of a box, and of the length of a cylinder, when live."""

_SCENE_GEOMS = 2000
_TYPICAL_DISTANCE_M = 0.6


class View(Protocol):
    """Something that draws a configuration as a pinhole camera without distortion sees it."""

    def draw(self, snapshot: Snapshot, *, shift_px: tuple[float, float] = (0.0, 0.0)) -> Image:
        """Return the image (H, W, 3) RGB, moved by parts of a pixel where it helps edges."""

    def close(self) -> None:
        """Give everything back."""


class Renderer:
    """A camera of the plant; every call comes from the thread that made it."""

    def __init__(
        self,
        plant: Plant,
        camera: str,
        *,
        quality: str = "live",
        backend: str | None = None,
        sensor: Sensor | None = None,
        seed: int = 0,
    ) -> None:
        """Set up a camera, with its true intrinsics and mount as the plant has them.

        Args:
            plant: what to draw.
            camera: `hc`, `mako`, ...
            quality: one of `QUALITIES`.
            backend: one of `BACKENDS`; the best that works here when left out.
            sensor: exposure and noise, in lock-step only.
            seed: of the noise.

        Raises:
            InputError: an unknown camera, quality or backend.
            MissingError: the backend asked for does not work here; the packages it needs.
        """
        for what, name, known in (
            ("camera", camera, plant.cameras),
            ("quality", quality, QUALITIES),
            ("renderer", backend or BACKENDS[0], BACKENDS),
        ):
            if name not in known:
                raise InputError(unknown(what, name, known))
        self.backend = backend or (*usable_backends(), "painter")[0]
        self.time_s = 0.0
        self._plant = plant
        self._camera = camera
        self._careful = quality == "lockstep"
        self._sensor = sensor or Sensor()
        self._rng = np.random.default_rng((seed, len(camera), camera.encode()[0]))
        self._lens = Lens(plant.cameras[camera].intrinsics)
        self._view = self._open_view()

    def render(self) -> Image:
        """Return the image (H, W, 3) uint8 RGB of now; `time_s` is then its mid-exposure time."""
        if not self._careful:
            snapshot = self._plant.snapshot()
            self.time_s = snapshot.time_s
            return self._lens.bend(self._view.draw(snapshot))
        snapshots = self._exposed()
        self.time_s = (snapshots[0].time_s + snapshots[-1].time_s) / 2.0
        light = np.zeros((self._lens.canvas.height, self._lens.canvas.width, 3), np.float32)
        for snapshot, shift_px in zip(snapshots, cycle(GRID_PX), strict=False):
            cv2.accumulate(self._view.draw(snapshot, shift_px=shift_px), light)
        light /= np.float32(len(snapshots))
        return expose(self._lens.bend(light), self._sensor, time_s=self.time_s, rng=self._rng)

    def close(self) -> None:
        """Give the context back."""
        self._view.close()

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close."""
        self.close()

    def _open_view(self) -> View:
        if self.backend == "painter":
            return PaintedView(self._plant, self._camera, canvas=self._lens.canvas)
        return ClassicView(
            self._plant,
            self._camera,
            canvas=self._lens.canvas,
            backend=self.backend,
            careful=self._careful,
        )

    def _exposed(self) -> list[Snapshot]:
        """Return the configurations an exposure that ends now averages, evenly spread."""
        history = self._plant.history()
        start_s = history[-1].time_s - self._sensor.exposure_s - 1e-9
        during = [snapshot for snapshot in history if snapshot.time_s >= start_s]
        velocity, _ = self._plant.camera_twist(self._camera)
        focal = self._lens.canvas.fx
        speed_px = focal * float(
            np.linalg.norm(velocity[:3]) / _TYPICAL_DISTANCE_M + np.linalg.norm(velocity[3:])
        )
        count = SUBFRAMES[speed_px * self._sensor.exposure_s > MUCH_MOTION_PX]
        return [during[i] for i in np.linspace(0, len(during) - 1, count).round().astype(int)]


class ClassicView:
    """MuJoCo's OpenGL renderer in a context of its own."""

    def __init__(
        self, plant: Plant, camera: str, *, canvas: PinholeCamera, backend: str, careful: bool
    ) -> None:
        """Open a context in this thread and load the model into it.

        Raises:
            MissingError: the backend does not work here.
        """
        site = plant.site_model
        self._model = copy.copy(site.model)  # its size and quality are this view's own
        self._data = mujoco.MjData(self._model)
        self._site = site.camera_sites[camera]
        self._canvas = canvas
        quality = self._model.vis.quality
        quality.offsamples = 0
        quality.shadowsize = SHADOW_PX if careful else 0
        if not careful:  # what is lit by a far sun needs no grid to be lit on
            quality.numquads, quality.numstacks = LIVE_QUADS, LIVE_STACKS
        offscreen = self._model.vis.global_
        offscreen.offwidth, offscreen.offheight = canvas.width, canvas.height
        self._context = open_context(
            backend, width=canvas.width, height=canvas.height, threads=None if careful else 0
        )
        self._context.make_current()
        try:
            self._gl = mujoco.MjrContext(self._model, mujoco.mjtFontScale.mjFONTSCALE_100)
        except mujoco.FatalError as error:
            self._context.free()
            raise MissingError(f"{backend} cannot draw here: {error}") from error
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._gl)
        self._opengl = importlib.import_module("OpenGL.GL")  # bound to the context's backend
        self._shrink_depth()
        self._scene = mujoco.MjvScene(self._model, maxgeom=_SCENE_GEOMS)
        self._scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = careful
        self._scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False
        self._option = mujoco.MjvOption()
        self._option.geomgroup[TRUE_SHADE_GROUP if careful else LIVE_SHADE_GROUP] = 1
        self._free_camera = mujoco.MjvCamera()
        self._rect = mujoco.MjrRect(0, 0, canvas.width, canvas.height)
        self._rows = np.zeros((canvas.height, canvas.width, 4), np.uint8)
        self._careful = careful
        self._sides = _sides_of(canvas)
        self._groups = self._model.geom_group.copy()
        self._reach = np.where(self._model.geom_rbound > 0.0, self._model.geom_rbound, np.inf)

    def draw(self, snapshot: Snapshot, *, shift_px: tuple[float, float] = (0.0, 0.0)) -> Image:
        """Return the image (H, W, 3) RGB, moved by a shift [px]."""
        data = self._data
        data.qpos[:] = snapshot.qpos
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_camlight(self._model, data)
        if not self._careful:  # a true shadow may come from outside the picture
            self._hide_unseen()
        mujoco.mjv_updateScene(
            self._model,
            data,
            self._option,
            None,
            self._free_camera,
            mujoco.mjtCatBit.mjCAT_ALL,
            self._scene,
        )
        self._aim(shift_px)
        self._context.make_current()
        mujoco.mjr_render(self._rect, self._scene, self._gl)
        return self._read()

    def close(self) -> None:
        """Free the context; a second call does nothing."""
        if self._gl is not None:
            self._context.make_current()
            self._gl.free()
            self._gl = None
            self._context.free()

    def _hide_unseen(self) -> None:
        """Spare OpenGL what lies beyond a side of the picture: most of the robot, for its hand."""
        data = self._data
        R_w_cam = data.site_xmat[self._site].reshape(3, 3)
        p_cam = (data.geom_xpos - data.site_xpos[self._site]) @ R_w_cam
        unseen = (p_cam @ self._sides.T < -self._reach[:, None]).any(axis=1)
        self._model.geom_group[:] = np.where(unseen, SOLID_GROUP, self._groups)

    def _read(self) -> Image:
        """Return the picture; read as it is stored, which takes a third of reading RGB."""
        gl, rect = self._opengl, self._rect
        gl.glBindFramebuffer(gl.GL_READ_FRAMEBUFFER, self._gl.offFBO)
        gl.glReadPixels(
            0, 0, rect.width, rect.height, gl.GL_RGBA, gl.GL_UNSIGNED_BYTE, array=self._rows
        )
        return np.asarray(cv2.flip(cv2.cvtColor(self._rows, cv2.COLOR_RGBA2RGB), 0), dtype=np.uint8)

    def _shrink_depth(self) -> None:
        """Make depth four bytes a pixel instead of eight: an eighth of the time of an image."""
        gl = self._opengl
        gl.glBindRenderbuffer(gl.GL_RENDERBUFFER, self._gl.offDepthStencil)
        gl.glRenderbufferStorage(
            gl.GL_RENDERBUFFER, gl.GL_DEPTH24_STENCIL8, self._canvas.width, self._canvas.height
        )

    def _aim(self, shift_px: tuple[float, float]) -> None:
        """Put the frustum of both GL cameras (mono averages them) where the canvas is."""
        c = self._canvas
        cx, cy = c.cx + shift_px[0], c.cy + shift_px[1]
        R_w_cam = self._data.site_xmat[self._site].reshape(3, 3)
        for camera in self._scene.camera:
            camera.pos = self._data.site_xpos[self._site]
            camera.forward = R_w_cam[:, 2]
            camera.up = -R_w_cam[:, 1]
            camera.frustum_near, camera.frustum_far = NEAR_M, FAR_M
            camera.frustum_width = NEAR_M * c.width / 2.0 / c.fx
            camera.frustum_center = NEAR_M * ((c.width - 1.0) / 2.0 - cx) / c.fx
            camera.frustum_top = NEAR_M * (cy + 0.5) / c.fy
            camera.frustum_bottom = -NEAR_M * (c.height - 0.5 - cy) / c.fy


def _sides_of(c: PinholeCamera) -> np.ndarray:
    """Return the inward normals (4, 3) of left, right, top and bottom of what a camera sees."""
    normals = np.array(
        [
            (c.fx, 0.0, c.cx + 1.0),
            (-c.fx, 0.0, c.width - c.cx),
            (0.0, c.fy, c.cy + 1.0),
            (0.0, -c.fy, c.height - c.cy),
        ]
    )
    return np.asarray(normals / np.linalg.norm(normals, axis=1, keepdims=True), dtype=np.float64)
