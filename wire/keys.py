"""Names of everything on the bus (contract.md): `<session>/<site>/...`, in no file the session.

A key is chunks joined by slashes. In an expression `*` stands for one chunk and `**` for any
number of them, none included; both stand alone in their chunk.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache

from spatial.errors import InputError
from wire.bus import Qos

STATION = "station"
TRUTH = "truth"
_CHUNK = re.compile(r"[A-Za-z0-9_.+-]+")
_MAX_KEY = 512


@lru_cache(maxsize=4096)
def checked_key(key: str) -> str:
    """Return a key that is safe to publish on.

    Raises:
        InputError: empty, too long, or a chunk with a wildcard or another forbidden character.
    """
    if len(key) <= _MAX_KEY and all(_CHUNK.fullmatch(chunk) for chunk in key.split("/")):
        return key
    raise InputError(
        f"{key[:80]!r} is no key: chunks of letters, digits and _ . + - joined by single "
        f"slashes, at most {_MAX_KEY} characters"
    )


def checked_expression(expression: str) -> str:
    """Return a key expression whose wildcards stand alone in their chunks.

    Raises:
        InputError: it has another form.
    """
    chunks = expression.split("/")
    if all(chunk in ("*", "**") or _CHUNK.fullmatch(chunk) for chunk in chunks):
        return expression
    raise InputError(f"{expression[:80]!r} is no key expression: chunks are names, * or **")


@lru_cache(maxsize=4096)
def matches(expression: str, key: str) -> bool:
    """Return whether a key lies in an expression with `*` and `**`."""
    return _matches(tuple(expression.split("/")), tuple(key.split("/")))


def _matches(pattern: tuple[str, ...], chunks: tuple[str, ...]) -> bool:
    if not pattern:
        return not chunks
    head, rest = pattern[0], pattern[1:]
    if head == "**":
        return any(_matches(rest, chunks[i:]) for i in range(len(chunks) + 1))
    return bool(chunks) and head in ("*", chunks[0]) and _matches(rest, chunks[1:])


@dataclass(frozen=True, slots=True)
class Keys:
    """Keys of one site in one session."""

    session: str = "live"
    """`live` or `replay-<id>`."""
    site: str = "sam"
    """Name of the site."""

    def __post_init__(self) -> None:
        """Refuse what is not one chunk.

        Raises:
            InputError: a session or site that is not one chunk, or a site with a reserved name.
        """
        for what, name in (("session", self.session), ("site", self.site)):
            if not _CHUNK.fullmatch(name):
                raise InputError(f"{what} {name!r} is no name of letters, digits and _ . + -")
        if self.site in (STATION, TRUTH):
            raise InputError(f"site {self.site!r} has a reserved name ({STATION}, {TRUTH})")

    def image(self, camera: str) -> str:
        """Key of full-quality images for the tracker."""
        return self._site(f"camera/{camera}/image")

    def video(self, camera: str) -> str:
        """Key of the operator's video, with a budget of its own."""
        return self._site(f"camera/{camera}/video")

    def calibration(self, camera: str) -> str:
        """Key of the nominal intrinsics, latched."""
        return self._site(f"camera/{camera}/calibration")

    def health(self, component: str) -> str:
        """Key of the health of one process."""
        return self._site(f"health/{component}")

    def command(self, name: str) -> str:
        """Key of one kind of command to the site; a player never publishes it."""
        return self._site(f"cmd/{name}")

    def object(self, slug: str) -> str:
        """Key of the revision of a database entry, latched."""
        return checked_key(f"{self.session}/{STATION}/objects/{slug}")

    def truth(self, name: str) -> str:
        """Key below which only the simulator publishes and only metrics and recorder read."""
        return checked_key(f"{self.session}/{TRUTH}/{name}")

    @property
    def vio(self) -> str:
        """Key of the odometry."""
        return self._site("vio")

    @property
    def joints(self) -> str:
        """Key of the joint states."""
        return self._site("joints")

    @property
    def wrench(self) -> str:
        """Key of the tool's wrench."""
        return self._site("wrench")

    @property
    def robot_description(self) -> str:
        """Key of the URDF, latched."""
        return self._site("robot_description")

    @property
    def clock(self) -> str:
        """Key of clock probes; in a replay, of the playback clock."""
        return self._site("clock")

    @property
    def tracked(self) -> str:
        """Key of the tracker's poses."""
        return self._site("tracked")

    @property
    def track_report(self) -> str:
        """Key of the tracker's reasons."""
        return self._site("track_report")

    @property
    def tf(self) -> str:
        """Key of link transforms for other tools."""
        return f"{self.session}/{STATION}/tf"

    @property
    def scene(self) -> str:
        """Key of the scene for other tools."""
        return f"{self.session}/{STATION}/scene"

    @property
    def events(self) -> str:
        """Key of event marks."""
        return f"{self.session}/{STATION}/events"

    @property
    def all(self) -> str:
        """Expression of everything in the session."""
        return f"{self.session}/**"

    @property
    def all_commands(self) -> str:
        """Expression of every command to the site: all that a site listens to."""
        return self._site("cmd/**")

    @property
    def all_health(self) -> str:
        """Expression of the health of every process."""
        return self._site("health/*")

    @property
    def all_truth(self) -> str:
        """Expression of the simulator's truth."""
        return f"{self.session}/{TRUTH}/**"

    def topic(self, key: str) -> str | None:
        """Return a key without this session, as a file has it; `None` when of another session."""
        prefix = f"{self.session}/"
        return key[len(prefix) :] if key.startswith(prefix) else None

    def of_topic(self, topic: str) -> str:
        """Return the key of a file's topic in this session.

        Raises:
            InputError: the topic has characters that no key has.
        """
        return checked_key(f"{self.session}/{topic}")

    def _site(self, rest: str) -> str:
        key = f"{self.session}/{self.site}/{rest}"
        return key if key.endswith("*") else checked_key(key)


def is_command(topic: str) -> bool:
    """Return whether a topic (a key without its session) could move a robot.

    Wider than our own layout on purpose: any topic with a chunk `cmd` counts.
    """
    return "cmd" in topic.split("/")


def is_truth(topic: str) -> bool:
    """Return whether a topic (a key without its session) holds ground truth."""
    return topic.split("/", maxsplit=1)[0] == TRUTH


LATCHED_TOPICS = ("*/camera/*/calibration", "*/robot_description", f"{STATION}/objects/*")
IMAGE_TOPICS = ("*/camera/*/image", "*/camera/*/video")


def qos_of(topic: str) -> Qos:
    """Return how a topic (a key without its session) travels."""
    if any(matches(pattern, topic) for pattern in LATCHED_TOPICS):
        return Qos.LATCHED
    return Qos.IMAGE if any(matches(p, topic) for p in IMAGE_TOPICS) else Qos.STATE
