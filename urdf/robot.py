"""Describe the robot of a URDF in the terms of the file: links, joints, loops and couplings.

`describe` reads the XML of a file itself, without Pinocchio's parser, which merges links that fixed joints
connect. `urdf.model_robot` describes models that Pinocchio has in memory. No scene is imported. `crosscheck
diff` compares two robots.
"""

from __future__ import annotations

import math
import os
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from newton_euler.errors import check_choice
from newton_euler.model.source_file import element_lines, path_text, read_text, read_xml, xml_tree
from newton_euler.reading.digits import VARIANTS, NumbersOfText
from newton_euler.reading.import_report import ImportReport
from newton_euler.reading.names import names_by_kind
from newton_euler.reading.robot import (
    IN_PLACE,
    FileBody,
    FileCoupling,
    FileJoint,
    FileLoop,
    JointKind,
    LoopKind,
    Placement,
    Robot,
    RobotFile,
)
from newton_euler.scalars import Array
from urdf.errors import LoopFileError
from urdf.extensions import Extensions
from urdf.loops import NO_LOOPS, REVOLUTE, UNIVERSAL, Loops, loop_files_beside
from urdf.reading.planes import axes_of_plane, axis_vector
from urdf.reading.source import NUMBER_ATTRIBUTES, SourceError, finite_or_infinite, parsed, read_loops
from urdf.reading.transmissions import REDUCTION_TAGS, read_transmissions
from urdf.reading.vocabulary import BASES, BaseName, tag_of, unknown

if TYPE_CHECKING:
    from urdf.reading.given import UrdfInMemory

JOINT_KINDS = {
    "revolute": JointKind.HINGE,
    "continuous": JointKind.HINGE,
    "prismatic": JointKind.SLIDE,
    "floating": JointKind.FREE,
}
"""Kind of a joint by its type in a URDF; a fixed joint has none, and a planar joint has three motions."""

ROOT_JOINT = "root_joint"
"""Name of the free joint of a floating root link, as in Pinocchio."""

LOOP_KINDS = {"3d": LoopKind.POINT, "6d": LoopKind.WELD, REVOLUTE: LoopKind.HINGE, "rod": LoopKind.ROD}
"""Kind of a loop by its type in a loop file."""

NUMBERS = frozenset(name for names in NUMBER_ATTRIBUTES.values() for name in names) | {
    "armature",
    "spring_reference",
    "spring_stiffness",
    *REDUCTION_TAGS,
}
"""Names of attributes with numbers."""

ANGLES = ("rpy", "lower", "upper")
"""Names of attributes with angles."""

NUMBER_TAGS = (
    "pose",
    "xyz",
    "damping",
    "spring_reference",
    "spring_stiffness",
    "springReference",
    "springStiffness",
    "offset",
    *REDUCTION_TAGS,
)
"""Tags of elements that tools add and whose texts are numbers."""


def describe(
    source: str | os.PathLike[str] | UrdfInMemory,
    loops: str | os.PathLike[str] | None = None,
    base: BaseName | None = None,
) -> RobotFile:
    """Describe the robot of a model.

    Args:
        source: path of a URDF; or a `pinocchio.Model`, alone or in a pair with its constraints, which has no
            text and so no uncertainty.
        loops: path of the loop file of a URDF; None for no loop file.
        base: "fixed" if the root link of a URDF is the ground, "free" if it floats; None for a root that
            is described as the ground, but may float.

    Raises:
        UnknownNameError: for an unknown base.
        SourceError: for a file that cannot be read or that is no URDF, and for an unknown model.
        LoopFileError: for a loop file that is not valid or does not fit to the URDF.

    Examples:
        >>> tracker = describe("urdf/tracker.urdf", "urdf/tracker.loops.yaml")
        >>> tracker.robot.bodies[1].joints[0].kind.value, len(tracker.robot.loops)
        ('hinge', 2)
    """
    if not isinstance(source, str | os.PathLike):
        from urdf.model_robot import describe_model

        return describe_model(source)
    if base is not None:
        check_choice("base", base, BASES)
    path = path_text(source, SourceError)
    text = read_xml(path, SourceError)
    root = parsed(path, text)
    loop_content = NO_LOOPS
    if loops is not None:
        loop_path = path_text(loops, SourceError)
        loop_content = read_loops(loop_path, read_text(loop_path, limit="scene_size", error=SourceError))
    notes: list[str] = []
    if loops is None:
        notes += [
            f"its loops are open: {loop_file.name} next to it was not read; "
            f"the option loops={loop_file} closes them"
            for loop_file in loop_files_beside(Path(path))
        ]
    has_additions = _has_additions(root)
    robot = _robot(path, text, root, loop_content, base, has_additions, notes)
    numbers = NumbersOfText(text, NUMBERS.__contains__, NUMBER_TAGS, lambda _, name: name in ANGLES)
    random = np.random.default_rng(0)
    variants = []
    for _ in range(VARIANTS):
        changed = numbers.variant(random)
        variants.append(_robot(path, changed, xml_tree(changed), loop_content, base, has_additions, []))
    return RobotFile(
        robot,
        variants=tuple(variants),
        source=path,
        format="URDF",
        lines=element_lines({path: text}, SourceError),
        notes=tuple(notes),
        has_ground=base is not None or robot.bodies[0].name == "world",
    )


def _robot(
    path: str,
    text: str,
    root: ET.Element,
    loops: Loops,
    base: BaseName | None,
    has_additions: bool,
    notes: list[str],
) -> Robot:
    """Describe the robot of a checked URDF.

    Args:
        path: path of the file.
        text: its text.
        root: its root element.
        loops: content of the loop file.
        base: motion of the root link.
        has_additions: True if tools have added elements.
        notes: list that receives what the files have and the robot has not.
    """
    extensions = _extensions(path, text, root, loops, notes) if has_additions else Extensions(text)
    links = {str(link.get("name")): link for link in root.findall("link")}
    joints = root.findall("joint")
    joint_above = {_link_of(joint, "child"): joint for joint in joints}
    # parents before children
    children: dict[str, list[str]] = {name: [] for name in links}
    for child, joint in joint_above.items():
        children[_link_of(joint, "parent")].append(child)
    order = [name for name in links if name not in joint_above]
    for parent in order:  # grows during the loop
        order.extend(children[parent])
    types = dict(zip(loops.joint_name, loops.joint_type, strict=True))
    number = {name: k for k, name in enumerate(order)}
    bodies: list[FileBody] = []
    for name in order:
        above = joint_above.get(name)
        above_number = -1 if above is None else number[_link_of(above, "parent")]
        if above is not None:
            motions = tuple(_motions(path, above, types, extensions))
        elif base == "free":
            motions = (FileJoint(ROOT_JOINT, JointKind.FREE, axis=np.zeros(3), point=np.zeros(3)),)
        else:
            motions = ()
        bodies.append(_body(links[name], above, above_number, motions))
    robot = Robot(name=root.get("name", "") or Path(path).stem, bodies=tuple(bodies))
    return replace(
        robot,
        loops=tuple(_loops(robot, root, extensions, loops)),
        couplings=(*_mimics(joints), *_coupled(loops, notes)),
        transmissions=read_transmissions(root, notes),
    )


def _has_additions(root: ET.Element) -> bool:
    """Return True if a URDF has elements or attributes beyond the standard, which may move something."""
    additional = (
        dynamics.attrib.keys() - {"damping", "friction"} for dynamics in root.findall("joint/dynamics")
    )
    # rotors in transmissions are part of the vocabulary, unlike other additions that move something
    has_rotors = any(tag_of(element) == "drake:rotor_inertia" for element in root.iter())
    return any(additional) or has_rotors or next(unknown(root), None) is not None


def _extensions(path: str, text: str, root: ET.Element, loops: Loops, notes: list[str]) -> Extensions:
    """Return the loops, springs and rotors that tools add to a URDF; for the arguments see `_robot`."""
    from urdf.reading.extensions import read_extensions

    report = ImportReport()
    try:
        extensions = read_extensions(path, text, root, loops, (), report)
    except SourceError as error:
        notes.append(f"loops and springs that tools add to the URDF are not described: {error.problem}")
        return Extensions(text)
    elements_of: dict[str, list[str]] = {}  # by reason
    for entry in report.entries:
        if entry.is_unsimulated:
            elements_of.setdefault(entry.how, []).append(entry.element)
    notes.extend(f"{names_by_kind(elements)}: {why}" for why, elements in elements_of.items())
    springs = extensions.point_springs
    notes.extend(f"spring {spring.name!r} between two points is not described" for spring in springs)
    return extensions


def _link_of(joint: ET.Element, end: str) -> str:
    """Return the name of the link at one end, "parent" or "child", of a joint."""
    element = joint.find(end)
    return "" if element is None else str(element.get("link"))


def _body(
    link: ET.Element, joint: ET.Element | None, parent: int, motions: tuple[FileJoint, ...]
) -> FileBody:
    """Describe a link.

    Args:
        link: element of the link.
        joint: element of the joint to its parent; None for the root link.
        parent: index of the parent.
        motions: motions of the joint.
    """
    mass, center, inertia = 0.0, np.zeros(3), np.zeros((3, 3))
    inertial = link.find("inertial")
    if inertial is not None:
        frame = origin_of(inertial)
        mass, center = _number(inertial.find("mass"), "value"), frame.position
        xx, xy, xz, yy, yz, zz = (
            _number(inertial.find("inertia"), name) for name in NUMBER_ATTRIBUTES["inertia"]
        )
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        inertia = frame.rotation @ inertia @ frame.rotation.T
    return FileBody(
        name=str(link.get("name")),
        parent=parent,
        placement=IN_PLACE if joint is None else origin_of(joint),
        joints=motions,
        mass=mass,
        center=center,
        inertia=inertia,
    )


def _motions(
    path: str, joint: ET.Element, types: dict[str, str], extensions: Extensions
) -> Iterator[FileJoint]:
    """Yield the motions of a joint: one, none of a fixed joint, or several, such as of a planar joint.

    Args:
        path: path of the file.
        joint: element of the joint.
        types: types of joints in the loop file, by name of the joint.
        extensions: springs, dampers and rotors that tools add to joints.
    """
    kind, name = str(joint.get("type")), str(joint.get("name"))
    kind = types.get(name, kind)
    if kind == "SPHERICAL":
        yield FileJoint(name, JointKind.BALL, axis=np.zeros(3), point=np.zeros(3))
    elif kind in UNIVERSAL:
        for letter in UNIVERSAL[kind]:
            axis = np.eye(3)["XYZ".index(letter)]
            yield FileJoint(f"{name}_{letter}", JointKind.HINGE, axis, point=np.zeros(3))
    elif kind == "planar":
        # the format defines no limits of a planar joint; as in MuJoCo, they bound its first motion
        for letter, axis in zip("xyz", axes_of_plane(_axis(path, joint)), strict=True):
            motion = JointKind.HINGE if letter == "z" else JointKind.SLIDE
            yield _single_motion(joint, f"{name}_{letter}", motion, axis, extensions, limited=letter == "x")
    elif kind in JOINT_KINDS:
        axis = np.zeros(3) if kind == "floating" else _axis(path, joint)
        yield _single_motion(joint, name, JOINT_KINDS[kind], axis, extensions)


def _single_motion(
    joint: ET.Element,
    name: str,
    kind: JointKind,
    axis: Array,
    extensions: Extensions,
    limited: bool = True,
) -> FileJoint:
    """Describe one motion of a joint, with the damping, friction and limits of the joint.

    Args:
        joint: element of the joint.
        name: name of the motion.
        kind: kind of the motion.
        axis: (3,) unit vector in the frame of the joint; zeros for a free joint.
        extensions: springs, dampers and rotors that tools add to joints.
        limited: whether the limits of the joint are those of this motion.
    """
    dynamics, limit = joint.find("dynamics"), joint.find("limit") if limited else None
    has_range = limit is not None and joint.get("type") in ("revolute", "prismatic", "planar")
    in_file = str(joint.get("name"))
    stiffness, rest = extensions.springs.get(in_file, (0.0, 0.0))
    effort = _limit(limit, "effort", math.inf)
    return FileJoint(
        name,
        kind,
        axis,
        point=np.zeros(3),
        damping=_number(dynamics, "damping") + extensions.dampings.get(in_file, 0.0),
        armature=extensions.armatures.get(in_file, 0.0),
        friction=_number(dynamics, "friction"),
        stiffness=stiffness,
        rest=rest,
        limits=(_limit(limit, "lower"), _limit(limit, "upper")) if has_range else (-math.inf, math.inf),
        effort=(-effort, effort),
        speed=_limit(limit, "velocity", math.inf),
    )


def _axis(path: str, joint: ET.Element) -> Array:
    """Return the unit vector (3,) of a joint's axis in the frame of the joint."""
    axis = axis_vector(joint)
    length = np.linalg.norm(axis)
    if not length:
        raise SourceError(path, f"joint {joint.get('name')!r}: its axis is 0 0 0; needed: a direction")
    return axis / length


def _mimics(joints: list[ET.Element]) -> Iterator[FileCoupling]:
    """Yield the couplings of joints that mimic others; a fixed joint follows none, and stays at zero."""
    moving = {str(joint.get("name")) for joint in joints if joint.get("type") in JOINT_KINDS}
    for joint in joints:
        mimic, name = joint.find("mimic"), str(joint.get("name"))
        if mimic is not None and name in moving:
            powers = (_number(mimic, "offset"), _number(mimic, "multiplier", 1.0))
            leader = str(mimic.get("joint"))
            is_led = leader in moving
            yield FileCoupling(name, name, leader if is_led else "", powers if is_led else powers[:1])


def _coupled(loops: Loops, notes: list[str]) -> Iterator[FileCoupling]:
    """Yield the couplings of two joints in a loop file; others become notes.

    The sum of the polynomials of both joints is zero, and one of them has the first power only.
    """
    for number, polynomials in enumerate(loops.coupled, start=1):
        linear = [name for name, factors in polynomials.items() if not any(factors[1:]) and factors[0]]
        if len(polynomials) != 2 or not linear:
            notes.append(f"coupling of joints {', '.join(polynomials)} is not described")
            continue
        follower = linear[0]
        (leader,) = polynomials.keys() - {follower}
        powers = (-factor / polynomials[follower][0] for factor in polynomials[leader])
        yield FileCoupling(f"coupling_{number}", follower, leader, (0.0, *powers))


def _loops(robot: Robot, root: ET.Element, extensions: Extensions, loops: Loops) -> Iterator[FileLoop]:
    """Yield the loops of a loop file and of elements that tools add to a URDF.

    Args:
        robot: robot without loops.
        root: root element of the URDF.
        extensions: elements that tools add; its text has a link at each end of their loops.
        loops: content of the loop file.
    """
    all_loops = extensions.added_to(loops)
    if not all_loops.closed_loop:
        return
    numbers = {body.name: number for number, body in enumerate(robot.bodies)}
    # link and placement of each named frame: links, joints, and the links that `extensions` adds
    frames = {body.name: (numbers[body.name], IN_PLACE) for body in robot.bodies}
    for joint in root.findall("joint"):
        frames.setdefault(str(joint.get("name")), (numbers[_link_of(joint, "child")], IN_PLACE))
    if extensions.closed_loop:
        for joint in xml_tree(extensions.text).findall("joint"):
            added = _link_of(joint, "child")
            if added not in numbers:
                frames[added] = numbers[_link_of(joint, "parent")], origin_of(joint)
    placements = robot.placements()
    for pair, kind in zip(all_loops.closed_loop, all_loops.type, strict=True):
        for name in pair:
            if name not in frames:
                raise LoopFileError(loops.source, "closed_loop", f"the URDF has no link or joint {name!r}")
        (first, first_frame), (second, second_frame) = (frames[name] for name in pair)
        ends = placements[first] @ first_frame, placements[second] @ second_frame
        length = float(np.linalg.norm(ends[1].position - ends[0].position)) if kind == "rod" else 0.0
        first_name, second_name = (name.rpartition("_on_")[0] for name in pair)
        # frames that `urdf.write` and `extensions` add are named "<loop>_on_<link>"
        name = first_name if first_name and first_name == second_name else " ".join(pair)
        yield FileLoop(name, LOOP_KINDS[kind], first, second, first_frame, second_frame, length)


def _number(element: ET.Element | None, name: str, default: float = 0.0) -> float:
    """Return the number of an attribute; the default if the element or the attribute is missing."""
    return default if element is None else float(element.get(name, default))


def _limit(element: ET.Element | None, name: str, default: float = 0.0) -> float:
    """Return a limit of a joint, infinite if the number stands for no limit; see `_number`."""
    return finite_or_infinite(_number(element, name, default))


def _vector(element: ET.Element, name: str) -> Array:
    """Return the three numbers (3,) of an attribute; zeros if the attribute is missing."""
    return np.array([float(number) for number in element.get(name, "0 0 0").split()])


def origin_of(element: ET.Element) -> Placement:
    """Return the placement that the `<origin>` of an element gives; none means the frame of the parent."""
    origin = element.find("origin")
    if origin is None:
        return IN_PLACE
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
