"""Joint of two parallel hinges with a massless link between them, as in rolling contacts of feet, fingers and
knees.

`ParallelHinges` is the joint, `LinkAngle` its two coordinates, and `driving_wrench` the wrench with which
actuators at the two hinges drive the second body. Frames, spans, Jacobians and the methods of constraint
equations Phi = 0 are those of `newton_euler.model.constraints`; `gamma` is the right side of
Phi_q qddot = gamma.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Literal, Self

import numpy as np

from newton_euler.errors import MechanismError, check_flag, quoted, set_finite_arrays
from newton_euler.model.constraints import Angle, Constraint, Displacement, Distance, Frame, Jacobian, Span
from newton_euler.model.description import ArrayField, description
from newton_euler.model.fields import NumberField
from newton_euler.model.joint import MIN_POINT_DISTANCE, AxisJoint, Motion, Pose
from newton_euler.scalars import Array, arctan2, cross, sqrt


@dataclass(frozen=True, eq=False)
class LinkAngle:
    """The angle, rad, in (-pi, pi], of one of two parallel hinges that a massless link joins.

    Body i is the first body and body j the second. n is the hinge axis in body i. d is the vector from point
    s_first on the first axis to point s_second on the second axis; it is perpendicular to n. The link rotates
    relative to body i by x_1, and body j relative to the link by x_2:

        x_1 = angle about n from u to d,    x_2 = angle about n from d to p.

    The vector u is fixed in body i and p in body j; both are along d at the initial pose. Let t be the vector
    n x d / (d . d), and v the rate of d as seen in body i. Then dx_1/dt = t . v. The sum x_1 + x_2 is the
    `Angle` between the bodies.

    Attributes:
        hinge: 0 for x_1, 1 for x_2.
        sense: 1, or -1 if x_2 counts about -n; 1 for x_1.
        total_angle: the angle x_1 + x_2. Its triad in body i is (u, n x u, n) and its pointer is p.
        s_first: (3,) m, point on the first axis from the center of mass of body i, in the frame of body i.
        s_second: (3,) m, point on the second axis from the center of mass of body j, in the frame of body j.
    """

    hinge: Literal[0, 1]
    sense: float
    total_angle: Angle
    s_first: Array
    s_second: Array
    is_length = False
    count = 1

    def _link_vectors(self, first: Frame, second: Frame) -> tuple[Array, Span, Array]:
        """Compute the axis n (3,), the `Span` with d, and t = n x d / (d . d), (3,), world frame."""
        span = Span.of(first, second, self.s_first, self.s_second)
        axis = first.rotation @ cross(self.total_angle.u_first, self.total_angle.w_first)
        # d without a part along n, which only a violation of the constraints causes
        across = span.d - (axis @ span.d) * axis
        return axis, span, cross(axis, across) / (across @ across)

    def phi(self, first: Frame, second: Frame) -> Array:
        axis, span, _ = self._link_vectors(first, second)
        if self.hinge == 0:
            start, end = first.rotation @ self.total_angle.u_first, span.d
        else:
            start, end = span.d, second.rotation @ self.total_angle.pointer_second
        sine, cosine = axis @ cross(start, end), start @ end - (axis @ start) * (axis @ end)
        return np.array([arctan2(self.sense * sine, cosine)])

    def jacobian(self, first: Frame, second: Frame) -> Jacobian:
        # The Jacobian of x_1; that of x_2 is the difference of the total angle and x_1
        _, (s_i, s_j, d), t = self._link_vectors(first, second)
        of_x_1 = Jacobian(-t[None], -cross(s_i + d, t)[None], t[None], cross(s_j, t)[None])
        if self.hinge == 0:
            return of_x_1
        of_sum = self.total_angle.jacobian(first, second)
        return Jacobian(*(self.sense * (one - two) for one, two in zip(of_sum, of_x_1, strict=True)))

    def gamma(self, first: Frame, second: Frame) -> Array:
        axis, span, t = self._link_vectors(first, second)
        w, rate = first.angular_velocity, span.rate(first, second)
        relative_rate = rate - cross(w, span.d)  # v: the rate of d as seen in body i
        relative_drift = span.drift(first, second) - 2.0 * cross(w, rate) + cross(w, cross(w, span.d))
        across = span.d - (axis @ span.d) * axis
        # dx_1/dt is n . (d x v) / s with s = d . d; its derivative at zero acceleration is
        # t . dv/dt - 2 (d . v) (t . v) / s, which is -gamma
        turning = 2.0 * (across @ relative_rate) * (t @ relative_rate) / (across @ across)
        of_x_1 = np.array([turning - t @ relative_drift])
        return of_x_1 if self.hinge == 0 else self.sense * (self.total_angle.gamma(first, second) - of_x_1)


def driving_wrench(axes: Array, rates: Array, forces: Array) -> tuple[Array, Array]:
    """Compute the wrench on the second body that has the same power as torques at two parallel hinges.

    The force F is perpendicular to the link. It acts at the joint point, a point of the second body on one of
    the two axes. F and the torque T solve F . u_k + T . a_k = f_k for the hinges k = 1, 2.

    Args:
        axes: (2, 3) a_k, unit axes, world frame.
        rates: (2, 3) u_k, velocity of the joint point per rate of hinge k, m/rad; one of them is zero.
        forces: (2,) f_k, torques at the hinges, N m.

    Returns:
        F (3,), N, and T (3,), N m, world frame.
    """
    across = rates.sum(axis=0)  # perpendicular to the link: the other rate is zero
    axis = axes[0]
    force, torque = np.linalg.solve(np.stack([rates @ across, axes @ axis], axis=1), forces)
    return force * across, torque * axis


@description
class ParallelHinges(AxisJoint):
    """A hinge about `axis`, a massless link, and a hinge about a parallel axis: four constraint equations.

    The first axis passes through `point`, the second axis through `point_on_second`. The joint has two
    coordinates: the angle of the link relative to the first body, and the angle of the second body relative
    to the link. Use it for two hinges in a row whose axes are parallel: `Compound` needs axes that are not.

    Attributes:
        axis: (3,) direction of both axes, world at the initial pose, of any length.
        offset: (3,) m from the first axis to the second, world at the initial pose. Its part perpendicular to
            the axis is at least 1 micrometer long. `point_on_second` is `point` + `offset` unless it is
            given, as in a joint of which one point was displaced alone.
        opposed: True if the second angle counts about -`axis`.

    Raises:
        MechanismError: naming the joint and the invalid value, such as an offset for which the two axes
            coincide.

    Examples:
        >>> joint = ParallelHinges("toe", "ground", "body", [0, 0, 0], axis=[0, 1, 0], offset=[0.02, 0, 0])
        >>> joint.coordinate_kinds
        ('hinge', 'hinge')
    """

    offset: ArrayField = field(kw_only=True)
    opposed: bool = field(default=False, kw_only=True)
    kind: ClassVar[str] = "parallel_hinges"
    # Numbers of the joint that may vary from run to run. `shape` is None because the constructor checks the
    # offset. `moves_loops`: a change moves the poses in which loops are closed
    number_fields: ClassVar = AxisJoint.number_fields | {
        "offset": NumberField("m", shape=None, moves_loops=True)
    }
    # Attributes other than the axis that are vectors, which turn with the mechanism but do not move
    vector_names: ClassVar[tuple[str, ...]] = ("offset",)

    def __post_init__(self) -> None:
        given_point, where = self.point_on_second, f"joint {quoted(self.name)}"
        super().__post_init__()
        set_finite_arrays(self, where, offset=(3,))
        check_flag(where, self, "opposed")
        with np.errstate(all="ignore"):  # an overflow makes the length infinite, which is refused below
            across = float(np.linalg.norm(self._perpendicular_part(self.offset)))
        if not MIN_POINT_DISTANCE <= across < np.inf:
            problem = f"offset {self.offset.tolist()} puts its axes {across:.3g} m apart"
            raise MechanismError(
                where, problem, f"at least {MIN_POINT_DISTANCE:g} m, a revolute joint otherwise"
            )
        if given_point is None:
            object.__setattr__(self, "point_on_second", self.point + self.offset)

    def offset_between(self, axis: Array, point: Array, point_on_second: Array) -> Array:
        """Compute the offset (3,), m, of the joint at another pose of the mechanism.

        Its parts along and perpendicular to the axis have the lengths of those of `offset`. Only their
        directions follow from the points, so that round-off in the points does not change the lengths.

        Args:
            axis, point, point_on_second: (3,) the joint's unit axis and points (m) at the other pose, world
                frame.
        """
        old_across, link = self._perpendicular_part(self.offset), point_on_second - point
        new_across = link - (axis @ link) * axis
        stretch = np.sqrt((old_across @ old_across) / (new_across @ new_across))
        return np.asarray((self.axis @ self.offset) * axis + stretch * new_across)

    def _perpendicular_part(self, vector: Array) -> Array:
        """Return the part of a vector (3,) that is perpendicular to the axis."""
        return np.asarray(vector - (self.axis @ vector) * self.axis)

    def varied(self, values: Mapping[str, Any]) -> Self:
        """Return the joint with other numbers, unchecked, see `Joint.varied`.

        The offset, also a new one, turns with the axis. `span`, the vector between the joint points where the
        coordinates are zero, changes like the offset. A point that is displaced alone, which opens the joint
        at the initial pose, changes neither.
        """
        changed = super().varied({name: value for name, value in values.items() if name != "offset"})
        offset = np.asarray(values.get("offset", self.offset))
        moved = offset - self.offset
        if "axis" in values:
            # the base class turns the point on the second axis; the offset turns alike
            offset, moved = self._rotated_with_axis(changed, offset), self._rotated_with_axis(changed, moved)
        object.__setattr__(changed, "offset", offset)
        if "offset" in values:
            object.__setattr__(changed, "point_on_second", changed.point_on_second + moved)
            object.__setattr__(changed, "_span", changed.span + moved)
        return changed

    def rebuilt(self, values: Mapping[str, Any]) -> Self:
        # Like `varied`, but by the constructor, which checks the numbers
        changed = self.varied(values)
        fields: dict[str, Any] = {name: getattr(changed, name) for name in ("axis", "offset")}
        return replace(self, point=changed.point, point_on_second=changed.point_on_second, **fields)

    @property
    def motions(self) -> tuple[Motion, ...]:
        return Motion("hinge", self.axis), Motion("hinge", -self.axis if self.opposed else self.axis)

    @property
    def motion_points(self) -> tuple[Array, ...]:
        # A point on each axis at the initial pose, from that of the second body. If a point was displaced
        # alone, `point_gap` leads from `point` to the first
        return self.point_on_second - self.offset, self.point_on_second

    def _axis_points(self, first: Pose, second: Pose) -> tuple[Array, Array]:
        """Return a point on each axis, (3,), m, in the frames of their bodies.

        The line through both points is perpendicular to the axes.
        """
        along = (self.axis @ self.offset) * self.axis
        return first.point_to_body(self.point + along), second.point_to_body(self.point_on_second)

    def constraints(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        ends, across = self._axis_points(first, second), self._perpendicular_part(self.offset)
        # The axes stay parallel (`pair` is perpendicular to them); the distance of the points `ends` is
        # constant, and perpendicular to the axes
        return (
            *self._parallel(self.axis, self.pair, first, second),
            Displacement(first.vector_to_body(self.axis), *ends),
            Distance(*ends, sqrt(across @ across)),
        )

    def coordinates(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        across = self._perpendicular_part(self.offset)
        turn = self._hinge_coordinate(self.axis, across / sqrt(across @ across), first, second)
        assert isinstance(turn, Angle)
        ends = self._axis_points(first, second)
        return LinkAngle(0, 1.0, turn, *ends), LinkAngle(1, -1.0 if self.opposed else 1.0, turn, *ends)
