"""Names for the elements that a model file leaves without name, by which rows of differences tell them apart.

Elements are paired before they get these names, since equal numbers in two files mean nothing.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import replace

from newton_euler.reading.robot import FileBody, FileDrive, Robot, RobotFile


def with_names(file: RobotFile) -> RobotFile:
    """Return a file whose bodies, joints and drives all have names, also in the variants of the robot."""
    return replace(file, robot=_named(file.robot), variants=tuple(map(_named, file.variants)))


def _named(robot: Robot) -> Robot:
    """Return a robot whose bodies, joints and drives have names.

    A body gets its number, where the first body is 1 as in MuJoCo. A joint gets the name of its body, and a
    drive those of its joints.
    """
    names = _unique(body.name or f"body {number}" for number, body in enumerate(robot.bodies, start=1))
    bodies = (_with_joint_names(replace(b, name=n)) for b, n in zip(robot.bodies, names, strict=True))
    drives = _unique(drive.name or _name_of_drive(drive, robot.drives) for drive in robot.drives)
    return replace(
        robot,
        bodies=tuple(bodies),
        drives=tuple(replace(drive, name=name) for drive, name in zip(robot.drives, drives, strict=True)),
    )


def _with_joint_names(body: FileBody) -> FileBody:
    """Return a body whose joints have names."""
    names = _unique(joint.name or body.name for joint in body.joints)
    return replace(body, joints=tuple(replace(j, name=n) for j, n in zip(body.joints, names, strict=True)))


def _name_of_drive(drive: FileDrive, drives: Iterable[FileDrive]) -> str:
    """Return the names of a drive's joints, and its law if the joints have several drives without name."""
    joints = ", ".join(drive.gears) or "a body"
    if sum(not other.name and other.gears.keys() == drive.gears.keys() for other in drives) == 1:
        return joints
    law = "position" if drive.stiffness else "velocity" if drive.damping else "force"
    return f"{law} drive of {joints}"


def _unique(names: Iterable[str]) -> list[str]:
    """Return names of which each repeated one has a number."""
    counts: Counter[str] = Counter()
    unique = []
    for name in names:
        counts[name] += 1
        unique.append(name if counts[name] == 1 else f"{name} ({counts[name]})")
    return unique
