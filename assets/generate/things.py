"""An object of the database before it is written."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from assets.generate.shapes import Body
from assets.generate.tags import Tag

Triple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Place:
    """A named frame."""

    name: str
    """Its name."""
    kind: str
    """One of `scene.entry.FRAME_KINDS`."""
    translation_m: Triple = (0.0, 0.0, 0.0)
    """Its origin in the object [m]."""
    quaternion_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    """Its orientation in the object."""


@dataclass(frozen=True, slots=True)
class Fixture:
    """A guiding shape."""

    name: str
    """Its name."""
    kind: str
    """Kind of solid."""
    role: str
    """`inside` or `forbidden`."""
    frame: str
    """Frame it hangs on."""
    translation_m: Triple
    """Origin of the solid in that frame [m]."""
    sizes: Mapping[str, object]
    """Sizes, as `scene.fixture` names them."""
    quaternion_wxyz: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)
    """Orientation of the solid in that frame."""
    enabled: bool = True
    """Whether it starts shown and felt."""


@dataclass(frozen=True, slots=True)
class Thing:
    """An object to write."""

    slug: str
    """Name of its folder."""
    name: str
    """Name for people."""
    mass_kg: float
    """Mass [kg]."""
    color: tuple[int, int, int]
    """One colour that stands for it."""
    motion: str
    """`static`, `held` or `mobile`."""
    body: Body
    """Its shape without markers."""
    tags: tuple[Tag, ...]
    """Its markers."""
    diameter_m: float
    """Largest distance of two of its points, about [m]."""
    about: str
    """What it is, in a sentence or two."""
    places: tuple[Place, ...] = ()
    """Named frames."""
    fixtures: tuple[Fixture, ...] = ()
    """Guiding shapes."""
    continuous_axis: Triple | None = None
    """Axis of rotational symmetry of the shape without its markers."""
