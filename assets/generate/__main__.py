"""`python -m assets.generate` writes every asset again; `git diff` shows what changed."""

from __future__ import annotations

import shutil
from pathlib import Path

from assets.generate import objects, robot

ASSETS = Path(__file__).parents[1]


def main() -> None:
    """Write robots and objects, each with the licence of the project."""
    robot.make(ASSETS / "robots" / "sam")
    objects.make(ASSETS / "objects")
    licence = ASSETS.parent / "LICENSE"
    for folder in (ASSETS / "robots" / "sam", *sorted((ASSETS / "objects").iterdir())):
        shutil.copyfile(licence, folder / "LICENSE")


if __name__ == "__main__":
    main()
