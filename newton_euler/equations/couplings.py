"""Measured joint coordinates, and couplings between joint coordinates: gears, screws, prescribed motions.

The poses of two bodies determine a slide, but an angle only within a revolution. The number of revolutions
follows from the integral of the rate, which is carried in q and starts within half a revolution. All
couplings have one form: a sum of polynomials of joint coordinates, most of them linear, equals a function of
time,

    Phi = sum_i p_i(x_i) - f(t),    Phi_q = sum_i p_i'(x_i) dx_i/dq,    Phi_t = -f'(t)
    gamma = sum_i p_i'(x_i) gamma_i - p_i''(x_i) (dx_i/dt)^2 + f''(t)

with d2x_i/dt2 = dx_i/dq . qddot - gamma_i (Haug, Computer Aided Kinematics and Dynamics of
Mechanical Systems, 1989, chapters 3 and 9).
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

MAX_START_REVOLUTIONS = 1000  # revolutions of the slowest of several coupled angles in an initial state
MAX_ANGLE_ERROR = 1e-6  # rad, between an angle and the pose; wrong revolutions rarely match by chance


class Measured(NamedTuple):
    """A joint coordinate at a state, with d2x/dt2 = jacobian . accelerations - gamma."""

    x: Scalar
    """m or rad from the initial pose."""
    rate: Scalar
    jacobian: Any
    """A `Jacobian` between two bodies, blocks (1, 3); in joint coordinates the nonzeros of a row over v."""
    gamma: Scalar


@dataclass(frozen=True, eq=False)
class Coordinate:
    """A hinge or slide that is measured between two bodies.

    Attributes:
        first, second: numbers of the bodies.
        constraint: constraint whose residual is the coordinate.
        carried: index in q of the carried angle; None for a slide, or if revolutions have no effect.
    """

    first: int
    second: int
    constraint: Constraint
    carried: int | None

    def measure(self, q: Array, frames: Sequence[Frame]) -> Measured:
        """Measure the coordinate where the bodies have these frames."""
        first, second = frames[self.first], frames[self.second]
        jacobian = self.constraint.jacobian(first, second)
        rate = jacobian.rate(first, second)[0]
        return Measured(self.value(q, frames), rate, jacobian, self.constraint.gamma(first, second)[0])

    def value(self, q: Array, frames: Sequence[Frame]) -> Scalar:
        """Compute the coordinate, m or rad, where the bodies have these frames."""
        x = self.constraint.phi(frames[self.first], frames[self.second])[0]
        if self.carried is None:
            return x
        past = x - q[self.carried]
        return q[self.carried] + arctan2(sin(past), cos(past))


def coordinates(
    keys: dict[Key, JointEquations], size: int, counted: Collection[Key]
) -> dict[Key, Coordinate]:
    """Describe coordinates of joints; those of `counted` angles are carried from place `size` of q on."""
    found: dict[Key, Coordinate] = {}
    for key, equations in keys.items():
        constraint = equations.coordinates[key[1]]
        carried = None if constraint.is_length or key not in counted else size
        size += carried is not None
        found[key] = Coordinate(equations.first, equations.second, constraint, carried)
    return found


def _carried(
    measured: dict[Key, Coordinate], frames: Sequence[Frame]
) -> Iterator[tuple[Constraint, Frame, Frame]]:
    for each in measured.values():
        if each.carried is not None:
            yield each.constraint, frames[each.first], frames[each.second]


def carried_angles(measured: dict[Key, Coordinate], frames: Sequence[Frame]) -> Array:
    """Compute the carried angles within half a revolution, rad."""
    return np.array([angle.phi(*ends)[0] for angle, *ends in _carried(measured, frames)])


def carried_rates(measured: dict[Key, Coordinate], frames: Sequence[Frame]) -> Array:
    """Compute the rates of the carried angles, rad/s."""
    return np.array([angle.jacobian(*ends).rate(*ends)[0] for angle, *ends in _carried(measured, frames)])


@dataclass(frozen=True, eq=False)
class Coupling:
    """One equation: the sum of polynomials, each of one joint coordinate x, equals f(t).

    Attributes:
        what: "motion of joint", "joint", or the `kind` of a `JointCoupling`.
        name: of the joint, gear or coupling that it belongs to.
        joint: name of the joint that errors blame for its residual.
        factors: of the first powers of all joint coordinates.
        function: f; None for 0.
        is_length: True for an equation in meters, False for one in radians.
        powers: factors of the second and higher powers of the coordinates that have them.
    """

    what: str
    name: str
    joint: str
    factors: Mapping[Key, Scalar]
    function: TimeFunction | None
    is_length: bool
    powers: Mapping[Key, tuple[Scalar, ...]] = field(default_factory=dict)

    def phi(self, seen: Mapping[Key, Measured], time: Scalar) -> Scalar:
        """Compute the residual, m or rad."""
        return self.value({key: seen[key].x for key in self.factors}) - (
            self.function.value(time) if self.function else 0.0
        )

    def phi_t(self, time: Scalar) -> Scalar:
        """Compute the partial derivative of the residual by time, m/s or rad/s."""
        return -self.function.rate(time) if self.function else 0.0

    def rate(self, seen: Mapping[Key, Measured], time: Scalar) -> Scalar:
        """Compute the rate of the residual, m/s or rad/s."""
        slopes = self.seen_slopes(seen)
        return sum(slope * seen[key].rate for key, slope in slopes.items()) + self.phi_t(time)

    def gamma(self, seen: Mapping[Key, Measured], time: Scalar) -> Scalar:
        """Compute the right side of Phi_q qddot = gamma."""
        x, rates = ({key: getattr(seen[key], name) for key in self.factors} for name in ("x", "rate"))
        products = sum(slope * seen[key].gamma for key, slope in self.slopes(x).items())
        return products - self.bend(x, rates) + (self.function.acceleration(time) if self.function else 0.0)

    def value(self, x: Mapping[Key, Scalar]) -> Scalar:
        """Compute the sum of the polynomials p(x), m or rad."""
        return sum(self.term(key, x[key]) for key in self.factors)

    def term(self, key: Key, x: Scalar) -> Scalar:
        """Compute the polynomial p of one coordinate."""
        return x * _polynomial((self.factors[key], *self.powers.get(key, ())), x)

    def slopes(self, x: Mapping[Key, Scalar]) -> dict[Key, Scalar]:
        """Compute the derivative p'(x) of each coordinate's polynomial; those of linear ones need no x."""
        slopes = dict(self.factors)
        for key, powers in self.powers.items():
            derivative = (self.factors[key], *(k * c for k, c in enumerate(powers, start=2)))
            slopes[key] = _polynomial(derivative, x[key])
        return slopes

    def seen_slopes(self, seen: Mapping[Key, Measured]) -> dict[Key, Scalar]:
        """Compute the slopes at measured coordinates."""
        return self.slopes({key: seen[key].x for key in self.factors})

    def bend(self, x: Mapping[Key, Scalar], rates: Mapping[Key, Scalar]) -> Scalar:
        """Compute the sum of p''(x) (dx/dt)^2: the second rate of `value` at constant rates."""
        total: Scalar = 0.0
        for key, powers in self.powers.items():
            derivative = [k * (k - 1) * c for k, c in enumerate(powers, start=2)]
            total = total + _polynomial(derivative, x[key]) * (rates[key] * rates[key])
        return total


def _polynomial(coefficients: Sequence[Scalar], x: Scalar) -> Scalar:
    """Compute the sum of coefficients times the powers 0, 1, ... of x, by Horner's method."""
    total = coefficients[-1]
    for coefficient in reversed(coefficients[:-1]):
        total = total * x + coefficient
    return total


def couplings(scene: Scene) -> tuple[Coupling, ...]:
    """List all couplings of a scene: prescribed motions, screws, then couplings of the mechanism."""
    mechanism = scene.mechanism
    found = []
    for motion in scene.motions:
        slides = mechanism.is_slide(*motion.key)
        factors = {motion.key: 1.0}
        what, name = "motion of joint", motion.joint
        found.append(Coupling(what, name, name, factors, motion.function, slides))
    for joint in mechanism.joints:
        if isinstance(joint, Screw):
            factors = {(joint.name, 0): 1.0, (joint.name, 1): -joint.pitch}
            found.append(Coupling("joint", joint.name, joint.name, factors, None, True))
    for coupling in mechanism.couplings:
        factors = coupling.factors()
        first = next(iter(factors))
        slides = mechanism.is_slide(*first)
        found.append(
            Coupling(coupling.kind, coupling.name, first[0], factors, None, slides, coupling.powers())
        )
    return tuple(found)


def needed_coordinates(scene: Scene, couplings: Sequence[Coupling]) -> list[Key]:
    """List the joint coordinates on which forces and couplings of a scene depend, each once."""
    forces = [*(force.key for force in scene.joint_forces), *scene.sensed]
    coupled = [key for coupling in couplings for key in coupling.factors]
    return list(dict.fromkeys([*forces, *coupled]))


def counted_angles(scene: Scene) -> tuple[Key, ...]:
    """List the angles on which forces and couplings of a scene depend; runs carry their revolutions."""
    needed = needed_coordinates(scene, couplings(scene))
    return tuple(key for key in needed if not scene.mechanism.is_slide(*key))


def row_units(equations: Sequence[JointEquations], couplings: Sequence[Coupling], size: float) -> Array:
    """Compute units (k,) of the rows of joints, then couplings: `size` (m) for lengths, else 1."""
    coupled = np.array([size if coupling.is_length else 1.0 for coupling in couplings])
    return np.concatenate([np.zeros(0), *(e.units(size) for e in equations), coupled])


def row_owners(equations: Sequence[JointEquations], couplings: Sequence[Coupling]) -> tuple[str, ...]:
    """List the names of the joints, then couplings, that rows belong to."""
    joints = [e.joint.name for e in equations for _ in range(e.count)]
    return (*joints, *(coupling.name for coupling in couplings))


def revolutions(
    couplings: Sequence[Coupling],
    x: Mapping[Key, float],
    angles: Collection[Key],
    time: float,
    known: Mapping[Key, float],
) -> dict[Key, float]:
    """Compute multiples of 2 pi to add to angles so that they are the known ones and couplings hold.

    Poses determine angles within half a revolution only. Known angles, prescribed motions and slides
    determine the rest, directly or through couplings. Angles that are only coupled to each other, or that
    others follow by polynomials, get the fewest revolutions that agree with all poses. The order of the
    couplings does not matter.

    Args:
        couplings: those of several coordinates without a function of time.
        x: the coordinates that poses give, m or rad.
        angles: which of them are angles.
        time: s.
        known: angles with their revolutions, rad, as of `State.angles`.
    """
    wanted = {key: x[key] + whole_revolutions(known[key] - x[key]) for key in angles if key in known}
    for coupling in couplings:
        if coupling.function:
            (key,) = coupling.factors
            wanted.setdefault(key, float(coupling.function.value(time)))
    linked = sorted((c for c in couplings if c.function is None), key=lambda c: (c.what, c.name))
    _follow(linked, wanted)
    coupled = {key for coupling in couplings for key in coupling.factors}
    wanted |= {key: x[key] for key in coupled if key not in angles and key not in wanted}
    _follow(linked, wanted)
    while coupled - wanted.keys():
        ratios = {_first_to_turn(linked, wanted, coupled - wanted.keys()): 1.0}
        _follow([c for c in linked if not c.powers], ratios)
        wanted |= _fewest_revolutions(ratios, linked, wanted, x)
        _follow(linked, wanted)
    return {key: float(whole_revolutions(wanted[key] - x[key])) for key in angles if key in wanted}


def _follow(couplings: Sequence[Coupling], wanted: dict[Key, Any]) -> None:
    """Add the coordinates, numbers or arrays, that follow from the wanted ones by couplings."""
    before = -1
    while before < len(wanted):
        before = len(wanted)
        for coupling in couplings:
            missing = [key for key in coupling.factors if key not in wanted]
            if len(missing) == 1 and missing[0] not in coupling.powers:
                known = sum(coupling.term(key, wanted[key]) for key in coupling.factors if key in wanted)
                wanted[missing[0]] = -known / coupling.factors[missing[0]]


def _first_to_turn(couplings: Sequence[Coupling], wanted: Mapping[Key, float], among: Collection[Key]) -> Key:
    """Choose the angle whose revolutions are searched first: the angle that most others follow."""
    bent = [key for coupling in couplings for key in coupling.powers if key in among]
    if not bent:
        return min(among)
    reached = {}
    for key in bent:
        followers = {**wanted, key: 0.0}
        _follow(couplings, followers)
        reached[key] = len(followers)
    return min(bent, key=lambda key: (-reached[key], key))


def _fewest_revolutions(
    ratios: Mapping[Key, float],
    couplings: Sequence[Coupling],
    wanted: Mapping[Key, float],
    x: Mapping[Key, float],
) -> dict[Key, float]:
    """Find the smallest angles of these ratios that agree with their poses x, up to `MAX_START_REVOLUTIONS`.

    What follows from them and the wanted coordinates by the couplings has to agree, too. If there are no such
    angles, those of the slowest one within half a revolution.
    """
    slowest = min(ratios, key=lambda key: (abs(ratios[key]), key))
    count = np.arange(MAX_START_REVOLUTIONS + 1)
    count = np.stack([count, -count], axis=1).ravel()
    angle = x[slowest] + 2.0 * np.pi * count
    angle = angle[np.argsort(np.abs(angle), kind="stable")]
    angles = {key: angle * (ratio / ratios[slowest]) for key, ratio in ratios.items()}
    known: dict[Key, Any] = {**wanted, **angles}
    bent = [coupling for coupling in couplings if coupling.powers]
    if bent:
        _follow(couplings, known)
    away = [known[key] - x[key] for key in known.keys() - wanted.keys()]
    turned = np.array(away) / (2.0 * np.pi)
    near = MAX_ANGLE_ERROR / (2.0 * np.pi)
    # angles of so many revolutions that their fractions are rounded off agree with nothing
    agree = np.all((np.abs(turned - np.round(turned)) < near) & (np.spacing(np.abs(turned)) < near), axis=0)
    for coupling in bent:
        if coupling.factors.keys() <= known.keys():
            agree = agree & (np.abs(coupling.value(known)) < MAX_ANGLE_ERROR)
    best = int(np.argmax(agree))
    return {key: float(values[best]) for key, values in angles.items()}


class Residuals(NamedTuple):
    """Residuals of couplings at given frames of the bodies."""

    phi: Array
    """(c,) m or rad."""
    rate: Array
    """(c,) m/s or rad/s."""
    slopes: list[dict[Key, float]]
    """Derivative of the residual of each coupling with respect to each of its coordinates."""

    @property
    def sensitivity(self) -> Array:
        """Return the sums (c,) of the slopes' magnitudes: how far a residual moves with its coordinates."""
        return np.array([sum(map(abs, slopes.values())) for slopes in self.slopes])


def residuals(
    mechanism: Mechanism,
    couplings: Sequence[Coupling],
    frames: Sequence[Frame],
    time: float,
    known: Mapping[Key, float],
) -> Residuals:
    """Compute residuals of couplings at given frames of the bodies.

    The frames are those of the bodies of the mechanism. Angles are in the revolution of `revolutions`.
    """
    x, rates = dict[Key, float](), dict[Key, float]()
    for key in {key for coupling in couplings for key in coupling.factors}:
        x[key], rates[key] = map(float, mechanism.measure(key, frames))
    angles = {key for key in x if not mechanism.is_slide(*key)}
    for key, angle in revolutions(couplings, x, angles, time, known).items():
        x[key] += angle
    phi = [c.value(x) - (c.function.value(time) if c.function else 0.0) for c in couplings]
    slopes = [c.slopes(x) for c in couplings]
    moved = (sum(slope * rates[key] for key, slope in of_one.items()) for of_one in slopes)
    opening = [rate + c.phi_t(time) for rate, c in zip(moved, couplings, strict=True)]
    return Residuals(np.array(phi), np.array(opening), slopes)


class TreeCouplings:
    """The couplings of a scene, in order: jacobian(q) @ v + phi_t = 0.

    The coordinates are those of a tree that keeps all the joints they couple, as that of a welded mechanism
    does: only balls, rods and welds are cut there, which have no coordinates.

    Attributes:
        couplings: as of `couplings`.
        units: (c,) of the equations: the mechanism's size (m) for lengths, else 1.
    """

    def __init__(self, scene: Scene, tree: SpanningTree) -> None:
        self.couplings = couplings(scene)
        self._angles = counted_angles(scene)
        self._on_q: dict[Key, int] = {}
        self._on_v: dict[Key, int] = {}
        self._nv = tree.nv
        for key in needed_coordinates(scene, self.couplings):
            place = tree.place(*key)
            assert place is not None
            self._on_q[key], self._on_v[key] = place
        self.units = row_units((), self.couplings, scene.mechanism.size)

    def _x(self, q: Array) -> dict[Key, Any]:
        """Return the coordinates that forces and couplings depend on, m or rad, at q (nq,)."""
        return {key: q[place] for key, place in self._on_q.items()}

    def phi(self, q: Array, time: float) -> Array:
        """Compute residuals (c,), m or rad."""
        x = self._x(q)
        return np.array([coupling.value(x) for coupling in self.couplings]) - self.value(time)

    def jacobian(self, q: Array) -> Array:
        """Compute the derivative (c, nv) of the residuals along tree velocities."""
        rows, x = np.zeros((len(self.couplings), self._nv)), self._x(q)
        for row, coupling in zip(rows, self.couplings, strict=True):
            for key, slope in coupling.slopes(x).items():
                row[self._on_v[key]] = slope
        return rows

    def value(self, time: float) -> Array:
        """Compute the prescribed values (c,) of the combinations of coordinates, m or rad."""
        return np.array([c.function.value(time) if c.function else 0.0 for c in self.couplings])

    def rate(self, time: float) -> Array:
        """Compute the first derivatives (c,) of `value`."""
        return np.array([c.function.rate(time) if c.function else 0.0 for c in self.couplings])

    def acceleration(self, time: float) -> Array:
        """Compute the second derivatives (c,) of `value`."""
        return np.array([c.function.acceleration(time) if c.function else 0.0 for c in self.couplings])

    def turned(self, q: Array, state: State, time: float) -> Array:
        """Add revolutions to the angles in q (nq,) of a state's poses, as `revolutions` finds them."""
        x = {key: float(value) for key, value in self._x(q).items()}
        q = q.copy()
        for key, angle in revolutions(self.couplings, x, self._angles, time, state.angles).items():
            q[self._on_q[key]] += angle
        return q

    def angles(self, q: Array) -> dict[Key, float]:
        """Return the angles that forces and couplings depend on, rad, at q (nq,), for `State.angles`."""
        return {key: float(q[self._on_q[key]]) for key in self._angles}
