"""Joint coordinates, and couplings between them: gears, screws, polynomial couplings, prescribed motions.

A key (joint, number) names a joint coordinate x: a slide displacement or a hinge angle. The poses of two
bodies determine a slide, but an angle only up to full revolutions. A carried angle is an additional element
of the coordinates q: the integral of the angle's rate, from which the number of revolutions follows. All
couplings have one form: a sum of polynomials of joint coordinates, most of them linear, equals a function of
time,

    Phi = sum_i p_i(x_i) - f(t),    Phi_q = sum_i p_i'(x_i) dx_i/dq,    Phi_t = -f'(t)
    gamma = sum_i p_i'(x_i) gamma_i - p_i''(x_i) (dx_i/dt)^2 + f''(t)

with the residual Phi, the right side gamma of Phi_q qddot = gamma, and
d2x_i/dt2 = dx_i/dq . qddot - gamma_i (E. J. Haug, Computer Aided Kinematics and Dynamics of Mechanical
Systems, 1989, chapters 3 and 9).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from newton_euler.model.constraints import Constraint, Frame
from newton_euler.model.joint import JointEquations, Key
from newton_euler.model.joint_kinds import Screw
from newton_euler.model.motions import TimeFunction
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array, Scalar, arctan2, cos, sin


class Measured(NamedTuple):
    """A joint coordinate x at a state, its rate, and d2x/dt2 = jacobian . accelerations - gamma.

    Attributes:
        x: m or rad from the initial pose.
        rate: m/s or rad/s.
        jacobian: in Cartesian coordinates a `newton_euler.model.constraints.Jacobian`, with blocks (1, 3) for
            translation and rotation of both bodies; in joint coordinates a sparse row over the velocities v.
        gamma: m/s^2 or rad/s^2, minus the acceleration of x at zero accelerations.
    """

    x: Scalar
    rate: Scalar
    jacobian: Any
    gamma: Scalar


@dataclass(frozen=True, eq=False)
class Coordinate:
    """A hinge or slide coordinate that is measured between two bodies.

    Attributes:
        first, second: numbers of the bodies.
        constraint: measures the coordinate: its residual `phi` is x, m, or rad between -pi and pi.
        carried: index in q of the carried angle, which counts revolutions; None for a slide, and for an angle
            whose revolutions have no effect.
    """

    first: int
    second: int
    constraint: Constraint
    carried: int | None

    def measure(self, q: Array, frames: Sequence[Frame]) -> Measured:
        """Measure the coordinate and its derivatives, with the `Jacobian` of two bodies, at q (nq,) and the
        frames of all bodies."""
        first, second = frames[self.first], frames[self.second]
        jacobian = self.constraint.jacobian(first, second)
        rate = jacobian.rate(first, second)[0]
        return Measured(self.value(q, frames), rate, jacobian, self.constraint.gamma(first, second)[0])

    def value(self, q: Array, frames: Sequence[Frame]) -> Scalar:
        """Compute the coordinate, m or rad, at q (nq,) and the frames of all bodies."""
        x = self.constraint.phi(frames[self.first], frames[self.second])[0]
        if self.carried is None:
            return x
        # the angle that has the pose x and is closest to the carried angle
        difference = x - q[self.carried]
        return q[self.carried] + arctan2(sin(difference), cos(difference))


def measured_coordinates(
    joints: dict[Key, JointEquations], first_index: int, counted: Collection[Key]
) -> dict[Key, Coordinate]:
    """Describe joint coordinates that are measured between two bodies, by key.

    Args:
        joints: equations of the joint of each coordinate, by key.
        first_index: index in q of the first carried angle.
        counted: keys of the coordinates whose angles are carried in q, because revolutions have an effect.
    """
    found: dict[Key, Coordinate] = {}
    index = first_index
    for key, equations in joints.items():
        constraint = equations.coordinates[key[1]]
        carried = None if constraint.is_length or key not in counted else index
        index += carried is not None
        found[key] = Coordinate(equations.first, equations.second, constraint, carried)
    return found


def _carried_constraints(
    measured: dict[Key, Coordinate], frames: Sequence[Frame]
) -> Iterator[tuple[Constraint, Frame, Frame]]:
    """Yield the measuring constraint and the frames of both bodies of each carried angle."""
    for coordinate in measured.values():
        if coordinate.carried is not None:
            yield coordinate.constraint, frames[coordinate.first], frames[coordinate.second]


def carried_angles(measured: dict[Key, Coordinate], frames: Sequence[Frame]) -> Array:
    """Compute the carried angles (n,) in the poses of the bodies, rad, between -pi and pi."""
    return np.array([angle.phi(*ends)[0] for angle, *ends in _carried_constraints(measured, frames)])


def carried_rates(measured: dict[Key, Coordinate], frames: Sequence[Frame]) -> Array:
    """Compute the rates (n,) of the carried angles from the frames of the bodies, rad/s."""
    return np.array(
        [angle.jacobian(*ends).rate(*ends)[0] for angle, *ends in _carried_constraints(measured, frames)]
    )


@dataclass(frozen=True, eq=False)
class Coupling:
    """One constraint equation: a sum of polynomials p(x), each of one joint coordinate x, equals f(t).

    Attributes:
        what: kind of element for messages: "motion of joint" for a prescribed motion, "joint" for a screw, or
            the `kind` of a `newton_euler.model.couplings.JointCoupling`.
        name: name of the joint, gear or coupling that the equation belongs to.
        joint: name of the joint to which messages attribute the residual.
        factors: coefficient of the first power in each polynomial p, by key of the joint coordinate.
        function: f, a function of time; None for 0.
        is_length: True for an equation in meters, False for one in radians.
        powers: coefficients of the powers 2, 3, ..., by key, for polynomials of degree 2 or higher.
    """

    what: str
    name: str
    joint: str
    factors: Mapping[Key, Scalar]
    function: TimeFunction | None
    is_length: bool
    powers: Mapping[Key, tuple[Scalar, ...]] = field(default_factory=dict)

    def phi(self, measured: Mapping[Key, Measured], time: Scalar) -> Scalar:
        """Compute the residual Phi, m or rad."""
        return self.value({key: measured[key].x for key in self.factors}) - (
            self.function.value(time) if self.function else 0.0
        )

    def phi_t(self, time: Scalar) -> Scalar:
        """Compute the partial derivative of the residual with respect to time, m/s or rad/s."""
        return -self.function.rate(time) if self.function else 0.0

    def rate(self, measured: Mapping[Key, Measured], time: Scalar) -> Scalar:
        """Compute the rate of the residual, m/s or rad/s."""
        slopes = self.measured_slopes(measured)
        return sum(slope * measured[key].rate for key, slope in slopes.items()) + self.phi_t(time)

    def gamma(self, measured: Mapping[Key, Measured], time: Scalar) -> Scalar:
        """Compute the right side of Phi_q qddot = gamma, m/s^2 or rad/s^2."""
        x = {key: measured[key].x for key in self.factors}
        rates = {key: measured[key].rate for key in self.factors}
        products = sum(slope * measured[key].gamma for key, slope in self.slopes(x).items())
        return (
            products
            - self.curvature_term(x, rates)
            + (self.function.acceleration(time) if self.function else 0.0)
        )

    def value(self, x: Mapping[Key, Scalar]) -> Scalar:
        """Compute the sum of the polynomials p(x), m or rad, at the coordinates x by key."""
        return sum(self.term(key, x[key]) for key in self.factors)

    def term(self, key: Key, x: Scalar) -> Scalar:
        """Compute the polynomial p(x) of the coordinate with a key."""
        return x * _polynomial((self.factors[key], *self.powers.get(key, ())), x)

    def slopes(self, x: Mapping[Key, Scalar]) -> dict[Key, Scalar]:
        """Compute the derivative p'(x) of each coordinate's polynomial at the coordinates x, by key."""
        slopes = dict(self.factors)
        for key, powers in self.powers.items():
            derivative = (self.factors[key], *(k * c for k, c in enumerate(powers, start=2)))
            slopes[key] = _polynomial(derivative, x[key])
        return slopes

    def measured_slopes(self, measured: Mapping[Key, Measured]) -> dict[Key, Scalar]:
        """Compute the derivatives p'(x) at measured coordinates, by key."""
        return self.slopes({key: measured[key].x for key in self.factors})

    def curvature_term(self, x: Mapping[Key, Scalar], rates: Mapping[Key, Scalar]) -> Scalar:
        """Compute the sum of p''(x) (dx/dt)^2, m/s^2 or rad/s^2."""
        total: Scalar = 0.0
        for key, powers in self.powers.items():
            second_derivative = [k * (k - 1) * c for k, c in enumerate(powers, start=2)]
            total = total + _polynomial(second_derivative, x[key]) * (rates[key] * rates[key])
        return total


def _polynomial(coefficients: Sequence[Scalar], x: Scalar) -> Scalar:
    """Evaluate a polynomial with the given coefficients of x^0, x^1, ... by Horner's method."""
    total = coefficients[-1]
    for coefficient in reversed(coefficients[:-1]):
        total = total * x + coefficient
    return total


def couplings(scene: Scene) -> tuple[Coupling, ...]:
    """List all couplings of a scene: prescribed motions, screws, then couplings of the mechanism."""
    mechanism = scene.mechanism
    found = []
    # prescribed motions: x = f(t)
    for motion in scene.motions:
        slides = mechanism.is_slide(*motion.key)
        factors = {motion.key: 1.0}
        what, name = "motion of joint", motion.joint
        found.append(Coupling(what, name, name, factors, motion.function, is_length=slides))
    # screws: translation (coordinate 0) = pitch times rotation (coordinate 1)
    for joint in mechanism.joints:
        if isinstance(joint, Screw):
            factors = {(joint.name, 0): 1.0, (joint.name, 1): -joint.pitch}
            found.append(Coupling("joint", joint.name, joint.name, factors, function=None, is_length=True))
    # gears and polynomial couplings; messages name the joint of the first coordinate, which follows the
    # others and determines the unit of the equation
    for element in mechanism.couplings:
        factors = element.factors()
        follower = next(iter(factors))
        coupling = Coupling(
            element.kind,
            element.name,
            follower[0],
            factors,
            function=None,
            is_length=mechanism.is_slide(*follower),
            powers=element.powers(),
        )
        found.append(coupling)
    return tuple(found)


def needed_coordinates(scene: Scene, couplings: Sequence[Coupling]) -> list[Key]:
    """List the keys of the joint coordinates on which forces and couplings of a scene depend, each once."""
    # `sensed`: coordinates that control laws drive or read
    forces = [*scene.loaded_coordinates, *scene.sensed]
    coupled = [key for coupling in couplings for key in coupling.factors]
    return list(dict.fromkeys([*forces, *coupled]))


def counted_angles(scene: Scene) -> tuple[Key, ...]:
    """List the keys of the angles on which forces and couplings depend; runs count their revolutions."""
    needed = needed_coordinates(scene, couplings(scene))
    return tuple(key for key in needed if not scene.mechanism.is_slide(*key))


def row_units(equations: Sequence[JointEquations], couplings: Sequence[Coupling], size: float) -> Array:
    """Return divisors that make the constraint rows of joints, then of couplings, dimensionless.

    Args:
        equations: constraint equations of the joints.
        couplings: the couplings.
        size: the mechanism's size, m.

    Returns:
        (k,) the size for a row in meters; 1 for a row in radians.
    """
    coupled = np.array([size if coupling.is_length else 1.0 for coupling in couplings])
    return np.concatenate([np.zeros(0), *(e.units(size) for e in equations), coupled])


def row_owners(equations: Sequence[JointEquations], couplings: Sequence[Coupling]) -> tuple[str, ...]:
    """List the name of the joint that each constraint row belongs to, then the name of each coupling."""
    joints = [e.joint.name for e in equations for _ in range(e.count)]
    return (*joints, *(coupling.name for coupling in couplings))
