"""Base classes of the elements of a scene, by the place where an element acts.

Control laws, forces (`newton_euler.model.forces`), armatures and prescribed motions are elements. An element
acts on a joint coordinate (`OnCoordinate`), on the ball of a joint (`OnBall`) or on points of bodies
(`OnBodies`). Its methods take the state as `Surroundings`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from newton_euler.errors import MechanismError, listed, quoted
from newton_euler.model import balls
from newton_euler.model.constraints import Frame
from newton_euler.model.fields import POINT
from newton_euler.model.joint import Key, Pose
from newton_euler.model.mechanism import CLOSURE_TOLERANCE, Mechanism, check_coordinate
from newton_euler.model.variable import COORDINATE_INDEX, Variable
from newton_euler.scalars import Array, Scalar, cross

BALL = -1  # number of a "coordinate" that stands for all three rotations of a joint's ball


class Surroundings(NamedTuple):
    """The state on which forces and armatures depend, over generic scalars; world frame, SI.

    Attributes:
        mechanism: the bodies and joints.
        poses: reference poses of all body frames, at the initial pose.
        frames: frames of all bodies, ground first.
        measured: joint coordinates (m or rad) and their rates, the first two values of each sequence.
        time: s.
        model: function that computes the forces (N or N m) of control laws with a model of the mechanism;
            by default it returns no forces.
    """

    mechanism: Mechanism
    poses: Sequence[Pose]
    frames: Sequence[Frame]
    measured: Mapping[Key, Sequence[Any]]
    time: Scalar
    model: Callable[[], Mapping[Key, Scalar]] = dict


class Move(NamedTuple):
    """The motion of a body from the initial pose to another pose.

    Attributes:
        turn: (3, 3) rotation, world frame.
        start, end: (3,) center of mass before and after, m.
    """

    turn: Array
    start: Array
    end: Array

    def point(self, point: Array) -> Array:
        """Return the new places (..., 3) of points of the body."""
        return np.asarray(self.end + (point - self.start) @ self.turn.T)

    def vector(self, vector: Array) -> Array:
        """Return the new directions (..., 3) of vectors of the body."""
        return np.asarray(vector @ self.turn.T)


class PoseChange(NamedTuple):
    """The change of a scene's initial pose, where the scene is described.

    Attributes:
        mechanism: the bodies and joints at the initial pose before.
        moves: motions of all bodies, ground first.
        zeros: joint coordinates of the new initial pose, m or rad, counted from the pose before.
    """

    mechanism: Mechanism
    moves: Sequence[Move]
    zeros: Mapping[Key, float]

    def move(self, body: str) -> Move:
        """Return the motion of a body by its name."""
        return self.moves[self.mechanism.body_index(body)]


class Element(Variable):
    """An element that acts in a scene.

    Attributes:
        noun: first word of messages about the element.
        body_fields: attributes that are names of bodies.
    """

    noun: ClassVar[str]
    body_fields: ClassVar[tuple[str, ...]] = ()

    @property
    def strengths(self) -> dict[str, tuple[str, ...]]:
        """Attributes that the element is proportional to, by what they are the strength of."""
        kinds = dict.fromkeys(field.strength for field in self.number_fields.values() if field.strength)
        return {
            kind: tuple(name for name, field in self.number_fields.items() if field.strength == kind)
            for kind in kinds
        }

    @property
    def functions(self) -> tuple[str, ...]:
        """Attributes that may be functions of time, or mappings to functions of time."""
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
        """The place or the name of the element, for messages."""
        raise NotImplementedError

    @property
    def identity(self) -> str:
        """A text that is unique among the elements of one kind in a scene."""
        return self.element

    @property
    def prefix(self) -> str:
        """The prefix of names of the element's parameters, see `newton_euler.equations.parameters`."""
        raise NotImplementedError

    def check(self, mechanism: Mechanism) -> None:
        """Raise `MechanismError` unless the mechanism has the place where the element acts."""
        raise NotImplementedError


class OnJoint(Element):
    """An element on a joint."""

    joint: str
    kind_of_parameters: ClassVar[str] = ""
    """Suffix of `prefix`."""

    def check(self, mechanism: Mechanism) -> None:
        check_known(self.element, "is on an unknown joint", self.joint, mechanism.joint_names)


class OnCoordinate(OnJoint):
    """An element on a hinge or slide of a joint."""

    coordinate: int
    constant: ClassVar = {"coordinate": COORDINATE_INDEX}

    @property
    def key(self) -> Key:
        """The joint coordinate."""
        return self.joint, self.coordinate

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
        """Return the coordinate, m or rad from the initial pose, and its rate."""
        x, rate = at.measured[self.key][:2]
        return x, rate


class OnBall(OnJoint):
    """An element on the ball of a joint, the same about all axes."""

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
        """Compute the angular velocity (3,) of the second body against the first, rad/s, world frame."""
        i, j = balls.ends(at.mechanism, self.joint)
        return balls.spin(at.frames[i], at.frames[j])


class OnBodies(Element):
    """An element with a name, on points of bodies."""

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

    def check(self, mechanism: Mechanism) -> None:
        for field in self.body_fields:
            body = getattr(self, field)
            check_known(self.element, "acts on an unknown body", body, mechanism.body_names)


class AppliedForce(Element):
    """A force or a control law. Each kind redefines the methods for what it does.

    Attributes:
        kind: name of the kind of force in scene files.
        may_jump: True if the force can jump during a motion.
    """

    kind: ClassVar[str]
    may_jump: ClassVar[bool] = False

    def described_after(self, change: PoseChange) -> Self:
        """Return the force described at another initial pose."""
        raise NotImplementedError

    def spans(self, at: Surroundings) -> tuple[Array, ...]:
        """Compute the vectors (3,), m, whose directions the force depends on; they must not be zero."""
        return ()

    def check_start(self, at: Surroundings) -> None:
        """Raise `MechanismError` if one of `spans` is zero at the initial state."""
        if any(np.linalg.norm(d) <= CLOSURE_TOLERANCE for d in self.spans(at)):
            raise MechanismError(
                self.element,
                "its points coincide in the initial state",
                "points apart, or a spring of rest_length 0 without damping",
            )

    def reversing(self, at: Surroundings) -> Array:
        """Compute a vector (k,) that changes its sign where the force jumps; zero for a force that cannot."""
        raise NotImplementedError

    def wrenches(self, at: Surroundings) -> Iterable[tuple[int, Array]]:
        """Compute the wrenches on bodies, by body number: force and torque (6,) about the center of mass."""
        return ()

    def energy(self, at: Surroundings) -> Scalar:
        """Compute the potential energy, J."""
        return 0.0

    def powers(self, at: Surroundings) -> Iterable[Scalar]:
        """Compute the terms of the power, W, without potential energy, in the order of summation."""
        raise NotImplementedError

    def magnitude(self, at: Surroundings) -> float:
        """Compute the magnitude of the force, N; a torque is divided by the mechanism's size."""
        raise NotImplementedError


class OnPoint(OnBodies, AppliedForce):
    """A force and a torque at a point of one body.

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

    def parts(self, at: Surroundings) -> tuple[int, Array, Array, Array]:
        """Return the body's number, and the force, the torque and the arm of the point (3,), world frame."""
        raise NotImplementedError

    def wrenches(self, at: Surroundings) -> Iterator[tuple[int, Array]]:
        k, force, torque, arm = self.parts(at)
        yield k, np.concatenate([force, torque + cross(arm, force)])

    def powers(self, at: Surroundings) -> Iterator[Scalar]:
        k, force, torque, arm = self.parts(at)
        omega = at.frames[k].angular_velocity
        yield force @ (at.frames[k].velocity + cross(omega, arm))
        yield torque @ omega

    def magnitude(self, at: Surroundings) -> float:
        _, force, torque, _ = self.parts(at)
        return float(np.max(np.abs([force, torque / at.mechanism.size])))


class CoordinateForce(OnCoordinate, AppliedForce):
    """A force on a joint coordinate. The force acts through the coordinate, without wrenches on bodies."""

    def force(self, x: Scalar, x_rate: Scalar, time: Scalar) -> Scalar:
        """Compute the force (N or N m) at coordinate x (m or rad), its rate, and a time in s."""
        raise NotImplementedError

    def at_joint(self, at: Surroundings) -> Scalar:
        """Compute the force, N or N m."""
        return self.force(*self.measure(at), at.time)

    def powers(self, at: Surroundings) -> Iterator[Scalar]:
        yield self.at_joint(at) * self.measure(at)[1]

    def magnitude(self, at: Surroundings) -> float:
        slides = at.mechanism.is_slide(*self.key)
        return float(abs(self.at_joint(at)) / (1.0 if slides else at.mechanism.size))


def check_known(element: str, problem: str, name: str, known: Sequence[str]) -> None:
    """Raise `MechanismError` unless a name is among the known names."""
    if name not in known:
        raise MechanismError(element, f"{problem} {quoted(name)}", f"one of {listed(known)}")


def check_elements(elements: Sequence[Element], mechanism: Mechanism) -> None:
    """Raise `MechanismError` for an element without a place in the mechanism, or a repeated element."""
    for element in elements:
        element.check(mechanism)
    for identity, count in Counter(element.identity for element in elements).items():
        if count > 1:
            needed = "unique names, and one of a kind per joint coordinate or ball"
            raise MechanismError(identity, f"{count} of that name", needed)
