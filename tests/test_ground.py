"""The ground everything stands on: roots, files that must not be tracked, commands in documents."""

from __future__ import annotations

import importlib
import re
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("app", "scene", "sim", "spatial", "teleop", "tracking", "wire")


def tracked_files() -> list[Path]:
    listing = subprocess.run(
        ["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True, text=True
    )
    return [ROOT / name for name in listing.stdout.split("\0") if name]


@pytest.mark.parametrize("name", PACKAGES)
def test_every_root_package_lies_in_this_checkout(name: str) -> None:
    package = importlib.import_module(name)
    assert Path(str(package.__file__)).is_relative_to(ROOT)


def test_no_tracked_file_names_a_package_index_or_a_path_of_one_machine() -> None:
    pattern = re.compile(
        rb"--(extra-)?index-url|://[^\s\"']*/simple\b|file:///|[\"' (]/(root|work)/"
    )
    ours = Path(__file__)
    hits = [
        path.relative_to(ROOT)
        for path in tracked_files()
        if path.exists() and path != ours and pattern.search(path.read_bytes())
    ]
    assert hits == []


def test_no_lock_file_that_records_hosts_is_tracked() -> None:
    names = [path.name for path in tracked_files()]
    assert not [name for name in names if name == "uv.lock" or name.startswith("pylock")]


def test_requirements_are_hashed_and_name_no_host() -> None:
    for name in ("run.txt", "test.txt"):
        text = (ROOT / "requirements" / name).read_text(encoding="utf-8")
        pins = re.findall(r"^[a-z][^ ]*==", text, re.MULTILINE)
        assert len(pins) > 20
        assert "--hash=sha256:" in text
        assert "://" not in text


def test_init_files_hold_a_docstring_and_nothing_else() -> None:
    for package in PACKAGES:
        for init in (ROOT / package).rglob("__init__.py"):
            if "generated" in init.parts:
                continue
            text = init.read_text(encoding="utf-8").strip()
            assert text.startswith('"""'), init
            assert text.endswith('"""'), init
            assert text.count('"""') == 2, init


def test_continuous_integration_runs_the_command_of_the_readme() -> None:
    assert "./run test" in (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert "./run test" in (ROOT / "README.md").read_text(encoding="utf-8")
