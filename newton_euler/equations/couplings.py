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
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.motions import TimeFunction
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import SpanningTree
from newton_euler.model.state import State, whole_revolutions
from newton_euler.scalars import Array, Scalar, arctan2, cos, sin

MAX_START_REVOLUTIONS = 1000
"""Largest number of revolutions that is tried for the slowest of several coupled angles at the start."""

MAX_ANGLE_ERROR = 1e-6
"""Largest difference, rad, between an angle that follows from couplings and the same angle in the poses.

A wrong number of revolutions rarely comes so close."""


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
    forces = [*(force.key for force in scene.joint_forces), *scene.sensed]
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


def revolutions(
    couplings: Sequence[Coupling],
    x: Mapping[Key, float],
    angles: Collection[Key],
    time: float,
    known: Mapping[Key, float],
) -> dict[Key, float]:
    """Find the full revolutions of angles at which all couplings hold.

    Poses determine angles between -pi and pi only. Known angles, prescribed motions and slides determine the
    revolutions of other angles through couplings. Angles that are coupled only to each other, or that
    determine others by polynomials, get the fewest revolutions at which all coupled coordinates match the
    poses. The order of the couplings does not matter.

    Args:
        couplings: all couplings of the scene.
        x: joint coordinates in the poses of the bodies, by key, m or rad.
        angles: keys of the coordinates in `x` that are angles.
        time: s, at which prescribed motions are evaluated.
        known: angles with their full revolutions, rad, by key, as in `State.angles`.

    Returns:
        Multiple of 2 pi to add to each angle, rad, by key.
    """
    # `wanted`: coordinates with their full revolutions, m or rad; first known angles and prescribed motions
    wanted = {key: x[key] + whole_revolutions(known[key] - x[key]) for key in angles if key in known}
    for coupling in couplings:
        if coupling.function:
            (key,) = coupling.factors
            wanted.setdefault(key, float(coupling.function.value(time)))
    # coordinates that follow from these by couplings; then slides, and coordinates that follow from slides
    linked = sorted((c for c in couplings if c.function is None), key=lambda c: (c.what, c.name))
    _add_followers(linked, wanted)
    coupled = {key for coupling in couplings for key in coupling.factors}
    wanted |= {key: x[key] for key in coupled if key not in angles and key not in wanted}
    _add_followers(linked, wanted)
    # groups of angles that are coupled only to each other: search for the fewest revolutions. In one group
    # all angles have constant ratios to one of them
    while coupled - wanted.keys():
        ratios = {_first_to_turn(linked, wanted, coupled - wanted.keys()): 1.0}
        _add_followers([c for c in linked if not c.powers], ratios)
        wanted |= _fewest_revolutions(ratios, linked, wanted, x)
        _add_followers(linked, wanted)
    return {key: float(whole_revolutions(wanted[key] - x[key])) for key in angles if key in wanted}


def _add_followers(couplings: Sequence[Coupling], wanted: dict[Key, Any]) -> None:
    """Add the coordinates that follow from known coordinates by couplings.

    Args:
        couplings: couplings without a function of time.
        wanted: known coordinates, numbers or arrays, by key; the new ones are added.
    """
    # pass through the couplings until a pass adds no coordinate; a coordinate whose polynomial has a higher
    # degree is not added, because the equation may have several solutions
    count_before = -1
    while count_before < len(wanted):
        count_before = len(wanted)
        for coupling in couplings:
            missing = [key for key in coupling.factors if key not in wanted]
            if len(missing) == 1 and missing[0] not in coupling.powers:
                known = sum(coupling.term(key, wanted[key]) for key in coupling.factors if key in wanted)
                wanted[missing[0]] = -known / coupling.factors[missing[0]]  # all terms together are 0


def _first_to_turn(couplings: Sequence[Coupling], wanted: Mapping[Key, float], among: Collection[Key]) -> Key:
    """Choose the angle whose revolutions are searched first: the one that determines most other angles.

    Only angles with a polynomial of degree 2 or higher are compared, because other coordinates do not
    determine them. Without such angles, the first key in alphabetical order is chosen.

    Args:
        couplings: couplings without a function of time.
        wanted: known coordinates by key.
        among: keys of the angles to choose from.
    """
    nonlinear = [key for coupling in couplings for key in coupling.powers if key in among]
    if not nonlinear:
        return min(among)
    determined_counts = {}
    for key in nonlinear:
        determined = {**wanted, key: 0.0}
        _add_followers(couplings, determined)
        determined_counts[key] = len(determined)
    return min(nonlinear, key=lambda key: (-determined_counts[key], key))


def _fewest_revolutions(
    ratios: Mapping[Key, float],
    couplings: Sequence[Coupling],
    wanted: Mapping[Key, float],
    x: Mapping[Key, float],
) -> dict[Key, float]:
    """Find the smallest angles with given ratios that match the poses up to full revolutions.

    Coordinates that follow from the angles by couplings must match the poses, too. If no angles up to
    `MAX_START_REVOLUTIONS` match, the slowest angle (the one of the smallest ratio) is between -pi and pi.

    Args:
        ratios: ratio of each angle to a common angle, by key.
        couplings: couplings without a function of time.
        wanted: known coordinates by key.
        x: joint coordinates in the poses of the bodies, by key, m or rad.

    Returns:
        The angles with their revolutions, rad, by key.
    """
    # candidates of the slowest angle in ascending magnitude, and the other angles for each of them
    slowest = min(ratios, key=lambda key: (abs(ratios[key]), key))
    count = np.arange(MAX_START_REVOLUTIONS + 1)
    count = np.stack([count, -count], axis=1).ravel()
    candidates = x[slowest] + 2.0 * np.pi * count
    candidates = candidates[np.argsort(np.abs(candidates), kind="stable")]
    angles = {key: candidates * (ratio / ratios[slowest]) for key, ratio in ratios.items()}
    known: dict[Key, Any] = {**wanted, **angles}
    nonlinear = [coupling for coupling in couplings if coupling.powers]
    if nonlinear:
        _add_followers(couplings, known)
    # the first candidate at which all angles differ from the poses by full revolutions. An angle is rejected
    # if it has so many revolutions that round-off exceeds the limit
    differences = [known[key] - x[key] for key in known.keys() - wanted.keys()]
    turns = np.array(differences) / (2.0 * np.pi)
    limit = MAX_ANGLE_ERROR / (2.0 * np.pi)
    agree = np.all((np.abs(turns - np.round(turns)) < limit) & (np.spacing(np.abs(turns)) < limit), axis=0)
    # polynomial couplings between known coordinates must hold, too
    for coupling in nonlinear:
        if coupling.factors.keys() <= known.keys():
            agree = agree & (np.abs(coupling.value(known)) < MAX_ANGLE_ERROR)
    best = int(np.argmax(agree))
    return {key: float(values[best]) for key, values in angles.items()}


class Residuals(NamedTuple):
    """Residuals of c couplings at given frames of the bodies.

    Attributes:
        phi: (c,) m or rad.
        rate: (c,) m/s or rad/s.
        slopes: for each coupling, the derivative of its residual with respect to each coordinate, by key.
    """

    phi: Array
    rate: Array
    slopes: list[dict[Key, float]]

    @property
    def sensitivity(self) -> Array:
        """Sum (c,) of the magnitudes of each coupling's slopes.

        The residual changes by this at most if each coordinate changes by 1 m or 1 rad.
        """
        return np.array([sum(map(abs, slopes.values())) for slopes in self.slopes])


def residuals(
    mechanism: Mechanism,
    couplings: Sequence[Coupling],
    frames: Sequence[Frame],
    time: float,
    known: Mapping[Key, float],
) -> Residuals:
    """Compute the residuals of couplings at given frames of the bodies.

    Args:
        mechanism: the mechanism to which the couplings belong.
        couplings: the couplings.
        frames: pose and velocity of each body, ground first.
        time: s.
        known: angles with their full revolutions, rad, by key; for other angles `revolutions` finds them.
    """
    x, rates = dict[Key, float](), dict[Key, float]()
    for key in {key for coupling in couplings for key in coupling.factors}:
        x[key], rates[key] = map(float, mechanism.measure(key, frames))
    angles = {key for key in x if not mechanism.is_slide(*key)}
    for key, angle in revolutions(couplings, x, angles, time, known).items():
        x[key] += angle
    phi = [c.value(x) - (c.function.value(time) if c.function else 0.0) for c in couplings]
    slopes = [c.slopes(x) for c in couplings]
    phi_rates = [
        sum(slope * rates[key] for key, slope in of_coupling.items()) + coupling.phi_t(time)
        for of_coupling, coupling in zip(slopes, couplings, strict=True)
    ]
    return Residuals(np.array(phi), np.array(phi_rates), slopes)


class TreeCouplings:
    """The couplings of a scene as equations in the coordinates q and velocities v of a spanning tree.

    A spanning tree connects all bodies by joints without loops. The tree must contain all coupled joints.
    This holds if only ball joints, rods and welds close loops, because these joints have no coordinates.
    Models for MuJoCo and Pinocchio have such trees.

    Attributes:
        couplings: the c couplings of the scene.
        units: (c,) divisors that make the equations dimensionless: the mechanism's size, m, for lengths, else
        1.
    """

    def __init__(self, scene: Scene, tree: SpanningTree) -> None:
        """Find the indices in q and v of the coordinates on which forces and couplings depend."""
        self.couplings = couplings(scene)
        self._angles = counted_angles(scene)
        self._on_q: dict[Key, int] = {}
        self._on_v: dict[Key, int] = {}
        self._nv = tree.nv
        for key in needed_coordinates(scene, self.couplings):
            place = tree.place(*key)
            assert place is not None
            self._on_q[key], self._on_v[key] = place
        self.units = row_units(equations=(), couplings=self.couplings, size=scene.mechanism.size)

    def _x(self, q: Array) -> dict[Key, Any]:
        """Return the joint coordinates that forces and couplings depend on, m or rad, by key, at q (nq,)."""
        return {key: q[place] for key, place in self._on_q.items()}

    def phi(self, q: Array, time: float) -> Array:
        """Compute the residuals (c,), m or rad, at q (nq,) and a time, s."""
        x = self._x(q)
        return np.array([coupling.value(x) for coupling in self.couplings]) - self.value(time)

    def jacobian(self, q: Array) -> Array:
        """Compute the Jacobian (c, nv) of the residuals with respect to the tree velocities."""
        rows, x = np.zeros((len(self.couplings), self._nv)), self._x(q)
        for row, coupling in zip(rows, self.couplings, strict=True):
            for key, slope in coupling.slopes(x).items():
                row[self._on_v[key]] = slope
        return rows

    def value(self, time: float) -> Array:
        """Compute the prescribed values f(t) (c,) of the couplings, m or rad; 0 without a function."""
        return np.array([c.function.value(time) if c.function else 0.0 for c in self.couplings])

    def rate(self, time: float) -> Array:
        """Compute the first time derivatives (c,) of `value`."""
        return np.array([c.function.rate(time) if c.function else 0.0 for c in self.couplings])

    def acceleration(self, time: float) -> Array:
        """Compute the second time derivatives (c,) of `value`."""
        return np.array([c.function.acceleration(time) if c.function else 0.0 for c in self.couplings])

    def turned(self, q: Array, state: State, time: float) -> Array:
        """Return q (nq,) with full revolutions added to its angles, so that the couplings hold.

        Args:
            q: tree coordinates with angles between -pi and pi.
            state: gives known angles with their revolutions; `revolutions` finds those of other angles.
            time: s.
        """
        x = {key: float(value) for key, value in self._x(q).items()}
        q = q.copy()
        for key, angle in revolutions(self.couplings, x, self._angles, time, state.angles).items():
            q[self._on_q[key]] += angle
        return q

    def angles(self, q: Array) -> dict[Key, float]:
        """Return the angles that forces and couplings depend on, rad, at q (nq,), for `State.angles`."""
        return {key: float(q[self._on_q[key]]) for key in self._angles}
