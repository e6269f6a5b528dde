"""Regenerate `wire/generated` from the .proto files: `python -m wire.proto.generate [FOLDER]`."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from spatial.errors import StateError

HERE = Path(__file__).resolve().parent
SOURCE = "telepresence/v1/telepresence.proto"
GENERATED = HERE.parent / "generated"
INIT = '"""Generated from wire/proto; do not edit."""\n'


def generate(folder: Path) -> list[Path]:
    """Write the modules and stubs of every message below a folder.

    The compiler (grpcio-tools) and its plug-in (mypy-protobuf) belong to the test dependencies,
    so the compiler is called and not imported.

    Returns:
        The files written, relative to `folder`.

    Raises:
        StateError: the protobuf compiler refused the source or is not installed.
    """
    module = Path(SOURCE.replace(".proto", "_pb2.py"))
    inits = [parent / "__init__.py" for parent in module.parents]
    for init in inits:
        (folder / init).parent.mkdir(parents=True, exist_ok=True)
        (folder / init).write_text(INIT)
    outputs = [f"--python_out={folder}", f"--mypy_out=quiet:{folder}"]
    command = [sys.executable, "-m", "grpc_tools.protoc", f"-I{HERE}", *outputs, SOURCE]
    plugins = f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', '')}"
    result = subprocess.run(  # noqa: S603  # our own arguments
        command, env={**os.environ, "PATH": plugins}, capture_output=True, text=True, check=False
    )
    if result.returncode != 0:
        raise StateError(f"the protobuf compiler refused {SOURCE}: {result.stderr.strip()}")
    return [*inits, module, module.with_suffix(".pyi")]


if __name__ == "__main__":
    generate(Path(sys.argv[1]) if len(sys.argv) > 1 else GENERATED)
