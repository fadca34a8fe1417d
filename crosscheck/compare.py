"""Comparison of engines, level by level, from the model itself to whole runs.

Each `Row` is one figure for one pair of engines (or one engine), with the tolerance it is held to
and the body, joint or time where it is worst. Levels 1 to 3 use each engine's rigid equations of
motion at consistent states, so that a difference is one of the models; the later levels use runs.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np

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
"""Metres and radians, and relative for velocities: a few dozen products at 1e-16 each, and velocities
that come from projecting onto constraints of condition 1e2 to 1e3."""

ACCELERATION_TOLERANCE = 1e-10
"""Relative to the largest: the mass matrix and the constraints have condition 1e4 to 1e5."""

REACTION_TOLERANCE = 1e-8
"""Relative to the largest: multipliers lose the constraints' condition once more."""

SOFTNESS = 1e-2
"""Relative to the largest: MuJoCo caps solimp at 0.9999, so its constraint forces are off by the
order of 0.1 % however small the step; they are shown beside the rigid ones."""

WORK_QUADRATURE = 2e-5
"""Share of the largest energy: the actuators' work is integrated through output times, and a spline
of degree 7 through points 10 ms apart misses 5e-6 where the paper's dampers act within 9 ms."""


@dataclass(frozen=True)
class Row:
    """One compared figure.

    Attributes:
        level: one of `LEVELS`.
        quantity: what is compared, with its unit.
        between: the engines or systems compared, one or two.
        value, tolerance: the figure and what it may be at most.
        where: the body, joint or time of the largest difference.
    """

    level: str
    quantity: str
    between: tuple[str, ...]
    value: float
    tolerance: float
    where: str

    @property
    def agrees(self) -> bool:
        """NaN does not agree with anything."""
        return bool(self.value <= self.tolerance)


def compare_models(scene: Scene, engines: Sequence[Engine]) -> Iterator[Row]:
    """Level 1: masses, centres of mass and inertias of the engines' own models."""
    names = scene.mechanism.body_names
    properties = {engine.name: engine.systems(scene)[0].mass_properties() for engine in engines}
    for a, b in combinations(properties, 2):
        first, second = properties[a], properties[b]
        for quantity, x, y in (
            ("mass, rel", first.mass[1:], second.mass[1:]),
            ("centre of mass, m", first.center_of_mass[1:], second.center_of_mass[1:]),
            ("inertia, rel", first.inertia[1:], second.inertia[1:]),
        ):
            gap = np.abs(x - y).reshape(len(names) - 1, -1)
            if quantity.endswith("rel"):
                gap = gap / np.max(np.abs(x).reshape(len(names) - 1, -1), axis=1, keepdims=True)
            worst = int(np.argmax(gap.max(axis=1)))
            yield Row("model", quantity, (a, b), float(gap.max()), MODEL_TOLERANCE, names[worst + 1])


def compare_equations(scene: Scene, engines: Sequence[Engine], states: list[State]) -> Iterator[Row]:
    """Levels 2 and 3: kinematics, constrained accelerations and reactions at consistent states.

    An engine with several rigid systems (formulations) enters a pair with the one that is worst,
    and has rows for its systems against each other. An engine with soft constraints has a row for
    what they do to its reactions.
    """
    samples = {e.name: {s.name: Samples.of(s, states) for s in e.systems(scene)} for e in engines}
    for a, b in combinations(engines, 2):
        found: dict[str, Row] = {}
        for x, y in product(samples[a.name].values(), samples[b.name].values()):
            for row in _equation_rows(scene, (a.name, b.name), x, y):
                known = found.setdefault(row.quantity, row)
                if not row.value <= known.value:
                    found[row.quantity] = row
        yield from found.values()
    for engine in engines:
        for pair in combinations(samples[engine.name], 2):
            one, two = (samples[engine.name][name] for name in pair)
            yield from _equation_rows(scene, pair, one, two)
        if engine.soft_start is not None:
            yield _softness(scene, engine, engine.soft_start(scene))


def _softness(scene: Scene, engine: Engine, soft: Evaluation) -> Row:
    """What soft constraints do to the reaction forces at the start."""
    system = engine.systems(scene)[0]
    rigid = system.evaluate(*system.coordinates(scene.initial_state))
    forces = (soft.reaction_force, rigid.reaction_force)
    gap = np.linalg.norm(forces[0] - forces[1], axis=1) / (np.linalg.norm(forces[1], axis=1).max() or 1.0)
    return Row(
        "accelerations and reactions",
        "reaction force, rel",
        (f"{engine.name} soft", f"{engine.name} rigid"),
        float(gap.max()),
        SOFTNESS,
        scene.mechanism.joint_names[int(np.argmax(gap))],
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


def _equation_rows(scene: Scene, pair: tuple[str, str], first: Samples, second: Samples) -> Iterator[Row]:
    bodies, joints = scene.mechanism.body_names, scene.mechanism.joint_names

    def apart(name: str) -> Array:
        return np.asarray(np.linalg.norm(first.stack(name) - second.stack(name), axis=-1))

    def relative(name: str, companion: str, arm: float) -> Array:
        """Gaps against the largest vector of the state, or the largest companion times an arm.

        The companion (force for torque, velocity for angular velocity) is there for quantities
        that vanish, a ball's torque for one; states in which both vanish count as they are.
        """
        scale = np.maximum(
            np.linalg.norm(first.stack(name), axis=-1).max(axis=1),
            arm * np.linalg.norm(first.stack(companion), axis=-1).max(axis=1),
        )[:, None]
        return apart(name) / np.where(scale > 0.0, scale, 1.0)

    def row(level: str, quantity: str, gap: Array, tolerance: float, names: Sequence[str]) -> Row:
        worst = int(np.argmax(gap.max(axis=0)))
        return Row(level, quantity, pair, float(gap.max()), tolerance, names[worst])

    kinematics, dynamics = "kinematics", "accelerations and reactions"
    projector = np.abs(first.admissible - second.admissible).max(axis=2)
    projector = projector.reshape(-1, len(bodies), 6).max(axis=2)
    angles = angle_between(first.stack("quaternion"), second.stack("quaternion"))
    yield row(kinematics, "positions, m", apart("position"), KINEMATICS_TOLERANCE, bodies)
    yield row(kinematics, "orientations, rad", angles, KINEMATICS_TOLERANCE, bodies)
    yield row(kinematics, "constraint Jacobian", projector, KINEMATICS_TOLERANCE, bodies)
    size = scene.mechanism.size
    for level, name, companion, arm, tolerance, names in (
        (kinematics, "linear_velocity", "angular_velocity", size, KINEMATICS_TOLERANCE, bodies),
        (kinematics, "angular_velocity", "linear_velocity", 1 / size, KINEMATICS_TOLERANCE, bodies),
        (dynamics, "linear_acceleration", "angular_acceleration", size, ACCELERATION_TOLERANCE, bodies),
        (dynamics, "angular_acceleration", "linear_acceleration", 1 / size, ACCELERATION_TOLERANCE, bodies),
        (dynamics, "reaction_force", "reaction_torque", 1 / size, REACTION_TOLERANCE, joints),
        (dynamics, "reaction_torque", "reaction_force", size, REACTION_TOLERANCE, joints),
    ):
        quantity = f"{name.replace('_', ' ')}, rel"
        yield row(level, quantity, relative(name, companion, arm), tolerance, names)


def compare_runs(scene: Scene, engines: Sequence[Engine], runs: dict[str, Trajectory]) -> Iterator[Row]:
    """Levels 4 to 6: trajectories for each pair, drift and energy balance for each engine."""
    bodies, joints, times = scene.mechanism.body_names, scene.mechanism.joint_names, scene.times

    def worst(gap: Array, names: Sequence[str]) -> str:
        n, k = divmod(int(np.argmax(gap)), gap.shape[1])
        return f"{names[k]} at {times[n]:.3g} s"

    for a, b in combinations(engines, 2):
        x, y = runs[a.name], runs[b.name]
        tolerance = a.trajectory_error + b.trajectory_error
        for quantity, gap in (
            ("positions, m", np.linalg.norm(x.position - y.position, axis=2)),
            ("orientations, rad", angle_between(x.quaternion, y.quaternion)),
        ):
            yield Row(
                "trajectories", quantity, (a.name, b.name), float(gap.max()), tolerance, worst(gap, bodies)
            )
    for engine in engines:
        violation = runs[engine.name].constraint_violation
        if violation is not None:
            yield Row(
                "drift",
                "open joints, m or rad",
                (engine.name,),
                float(violation.max()),
                engine.drift,
                worst(violation, joints),
            )
    for a, b in combinations(engines, 2):
        kinetic_a, kinetic_b = runs[a.name].kinetic_energy, runs[b.name].kinetic_energy
        if kinetic_a is not None and kinetic_b is not None:
            gap = np.abs(kinetic_a - kinetic_b) / (np.max(kinetic_a) or 1.0)
            yield Row(
                "energy",
                "kinetic energy, rel",
                (a.name, b.name),
                float(gap.max()),
                a.energy_error + b.energy_error,
                f"{times[int(np.argmax(gap))]:.3g} s",
            )
    for engine in engines:
        balance = energy_balance(scene, runs[engine.name])
        if balance is not None:
            n = int(np.argmax(np.abs(balance)))
            yield Row(
                "energy",
                "energy less work, rel",
                (engine.name,),
                float(np.abs(balance).max()),
                engine.energy_error + WORK_QUADRATURE,
                f"{times[n]:.3g} s",
            )


def actuated_rates(scene: Scene, run: Trajectory) -> Array:
    """(n, a) rates of the actuated coordinates, m/s or rad/s, from body velocities."""
    assert run.linear_velocity is not None
    assert run.angular_velocity is not None
    rates = np.zeros((len(run.time), len(scene.control)))
    for n in range(len(run.time)):
        frames = State(
            run.position[n], run.quaternion[n], run.linear_velocity[n], run.angular_velocity[n]
        ).frames()
        for k, law in enumerate(scene.control):
            equations = scene.mechanism.equations[scene.mechanism.joint_index(law.joint)]
            i, j = frames[equations.first], frames[equations.second]
            r_i, theta_i, r_j, theta_j = equations.coordinates[law.coordinate].jacobian(i, j)
            rates[n, k] = (
                r_i @ i.velocity
                + theta_i @ i.angular_velocity
                + r_j @ j.velocity
                + theta_j @ j.angular_velocity
            )[0]
    return rates


def energy_balance(scene: Scene, run: Trajectory) -> Array | None:
    """(n,) energy less its start less the actuators' work, as a share of the largest energy.

    The work is the integral of actuator power, by a spline of degree 7 through the output times.
    None if the run holds no energies, velocities or actuator forces.
    """
    if (
        run.kinetic_energy is None
        or run.potential_energy is None
        or run.actuator_force is None
        or run.linear_velocity is None
    ):
        return None
    energy = run.kinetic_energy + run.potential_energy
    work = np.zeros_like(energy)
    exchanged = np.max(np.abs(energy - energy[0])) + np.max(run.kinetic_energy)
    if scene.control:
        from scipy.interpolate import make_interp_spline

        power = np.sum(run.actuator_force * actuated_rates(scene, run), axis=1)
        degree = min(7, len(power) - 1 - (len(power) % 2))
        work = make_interp_spline(run.time, power, k=degree).antiderivative()(run.time)
    if exchanged == 0.0:
        return np.zeros_like(energy)
    return np.asarray((energy - energy[0] - work) / exchanged)


def compare(scene: Scene, engines: Sequence[Engine], runs: dict[str, Trajectory], states: int) -> list[Row]:
    """All levels; `states` is the number of random consistent states for the first three."""
    rows = list(compare_models(scene, engines))
    samples = [scene.initial_state, *random_states(scene, states)]
    rows.extend(compare_equations(scene, engines, samples))
    rows.extend(compare_runs(scene, engines, runs))
    order = {level: k for k, level in enumerate(LEVELS)}
    return sorted(rows, key=lambda row: order[row.level])
