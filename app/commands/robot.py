"""`telepresence robot`: checks a robot description and prints where its links are."""

from __future__ import annotations

from pathlib import Path

import click

from app.report import pose_json, print_json, say
from scene.robot import Robot, load_robot
from spatial.errors import InputError, unknown

EXAMPLE = """Check a robot description (URDF) and print the pose of every link in its root.

An explicit joint value wins over a mimic rule; one outside its limits is a warning.

Example: telepresence robot assets/robots/sam/robot.urdf --joints A2=0.5 A4=-1.2 --json
"""


@click.command(help=EXAMPLE, context_settings={"ignore_unknown_options": False})
@click.argument("urdf", type=click.Path(path_type=Path))
@click.argument("more", nargs=-1)
@click.option(
    "--package", "packages", multiple=True, metavar="NAME=DIR", help="Where package:// is."
)
@click.option(
    "--joints", "joints", multiple=True, metavar="NAME=VALUE ...", help="Positions [rad, m]."
)
@click.option("--json", "as_json", is_flag=True, help="One line of JSON.")
def command(
    *,
    urdf: Path,
    more: tuple[str, ...],
    packages: tuple[str, ...],
    joints: tuple[str, ...],
    as_json: bool,
) -> None:
    """Run the command."""
    if more and not joints:
        raise InputError(f"unexpected argument {more[0]!r}; joint values follow --joints")
    folders = {name: _folder(name, folder) for name, folder in map(_pair, packages)}
    robot = load_robot(urdf, packages=folders)
    values = {name: _number(name, text) for name, text in map(_pair, (*joints, *more))}
    warnings = list(robot.warnings) + check_joints(robot, values)
    poses = robot.fk(values)
    report = {
        "name": robot.name,
        "root": robot.root,
        "links": list(robot.links),
        "joints": [
            {
                "name": joint.name,
                "type": joint.type,
                "parent": joint.parent,
                "child": joint.child,
                "lower": joint.lower,
                "upper": joint.upper,
                "mimic": joint.mimic.joint if joint.mimic is not None else None,
            }
            for joint in robot.joints
        ],
        "poses": {link: pose_json(pose) for link, pose in poses.items()},
        "warnings": warnings,
    }
    if as_json:
        print_json(report)
        return
    say(f"{robot.name}: {len(robot.links)} links, {len(robot.joints)} joints, root {robot.root}")
    for warning in warnings:
        say(f"warning: {warning}")


def check_joints(robot: Robot, values: dict[str, float]) -> list[str]:
    """Return a warning for every value outside its limits.

    Raises:
        InputError: a joint the robot does not have.
    """
    joints = {joint.name: joint for joint in robot.joints}
    warnings = []
    for name, value in values.items():
        if name not in joints:
            raise InputError(unknown("joint", name, joints))
        joint = joints[name]
        low = joint.lower if joint.lower is not None else float("-inf")
        high = joint.upper if joint.upper is not None else float("inf")
        if not low <= value <= high:
            warnings.append(f"joint {name} = {value:g} lies outside its limits {low:g} to {high:g}")
    return warnings


def _pair(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals or not name or not value:
        raise InputError(f"expected NAME=VALUE, got {text!r}")
    return name, value


def _folder(package: str, text: str) -> Path:
    if not Path(text).is_dir():
        raise InputError(f"package {package}: expected a folder, got {text!r}")
    return Path(text)


def _number(name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise InputError(f"joint {name}: {text!r} is not a number") from None
    if value - value != 0.0:
        raise InputError(f"joint {name}: {text!r} is not finite")
    return value
