"""The type checker holds the frames: wrong chains are rejected, names agree with annotations."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("app", "scene", "sim", "spatial", "teleop", "tracking", "wire")
FRAMES = {"w", "platform", "base", "tcp", "hc", "mako", "object"}  # others have narrower names


def test_mypy_rejects_every_wrong_chain() -> None:
    command = [sys.executable, "-m", "mypy", "--strict", "--warn-unused-ignores"]
    done = subprocess.run(
        [*command, "tests/typing/wrong_chains.py"], cwd=ROOT, capture_output=True, text=True,
        check=False, timeout=100,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout


def faults(path: Path) -> list[str]:
    """Names `T_a_b` in a file whose annotation is not `Pose[A, B]`, roles like `now` aside."""
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if not isinstance(node, (ast.arg, ast.AnnAssign)) or node.annotation is None:
            continue
        name = node.arg if isinstance(node, ast.arg) else ast.unparse(node.target)
        words = name.rpartition(".")[2].lstrip("_").lower().split("_")
        for sub in ast.walk(node.annotation):
            if not (isinstance(sub, ast.Subscript) and ast.unparse(sub.value) == "Pose"):
                continue
            frames = ast.unparse(sub.slice).strip("()")
            pairs = zip(words[1:], frames.lower().split(", "), strict=False)
            wrong = any({w, f} <= FRAMES and w != f for w, f in pairs)
            if words[0] in {"t", "ts"} and wrong:
                found.append(f"{path.name}:{node.lineno} {name}: {ast.unparse(sub)}")
    return found


def test_names_of_poses_agree_with_their_frames() -> None:
    files = [path for name in PACKAGES for path in (ROOT / name).rglob("*.py")]
    assert [fault for path in files for fault in faults(path)] == []


def test_a_wrong_name_is_found(tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.py"
    wrong.write_text("def f(T_tcp_base: Pose[Base, Tcp], T_base_tcp_now: Pose[Base, Tcp]): ...")
    assert faults(wrong) == ["wrong.py:1 T_tcp_base: Pose[Base, Tcp]"]
