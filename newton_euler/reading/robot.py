"""Description of a robot in the terms of its model file: bodies, joints, loops, couplings, drives, springs.

Readers of file formats make a `Robot` without the checks and the simplifications of an import: bodies that
are fixed to each other stay apart, frames and zeros are those of the file. `crosscheck diff` compares two.
The number of digits in the file limits what a comparison can tell: a `RobotFile` has the robot as it is
written, and the same robot read from texts whose numbers are changed by half a unit of their last digit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from newton_euler.model.source_file import SourceLine
from newton_euler.scalars import Array


class Placement(NamedTuple):
    """Position and orientation of a frame in another frame.

    Attributes:
        position: (3,) m, origin of the frame.
        rotation: (3, 3) matrix whose columns are the axes of the frame; it takes components along them to
            components in the other frame.
    """

    position: Array
    rotation: Array

    def __matmul__(self, inner: Placement) -> Placement:
        """Return where a frame inside this frame is in the other frame."""
        return Placement(self.point(inner.position), self.rotation @ inner.rotation)

    def point(self, point: Array) -> Array:
        """Return where a point (3,), m, of this frame is in the other frame."""
        return np.asarray(self.position + self.rotation @ point)

    def inverse(self) -> Placement:
        """Return where the other frame is in this frame."""
        return Placement(-self.rotation.T @ self.position, self.rotation.T)


IN_PLACE = Placement(np.zeros(3), np.eye(3))
"""Placement of a frame that coincides with the other frame."""


class JointKind(StrEnum):
    """Motion that a joint of a model file allows."""

    HINGE = "hinge"
    """Rotation about the axis."""
    SLIDE = "slide"
    """Translation along the axis."""
    BALL = "ball"
    """Rotation about the point."""
    FREE = "free"
    """Any motion; the body is not held by its parent."""


class LoopKind(StrEnum):
    """Constraint between two bodies that closes a loop of a model file."""

    POINT = "point"
    """The two points coincide."""
    WELD = "weld"
    """The two points and the axes of the two frames coincide."""
    HINGE = "hinge"
    """The two points coincide, and the x axes of the two frames are parallel."""
    SLIDE = "slide"
    """One body moves along the x axis of the first frame without rotation."""
    ROD = "rod"
    """The distance of the two points stays."""


@dataclass(frozen=True, eq=False)
class FileJoint:
    """Joint of a model file between a body and its parent.

    Attributes:
        name: name in the file; "" for a joint without name.
        kind: its motion.
        axis: (3,) unit vector of a hinge or slide, in the frame of its body; zeros for other kinds.
        point: (3,) m, a point of the axis or the center of a ball, in the frame of its body.
        zero: coordinate of a hinge or slide in the pose of the file, rad or m.
        damping: force per velocity, N s/m or N m s/rad.
        armature: inertia of the drive's rotor, seen at the joint, kg or kg m^2.
        friction: largest force of dry friction, N or N m.
        stiffness: of a spring at the joint, N/m or N m/rad.
        rest: coordinate at which the spring has no force, rad or m.
        limits: smallest and largest coordinate, rad or m, of a ball 0 and the largest angle; infinite without
            limit.
        effort: smallest and largest force or torque of all drives together, N or N m; infinite without limit.
        speed: largest velocity, m/s or rad/s; infinite without limit.
    """

    name: str
    kind: JointKind
    axis: Array
    point: Array
    zero: float = 0.0
    damping: float = 0.0
    armature: float = 0.0
    friction: float = 0.0
    stiffness: float = 0.0
    rest: float = 0.0
    limits: tuple[float, float] = (-math.inf, math.inf)
    effort: tuple[float, float] = (-math.inf, math.inf)
    speed: float = math.inf


@dataclass(frozen=True, eq=False)
class FileBody:
    """Body of a model file.

    Attributes:
        name: name in the file.
        parent: index of the parent in `Robot.bodies`; -1 for the ground.
        placement: of the body's frame in the frame of its parent, all joints in the pose of the file.
        joints: joints between parent and body, the first one next to the parent; none for a fixed body.
        mass: kg.
        center: (3,) m, center of mass in the body's frame.
        inertia: (3, 3) kg m^2 about the center of mass, along the axes of the body's frame.
    """

    name: str
    parent: int
    placement: Placement
    joints: tuple[FileJoint, ...]
    mass: float
    center: Array
    inertia: Array

    @property
    def joint_point(self) -> Array:
        """Point (3,), m, of the first joint in the body's frame; the origin of a fixed body."""
        return self.joints[0].point if self.joints else np.zeros(3)


@dataclass(frozen=True, eq=False)
class FileLoop:
    """Constraint of a model file that closes a loop.

    Attributes:
        name: name in the file.
        kind: kind of the constraint.
        first, second: indices of the two bodies in `Robot.bodies`; -1 for the ground.
        first_frame, second_frame: frame of the constraint in the frame of each body. Its rotation counts for
            welds, hinges and slides.
        length: distance of the points of a rod, m; 0 for other kinds.
    """

    name: str
    kind: LoopKind
    first: int
    second: int
    first_frame: Placement
    second_frame: Placement
    length: float = 0.0


@dataclass(frozen=True, eq=False)
class FileSpring:
    """Spring and damper of a model file along the line between points of two bodies.

    Attributes:
        name: name in the file.
        first, second: indices of the two bodies in `Robot.bodies`; -1 for the ground.
        first_frame, second_frame: frame at the point in the frame of each body. Its rotation does not count.
        stiffness: force per length, N/m.
        damping: force per rate of the length, N s/m.
        rest: smallest and largest length at which the spring has no force, m.
    """

    name: str
    first: int
    second: int
    first_frame: Placement
    second_frame: Placement
    stiffness: float = 0.0
    damping: float = 0.0
    rest: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, eq=False)
class FileCoupling:
    """Coupling of a joint coordinate to another one, such as a mimic joint or a gear.

    Attributes:
        name: name in the file.
        follower: name of the joint that follows.
        leader: name of the joint that it follows; "" if the coupling holds the follower at a value.
        powers: coefficients of the powers 0, 1, 2 ... of the leader's coordinate, from its zero, in the
            follower's coordinate, from its zero.
    """

    name: str
    follower: str
    leader: str
    powers: tuple[float, ...]


class PlaceKind(StrEnum):
    """Part of a frame that counts."""

    POINT = "point"
    """The origin."""
    LINE = "line"
    """The line of the z axis; neither its direction nor the place of the origin on it."""
    DIRECTION = "direction"
    """The direction of the z axis."""
    FRAME = "frame"
    """The origin and all axes."""


@dataclass(frozen=True, eq=False)
class FilePlace:
    """Frame of a model file that is fixed to a body, such as a site.

    Attributes:
        kind: what counts of the frame.
        body: index of the body in `Robot.bodies`; -1 for the ground.
        frame: the frame in the frame of the body.
    """

    kind: PlaceKind
    body: int
    frame: Placement


@dataclass(frozen=True, eq=False)
class FileDrive:
    """Actuator of a model file.

    Attributes:
        name: name in the file.
        gears: force on each joint per unit of the actuator's force, by name of the joint. An actuator that
            acts on a body instead of joints has none.
        gain: force of the actuator per unit of its control.
        stiffness: force of the actuator per length of the actuator, negative for a position servo: -kp.
        damping: force of the actuator per velocity of the actuator, negative for a damping servo: -kv.
        constant: force of the actuator without control, at length zero.
        control_limits: smallest and largest control; infinite without limit.
        force_limits: smallest and largest force of the actuator; infinite without limit.
        other: what else the file says of the actuator, such as activation dynamics, by name.
    """

    name: str
    gears: Mapping[str, float]
    gain: float
    stiffness: float = 0.0
    damping: float = 0.0
    constant: float = 0.0
    control_limits: tuple[float, float] = (-math.inf, math.inf)
    force_limits: tuple[float, float] = (-math.inf, math.inf)
    other: Mapping[str, float | str | FilePlace] = field(default_factory=dict)

    @property
    def is_modeled(self) -> bool:
        """True if the force follows from gears, gain, stiffness and damping; that of a muscle does not."""
        return bool(self.gears) and not self.other.keys() & {"gain type", "bias type"}


class TransmissionEnd(NamedTuple):
    """Joint or actuator of a transmission.

    Attributes:
        name: name in the file.
        reduction: mechanical reduction at this end; the text of the file if it is no number.
        offset: of the coordinate, rad or m; the text of the file if it is no number.
        interfaces: hardware interfaces of a joint and of its actuators.
    """

    name: str
    reduction: float | str = 1.0
    offset: float | str = 0.0
    interfaces: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class FileTransmission:
    """Transmission of a URDF, from actuators to joints, which controllers read and engines ignore.

    Attributes:
        name: name in the file; "" for a transmission without name.
        kind: its type in the file; "" without one.
        joints: its joints.
        actuators: its actuators, in the order of the joints.
        reduction: mechanical reduction of the whole; the text of the file if it is no number.
    """

    name: str
    kind: str
    joints: tuple[TransmissionEnd, ...]
    actuators: tuple[TransmissionEnd, ...]
    reduction: float | str = 1.0


@dataclass(frozen=True, eq=False)
class FileStart:
    """Named start of runs in a model file, such as a keyframe.

    Attributes:
        name: name in the file.
        coordinates: of the hinges and slides, rad or m, by name of the joint.
        velocities: of the hinges and slides, rad/s or m/s, by name of the joint.
    """

    name: str
    coordinates: Mapping[str, float]
    velocities: Mapping[str, float]


class Setting(NamedTuple):
    """Name of a number or a word of a model file for which the description of a robot has no model.

    Attributes:
        element_kind: kind of the element, such as "tendon", in the terms of the file.
        element: name of the element; "" for the whole model.
        name: what the number is, such as "range".
        exerts: whether it makes forces that are in no other part of the description.
        joint: name of the joint that the number is about, such as that of a coefficient of a tendon; ""
            without one.
    """

    element_kind: str
    element: str
    name: str
    exerts: bool = False
    joint: str = ""

    @property
    def words(self) -> str:
        """Name of the number with that of the joint, such as "coefficient of 'elbow'"."""
        return f"{self.name} of {self.joint!r}" if self.joint else self.name


SettingValue = tuple[float, ...] | str | FilePlace
"""Numbers, a word or a place of a model file."""

PRESCRIBED_MOTION = "prescribed motion"
"""Name of the setting of a joint coordinate whose motion a scene prescribes."""


@dataclass(frozen=True, eq=False)
class Robot:
    """A robot as its file describes it.

    Attributes:
        name: name of the model in the file.
        bodies: bodies; a parent comes before its children.
        loops: constraints that close loops.
        couplings: couplings of joint coordinates.
        drives: actuators.
        gravity: (3,) m/s^2; None if the format has none, as URDF.
        time_step: s, of the runs that the file asks for; None if the format has none.
        integrator: name of the integrator of such runs; "" if the format has none.
        springs: springs and dampers between points.
        starts: named starts of runs.
        settings: numbers of the file that are in none of the above, such as the range of a tendon.
        transmissions: transmissions for controllers, which do not change the robot's motion.
    """

    name: str
    bodies: tuple[FileBody, ...]
    loops: tuple[FileLoop, ...] = ()
    couplings: tuple[FileCoupling, ...] = ()
    drives: tuple[FileDrive, ...] = ()
    gravity: Array | None = None
    time_step: float | None = None
    integrator: str = ""
    springs: tuple[FileSpring, ...] = ()
    starts: tuple[FileStart, ...] = ()
    settings: Mapping[Setting, SettingValue] = field(default_factory=dict)
    transmissions: tuple[FileTransmission, ...] = ()

    def joint(self, key: tuple[int, int]) -> FileJoint:
        """Return a joint by the index of its body and its own index in `FileBody.joints`."""
        return self.bodies[key[0]].joints[key[1]]

    @property
    def unmodeled(self) -> tuple[str, ...]:
        """Names of forces that the description has no model for, such as "gravcomp of body 'hand'"."""
        of_settings = (
            f"{key.name} of {key.element_kind} {key.element!r}" if key.element else key.name
            for key in self.settings
            if key.exerts
        )
        of_drives = (f"drive {drive.name!r}" for drive in self.drives if not drive.is_modeled)
        return (*of_settings, *of_drives)

    @property
    def prescribed(self) -> tuple[str, ...]:
        """Names of joint coordinates whose motion is prescribed. The description lets them move freely."""
        return tuple(key.element for key in self.settings if key.name == PRESCRIBED_MOTION)

    def loop_name(self, loop: FileLoop | FileSpring) -> str:
        """Return the name of a loop or spring, or those of its bodies if it has no name."""
        ends = (self.bodies[body].name if body >= 0 else "the ground" for body in (loop.first, loop.second))
        return loop.name or " and ".join(ends)

    def placements(self) -> list[Placement]:
        """Return where the frame of each body is in the world, in the pose of the file."""
        found: list[Placement] = []
        for body in self.bodies:
            found.append((found[body.parent] if body.parent >= 0 else IN_PLACE) @ body.placement)
        return found


@dataclass(frozen=True, eq=False)
class RobotFile:
    """A robot and the uncertainty of its numbers.

    Attributes:
        robot: the robot as it is written.
        variants: the robot read from texts in which each number is changed by plus or minus half a unit of
            its last digit, at most of its sixth significant digit; the signs are random. Zeros and whole
            numbers are exact. Empty for a model without text, such as one in memory.
        source: path of the file; "" for a model in memory.
        format: "MJCF", "URDF", "scene file", or "Pinocchio" for its model in memory.
        lines: line of an element in the file, or in a file that it includes, by the tag and the name of the
            element, such as ("joint", "knee").
        notes: what the file has and the description has not, one sentence each.
        has_ground: whether a root without joints is known to be fixed. A URDF does not tell it from one that
            floats, unless its name is "world" or an option tells.
        missing_meshes: names of bodies without mass, because their masses come from meshes that are missing.
    """

    robot: Robot
    variants: tuple[Robot, ...] = ()
    source: str = ""
    format: str = ""
    lines: Mapping[tuple[str, str], SourceLine] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    has_ground: bool = True
    missing_meshes: tuple[str, ...] = ()

    @property
    def robots(self) -> tuple[Robot, ...]:
        """The robot as it is written, then its variants."""
        return (self.robot, *self.variants)
