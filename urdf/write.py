"""Write the mechanism of a scene (a mechanism with forces, control laws and state) as a URDF and a loop file.

The frame of a link has its origin at the joint to its parent, and is parallel to the world at the initial
pose. Therefore every rpy of joints and inertials is zero, no number is converted through an angle, and joint
coordinates are those of newton_euler's spanning tree. A joint of several motions becomes a chain of hinges
and slides through massless links. Joints have the limits of stops, without stiffness, and the Coulomb
friction of dry friction.

A URDF can describe neither closed loops nor ball joints. The loop file names frames that coincide and joints
that are balls. Its keys are those of Gepetto's example-parallel-robots
(https://github.com/Gepetto/example-parallel-robots, `robot.yaml`), with two additions: closures of type
`rod`, whose two points keep their distance at the start, and `coupled`, sums of polynomials of joint
coordinates that are zero. A loop is closed by a ball, a rod or a weld. At any other joint that closes a loop,
a body is cut into two halves, which a weld joins: the welded mechanism.
"""

from __future__ import annotations

import math
import os
from collections import defaultdict
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, assert_never
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np
import yaml

from newton_euler.arguments import checked
from newton_euler.equations.couplings import couplings
from newton_euler.model.euler_parameters import rotation
from newton_euler.model.forces import JointSpring
from newton_euler.model.geometry import Box, Capsule, Cylinder, Shape, Sphere
from newton_euler.model.joint import Joint, Motion
from newton_euler.model.joint_kinds import Fixed, Rod
from newton_euler.model.mechanism import Body
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import (
    TreeJoint,
    WeldedMechanism,
    coordinate_name,
    motion_names,
    weld_loops,
)
from newton_euler.model.switched_forces import JointFriction, JointStop
from newton_euler.model.written_file import atomic_file
from newton_euler.scalars import Array
from urdf.errors import NameClashError, UrdfError
from urdf.reading.source import NO_LIMIT

MATERIAL_COLORS = {
    "grey": (0.6, 0.6, 0.6),
    "orange": (0.9, 0.6, 0.0),
    "sky_blue": (0.35, 0.7, 0.9),
    "bluish_green": (0.0, 0.6, 0.5),
    "yellow": (0.95, 0.9, 0.25),
    "blue": (0.0, 0.45, 0.7),
    "vermilion": (0.8, 0.4, 0.0),
    "reddish_purple": (0.8, 0.6, 0.7),
}
"""Red, green and blue of materials that color-blind readers can distinguish.

Source: Okabe and Ito, Color Universal Design, 2008."""


INERTIA_ATTRIBUTES = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
"""Attributes of an element `<inertia>`: the upper triangle of the matrix, row by row."""

CLOSURE_TYPES_OF_JOINTS: dict[type[Joint], str] = {Fixed: "6d", Rod: "rod"}
"""Type of a loop closure in the loop file by class of joint; all other closing joints are balls, "3d"."""


@checked
def to_urdf(scene: Scene, keep_bodies: bool = False) -> str:
    """Return the mechanism of a scene as URDF text.

    Links have the names of bodies, joints the names of joints. The parts of a joint with several motions are
    `<joint>_1`, `<joint>_2`, ... from the first body to the second. Balls are revolute joints that the loop
    file replaces. The text includes the damping of joint springs, Coulomb friction and the limits of stops,
    which Pinocchio stores and does not use. The text does not include gravity, control, other forces,
    prescribed motions and the initial state.

    Args:
        scene: scene with the mechanism.
        keep_bodies: True to cut loops at fixed joints where possible, so that these joints are closures.
            Readers of the file merge the two bodies of other fixed joints; see `weld_loops`.

    Raises:
        NameClashError: if a part of a joint has the name of another joint or body.

    Examples:
        >>> '<robot name="pendulum">' in urdf.to_urdf(load("pendulum"))
        True
    """
    # loaded: never close a loop by a ball with a spring, damper or armature
    welded = weld_loops(scene.mechanism, keep_bodies, loaded=scene.loaded_balls)
    mechanism, tree = welded.mechanism, welded.tree
    robot = Element("robot", name=scene.name)
    add_materials(robot)
    # origin (3,) of each link at the initial pose, m, world frame: the point of the last motion of the joint
    # to its parent, or the point of a fixed joint, which has no motions
    origins = [np.zeros(3)] * len(mechanism.bodies)
    for tree_joint in tree.joints:
        points = tree_joint.points
        origins[tree_joint.child] = points[-1] if points else tree.joint(tree_joint.joint).point_on_second
    # links of bodies
    for index, body in enumerate(mechanism.bodies):
        link = SubElement(robot, "link", name=body.name)
        if index > 0:  # no inertia of the ground: readers warn of a root with mass
            rotation = tree.initial_rotations[
                index
            ]  # of the body frame; link frames are parallel to the world
            _add_inertial(link, body, body.center_of_mass - origins[index], rotation)
        if index < len(scene.mechanism.bodies):  # added halves of cut bodies have no shapes
            for shape in scene.mechanism.shapes(index):
                add_visual(link, shape, origins[index], color(index))
    # joints, and links of loop closures
    properties = _coordinate_properties(scene)
    for tree_joint in tree.joints:
        _add_chain(robot, welded, tree_joint, origins, properties)
    for ends in closures(welded):
        for frame, number, point in ends:
            SubElement(robot, "link", name=frame)
            parent, offset = mechanism.body_names[number], point - origins[number]
            _add_joint(robot, "fixed", f"{frame}_fixed", parent, frame, offset)

    _check_names(robot)
    indent(robot)
    return tostring(robot, encoding="unicode", xml_declaration=True) + "\n"


@checked
def to_loops(scene: Scene, keep_bodies: bool = False) -> str:
    """Return the text of the loop file, YAML, that belongs to `to_urdf(scene, keep_bodies)`.

    Examples:
        >>> "closed_loop" in urdf.to_loops(load("four_bar"))
        True
    """
    welded = weld_loops(scene.mechanism, keep_bodies, loaded=scene.loaded_balls)
    joints = welded.mechanism.joints
    # balls, and joints with motors
    balls, motors = [], []
    for tree_joint in welded.tree.joints:
        joint = welded.tree.joint(tree_joint.joint)
        for name, motion in zip(motion_names(joint, tree_joint.forward), tree_joint.motions, strict=True):
            if motion.kind == "ball":
                balls.append(name)
            elif joint.actuated:
                motors.append(name)
    # couplings, without prescribed motions: a factor, or a list of factors of the powers 1, 2, ...
    coupled = []
    for coupling in couplings(scene):
        if coupling.function is not None:  # a prescribed motion
            continue
        factors: dict[str, Any] = {}
        for key, factor in coupling.factors.items():
            joint_name, coordinate = key
            name = coordinate_name(scene.mechanism.joint(joint_name), coordinate)  # of the URDF joint
            higher_powers = coupling.powers.get(key)
            factors[name] = [factor, *higher_powers] if higher_powers else factor
        coupled.append(factors)
    closing_joints = [joints[k] for k in welded.tree.cuts]
    document: dict[str, Any] = {
        "closed_loop": [[frame for frame, _, _ in ends] for ends in closures(welded)],
        "type": [CLOSURE_TYPES_OF_JOINTS.get(type(joint), "3d") for joint in closing_joints],
        "name_mot": motors,
        "joint_name": balls,
        "joint_type": ["SPHERICAL"] * len(balls),
    }
    if coupled:
        document["coupled"] = coupled
    return str(yaml.safe_dump(document, default_flow_style=None, sort_keys=False, width=100))


@checked
def write(scene: Scene, path: str | os.PathLike[str]) -> None:
    """Write a URDF file, and the loop file `<stem>.loops.yaml` next to it.

    A failed write leaves no partial file. The path must end in .urdf.

    Raises:
        UrdfError: for another suffix, a path that cannot be written, or names that clash.

    Examples:
        >>> urdf.write(load("four_bar"), "output/four_bar.urdf")
    """
    if Path(path).suffix != ".urdf":
        raise UrdfError(f"cannot write {os.fspath(path)!r}; needed: a name that ends in .urdf")
    urdf_text, loop_text = to_urdf(scene, keep_bodies=True), to_loops(scene, keep_bodies=True)
    try:
        with atomic_file(path) as urdf_file, atomic_file(loops_path(path)) as loop_file:
            urdf_file.write_text(urdf_text, encoding="utf-8")
            loop_file.write_text(loop_text, encoding="utf-8")
    except OSError as error:
        raise UrdfError(f"cannot write {os.fspath(path)!r}: {error.strerror}") from error


def loops_path(path: str | os.PathLike[str]) -> Path:
    """Return the path of the loop file next to a URDF at `path`."""
    return Path(path).with_suffix(".loops.yaml")


def closures(welded: WeldedMechanism) -> list[list[tuple[str, int, Array]]]:
    """Return both ends of each loop closure: name of the frame, number of the body, and point (3,).

    Points are in m, world frame at the initial pose.
    """
    ends_of_closures = []
    for index in welded.tree.cuts:  # joints that close loops
        joint, equations = welded.mechanism.joints[index], welded.tree.equations(index)
        # `point` is the joint's point on the first body, `point_on_second` on the second
        ends = ((equations.first, joint.point), (equations.second, joint.point_on_second))
        names = welded.mechanism.body_names
        ends_of_closures.append([(f"{joint.name}_on_{names[body]}", body, point) for body, point in ends])
    return ends_of_closures


def _add_inertial(link: Element, body: Body, center: Array, rotation: Array) -> None:
    """Add mass, center of mass and inertia of a body to its link.

    Args:
        link: XML element of the link.
        body: body with the inertia in its own frame.
        center: (3,) center of mass in the frame of the link, m.
        rotation: (3, 3) from the frame of the body to the frame of the link.
    """
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "origin", xyz=numbers(center), rpy="0 0 0")
    SubElement(inertial, "mass", value=repr(body.mass))
    turned = rotation @ body.inertia @ rotation.T
    inertia = 0.5 * (turned + turned.T)
    entries = zip(INERTIA_ATTRIBUTES, inertia[np.triu_indices(3)].tolist(), strict=True)
    SubElement(inertial, "inertia", {name: repr(value + 0.0) for name, value in entries})


class CoordinateProperties(NamedTuple):
    """Damping, N s/m or N m s/rad, Coulomb friction, N or N m, and limits, m or rad, of a coordinate."""

    damping: float = 0.0
    friction: float = 0.0
    low: float = -NO_LIMIT
    high: float = NO_LIMIT


def _coordinate_properties(scene: Scene) -> dict[str, CoordinateProperties]:
    """Return the properties of joint coordinates by name of the URDF joint."""
    found = defaultdict[str, CoordinateProperties](CoordinateProperties)
    for force in scene.forces:
        if isinstance(force, JointSpring | JointFriction | JointStop):
            name = coordinate_name(scene.mechanism.joint(force.joint), force.coordinate)
            known = found[name]
            if isinstance(force, JointSpring):
                found[name] = known._replace(damping=known.damping + force.damping)
            elif isinstance(force, JointFriction):
                found[name] = known._replace(friction=force.coulomb)
            elif force.stiffness:  # a stop without stiffness exerts nothing
                found[name] = known._replace(**{force.side: force.limit})
    return found


def _add_chain(
    robot: Element,
    welded: WeldedMechanism,
    tree_joint: TreeJoint,
    origins: list[Array],
    properties: Mapping[str, CoordinateProperties],
) -> None:
    """Add a joint of the tree as a chain of URDF joints from parent to child, one for each motion.

    Args:
        robot: root element of the URDF.
        welded: welded mechanism.
        tree_joint: joint of the spanning tree.
        origins: (3,) origin of the link of each body at the initial pose, m, world frame.
        properties: friction, damping and limits by name of the URDF joint.
    """
    names, joint = welded.mechanism.body_names, welded.tree.joint(tree_joint.joint)
    parent, child = names[tree_joint.parent], names[tree_joint.child]
    origin = origins[tree_joint.parent]
    if not tree_joint.motions:
        _add_joint(robot, "fixed", joint.name, parent, child, origins[tree_joint.child] - origin)
    joint_names = motion_names(joint, tree_joint.forward)
    for name, motion, point in zip(joint_names, tree_joint.motions, tree_joint.points, strict=True):
        is_last = motion is tree_joint.motions[-1]
        link = child if is_last else f"{name}_link"
        if not is_last:
            SubElement(robot, "link", name=link)
        kind = "prismatic" if motion.kind == "slide" else "revolute"
        element = _add_joint(robot, kind, name, parent, link, point - origin)
        SubElement(element, "axis", xyz=numbers(_axis(motion)))
        # URDF requires all limits; most scenes have none
        limit, of_joint = repr(NO_LIMIT), properties.get(name, CoordinateProperties())
        low, high = repr(of_joint.low), repr(of_joint.high)
        SubElement(element, "limit", lower=low, upper=high, effort=limit, velocity=limit)
        dynamics = {"damping": of_joint.damping, "friction": of_joint.friction}
        if attributes := {key: repr(value) for key, value in dynamics.items() if value}:
            SubElement(element, "dynamics", attributes)
        parent, origin = link, point


def _axis(motion: Motion) -> Array:
    """Return the axis (3,) of a hinge or slide; for a ball, whose hinge is a placeholder, the z axis."""
    return np.array([0.0, 0.0, 1.0]) if motion.kind == "ball" else motion.axis


def _add_joint(robot: Element, kind: str, name: str, parent: str, child: str, offset: Array) -> Element:
    """Add a URDF joint with origin `offset` (3,), m, in the frame of the parent, and return its element."""
    joint = SubElement(robot, "joint", name=name, type=kind)
    SubElement(joint, "origin", xyz=numbers(offset), rpy="0 0 0")
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)
    return joint


def _check_names(robot: Element) -> None:
    """Raise `NameClashError` if two links or two joints have one name."""
    for what in ("link", "joint"):
        names = [str(element.get("name")) for element in robot.findall(what)]
        for name in names:
            if names.count(name) > 1:
                raise NameClashError(what, name)


def color(index: int) -> str:
    """Return the name of the material of body number `index`."""
    return list(MATERIAL_COLORS)[index % len(MATERIAL_COLORS)]


def add_materials(robot: Element) -> None:
    """Define all `MATERIAL_COLORS` as materials."""
    for name, rgb in MATERIAL_COLORS.items():
        material = SubElement(robot, "material", name=name)
        SubElement(material, "color", rgba=numbers((*rgb, 1.0)))


def add_visual(link: Element, shape: Shape, origin: Array, material: str) -> None:
    """Add a shape to a link whose frame is parallel to the world, with origin (3,), m, world frame.

    A capsule becomes a cylinder, because URDF has no capsules.
    """
    visual = SubElement(link, "visual")
    if isinstance(shape, Box):
        center, rpy = shape.center, roll_pitch_yaw(rotation(shape.quaternion))
    elif isinstance(shape, Sphere):
        center, rpy = shape.center, (0.0, 0.0, 0.0)
    elif isinstance(shape, Capsule | Cylinder):
        center, rpy = 0.5 * (shape.start + shape.end), _along(shape.end - shape.start)
    else:
        assert_never(shape)
    SubElement(visual, "origin", xyz=_rounded(center - origin), rpy=_rounded(rpy))
    geometry = SubElement(visual, "geometry")
    if isinstance(shape, Box):
        SubElement(geometry, "box", size=_rounded(2.0 * shape.half_sizes))
    elif isinstance(shape, Sphere):
        SubElement(geometry, "sphere", radius=_rounded([shape.radius]))
    elif isinstance(shape, Capsule | Cylinder):
        SubElement(geometry, "cylinder", radius=_rounded([shape.radius]), length=_rounded([shape.length]))
    SubElement(visual, "material", name=material)


def roll_pitch_yaw(matrix: Array) -> tuple[float, float, float]:
    """Return the angles of R = R_z(yaw) R_y(pitch) R_x(roll) (3, 3); roll is 0 at pitch 90 degrees."""
    cosine = math.hypot(matrix[0, 0], matrix[1, 0])
    pitch = math.atan2(-matrix[2, 0], cosine)
    if cosine < 1e-12:
        return 0.0, pitch, math.atan2(-matrix[0, 1], matrix[1, 1])
    return (
        math.atan2(matrix[2, 1], matrix[2, 2]),
        pitch,
        math.atan2(matrix[1, 0], matrix[0, 0]),
    )


def _along(direction: Array) -> tuple[float, float, float]:
    """Return roll, pitch and yaw that turn the z axis to a direction (3,)."""
    x, y, z = direction
    return 0.0, math.atan2(math.hypot(x, y), z), math.atan2(y, x)


def numbers(values: Iterable[float]) -> str:
    """Return numbers as a URDF attribute: the shortest texts that parse to the same doubles."""
    return " ".join(repr(float(value) + 0.0) for value in values)  # + 0.0 turns -0.0 into 0.0


def _rounded(values: Iterable[float]) -> str:
    """Return numbers of a shape as a URDF attribute, rounded to nine decimals."""
    return numbers(round(float(value), 9) for value in values)
