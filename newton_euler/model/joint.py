"""Joint: the base of all joint kinds.

A `Joint` is a description in the world frame at the mechanism's initial pose. `attach` ties it to
the two bodies' reference poses and gives `JointEquations`: Phi, Phi_q and gamma of its constraint
equations, and its coordinates. `motions` lists the elementary motions it allows, which is what a
spanning tree, an MJCF and a URDF are built from.

Joint coordinates are zero at the initial pose and measure the motion of the second body against
the first.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal, NamedTuple, Self

import numpy as np

from newton_euler.errors import MechanismError, check_flag, check_texts, finite_array, quoted, set_arrays
from newton_euler.model.constraints import (
    Angle,
    Coincidence,
    Constraint,
    Displacement,
    Frame,
    Jacobian,
    Perpendicular,
)
from newton_euler.model.description import ArrayField, DefaultArrayField, description
from newton_euler.model.fields import POINT, NumberField
from newton_euler.model.variable import Variable
from newton_euler.scalars import Array, Scalar, cross, sqrt

POINTS = ("point", "point_on_first", "point_on_second")
"""Displacements of joint points: of both bodies' own, of the first's, and of the second's."""

LEAST_LENGTH = 1e-6
"""m: points of a joint that are closer coincide, and the line through them has no direction."""

Key = tuple[str, int]
"""A joint coordinate: the name of its joint, and which of the joint's coordinates it is, from 0."""


MotionKind = Literal["hinge", "slide", "ball"]


class Motion(NamedTuple):
    """One elementary motion of the second body against the first."""

    kind: MotionKind
    axis: Array
    """(3,) unit axis in the world at the initial pose; unused for a ball."""


BALL_MOTION = Motion("ball", np.zeros(3))


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
    `is_length` (k,) tells rows in meters from rows in radians.
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
        """Compute units (k,) of the equations: `size` (m) for lengths, 1 for angles."""
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

    def measure(self, coordinate: int, frames: Sequence[Frame]) -> tuple[Scalar, Scalar]:
        """Measure a coordinate, m or rad from the initial pose, and its rate, at frames of all bodies."""
        measure, ends = self.coordinates[coordinate], (frames[self.first], frames[self.second])
        return measure.phi(*ends)[0], measure.jacobian(*ends).rate(*ends)[0]


def perpendicular_pair(axis: Array, described: Array | None = None) -> tuple[Array, Array]:
    """Compute unit vectors u and w that make (u, w, axis) right-handed and orthonormal; axis (3,) unit.

    They are chosen by the description's own axis where that is given, and another one varies from it.
    """
    own = axis if described is None else described
    helper = np.zeros(3)
    # the first of the smallest components: their last digits, which processors differ in, choose nothing
    helper[int(np.argmin(np.abs(own).round(6)))] = 1.0
    w = cross(axis, helper)
    w /= np.linalg.norm(w)
    return cross(w, axis), w


def unit_vector(joint: str, name: str, value: object) -> Array:
    """Return a read-only array (3,) of norm 1 along an axis of a joint; raises `MechanismError`."""
    vector = finite_array(f"joint {quoted(joint)}", name, value, (3,))
    largest = float(np.max(np.abs(vector)))
    if largest < 1e-12:
        raise MechanismError(f"joint {quoted(joint)}", f"{name} is {vector.tolist()}", "a non-zero axis")
    vector = np.ldexp(vector, -np.frexp(largest)[1])  # exact, and no square can overflow
    vector /= np.linalg.norm(vector)
    vector.flags.writeable = False
    return vector


@description
class Joint(Variable):
    """A joint: what all kinds have in common.

    Attributes:
        name: unique in its mechanism.
        first, second: names of the two bodies; reactions are those acting on the second.
        point: (3,) joint point in the world at the initial pose, meters.
        point_on_second: (3,) the second body's own joint point where it is another one; it must
            lie where the joint's constraints allow it. Reactions are reduced to this point.
        actuated: whether a control law may drive the joint.
    """

    name: str
    first: str
    second: str
    point: ArrayField
    point_on_second: DefaultArrayField = field(default=None, kw_only=True)  # type: ignore[assignment]
    actuated: bool = field(default=False, kw_only=True)

    kind: ClassVar[str]
    number_fields: ClassVar = {
        "point": replace(POINT, moves_loops=True),
        "point_on_first": replace(POINT, moves_loops=True, opens_joints=True),
        "point_on_second": replace(POINT, moves_loops=True, opens_joints=True),
    }
    axis_names: ClassVar[tuple[str, ...]] = ()
    vector_names: ClassVar[tuple[str, ...]] = ()
    """Attributes that are vectors (3,), or rows of them, beside those of `axis_names`."""
    only_closes: ClassVar[bool] = False
    """True for a joint that no `motions` describe, so that it can only close loops of a tree."""
    apart = np.zeros(3)
    """(3,) by which the second body's point is displaced more than the first's, where points vary."""

    def __post_init__(self) -> None:
        check_texts(f"joint {quoted(self.name)}", self, "name", "first", "second")
        check_flag(f"joint {quoted(self.name)}", self, "actuated")
        if self.point_on_second is None:
            object.__setattr__(self, "point_on_second", self.point)
        set_arrays(self, f"joint {quoted(self.name)}", point=(3,), point_on_second=(3,))
        for name in self.axis_names:
            object.__setattr__(self, name, unit_vector(self.name, name, getattr(self, name)))

    @property
    def variables(self) -> tuple[str, ...]:
        return tuple(self.number_fields)

    @property
    def described(self) -> Self:
        """The joint as it is described, of one whose points and axes vary, see `varied`."""
        own: Self = vars(self).get("_described", self)
        return own

    @property
    def span(self) -> Array:
        """(3,) from the first body's point to the second's where the coordinates are zero."""
        return vars(self).get("_span", self.reaction_point - self.point)

    def varied(self, values: Mapping[str, Any]) -> Self:
        """Return the joint with other numbers, scalars of any kind, which are not checked.

        Its coordinates stay zero where those of the described joint are: they measure how the bodies are
        rotated against each other, and how far its points are from where they are described.

        Args:
            values: `point`, `point_on_first` and `point_on_second`, displacements (3,) of both points or of
                one alone, and other attributes by their names; axes of any length.
        """
        changed, none = copy.copy(self), np.zeros(3)
        both, first, second = (values.get(name, none) for name in POINTS)
        fields = {name: value for name, value in values.items() if name not in POINTS}
        for name in self.axis_names:
            if name in fields:
                fields[name] = fields[name] / sqrt(fields[name] @ fields[name])
        if not values.keys().isdisjoint(POINTS):
            fields["point"] = self.point + both + first
            fields["point_on_second"] = self.reaction_point + both + second
            fields["apart"] = second - first
        for name, value in fields.items():
            object.__setattr__(changed, name, value)
        object.__setattr__(changed, "_described", self.described)
        object.__setattr__(changed, "_span", self.span)
        return changed

    def rebuilt(self, values: Mapping[str, Any]) -> Self:
        """Return the joint made anew with these numbers, as of `varied`, checked."""
        fields: dict[str, Any] = {name: value for name, value in values.items() if name not in POINTS}
        replace(self, **fields)
        moved = self.varied(values)
        return replace(self, point=moved.point, point_on_second=moved.point_on_second, **fields)

    @property
    def reaction_point(self) -> Array:
        """(3,) the joint point fixed in the second body, in the world at the initial pose."""
        return self.point_on_second

    @property
    def motions(self) -> tuple[Motion, ...]:
        """The elementary motions of the second body against the first, in their order."""
        return ()

    @property
    def motion_points(self) -> tuple[Array, ...]:
        """Point (3,) of each of `motions` in the world at the initial pose: on a hinge's axis, a ball's
        center, or the point at which a slide acts."""
        return (self.reaction_point,) * len(self.motions)

    @property
    def coordinate_kinds(self) -> tuple[str, ...]:
        """ "hinge" or "slide" for each of the joint's coordinates."""
        return tuple(motion.kind for motion in self.motions if motion.kind != "ball")

    def constraints(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        """Write the joint's constraint equations between bodies with these reference poses."""
        raise NotImplementedError

    def coordinates(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        """Define a coordinate for each hinge and slide among `motions`; here of slides alone."""
        slides = (motion.axis for motion in self.motions if motion.kind == "slide")
        return tuple(self._slide(axis, first, second) for axis in slides)

    def attach(self, first: int, first_pose: Pose, second: int, second_pose: Pose) -> JointEquations:
        """Tie the joint to bodies number `first` and `second` at their reference poses."""
        poses = first_pose, second_pose
        return JointEquations(self, first, second, self.constraints(*poses), self.coordinates(*poses))

    # Constraint sets of Appendix A, from which the joint kinds are built

    def _coincident(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        """Phi^(s,3), eq. (25)."""
        return (Coincidence(first.point_to_body(self.point), second.point_to_body(self.reaction_point)),)

    def _parallel(
        self, axis: Array, pair: tuple[Array, Array], first: Pose, second: Pose
    ) -> tuple[Constraint, ...]:
        """Phi^(p1,2), eq. (27): tilde(s_i) s_j = 0.

        Of its three components the two along u and w of body i, the pair, are kept (-w.s_j and u.s_j); the
        third, along the axis itself, is zero whatever the bodies do.
        """
        s_j = second.vector_to_body(axis)
        return tuple(Perpendicular(first.vector_to_body(a), s_j) for a in pair)

    def _on_line(self, pair: tuple[Array, Array], first: Pose, second: Pose) -> tuple[Constraint, ...]:
        """Phi^(p2,2), eq. (28): tilde(s_i) d = 0, again its two components across the axis."""
        return tuple(self._displacement(a, 0.0, first, second) for a in pair)

    def _aligned(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        """Keep the second body's orientation that of the first."""
        x, y, z = np.eye(3)
        pairs = (x, y), (y, z), (z, x)
        return tuple(Perpendicular(first.vector_to_body(a), second.vector_to_body(b)) for a, b in pairs)

    def _slide(self, axis: Array, first: Pose, second: Pose) -> Constraint:
        """Define the displacement of the second body's point along an axis of the first."""
        return self._displacement(axis, axis @ self.span, first, second)

    def _displacement(self, axis: Array, offset: Any, first: Pose, second: Pose) -> Constraint:
        """Compute the second body's displacement along an axis of the first, less an offset, m."""
        ends = first.point_to_body(self.point), second.point_to_body(self.reaction_point)
        return Displacement(first.vector_to_body(axis), *ends, offset=offset)

    def _turn(self, axis: Array, pointer: Array, first: Pose, second: Pose) -> Constraint:
        """Define the angle about `axis` of `pointer`, a vector of the second body perpendicular to it."""
        return Angle(
            first.vector_to_body(pointer),
            first.vector_to_body(cross(axis, pointer)),
            second.vector_to_body(pointer),
        )


@description
class AxisJoint(Joint):
    """A joint with one axis that is common to both bodies."""

    axis: ArrayField = field(kw_only=True)
    axis_names: ClassVar[tuple[str, ...]] = ("axis",)
    number_fields: ClassVar = Joint.number_fields | {
        "axis": NumberField(shape=None, allowed="axis", moves_loops=True)
    }
    along: ClassVar[tuple[MotionKind, ...]] = ()
    """Motions along and about the axis, in their order."""

    @property
    def pair(self) -> tuple[Array, Array]:
        """Unit vectors (3,) across the axis, see `perpendicular_pair`."""
        return perpendicular_pair(self.axis, self.described.axis)

    @property
    def motions(self) -> tuple[Motion, ...]:
        return tuple(Motion(kind, self.axis) for kind in self.along)

    def coordinates(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        slides = super().coordinates(first, second)
        if "hinge" not in self.coordinate_kinds:
            return slides
        return (*slides, self._turn(self.axis, self.pair[0], first, second))

    def varied(self, values: Mapping[str, Any]) -> Self:
        """See `Joint.varied`; the second body's point stays on the axis, or plane, of the first."""
        changed, span = super().varied(values), self.span
        if "axis" in values and np.any(span):
            turned = self._turned(changed, span)
            object.__setattr__(changed, "point_on_second", changed.point_on_second + (turned - span))
            object.__setattr__(changed, "_span", turned)
        return changed

    def _turned(self, changed: AxisJoint, vector: Array) -> Array:
        """Return a vector (3,) that turns as the axis and pair turn into those of the changed joint."""
        own = np.column_stack([*self.pair, self.axis])
        return np.asarray(np.column_stack([*changed.pair, changed.axis]) @ (own.T @ vector))
