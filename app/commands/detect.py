"""`telepresence detect`: markers in images, with sub-pixel corners and both planar poses."""

from __future__ import annotations

import time
import tomllib
from pathlib import Path
from typing import Any

import click
import cv2
import numpy as np

from app.report import pose_json, print_json, say
from spatial.camera import PinholeCamera
from spatial.errors import FileInputError, InputError
from spatial.marker import FAMILIES
from tracking.detector import REFINEMENTS, Detection, Refinement, detect
from tracking.marker_pose import planar_poses

EXAMPLE = """Find markers in images.

Corners are in pixels, pixel centres at integers, in the order TL TR BR BL. A camera file is TOML
with width, height, fx, fy, cx, cy and optionally distortion = [k1, k2, p1, p2, k3].

Example: telepresence detect photo.jpg --family tag36h11 --json
"""


@click.command(help=EXAMPLE)
@click.argument("images", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--family", type=click.Choice(FAMILIES), default="tag36h11", show_default=True)
@click.option(
    "--refine",
    type=click.Choice(REFINEMENTS),
    default="edges",
    show_default=True,
    help="How corners are made sub-pixel.",
)
@click.option("--camera", type=click.Path(path_type=Path), help="Intrinsics, for poses.")
@click.option("--size-m", type=click.FloatRange(min=0, min_open=True), help="Edge of the markers.")
@click.option("--json", "as_json", is_flag=True, help="One line of JSON.")
def command(
    *,
    images: tuple[Path, ...],
    family: str,
    refine: Refinement,
    camera: Path | None,
    size_m: float | None,
    as_json: bool,
) -> None:
    """Run the command."""
    if (camera is None) != (size_m is None):
        raise InputError("--camera and --size-m go together: poses need both")
    intrinsics = load_camera(camera) if camera is not None else None
    reports = [
        detect_file(path, family=family, refine=refine, camera=intrinsics, size_m=size_m)
        for path in images
    ]
    if as_json:
        print_json({"images": reports})
        return
    for report in reports:
        ids = ", ".join(str(marker["id"]) for marker in report["markers"]) or "none"
        say(f"{report['file']}: {ids} ({report['detect_ms']:.1f} ms)")


def detect_file(
    path: Path,
    *,
    family: str,
    refine: Refinement,
    camera: PinholeCamera | None = None,
    size_m: float | None = None,
) -> dict[str, Any]:
    """Return the report of one image file.

    Raises:
        FileInputError: it does not exist, is no image, or has another size than the camera.
    """
    if not path.is_file():
        raise FileInputError("no such image", path=path)
    gray = cv2.imdecode(np.fromfile(path, dtype=np.uint8), cv2.IMREAD_GRAYSCALE)
    if gray is None:
        raise FileInputError("not an image, expected JPEG, PNG or another common format", path=path)
    height, width = gray.shape
    if camera is not None and (camera.width, camera.height) != (width, height):
        raise FileInputError(
            f"the image is {width}x{height}, the camera file says {camera.width}x{camera.height}",
            path=path,
        )
    start = time.perf_counter()
    found = detect(np.asarray(gray, dtype=np.uint8), family=family, refine=refine)
    elapsed_ms = 1e3 * (time.perf_counter() - start)
    return {
        "file": str(path),
        "width": width,
        "height": height,
        "detect_ms": elapsed_ms,
        "markers": [_marker(item, camera=camera, size_m=size_m) for item in found],
    }


def load_camera(path: Path) -> PinholeCamera:
    """Read intrinsics from a TOML file.

    Raises:
        FileInputError: the file is missing or broken, or a key is missing or wrong.
    """
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise FileInputError(f"cannot read the camera file: {error.strerror}", path=path) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise FileInputError(f"not TOML: {error}", path=path) from error
    for key in ("width", "height", "fx", "fy", "cx", "cy"):
        if not isinstance(table.get(key), int | float):
            raise FileInputError("expected a number", path=path, key=key)
    distortion = table.get("distortion", [0.0] * 5)
    if not isinstance(distortion, list) or len(distortion) != 5:
        raise FileInputError("expected k1, k2, p1, p2, k3", path=path, key="distortion")
    k1, k2, p1, p2, k3 = (float(value) for value in distortion)
    return PinholeCamera(
        width=int(table["width"]),
        height=int(table["height"]),
        fx=float(table["fx"]),
        fy=float(table["fy"]),
        cx=float(table["cx"]),
        cy=float(table["cy"]),
        distortion=(k1, k2, p1, p2, k3),
    )


def _marker(
    found: Detection, *, camera: PinholeCamera | None, size_m: float | None
) -> dict[str, Any]:
    report: dict[str, Any] = {
        "id": found.id,
        "family": found.family,
        "corners_px": found.corners_px.tolist(),
    }
    if camera is not None and size_m is not None:
        report["poses"] = [
            {**pose_json(item.T_cam_tag), "reprojection_px": item.reprojection_px}
            for item in planar_poses(found.corners_px, size_m=size_m, camera=camera)
        ]
    return report
