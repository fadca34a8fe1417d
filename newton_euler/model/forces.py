"""Force elements: springs, dampers and constant wrenches.

Points are given in the world at the initial pose, like those of joints, and move with their bodies. Each kind
of force computes its wrenches on bodies, its energy and its power from the state (`Surroundings`: the time,
the present frames of all bodies, their poses at the initial pose, and the joint coordinates). A wrench (6,)
is a force, N, and a torque about the center of mass, N m, in the world frame. The method `described_after`
converts a force to another initial pose, to which `PoseChange` has the displacement of each body. The numbers
may be floats or generic scalars such as expressions of the code generator (`newton_euler.scalars`).
`newton_euler.equations.applied_forces` sums the forces of a scene. Source of springs between points:
Nikravesh, Computer-Aided Analysis of Mechanical Systems, 1988, chapter 9.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import ClassVar, Literal, NamedTuple, Self

import numpy as np

from newton_euler.errors import MechanismError, check_key, check_texts, quoted
from newton_euler.model import balls
from newton_euler.model.constraints import Span
from newton_euler.model.description import ArrayField, description
from newton_euler.model.elements import (
    AppliedForce,
    CoordinateForce,
    OnBall,
    OnBodies,
    OnPoint,
    PointLoad,
    PoseChange,
    Surroundings,
)
from newton_euler.model.fields import POINT, NumberField
from newton_euler.model.mechanism import Mechanism, check_name
from newton_euler.model.switched_forces import SwitchedElement
from newton_euler.model.wind import WindLoad
from newton_euler.scalars import Array, Scalar, cross, sqrt

# Declarations of attributes: the unit at a slide, the unit about a hinge or ball, the allowed values, and the
# physical effect that is proportional to the attribute
STIFFNESS = NumberField("N/m", unit_about="N m/rad", least=0.0, strength="spring")
DAMPING = NumberField("N s/m", unit_about="N m s/rad", least=0.0, strength="damper")


class Spring(AppliedForce):
    """Base class of a spring and a damper in parallel.

    Attributes:
        stiffness: stiffness of the spring, N/m or N m/rad.
        damping: damping coefficient of the damper, N s/m or N m s/rad.
    """

    stiffness: float
    damping: float

    noun = "spring"  # the name of the kind of element in error messages
    number_fields: ClassVar = {"stiffness": STIFFNESS, "damping": DAMPING}

    @property
    def active_parts(self) -> list[str]:
        """The parts that are present: "spring" if the stiffness is not 0, "damper" if the damping is not
        0."""
        return [part for part, value in (("spring", self.stiffness), ("damper", self.damping)) if value]


@dataclass(frozen=True)
class JointSpring(CoordinateForce, Spring):
    """A spring and damper on a hinge or slide of a joint.

    The force on the joint coordinate x is -(k (x - rest) + d dx/dt), N or N m. The joint need not be
    actuated. Damping without stiffness is viscous friction.

    Attributes:
        joint: name of the joint.
        stiffness: k in N/m or N m/rad, 0 or more.
        damping: d in N s/m or N m s/rad, 0 or more.
        rest: joint coordinate at which the spring force is zero, m or rad from the initial pose.
        coordinate: index of the joint coordinate, from 0.

    Raises:
        MechanismError: naming the joint and the invalid value.

    Examples:
        >>> damped = replace(load("pendulum"), forces=[JointSpring("pivot", damping=0.5)])
        >>> print(simulate(damped).joint("pivot").coordinates[-1].round(3))  # rad, nearly hangs down
        [1.529]
    """

    joint: str
    stiffness: float = 0.0
    damping: float = 0.0
    rest: float = 0.0
    coordinate: int = 0

    kind = "joint_spring"  # the name in scene files
    number_fields: ClassVar = Spring.number_fields | {"rest": NumberField("m", unit_about="rad")}
    kind_of_parameters = ".spring"  # names of parameters in studies: `hinge.spring.stiffness`

    def __post_init__(self) -> None:
        self.set_numbers(self.element)
        check_key(self.element, self.joint, self.coordinate)

    def described_after(self, change: PoseChange) -> Self:
        # `change.zeros`: the joint coordinates at the new initial pose, counted from the old one
        return replace(self, rest=self.rest - change.zeros[self.key])

    def force(self, x: Scalar, x_rate: Scalar, time: Scalar) -> Scalar:
        return -(self.stiffness * (x - self.rest) + self.damping * x_rate)

    def energy(self, at: Surroundings) -> Scalar:
        x, _ = self.measure(at)
        return 0.5 * self.stiffness * ((x - self.rest) * (x - self.rest))

    def powers(self, at: Surroundings) -> Iterator[Scalar]:
        """Compute the power of the damper, W."""
        _, rate = self.measure(at)
        yield -self.damping * (rate * rate)


@description
class BallSpring(OnBall, Spring):
    """An isotropic torsion spring and damper on the ball of a joint.

    The torque on the second body is -(k theta + d omega), N m; the opposite torque acts on the first body.
    theta is the rotation vector (axis times angle) of the second body relative to the first, counted from the
    orientation at rest. omega is the relative angular velocity. |theta| is at most half a revolution; there
    the torque of the spring jumps to the opposite direction.

    Attributes:
        joint: name of the joint.
        stiffness: k in N m/rad, 0 or more.
        damping: d in N m s/rad, 0 or more.
        rest: (3,) rotation vector of the second body relative to the first where the spring torque is zero,
            rad from the initial pose, with world components at the initial pose.

    Raises:
        MechanismError: naming the joint and the invalid value.

    Examples:
        >>> spring = BallSpring("ball_67", stiffness=5.0, rest=[0.0, 0.1, 0.0])
        >>> held = statics(replace(load("tracker"), forces=[spring]))
        >>> print(held.actuator_force.round(2))  # N, of both slides, against the spring
        [-18.08  -1.28]
    """

    joint: str
    stiffness: float = 0.0
    damping: float = 0.0
    rest: ArrayField = (0.0, 0.0, 0.0)  # type: ignore[assignment]

    kind = "ball_spring"
    number_fields: ClassVar = Spring.number_fields | {"rest": NumberField("rad", shape=(3,))}
    may_jump = True  # at half a revolution

    def __post_init__(self) -> None:
        check_texts(self.element, self, "joint")
        self.set_numbers(self.element)

    def described_after(self, change: PoseChange) -> Self:
        i, j = balls.joint_bodies(change.mechanism, self.joint)  # indices of the two bodies
        # rotation of the second body from the new initial pose to rest, with the first body at the new pose
        rest = change.moves[i].turn @ balls.rotation_by(self.rest) @ change.moves[j].turn.T
        return replace(self, rest=balls.rotation_vector(rest))

    def theta(self, at: Surroundings) -> Array:
        """Compute the rotation vector theta (3,), rad, of the second body relative to the first, counted from
        the rest orientation, world frame."""
        i, j = balls.joint_bodies(at.mechanism, self.joint)
        return balls.rotation_from_rest(at.poses[i], at.poses[j], self.rest, (at.frames[i], at.frames[j]))

    def at_joint(self, at: Surroundings) -> Array:
        """Compute the torque (3,) on the second body, N m, world frame."""
        theta, omega = self.theta(at), self.spin(at)
        return -(self.stiffness * theta + self.damping * omega)

    def reversing_vector(self, at: Surroundings) -> Array:
        """Compute the quaternion (4,) of theta, whose vector part reverses where theta jumps.

        A reversal during a run shows that the force jumped. Zeros are returned without a spring.
        """
        return np.zeros(4) if self.stiffness == 0.0 else balls.quaternion_by(self.theta(at))

    def wrenches(self, at: Surroundings) -> Iterator[tuple[int, Array]]:
        i, j = balls.joint_bodies(at.mechanism, self.joint)
        couple = np.concatenate([np.zeros(3), self.at_joint(at)])
        yield i, -couple
        yield j, couple

    def energy(self, at: Surroundings) -> Scalar:
        theta = self.theta(at)
        return 0.5 * self.stiffness * (theta @ theta)

    def powers(self, at: Surroundings) -> Iterator[Scalar]:
        """Compute the power of the damper, W."""
        omega = self.spin(at)
        yield -self.damping * (omega @ omega)

    def magnitude(self, at: Surroundings) -> float:
        """Compute the largest component of the torque, divided by the mechanism's size, N."""
        return float(np.max(np.abs(self.at_joint(at)))) / at.mechanism.size


class Line(NamedTuple):
    """The line between the two points of a point spring at a state, world frame."""

    first: int
    """Index of the first body."""
    second: int
    """Index of the second body."""
    s_i: Array
    """(3,) from the first body's center of mass to its point, m."""
    s_j: Array
    """(3,) from the second body's center of mass to its point, m."""
    d: Array
    """(3,) from the first body's point to the second body's point, m."""
    rate: Array
    """(3,) rate of d, m/s."""


@description
class PointSpring(OnBodies, Spring):
    """A spring and damper between points of two bodies.

    The tension along the line between the points is k (l - l0) + d dl/dt, where l is the distance of the
    points.

    Attributes:
        name: unique among the forces of a scene; letters, digits, `_`, `.` and `-`.
        first, second: names of the two bodies.
        point_on_first, point_on_second: (3,) point of each body, m, world at the initial pose.
        stiffness: k in N/m, 0 or more.
        rest_length: l0 in m, 0 or more.
        damping: d in N s/m, 0 or more.

    Raises:
        MechanismError: naming the spring and the invalid value.

    Examples:
        >>> ends = [-0.5, 0.5, 0.0], [-0.5, 0.0, 0.0]
        >>> cord = PointSpring("cord", "ground", "dumbbell", *ends, stiffness=100.0, rest_length=0.5)
        >>> run = simulate(replace(load("pendulum"), forces=[cord]))
        >>> print(run.position[:, 1, 1].min().round(3))  # m, how far the dumbbell falls
        -0.364
    """

    name: str
    first: str
    second: str
    point_on_first: ArrayField
    point_on_second: ArrayField
    stiffness: float = field(kw_only=True)
    rest_length: float = field(kw_only=True)
    damping: float = field(default=0.0, kw_only=True)

    noun = "point spring"
    kind = "point_spring"
    number_fields: ClassVar = {
        "point_on_first": POINT,
        "point_on_second": POINT,
        "stiffness": STIFFNESS,
        "rest_length": NumberField("m", least=0.0),
        "damping": DAMPING,
    }
    body_fields = ("first", "second")
    may_jump = True  # where the points pass through each other

    def __post_init__(self) -> None:
        check_name("point spring", self.name)
        check_texts(self.element, self, "first", "second")
        self.set_numbers(self.element)

    def check(self, mechanism: Mechanism) -> None:
        """Raise `MechanismError` unless the mechanism has both bodies of the spring and they differ."""
        super().check(mechanism)
        if self.first == self.second:
            raise MechanismError(self.element, f"connects {quoted(self.first)} to itself", "two bodies")

    def described_after(self, change: PoseChange) -> Self:
        on_first = change.move(self.first).point(self.point_on_first)
        on_second = change.move(self.second).point(self.point_on_second)
        return replace(self, point_on_first=on_first, point_on_second=on_second)

    @property
    def has_direction(self) -> bool:
        """True if the force depends on the direction of the line, so that the points must not coincide.

        Without rest length and damping the force is k d, which is smooth where the vector d between the
        points is 0.
        """
        return not (self.rest_length == 0.0 and self.damping == 0.0)

    def line(self, at: Surroundings) -> Line:
        """Compute the line between the two points of the spring."""
        poses, frames = at.poses, at.frames
        i, j = at.mechanism.body_index(self.first), at.mechanism.body_index(self.second)
        on_first = poses[i].point_to_body(self.point_on_first)
        on_second = poses[j].point_to_body(self.point_on_second)
        span = Span.of(frames[i], frames[j], on_first, on_second)
        return Line(i, j, *span, span.rate(frames[i], frames[j]))

    def force_on_first(self, line: Line) -> Array:
        """Compute the force (3,), N, on the first body's point, world frame; the opposite force acts on the
        second body's point."""
        if not self.has_direction:
            return np.asarray(self.stiffness * line.d)
        length = sqrt(line.d @ line.d)
        along = line.d / length
        tension = self.stiffness * (length - self.rest_length) + self.damping * (along @ line.rate)
        return np.asarray(tension * along)

    def spans(self, at: Surroundings) -> tuple[Array, ...]:
        """Return the vector between the points, (3,) m, if the force depends on its direction."""
        return (self.line(at).d,) if self.has_direction else ()

    def reversing_vector(self, at: Surroundings) -> Array:
        """Compute the vector (3,), m, between the points, which reverses where they pass through each other.

        A reversal during a run shows that the force jumped. The vector is zero for an element whose force
        does not jump there: a damper, or a spring without rest length.
        """
        return np.zeros(3) if self.stiffness == 0.0 or self.rest_length == 0.0 else self.line(at).d

    def wrenches(self, at: Surroundings) -> Iterator[tuple[int, Array]]:
        line = self.line(at)
        force = self.force_on_first(line)
        yield line.first, np.concatenate([force, cross(line.s_i, force)])
        yield line.second, -np.concatenate([force, cross(line.s_j, force)])

    def energy(self, at: Surroundings) -> Scalar:
        d = self.line(at).d
        if self.rest_length == 0.0:  # without a square root, which has no derivative at 0
            return 0.5 * self.stiffness * (d @ d)
        stretch = sqrt(d @ d) - self.rest_length
        return 0.5 * self.stiffness * (stretch * stretch)

    def powers(self, at: Surroundings) -> Iterator[Scalar]:
        """Compute the power of the damper, W."""
        line = self.line(at)
        if self.has_direction:
            along = line.d @ line.rate
            yield -(self.damping * (along * along) / (line.d @ line.d))

    def magnitude(self, at: Surroundings) -> float:
        """Compute the largest component of the force on a point, N."""
        return float(np.max(np.abs(self.force_on_first(self.line(at)))))


@description
class Wrench(OnPoint):
    """A force at a point of a body and a torque on it, constant in the world frame or in the body frame.

    Attributes:
        name: unique among the forces of a scene; letters, digits, `_`, `.` and `-`.
        body: name of the body, not the ground.
        point: (3,) m, world at the initial pose; the point moves with the body.
        force: (3,) N, world components at the initial pose.
        torque: (3,) N m, world components at the initial pose.
        frame: "world", or "body" for a force and a torque that rotate with the body.

    Raises:
        MechanismError: naming the wrench and the invalid value.

    Examples:
        >>> lift = Wrench("lift", "dumbbell", point=[-0.5, 0.0, 0.0], force=[0.0, 19.62, 0.0])
        >>> run = simulate(replace(load("pendulum"), forces=[lift]))
        >>> print(abs(run.joint("pivot").coordinates).max())  # rad: the force carries the weight
        0.0
    """

    name: str
    body: str
    point: ArrayField
    force: ArrayField = (0.0, 0.0, 0.0)  # type: ignore[assignment]
    torque: ArrayField = (0.0, 0.0, 0.0)  # type: ignore[assignment]
    frame: Literal["world", "body"] = "world"

    noun = "wrench"
    kind = "wrench"
    number_fields: ClassVar = OnPoint.number_fields | {
        "force": NumberField("N", shape=(3,), strength="wrench"),
        "torque": NumberField("N m", shape=(3,), strength="wrench"),
    }

    def __post_init__(self) -> None:
        check_name("wrench", self.name)
        check_texts(self.element, self, "body")
        self.set_numbers(self.element)
        if not isinstance(self.frame, str) or self.frame not in ("world", "body"):
            raise MechanismError(self.element, f"frame is {quoted(self.frame)}", "'world' or 'body'")

    def described_after(self, change: PoseChange) -> Self:
        move = change.move(self.body)
        moved = replace(self, point=move.point(self.point))
        if self.frame == "world":
            return moved
        return replace(moved, force=move.vector(self.force), torque=move.vector(self.torque))

    def load(self, at: Surroundings) -> PointLoad:
        k = at.mechanism.body_index(self.body)
        pose, frame = at.poses[k], at.frames[k]
        arm = frame.rotation @ pose.point_to_body(self.point)
        if self.frame == "world":
            return PointLoad(k, self.force, self.torque, arm)
        force, torque = pose.vector_to_body(self.force), pose.vector_to_body(self.torque)
        return PointLoad(k, frame.rotation @ force, frame.rotation @ torque, arm)


Force = JointSpring | BallSpring | PointSpring | Wrench | WindLoad | SwitchedElement
"""Every kind of force in `Scene.forces`."""
