"""Documents tell the truth: their commands parse, their files exist, their links lead somewhere."""

from __future__ import annotations

import importlib
import re
import shlex
import subprocess
from pathlib import Path

import click
import pytest

from app.__main__ import COMMANDS

ROOT = Path(__file__).parents[1]
DOCUMENTS = [ROOT / "README.md", ROOT / "ARCHITECTURE.md", *sorted((ROOT / "docs").glob("*.md"))]


def commands() -> list[str]:
    found = set()
    for document in DOCUMENTS:
        text = document.read_text(encoding="utf-8")
        found |= set(re.findall(r"^ {4}(\./run [^#\n]*)", text, re.MULTILINE))
        found |= set(re.findall(r"`((?:\./run )?telepresence [a-z][^`]*)`", text))
    return sorted(line.strip() for line in found)


@pytest.mark.parametrize("line", commands())
def test_a_command_in_a_document_is_one_the_program_takes(line: str) -> None:
    words = shlex.split(line.removeprefix("./run "))
    if words[0] == "telepresence":
        words = words[1:]
    if words[0] in ("test", "lock"):
        assert words[0] in (ROOT / "run").read_text(encoding="utf-8")
        return
    assert words[0] in COMMANDS
    command = importlib.import_module(f"app.commands.{words[0]}").command
    assert isinstance(command, click.Command)
    while isinstance(command, click.Group):
        words = words[1:]
        command = command.commands[words[0]]
    given = [word for word in words[1:] if word != "FILE"] + ["x"] * words[1:].count("FILE")
    if given or not any(parameter.required for parameter in command.params):
        command.make_context(words[0], given)


def test_every_link_and_named_file_exists() -> None:
    for document in DOCUMENTS:
        text = document.read_text(encoding="utf-8")
        targets = re.findall(r"\]\(([^)#]+)\)", text)
        targets += re.findall(
            r"`((?:app|assets|docs|scene|sim|spatial|teleop|tracking|wire)/[\w./]+)`", text
        )
        for target in targets:
            exists = (ROOT / target).exists() or (document.parent / target).exists()
            assert exists, f"{document.name} names {target}"


def test_the_run_script_is_a_posix_script_and_lists_its_commands() -> None:
    assert subprocess.run(["sh", "-n", ROOT / "run"], check=False).returncode == 0
    usage = subprocess.run([ROOT / "run", "help"], check=False, capture_output=True, text=True)
    assert usage.stdout == ""
    for name in ("demo", "test", "lock", "doctor", "telepresence"):
        assert name in usage.stderr
