"""Quantities of equations and of runs for `crosscheck regress`, with tolerances for round-off.

A `Measurement` measures one group of quantities, such as those of one engine. Equations are evaluated at the
initial state and at one state of the run; newton_euler's equations also with joints pulled apart, where
Baumgarte's stabilization (feedback of constraint violations) acts.

Tolerances of equations are round-off times the condition numbers of constraints and mass matrix. Values at
the end of a run have the relative tolerance of accelerations.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from crosscheck.compare.allowed_motions import admissible_basis
from crosscheck.compare.check import reach, round_off
from crosscheck.compare.samples import Samples, States
from crosscheck.regress.baseline import COUNT_SUFFIXES, GroupName, MeasurementPlan, StoredQuantity
from newton_euler.compiled.formulations import FORMULATIONS, formulate
from newton_euler.equations.system import Evaluation, System, at_time
from newton_euler.equations.undetermined import determined
from newton_euler.integrators.options import PAPER_ALPHA, IntegratorName
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import Trajectory
from newton_euler.reading.file_run import FileSimulation
from newton_euler.runs.assemble import initial_state
from newton_euler.runs.simulate import CompiledScene

COUNT_RTOL = 1e-6
"""Relative tolerance of the runs whose steps are counted. At the tighter tolerances of other runs the number
of steps depends on the round-off of the processor."""

MAX_COUNT_GROWTH = 0.02
"""Fraction by which a count may grow: other versions of libraries round constants differently, which can add
a step."""

JOINT_GAP = 1e-3
"""Size of the steps by which coordinates are moved to pull joints apart, in sizes of the mechanism or rad;
also the size of the steps in velocity, per second."""

XYZ = ("x", "y", "z")
"""Labels of the components of vectors."""

WXYZ = ("w", "x", "y", "z")
"""Labels of the components of quaternions."""


@dataclass(frozen=True, eq=False)
class Measurement:
    """Measurement of one group of quantities of a scene, with the parts that several groups share.

    Attributes:
        group: name of the group.
        scene: a result of `crosscheck.regress.plan.regress_scene`.
        plan: settings of the measurement.
        simulation: the model file in its own engine; None for scenes that are not read from such a file.
    """

    group: GroupName
    scene: Scene
    plan: MeasurementPlan
    simulation: FileSimulation[Any] | None = None

    @cached_property
    def states(self) -> tuple[tuple[str, float, State], ...]:
        """The two states at which equations are evaluated: triples of label, time (s) and state."""
        return ("start", 0.0, initial_state(self.scene)), ("moving", self.plan.time, self.plan.state.state())

    def samples(self, system: System, time: float, state: State) -> Samples:
        """Return the equations of motion of a system at one state and its time, s."""
        return Samples(at_time(system, time), States(self.scene, (state,)))

    @cached_property
    def run_tolerance(self) -> dict[str, float]:
        """Relative tolerance of all values at the end of a run, by formulation.

        It is the larger tolerance of accelerations at the two `states`. In a few dozen steps, velocities sum
        up accelerations, and positions sum up velocities.
        """
        systems = {name: formulate(self.scene, name) for name in FORMULATIONS}
        return {
            name: max(
                _relative_tolerances(self.samples(system, time, state)).acceleration
                for _, time, state in self.states
            )
            for name, system in systems.items()
        }

    def quantity(
        self,
        name: str,
        unit: str,
        array: ArrayLike,
        tolerance: float,
        rows: Sequence[str] = ("",),
        columns: Sequence[str] = ("",),
    ) -> StoredQuantity:
        """Make a quantity of the group with one tolerance for all of its rows.

        Args:
            name, unit, rows, columns: see `StoredQuantity`.
            array: numbers, reshaped to (rows, columns).
            tolerance: largest allowed change, in `unit`.
        """
        return StoredQuantity.model_construct(
            group=self.group,
            name=name,
            unit=unit,
            rows=list(rows),
            columns=list(columns),
            value=np.reshape(array, (len(rows), len(columns))).tolist(),
            tolerance=[tolerance] * len(rows),
        )

    def count(self, name: str, value: int) -> StoredQuantity:
        """Make a quantity that counts steps, evaluations or operations."""
        return self.quantity(name, "", float(value), float(np.ceil(MAX_COUNT_GROWTH * value)))

    def equations(self, system: System) -> Iterator[StoredQuantity]:
        """Measure accelerations and reactions of a system at both states."""
        for label, time, state in self.states:
            samples = self.samples(system, time, state)
            (solution,) = samples.evaluations
            yield from self.evaluation(label, samples, solution, _relative_tolerances(samples))

    def evaluation(
        self, label: str, samples: Samples, solution: Evaluation, relative: RelativeTolerances
    ) -> Iterator[StoredQuantity]:
        """Measure accelerations of all bodies and reactions at all joints.

        The part of the reactions that redundant constraints leave undetermined is removed.

        Args:
            label: start of the names, such as "moving".
            samples: equations at one state, with the largest acceleration and force there as units.
            solution: accelerations and reactions at the state.
            relative: tolerances relative to these units.
        """
        mechanism, scales = self.scene.mechanism, samples.scales
        bodies, joints, size = mechanism.body_names[1:], mechanism.joint_names, scales.size  # without ground
        # `determined` takes and returns arrays with an axis of states, here one state
        reactions = solution.reaction_force[None], solution.reaction_torque[None]
        (force,), (torque,) = determined(*reactions, samples.states.undetermined, size)
        acceleration = relative.acceleration * scales.acceleration
        reaction = relative.reaction * scales.force
        linear, angular = solution.linear_acceleration[1:], solution.angular_acceleration[1:]
        for name, unit, rows, array, allowed in (
            ("linear acceleration", "m/s^2", bodies, linear, acceleration),
            ("angular acceleration", "rad/s^2", bodies, angular, acceleration / size),
            ("reaction force", "N", joints, force, reaction),
            ("reaction torque", "N m", joints, torque, reaction * size),
        ):
            yield self.quantity(f"{label}: {name}", unit, array, allowed, rows, XYZ)

    def open_joints(self, formulation: str) -> StoredQuantity:
        """Measure accelerations with joints pulled apart and moving apart, under Baumgarte's stabilization
        with its default gain `PAPER_ALPHA`.

        The tolerance uses the condition number of the constraints in this state: constraints that are
        redundant with closed joints are only nearly redundant with open joints.
        """
        system = at_time(formulate(self.scene, formulation, alpha=PAPER_ALPHA), self.plan.time)
        q, v = system.coordinates(self.plan.state.state())
        # the cosines move each coordinate by another amount, so that joints do not stay closed
        step = JOINT_GAP * system.velocity_units * np.cos(1.0 + np.arange(system.nv))
        opened = system.retract(q, step)
        acceleration = system.acceleration(opened, v + step) / system.velocity_units
        columns = [str(k) for k in range(system.nv)]
        states = States(self.scene, (self.plan.state.state(),))
        _, constraint_condition = admissible_basis(system, opened, states.units)  # _: allowed velocities
        condition = constraint_condition * states.mass_condition
        allowed = round_off(condition, states.noise) * float(np.max(np.abs(acceleration), initial=0.0))
        return self.quantity("open joints: acceleration", "1/s^2", acceleration, allowed, columns=columns)

    def over_time(self, run: Trajectory) -> Iterator[StoredQuantity]:
        """Measure positions and quaternions of all bodies at all output times of a run."""
        rows = [f"{time:.9g} s" for time in run.time]
        largest_coordinate = reach(self.scene, run.position)  # m, at least the size of the mechanism
        for name, unit, array, letters, scale in (
            ("position over time", "m", run.position, XYZ, largest_coordinate),
            ("quaternion over time", "", run.quaternion, WXYZ, 1.0),
        ):
            columns = [f"{body} {letter}" for body in run.body_names[1:] for letter in letters]
            allowed = round_off(condition=1.0) * scale
            yield self.quantity(name, unit, array[:, 1:], allowed, rows, columns)  # without the ground

    def end_of_run(
        self, label: str, run: Trajectory, formulation: str = "relative"
    ) -> Iterator[StoredQuantity]:
        """Measure poses and velocities of all bodies at the end of a run, and its largest constraint
        violation.

        Args:
            label: start of the names, such as "RK4".
            run: the run, with velocities and constraint violations.
            formulation: formulation of the equations, which sets the tolerances.
        """
        assert run.linear_velocity is not None
        assert run.angular_velocity is not None
        assert run.constraint_violation is not None
        bodies, size = run.body_names[1:], self.scene.mechanism.size
        relative = self.run_tolerance[formulation]
        length = relative * reach(self.scene, run.position)  # m, relative to the largest coordinate
        linear, angular = run.linear_velocity, run.angular_velocity
        # m/s, relative to the largest velocity, at least one size of the mechanism per second
        speed = relative * max(size, float(np.max(np.abs(linear))), size * float(np.max(np.abs(angular))))
        for name, unit, array, allowed, letters in (
            ("position", "m", run.position, length, XYZ),
            ("quaternion", "", run.quaternion, relative, WXYZ),
            ("linear velocity", "m/s", linear, speed, XYZ),
            ("angular velocity", "rad/s", angular, speed / size, XYZ),
        ):
            at_end = array[-1, 1:]  # without the ground
            yield self.quantity(f"{label}: {name} at the end", unit, at_end, allowed, bodies, letters)
        drift = np.max(run.constraint_violation, initial=0.0)
        yield self.quantity(f"{label}: drift", "m or rad", drift, relative * max(size, 1.0))

    def counts(self, compiled: CompiledScene, integrator: IntegratorName) -> Iterator[StoredQuantity]:
        """Measure the numbers of steps and evaluations of a run at `COUNT_RTOL`."""
        run = compiled.simulate(integrator, rtol=COUNT_RTOL, atol=0.01 * COUNT_RTOL)
        for suffix in COUNT_SUFFIXES:
            key = suffix.removeprefix(": ")
            yield self.count(f"{integrator}, rtol {COUNT_RTOL:g}{suffix}", run.settings[key])

    def short(self, steps: int) -> Scene:
        """Return the scene with a duration of a few fixed steps that starts from the plan's state in motion.

        A scene with prescribed motions starts from its own initial state, as the motions begin there.
        """
        start = initial_state(self.scene) if self.scene.motions else self.plan.state.state()
        duration = steps * self.plan.step
        return replace(self.scene, duration=duration, output_period=duration, initial_state=start)


class RelativeTolerances(NamedTuple):
    """Tolerances relative to the largest acceleration and the largest force."""

    acceleration: float
    reaction: float


def _relative_tolerances(samples: Samples) -> RelativeTolerances:
    """Compute the relative tolerances for round-off, magnified by condition numbers.

    Accelerations are magnified by the condition number of the constraints times that of the mass matrix.
    Reactions are magnified by the constraints twice, see `crosscheck.compare.accelerations`. The relative
    error of the constraints themselves, `noise`, counts where it exceeds round-off.
    """
    masses, noise = samples.states.mass_condition, samples.states.noise
    return RelativeTolerances(
        acceleration=round_off(samples.condition * masses, noise),
        reaction=round_off(samples.condition**2 * masses, noise),
    )
