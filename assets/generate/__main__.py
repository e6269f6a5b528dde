"""`python -m assets.generate` writes every asset again; `git diff` shows what changed."""

from __future__ import annotations

from pathlib import Path

from assets.generate import robot

ASSETS = Path(__file__).parents[1]


def main() -> None:
    """Write robots and objects."""
    robot.make(ASSETS / "robots" / "sam")


main()
