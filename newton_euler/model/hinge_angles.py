"""Two or three hinges in a row between two bodies: their angles and their constraints.

The first axis is fixed in body i, the last one in body j. Of three, the middle one keeps its angles to
both, and the side of their plane it is on: it is known as long as the three do not come to lie in one
plane, which is the singularity of the angles. With unit axes a_k and rates x_k',

    omega_j - omega_i = sum_k x_k' a_k
    x_k' = d_k . (omega_j - omega_i),    d_k . a_m = 1 for m = k, else 0
    x_k'' = d_k . (alpha_j - alpha_i) - gamma_k,    gamma_k = d_k . sum_m x_m' da_m/dt

(Featherstone, Rigid Body Dynamics Algorithms, 2008, section 4.4, for such joints.)

Axes need not meet. The links between the hinges have no mass and are no bodies: the one between hinges k and
k + 1 carries both axes, and with them the constant offset o_k = u a_k + v a_k+1 + w a_k x a_k+1 from the one
axis to the other. The middle one of three axes turns with omega_i + x_1' a_1. With points s_i and s_j on the
first and the last axis,

    D = r_j + s_j - r_i - s_i - sum_k o_k

is 0 where hinges alone join the bodies, and the way of the slides where there are some before them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from newton_euler.model.constraints import Frame, Jacobian, Span
from newton_euler.scalars import Array, Scalar, arctan2, cross, sqrt, tilde

_ZERO = np.zeros((1, 3))

RIGHT_ANGLE = 1e-14  # cosine below which axes count as perpendicular: their products are structural zeros


def dual_axes(axes: Array) -> Array:
    """Compute d_k in the span of n independent axes (..., n, 3) with d_k . a_m = 1 for m = k, else 0."""
    if axes.shape[-2] == 1:  # which is most often, and much quicker
        return axes / np.sum(axes * axes, axis=-1, keepdims=True)
    if axes.dtype == object:  # one set of generic scalars
        return np.array(_duals([*axes]))
    return np.swapaxes(np.linalg.pinv(axes), -1, -2)


def _duals(axes: Sequence[Array]) -> list[Array]:
    """Compute d_k (3,) of two or three axes; those of two axes lie in their plane."""
    a, b, c = axes if len(axes) == 3 else (*axes, cross(*axes))
    normals = cross(b, c), cross(c, a), cross(a, b)
    volume = a @ normals[0]
    return [normal / volume for normal in normals[: len(axes)]]


class Axis(NamedTuple):
    """An axis a of a row at a state, world frame."""

    value: Array
    """(3,) unit vector."""
    on_first: Array
    """(3, 3) with delta a = on_first delta theta_i + on_second delta theta_j."""
    on_second: Array
    """(3, 3)"""
    rate: Array
    """(3,) da/dt."""
    drift: Array
    """(3,) d2a/dt2 where neither body accelerates."""


def _carried(axis: Array, omega: Array, on_first: bool) -> Axis:
    """Describe an axis fixed in the first body, or else in the second, of angular velocity omega."""
    rate, turn, none = cross(omega, axis), -tilde(axis), np.zeros((3, 3))
    turns = (turn, none) if on_first else (none, turn)
    return Axis(axis, turns[0], turns[1], rate, cross(omega, rate))


@dataclass(frozen=True, eq=False)
class HingeRow:
    """Two or three hinges in a row, tied to bodies i and j.

    Attributes:
        first_axis, second_axis: of the first hinge in body i, and of the one after it, there, initially.
        last_axis, before_last: of the last hinge in body j, and of the one before it, there, initially.
        cosines: of the middle axis with the first and with the last one; None if there are two hinges.
        sine: a_2 . (a_1 x a_3) of three hinges initially.
        cosine: a_1 . a_3 less the product of `cosines`, initially.
        side: sign of the sine.
    """

    first_axis: Array
    second_axis: Array
    last_axis: Array
    before_last: Array
    cosines: tuple[float, float] | None = None
    sine: float = 0.0
    cosine: float = 0.0
    side: float = 1.0

    def axes(self, first: Frame, second: Frame) -> list[Array]:
        """Compute the axes, (3,) each, world frame."""
        a, c = first.rotation @ self.first_axis, second.rotation @ self.last_axis
        if self.cosines is None:
            return [a, c]
        p, r = (0.0 if _is_right(cosine) else cosine for cosine in self.cosines)
        s = a @ c
        sine2 = 1.0 - s * s
        on_a, on_c = (p - r * s) / sine2, (r - p * s) / sine2
        rest = (1.0 - on_a * on_a - on_c * on_c - 2.0 * on_a * on_c * s) / sine2
        across = self.side * sqrt(rest)
        return [a, on_a * a + on_c * c + across * cross(a, c), c]

    def moving(self, first: Frame, second: Frame) -> tuple[list[Axis], list[Array], Array]:
        """Compute the axes, their duals, and sum_k x_k' da_k/dt (3,) at the motion of two frames."""
        values = self.axes(first, second)
        duals = _duals(values)
        wi, wj = first.angular_velocity, second.angular_velocity
        rates = [dual @ (wj - wi) for dual in duals]
        axes = [_carried(values[0], wi, True), _carried(values[-1], wj, False)]
        if len(values) == 2:
            return axes, duals, rates[0] * axes[0].rate + rates[1] * axes[1].rate
        a, b, _ = values
        omega, share = wi + rates[0] * a, np.outer(a, duals[0])
        rate = cross(omega, b)
        change = rates[0] * axes[0].rate + rates[1] * rate + rates[2] * axes[1].rate
        alpha = rates[0] * axes[0].rate - (duals[0] @ change) * a
        of_first, of_second = -tilde(b) @ (np.eye(3) - share), -tilde(b) @ share
        middle = Axis(b, of_first, of_second, rate, cross(alpha, b) + cross(omega, rate))
        return [axes[0], middle, axes[1]], duals, change


@dataclass(frozen=True, eq=False)
class HingeAngle:
    """The angle, in (-pi, pi], of hinge number `index` of a row, from 0; zero at the initial pose."""

    index: int
    row: HingeRow
    is_length = False
    count = 1

    def phi(self, first: Frame, second: Frame) -> Array:
        row = self.row
        axes = row.axes(first, second)
        if self.index == 0:
            return np.array([_angle(axes[0], first.rotation @ row.second_axis, axes[1])])
        if self.index == len(axes) - 1:
            return np.array([_angle(axes[-1], axes[-2], second.rotation @ row.before_last)])
        a, b, c = axes
        assert row.cosines is not None
        sine, cosine = b @ cross(a, c), a @ c - row.cosines[0] * row.cosines[1]
        turned = sine * row.cosine - cosine * row.sine, cosine * row.cosine + sine * row.sine
        return np.array([arctan2(*turned)])

    def jacobian(self, first: Frame, second: Frame) -> Jacobian:
        dual = _duals(self.row.axes(first, second))[self.index][None]
        return Jacobian(_ZERO, -dual, _ZERO, dual)

    def gamma(self, first: Frame, second: Frame) -> Array:
        _, duals, change = self.row.moving(first, second)
        return np.array([duals[self.index] @ change])


class SeparationVector(NamedTuple):
    """D at a state, world frame."""

    value: Array
    """(3,) m."""
    jacobian: Jacobian
    """Four blocks (3, 3)."""
    drift: Array
    """(3,) its second rate where neither body accelerates, m/s^2."""


@dataclass(frozen=True, eq=False)
class Separation:
    """D of a row of hinges whose axes do not meet.

    Attributes:
        row: the hinges.
        s_first, s_second: (3,) in body i a point on the first axis, in body j one on the last.
        offsets: (m - 1, 3) of m hinges: u, v and w of each o_k, m.
    """

    row: HingeRow
    s_first: Array
    s_second: Array
    offsets: Array

    def vector(self, first: Frame, second: Frame) -> SeparationVector:
        """Compute D where the bodies have these frames."""
        axes, _, _ = self.row.moving(first, second)
        span = Span.of(first, second, self.s_first, self.s_second)
        theta_i, theta_j = tilde(span.s_i), -tilde(span.s_j)
        value, drift = span.d, span.drift(first, second)
        for (u, v, w), a, b in zip(self.offsets, axes[:-1], axes[1:], strict=True):
            on_a, on_b = w * tilde(b.value) - u * np.eye(3), w * tilde(a.value) + v * np.eye(3)
            value = value + on_a @ a.value - v * b.value
            theta_i = theta_i + on_a @ a.on_first - on_b @ b.on_first
            theta_j = theta_j + on_a @ a.on_second - on_b @ b.on_second
            drift = drift + on_a @ a.drift - on_b @ b.drift - 2.0 * w * cross(a.rate, b.rate)
        return SeparationVector(value, Jacobian(-np.eye(3), theta_i, np.eye(3), theta_j), drift)


@dataclass(frozen=True, eq=False)
class ClosedRow:
    """-D = 0: the constraint of hinges in a row whose axes do not meet, `Coincidence` of those that do."""

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
    """a . D - offset, a (3,) on body i: `Displacement` before hinges in a row whose axes do not meet."""

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
        a, d, wi = (
            first.rotation @ self.a_first,
            self.separation.vector(first, second),
            first.angular_velocity,
        )
        turning = cross(wi, a)
        rate = d.jacobian.rate(first, second)
        return -np.array([cross(wi, turning) @ d.value + 2.0 * (turning @ rate) + a @ d.drift])


@dataclass(frozen=True, eq=False)
class RowSlide(RowDisplacement):
    """`RowDisplacement` as a coordinate: before two hinges, a force on it has no torque along a_1 x a_2.

    The bodies do not rotate about that axis against each other, so that its rate is that of
    `RowDisplacement`.
    """

    def _spare(self, first: Frame, second: Frame) -> Array:
        """Compute the part (3,) of the Jacobian along which no motion is possible."""
        a, b = self.separation.row.axes(first, second)
        normal = cross(a, b)
        along, s_j = first.rotation @ self.a_first, second.rotation @ self.separation.s_second
        of_offset = RowDisplacement.jacobian(self, first, second).theta_second[0] - cross(s_j, along)
        return ((of_offset @ normal) / (normal @ normal)) * normal

    def jacobian(self, first: Frame, second: Frame) -> Jacobian:
        r_i, theta_i, r_j, theta_j = super().jacobian(first, second)
        if self.separation.row.cosines is None:
            spare = self._spare(first, second)[None]
            theta_i, theta_j = theta_i + spare, theta_j - spare
        return Jacobian(r_i, theta_i, r_j, theta_j)

    def gamma(self, first: Frame, second: Frame) -> Array:
        gamma = super().gamma(first, second)
        if self.separation.row.cosines is None:
            gamma = gamma - self._spare(first, second) @ self.separation.row.moving(first, second)[2]
        return gamma


def _is_right(cosine: Scalar) -> bool:
    """Tell if axes of a cosine count as perpendicular; generic scalars are no structural zeros."""
    return isinstance(cosine, float) and abs(cosine) < RIGHT_ANGLE


def _angle(axis: Array, start: Array, end: Array) -> Scalar:
    """Compute the angle about a unit axis between the parts of two vectors perpendicular to it."""
    return arctan2(axis @ cross(start, end), start @ end - (axis @ start) * (axis @ end))
