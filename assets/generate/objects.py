"""Writes `assets/objects`: one folder per object with its description and mesh."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from assets.generate import carried, standing
from assets.generate.shapes import Array
from assets.generate.tags import FAMILY, Tag, add_tags
from assets.generate.things import Fixture, Place, Thing
from scene.glb import to_glb
from scene.mesh import MeshData
from spatial.rotation import quaternion_wxyz_of

IDENTITY = (1.0, 0.0, 0.0, 0.0)


def make(folder: Path) -> None:
    """Write every object into its folder below `folder`."""
    for thing in things():
        place = folder / thing.slug
        place.mkdir(parents=True, exist_ok=True)
        glb = to_glb(mesh_of(thing), extras={"frame": thing.slug})
        (place / "mesh.glb").write_bytes(glb)
        (place / "object.toml").write_text(describe(thing), encoding="utf-8")
        (place / "README.md").write_text(readme(thing), encoding="utf-8")


def things() -> tuple[Thing, ...]:
    """Return all objects."""
    return tuple(make_thing() for make_thing in (*carried.THINGS, *standing.THINGS))


def mesh_of(thing: Thing) -> MeshData:
    """Return the mesh of an object with its markers."""
    add_tags(thing.body, thing.tags)
    return thing.body.mesh()


def describe(thing: Thing) -> str:
    """Return the text of `object.toml`."""
    lines = [
        f"# {thing.about}",
        "# Made by `python -m assets.generate`. Metres, kilograms, wxyz; poses are T_object_*.",
        "schema = 1",
        *_entries(slug=thing.slug, name=thing.name, revision=1),
        *_entries(mass_kg=thing.mass_kg, motion=thing.motion, units_of_source="m"),
        "",
        "[mesh]",
        'file = "mesh.glb"  # object frame, metres, Z up',
        "",
        "[appearance]",
        *_entries(color=list(thing.color), opacity=1.0),
        "",
        "[symmetry]  # of the shape without its markers",
        *_entries(diameter_m=thing.diameter_m),
    ]
    if thing.continuous_axis is not None:
        lines += _entries(continuous_axis=list(thing.continuous_axis))
    for blocks in (
        map(_marker, thing.tags),
        map(_place, thing.places),
        map(_fixture, thing.fixtures),
    ):
        lines += [line for block in blocks for line in ("", *block)]
    return "\n".join([*lines, ""])


def readme(thing: Thing) -> str:
    """Return the text of the object's README."""
    ids = sorted(tag.id for tag in thing.tags)
    frames = ", ".join(f"`{place.name}`" for place in thing.places)
    fixtures = ", ".join(f"`{fixture.name}`" for fixture in thing.fixtures) or "none"
    return (
        f"# {thing.name}\n\n{thing.about}\n\n"
        f"- markers: {FAMILY} {ids[0]} to {ids[-1]}\n- frames: {frames}\n- fixtures: {fixtures}\n\n"
        "Own work, made by `python -m assets.generate`; licence: MIT, as the project.\n"
    )


def _marker(tag: Tag) -> list[str]:
    return [
        "[[marker]]",
        *_entries(
            family=FAMILY,
            id=tag.id,
            size_m=tag.size_m,
            translation_m=_rounded(tag.centre),
            quaternion_wxyz=_rounded(quaternion_wxyz_of(tag.rotation), digits=9),
        ),
        *(_entries(target=True) if tag.target else []),
    ]


def _place(place: Place) -> list[str]:
    return [
        "[[frame]]",
        *_entries(name=place.name, kind=place.kind),
        *_pose(place.translation_m, place.quaternion_wxyz),
    ]


def _fixture(fixture: Fixture) -> list[str]:
    return [
        "[[fixture]]",
        *_entries(name=fixture.name, kind=fixture.kind, role=fixture.role, frame=fixture.frame),
        *_pose(fixture.translation_m, fixture.quaternion_wxyz),
        *_entries(**fixture.sizes),
        *([] if fixture.enabled else _entries(enabled=False)),
    ]


def _pose(translation: Iterable[float], quaternion: tuple[float, ...]) -> list[str]:
    lines = _entries(translation_m=_rounded(translation))
    turned = quaternion != IDENTITY
    return lines + (_entries(quaternion_wxyz=_rounded(quaternion, digits=9)) if turned else [])


def _rounded(values: Iterable[float] | Array, *, digits: int = 6) -> list[float]:
    return [round(float(value), digits) + 0.0 for value in np.asarray(list(values))]


def _entries(**values: object) -> list[str]:
    """Return TOML lines; JSON writes numbers, texts, flags and flat lists the same way."""
    return [f"{key} = {json.dumps(value)}" for key, value in values.items()]
