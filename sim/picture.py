"""The plant as the painter of `sim.painter` sees it: images where no GL library exists."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from scene.mesh import MeshData, MeshPart
from scene.robot import Robot
from sim.paint import unprinted
from sim.painter import Image, Painted, Painter, Shade
from sim.plant import Plant, Snapshot
from sim.scenery import SHADE_LIFT_M
from spatial.camera import PinholeCamera
from spatial.frames import Cam, Object, W
from spatial.marker import Marker
from spatial.pose import Pose
from spatial.rotation import Array


class PaintedView:
    """A camera of the plant, painted with OpenCV alone."""

    def __init__(self, plant: Plant, camera: str, *, canvas: PinholeCamera) -> None:
        """Prepare objects, robot and shades."""
        site = plant.site_model
        self._model = site.model
        self._data = mujoco.MjData(site.model)
        self._site = site.camera_sites[camera]
        things: dict[str, Painted] = {}
        for slug, entry in plant.entries.items():
            markers = tuple(
                replace(m, T_object_marker=site.Ts_object_marker[m.key]) for m in entry.markers
            )
            things[f"object/{slug}"] = _painted(unprinted(entry.mesh), markers=markers)
        for link, mesh in _links(plant.robot).items():
            things[f"robot/{link}"] = _painted(mesh)
        self._bodies = {name: int(site.model.body(name).id) for name in things}
        shades = [
            Shade(f"object/{shade.slug}", shade.T_object_shade.apply(_corners(shade.size_m)))
            for shade in plant.world.shades
        ]
        self._painter = Painter(canvas, things=things, shades=shades)

    def draw(self, snapshot: Snapshot, *, shift_px: tuple[float, float] = (0.0, 0.0)) -> Image:
        """Return the image (H, W, 3) RGB; its edges are smooth already, `shift_px` is idle."""
        del shift_px
        data = self._data
        data.qpos[:] = snapshot.qpos
        mujoco.mj_kinematics(self._model, data)
        T_w_cam: Pose[W, Cam] = Pose.of(
            data.site_xmat[self._site].reshape(3, 3), data.site_xpos[self._site]
        )
        T_cam_w = T_w_cam.inverse()
        poses: dict[str, Pose[Cam, Object]] = {}
        for name, body in self._bodies.items():
            T_w_thing: Pose[W, Object] = Pose.of(data.xmat[body].reshape(3, 3), data.xpos[body])
            poses[name] = T_cam_w @ T_w_thing
        return self._painter.render(poses)

    def close(self) -> None:
        """Do nothing: there is nothing to give back."""


def _painted(mesh: MeshData, *, markers: tuple[Marker, ...] = ()) -> Painted:
    return Painted(markers, mesh.vertices, mesh.faces, mesh.face_colors[:, :3])


def _links(robot: Robot) -> dict[str, MeshData]:
    """Return the looks of each link, joined and in the link's frame."""
    parts: dict[str, list[MeshPart]] = {}
    for visual in robot.visuals:
        T_link_visual = visual.T_link_visual
        parts.setdefault(visual.link, []).extend(
            replace(part, vertices=T_link_visual.apply(part.vertices), normals=None)
            for part in visual.mesh.parts
        )
    return {link: MeshData.of(tuple(found)) for link, found in parts.items()}


def _corners(size_m: tuple[float, float]) -> Array:
    x, y = size_m[0] / 2.0, size_m[1] / 2.0
    return np.array(
        [[-x, -y, SHADE_LIFT_M], [x, -y, SHADE_LIFT_M], [x, y, SHADE_LIFT_M], [-x, y, SHADE_LIFT_M]]
    )
