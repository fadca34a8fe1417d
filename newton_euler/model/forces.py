"""Forces: springs and dampers at joints and between points, constant wrenches, and inertias of rotors.

Points are given in the world at the mechanism's initial pose, like those of joints, and move with
their bodies. What a force is at a state is worked out here over generic scalars (Nikravesh,
Computer-Aided Analysis of Mechanical Systems, 1988, chapter 9, for the elements between two points);
for what all of a scene do together see `newton_euler.equations.applied_forces`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Literal, NamedTuple

import numpy as np

from newton_euler.errors import (
    MechanismError,
    check_key,
    check_texts,
    is_finite_number,
    set_arrays,
    set_numbers,
)
from newton_euler.model.constraints import Frame
from newton_euler.model.joint import Key, Pose
from newton_euler.model.mechanism import CLOSURE_TOLERANCE, Mechanism, check_coordinate, check_name
from newton_euler.scalars import Array, Scalar, cross, sqrt


@dataclass(frozen=True)
class JointSpring:
    """A spring and damper on a joint's hinge or slide: -(k (x - rest) + d dx/dt), N or N m.

    The joint need not be actuated; damping alone is viscous friction.

    Attributes:
        joint: name of the joint it acts on.
        stiffness: k in N/m or N m/rad, 0 or more.
        damping: d in N s/m or N m s/rad, 0 or more.
        rest: joint coordinate without spring force, m or rad from the initial pose.
        coordinate: which of the joint's coordinates, from 0.

    Raises:
        MechanismError: naming the joint and the value at fault.
    """

    joint: str
    stiffness: float = 0.0
    damping: float = 0.0
    rest: float = 0.0
    coordinate: int = 0

    parameters: ClassVar[tuple[str, ...]] = ("stiffness", "damping", "rest")

    def __post_init__(self) -> None:
        set_numbers(self, self.element, ("stiffness", "damping"), 0.0)
        set_numbers(self, self.element, ("rest",))
        check_key(self.element, self.joint, self.coordinate)

    @property
    def element(self) -> str:
        """What errors call it."""
        return f"spring of joint {self.joint!r}"

    def check(self, mechanism: Mechanism) -> None:
        """Raise `MechanismError` unless the mechanism has its joint coordinate."""
        check_known(self.element, "acts on an unknown joint", self.joint, mechanism.joint_names)
        joint = mechanism.joint(self.joint)
        check_coordinate(self.element, joint, self.coordinate)

    def force(self, x: Scalar, x_rate: Scalar, time: Scalar) -> Scalar:
        """The generalized force (N or N m) at coordinate x (m or rad) and its rate, at any time."""
        return -(self.stiffness * (x - self.rest) + self.damping * x_rate)

    def power(self, x: Scalar, x_rate: Scalar, time: Scalar) -> Scalar:
        """Power of the damper, W."""
        return -self.damping * (x_rate * x_rate)

    def energy(self, x: Scalar) -> Scalar:
        """Energy of the spring, J."""
        return 0.5 * self.stiffness * ((x - self.rest) * (x - self.rest))


@dataclass(frozen=True, eq=False)
class BallSpring:
    """A torsion spring and damper on a joint's ball, the same about all axes: -(k theta + d omega), N m.

    theta is the rotation vector of the second body against the first, from where the spring rests, and
    omega their relative angular velocity; the torque is that on the second body. theta is below half a
    turn: there the torque of a spring jumps to the other side.

    Attributes:
        joint: name of the joint it acts on.
        stiffness: k in N m/rad, 0 or more.
        damping: d in N m s/rad, 0 or more.
        rest: (3,) rotation vector of the second body against the first where the spring rests, rad from
            the initial pose, in the world's axes there.

    Raises:
        MechanismError: naming the joint and the value at fault.
    """

    joint: str
    stiffness: float = 0.0
    damping: float = 0.0
    rest: Array = (0.0, 0.0, 0.0)  # type: ignore[assignment]

    parameters: ClassVar[tuple[str, ...]] = ("stiffness", "damping", "rest")

    def __post_init__(self) -> None:
        check_texts(self.element, self, "joint")
        set_numbers(self, self.element, ("stiffness", "damping"), 0.0)
        set_arrays(self, self.element, rest=(3,))

    @property
    def element(self) -> str:
        """What errors call it."""
        return f"spring of the ball of joint {self.joint!r}"

    def check(self, mechanism: Mechanism) -> None:
        """Raise `MechanismError` unless the mechanism has its joint, with a ball."""
        check_ball(self.element, self.joint, mechanism)

    def torque(self, theta: Array, omega: Array) -> Array:
        """(3,) N m on the second body at a turn theta (3,) rad and its rate omega (3,) rad/s."""
        return -(self.stiffness * theta + self.damping * omega)

    def power(self, omega: Array) -> Scalar:
        """Power of the damper, W."""
        return -self.damping * (omega @ omega)

    def energy(self, theta: Array) -> Scalar:
        """Energy of the spring, J."""
        return 0.5 * self.stiffness * (theta @ theta)


@dataclass(frozen=True, eq=False)
class PointSpring:
    """A spring and damper between points of two bodies; tension k (l - l0) + d dl/dt along their line.

    Attributes:
        name: unique among the forces of a scene; letters, digits, `_`, `.` and `-`.
        first, second: names of the two bodies.
        point_on_first, point_on_second: (3,) in the world at the initial pose, m.
        stiffness: k in N/m, 0 or more.
        rest_length: l0 in m, 0 or more.
        damping: d in N s/m, 0 or more.

    Raises:
        MechanismError: naming the spring and the value at fault.
    """

    name: str
    first: str
    second: str
    point_on_first: Array
    point_on_second: Array
    stiffness: float = field(kw_only=True)
    rest_length: float = field(kw_only=True)
    damping: float = field(default=0.0, kw_only=True)

    parameters: ClassVar[tuple[str, ...]] = ("stiffness", "rest_length", "damping")

    def __post_init__(self) -> None:
        check_name("point spring", self.name)
        check_texts(self.element, self, "first", "second")
        set_arrays(self, self.element, point_on_first=(3,), point_on_second=(3,))
        set_numbers(self, self.element, self.parameters, 0.0)

    @property
    def element(self) -> str:
        """What errors call it."""
        return f"point spring {self.name!r}"

    def check(self, mechanism: Mechanism) -> None:
        """Raise `MechanismError` unless the mechanism has its two bodies."""
        for body in (self.first, self.second):
            check_known(self.element, "acts on an unknown body", body, mechanism.body_names)
        if self.first == self.second:
            raise MechanismError(self.element, f"connects {self.first!r} to itself", "two bodies")

    @property
    def has_direction(self) -> bool:
        """Whether it needs its line; a spring of rest length 0 pulls in proportion to the distance."""
        return not (self.rest_length == 0.0 and self.damping == 0.0)

    def check_apart(self, mechanism: Mechanism, frames: Sequence[Frame]) -> None:
        """Raise `MechanismError` if it has no direction where bodies with these frames are."""
        poses = [body.pose for body in mechanism.bodies]
        d = line_of(self, mechanism, poses, frames).d
        if self.has_direction and np.linalg.norm(d) <= CLOSURE_TOLERANCE:
            raise MechanismError(
                self.element,
                "its points coincide in the initial state",
                "points apart, or a spring of rest_length 0 without damping",
            )


@dataclass(frozen=True, eq=False)
class Wrench:
    """A constant force at a point of a body and a constant torque, constant in the world or the body.

    Attributes:
        name: unique among the forces of a scene; letters, digits, `_`, `.` and `-`.
        body: name of the body they act on; not the ground.
        point: (3,) in the world at the initial pose, m; it moves with the body.
        force: (3,) N, world components at the initial pose.
        torque: (3,) N m, world components at the initial pose.
        frame: "world", or "body" for a force and a torque that turn with the body.

    Raises:
        MechanismError: naming the wrench and the value at fault.
    """

    name: str
    body: str
    point: Array
    force: Array = (0.0, 0.0, 0.0)  # type: ignore[assignment]
    torque: Array = (0.0, 0.0, 0.0)  # type: ignore[assignment]
    frame: Literal["world", "body"] = "world"

    parameters: ClassVar[tuple[str, ...]] = ("force", "torque")

    def __post_init__(self) -> None:
        check_name("wrench", self.name)
        check_texts(self.element, self, "body")
        set_arrays(self, self.element, point=(3,), force=(3,), torque=(3,))
        if not isinstance(self.frame, str) or self.frame not in ("world", "body"):
            raise MechanismError(self.element, f"frame is {self.frame!r}", "'world' or 'body'")

    @property
    def element(self) -> str:
        """What errors call it."""
        return f"wrench {self.name!r}"

    def check(self, mechanism: Mechanism) -> None:
        """Raise `MechanismError` unless the mechanism has its body, a moving one."""
        check_known(self.element, "acts on an unknown body", self.body, mechanism.body_names)
        if mechanism.body_index(self.body) == 0:
            raise MechanismError(self.element, f"acts on the ground {self.body!r}", "a body that moves")


Force = JointSpring | BallSpring | PointSpring | Wrench


def check_known(element: str, problem: str, name: str, known: Sequence[str]) -> None:
    """Raise `MechanismError` with a problem, and the name, unless that is among the known ones."""
    if name not in known:
        raise MechanismError(element, f"{problem} {name!r:.100}", f"one of {', '.join(known)}")


def check_ball(element: str, joint: str, mechanism: Mechanism) -> None:
    """Raise `MechanismError` unless the mechanism has a joint of that name, and that a ball."""
    check_known(element, "is on an unknown joint", joint, mechanism.joint_names)
    found = mechanism.joint(joint)
    if not any(motion.kind == "ball" for motion in found.motions):
        needed = "a joint with a ball: spherical, free, or compound with one"
        raise MechanismError(element, f"is on a {found.kind} joint", needed)


class Line(NamedTuple):
    """The two points of a spring at a state; world frame."""

    first: int
    second: int
    s_i: Array
    """(3,) from the first body's centre of mass to its point, m."""
    s_j: Array
    d: Array
    """(3,) from the first point to the second, m."""
    rate: Array
    """(3,) of d, m/s."""


def line_of(
    spring: PointSpring, mechanism: Mechanism, poses: Sequence[Pose], frames: Sequence[Frame]
) -> Line:
    """The two points of a spring where bodies have these frames; `poses` are the frames' initial ones."""
    i, j = mechanism.body_index(spring.first), mechanism.body_index(spring.second)
    s_i = frames[i].rotation @ poses[i].point_to_body(spring.point_on_first)
    s_j = frames[j].rotation @ poses[j].point_to_body(spring.point_on_second)
    d = frames[j].position + s_j - frames[i].position - s_i
    rate = (
        frames[j].velocity
        + cross(frames[j].angular_velocity, s_j)
        - frames[i].velocity
        - cross(frames[i].angular_velocity, s_i)
    )
    return Line(i, j, s_i, s_j, d, rate)


def pull_along(spring: PointSpring, line: Line) -> Array:
    """(3,) N, what the spring does to the first body's point; the opposite acts on the second's."""
    if not spring.has_direction:
        return np.asarray(spring.stiffness * line.d)
    length = sqrt(line.d @ line.d)
    along = line.d / length
    tension = spring.stiffness * (length - spring.rest_length) + spring.damping * (along @ line.rate)
    return np.asarray(tension * along)


def wrench_at(wrench: Wrench, body: int, poses: Sequence[Pose], frames: Sequence[Frame]) -> tuple[Array, ...]:
    """Force, torque and arm of its point (3,) each, world frame."""
    pose, frame = poses[body], frames[body]
    arm = frame.rotation @ pose.point_to_body(wrench.point)
    if wrench.frame == "world":
        return wrench.force, wrench.torque, arm
    force, torque = pose.vector_to_body(wrench.force), pose.vector_to_body(wrench.torque)
    return frame.rotation @ force, frame.rotation @ torque, arm


def _identity(force: Force) -> str:
    """What no two forces of a scene may have in common."""
    if isinstance(force, JointSpring):
        return f"spring of coordinate {force.coordinate} of joint {force.joint!r}"
    if isinstance(force, BallSpring):
        return force.element
    return f"force {force.name!r}"


def check_forces(forces: Sequence[Force], mechanism: Mechanism) -> None:
    """Check forces against a mechanism.

    Raises:
        MechanismError: naming the force at fault.
    """
    for force in forces:
        force.check(mechanism)
    for element, count in Counter(map(_identity, forces)).items():
        if count > 1:
            needed = "unique names, and one spring a joint coordinate or ball"
            raise MechanismError(element, f"{count} of that name", needed)


@dataclass(frozen=True)
class Armature:
    """The inertia of a rotor that a joint coordinate turns through a gear, reflected to the joint.

    It is a generalized force -a d2x/dt2 on a joint's hinge or slide x, and kinetic energy 1/2 a (dx/dt)^2:
    a on the diagonal of the mass matrix in joint coordinates. The rotor itself is no body of the mechanism:
    of its motion only the spin about its axis is taken into account, which is what a large gear ratio makes
    large (Featherstone, Rigid Body Dynamics Algorithms, 2008, chapter 9, on gears).

    Attributes:
        joint: name of the joint.
        inertia: a in kg m^2 or kg, positive.
        coordinate: which of the joint's coordinates, from 0.

    Raises:
        MechanismError: naming the joint and the value at fault.
    """

    joint: str
    inertia: float
    coordinate: int = 0

    parameters: ClassVar[tuple[str, ...]] = ("inertia",)

    def __post_init__(self) -> None:
        _set_inertia(self)
        check_key(self.element, self.joint, self.coordinate)

    @property
    def element(self) -> str:
        """What errors call it."""
        return f"armature of joint {self.joint!r}"

    @property
    def key(self) -> Key:
        """The joint coordinate that it is on."""
        return self.joint, self.coordinate


@dataclass(frozen=True)
class BallArmature:
    """A rotor inertia on a joint's ball, the same about all axes: kinetic energy 1/2 a |omega|^2.

    omega is the angular velocity of the joint's second body against the first. The torque on the second
    body is -a times the rate of omega as either body sees it, alpha_2 - alpha_1 + omega_2 x omega_1.

    Attributes:
        joint: name of the joint.
        inertia: a in kg m^2, positive.

    Raises:
        MechanismError: naming the joint and the value at fault.
    """

    joint: str
    inertia: float

    parameters: ClassVar[tuple[str, ...]] = ("inertia",)

    def __post_init__(self) -> None:
        _set_inertia(self)
        check_texts(self.element, self, "joint")

    @property
    def element(self) -> str:
        """What errors call it."""
        return f"armature of the ball of joint {self.joint!r}"


def _set_inertia(armature: Armature | BallArmature) -> None:
    inertia = armature.inertia
    if not is_finite_number(inertia) or inertia <= 0.0:
        raise MechanismError(armature.element, f"inertia is {inertia!r:.100}", "a positive finite number")
    object.__setattr__(armature, "inertia", float(inertia))


def check_armatures(armatures: Sequence[Armature | BallArmature], mechanism: Mechanism) -> None:
    """Raise `MechanismError` unless the mechanism has the joint coordinates and balls, each once."""
    for armature in armatures:
        if isinstance(armature, BallArmature):
            check_ball(armature.element, armature.joint, mechanism)
        else:
            check_known(armature.element, "is on an unknown joint", armature.joint, mechanism.joint_names)
            joint = mechanism.joint(armature.joint)
            check_coordinate(armature.element, joint, armature.coordinate)
    for element, count in Counter(map(_rotor_identity, armatures)).items():
        if count > 1:
            raise MechanismError(element, f"{count} for one coordinate", "one a coordinate or ball")


def _rotor_identity(armature: Armature | BallArmature) -> str:
    """What no two armatures of a scene may have in common."""
    if isinstance(armature, BallArmature):
        return armature.element
    return f"armature of coordinate {armature.coordinate} of joint {armature.joint!r}"
