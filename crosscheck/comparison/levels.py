"""Comparison of engines, level by level, from the model itself to whole runs.

Each `Row` is one figure for one pair of engines (or one engine), with the tolerance it is held to
and the body, joint or time where it is worst. Levels 1 to 3 use each engine's rigid equations of
motion at consistent states, so that a difference is one of the models; the later levels use runs.
Relative figures are relative to what the mechanism does at all of the states together, never to what
may be round-off: a mechanism at rest, in equilibrium or in free fall has nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

from crosscheck.comparison.energy import RANDOM_RATE, energy_balance, energy_scale
from crosscheck.comparison.reactions import determined, undetermined
from crosscheck.engines import Engine
from newton_euler.assemble import random_states
from newton_euler.euler_parameters import angle_between
from newton_euler.scalars import Array
from newton_euler.scene import Scene
from newton_euler.state import Evaluation, State
from newton_euler.system import System, admissible
from newton_euler.trajectory import Trajectory

LEVELS = ("model", "kinematics", "accelerations and reactions", "trajectories", "drift", "energy")

MODEL_TOLERANCE = 1e-12
"""Relative: numbers written with 17 digits and rotated a few times, each to 1e-16."""

KINEMATICS_TOLERANCE = 1e-11
"""Radians, and relative to the mechanism's reach for positions and to the largest for velocities: a few
dozen products at 1e-16 each, and velocities that come from projecting onto constraints of condition
1e2 to 1e3."""

ACCELERATION_TOLERANCE = 1e-10
"""Relative to the largest: the mass matrix and the constraints have condition 1e4 to 1e5."""

REACTION_TOLERANCE = 1e-8
"""Relative to the largest: multipliers lose the constraints' condition once more."""

SOFTNESS = 1e-2
"""Relative to the largest: MuJoCo caps solimp at 0.9999, so its constraint forces are off by the
order of 0.1 % however small the step, and by more where a mechanism is ill-conditioned; they are
shown beside the rigid ones."""

OWN_ERROR = 4.0
"""Share of the difference between a run and a finer one that the run may be off: three times 4/3, which
is its error where half a step leaves a quarter of it. Where it leaves half, its error is twice the
difference; where error control is a hundred times tighter, the difference itself."""

UNRESOLVED = 1e-2
"""Largest share of reach, 1 rad or energy that a refinement may excuse."""


@dataclass(frozen=True)
class Row:
    """One compared figure.

    Attributes:
        level: one of `LEVELS`.
        quantity: what is compared, with its unit.
        between: the engines or systems compared, one or two.
        value, tolerance: the figure and what it may be at most, or usually is where it only informs.
        where: the body, joint or time of the largest difference.
        informs: a figure that says how an engine works and is not judged.
    """

    level: str
    quantity: str
    between: tuple[str, ...]
    value: float
    tolerance: float
    where: str
    informs: bool = False

    @property
    def agrees(self) -> bool:
        """NaN does not agree with anything."""
        return self.informs or bool(self.value <= self.tolerance)


Systems = dict[str, tuple[System, ...]]
"""The rigid systems of each engine, by its name."""


def reach(scene: Scene, position: Array) -> float:
    """The size of a mechanism or how far (..., 3) positions lie from the origin, whichever is larger, m.

    Coordinates carry round-off in proportion to it.
    """
    return max(scene.mechanism.size, float(np.max(np.abs(position))))


def compare_models(scene: Scene, systems: Systems) -> Iterator[Row]:
    """Level 1: masses, centres of mass and inertias of the engines' own models."""
    names = scene.mechanism.body_names
    properties = {name: first.mass_properties() for name, (first, *_) in systems.items()}
    for a, b in combinations(properties, 2):
        first, second = properties[a], properties[b]
        length = reach(scene, first.center_of_mass)
        for quantity, x, y, tolerance in (
            ("mass, rel", first.mass[1:], second.mass[1:], MODEL_TOLERANCE),
            (
                "centre of mass, m",
                first.center_of_mass[1:],
                second.center_of_mass[1:],
                MODEL_TOLERANCE * length,
            ),
            ("inertia, rel", first.inertia[1:], second.inertia[1:], MODEL_TOLERANCE),
        ):
            gap = np.abs(x - y).reshape(len(names) - 1, -1)
            if quantity.endswith("rel"):
                gap = gap / np.max(np.abs(x).reshape(len(names) - 1, -1), axis=1, keepdims=True)
            worst = int(np.argmax(gap.max(axis=1)))
            yield Row("model", quantity, (a, b), float(gap.max()), tolerance, names[worst + 1])


def compare_equations(
    scene: Scene, engines: Sequence[Engine], systems: Systems, states: list[State]
) -> Iterator[Row]:
    """Levels 2 and 3: kinematics, constrained accelerations and reactions at consistent states.

    An engine with several rigid systems (formulations) enters a pair with the one that is worst,
    and has rows for its systems against each other. An engine with soft constraints has a row for
    what they do to its reactions at the first state, which is to be the initial one. Reactions are
    compared as far as redundant constraints let them be determined.
    """
    free = [undetermined(scene, state) for state in states]
    samples = {name: {s.name: Samples.of(s, states) for s in found} for name, found in systems.items()}
    for a, b in combinations(engines, 2):
        found: dict[str, Row] = {}
        for x, y in product(samples[a.name].values(), samples[b.name].values()):
            for row in _equation_rows(scene, (a.name, b.name), x, y, free):
                known = found.setdefault(row.quantity, row)
                if not row.value <= known.value:
                    found[row.quantity] = row
        yield from found.values()
    for engine in engines:
        for pair in combinations(samples[engine.name], 2):
            one, two = (samples[engine.name][name] for name in pair)
            yield from _equation_rows(scene, pair, one, two, free)
        if engine.soft_start is not None:
            rigid = next(iter(samples[engine.name].values()))
            yield _softness(scene, engine.name, engine.soft_start(scene), rigid)


def _softness(scene: Scene, name: str, soft: Evaluation, rigid: Samples) -> Row:
    """What soft constraints do to the reaction forces at the start."""
    force = rigid.evaluations[0].reaction_force
    states = [evaluation.state for evaluation in rigid.evaluations]
    floor = energy_scale(scene, states) / scene.mechanism.size
    gap = np.linalg.norm(soft.reaction_force - force, axis=1)
    gap = gap / max(floor, float(np.linalg.norm(force, axis=1).max()))
    return Row(
        "accelerations and reactions",
        "reaction force, rel",
        (f"{name} soft", f"{name} rigid"),
        float(gap.max()),
        SOFTNESS,
        scene.mechanism.joint_names[int(np.argmax(gap))],
        informs=True,
    )


@dataclass(frozen=True, eq=False)
class Samples:
    """One system at a number of states.

    Attributes:
        evaluations: at each state.
        admissible: (n, 6 b, 6 b) projectors onto admissible velocities.
    """

    evaluations: list[Evaluation]
    admissible: Array

    @classmethod
    def of(cls, system: System, states: list[State]) -> Samples:
        rows = [system.coordinates(state) for state in states]
        return cls(
            [system.evaluate(q, v) for q, v in rows], np.array([admissible(system, q) for q, _ in rows])
        )

    def stack(self, name: str) -> Array:
        """(n, bodies or joints, ...) array of that name, of the evaluations or of their states."""
        sources = [e.state if hasattr(e.state, name) else e for e in self.evaluations]
        return np.array([getattr(source, name) for source in sources])


@dataclass(frozen=True)
class Scales:
    """What differences at a number of states are relative to: the largest there, with physical floors.

    Angular quantities count at the mechanism's size, so that a ball's torque, which vanishes, is held
    against its force.

    Attributes:
        velocity: m/s, at least the size at `RANDOM_RATE`.
        acceleration: m/s^2, at least gravity and the centripetal one of the velocity at the size.
        force: N, at least the largest inertia force and the energy of `energy_scale` over the size.
    """

    velocity: float
    acceleration: float
    force: float

    @classmethod
    def of(cls, scene: Scene, samples: Samples) -> Scales:
        size, bodies = scene.mechanism.size, scene.mechanism.bodies

        def norms(name: str) -> Array:
            return np.asarray(np.linalg.norm(samples.stack(name), axis=-1))

        mass = np.array([body.mass for body in bodies])
        moment = np.array([np.linalg.norm(body.inertia, ord=2) for body in bodies])
        linear, angular = norms("linear_acceleration"), norms("angular_acceleration")
        states = [evaluation.state for evaluation in samples.evaluations]
        velocity = np.max(
            [norms("linear_velocity"), size * norms("angular_velocity")], initial=size * RANDOM_RATE
        )
        acceleration = np.max(
            [linear, size * angular], initial=max(float(np.linalg.norm(scene.gravity)), velocity**2 / size)
        )
        inertia_force = np.max([mass * linear, moment * angular / size])
        force = np.max(
            [norms("reaction_force"), norms("reaction_torque") / size],
            initial=max(inertia_force, energy_scale(scene, states) / size),
        )
        return cls(float(velocity), float(acceleration), float(force))


def _equation_rows(
    scene: Scene, pair: tuple[str, str], first: Samples, second: Samples, free: list[Array]
) -> Iterator[Row]:
    bodies, joints = scene.mechanism.body_names, scene.mechanism.joint_names

    def apart(name: str) -> Array:
        return np.asarray(np.linalg.norm(first.stack(name) - second.stack(name), axis=-1))

    def row(level: str, quantity: str, gap: Array, tolerance: float, names: Sequence[str]) -> Row:
        worst = int(np.argmax(gap.max(axis=0)))
        return Row(level, quantity, pair, float(gap.max()), tolerance, names[worst])

    kinematics, dynamics = "kinematics", "accelerations and reactions"
    projector = np.abs(first.admissible - second.admissible).max(axis=2)
    projector = projector.reshape(-1, len(bodies), 6).max(axis=2)
    angles = angle_between(first.stack("quaternion"), second.stack("quaternion"))
    length = reach(scene, first.stack("position"))
    yield row(kinematics, "positions, m", apart("position"), KINEMATICS_TOLERANCE * length, bodies)
    yield row(kinematics, "orientations, rad", angles, KINEMATICS_TOLERANCE, bodies)
    yield row(kinematics, "constraint Jacobian", projector, KINEMATICS_TOLERANCE, bodies)
    size, scales = scene.mechanism.size, Scales.of(scene, first)
    for level, name, scale, tolerance, names in (
        (kinematics, "linear_velocity", scales.velocity, KINEMATICS_TOLERANCE, bodies),
        (kinematics, "angular_velocity", scales.velocity / size, KINEMATICS_TOLERANCE, bodies),
        (dynamics, "linear_acceleration", scales.acceleration, ACCELERATION_TOLERANCE, bodies),
        (dynamics, "angular_acceleration", scales.acceleration / size, ACCELERATION_TOLERANCE, bodies),
    ):
        yield row(level, f"{name.replace('_', ' ')}, rel", apart(name) / scale, tolerance, names)
    force, torque = (first.stack(name) - second.stack(name) for name in ("reaction_force", "reaction_torque"))
    force, torque = (np.linalg.norm(x, axis=2) for x in determined(force, torque, free, size))
    yield row(dynamics, "reaction force, rel", force / scales.force, REACTION_TOLERANCE, joints)
    yield row(dynamics, "reaction torque, rel", torque / (scales.force * size), REACTION_TOLERANCE, joints)


Gap = Callable[[Trajectory, Trajectory], Array]
"""How far two runs are apart, (n,) at all times or (n, bodies or joints)."""


def _positions_apart(x: Trajectory, y: Trajectory) -> Array:
    return np.asarray(np.linalg.norm(x.position - y.position, axis=2))


def _orientations_apart(x: Trajectory, y: Trajectory) -> Array:
    return angle_between(x.quaternion, y.quaternion)


def _violations_apart(x: Trajectory, y: Trajectory) -> Array:
    assert x.constraint_violation is not None
    assert y.constraint_violation is not None
    return np.abs(x.constraint_violation - y.constraint_violation)


def _kinetic_energies_apart(x: Trajectory, y: Trajectory) -> Array:
    assert x.kinetic_energy is not None
    assert y.kinetic_energy is not None
    return np.abs(x.kinetic_energy - y.kinetic_energy)


def compare_runs(
    scene: Scene, engines: Sequence[Engine], runs: dict[str, Trajectory], energy: float
) -> Iterator[Row]:
    """Levels 4 to 6: trajectories for each pair, drift and energy balance for each engine.

    An engine may be off by its fixed share. Where a figure exceeds that, the engine is run again, once,
    more finely, and may be off by what that shows as well: how far errors grow depends on the
    mechanism. Shares are of 1 rad for angles. For lengths they are of the mechanism's reach in the
    runs, but of 1 m at least: error control is relative to large coordinates and absolute for small
    ones. Energies are relative to the larger of the run's own and `energy`, J.
    """
    bodies, joints, times = scene.mechanism.body_names, scene.mechanism.joint_names, scene.times
    length = max(1.0, *(reach(scene, run.position) for run in runs.values()))
    finer: dict[str, Trajectory] = {}

    def allowed(value: float, fixed: float, between: Sequence[Engine], apart: Gap, unit: float) -> float:
        """`fixed` shares of a unit, and own errors while the value exceeds that, quickest engine first."""
        for engine in sorted(between, key=lambda engine: runs[engine.name].wall_time):
            if value <= fixed:
                break
            if engine.name not in finer:
                finer[engine.name] = engine.refined(scene)
            own = float(np.max(apart(runs[engine.name], finer[engine.name]))) / unit
            fixed += min(OWN_ERROR * own, UNRESOLVED)
        return fixed

    def worst(gap: Array, names: Sequence[str]) -> str:
        n, k = divmod(int(np.argmax(gap)), gap.shape[1])
        return f"{names[k]} at {times[n]:.3g} s"

    for a, b in combinations(engines, 2):
        for quantity, apart, unit in (
            ("positions, m", _positions_apart, length),
            ("orientations, rad", _orientations_apart, 1.0),
        ):
            gap = apart(runs[a.name], runs[b.name])
            fixed = a.trajectory_error + b.trajectory_error
            tolerance = unit * allowed(float(gap.max()) / unit, fixed, (a, b), apart, unit)
            where = worst(gap, bodies)
            yield Row("trajectories", quantity, (a.name, b.name), float(gap.max()), tolerance, where)
    for engine in engines:
        violation = runs[engine.name].constraint_violation
        if violation is not None:
            value, where = float(violation.max()), worst(violation, joints)
            tolerance = length * allowed(value / length, engine.drift, (engine,), _violations_apart, length)
            yield Row("drift", "open joints, m or rad", (engine.name,), value, tolerance, where)
    for a, b in combinations(engines, 2):
        kinetic = runs[a.name].kinetic_energy
        if kinetic is not None:
            unit = max(energy, float(np.max(kinetic)))
            gap = _kinetic_energies_apart(runs[a.name], runs[b.name]) / unit
            value, where = float(gap.max()), f"{times[int(np.argmax(gap))]:.3g} s"
            fixed = a.energy_error + b.energy_error
            tolerance = allowed(value, fixed, (a, b), _kinetic_energies_apart, unit)
            yield Row("energy", "kinetic energy, rel", (a.name, b.name), value, tolerance, where)
    for engine in engines:
        balance = energy_balance(scene, runs[engine.name])
        if balance is not None:
            unit = max(energy, balance.exchanged)
            gap = np.abs(balance.residual) / unit
            value, where = float(gap.max()), f"{times[int(np.argmax(gap))]:.3g} s"
            tolerance = allowed(value, engine.energy_error, (engine,), _residuals_apart(scene), unit)
            yield Row("energy", "energy less work, rel", (engine.name,), value, tolerance, where)


def _residuals_apart(scene: Scene) -> Gap:
    def apart(x: Trajectory, y: Trajectory) -> Array:
        first, second = energy_balance(scene, x), energy_balance(scene, y)
        assert first is not None
        assert second is not None
        return np.abs(first.residual - second.residual)

    return apart


def compare(scene: Scene, engines: Sequence[Engine], runs: dict[str, Trajectory], states: int) -> list[Row]:
    """All levels; `states` is the number of random consistent states for the first three."""
    samples = [scene.initial_state, *random_states(scene, states)]
    systems = {engine.name: engine.systems(scene) for engine in engines}
    rows = [
        *compare_models(scene, systems),
        *compare_equations(scene, engines, systems, samples),
        *compare_runs(scene, engines, runs, energy_scale(scene, samples)),
    ]
    return sorted(rows, key=lambda row: LEVELS.index(row.level))
