"""Base classes of all joints.

A `Joint` is described in the world frame at the mechanism's initial pose. `Joint.attach` converts the
description to `JointEquations` between two bodies: residual Phi, Jacobian Phi_q and right side gamma of the
constraint equations, and the joint coordinates. `Joint.motions` lists the elementary motions (hinges, slides,
balls) that the joint allows. Spanning trees, MJCF files and URDF files are built from this list.

Joint coordinates measure the motion of the second body relative to the first body and are zero at the initial
pose. The numbers of a joint may vary from run to run. `Joint.varied` makes such a variation, whose
coordinates keep their zeros. `Joint.rebuilt` describes a joint anew: its coordinates are zero at the new
initial pose.

Equation numbers are those of S. Srang, S. Ath and M. Yamakita, Advances in Science, Technology and
Engineering Systems Journal 5(5), 2020, doi:10.25046/aj050587, Appendix A.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal, NamedTuple, Self

import numpy as np

from newton_euler.errors import (
    MechanismError,
    check_flag,
    check_texts,
    finite_array,
    quoted,
    set_finite_arrays,
)
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
"""Names of the parameters that displace joint points: `point` displaces the points of both bodies by the same
vector, the other two displace the point of one body."""

MIN_POINT_DISTANCE = 1e-6
"""Smallest distance, m, of the two ends of a rod or of two parallel hinges; the direction from one to the
other would depend on round-off if they were closer."""

Key = tuple[str, int]
"""A joint coordinate: the name of its joint, and the index of the coordinate in the joint, from 0."""


MotionKind = Literal["hinge", "slide", "ball"]
"""Kind of an elementary motion: rotation about an axis, translation along an axis, or free rotation about a
point."""


class Motion(NamedTuple):
    """One elementary motion of the second body of a joint relative to the first body."""

    kind: MotionKind
    axis: Array
    """(3,) unit axis in the world at the initial pose; unused for a ball."""


BALL_MOTION = Motion("ball", np.zeros(3))
"""The elementary motion of a ball, which has no axis."""


class Pose(NamedTuple):
    """Pose of a body frame at the mechanism's initial pose, to convert points and vectors from the world to
    the body frame."""

    position: Array
    """(3,) origin of the body frame (center of mass), m, world."""
    rotation: Array
    """(3, 3) rotation matrix: takes body-frame components to world components."""

    def point_to_body(self, point: Array) -> Array:
        """Convert a point (3,), m, from the world at the initial pose to the body frame."""
        return np.asarray(self.rotation.T @ (point - self.position))

    def vector_to_body(self, vector: Array) -> Array:
        """Convert a vector (3,) from world components at the initial pose to body-frame components."""
        return np.asarray(self.rotation.T @ vector)


@dataclass(frozen=True, eq=False)
class JointEquations:
    """The k constraint equations and the coordinates of one joint between two bodies of a mechanism.

    The methods stack the results of the elementary constraints, see `newton_euler.model.constraints`.

    Attributes:
        joint: description of the joint.
        first, second: indices of the two bodies in `Mechanism.bodies`.
        constraints: elementary constraints, with k scalar equations in total.
        coordinates: joint coordinates, one for each hinge and slide of the joint; their `phi` is the
            coordinate.
    """

    joint: Joint
    first: int
    second: int
    constraints: tuple[Constraint, ...]
    coordinates: tuple[Constraint, ...]

    @property
    def count(self) -> int:
        """Number k of scalar constraint equations."""
        return sum(c.count for c in self.constraints)

    @property
    def is_length(self) -> Array:
        """(k,) True for residuals in meters, False for residuals in radians."""
        return np.concatenate([np.zeros(0, bool), *(np.full(c.count, c.is_length) for c in self.constraints)])

    def units(self, size: float) -> Array:
        """Return the scale (k,) of each residual: `size`, m, for lengths and 1 for angles."""
        return np.where(self.is_length, size, 1.0)

    def phi(self, first: Frame, second: Frame) -> Array:
        """Compute the residuals Phi (k,), m or rad, at the frames of the two bodies."""
        return np.concatenate([np.zeros(0), *(c.phi(first, second) for c in self.constraints)])

    def gamma(self, first: Frame, second: Frame) -> Array:
        """Compute the right side gamma (k,) of Phi_q qddot = gamma at the frames of the two bodies."""
        return np.concatenate([np.zeros(0), *(c.gamma(first, second) for c in self.constraints)])

    def jacobian(self, first: Frame, second: Frame) -> Jacobian:
        """Compute the Jacobian Phi_q, four blocks (k, 3), at the frames of the two bodies."""
        blocks = [c.jacobian(first, second) for c in self.constraints]
        empty = np.zeros((0, 3))
        if not blocks:
            return Jacobian(empty, empty, empty, empty)
        return Jacobian(*(np.concatenate([empty, *column]) for column in zip(*blocks, strict=True)))

    def measure(self, coordinate: int, frames: Sequence[Frame]) -> tuple[Scalar, Scalar]:
        """Measure a joint coordinate, m or rad from the initial pose, and its rate.

        Args:
            coordinate: index of the coordinate in the joint, from 0.
            frames: frames of all bodies of the mechanism.
        """
        measure, ends = self.coordinates[coordinate], (frames[self.first], frames[self.second])
        return measure.phi(*ends)[0], measure.jacobian(*ends).rate(*ends)[0]


def perpendicular_pair(axis: Array, described: Array | None = None) -> tuple[Array, Array]:
    """Compute unit vectors u and w, (3,) each, such that (u, w, axis) is right-handed and orthonormal.

    Args:
        axis: (3,) unit axis; floats, or expressions of the code generator, on which NumPy's norm works too.
        described: (3,) unit axis as described, if `axis` is a variation of it. The choice among all possible
            pairs then depends on the described axis only, so that the pair varies continuously with `axis`.
    """
    chosen_by = axis if described is None else described
    helper = np.zeros(3)
    # The helper is the coordinate axis of the smallest component. Rounding makes the choice independent of
    # the last digits, which differ from processor to processor
    helper[int(np.argmin(np.abs(chosen_by).round(6)))] = 1.0
    w = cross(axis, helper)
    w /= np.linalg.norm(w)
    return cross(w, axis), w


def unit_vector(joint: str, name: str, value: object) -> Array:
    """Convert an axis of a joint to a read-only unit vector (3,).

    Args:
        joint: name of the joint, for error messages.
        name: name of the axis, for error messages.
        value: the axis, three numbers; the length does not matter.

    Raises:
        MechanismError: for an axis whose components are all below 1e-12, and anything but three finite
            numbers.
    """
    vector = finite_array(f"joint {quoted(joint)}", name, value, (3,))
    largest = float(np.max(np.abs(vector)))
    if largest < 1e-12:
        raise MechanismError(f"joint {quoted(joint)}", f"{name} is {vector.tolist()}", "a non-zero axis")
    vector = np.ldexp(vector, -np.frexp(largest)[1])  # exact scaling, so that no square overflows
    vector /= np.linalg.norm(vector)
    vector.flags.writeable = False
    return vector


@description
class Joint(Variable):
    """Base class of all joints, which are frozen dataclasses and compared by identity.

    Attributes:
        name: unique in its mechanism.
        first, second: names of the two bodies. Reactions are the force and torque on the second body.
        point: (3,) joint point, m, world at the initial pose.
        point_on_second: (3,) joint point of the second body, m, world at the initial pose; `point` if it is
            not given. It must satisfy the constraints of the joint. Reaction torques are about this point.
        actuated: True if a control law may drive the joint.
    """

    name: str
    first: str
    second: str
    point: ArrayField
    point_on_second: DefaultArrayField = field(default=None, kw_only=True)  # type: ignore[assignment]
    actuated: bool = field(default=False, kw_only=True)

    kind: ClassVar[str]
    """Name of the kind of joint in scene files."""
    # Numbers of the joint that may vary from run to run. `moves_loops`: a change has the effect that loops
    # close in other poses. `opens_joints`: a change violates the joint's constraints at the initial pose
    number_fields: ClassVar = {
        "point": replace(POINT, moves_loops=True),
        "point_on_first": replace(POINT, moves_loops=True, opens_joints=True),
        "point_on_second": replace(POINT, moves_loops=True, opens_joints=True),
    }
    axis_names: ClassVar[tuple[str, ...]] = ()
    """Names of the attributes that are unit axes (3,)."""
    vector_names: ClassVar[tuple[str, ...]] = ()
    """Names of other attributes that are vectors (3,), or arrays of vectors (n, 3)."""
    only_closes: ClassVar[bool] = False
    """True for a joint that is not a sequence of elementary motions (a rod), and so can only close a loop of
    a spanning tree."""
    point_gap = np.zeros(3)
    """(3,) m, displacement of the second body's point minus that of the first body's point; zero in joints
    that you describe, and nonzero in variations of a joint, as in a tolerance study."""

    def __post_init__(self) -> None:
        check_texts(f"joint {quoted(self.name)}", self, "name", "first", "second")
        check_flag(f"joint {quoted(self.name)}", self, "actuated")
        if self.point_on_second is None:
            object.__setattr__(self, "point_on_second", self.point)
        set_finite_arrays(self, f"joint {quoted(self.name)}", point=(3,), point_on_second=(3,))
        for name in self.axis_names:
            object.__setattr__(self, name, unit_vector(self.name, name, getattr(self, name)))

    @property
    def variables(self) -> tuple[str, ...]:
        """Names of the numbers that may vary from run to run."""
        return tuple(self.number_fields)

    @property
    def described(self) -> Self:
        """The joint as the user described it, of which this joint may be a variation made by `varied`."""
        described: Self = vars(self).get("_described", self)
        return described

    @property
    def span(self) -> Array:
        """(3,) m, from the first body's point to the second body's point at the relative pose where the
        coordinates are zero, world at the initial pose. Displaced joint points do not change it."""
        return vars(self).get("_span", self.point_on_second - self.point)

    def varied(self, values: Mapping[str, Any]) -> Self:
        """Copy the joint with other, unchecked numbers, which may be generic scalars such as symbols.

        The coordinates of the copy are zero where the relative orientation of the bodies and the vector
        `span` between the joint points are those of the described joint. If only one point is displaced, the
        bodies are therefore displaced relative to each other at the zero.

        Args:
            values: new values by name: displacements (3,) of the points of this joint, see `POINTS`, axes
                (3,) of any length, and other attributes.
        """
        changed, zero = copy.copy(self), np.zeros(3)
        both, first, second = (values.get(name, zero) for name in POINTS)
        fields = {name: value for name, value in values.items() if name not in POINTS}
        for name in self.axis_names:
            if name in fields:
                fields[name] = fields[name] / sqrt(fields[name] @ fields[name])
        if not values.keys().isdisjoint(POINTS):
            fields["point"] = self.point + both + first
            fields["point_on_second"] = self.point_on_second + both + second
            fields["point_gap"] = self.point_gap + (second - first)
        for name, value in fields.items():
            object.__setattr__(changed, name, value)
        object.__setattr__(changed, "_described", self.described)
        object.__setattr__(changed, "_span", self.span)
        return changed

    def rebuilt(self, values: Mapping[str, Any]) -> Self:
        """Construct the joint again with other numbers, with the checks of the constructor.

        The result is a described joint: its coordinates are zero at its own points and axes, without a gap.

        Args:
            values: new values by name, as for `varied`.

        Raises:
            MechanismError: for a value that the constructor refuses.
        """
        fields: dict[str, Any] = {name: value for name, value in values.items() if name not in POINTS}
        replace(self, **fields)  # checks the values before any arithmetic with them
        moved = self.varied(values)
        return replace(self, point=moved.point, point_on_second=moved.point_on_second, **fields)

    @property
    def motions(self) -> tuple[Motion, ...]:
        """Elementary motions of the second body relative to the first, in order from the first body to the
        second."""
        return ()

    @property
    def motion_points(self) -> tuple[Array, ...]:
        """Point (3,), m, of each of `motions`, world at the initial pose.

        It is a point on the axis of a hinge, the center of a ball, or the point at which a slide's force
        acts.
        """
        return (self.point_on_second,) * len(self.motions)

    @property
    def coordinate_kinds(self) -> tuple[str, ...]:
        """Kind of each joint coordinate, "hinge" or "slide"."""
        return tuple(motion.kind for motion in self.motions if motion.kind != "ball")

    def constraints(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        """Return the constraint equations of the joint.

        Args:
            first, second: poses of the two body frames at the initial pose.
        """
        raise NotImplementedError

    def coordinates(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        """Return the joint coordinates, one for each hinge and slide among `motions`, as measured quantities.

        The base class covers joints whose only coordinates are slides.

        Args:
            first, second: poses of the two body frames at the initial pose.
        """
        slides = (motion.axis for motion in self.motions if motion.kind == "slide")
        return tuple(self._slide_coordinate(axis, first, second) for axis in slides)

    def attach(self, first: int, first_pose: Pose, second: int, second_pose: Pose) -> JointEquations:
        """Return the equations of the joint between two bodies of a mechanism.

        Args:
            first, second: indices of the bodies.
            first_pose, second_pose: poses of their body frames at the initial pose.
        """
        poses = first_pose, second_pose
        return JointEquations(self, first, second, self.constraints(*poses), self.coordinates(*poses))

    # Sets of constraints from which the joint kinds are built. The arguments `first` and `second` are the
    # poses of the two body frames at the initial pose; axes and other vectors (3,) are in the world at the
    # initial pose

    def _coincident(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        """Return three equations, eq. (25): the joint points of both bodies coincide."""
        return (Coincidence(first.point_to_body(self.point), second.point_to_body(self.point_on_second)),)

    def _parallel(
        self, axis: Array, pair: tuple[Array, Array], first: Pose, second: Pose
    ) -> tuple[Constraint, ...]:
        """Return two equations, eq. (27): an axis s_i of the first body and s_j of the second body stay
        parallel.

        The cross product s_i x s_j must vanish. Its component along s_i is always zero; the other two
        components are -w . s_j and u . s_j, where (u, w) is the pair of vectors of the first body
        perpendicular to the axis, see `perpendicular_pair`.
        """
        s_j = second.vector_to_body(axis)
        return tuple(Perpendicular(first.vector_to_body(a), s_j) for a in pair)

    def _on_line(self, pair: tuple[Array, Array], first: Pose, second: Pose) -> tuple[Constraint, ...]:
        """Return two equations, eq. (28): the second body's point stays on the joint's axis in the first
        body.

        The vector between the joint points has no component along the pair of vectors perpendicular to the
        axis.
        """
        return tuple(self._displacement(a, 0.0, first, second) for a in pair)

    def _aligned(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        """Return three equations: the orientation of the second body relative to the first stays constant."""
        x, y, z = np.eye(3)
        pairs = (x, y), (y, z), (z, x)
        return tuple(Perpendicular(first.vector_to_body(a), second.vector_to_body(b)) for a, b in pairs)

    def _slide_coordinate(self, axis: Array, first: Pose, second: Pose) -> Constraint:
        """Return the coordinate of a slide: the displacement of the second body's point along an axis of the
        first body, m."""
        return self._displacement(axis, axis @ self.span, first, second)

    def _displacement(self, axis: Array, offset: Any, first: Pose, second: Pose) -> Constraint:
        """Return the displacement of the second body's point along an axis of the first body, minus an
        offset, m."""
        ends = first.point_to_body(self.point), second.point_to_body(self.point_on_second)
        return Displacement(first.vector_to_body(axis), *ends, offset=offset)

    def _hinge_coordinate(self, axis: Array, pointer: Array, first: Pose, second: Pose) -> Constraint:
        """Return the coordinate of a hinge: the angle about an axis of the first body.

        Args:
            axis: unit axis.
            pointer: unit vector of the second body, perpendicular to the axis; the angle counts its rotation
                from the initial pose.
            first, second: poses of the two body frames at the initial pose.
        """
        return Angle(
            first.vector_to_body(pointer),
            first.vector_to_body(cross(axis, pointer)),
            second.vector_to_body(pointer),
        )


@description
class AxisJoint(Joint):
    """Base class of joints with one axis that is common to both bodies.

    Attributes:
        axis: (3,) axis, world at the initial pose, of any nonzero length; stored as a unit vector.
        motion_kinds: kinds of the elementary motions along and about the axis, in order.
    """

    axis: ArrayField = field(kw_only=True)
    axis_names: ClassVar[tuple[str, ...]] = ("axis",)
    # `shape` is None because `unit_vector` checks the axis. `allowed` is a rule of
    # `newton_euler.model.fields.AllowedValues`: the smallest component of the axis must remain the smallest,
    # so that `pair` varies continuously
    number_fields: ClassVar = Joint.number_fields | {
        "axis": NumberField(shape=None, allowed="axis", moves_loops=True)
    }
    motion_kinds: ClassVar[tuple[MotionKind, ...]] = ()

    @property
    def pair(self) -> tuple[Array, Array]:
        """Two unit vectors u and w, (3,), perpendicular to the axis and to each other, see
        `perpendicular_pair`."""
        return perpendicular_pair(self.axis, self.described.axis)

    @property
    def motions(self) -> tuple[Motion, ...]:
        return tuple(Motion(kind, self.axis) for kind in self.motion_kinds)

    def coordinates(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        slides = super().coordinates(first, second)
        if "hinge" not in self.coordinate_kinds:
            return slides
        return (*slides, self._hinge_coordinate(self.axis, self.pair[0], first, second))

    def varied(self, values: Mapping[str, Any]) -> Self:
        """Copy the joint with other, unchecked numbers, see `Joint.varied`.

        If the axis varies, the vector between the joint points turns with the axis. The second body's point
        then stays on the axis fixed in the first body, or in the plane perpendicular to it.
        """
        changed, span = super().varied(values), self.span
        if "axis" in values and np.any(span):
            rotated = self._rotated_with_axis(changed, span)
            object.__setattr__(changed, "point_on_second", changed.point_on_second + (rotated - span))
            object.__setattr__(changed, "_span", rotated)
        return changed

    def _rotated_with_axis(self, changed: AxisJoint, vector: Array) -> Array:
        """Rotate a vector (3,) by the rotation that takes this joint's axis and `pair` to those of another
        joint."""
        triad = np.column_stack([*self.pair, self.axis])
        changed_triad = np.column_stack([*changed.pair, changed.axis])
        return np.asarray(changed_triad @ (triad.T @ vector))
