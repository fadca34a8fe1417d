"""Base classes of the elements of a scene: control laws, forces, rotor inertias and prescribed motions.

Rotor inertias on joints are called armatures, as in MuJoCo. There is one base class for each place where an
element can act: a joint coordinate (`OnCoordinate`), the ball of a joint (`OnBall`) or points of bodies
(`OnBodies`). `AppliedForce` is the base class of forces and control laws; its methods compute wrenches,
energy and power from the state, which they take as `Surroundings`. A scene is described at one pose, the
initial pose; `Move` and `PoseChange` serve to describe the same scene at another pose.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from newton_euler.errors import MechanismError, listed, quoted
from newton_euler.model import balls
from newton_euler.model.constraints import Frame
from newton_euler.model.fields import POINT
from newton_euler.model.joint import Key, Pose
from newton_euler.model.mechanism import CLOSURE_TOLERANCE, Mechanism, check_coordinate
from newton_euler.model.variable import INDEX_REASON, Variable
from newton_euler.scalars import Array, Scalar, cross

BALL = -1
"""Index in place of a joint coordinate that stands for the three rotations of a joint's ball."""


class Surroundings(NamedTuple):
    """The state on which forces and armatures depend, in floats or generic scalars (`newton_euler.scalars`).

    Attributes:
        mechanism: the bodies and joints.
        poses: poses of all body frames at the initial pose, ground first.
        frames: present frames (pose and velocity) of all bodies, ground first.
        measured: by joint coordinate, a sequence of the coordinate, m or rad from the initial pose, its rate,
            and possibly derivatives, which elements do not use.
        time: s.
        model: function without arguments that computes, by joint coordinate, the forces (N or N m) of control
            laws that use a model of the mechanism. The default, `dict`, returns no forces.
        friction: function without arguments that computes, by identity of the element, the frictions (N or
            N m) that grow with the reaction of their joint. The default, `dict`, returns none.
        branches: flags of switched forces by their `Element.identity`, see
            `newton_euler.model.switched_forces`. The state decides the branches of forces without an entry.
    """

    mechanism: Mechanism
    poses: Sequence[Pose]
    frames: Sequence[Frame]
    measured: Mapping[Key, Sequence[Any]]
    time: Scalar
    model: Callable[[], Mapping[Key, Scalar]] = dict
    friction: Callable[[], Mapping[str, Scalar]] = dict
    branches: Mapping[str, Iterable[Scalar]] = MappingProxyType({})


class Move(NamedTuple):
    """Rigid displacement of a body from the initial pose to another pose.

    Attributes:
        turn: (3, 3) rotation matrix of the displacement, world frame.
        start, end: (3,) center of mass before and after, m, world frame.
    """

    turn: Array
    start: Array
    end: Array

    def point(self, point: Array) -> Array:
        """Displace points (..., 3), m, that are fixed in the body, world frame."""
        return np.asarray(self.end + (point - self.start) @ self.turn.T)

    def vector(self, vector: Array) -> Array:
        """Rotate vectors (..., 3) that are fixed in the body, world frame."""
        return np.asarray(vector @ self.turn.T)


class PoseChange(NamedTuple):
    """Change of the initial pose at which a scene is described, see `newton_euler.model.initial_pose`.

    Attributes:
        mechanism: the bodies and joints, described at the old initial pose.
        moves: displacements of all bodies from the old to the new initial pose, ground first.
        zeros: joint coordinates at the new initial pose, m or rad, counted from the old initial pose.
    """

    mechanism: Mechanism
    moves: Sequence[Move]
    zeros: Mapping[Key, float]

    def move(self, body: str) -> Move:
        """Return the displacement of a body by its name."""
        return self.moves[self.mechanism.body_index(body)]


class Element(Variable):
    """Base class of everything that acts in a scene: forces, control laws, armatures and prescribed motions.

    The attribute `number_fields` of the base class `Variable` declares the numbers that parameter studies may
    vary: by attribute name, a `NumberField` with the unit and the allowed values.

    Attributes:
        noun: name of the kind of element, with which error messages begin.
        body_fields: names of the attributes that are names of bodies.
    """

    noun: ClassVar[str]
    body_fields: ClassVar[tuple[str, ...]] = ()

    @property
    def strengths(self) -> dict[str, tuple[str, ...]]:
        """Names of the attributes to which an effect of the element is proportional, by the effect's name
        (`NumberField.strength`).

        A spring with a damper returns {"spring": ("stiffness",), "damper": ("damping",)}.
        """
        kinds = dict.fromkeys(field.strength for field in self.number_fields.values() if field.strength)
        return {
            kind: tuple(name for name, field in self.number_fields.items() if field.strength == kind)
            for kind in kinds
        }

    @property
    def functions(self) -> tuple[str, ...]:
        """Names of the attributes that may be functions of time, or mappings to functions of time."""
        return tuple(name for name, field in self.number_fields.items() if field.may_be_function)

    @property
    def on_ball(self) -> bool:
        """True if the element acts on the ball of a joint."""
        return False

    @property
    def element(self) -> str:
        """The name of the element in error messages."""
        return f"{self.noun} {self.where}"

    @property
    def where(self) -> str:
        """The joint on which the element acts, or the name of the element, for error messages."""
        raise NotImplementedError

    @property
    def unit_key(self) -> Key | None:
        """The joint coordinate whose kind, slide or hinge, decides the units of the element's numbers."""
        return None

    @property
    def identity(self) -> str:
        """Text that must be unique among the elements of one attribute of a scene, such as `Scene.forces`."""
        return self.element

    @property
    def prefix(self) -> str:
        """Prefix of the names of the element's numbers in parameter studies: `hinge.spring` in
        `hinge.spring.stiffness`."""
        raise NotImplementedError

    def check(self, mechanism: Mechanism) -> None:
        """Raise `MechanismError` unless the mechanism has the place where the element acts."""
        raise NotImplementedError


class OnJoint(Element):
    """Base class of elements that act on a joint.

    Attributes:
        joint: name of the joint.
        kind_of_parameters: end of `prefix`, such as ".spring".
    """

    joint: str
    kind_of_parameters: ClassVar[str] = ""

    def check(self, mechanism: Mechanism) -> None:
        check_known(self.element, "is on an unknown joint", self.joint, mechanism.joint_names)


class OnCoordinate(OnJoint):
    """Base class of elements that act on one coordinate (hinge or slide) of a joint.

    Attributes:
        coordinate: index of the coordinate in the joint, from 0.
    """

    coordinate: int
    constant: ClassVar = {"coordinate": INDEX_REASON}  # why this attribute cannot vary in studies

    @property
    def key(self) -> Key:
        """The joint coordinate: (name of the joint, index)."""
        return self.joint, self.coordinate

    @property
    def unit_key(self) -> Key:
        return self.key

    @property
    def element(self) -> str:
        return f"{self.noun} of joint {quoted(self.joint)}"

    @property
    def where(self) -> str:
        return f"of joint {quoted(self.joint)}" + (
            f", coordinate {self.coordinate}" if self.coordinate else ""
        )

    @property
    def identity(self) -> str:
        return f"{self.noun} of coordinate {self.coordinate} of joint {quoted(self.joint)}"

    @property
    def prefix(self) -> str:
        place = self.joint if self.coordinate == 0 else f"{self.joint}.{self.coordinate}"
        return place + self.kind_of_parameters

    def check(self, mechanism: Mechanism) -> None:
        super().check(mechanism)
        check_coordinate(self.element, mechanism.joint(self.joint), self.coordinate)

    def measure(self, at: Surroundings) -> tuple[Scalar, Scalar]:
        """Return the coordinate at a state, m or rad from the initial pose, and its rate."""
        x, rate = at.measured[self.key][:2]
        return x, rate


class OnBall(OnJoint):
    """Base class of elements that act on the ball of a joint, isotropically (the same about all axes)."""

    @property
    def key(self) -> Key:
        """The joint, and `BALL` in place of a coordinate."""
        return self.joint, BALL

    @property
    def on_ball(self) -> bool:
        return True

    @property
    def where(self) -> str:
        return f"of the ball of joint {quoted(self.joint)}"

    @property
    def prefix(self) -> str:
        return f"{self.joint}.ball{self.kind_of_parameters}"

    def check(self, mechanism: Mechanism) -> None:
        super().check(mechanism)
        joint = mechanism.joint(self.joint)
        if not any(motion.kind == "ball" for motion in joint.motions):
            needed = "a joint with a ball: spherical, free, or compound with one"
            raise MechanismError(self.element, f"is on a {joint.kind} joint", needed)

    def spin(self, at: Surroundings) -> Array:
        """Compute the angular velocity (3,) of the second body relative to the first, rad/s, world frame."""
        i, j = balls.joint_bodies(at.mechanism, self.joint)
        return balls.spin(at.frames[i], at.frames[j])


class Named(Element):
    """Base class of elements that have a name.

    Attributes:
        name: unique among the forces of a scene.
    """

    name: str

    @property
    def where(self) -> str:
        return repr(self.name)

    @property
    def identity(self) -> str:
        return f"force {quoted(self.name)}"

    @property
    def prefix(self) -> str:
        return self.name


class OnBodies(Named):
    """Base class of elements that act on points of bodies."""

    def check(self, mechanism: Mechanism) -> None:
        for field in self.body_fields:
            body = getattr(self, field)
            check_known(self.element, "acts on an unknown body", body, mechanism.body_names)


class AppliedForce(Element):
    """Base class of forces and control laws.

    Each kind of force overrides the methods that concern it. Methods take the state as `Surroundings`.

    Attributes:
        kind: name of the kind of force in scene files.
        may_jump: True if the force can be discontinuous in the state, such as a spring whose two ends meet.
    """

    kind: ClassVar[str]
    may_jump: ClassVar[bool] = False

    def described_after(self, change: PoseChange) -> Self:
        """Return the same force for the scene as it is described at another initial pose."""
        raise NotImplementedError

    @property
    def keys(self) -> tuple[Key, ...]:
        """The joint coordinates on which the force acts."""
        return ()

    def along_coordinates(self, at: Surroundings) -> tuple[Scalar, ...]:
        """Compute the forces on the joint coordinates `keys`, N or N m."""
        return ()

    def spans(self, at: Surroundings) -> tuple[Array, ...]:
        """Compute the vectors (3,), m, on whose directions the force depends; they must not be zero."""
        return ()

    def check_start(self, at: Surroundings) -> None:
        """Raise `MechanismError` if one of `spans` is zero at the initial state."""
        if any(np.linalg.norm(d) <= CLOSURE_TOLERANCE for d in self.spans(at)):
            raise MechanismError(
                self.element,
                "its points coincide in the initial state",
                "points apart, or a spring of rest_length 0 without damping",
            )

    def reversing_vector(self, at: Surroundings) -> Array:
        """Compute a vector (k,) that reverses its direction where the force jumps, to find jumps in a run.

        The vector and its length k depend on the kind of force, for example the vector (3,) between the two
        points of a spring. All numbers are zero if the force cannot jump.
        """
        raise NotImplementedError

    def wrenches(self, at: Surroundings) -> Iterable[tuple[int, Array]]:
        """Compute the wrenches of the force on bodies, world frame.

        Returns:
            Pairs of a body index and a wrench (6,): force, N, and torque about the center of mass, N m.
        """
        return ()

    def energy(self, at: Surroundings) -> Scalar:
        """Compute the potential energy, J."""
        return 0.0

    def powers(self, at: Surroundings) -> Iterable[Scalar]:
        """Compute the power, W, of the parts of the force that have no potential energy.

        Returns:
            The terms of the power, in the order in which they are summed.
        """
        raise NotImplementedError

    def magnitude(self, at: Surroundings) -> float:
        """Compute the magnitude of the force, N; a torque is divided by the mechanism's size, m."""
        raise NotImplementedError


class PointLoad(NamedTuple):
    """A force at a point of a body and a torque on the body, world frame."""

    body: int
    """Index of the body."""
    force: Array
    """(3,) N, at the point."""
    torque: Array
    """(3,) N m."""
    arm: Array
    """(3,) m, from the center of mass to the point."""


class OnPoint(OnBodies, AppliedForce):
    """Base class of a force and a torque at a point of one body.

    Attributes:
        body: name of the body, not the ground.
        point: (3,) in the world at the initial pose, m; the point moves with the body.
    """

    body: str
    point: Array
    body_fields = ("body",)
    number_fields: ClassVar = {"point": POINT}

    def check(self, mechanism: Mechanism) -> None:
        """Raise `MechanismError` unless the mechanism has the body and the body moves."""
        super().check(mechanism)
        if mechanism.body_index(self.body) == 0:
            raise MechanismError(self.element, f"acts on the ground {quoted(self.body)}", "a body that moves")

    def load(self, at: Surroundings) -> PointLoad:
        """Compute the force and torque on the body at a state."""
        raise NotImplementedError

    def wrenches(self, at: Surroundings) -> Iterator[tuple[int, Array]]:
        k, force, torque, arm = self.load(at)
        yield k, np.concatenate([force, torque + cross(arm, force)])

    def powers(self, at: Surroundings) -> Iterator[Scalar]:
        k, force, torque, arm = self.load(at)
        omega = at.frames[k].angular_velocity
        yield force @ (at.frames[k].velocity + cross(omega, arm))
        yield torque @ omega

    def magnitude(self, at: Surroundings) -> float:
        _, force, torque, _ = self.load(at)
        return float(np.max(np.abs([force, torque / at.mechanism.size])))


class CoordinateForce(OnCoordinate, AppliedForce):
    """Base class of generalized forces on a joint coordinate, such as control laws and joint springs.

    The equations of motion use the force on the coordinate itself, so that `wrenches` is empty.
    """

    def force(self, x: Scalar, x_rate: Scalar, time: Scalar) -> Scalar:
        """Compute the force, N or N m.

        Args:
            x: joint coordinate, m or rad from the initial pose.
            x_rate: rate of the coordinate, m/s or rad/s.
            time: s.
        """
        raise NotImplementedError

    @property
    def keys(self) -> tuple[Key, ...]:
        return (self.key,)

    def along_coordinates(self, at: Surroundings) -> tuple[Scalar, ...]:
        return (self.at_joint(at),)

    def at_joint(self, at: Surroundings) -> Scalar:
        """Compute the force, N or N m, at the present state."""
        return self.force(*self.measure(at), at.time)

    def powers(self, at: Surroundings) -> Iterator[Scalar]:
        yield self.at_joint(at) * self.measure(at)[1]

    def magnitude(self, at: Surroundings) -> float:
        is_slide = at.mechanism.is_slide(*self.key)
        return float(abs(self.at_joint(at)) / (1.0 if is_slide else at.mechanism.size))


def check_known(element: str, problem: str, name: str, known: Sequence[str]) -> None:
    """Raise `MechanismError` unless a name is among the known names.

    Args:
        element: name of the element, for the message.
        problem: text before the name in the message, such as "acts on an unknown body".
        name: the name.
        known: all known names.
    """
    if name not in known:
        raise MechanismError(element, f"{problem} {quoted(name)}", f"one of {listed(known)}")


def check_elements(elements: Sequence[Element], mechanism: Mechanism) -> None:
    """Raise `MechanismError` for an element whose joint or body does not exist, and for a repeated
    element."""
    for element in elements:
        element.check(mechanism)
    for identity, count in Counter(element.identity for element in elements).items():
        if count > 1:
            needed = "unique names, and one of a kind per joint coordinate or ball"
            raise MechanismError(identity, f"{count} of that name", needed)
