"""Elementary constraint equations between two bodies, from which all joints are built.

Each class is one or more scalar equations Phi = 0, such as "two points coincide" or "two vectors stay
perpendicular". It computes the residual Phi, the Jacobian, and the right side gamma of the acceleration
equations. Some classes also serve as joint coordinates: the coordinate is the value of Phi, which is then not
held at zero. The arguments of all methods are the `Frame` records (pose and velocity) of the first body i and
the second body j.

Let r and A be the position of the center of mass and the rotation matrix of a body. Virtual rotations delta
theta have world-frame components. The Jacobian blocks of a constraint Phi(r_i, A_i, r_j, A_j) are defined by

    delta Phi = Phi_ri delta r_i + Phi_ti delta theta_i + Phi_rj delta r_j + Phi_tj delta theta_j.

With respect to Euler parameters p, the Jacobian is Phi_p = 2 Phi_t G, because delta theta = 2 G delta p
(`newton_euler.model.euler_parameters.matrix_g`). Phi_q is the matrix of the four blocks, qdot and qddot the
linear and angular velocities and accelerations of both bodies. gamma is the part of -d2 Phi / dt2 without
accelerations: Phi_q qddot = gamma, eq. (5).

Equation numbers are those of S. Srang, S. Ath and M. Yamakita, Advances in Science, Technology and
Engineering Systems Journal 5(5), 2020, doi:10.25046/aj050587, Appendix A. The constraints are also in
Nikravesh, Computer-Aided Analysis of Mechanical Systems, 1988, section 7.2.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from newton_euler.scalars import Array, arctan2, cross, tilde

_I3 = np.eye(3)
_ZERO = np.zeros((1, 3))  # Jacobian block of an equation that does not depend on a position


class Frame(NamedTuple):
    """Pose and velocity of a body, world frame."""

    position: Array
    """(3,) center of mass r, m."""
    rotation: Array
    """(3, 3) rotation matrix A: takes body-frame components to world-frame components."""
    velocity: Array
    """(3,) velocity of the center of mass, m/s."""
    angular_velocity: Array
    """(3,) angular velocity omega, rad/s."""


class Jacobian(NamedTuple):
    """The four blocks (k, 3) of the Jacobian of k constraint equations between two bodies."""

    r_first: Array
    """(k, 3) with respect to the position of the first body."""
    theta_first: Array
    """(k, 3) with respect to the virtual rotation of the first body, world frame."""
    r_second: Array
    """(k, 3) with respect to the position of the second body."""
    theta_second: Array
    """(k, 3) with respect to the virtual rotation of the second body, world frame."""

    def rate(self, first: Frame, second: Frame) -> Array:
        """Compute the rate of the residuals, dPhi/dt = Phi_q qdot (k,), from the velocities of both
        bodies."""
        return (
            self.r_first @ first.velocity
            + self.theta_first @ first.angular_velocity
            + self.r_second @ second.velocity
            + self.theta_second @ second.angular_velocity
        )


class Constraint(Protocol):
    """Interface of k scalar constraint equations between two bodies."""

    @property
    def is_length(self) -> bool:
        """True for residuals in meters, False for residuals in radians (angles, or sines of small angles)."""

    @property
    def count(self) -> int:
        """Number k of scalar equations."""

    def phi(self, first: Frame, second: Frame) -> Array:
        """Compute the residual Phi (k,), eq. (4)."""

    def jacobian(self, first: Frame, second: Frame) -> Jacobian:
        """Compute the Jacobian Phi_q as four blocks (k, 3)."""

    def gamma(self, first: Frame, second: Frame) -> Array:
        """Compute the right side (k,) of Phi_q qddot = gamma, eq. (5)."""


def _centripetal(omega: Array, s: Array) -> Array:
    """Compute omega x (omega x s), (3,): the second derivative of a body-fixed vector s at constant omega."""
    return cross(omega, cross(omega, s))


class Span(NamedTuple):
    """The vector d from a point fixed in the first body i to a point fixed in the second body j, world
    frame."""

    s_i: Array
    """(3,) from the center of mass of body i to its point, m."""
    s_j: Array
    """(3,) from the center of mass of body j to its point, m."""
    d: Array
    """(3,) from the point of body i to the point of body j, m."""

    @classmethod
    def of(cls, first: Frame, second: Frame, s_first: Array, s_second: Array) -> Span:
        """Compute the span at given frames of the two bodies.

        Args:
            first, second: present frames of the two bodies.
            s_first, s_second: (3,) m, the points from the centers of mass, in the frames of their bodies.
        """
        s_i, s_j = first.rotation @ s_first, second.rotation @ s_second
        return cls(s_i, s_j, second.position + s_j - first.position - s_i)

    def rate(self, first: Frame, second: Frame) -> Array:
        """Compute the rate of d, (3,), m/s."""
        at_second = second.velocity + cross(second.angular_velocity, self.s_j)
        return np.asarray(at_second - first.velocity - cross(first.angular_velocity, self.s_i))

    def drift(self, first: Frame, second: Frame) -> Array:
        """Compute the second derivative of d, (3,), m/s^2, if both bodies have zero acceleration."""
        at_second = _centripetal(second.angular_velocity, self.s_j)
        return np.asarray(at_second - _centripetal(first.angular_velocity, self.s_i))


@dataclass(frozen=True, eq=False)
class Coincidence:
    """Three equations, eq. (25): a point fixed in body i and a point fixed in body j coincide.

    Attributes:
        s_first: (3,) m, point of body i from its center of mass, body frame.
        s_second: (3,) m, point of body j from its center of mass, body frame.
    """

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
    """One equation, eq. (26): a vector fixed in body i stays perpendicular to a vector fixed in body j.

    Attributes:
        a_first: (3,) vector in the frame of body i.
        a_second: (3,) vector in the frame of body j.
        cosine: cosine of the constant angle between two unit vectors; 0 for perpendicular vectors.
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
        # minus the second derivative of a . b if both angular velocities are constant
        return -np.array(
            [_centripetal(wi, a) @ b + 2.0 * (cross(wi, a) @ cross(wj, b)) + a @ _centripetal(wj, b)]
        )


@dataclass(frozen=True, eq=False)
class Displacement:
    """One equation a . d - offset = 0: displacement of a point of body j along a vector a fixed in body i.

    d is the vector from the point of body i to the point of body j. With a perpendicular to the axis of a
    slide, this is a constraint, one row of eq. (28). With a along the axis, a . d - offset is the coordinate
    of the slide, m.

    Attributes:
        a_first: (3,) vector a in the frame of body i.
        s_first: (3,) m, point of body i from its center of mass, body frame.
        s_second: (3,) m, point of body j from its center of mass, body frame.
        offset: m, value of a . d at which the residual is zero.
    """

    a_first: Array
    s_first: Array
    s_second: Array
    offset: float = 0.0
    is_length = True
    count = 1

    def _vectors(self, first: Frame, second: Frame) -> tuple[Array, Span]:
        """Compute the vector a (3,), world frame, and the span with d."""
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
        # minus the second derivative of a . d if both bodies have zero acceleration
        of_rotating_a = _centripetal(wi, a) @ span.d + 2.0 * (cross(wi, a) @ rate)
        return -np.array([of_rotating_a + a @ span.drift(first, second)])


@dataclass(frozen=True, eq=False)
class Distance:
    """One equation (d . d - L^2) / (2 L) = 0: a point of body i and a point of body j keep the distance L.

    d is the vector from the point of body i to the point of body j. To first order the residual is the
    elongation of a rod between the points, m. The Lagrange multiplier is therefore the force along the rod.
    Source: Nikravesh, section 7.2, there without the factor 1 / (2 L).

    Attributes:
        s_first: (3,) m, point of body i from its center of mass, body frame.
        s_second: (3,) m, point of body j from its center of mass, body frame.
        length: L, m.
    """

    s_first: Array
    s_second: Array
    length: float
    is_length = True
    count = 1

    def _span(self, first: Frame, second: Frame) -> Span:
        """Compute the span with the vector d between the two points, world frame."""
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
        rate, along_drift = span.rate(first, second), span.d @ span.drift(first, second)
        return np.array([-(rate @ rate + along_drift) / self.length])


@dataclass(frozen=True, eq=False)
class Angle:
    """Joint coordinate: the angle, rad, in (-pi, pi], of body j relative to body i about an axis fixed in
    body i.

    The vectors u and w are fixed in body i and form a right-handed orthonormal triad (u, w, axis) with the
    axis. The pointer is a vector fixed in body j. The angle is that of the pointer in the plane of u and w,
    counted from u. Its gradient is the axis if body j can rotate relative to body i only about the axis and
    about the pointer. This holds for revolute, cylindrical, planar and universal joints.

    Attributes:
        u_first, w_first: (3,) vectors u and w in the frame of body i.
        pointer_second: (3,) pointer in the frame of body j.
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
    """A constraint or coordinate with its two bodies exchanged and its sign changed.

    Attributes:
        of: the original constraint or coordinate; its first body is the second body of this one.
    """

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
