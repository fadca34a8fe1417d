"""One run of two robots from the same start: how far apart their bodies get.

In: the `CommonStates` of two robots. Out: a `Run`. Both robots start at the same state, with the same
controls; if only one of them has a constraint, such as a mimic joint, the state fulfills it. If no pose fits
both, such as for loops of other sizes, the second robot starts from its nearest closed pose. They move for
the time in which a body falls by the length of the robot: about its own length, and too short for chaos. One
integration has both robots and their variants with other last digits, so that all of them have the same
steps.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from crosscheck.differences.common_states import DIGITS_FACTOR, MAX_OPEN, PHASES, CommonStates, Gap, Phase
from crosscheck.differences.dynamics import Dynamics
from crosscheck.differences.motion import Likeness, Motion
from crosscheck.differences.vectors import apply, cross, rotation_matrix, rotation_vector
from newton_euler.compiled.rates import integrate_rates
from newton_euler.integrators.options import Options
from newton_euler.reading.robot import JointKind, Robot
from newton_euler.scalars import Array

TOLERANCES = Options(rtol=1e-6, atol=1e-8)
"""Tolerances of a step."""

MAX_STEPS = 16
"""Steps of 12 evaluations after which a run ends, so that the largest robots take less than a second. Robots
of a few joints without stiff drives or dampers need about six."""

INTEGRATION_ERROR = 1e-6
"""Error of a run in lengths of the robot: ten times the relative tolerance of a step."""

SMALL_ANGLE = 1e-3
"""rad, below which the first term of a series replaces a quotient of small numbers, to a part in 1e8."""


@dataclass(frozen=True)
class Run:
    """Distance of the bodies of two robots in a run from the same start.

    A distance is the root mean square over the mass of a body; places at the start are laid on each other.

    Attributes:
        duration: s, that the run has reached. Stiff drives or dampers, and fast motion, need short steps.
        body: name, in the first file, of the body with the largest distance in excess of its uncertainty.
        distance: of this body, m, the largest one of the run.
        time: s, at which it occurs.
        uncertainty: of the distance, m, by the digits of both files and the error of the integration.
        start_distance: m, largest distance of a body of the second robot at its start from where the same
            body of the first robot starts; 0 if a pose fits both robots. The other distances do not have it.
    """

    duration: float
    body: str
    distance: float
    time: float
    uncertainty: float
    start_distance: float = 0.0


def run_both(states: CommonStates | None, motion: Motion) -> Run | None:
    """Run two robots from the same state; None if the second one cannot be in similar states.

    Args:
        states: states of both robots; None for robots without joints in common.
        motion: comparison of their accelerations.
    """
    if states is None or motion.likeness is Likeness.UNDECIDED:
        return None
    first = states.files[0].robot
    names = [first.bodies[pair.first[0]].name for pair in states.pairs]
    if _fit(motion.gaps, motion.freedoms):
        return _run(states, names)
    # the second robot may have constraints that the first does not have: its states may fit both
    files = states.files
    swapped = CommonStates(files[1], files[0], states.alignment.reversed())
    if swapped.is_closed and _fit(swapped.gaps(*swapped.variants), swapped.freedoms()):
        return _run(swapped, [first.bodies[pair.second[0]].name for pair in swapped.pairs])
    # loops of other sizes: robots with equal freedoms start from poses that are close to each other
    if motion.freedoms[0] != motion.freedoms[1] or not states.is_closed:
        return None
    start_distance = _start_distance(states)
    return None if start_distance is None else replace(_run(states, names), start_distance=start_distance)


def _fit(gaps: Iterable[Gap], freedoms: tuple[int, int]) -> bool:
    """Return whether the states of the first robot are states of the second one, too.

    Args:
        gaps: errors of the constraints of the second robot in the states of the first.
        freedoms: number of independent motions of the first and the second robot.
    """
    return freedoms[0] <= freedoms[1] and not any(gap.is_open for gap in gaps)


def _start_distance(states: CommonStates) -> float | None:
    """Return how far the bodies of the second robot move to its closed pose next to that of the first, m.

    None if the second robot has no closed pose there.

    Args:
        states: states of both robots.
    """
    at, two = PHASES.index(Phase.DRIVEN), states.two
    wanted = states.coordinates_of_second[:, at : at + 1]
    closed, error = two.closed(wanted)
    if error.max() > MAX_OPEN:
        return None
    bodies = [pair.second[0] for pair in states.pairs]
    points = states.points()[1][bodies]

    def poses(coordinates: Array) -> tuple[Array, Array]:
        """Return places of the centers of mass, and rotation matrices."""
        placed = two.kinematics(coordinates, np.zeros(coordinates.shape))
        rotation = placed.rotation[..., bodies, :, :]
        return placed.position[..., bodies, :] + apply(rotation, points), rotation

    radii = np.array([radius for _, radius in states.spreads])
    return float(_distance(poses(wanted), poses(closed), radii).max())


def _run(states: CommonStates, names: Sequence[str]) -> Run:
    """Run two robots from their first driven state.

    Args:
        states: states of both robots; the second one starts at its closed pose nearest to its state.
        names: name of each pair of bodies.
    """
    length = states.one.length
    at = PHASES.index(Phase.DRIVEN)
    one, two = states.one.robot, states.two.robot
    starts = states.states_of_first(len(one.drives)), states.states_of_second()
    first, second = (
        _Side([robot, *variants], length, *(part[:, at : at + 1] for part in start))
        for robot, variants, start in zip((one, two), states.variants, starts, strict=True)
    )
    size = len(first.start)

    def rates(state: Array) -> Array:
        """Return the rates of both robots with all variants."""
        return np.concatenate([first.rates(state[:size]), second.rates(state[size:])])

    start = np.concatenate([first.start, second.start])
    duration = float(np.sqrt(2.0 * length / max(float(np.linalg.norm(states.gravity)), 1.0)))
    times, found = integrate_rates(rates, start, duration, TOLERANCES, MAX_STEPS)
    centers = states.points()
    radii = np.array([radius for _, radius in states.spreads])
    poses = first.poses(found[:, :size], [pair.first[0] for pair in states.pairs], centers[0])
    turns = np.array([pair.placement.rotation for pair in states.pairs])
    others = second.poses(found[:, size:], [pair.second[0] for pair in states.pairs], centers[1])
    others = apply(turns, others[0]), turns @ others[1] @ np.swapaxes(turns, -1, -2)
    distances = _distance(_nominal(poses), _nominal(others), radii)[0]
    uncertainties = np.full(distances.shape, INTEGRATION_ERROR * length)
    for each in (poses, others):
        if len(each[0]) > 1:
            uncertainties += DIGITS_FACTOR * _distance(each, _nominal(each), radii).max(axis=0)
    excess = distances - uncertainties
    worst = int(np.argmax(excess.max(axis=0) if excess.max() > 0.0 else distances.max(axis=0)))
    step = int(np.argmax(distances[:, worst]))
    return Run(
        float(times[-1]),
        names[worst],
        float(distances[step, worst]),
        float(times[step]),
        float(uncertainties[step, worst]),
    )


def _nominal(poses: tuple[Array, Array]) -> tuple[Array, Array]:
    """Return the poses of the robot as it is written, without the variants."""
    return poses[0][:1], poses[1][:1]


def _distance(one: tuple[Array, Array], two: tuple[Array, Array], radii: Array) -> Array:
    """Return (robots, steps, pairs) m, root mean square distance of the masses of bodies at two poses.

    Args:
        one, two: displacements and rotation matrices.
        radii: (pairs,) m, of gyration.
    """
    places = np.linalg.norm(two[0] - one[0], axis=-1)
    angles = np.linalg.norm(rotation_vector(np.swapaxes(one[1], -1, -2) @ two[1]), axis=-1)
    return np.asarray(np.hypot(places, radii * angles))


class _Side:
    """A robot and its variants, as first-order differential equations.

    The state consists of coordinates and velocities, both (robots, coordinates) in one row. Balls and free
    joints have the rotation vector from the start, and the displacement along the axes at the start.

    Attributes:
        start: state at the start.
    """

    def __init__(
        self, robots: list[Robot], length: float, coordinates: Array, velocities: Array, controls: Array
    ) -> None:
        """Close the loops of all variants at the start.

        Args:
            robots: the robot and its variants.
            length: m, unit of lengths in constraint equations.
            coordinates, velocities, controls: (1, 1, n) at the start.
        """
        self._robot = robot = Dynamics(robots, length)
        self._controls = controls
        start, _ = robot.closed(coordinates)
        velocities = robot.admissible(start, velocities)
        joints = [(robot.robot.bodies[body].joints[k].kind, at) for (body, k), at in robot.at.items()]
        self._turns = [
            (slice(at.stop - 3, at.stop), slice(at.start, at.stop - 3))
            for kind, at in joints
            if kind in (JointKind.BALL, JointKind.FREE)
        ]
        # where the coordinates of balls and free joints begin; others count from their own zero
        self._base: Array = np.zeros(start.shape)
        for turn, place in self._turns:
            self._base[..., turn], self._base[..., place] = start[..., turn], start[..., place]
        self.start = np.concatenate([start - self._base, velocities]).ravel()

    def _split(self, state: Array) -> tuple[Array, Array]:
        """Return (robots, states, coordinates): changes of coordinates and velocities, of states (..., n)."""
        parts = state.reshape(-1, 2, len(self._base), self._base.shape[-1])
        return np.swapaxes(parts[:, 0], 0, 1), np.swapaxes(parts[:, 1], 0, 1)

    def rates(self, state: Array) -> Array:
        """Return the rates (n,) of a state (n,)."""
        change, velocities = self._split(state)
        coordinates = self._robot.moved(self._base, change)
        points = np.zeros((1, len(self._robot.robot.bodies), 3))
        found = self._robot.accelerations(coordinates, velocities, self._controls, np.ones(1), points)
        rates = velocities.copy()
        for turn, place in self._turns:
            rates[..., turn] = _rotation_rate(change[..., turn], velocities[..., turn])
            if place.stop > place.start:  # a free joint
                rates[..., place] = apply(rotation_matrix(change[..., turn]), velocities[..., place])
        return np.concatenate([rates, found.coordinates]).ravel()

    def poses(self, state: Array, bodies: list[int], points: Array) -> tuple[Array, Array]:
        """Return how bodies have moved since the start, along the axes of each body at the start.

        Args:
            state: (steps, n).
            bodies: indices of bodies.
            points: (all bodies, 3) m, point of each body.

        Returns:
            (robots, steps, bodies, 3) m, displacement of the point, and (robots, steps, bodies, 3, 3)
            rotation.
        """
        change, velocities = self._split(state)
        moving = self._robot.kinematics(self._robot.moved(self._base, change), velocities)
        rotation = moving.rotation[..., bodies, :, :]
        place = moving.position[..., bodies, :] + apply(rotation, points[bodies])
        back = np.swapaxes(rotation[:, :1], -1, -2)
        return apply(back, place - place[:, :1]), back @ rotation


def _rotation_rate(vector: Array, velocity: Array) -> Array:
    """Return the rate of a rotation vector (..., 3), from the angular velocity along the turned axes, rad/s.

    J. Sola and others, A micro Lie theory for state estimation in robotics, 2018, equation (144): the inverse
    of the right Jacobian.
    """
    angle = np.linalg.norm(vector, axis=-1, keepdims=True)
    half = np.maximum(angle, SMALL_ANGLE) / 2.0
    factor = np.where(angle > SMALL_ANGLE, (1.0 - half / np.tan(half)) / (4.0 * half**2), 1.0 / 12.0)
    turn = cross(vector, velocity)
    return np.asarray(velocity + turn / 2.0 + factor * cross(vector, turn))
