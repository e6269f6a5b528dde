"""Where the meshes of a robot description lie; never outside the robot's package folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from urllib.parse import unquote, urlsplit

from spatial.errors import FileInputError

_INNER_FOLDERS = {"urdf", "robots", "xacro"}


def find_mesh(name: str, *, urdf: Path, packages: Mapping[str, Path], line: int) -> Path | str:
    """Return the file a description names, or a sentence why it is missing.

    Args:
        name: a path relative to the description, or a `package://` or `file://` address.
        urdf: the description.
        packages: folders of package names; others are looked up in the folders above.
        line: where the name stands.

    Raises:
        FileInputError: a place outside the package folder, or another kind of address.
    """
    address = urlsplit(name)
    rest = Path(unquote(address.path).lstrip("/"))
    if address.scheme == "package":
        package = _package(address.netloc, urdf, packages)
        if package is None:
            above = f"the folders above {urdf.name}"
            return f"package {address.netloc!r} of mesh {name!r} is neither given nor in {above}"
        file = package / rest
    elif address.scheme in {"", "file"}:
        package = _package_of(urdf)
        file = urdf.parent / (unquote(address.path) if address.scheme else name)
    else:
        message = f"mesh {name!r}: expected a relative path or package://, got {address.scheme}:"
        raise FileInputError(message, path=urdf, line=line)
    try:
        inside = file.resolve().is_relative_to(package.resolve())
        exists = inside and file.is_file()
    except (OSError, ValueError, RuntimeError):
        return f"mesh {name[:80]!r} is not a usable path"
    if not inside:
        message = f"mesh {name!r} lies outside the robot's package folder {package.name!r}"
        raise FileInputError(message, path=urdf, line=line)
    return file if exists else f"mesh {name!r} does not exist"


def _package(name: str, urdf: Path, packages: Mapping[str, Path]) -> Path | None:
    if name in packages:
        return packages[name]
    if not name or name in {".", ".."}:
        return None
    for folder in urdf.resolve().parents:
        if folder.name == name:
            return folder
        if (folder / name).is_dir():
            return folder / name
    return None


def _package_of(urdf: Path) -> Path:
    """Return the folder a description belongs to: the one with `package.xml`, or its own."""
    folder = urdf.resolve().parent
    for above in (folder, *folder.parents[:3]):
        if (above / "package.xml").is_file():
            return above
    return folder.parent if folder.name in _INNER_FOLDERS else folder
