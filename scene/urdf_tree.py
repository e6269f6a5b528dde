"""The XML of a robot description, checked before a parser believes it.

Refuses a document type definition, duplicate names, loops, second roots, numbers that are none,
axes without direction and inverted limits; each fault with its line. What passes is written out
again without anything that was not looked at.
"""

from __future__ import annotations

import html
import math
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from spatial.errors import FileInputError, unknown

MAX_BYTES = 8_000_000
MAX_ELEMENTS = 50_000
MAX_DEPTH = 32
JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
MOVING = ("revolute", "continuous", "prismatic")
SHAPES = ("box", "cylinder", "sphere", "mesh")
_KEPT = {
    "robot": ("material", "link", "joint"),
    "material": ("color",),
    "link": ("inertial", "visual", "collision"),
    "inertial": ("origin", "mass", "inertia"),
    "visual": ("origin", "geometry", "material"),
    "collision": ("origin", "geometry"),
    "geometry": SHAPES,
    "joint": ("origin", "parent", "child", "axis", "limit", "dynamics", "mimic"),
}
_NUMBERS = {
    ("origin", "xyz"): 3,
    ("origin", "rpy"): 3,
    ("axis", "xyz"): 3,
    ("color", "rgba"): 4,
    ("box", "size"): 3,
    ("mesh", "scale"): 3,
    ("cylinder", "radius"): 1,
    ("cylinder", "length"): 1,
    ("sphere", "radius"): 1,
    ("mass", "value"): 1,
    **{("inertia", name): 1 for name in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")},
    **{("limit", name): 1 for name in ("lower", "upper", "velocity", "effort")},
    **{("dynamics", name): 1 for name in ("damping", "friction")},
    **{("mimic", name): 1 for name in ("multiplier", "offset")},
}
_REQUIRED = {
    "link": ("name",),
    "joint": ("name", "type"),
    "parent": ("link",),
    "child": ("link",),
    "mimic": ("joint",),
    "mass": ("value",),
    "box": ("size",),
    "cylinder": ("radius", "length"),
    "sphere": ("radius",),
    "mesh": ("filename",),
}


@dataclass(slots=True)
class Element:
    """One element of the description."""

    tag: str
    """Its name."""
    attributes: dict[str, str]
    """Its attributes."""
    line: int
    """One-based line it starts in."""
    children: list[Element] = field(default_factory=list)
    """Elements in it."""

    def all(self, tag: str) -> list[Element]:
        """Return the children of a name."""
        return [child for child in self.children if child.tag == tag]

    def first(self, tag: str) -> Element | None:
        """Return the first child of a name."""
        return next((child for child in self.children if child.tag == tag), None)

    def number(self, name: str) -> float | None:
        """Return a checked number, `None` where it is left out."""
        return float(self.attributes[name]) if name in self.attributes else None

    def xml(self) -> str:
        """Return the element as XML text."""
        attributes = "".join(f' {k}="{html.escape(v)}"' for k, v in self.attributes.items())
        inside = "".join(child.xml() for child in self.children)
        return f"<{self.tag}{attributes}>{inside}</{self.tag}>"


def read_tree(data: bytes, *, path: Path) -> Element:
    """Return the checked tree of a robot description.

    Raises:
        FileInputError: with the line, what was found and what was expected.
    """
    root = _parse(data, path=path)
    if root.tag != "robot":
        raise FileInputError(
            f"the root element is <{root.tag}>; expected <robot>", path=path, line=root.line
        )
    _keep(root)
    _check_values(root, path=path)
    _check_joints(root, path=path)
    _check_names(root, path=path)
    return root


def root_link(tree: Element) -> str:
    """Return the one link that no joint moves."""
    children = {_end(joint, "child") for joint in tree.all("joint")}
    return next(n for link in tree.all("link") if (n := link.attributes["name"]) not in children)


def _parse(data: bytes, *, path: Path) -> Element:
    if len(data) > MAX_BYTES:
        raise FileInputError(f"{len(data)} bytes; at most {MAX_BYTES}", path=path)
    parser = expat.ParserCreate()
    top = Element("", {}, 0)
    stack = [top]
    count = 0

    def refuse(*_: object) -> None:
        line = parser.CurrentLineNumber
        message = "a document type definition is not accepted in a robot description"
        raise FileInputError(message, path=path, line=line)

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal count
        count += 1
        line = parser.CurrentLineNumber
        if count > MAX_ELEMENTS or len(stack) > MAX_DEPTH:
            message = f"over {MAX_ELEMENTS} elements or nested deeper than {MAX_DEPTH}"
            raise FileInputError(message, path=path, line=line)
        element = Element(tag, attributes, line)
        stack[-1].children.append(element)
        stack.append(element)

    def end(_: str) -> None:
        stack.pop()

    parser.StartDoctypeDeclHandler = refuse
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    try:
        parser.Parse(data, True)
    except (expat.ExpatError, ValueError, LookupError) as error:
        raise FileInputError(
            f"is not XML: {error}", path=path, line=parser.CurrentLineNumber
        ) from error
    return top.children[0]


def _keep(element: Element) -> None:
    """Drop what the program does not read: plugins, transmissions, textures."""
    kept = _KEPT.get(element.tag, ())
    element.children = [child for child in element.children if child.tag in kept]
    for child in element.children:
        _keep(child)


def _check_values(element: Element, *, path: Path) -> None:
    for name in _REQUIRED.get(element.tag, ()):
        if not element.attributes.get(name, "").strip():
            message = f"<{element.tag}> has no {name!r}"
            raise FileInputError(message, path=path, line=element.line)
    for name, text in element.attributes.items():
        count = _NUMBERS.get((element.tag, name))
        if count is not None:
            element.attributes[name] = _numbers(element, name, text, count, path=path)
    if element.tag == "geometry" and len(element.children) != 1:
        message = f"<geometry> holds {len(element.children)} of {', '.join(SHAPES)}; expected one"
        raise FileInputError(message, path=path, line=element.line)
    for child in element.children:
        _check_values(child, path=path)
    if element.tag in {"visual", "collision"} and element.first("geometry") is None:
        message = f"<{element.tag}> has no <geometry>"
        raise FileInputError(message, path=path, line=element.line)


def _numbers(element: Element, name: str, text: str, count: int, *, path: Path) -> str:
    """Return `count` finite numbers as text, separated by blanks."""
    words = text.replace(",", " ").split()
    if (element.tag, name, len(words)) == ("mesh", "scale", 1):
        words = words * 3
    try:
        good = len(words) == count and all(math.isfinite(float(word)) for word in words)
    except ValueError:
        good = False
    if not good:
        expected = "a finite number" if count == 1 else f"{count} finite numbers"
        message = f"<{element.tag}> {name}={text[:60]!r} is not {expected}"
        raise FileInputError(message, path=path, line=element.line)
    return " ".join(words)


def _check_joints(tree: Element, *, path: Path) -> None:
    for joint in tree.all("joint"):
        name, kind = joint.attributes["name"], joint.attributes["type"]
        if kind not in JOINT_TYPES:
            message = f"joint {name!r}: {unknown('type', kind, JOINT_TYPES)}"
            raise FileInputError(message, path=path, line=joint.line)
        for end in ("parent", "child"):
            if joint.first(end) is None:
                message = f"joint {name!r} has no <{end}>"
                raise FileInputError(message, path=path, line=joint.line)
        axis = joint.first("axis")
        if axis is not None and kind in MOVING:
            norm = math.hypot(*map(float, axis.attributes.get("xyz", "1 0 0").split()))
            if norm < 1e-6:
                message = f"joint {name!r} has an axis of length {norm:g}; expected 1"
                raise FileInputError(message, path=path, line=axis.line)
        limit = joint.first("limit")
        if limit is not None and kind in {"revolute", "prismatic"}:
            lower, upper = limit.number("lower") or 0.0, limit.number("upper") or 0.0
            if lower > upper:
                message = f"joint {name!r} has lower limit {lower:g} above upper limit {upper:g}"
                raise FileInputError(message, path=path, line=limit.line)


def _check_names(tree: Element, *, path: Path) -> None:
    links = _unique(tree, "link", path=path)
    joints = _unique(tree, "joint", path=path)
    if not links:
        raise FileInputError("has no <link>; expected at least 1", path=path, line=tree.line)
    parent_of: dict[str, str] = {}
    for joint in tree.all("joint"):
        name = joint.attributes["name"]
        parent, child = _end(joint, "parent"), _end(joint, "child")
        for link in (parent, child):
            if link not in links:
                message = f"joint {name!r}: {unknown('link', link, links)}"
                raise FileInputError(message, path=path, line=joint.line)
        if child in parent_of:
            message = f"link {child!r} is the child of joint {name!r} and of another one"
            raise FileInputError(message, path=path, line=joint.line)
        parent_of[child] = parent
        mimic = joint.first("mimic")
        if mimic is not None and mimic.attributes["joint"] not in joints:
            message = (
                f"joint {name!r} mimics: {unknown('joint', mimic.attributes['joint'], joints)}"
            )
            raise FileInputError(message, path=path, line=mimic.line)
    roots = [name for name in links if name not in parent_of]
    if len(roots) != 1:
        held = ", ".join(roots) or "none, the joints form a loop"
        raise FileInputError(f"expected one root link; found {held}", path=path, line=tree.line)
    _check_loops(links, parent_of, "links", path=path)
    masters = {
        joint.attributes["name"]: mimic.attributes["joint"]
        for joint in tree.all("joint")
        if (mimic := joint.first("mimic")) is not None
    }
    _check_loops(joints, masters, "mimicking joints", path=path)


def _check_loops(names: dict[str, int], above: dict[str, str], what: str, *, path: Path) -> None:
    good: set[str] = set()
    for name, line in names.items():
        way = [name]
        while way[-1] in above and way[-1] not in good:
            way.append(above[way[-1]])
            if way[-1] in way[:-1]:
                message = f"{what} form a loop: {' - '.join(way[:10])}"
                raise FileInputError(message, path=path, line=line)
        good.update(way)


def _unique(tree: Element, tag: str, *, path: Path) -> dict[str, int]:
    """Return the names of all elements of a tag with their lines."""
    elements = tree.all(tag)
    counts = Counter(element.attributes["name"] for element in elements)
    for element in elements:
        name = element.attributes["name"]
        if counts[name] > 1:
            message = f"{counts[name]} {tag}s are named {name!r}; names are unique"
            raise FileInputError(message, path=path, line=element.line)
    return {element.attributes["name"]: element.line for element in elements}


def _end(joint: Element, end: str) -> str:
    element = joint.first(end)
    assert element is not None, "checked by _check_joints"
    return element.attributes["link"]
