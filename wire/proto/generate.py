"""Regenerate `wire/generated` from the .proto files: `python -m wire.proto.generate [FOLDER]`."""

from __future__ import annotations

import sys
from pathlib import Path

from grpc_tools import protoc

from spatial.errors import StateError

HERE = Path(__file__).resolve().parent
SOURCE = "telepresence/v1/telepresence.proto"
GENERATED = HERE.parent / "generated"
INIT = '"""Generated from wire/proto; do not edit."""\n'


def generate(folder: Path) -> list[Path]:
    """Write the modules and stubs of every message below a folder.

    Returns:
        The files written, relative to `folder`.

    Raises:
        StateError: the protobuf compiler refused the source.
    """
    module = Path(SOURCE.replace(".proto", "_pb2.py"))
    inits = [parent / "__init__.py" for parent in module.parents]
    for init in inits:
        (folder / init).parent.mkdir(parents=True, exist_ok=True)
        (folder / init).write_text(INIT)
    arguments = ["protoc", f"-I{HERE}", f"--python_out={folder}", f"--mypy_out=quiet:{folder}"]
    if protoc.main([*arguments, SOURCE]) != 0:
        raise StateError(f"the protobuf compiler refused {SOURCE}")
    return [*inits, module, module.with_suffix(".pyi")]


if __name__ == "__main__":
    generate(Path(sys.argv[1]) if len(sys.argv) > 1 else GENERATED)
