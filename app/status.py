"""What the page is told thirty times a second beside the poses: ages, states, reasons."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from scene.graph import ObjectNode, SceneState
from spatial.rotation import Array

COVERAGE = 3.0
"""Standard deviations of the stated bound."""


def status_of(
    state: SceneState,
    *,
    site: str,
    target: str = "",
    names: Mapping[str, str] | None = None,
    replay: bool = False,
    rate: float = 1.0,
    clock_bound_ms: float | None = None,
    link: str = "ok",
    note: str = "",
) -> dict[str, Any]:
    """Return the status of one scene state, ready for JSON.

    Args:
        state: the scene.
        site: name of the site.
        target: slug the page's close-up looks at.
        names: names of objects for people, by slug.
        replay: whether this is a recording.
        rate: how fast T* runs against the wall clock; 0 when paused.
        clock_bound_ms: by how much the site's clock may be off [ms], `None` when it is shared.
        link: `ok`, or `lost` while nothing comes from the site.
        note: one sentence for the operator.
    """
    known = names or {}
    return {
        "tick": state.tick,
        "instant_ms": state.instant_ns / 1e6,
        "site": site,
        "target": target,
        "session": "replay" if replay else "live",
        "rate": rate,
        "link": link,
        "note": note,
        "clock_bound_ms": _number(clock_bound_ms),
        "robot_ms": _number(state.robot_ms),
        "objects": [_object(node, known.get(node.slug, node.slug)) for node in state.objects],
    }


def _object(node: ObjectNode, name: str) -> dict[str, Any]:
    return {
        "slug": node.slug,
        "name": name,
        "state": node.state.value,
        "hierarchy": node.hierarchy,
        "camera": node.camera,
        "seen_ms": _number(node.seen_ms),
        "predicted_ms": _number(node.predicted_ms),
        "bound_mm": _bound_mm(node.covariance_base) if node.T_base_object is not None else None,
        "reason": node.reason,
    }


def _bound_mm(covariance: Array) -> float | None:
    """Largest positional 3 sigma [mm]."""
    if covariance.shape != (3, 3) or not np.isfinite(covariance).all():
        return None
    largest = float(np.linalg.eigvalsh(covariance)[-1])
    return _number(1000.0 * COVERAGE * np.sqrt(max(largest, 0.0)))


def _number(value: float | None) -> float | None:
    return round(float(value), 2) if value is not None and np.isfinite(value) else None
