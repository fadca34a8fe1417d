"""Check a URDF file before Pinocchio parses it, and read properties of its joints.

Pinocchio's parser accepts some wrong files silently, and its errors name no element. `parsed` checks names,
numbers and the tree of links, and raises errors that name the line or element.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections import Counter
from typing import NamedTuple

import numpy as np

from newton_euler.errors import choices
from newton_euler.limits import exceeded
from newton_euler.model import source_file
from newton_euler.model.source_file import MAX_MODEL_NUMBER, scan, xml_tree
from newton_euler.scalars import Array
from urdf.errors import LoopFileError, UrdfError
from urdf.loops import Loops, parse_loops
from urdf.reading.vocabulary import check_expanded

NUMBER_ATTRIBUTES = {
    "origin": ("xyz", "rpy"),
    "axis": ("xyz",),
    "mass": ("value",),
    "inertia": ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"),
    "limit": ("lower", "upper", "effort", "velocity"),
    "dynamics": ("damping", "friction"),
    "mimic": ("multiplier", "offset"),
}
"""Attributes with numbers, by tag of the element."""

JOINT_VELOCITIES = {"revolute": 1, "continuous": 1, "prismatic": 1, "fixed": 0, "floating": 6, "planar": 3}
"""Number of velocities by type of joint; other types are unknown."""


NO_LIMIT = 1e300
"""Magnitude from which on a number counts as no limit. A URDF must have limits of slides and of revolute
joints, and no number in it may be infinite: `urdf.write` writes this number, Pinocchio the largest double."""


class SourceError(source_file.SourceError, UrdfError):
    """File that is not a usable model. The message has the file, the place in the file and the problem."""


class JointLimits(NamedTuple):
    """Limits of a joint.

    Attributes:
        low, high: smallest and largest coordinate, m or rad; one may be infinite.
        speed: largest rate, m/s or rad/s; may be infinite.
    """

    low: float
    high: float
    speed: float


def finite_or_infinite(limit: float) -> float:
    """Return a limit of a joint, infinite if the number stands for no limit."""
    return float(limit) if abs(limit) < NO_LIMIT else math.copysign(math.inf, limit)


def joint_limits(low: float, high: float, speed: float) -> JointLimits | None:
    """Return the limits of a joint, one of them infinite or none; None for a coordinate without limits.

    Args:
        low, high: smallest and largest coordinate in the model, m or rad.
        speed: largest rate in the model, m/s or rad/s.
    """
    limits = JointLimits(*map(finite_or_infinite, (low, high, speed)))
    return limits if math.isfinite(limits.low) or math.isfinite(limits.high) else None


class JointProperties(NamedTuple):
    """Properties of a joint in addition to its kind, axis and placement.

    Attributes:
        name: name of the joint.
        damping: N s/m or N m s/rad.
        friction: dry friction, N or N m.
        armature: rotor inertia, kg or kg m^2.
        limits: limits of coordinate and rate; None without limits.
        unit: unit of the coordinate, "m" or "rad".
        has_safety: True for a joint with a safety controller.
        stiffness: stiffness of the spring, N/m or N m/rad.
        rest: coordinate, m or rad, at which the spring exerts no force.
        rotor: rotor inertia times squared gear ratio, kg m^2 or kg, of a Pinocchio model that has these two
            numbers but no armature; Pinocchio's dynamics ignore them.
    """

    name: str
    damping: float
    friction: float
    armature: float
    limits: JointLimits | None
    unit: str
    has_safety: bool = False
    stiffness: float = 0.0
    rest: float = 0.0
    rotor: float = 0.0


def joint_properties(root: ET.Element) -> list[JointProperties]:
    """Read the properties of all joints of a checked URDF."""
    joints = []
    for joint in root.findall("joint"):
        dynamics, limit = joint.find("dynamics"), joint.find("limit")
        damping, friction = (
            0.0 if dynamics is None else float(dynamics.get(name, 0.0)) for name in ("damping", "friction")
        )
        limits = None
        if limit is not None and joint.get("type") in ("revolute", "prismatic"):
            limits = joint_limits(*(float(limit.get(name, 0.0)) for name in ("lower", "upper", "velocity")))
        unit = "m" if joint.get("type") == "prismatic" else "rad"
        joints.append(
            JointProperties(
                str(joint.get("name")),
                damping=damping,
                friction=friction,
                armature=0.0,
                limits=limits,
                unit=unit,
                has_safety=joint.find("safety_controller") is not None,
            )
        )
    return joints


def read_loops(path: str, text: str) -> Loops:
    """Parse a loop file: YAML that gives a URDF the loops and couplings of joints that URDF cannot describe.

    Args:
        path: path of the loop file.
        text: its content.

    Raises:
        LoopFileError: for invalid content or too many loops.
    """
    loops = parse_loops(text, path)
    for key in ("closed_loop", "coupled"):
        # a message if the number is above the limit "closures", which users can change
        if problem := exceeded("closures", len(getattr(loops, key))):
            raise LoopFileError(path, key, problem)
    return loops


def parsed(path: str, text: str) -> ET.Element:
    """Parse a URDF and check its names, structure and numbers.

    Returns:
        The root element.

    Raises:
        SourceError: with the line or the element at fault.
    """
    # `scan` refuses dangerous XML; the callback refuses SDF files and xacro macros
    any_root = None
    scan(path, text, any_root, check_expanded(path, SourceError), SourceError)
    root = xml_tree(text)
    for what in ("link", "joint"):
        names = [element.get("name") for element in root.findall(what)]
        if not all(names):
            raise SourceError(path, f"a {what} without a name")
        for name, count in Counter(names).items():
            if count > 1:
                raise SourceError(path, f"{what} {name!r:.100}: {count} of that name")
    # sizes (by name of the limit; a mimic counts as a loop closure), joints, and the tree of links
    links, joints = ({element.get("name") for element in root.findall(tag)} for tag in ("link", "joint"))
    if not links:
        raise SourceError(path, "no links")
    velocities = sum(JOINT_VELOCITIES.get(str(joint.get("type")), 0) for joint in root.findall("joint"))
    counts = {"bodies": len(links), "velocities": velocities, "closures": len(root.findall("joint/mimic"))}
    for name, count in counts.items():
        if problem := exceeded(name, count):
            raise SourceError(path, problem)
    for joint in root.findall("joint"):
        _check_joint(path, joint, links, joints)
    _check_tree(path, root)
    # numbers of all elements
    for element in (*root.findall("link"), *root.findall("joint")):
        where = f"{element.tag} {element.get('name')!r:.100}"
        for part in element.iter():
            for name in NUMBER_ATTRIBUTES.get(part.tag, ()):
                if name in part.attrib:
                    _check_numbers(f"{where}: <{part.tag}>", path, name, part.attrib[name])
                elif part.tag in ("mass", "inertia"):
                    raise SourceError(path, f"{where}: <{part.tag}> has no {name}")
            if part.tag == "mass" and float(part.attrib["value"]) < 0.0:
                raise SourceError(
                    path, f"{where}: mass is {part.attrib['value']:.100} kg; needed: none below 0"
                )
    return root


def check_inertias(path: str, root: ET.Element) -> None:
    """Raise `SourceError` for the first negative moment of inertia; Pinocchio's error names no link.

    Moments below the round-off of the largest moment in the file count as zero.
    """
    moments_of_link: dict[str, Array] = {}
    for link in root.findall("link"):
        element = link.find("inertial/inertia")
        if element is not None:
            xx, xy, xz, yy, yz, zz = (float(element.get(name, "0")) for name in NUMBER_ATTRIBUTES["inertia"])
            moments = np.linalg.eigvalsh([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            moments_of_link[str(link.get("name"))] = moments
    largest = max((moments[-1] for moments in moments_of_link.values()), default=0.0)
    round_off = 4.0 * np.finfo(float).eps * largest
    for name, moments in moments_of_link.items():
        if moments[0] < -round_off:
            text = ", ".join(f"{moment:.6g}" for moment in moments)
            problem = f"link {name!r:.100}: principal moments of inertia are {text} kg m^2"
            raise SourceError(path, f"{problem}; needed: none below 0")


def _check_joint(path: str, joint: ET.Element, links: set[str | None], joints: set[str | None]) -> None:
    """Raise `SourceError` for an unknown type, links that do not exist, or a mimic of no other joint.

    Args:
        path: path of the URDF.
        joint: element of the joint.
        links: names of all links.
        joints: names of all joints.
    """
    where = f"joint {joint.get('name')!r:.100}"
    if joint.get("type") not in JOINT_VELOCITIES:
        kind = joint.get("type")
        raise SourceError(path, f"{where}: unknown type {kind!r:.100}; {choices(kind, JOINT_VELOCITIES)}")
    for end in ("parent", "child"):
        element = joint.find(end)
        link = None if element is None else element.get("link")
        if link not in links:
            raise SourceError(path, f"{where}: {end} link {link!r:.100} does not exist")
    for mimic in joint.findall("mimic"):
        if mimic.get("joint") not in joints - {joint.get("name")}:
            problem = "itself" if mimic.get("joint") in joints else "which does not exist"
            raise SourceError(path, f"{where}: mimics {mimic.get('joint')!r:.100}, {problem}")


def _check_tree(path: str, root: ET.Element) -> None:
    """Raise `SourceError` unless joints connect one root link to all others, which parsers do not check."""
    # each link is the child of at most one joint
    joint_above: dict[str, ET.Element] = {}
    for joint in root.findall("joint"):
        child = _link_of(joint, "child")
        if child in joint_above:
            both = f"{joint_above[child].get('name')!r:.100} and {joint.get('name')!r:.100}"
            raise SourceError(path, f"link {child!r:.100}: child of both joint {both}; needed: of one")
        joint_above[child] = joint
    # one root
    roots = [str(link.get("name")) for link in root.findall("link") if link.get("name") not in joint_above]
    if len(roots) > 1:
        problem = f"links {roots[0]!r:.100} and {roots[1]!r:.100}: no joint leads to either"
        raise SourceError(path, f"{problem}; needed: one such link, the root")
    # the parents of every link lead to the root
    reached = set(roots)
    for link in joint_above:
        path_up: dict[str, None] = {}
        while link not in reached:
            if link in path_up:
                problem = f"link {link!r:.100}: its joints form a circle"
                raise SourceError(path, f"{problem}; needed: a tree, with loops in the loop file")
            path_up[link] = None
            link = _link_of(joint_above[link], "parent")
        reached |= path_up.keys()


def _link_of(joint: ET.Element, end: str) -> str:
    """Return the name of the link at one end, "parent" or "child", of a checked joint."""
    element = joint.find(end)
    return "" if element is None else str(element.get("link"))


def _check_numbers(where: str, path: str, name: str, value: str) -> None:
    """Raise `SourceError` unless an attribute has the right count of finite numbers.

    Args:
        where: element in messages.
        path: path of the URDF.
        name: name of the attribute.
        value: text of the attribute.
    """
    count = 3 if name in ("xyz", "rpy") else 1
    if len(value.split()) != count:
        raise SourceError(path, f"{where} has {name}={value!r:.100}; needed: {count} numbers")
    for token in value.split():
        try:
            number = float(token)
        except ValueError:
            number = math.nan
        # limits are not simulated, and often infinite
        if math.isnan(number) or (abs(number) > MAX_MODEL_NUMBER and "<limit>" not in where):
            raise SourceError(path, f"{where} has {name}={value!r:.100}; needed: finite numbers")
