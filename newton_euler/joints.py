"""Joint kinds: Appendix A of the paper, one class a kind.

A `Joint` is a description in the world frame at the mechanism's initial pose. `attach` ties it to
the two bodies' reference poses and gives `JointEquations`: Phi, Phi_q and gamma of its constraint
equations, and its coordinates. `motions` lists the elementary motions it allows, which is what a
spanning tree, an MJCF and a URDF are built from.

Joint coordinates are zero at the initial pose and measure the motion of the second body against
the first.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, Literal, NamedTuple

import numpy as np

from newton_euler.constraints import (
    Angle,
    Coincidence,
    Constraint,
    Displacement,
    Frame,
    Jacobian,
    Perpendicular,
    Reversed,
)
from newton_euler.errors import MechanismError
from newton_euler.scalars import Array, cross

AXIS_TOLERANCE = 1e-9
"""How far from perpendicular (radians) a universal joint's axes may be at the initial pose."""


class Motion(NamedTuple):
    """One elementary motion of the second body against the first."""

    kind: Literal["hinge", "slide", "ball"]
    axis: Array
    """(3,) unit axis in the world at the initial pose; unused for a ball."""


class Pose(NamedTuple):
    """A reference pose: takes world points and vectors at the initial pose into a body's frame."""

    position: Array
    rotation: Array

    def point_to_body(self, point: Array) -> Array:
        return np.asarray(self.rotation.T @ (point - self.position))

    def vector_to_body(self, vector: Array) -> Array:
        return np.asarray(self.rotation.T @ vector)


@dataclass(frozen=True, eq=False)
class JointEquations:
    """Constraint equations and coordinates of one joint, tied to its two bodies.

    `phi` (k,), `jacobian` (four blocks (k, 3)) and `gamma` (k,) stack the joint's constraints;
    `is_length` (k,) tells rows in metres from rows in radians.
    """

    joint: Joint
    first: int
    second: int
    constraints: tuple[Constraint, ...]
    coordinates: tuple[Constraint, ...]

    @property
    def count(self) -> int:
        return sum(c.count for c in self.constraints)

    @property
    def is_length(self) -> Array:
        return np.concatenate([np.zeros(0, bool), *(np.full(c.count, c.is_length) for c in self.constraints)])

    def units(self, size: float) -> Array:
        """(k,) what makes the equations dimensionless: `size` (m) for lengths, 1 for angles."""
        return np.where(self.is_length, size, 1.0)

    def phi(self, first: Frame, second: Frame) -> Array:
        return np.concatenate([np.zeros(0), *(c.phi(first, second) for c in self.constraints)])

    def gamma(self, first: Frame, second: Frame) -> Array:
        return np.concatenate([np.zeros(0), *(c.gamma(first, second) for c in self.constraints)])

    def jacobian(self, first: Frame, second: Frame) -> Jacobian:
        blocks = [c.jacobian(first, second) for c in self.constraints]
        empty = np.zeros((0, 3))
        return (
            Jacobian(*(np.concatenate([empty, *column]) for column in zip(*blocks, strict=True)))
            if blocks
            else Jacobian(empty, empty, empty, empty)
        )


def perpendicular_pair(axis: Array) -> tuple[Array, Array]:
    """Unit vectors u and w that make (u, w, axis) right-handed and orthonormal; axis (3,) unit."""
    helper = np.zeros(3)
    helper[int(np.argmin(np.abs(axis)))] = 1.0
    w = cross(axis, helper)
    w /= np.linalg.norm(w)
    return cross(w, axis), w


def _vector(joint: str, name: str, value: object) -> Array:
    try:
        vector = np.array(value, dtype=float)
    except (TypeError, ValueError):
        vector = np.zeros(0)
    if vector.shape != (3,) or not np.all(np.isfinite(vector)):
        raise MechanismError(f"joint {joint!r}", f"{name} is {value!r}", "three finite numbers")
    return vector


def _unit(joint: str, name: str, value: object) -> Array:
    vector = _vector(joint, name, value)
    largest = float(np.max(np.abs(vector)))
    if largest < 1e-12:
        raise MechanismError(f"joint {joint!r}", f"{name} is {vector.tolist()}", "a non-zero axis")
    vector = np.ldexp(vector, -np.frexp(largest)[1])  # exact, and no square can overflow
    vector /= np.linalg.norm(vector)
    vector.flags.writeable = False
    return vector


@dataclass(frozen=True, eq=False)
class Joint:
    """What all joints share.

    Attributes:
        name: unique in its mechanism.
        first, second: names of the two bodies; reactions are those acting on the second.
        point: (3,) joint point in the world at the initial pose, metres.
        point_on_second: (3,) the second body's own joint point where it is another one; it must
            lie where the joint's constraints allow it. Reactions are reduced to this point.
        actuated: whether a control law may drive the joint.
    """

    name: str
    first: str
    second: str
    point: Array
    point_on_second: Array | None = field(default=None, kw_only=True)
    actuated: bool = field(default=False, kw_only=True)

    kind: ClassVar[str]
    axis_names: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", _vector(self.name, "point", self.point))
        second = self.point if self.point_on_second is None else self.point_on_second
        object.__setattr__(self, "point_on_second", _vector(self.name, "point_on_second", second))
        for name in self.axis_names:
            object.__setattr__(self, name, _unit(self.name, name, getattr(self, name)))

    @property
    def reaction_point(self) -> Array:
        """(3,) the joint point fixed in the second body, in the world at the initial pose."""
        assert self.point_on_second is not None
        return self.point_on_second

    @property
    def motions(self) -> tuple[Motion, ...]:
        """The elementary motions of the second body against the first, in their order."""
        return ()

    def constraints(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        """The joint's constraint equations between bodies with these reference poses."""
        raise NotImplementedError

    def coordinates(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        """One coordinate for each hinge and slide among `motions`."""
        return ()

    def attach(self, first: int, first_pose: Pose, second: int, second_pose: Pose) -> JointEquations:
        """Tie the joint to bodies number `first` and `second` at their reference poses."""
        return JointEquations(
            self,
            first,
            second,
            self.constraints(first_pose, second_pose),
            self.coordinates(first_pose, second_pose),
        )

    # What the joint kinds below are made of: the constraint sets of Appendix A.

    def _coincident(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        """Phi^(s,3), eq. (25)."""
        return (Coincidence(first.point_to_body(self.point), second.point_to_body(self.reaction_point)),)

    def _parallel(self, axis: Array, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        """Phi^(p1,2), eq. (27): tilde(s_i) s_j = 0.

        Of its three components the two along u and w of body i are kept (-w.s_j and u.s_j); the
        third, along the axis itself, is zero whatever the bodies do.
        """
        s_j = second.vector_to_body(axis)
        return tuple(Perpendicular(first.vector_to_body(a), s_j) for a in perpendicular_pair(axis))

    def _on_line(self, axis: Array, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        """Phi^(p2,2), eq. (28): tilde(s_i) d = 0, again its two components across the axis."""
        return tuple(
            Displacement(
                first.vector_to_body(a),
                first.point_to_body(self.point),
                second.point_to_body(self.reaction_point),
            )
            for a in perpendicular_pair(axis)
        )

    def _slide(self, axis: Array, first: Pose, second: Pose) -> Constraint:
        return Displacement(
            first.vector_to_body(axis),
            first.point_to_body(self.point),
            second.point_to_body(self.reaction_point),
            offset=float(axis @ (self.reaction_point - self.point)),
        )

    def _turn(self, axis: Array, pointer: Array, first: Pose, second: Pose) -> Constraint:
        """The angle about `axis`, seen on `pointer`, a vector of the second body across it."""
        return Angle(
            first.vector_to_body(pointer),
            first.vector_to_body(cross(axis, pointer)),
            second.vector_to_body(pointer),
        )


@dataclass(frozen=True, eq=False)
class Spherical(Joint):
    """Ball joint, eq. (25): three equations."""

    kind: ClassVar[str] = "spherical"

    @property
    def motions(self) -> tuple[Motion, ...]:
        return (Motion("ball", np.zeros(3)),)

    def constraints(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        return self._coincident(first, second)


@dataclass(frozen=True, eq=False)
class Universal(Joint):
    """Cardan joint, eq. (26): four equations; `axis_on_first` stays perpendicular to `axis_on_second`.

    Its coordinates are the angle about the first body's axis, then that about the second's.
    """

    axis_on_first: Array = field(kw_only=True)
    axis_on_second: Array = field(kw_only=True)
    kind: ClassVar[str] = "universal"
    axis_names: ClassVar[tuple[str, ...]] = ("axis_on_first", "axis_on_second")

    def __post_init__(self) -> None:
        super().__post_init__()
        cosine = float(self.axis_on_first @ self.axis_on_second)
        if abs(cosine) > AXIS_TOLERANCE:
            raise MechanismError(
                f"joint {self.name!r}",
                f"its two axes have a cosine of {cosine:.3g}",
                f"perpendicular axes, |cosine| at most {AXIS_TOLERANCE:g}",
            )

    @property
    def motions(self) -> tuple[Motion, ...]:
        return (Motion("hinge", self.axis_on_first), Motion("hinge", self.axis_on_second))

    def constraints(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        cross_axes = Perpendicular(
            first.vector_to_body(self.axis_on_first), second.vector_to_body(self.axis_on_second)
        )
        return (*self._coincident(first, second), cross_axes)

    def coordinates(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        a, b = self.axis_on_first, self.axis_on_second
        return self._turn(a, b, first, second), Reversed(self._turn(b, a, second, first))


@dataclass(frozen=True, eq=False)
class _AxisJoint(Joint):
    """A joint with one axis that is common to both bodies."""

    axis: Array = field(kw_only=True)
    axis_names: ClassVar[tuple[str, ...]] = ("axis",)


@dataclass(frozen=True, eq=False)
class Revolute(_AxisJoint):
    """Hinge, eq. (27): five equations."""

    kind: ClassVar[str] = "revolute"

    @property
    def motions(self) -> tuple[Motion, ...]:
        return (Motion("hinge", self.axis),)

    def constraints(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        return self._coincident(first, second) + self._parallel(self.axis, first, second)

    def coordinates(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        return (self._turn(self.axis, perpendicular_pair(self.axis)[0], first, second),)


@dataclass(frozen=True, eq=False)
class Cylindrical(_AxisJoint):
    """Slide along and hinge about one axis: four equations, Phi^(p1,2) and Phi^(p2,2).

    Its coordinates are the displacement, then the angle.
    """

    kind: ClassVar[str] = "cylindrical"

    @property
    def motions(self) -> tuple[Motion, ...]:
        return (Motion("slide", self.axis), Motion("hinge", self.axis))

    def constraints(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        return self._parallel(self.axis, first, second) + self._on_line(self.axis, first, second)

    def coordinates(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        turn = self._turn(self.axis, perpendicular_pair(self.axis)[0], first, second)
        return self._slide(self.axis, first, second), turn


@dataclass(frozen=True, eq=False)
class Translational(_AxisJoint):
    """Slide without rotation, eq. (28): five equations, h_i and h_j across the axis."""

    kind: ClassVar[str] = "translational"

    @property
    def motions(self) -> tuple[Motion, ...]:
        return (Motion("slide", self.axis),)

    def constraints(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        h_i, h_j = perpendicular_pair(self.axis)
        return (
            *self._parallel(self.axis, first, second),
            *self._on_line(self.axis, first, second),
            Perpendicular(first.vector_to_body(h_i), second.vector_to_body(h_j)),
        )

    def coordinates(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        return (self._slide(self.axis, first, second),)


@dataclass(frozen=True, eq=False)
class Prismatic(Translational):
    """The paper's translational joint under the name that robot models give it."""

    kind: ClassVar[str] = "prismatic"


@dataclass(frozen=True, eq=False)
class Fixed(Joint):
    """No motion at all: six equations."""

    kind: ClassVar[str] = "fixed"

    def constraints(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        x, y, z = np.eye(3)
        return (
            *self._coincident(first, second),
            *(
                Perpendicular(first.vector_to_body(a), second.vector_to_body(b))
                for a, b in ((x, y), (y, z), (z, x))
            ),
        )


@dataclass(frozen=True, eq=False)
class Free(Joint):
    """All motion: no equation. It says that a body floats on purpose."""

    kind: ClassVar[str] = "free"

    @property
    def motions(self) -> tuple[Motion, ...]:
        x, y, z = np.eye(3)
        slides = (Motion("slide", x), Motion("slide", y), Motion("slide", z))
        return (*slides, Motion("ball", np.zeros(3)))

    def constraints(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        return ()

    def coordinates(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        return tuple(self._slide(axis, first, second) for axis in np.eye(3))


JOINT_KINDS: dict[str, type[Joint]] = {
    kind.kind: kind
    for kind in (
        Fixed,
        Revolute,
        Prismatic,
        Translational,
        Cylindrical,
        Universal,
        Spherical,
        Free,
    )
}
"""Joint classes by the name that files use."""
