"""Describe the robot of a URDF in the terms of the file: links, joints, loops and couplings.

`describe` reads the XML of the file itself, without Pinocchio's parser, which merges links that fixed joints
connect. It imports no scene. `crosscheck diff` compares two robots.
"""

from __future__ import annotations

import math
import os
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from newton_euler.model.source_file import element_lines, path_text, read_text
from newton_euler.reading.digits import VARIANTS, NumbersOfText
from newton_euler.reading.robot import (
    FileBody,
    FileCoupling,
    FileJoint,
    JointKind,
    Placement,
    Robot,
    RobotFile,
)
from newton_euler.scalars import Array
from urdf.reading.source import NUMBER_ATTRIBUTES, SourceError, parsed

JOINT_KINDS = {
    "revolute": JointKind.HINGE,
    "continuous": JointKind.HINGE,
    "prismatic": JointKind.SLIDE,
    "floating": JointKind.FREE,
}
"""Kind of a joint by its type in a URDF; a fixed joint has none, and a planar joint has three motions."""

NUMBERS = frozenset(name for names in NUMBER_ATTRIBUTES.values() for name in names)
"""Names of attributes with numbers."""


def describe(source: str | os.PathLike[str]) -> RobotFile:
    """Describe the robot of a URDF.

    Args:
        source: path of the file.

    Raises:
        SourceError: for a file that cannot be read or that is no URDF.

    Examples:
        >>> tracker = describe("urdf/tracker.urdf")
        >>> [joint.name for body in tracker.robot.bodies for joint in body.joints][0]
        'motor_1'
    """
    path = path_text(source, SourceError)
    text = read_text(path, limit="file_size", error=SourceError)
    robot = _robot(parsed(path, text), path)
    numbers = NumbersOfText(text, NUMBERS.__contains__)
    random = np.random.default_rng(0)
    return RobotFile(
        robot,
        variants=tuple(_robot(ET.fromstring(numbers.variant(random)), path) for _ in range(VARIANTS)),
        source=path,
        format="URDF",
        lines=element_lines(path, text, SourceError),
    )


def _robot(root: ET.Element, path: str) -> Robot:
    """Describe the robot of the root element of a checked URDF."""
    links = {str(link.get("name")): link for link in root.findall("link")}
    joints = root.findall("joint")
    joint_above = {_link_of(joint, "child"): joint for joint in joints}
    # parents before children
    order = [name for name in links if name not in joint_above]
    for parent in order:  # grows during the loop
        order.extend(child for child, joint in joint_above.items() if _link_of(joint, "parent") == parent)
    number = {name: k for k, name in enumerate(order)}
    return Robot(
        name=root.get("name", "") or Path(path).stem,
        bodies=tuple(_body(links[name], joint_above.get(name), number) for name in order),
        couplings=tuple(_mimics(joints)),
    )


def _link_of(joint: ET.Element, end: str) -> str:
    """Return the name of the link at one end, "parent" or "child", of a joint."""
    element = joint.find(end)
    return "" if element is None else str(element.get("link"))


def _body(link: ET.Element, joint: ET.Element | None, number: dict[str, int]) -> FileBody:
    """Describe a link and the joint to its parent; the root link has none.

    Args:
        link: element of the link.
        joint: element of the joint.
        number: index of each link in the robot, by name.
    """
    mass, center, inertia = 0.0, np.zeros(3), np.zeros((3, 3))
    inertial = link.find("inertial")
    if inertial is not None:
        frame = _origin(inertial)
        mass, center = _number(inertial.find("mass"), "value"), frame.position
        xx, xy, xz, yy, yz, zz = (
            _number(inertial.find("inertia"), name) for name in NUMBER_ATTRIBUTES["inertia"]
        )
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        inertia = frame.rotation @ inertia @ frame.rotation.T
    return FileBody(
        name=str(link.get("name")),
        parent=-1 if joint is None else number[_link_of(joint, "parent")],
        placement=Placement(np.zeros(3), np.eye(3)) if joint is None else _origin(joint),
        joints=() if joint is None else tuple(_motions(joint)),
        mass=mass,
        center=center,
        inertia=inertia,
    )


def _motions(joint: ET.Element) -> Iterator[FileJoint]:
    """Yield the motions of a joint: one, none of a fixed joint, or the three of a planar joint."""
    kind, name = str(joint.get("type")), str(joint.get("name"))
    if kind == "planar":
        for number, letter in enumerate("xyz"):
            yield FileJoint(
                f"{name}_{letter}",
                JointKind.HINGE if letter == "z" else JointKind.SLIDE,
                axis=np.eye(3)[number],
                point=np.zeros(3),
            )
        return
    if kind not in JOINT_KINDS:
        return
    dynamics, limit = joint.find("dynamics"), joint.find("limit")
    has_axis = kind != "floating"
    has_limits = limit is not None and kind in ("revolute", "prismatic")
    yield FileJoint(
        name,
        JOINT_KINDS[kind],
        axis=_axis(joint) if has_axis else np.zeros(3),
        point=np.zeros(3),
        damping=_number(dynamics, "damping"),
        friction=_number(dynamics, "friction"),
        limits=(_number(limit, "lower"), _number(limit, "upper")) if has_limits else (-math.inf, math.inf),
        effort=_number(limit, "effort", math.inf),
        speed=_number(limit, "velocity", math.inf),
    )


def _axis(joint: ET.Element) -> Array:
    """Return the unit vector (3,) of a joint's axis in the frame of the joint."""
    element = joint.find("axis")
    axis = np.array([1.0, 0.0, 0.0]) if element is None else _vector(element, "xyz")
    return axis / np.linalg.norm(axis)


def _mimics(joints: list[ET.Element]) -> Iterator[FileCoupling]:
    """Yield the couplings of joints that mimic others."""
    for joint in joints:
        mimic, name = joint.find("mimic"), str(joint.get("name"))
        if mimic is not None:
            powers = (_number(mimic, "offset"), _number(mimic, "multiplier", 1.0))
            yield FileCoupling(name, name, str(mimic.get("joint")), powers)


def _number(element: ET.Element | None, name: str, default: float = 0.0) -> float:
    """Return the number of an attribute; the default if the element or the attribute is missing."""
    return default if element is None else float(element.get(name, default))


def _vector(element: ET.Element, name: str) -> Array:
    """Return the three numbers (3,) of an attribute; zeros if the attribute is missing."""
    return np.array([float(number) for number in element.get(name, "0 0 0").split()])


def _origin(element: ET.Element) -> Placement:
    """Return the placement that the `<origin>` of an element gives; none means the frame of the parent."""
    origin = element.find("origin")
    if origin is None:
        return Placement(np.zeros(3), np.eye(3))
    roll, pitch, yaw = _vector(origin, "rpy")
    (sr, sp, sy), (cr, cp, cy) = np.sin([roll, pitch, yaw]), np.cos([roll, pitch, yaw])
    rotation = np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
    return Placement(_vector(origin, "xyz"), rotation)
