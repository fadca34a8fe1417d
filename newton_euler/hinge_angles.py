"""Angles of two or three hinges in a row whose axes meet in a point, measured between the outer bodies.

The first axis is fixed in body i, the last one in body j. Of three, the middle one keeps its angles to
both, and the side of their plane it is on: it is known as long as the three do not come to lie in one
plane, which is the singularity of the angles. With unit axes a_k and rates x_k',

    omega_j - omega_i = sum_k x_k' a_k
    x_k' = d_k . (omega_j - omega_i),    d_k . a_m = 1 for m = k, else 0
    x_k'' = d_k . (alpha_j - alpha_i) - gamma_k,    gamma_k = d_k . sum_m x_m' da_m/dt

(Featherstone, Rigid Body Dynamics Algorithms, 2008, section 4.4, for such joints.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from newton_euler.constraints import Frame, Jacobian
from newton_euler.scalars import Array, Scalar, arctan2, cross, sqrt

_ZERO = np.zeros((1, 3))

RIGHT_ANGLE = 1e-14
"""Cosine below which axes count as perpendicular, so that their products are structural zeros."""


def dual_axes(axes: Array) -> Array:
    """(n, 3) vectors d_k in the span of n independent axes (n, 3) with d_k . a_m = 1 for m = k, else 0."""
    return np.asarray(np.linalg.pinv(axes).T)


@dataclass(frozen=True, eq=False)
class HingeAngle:
    """The angle, in (-pi, pi], of one of several hinges in a row; zero at the initial pose.

    Attributes:
        index: which of the hinges, from 0.
        first_axis, second_axis: of the first hinge in body i, and of the one after it, there, initially.
        last_axis, before_last: of the last hinge in body j, and of the one before it, there, initially.
        cosines: of the middle axis with the first and with the last one; None if there are two hinges.
        sine: a_2 . (a_1 x a_3) of three hinges initially.
        cosine: a_1 . a_3 less the product of `cosines`, initially.
    """

    index: int
    first_axis: Array
    second_axis: Array
    last_axis: Array
    before_last: Array
    cosines: tuple[float, float] | None = None
    sine: float = 0.0
    cosine: float = 0.0
    is_length = False
    count = 1

    def _axes(self, first: Frame, second: Frame) -> list[Array]:
        """The axes, (3,) world frame."""
        a, c = first.rotation @ self.first_axis, second.rotation @ self.last_axis
        if self.cosines is None:
            return [a, c]
        p, r = (0.0 if abs(cosine) < RIGHT_ANGLE else cosine for cosine in self.cosines)
        s = a @ c
        sine2 = 1.0 - s * s
        on_a, on_c = (p - r * s) / sine2, (r - p * s) / sine2
        rest = (1.0 - on_a * on_a - on_c * on_c - 2.0 * on_a * on_c * s) / sine2
        across = np.copysign(1.0, self.sine) * sqrt(rest)
        return [a, on_a * a + on_c * c + across * cross(a, c), c]

    def _duals(self, axes: list[Array]) -> list[Array]:
        a, b, c = axes if len(axes) == 3 else (*axes, cross(*axes))
        normals = cross(b, c), cross(c, a), cross(a, b)
        volume = a @ normals[0]
        return [normal / volume for normal in normals[: len(axes)]]

    def phi(self, first: Frame, second: Frame) -> Array:
        axes = self._axes(first, second)
        if self.index == 0:
            return np.array([_angle(axes[0], first.rotation @ self.second_axis, axes[1])])
        if self.index == len(axes) - 1:
            return np.array([_angle(axes[-1], axes[-2], second.rotation @ self.before_last)])
        a, b, c = axes
        assert self.cosines is not None
        sine, cosine = b @ cross(a, c), a @ c - self.cosines[0] * self.cosines[1]
        turned = sine * self.cosine - cosine * self.sine, cosine * self.cosine + sine * self.sine
        return np.array([arctan2(*turned)])

    def jacobian(self, first: Frame, second: Frame) -> Jacobian:
        dual = self._duals(self._axes(first, second))[self.index][None]
        return Jacobian(_ZERO, -dual, _ZERO, dual)

    def gamma(self, first: Frame, second: Frame) -> Array:
        axes = self._axes(first, second)
        duals = self._duals(axes)
        wi, wj = first.angular_velocity, second.angular_velocity
        rates = [dual @ (wj - wi) for dual in duals]
        spins = [wi, wi + rates[0] * axes[0], wj] if len(axes) == 3 else [wi, wj]
        change = sum(
            (rate * cross(spin, axis) for rate, spin, axis in zip(rates, spins, axes, strict=True)),
            start=np.zeros(3),
        )
        return np.array([duals[self.index] @ change])


def _angle(axis: Array, start: Array, end: Array) -> Scalar:
    """The angle about a unit axis that turns one vector's part across it to another's."""
    return arctan2(axis @ cross(start, end), start @ end - (axis @ start) * (axis @ end))
