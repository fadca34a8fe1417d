"""Single constraint equations between two bodies: Phi, its Jacobian and gamma.

These are the building blocks of the joints (Appendix A of the paper; Nikravesh, Computer-Aided
Analysis of Mechanical Systems, 1988, section 7.2). Each works on the `Frame` of its first body i
and second body j. Virtual rotations delta theta are world-frame, so that for a constraint
Phi(r_i, A_i, r_j, A_j)

    delta Phi = Phi_ri delta r_i + Phi_ti delta theta_i + Phi_rj delta r_j + Phi_tj delta theta_j

and Phi_p = 2 Phi_t G gives the paper's Jacobian in Euler parameters, because
delta theta = 2 G delta p. gamma is everything in -d2 Phi / dt2 that holds no acceleration:
Phi_q qddot = gamma, eq. (5).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from newton_euler.scalars import Array, arctan2, cross, tilde

_I3 = np.eye(3)
_ZERO = np.zeros((1, 3))


class Frame(NamedTuple):
    """Pose and velocity of a body; world frame, in m, rad and s."""

    position: Array
    """(3,) center of mass r."""
    rotation: Array
    """(3, 3) rotation matrix A, body to world."""
    velocity: Array
    """(3,) velocity of the center of mass."""
    angular_velocity: Array
    """(3,) angular velocity omega."""


class Jacobian(NamedTuple):
    """The four blocks (k, 3) of a constraint Jacobian."""

    r_first: Array
    theta_first: Array
    r_second: Array
    theta_second: Array

    def rate(self, first: Frame, second: Frame) -> Array:
        """Compute Phi_q qdot (k,), eq. (5), the rate of the residuals at the velocities of two frames."""
        return (
            self.r_first @ first.velocity
            + self.theta_first @ first.angular_velocity
            + self.r_second @ second.velocity
            + self.theta_second @ second.angular_velocity
        )


class Constraint(Protocol):
    """k scalar constraint equations between two bodies."""

    @property
    def is_length(self) -> bool:
        """True for equations in meters, False for equations in radians (sines of small angles)."""

    @property
    def count(self) -> int:
        """k."""

    def phi(self, first: Frame, second: Frame) -> Array:
        """Compute the residual Phi (k,), eq. (4)."""

    def jacobian(self, first: Frame, second: Frame) -> Jacobian:
        """Compute Phi_q, four blocks (k, 3)."""

    def gamma(self, first: Frame, second: Frame) -> Array:
        """Compute the right side (k,) of Phi_q qddot = gamma, eq. (5)."""


def _centripetal(omega: Array, s: Array) -> Array:
    """Compute omega x (omega x s), the acceleration of a body-fixed vector at constant omega."""
    return cross(omega, cross(omega, s))


class Span(NamedTuple):
    """Points fixed in two bodies, world frame: s_i and s_j from the centers of mass, d from one to the other.

    All are (3,) m.
    """

    s_i: Array
    s_j: Array
    d: Array

    @classmethod
    def of(cls, first: Frame, second: Frame, s_first: Array, s_second: Array) -> Span:
        """Compute it from the points in the frames of the bodies, (3,) m."""
        s_i, s_j = first.rotation @ s_first, second.rotation @ s_second
        return cls(s_i, s_j, second.position + s_j - first.position - s_i)

    def rate(self, first: Frame, second: Frame) -> Array:
        """Compute dd/dt (3,), m/s."""
        at_second = second.velocity + cross(second.angular_velocity, self.s_j)
        return np.asarray(at_second - first.velocity - cross(first.angular_velocity, self.s_i))

    def drift(self, first: Frame, second: Frame) -> Array:
        """Compute d2d/dt2 (3,) where neither body accelerates, m/s^2."""
        at_second = _centripetal(second.angular_velocity, self.s_j)
        return np.asarray(at_second - _centripetal(first.angular_velocity, self.s_i))


@dataclass(frozen=True, eq=False)
class Coincidence:
    """Phi^(s,3), eq. (25): point s_first of body i and point s_second of body j coincide."""

    s_first: Array
    s_second: Array
    is_length = True
    count = 3

    def phi(self, first: Frame, second: Frame) -> Array:
        return (
            first.position + first.rotation @ self.s_first - second.position - second.rotation @ self.s_second
        )

    def jacobian(self, first: Frame, second: Frame) -> Jacobian:
        s_i = first.rotation @ self.s_first
        s_j = second.rotation @ self.s_second
        return Jacobian(_I3, -tilde(s_i), -_I3, tilde(s_j))

    def gamma(self, first: Frame, second: Frame) -> Array:
        s_i = first.rotation @ self.s_first
        s_j = second.rotation @ self.s_second
        return _centripetal(second.angular_velocity, s_j) - _centripetal(first.angular_velocity, s_i)


@dataclass(frozen=True, eq=False)
class Perpendicular:
    """Phi^(n1,1), eq. (26): a_first on body i stays perpendicular to a_second on body j.

    For unit vectors and another `cosine` than 0 they stay at that angle.
    """

    a_first: Array
    a_second: Array
    cosine: float = 0.0
    is_length = False
    count = 1

    def phi(self, first: Frame, second: Frame) -> Array:
        return np.array([(first.rotation @ self.a_first) @ (second.rotation @ self.a_second) - self.cosine])

    def jacobian(self, first: Frame, second: Frame) -> Jacobian:
        normal = cross(first.rotation @ self.a_first, second.rotation @ self.a_second)[None]
        return Jacobian(_ZERO, normal, _ZERO, -normal)

    def gamma(self, first: Frame, second: Frame) -> Array:
        a, b = first.rotation @ self.a_first, second.rotation @ self.a_second
        wi, wj = first.angular_velocity, second.angular_velocity
        return -np.array(
            [_centripetal(wi, a) @ b + 2.0 * (cross(wi, a) @ cross(wj, b)) + a @ _centripetal(wj, b)]
        )


@dataclass(frozen=True, eq=False)
class Displacement:
    """a . d - offset, a on body i and d from point s_first of i to point s_second of j.

    As a constraint it is one row of Phi^(p2,2), eq. (28), with a perpendicular to the joint's
    axis; with a along the axis it is the coordinate of a slide.
    """

    a_first: Array
    s_first: Array
    s_second: Array
    offset: float = 0.0
    is_length = True
    count = 1

    def _vectors(self, first: Frame, second: Frame) -> tuple[Array, Span]:
        return first.rotation @ self.a_first, Span.of(first, second, self.s_first, self.s_second)

    def phi(self, first: Frame, second: Frame) -> Array:
        a, span = self._vectors(first, second)
        return np.array([a @ span.d - self.offset])

    def jacobian(self, first: Frame, second: Frame) -> Jacobian:
        a, (s_i, s_j, d) = self._vectors(first, second)
        return Jacobian(-a[None], cross(a, d + s_i)[None], a[None], cross(s_j, a)[None])

    def gamma(self, first: Frame, second: Frame) -> Array:
        a, span = self._vectors(first, second)
        wi, rate = first.angular_velocity, span.rate(first, second)
        turning = _centripetal(wi, a) @ span.d + 2.0 * (cross(wi, a) @ rate)
        return -np.array([turning + a @ span.drift(first, second)])


@dataclass(frozen=True, eq=False)
class Distance:
    """(d . d - L^2) / (2 L), d from point s_first of body i to point s_second of body j: |d| stays L.

    To first order it is the rod's elongation in meters, and its multiplier the force along the rod
    (Nikravesh, section 7.2, there without the 2 L).
    """

    s_first: Array
    s_second: Array
    length: float
    is_length = True
    count = 1

    def _span(self, first: Frame, second: Frame) -> Span:
        return Span.of(first, second, self.s_first, self.s_second)

    def phi(self, first: Frame, second: Frame) -> Array:
        d = self._span(first, second).d
        return np.array([0.5 * ((d @ d) / self.length - self.length)])

    def jacobian(self, first: Frame, second: Frame) -> Jacobian:
        s_i, s_j, d = self._span(first, second)
        along = d / self.length
        return Jacobian(-along[None], cross(along, s_i)[None], along[None], cross(s_j, along)[None])

    def gamma(self, first: Frame, second: Frame) -> Array:
        span = self._span(first, second)
        rate, bend = span.rate(first, second), span.d @ span.drift(first, second)
        return np.array([-(rate @ rate + bend) / self.length])


@dataclass(frozen=True, eq=False)
class Angle:
    """The angle, in (-pi, pi], by which body j is rotated against body i about an axis of body i.

    The pointer is a vector of body j; u and w of body i complete the axis to a right-handed
    orthonormal triad (u, w, axis) and the angle is that of the pointer in the plane of u and w.
    Its gradient is the axis itself wherever j can rotate against i about that axis and, at most,
    about the pointer: revolute, cylindrical, planar and universal joints.
    """

    u_first: Array
    w_first: Array
    pointer_second: Array
    is_length = False
    count = 1

    def phi(self, first: Frame, second: Frame) -> Array:
        u, w = first.rotation @ self.u_first, first.rotation @ self.w_first
        pointer = second.rotation @ self.pointer_second
        return np.array([arctan2(w @ pointer, u @ pointer)])

    def jacobian(self, first: Frame, second: Frame) -> Jacobian:
        axis = (first.rotation @ cross(self.u_first, self.w_first))[None]
        return Jacobian(_ZERO, -axis, _ZERO, axis)

    def gamma(self, first: Frame, second: Frame) -> Array:
        axis = first.rotation @ cross(self.u_first, self.w_first)
        wi, wj = first.angular_velocity, second.angular_velocity
        return -np.array([cross(wi, axis) @ (wj - wi)])


@dataclass(frozen=True, eq=False)
class Reversed:
    """A constraint or coordinate stated from body j to body i, used from i to j, sign changed."""

    of: Constraint

    @property
    def is_length(self) -> bool:
        return self.of.is_length

    @property
    def count(self) -> int:
        return self.of.count

    def phi(self, first: Frame, second: Frame) -> Array:
        return -self.of.phi(second, first)

    def jacobian(self, first: Frame, second: Frame) -> Jacobian:
        r_j, theta_j, r_i, theta_i = self.of.jacobian(second, first)
        return Jacobian(-r_i, -theta_i, -r_j, -theta_j)

    def gamma(self, first: Frame, second: Frame) -> Array:
        return -self.of.gamma(second, first)
