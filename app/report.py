"""What commands print: JSON alone on standard output, everything else on standard error."""

from __future__ import annotations

import json
import math
from typing import Any

import click
import numpy as np

from spatial.pose import Pose

MAX_JSON_BYTES = 64 * 1024


def say(text: str) -> None:
    """Tell the user something, on standard error."""
    click.echo(text, err=True)


def print_json(report: dict[str, Any]) -> None:
    """Write one object on one line of standard output.

    Arrays become nested lists, NaN and infinity become null.
    """
    text = json.dumps(_plain(report), allow_nan=False, separators=(", ", ": "))
    assert len(text) < MAX_JSON_BYTES, "long lists belong into --out"
    click.echo(text)


def pose_json(pose: Pose[Any, Any]) -> dict[str, list[float]]:
    """Return a pose as the commands' JSON writes it."""
    return {
        "translation_m": pose.translation.tolist(),
        "quaternion_wxyz": pose.quaternion_wxyz.tolist(),
    }


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value
