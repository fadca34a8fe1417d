"""Angles and constraints of two or three hinges in a row between two bodies i and j.

`newton_euler.model.compound_joint.Compound` builds its coordinates and constraints from these classes. Those
with a method `phi` are `newton_euler.model.constraints.Constraint`s: `count` equations with the residual phi,
in meters if `is_length`, else in radians, and the right side gamma of Phi_q qddot = gamma.

Angles. The first axis is fixed in body i and the last axis in body j. The middle one of three axes is fixed
in the massless links. It keeps its angles to the other two axes, and stays on one side of their plane. The
orientations of the bodies therefore determine it, unless all three axes are in one plane (gimbal lock).
Let a_k be the unit axes, x_k the angles, x_k' their rates, omega and alpha the angular velocity and
acceleration of a body. Then

    omega_j - omega_i = sum_k x_k' a_k
    x_k' = d_k . (omega_j - omega_i),    d_k . a_m = 1 for m = k, else 0
    x_k'' = d_k . (alpha_j - alpha_i) - gamma_k,    gamma_k = d_k . sum_m x_m' da_m/dt.

The vectors d_k are called dual axes (Featherstone, Rigid Body Dynamics Algorithms, 2008, section 4.4).

Points. The axes need not meet. The offset o_k leads from the axis of hinge k to the axis of hinge k + 1. It
is fixed in the link between the hinges: o_k = u a_k + v a_k+1 + w a_k x a_k+1 with constants u, v and w. The
middle axis of three rotates with the angular velocity omega_i + x_1' a_1. Let r be the center of mass of a
body, and s_i and s_j vectors from there to points on the first and the last axis. The separation

    D = r_j + s_j - r_i - s_i - sum_k o_k

is 0 if only hinges join the bodies. If slides come before the hinges, D is the displacement of the slides.
Numbers may be floats or symbols of the code generator (`newton_euler.scalars`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from newton_euler.model.constraints import Frame, Jacobian, Span
from newton_euler.scalars import Array, Scalar, arctan2, cross, sqrt, tilde

_ZERO = np.zeros((1, 3))  # Jacobian block of an angle, which does not depend on positions

RIGHT_ANGLE_COSINE = 1e-14
"""Cosine of the angle between two axes below which it is set to exactly 0, so that generated code omits its
products."""


def dual_axes(axes: Array) -> Array:
    """Compute the dual axes (..., n, 3) of n independent axes (..., n, 3), n at most 3.

    The dual axis d_k is in the span of the axes, with d_k . a_m = 1 for m = k and 0 for other m.
    """
    if axes.shape[-2] == 1:  # the most frequent case, much faster than a pseudoinverse
        return axes / np.sum(axes * axes, axis=-1, keepdims=True)
    if axes.dtype == object:  # generic scalars, for which NumPy has no pseudoinverse; no leading dimensions
        return np.array(_duals([*axes]))
    return np.swapaxes(np.linalg.pinv(axes), -1, -2)


def _duals(axes: Sequence[Array]) -> list[Array]:
    """Compute the dual axes, (3,) each, of two or three axes; see `dual_axes`."""
    a, b, c = axes if len(axes) == 3 else (*axes, cross(*axes))
    normals = cross(b, c), cross(c, a), cross(a, b)
    volume = a @ normals[0]
    return [normal / volume for normal in normals[: len(axes)]]


class Axis(NamedTuple):
    """A hinge axis a in the world frame at a state of the two bodies i and j, with its derivatives."""

    value: Array
    """(3,) unit vector a."""
    by_first: Array
    """(3, 3) derivative of a with respect to the virtual rotation theta_i of body i."""
    by_second: Array
    """(3, 3) derivative of a with respect to the virtual rotation theta_j of body j."""
    rate: Array
    """(3,) first derivative da/dt, 1/s."""
    drift: Array
    """(3,) second derivative d2a/dt2, 1/s^2, if both bodies have zero acceleration."""


def _body_fixed(axis: Array, omega: Array, in_first: bool) -> Axis:
    """Describe an axis that is fixed in one of the two bodies.

    Args:
        axis: (3,) unit axis, world frame.
        omega: (3,) angular velocity of the body, rad/s, world frame.
        in_first: True if the axis is fixed in the first body, False for the second body.
    """
    rate, by_rotation, none = cross(omega, axis), -tilde(axis), np.zeros((3, 3))
    by_first, by_second = (by_rotation, none) if in_first else (none, by_rotation)
    return Axis(axis, by_first, by_second, rate, drift=cross(omega, rate))


@dataclass(frozen=True, eq=False)
class HingeRow:
    """Two or three hinges in a row between bodies i and j, with the constant angles between their axes.

    Attributes:
        first_axis: (3,) unit axis of the first hinge in the frame of body i.
        second_axis: (3,) unit axis of the second hinge at the initial pose, in the frame of body i.
        last_axis: (3,) unit axis of the last hinge in the frame of body j.
        next_to_last_axis: (3,) unit axis of the hinge before the last one at the initial pose, in the frame
            of body j.
        cosines: a_1 . a_2 and a_2 . a_3 of three axes, which are constant; None for two hinges.
        sine: a_2 . (a_1 x a_3) of three axes at the initial pose: the sine of the angle about a_2 from a_1 to
            a_3, times a factor.
        cosine: a_1 . a_3 - (a_1 . a_2)(a_2 . a_3) of three axes at the initial pose: the cosine of the same
            angle, times the same factor.
        side: sign of `sine`: the side of the plane of a_1 and a_3 on which a_2 is.
    """

    first_axis: Array
    second_axis: Array
    last_axis: Array
    next_to_last_axis: Array
    cosines: tuple[float, float] | None = None
    sine: float = 0.0
    cosine: float = 0.0
    side: float = 1.0

    def axes(self, first: Frame, second: Frame) -> list[Array]:
        """Compute the unit axes of all hinges, (3,) each, world frame."""
        a, c = first.rotation @ self.first_axis, second.rotation @ self.last_axis
        if self.cosines is None:
            return [a, c]
        # The middle axis is b = on_a a + on_c c + across a x c. The coefficients follow from a . b = p,
        # b . c = r, a . c = s and |b| = 1
        p, r = (0.0 if _is_right_angle(cosine) else cosine for cosine in self.cosines)
        s = a @ c
        sine2 = 1.0 - s * s
        on_a, on_c = (p - r * s) / sine2, (r - p * s) / sine2
        across2 = (1.0 - on_a * on_a - on_c * on_c - 2.0 * on_a * on_c * s) / sine2
        across = self.side * sqrt(across2)
        return [a, on_a * a + on_c * c + across * cross(a, c), c]

    def motion(self, first: Frame, second: Frame) -> RowMotion:
        """Compute the axes with their derivatives, their dual axes, and the part of alpha_j - alpha_i that is
        due to the rotation of the axes."""
        values = self.axes(first, second)
        duals = _duals(values)
        wi, wj = first.angular_velocity, second.angular_velocity
        rates = [dual @ (wj - wi) for dual in duals]  # x_k'
        axes = [_body_fixed(values[0], wi, True), _body_fixed(values[-1], wj, False)]
        if len(values) == 2:
            return RowMotion(axes, duals, rates[0] * axes[0].rate + rates[1] * axes[1].rate)

        # The middle axis b is fixed in the first link, of angular velocity omega = omega_i + x_1' a
        a, b, _ = values
        # `first_share` (3, 3) takes omega_j - omega_i to the rotation x_1' a of the first link
        omega, first_share = wi + rates[0] * a, np.outer(a, duals[0])
        rate = cross(omega, b)
        axis_drift = rates[0] * axes[0].rate + rates[1] * rate + rates[2] * axes[1].rate
        # Angular acceleration of the first link if both bodies have zero acceleration
        alpha = rates[0] * axes[0].rate - (duals[0] @ axis_drift) * a
        by_first, by_second = -tilde(b) @ (np.eye(3) - first_share), -tilde(b) @ first_share
        middle = Axis(b, by_first, by_second, rate, drift=cross(alpha, b) + cross(omega, rate))
        return RowMotion([axes[0], middle, axes[1]], duals, axis_drift)


class RowMotion(NamedTuple):
    """The axes of a row of hinges at the poses and velocities of its two bodies, world frame."""

    axes: list[Axis]
    """Axis of each hinge with its derivatives."""
    duals: list[Array]
    """Dual axis d_k (3,) of each hinge."""
    axis_drift: Array
    """(3,) sum_k x_k' da_k/dt, rad/s^2: the part of alpha_j - alpha_i that is due to the rotation of the
    axes."""


@dataclass(frozen=True, eq=False)
class HingeAngle:
    """Joint coordinate: the angle, rad, in (-pi, pi], of one hinge of a row; zero at the initial pose.

    Attributes:
        index: index of the hinge in the row, from 0.
        row: the hinges.
    """

    index: int
    row: HingeRow
    is_length = False
    count = 1

    def phi(self, first: Frame, second: Frame) -> Array:
        row = self.row
        axes = row.axes(first, second)
        # First hinge: the angle by which the second axis has rotated since the initial pose, as seen in body
        # i. Last hinge: the angle by which body j has rotated, as seen from the axis before the last one
        if self.index == 0:
            return np.array([_angle(axes[0], first.rotation @ row.second_axis, axes[1])])
        if self.index == len(axes) - 1:
            return np.array([_angle(axes[-1], axes[-2], second.rotation @ row.next_to_last_axis)])
        # Middle hinge: the angle about b from a to c, minus that angle at the initial pose
        a, b, c = axes
        assert row.cosines is not None
        sine, cosine = b @ cross(a, c), a @ c - row.cosines[0] * row.cosines[1]
        sine_of_difference = sine * row.cosine - cosine * row.sine
        cosine_of_difference = cosine * row.cosine + sine * row.sine
        return np.array([arctan2(sine_of_difference, cosine_of_difference)])

    def jacobian(self, first: Frame, second: Frame) -> Jacobian:
        dual = _duals(self.row.axes(first, second))[self.index][None]
        return Jacobian(_ZERO, -dual, _ZERO, dual)

    def gamma(self, first: Frame, second: Frame) -> Array:
        motion = self.row.motion(first, second)
        return np.array([motion.duals[self.index] @ motion.axis_drift])


class SeparationVector(NamedTuple):
    """The separation D of two bodies joined by a row of hinges (see the module) at a state, world frame."""

    value: Array
    """(3,) D, m."""
    jacobian: Jacobian
    """Jacobian of D, four blocks (3, 3)."""
    drift: Array
    """(3,) second derivative of D if both bodies have zero acceleration, m/s^2."""


@dataclass(frozen=True, eq=False)
class Separation:
    """The separation D of two bodies as a function of their frames, for a row of hinges whose axes do not
    meet.

    Attributes:
        row: the hinges.
        s_first: (3,) m, point on the first axis from the center of mass of body i, in its frame.
        s_second: (3,) m, point on the last axis from the center of mass of body j, in its frame.
        offsets: (m - 1, 3) for m hinges: coefficients u, v and w, m, of each offset o_k.
    """

    row: HingeRow
    s_first: Array
    s_second: Array
    offsets: Array

    def vector(self, first: Frame, second: Frame) -> SeparationVector:
        """Compute D with its Jacobian and drift at given frames of the two bodies."""
        axes = self.row.motion(first, second).axes
        # the separation without offsets: r_j + s_j - r_i - s_i, and its drift
        span = Span.of(first, second, self.s_first, self.s_second)
        theta_i, theta_j = tilde(span.s_i), -tilde(span.s_j)
        value, drift = span.d, span.drift(first, second)
        for (u, v, w), a, b in zip(self.offsets, axes[:-1], axes[1:], strict=True):
            # The derivatives of -o_k = -(u a + v b + w a x b) are the matrices by_a with respect to a, and
            # -by_b with respect to b
            by_a, by_b = w * tilde(b.value) - u * np.eye(3), w * tilde(a.value) + v * np.eye(3)
            value = value + by_a @ a.value - v * b.value
            theta_i = theta_i + by_a @ a.by_first - by_b @ b.by_first
            theta_j = theta_j + by_a @ a.by_second - by_b @ b.by_second
            drift = drift + by_a @ a.drift - by_b @ b.drift - 2.0 * w * cross(a.rate, b.rate)
        return SeparationVector(value, Jacobian(-np.eye(3), theta_i, np.eye(3), theta_j), drift)


@dataclass(frozen=True, eq=False)
class ClosedRow:
    """Three equations -D = 0 of a row of hinges whose axes do not meet, without slides.

    If the axes meet in one point, `Coincidence` of this point in both bodies is the same constraint, with the
    same sign.
    """

    separation: Separation
    is_length = True
    count = 3

    def phi(self, first: Frame, second: Frame) -> Array:
        return -self.separation.vector(first, second).value

    def jacobian(self, first: Frame, second: Frame) -> Jacobian:
        return Jacobian(*(-block for block in self.separation.vector(first, second).jacobian))

    def gamma(self, first: Frame, second: Frame) -> Array:
        return self.separation.vector(first, second).drift


@dataclass(frozen=True, eq=False)
class RowDisplacement:
    """One equation a . D - offset = 0 for a vector a fixed in body i, for slides before a row of hinges.

    It replaces `Displacement` if the hinge axes do not meet.

    Attributes:
        a_first: (3,) vector a in the frame of body i.
        separation: the separation D.
        offset: m, value of a . D at which the residual is zero.
    """

    a_first: Array
    separation: Separation
    offset: float = 0.0
    is_length = True
    count = 1

    def phi(self, first: Frame, second: Frame) -> Array:
        a = first.rotation @ self.a_first
        return np.array([a @ self.separation.vector(first, second).value - self.offset])

    def jacobian(self, first: Frame, second: Frame) -> Jacobian:
        a, d = first.rotation @ self.a_first, self.separation.vector(first, second)
        r_i, theta_i, r_j, theta_j = ((a @ block)[None] for block in d.jacobian)
        return Jacobian(r_i, theta_i + cross(a, d.value)[None], r_j, theta_j)

    def gamma(self, first: Frame, second: Frame) -> Array:
        a, d = first.rotation @ self.a_first, self.separation.vector(first, second)
        wi = first.angular_velocity
        a_rate = cross(wi, a)
        rate = d.jacobian.rate(first, second)
        return -np.array([cross(wi, a_rate) @ d.value + 2.0 * (a_rate @ rate) + a @ d.drift])


@dataclass(frozen=True, eq=False)
class RowSlide(RowDisplacement):
    """Joint coordinate of a slide before a row of hinges whose axes do not meet: a . D - offset, m.

    With two hinges, the bodies cannot rotate relative to each other about a_1 x a_2. The Jacobian of
    `RowDisplacement` may have a component along this axis, which does not change the rate of the coordinate.
    This class removes the component, so that a force on the coordinate causes no torque that the hinges would
    have to carry.
    """

    def _blocked_part(self, first: Frame, second: Frame) -> Array:
        """Compute the component (3,) of the rotational Jacobian along a_1 x a_2, due to the offset of two
        hinges."""
        a, b = self.separation.row.axes(first, second)
        normal = cross(a, b)
        along, s_j = first.rotation @ self.a_first, second.rotation @ self.separation.s_second
        of_offset = RowDisplacement.jacobian(self, first, second).theta_second[0] - cross(s_j, along)
        return ((of_offset @ normal) / (normal @ normal)) * normal

    def jacobian(self, first: Frame, second: Frame) -> Jacobian:
        r_i, theta_i, r_j, theta_j = super().jacobian(first, second)
        if self.separation.row.cosines is None:  # two hinges
            blocked = self._blocked_part(first, second)[None]
            theta_i, theta_j = theta_i + blocked, theta_j - blocked
        return Jacobian(r_i, theta_i, r_j, theta_j)

    def gamma(self, first: Frame, second: Frame) -> Array:
        gamma = super().gamma(first, second)
        if self.separation.row.cosines is None:  # two hinges
            axis_drift = self.separation.row.motion(first, second).axis_drift
            gamma = gamma - self._blocked_part(first, second) @ axis_drift
        return gamma


def _is_right_angle(cosine: Scalar) -> bool:
    """Return True for a float cosine of perpendicular axes; False for symbols, whose value is not known."""
    return isinstance(cosine, float) and abs(cosine) < RIGHT_ANGLE_COSINE


def _angle(axis: Array, start: Array, end: Array) -> Scalar:
    """Compute the angle, rad, about a unit axis (3,) from `start` to `end`, (3,), projected perpendicular to
    the axis."""
    return arctan2(axis @ cross(start, end), start @ end - (axis @ start) * (axis @ end))
