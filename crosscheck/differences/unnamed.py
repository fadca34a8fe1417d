"""Names for the elements that a model file leaves without name, by which rows of differences tell them apart.

Elements are paired before they get these names, since equal numbers in two files mean nothing.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import replace

from newton_euler.reading.names import body_names, unique_names
from newton_euler.reading.robot import FileDrive, FilePlace, Robot, RobotFile


def with_names(file: RobotFile) -> RobotFile:
    """Return a file whose bodies, joints and drives all have names, also in the variants of the robot."""
    return replace(file, robot=_named(file.robot), variants=tuple(map(_named, file.variants)))


def _named(robot: Robot) -> Robot:
    """Return a robot whose bodies, joints and drives have names.

    A body gets its number, a joint the name of its body, and a drive the names of its joints.
    """
    names = body_names([body.name for body in robot.bodies])
    of_joints = iter(
        unique_names(
            [joint.name for body in robot.bodies for joint in body.joints],
            [name for body, name in zip(robot.bodies, names, strict=True) for _ in body.joints],
        )
    )
    bodies = tuple(
        replace(body, name=name, joints=tuple(replace(joint, name=next(of_joints)) for joint in body.joints))
        for body, name in zip(robot.bodies, names, strict=True)
    )
    drives = unique_names(
        [drive.name for drive in robot.drives],
        _names_of_drives(robot.drives, names),
    )
    return replace(
        robot,
        bodies=bodies,
        drives=tuple(replace(drive, name=name) for drive, name in zip(robot.drives, drives, strict=True)),
    )


def _names_of_drives(drives: Sequence[FileDrive], bodies: Sequence[str]) -> Iterator[str]:
    """Yield what each drive acts on, and its law if that has several drives without name.

    Args:
        drives: the drives of a robot.
        bodies: names of its bodies.
    """
    targets = [_target(drive, bodies) for drive in drives]
    counts = Counter(target for drive, target in zip(drives, targets, strict=True) if not drive.name)
    for drive, target in zip(drives, targets, strict=True):
        law = "position" if drive.stiffness else "velocity" if drive.damping else "force"
        yield target if counts[target] == 1 else f"{law} drive of {target}"


def is_numbered(drive: FileDrive) -> bool:
    """Return whether a drive without name in its file has a name that tells it from others of one joint."""
    return re.match(r"(position|velocity|force) drive of ", drive.name) is not None


def _target(drive: FileDrive, bodies: Sequence[str]) -> str:
    """Return the names of a drive's joints, or of what else it acts on; "a body" without a name."""
    for value in (drive.other.get(what) for what in ("joint", "tendon", "body", "site")):
        if isinstance(value, FilePlace) and value.body >= 0:
            return bodies[value.body]
        if isinstance(value, str):
            return value
    return ", ".join(drive.gears) or "a body"
