"""Measure the quantities of a scene that `crosscheck regress` compares with a baseline.

A scene is a mechanism (bodies and joints) with forces, inputs, initial state and duration. The quantities
come in groups (`GROUPS`): properties of the model; equations and runs of the solver newton_euler in each of
its two formulations; its other integrators; the engines MuJoCo and Pinocchio; and the "own run". The own run
is the run of a model file (MJCF or URDF) in the file's engine with the time step and solver settings of the
file. A formulation is a choice of coordinates: "relative" are joint coordinates, "cartesian" are the
positions and orientations of all bodies.

newton_euler runs the whole scene in joint coordinates, and a tenth of its duration in Cartesian coordinates,
at tight tolerances. The other integrators and engines make a few dozen steps of one size. Such short runs
execute all of their code, cost the same for every scene, and accumulate little round-off. The equations of
all engines are evaluated at the initial state and at one state of the run. newton_euler's equations are also
evaluated with joints pulled apart, where Baumgarte's stabilization (feedback of constraint violations) acts.

The tolerance of a quantity is the largest change that passes as round-off. Tolerances of equations are
round-off times the condition numbers of constraints and mass matrix. Tolerances of runs add the change of
each quantity in a second run with tighter error control.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike

from crosscheck.compare.check import ERROR_PER_CHANGE, reach, round_off
from crosscheck.compare.energy import energy_balance
from crosscheck.compare.samples import Samples, States, admissible_basis
from crosscheck.engines.engine import ENGINES
from crosscheck.own_run.judge import measure_error
from crosscheck.regress.baseline import (
    COUNT_SUFFIXES,
    OPERATIONS_PREFIX,
    GroupName,
    MeasurementPlan,
    StoredQuantity,
    StoredState,
)
from crosscheck.support.errors import CrosscheckError, reason_of
from newton_euler import compile_scene
from newton_euler.compiled.formulations import FORMULATIONS, formulate
from newton_euler.equations.system import Evaluation, System, at_time
from newton_euler.equations.undetermined import determined
from newton_euler.errors import NewtonEulerError
from newton_euler.integrators.options import PAPER_ALPHA, FormulationName, IntegratorName
from newton_euler.model.euler_parameters import rotation
from newton_euler.model.scene import OUTPUTS, Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import Trajectory
from newton_euler.reading.file_run import FileSimulation
from newton_euler.runs.assemble import initial_state
from newton_euler.runs.simulate import CompiledScene

MAIN_FORMULATION: FormulationName = "relative"
"""Formulation of newton_euler whose run over the whole duration is stored, and name of its group."""

OUTPUT_COUNT = 25
"""Number of output times of a whole run after the initial one: enough to tell when two runs begin to
differ."""

FIXED_STEP_COUNTS = {"newton_euler": 40, "mujoco": 40, "pinocchio": 10}
"""Numbers of steps of short runs, by engine. Python calls Pinocchio four times per step, therefore fewer."""

CARTESIAN_FRACTION = 0.1
"""Duration of the run in Cartesian coordinates, as a fraction of the scene's duration.

With redundant or nearly singular constraints a Cartesian run costs a hundred times as much as in joint
coordinates. It tests the same integrator, so a short one is enough."""

MAX_CARTESIAN_STEPS = 1000
"""Upper limit of the duration of the Cartesian run, in multiples of the plan's fixed step."""

MAX_SLOW_OPERATIONS = 1500
"""Largest number of arithmetic operations of the compiled right-hand side dv/dt for which code that is slow
to compile is measured, too.

Slow to compile are the derivatives of the right-hand side for Radau, and Cartesian equations with Baumgarte's
stabilization. In larger scenes they would take longer than all other measurements, and test no further
code."""

RADAU_RTOL = 1e-10
"""Relative tolerance of Radau (implicit, order 5): a few hundred steps in a short run."""

COUNT_RTOL = 1e-6
"""Relative tolerance of the runs whose steps are counted. At the tighter tolerances of other runs the number
of steps depends on the round-off of the processor."""

MAX_COUNT_GROWTH = 0.02
"""Fraction by which a count may grow: other versions of libraries round constants differently, which can add
a step."""

JOINT_GAP = 1e-3
"""Size of the steps by which coordinates are moved to pull joints apart, in sizes of the mechanism or rad;
also the size of the steps in velocity, per second."""

MUJOCO_SOLVER_TOLERANCE = 1e-8
"""Relative improvement below which MuJoCo's iteration for the forces of its soft (spring-like) constraints
ends; MuJoCo's default."""

CANDIDATE_RTOLS = (1e-12, 1e-11, 1e-10, 1e-9, 1e-8)
"""Relative tolerances of runs, of which a plan takes the first feasible one: a run at this tolerance and a
run at a tenth of it have to complete."""

TIGHTER_FACTOR = 0.1
"""Factor of the relative tolerances in the second run, whose changes show the error of the first run."""

MAX_ERROR_GROWTH = 0.02
"""Fraction by which errors of the own run may grow. Engines repeat a run to the last digit: an error that
grows by more shows a change of the model, its settings or the engine."""

MIN_ERROR = 1e-6
"""Growth of an error of the own run, divided by the extent of the motion, that is no change: round-off and
solver tolerances dominate smaller errors."""

ERROR_TOLERANCE_REASON = (
    f"{100 * MAX_ERROR_GROWTH:g} % of the error or {MIN_ERROR:g} of the motion, the larger one, plus "
    f"{ERROR_PER_CHANGE:g} times the change of the error with a reference of a tenth of the tolerance"
)
"""Text in a baseline that explains the tolerances of the own run."""

RK4_EVALUATIONS = 4
"""Evaluations of the equations per step of RK4."""

XYZ = ("x", "y", "z")
"""Labels of the components of vectors."""

WXYZ = ("w", "x", "y", "z")
"""Labels of the components of quaternions."""


def regress_scene(scene: Scene) -> Scene:
    """Return the scene with all kinds of outputs (such as energies) at `OUTPUT_COUNT` times after the start.

    With redundant constraints, reactions are computed in Python at each output: hundreds of outputs would
    take longer than all other measurements.
    """
    return replace(scene, output_period=scene.duration / OUTPUT_COUNT, outputs=frozenset(OUTPUTS))


def measure_group(
    group: GroupName, scene: Scene, plan: MeasurementPlan, simulation: FileSimulation[Any] | None = None
) -> list[StoredQuantity] | str:
    """Measure the quantities of one group, with tolerances for round-off only.

    Args:
        group: name of the group.
        scene: a result of `regress_scene`.
        plan: settings of the measurement.
        simulation: the model file in its own engine; None for scenes that are not read from such a file.

    Returns:
        The quantities, or the message of the first error of any kind: an error of the tested code is a result
        that is compared with the baseline, too.
    """
    try:
        return list(GROUPS[group](Measurement(group, scene, plan, simulation)))
    except Exception as error:
        return reason_of(error)


def measure_group_with_errors(
    group: GroupName, scene: Scene, plan: MeasurementPlan, simulation: FileSimulation[Any] | None = None
) -> list[StoredQuantity] | str:
    """Measure the quantities of one group for a new baseline.

    The group is measured twice, the second time with tighter error control. `ERROR_PER_CHANGE` times the
    change of each quantity is added to its tolerance.

    Args:
        group: name of the group.
        scene: a result of `regress_scene`.
        plan: settings of the first measurement.
        simulation: the model file in its own engine; None for scenes that are not read from such a file.

    Returns:
        The quantities, or the reason why the group is left out.
    """
    measured = measure_group(group, scene, plan, simulation)
    tighter = measure_group(group, scene, plan.tighter(TIGHTER_FACTOR), simulation)
    if isinstance(measured, str) or isinstance(tighter, str):  # the message of an error
        return measured if isinstance(measured, str) else tighter
    if wrong := [quantity.name for quantity in measured if not np.all(np.isfinite(quantity.array))]:
        return f"{wrong[0]} is not finite"
    quantities = []
    for quantity, other in zip(measured, tighter, strict=True):
        changes = np.max(np.abs(other.array - quantity.array), axis=1, initial=0.0)  # one per row
        if quantity.over_time:  # rows are times; errors grow along a run
            changes = np.maximum.accumulate(changes)
        else:
            changes = np.full(len(changes), np.max(changes, initial=0.0))
        tolerance = (np.array(quantity.tolerance) + ERROR_PER_CHANGE * changes).tolist()
        quantities.append(quantity.model_copy(update={"tolerance": tolerance}))
    return quantities


def make_plan(scene: Scene) -> MeasurementPlan:
    """Choose the settings of the measurement of a scene: tolerances, fixed step, and a state in motion.

    Args:
        scene: a result of `regress_scene`.

    Raises:
        NewtonEulerError: for a scene that newton_euler cannot run at any tolerance.
    """
    rtol: dict[str, float] = {MAIN_FORMULATION: _feasible_rtol(scene, MAIN_FORMULATION), "Radau": RADAU_RTOL}
    run = main_run(scene, rtol[MAIN_FORMULATION])
    assert run.kinetic_energy is not None
    # the state nearest to half of the largest kinetic energy: all bodies move, and no velocity is extreme
    n = int(np.argmin(np.abs(run.kinetic_energy - 0.5 * np.max(run.kinetic_energy))))
    # as many evaluations of dv/dt per second as the adaptive run needs, so that RK4 is stable but not exact;
    # rounded to two digits, as the plan is stored
    step = float(f"{RK4_EVALUATIONS * scene.duration / run.settings['evaluations']:.1e}")
    for formulation in FORMULATIONS:
        if formulation != MAIN_FORMULATION:
            rtol[formulation] = _feasible_rtol(shortened_scene(scene, formulation, step), formulation)
    return MeasurementPlan(rtol=rtol, step=step, time=float(run.time[n]), state=StoredState.of(run.state(n)))


def _feasible_rtol(scene: Scene, formulation: FormulationName) -> float:
    """Return the first of `CANDIDATE_RTOLS` at which a run and a run at a tenth of it complete.

    Without a feasible candidate, the last one is returned for a formulation other than `MAIN_FORMULATION`.
    The measurement of its group then fails, and the baseline leaves the group out with the reason.

    Raises:
        NewtonEulerError: for `MAIN_FORMULATION` without a feasible candidate.
    """
    compiled = compile_scene(scene, formulation)
    for rtol in CANDIDATE_RTOLS:
        try:
            for tried in (rtol, TIGHTER_FACTOR * rtol):
                compiled.simulate(rtol=tried, atol=0.01 * tried)
            return rtol
        except NewtonEulerError:
            if rtol == CANDIDATE_RTOLS[-1] and formulation == MAIN_FORMULATION:
                raise
    return CANDIDATE_RTOLS[-1]


def main_run(scene: Scene, rtol: float) -> Trajectory:
    """Run a scene in newton_euler in joint coordinates over its whole duration."""
    return compile_scene(scene, MAIN_FORMULATION).simulate(rtol=rtol, atol=0.01 * rtol)


def shortened_scene(scene: Scene, formulation: str, step: float) -> Scene:
    """Return the scene with the duration that it is run for in a formulation.

    The run in `MAIN_FORMULATION` has the whole duration. In other formulations, the run ends after a fraction
    of the duration, see `CARTESIAN_FRACTION`, with one output at its end.

    Args:
        scene: a result of `regress_scene`.
        formulation: "relative" or "cartesian".
        step: s, fixed step of short runs.
    """
    if formulation == MAIN_FORMULATION:
        return scene
    duration = min(CARTESIAN_FRACTION * scene.duration, MAX_CARTESIAN_STEPS * step)
    return replace(scene, duration=duration, output_period=duration)


@dataclass(frozen=True, eq=False)
class Measurement:
    """Measurement of one group of quantities of a scene, with the parts that several groups share.

    Attributes:
        group: name of the group.
        scene: a result of `regress_scene`.
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


def _measure_model(measurement: Measurement) -> Iterator[StoredQuantity]:
    """Measure properties of the model at its initial pose."""
    mechanism = measurement.scene.mechanism
    bodies, joints = mechanism.bodies[1:], mechanism.joints
    inertias = [rotation(body.quaternion) @ body.inertia @ rotation(body.quaternion).T for body in bodies]
    moments = {"xx": 0, "yy": 4, "zz": 8, "xy": 1, "xz": 2, "yz": 5}  # indices of a flattened 3 x 3 matrix
    tensors = np.reshape(inertias, (-1, 9))[:, list(moments.values())]
    for name, unit, array, rows, columns in (
        ("mass", "kg", [[body.mass] for body in bodies], mechanism.body_names[1:], ("",)),
        ("center of mass", "m", [body.center_of_mass for body in bodies], mechanism.body_names[1:], XYZ),
        ("inertia in world axes", "kg m^2", tensors, mechanism.body_names[1:], tuple(moments)),
        ("joint point", "m", [joint.point for joint in joints], mechanism.joint_names, XYZ),
        ("gravity", "m/s^2", [measurement.scene.gravity], ("",), XYZ),
    ):
        allowed = round_off(condition=1.0) * float(np.max(np.abs(array), initial=0.0))
        yield measurement.quantity(name, unit, array, allowed, rows, columns)


def _measure_formulation(measurement: Measurement) -> Iterator[StoredQuantity]:
    """Measure equations, compiled code and an adaptive run of newton_euler in the formulation that the group
    is named after."""
    formulation, plan = cast(FormulationName, measurement.group), measurement.plan
    yield from measurement.equations(formulate(measurement.scene, formulation))
    yield measurement.open_joints(formulation)
    compiled = compile_scene(shortened_scene(measurement.scene, formulation, plan.step), formulation)
    for function, operations in compiled.operations.items():  # numbers of arithmetic operations
        yield measurement.count(f"{OPERATIONS_PREFIX}{function}", operations)
    run = compiled.simulate(rtol=plan.rtol[formulation], atol=0.01 * plan.rtol[formulation])  # by DOP853
    if formulation == MAIN_FORMULATION:
        yield from measurement.over_time(run)
    yield from measurement.end_of_run("DOP853", run, formulation)
    # error: change of the energy minus work; relative to the energy scale of the run
    balance = energy_balance(measurement.scene, run)
    assert balance is not None
    error = float(np.max(np.abs(balance.residual))) / (balance.scale or 1.0)
    allowed = measurement.run_tolerance[formulation]
    yield measurement.quantity("DOP853: energy error", "relative", error, allowed)
    yield from measurement.counts(compiled, "DOP853")


def _measure_integrators(measurement: Measurement) -> Iterator[StoredQuantity]:
    """Measure short runs of newton_euler's other integrators, and runs with Baumgarte's stabilization."""
    step, short = measurement.plan.step, measurement.short(FIXED_STEP_COUNTS["newton_euler"])
    compiled = compile_scene(short, MAIN_FORMULATION)
    for integrator in ("RK4", "Euler"):
        with _naming_integrator(integrator):
            run = compiled.simulate(integrator, step=step)
        yield from measurement.end_of_run(integrator, run)
    is_small = compiled.operations["derivative"] <= MAX_SLOW_OPERATIONS
    for formulation in FORMULATIONS if is_small else (MAIN_FORMULATION,):
        name = f"RK4, {formulation}, Baumgarte"
        with _naming_integrator(name):
            run = compile_scene(short, formulation, "baumgarte").simulate("RK4", step=step)
        yield from measurement.end_of_run(name, run, formulation)
    if is_small:
        rtol = measurement.plan.rtol["Radau"]
        with _naming_integrator("Radau"):
            run = compiled.simulate("Radau", rtol=rtol, atol=0.01 * rtol)
        yield from measurement.end_of_run("Radau", run)
        yield from measurement.counts(compiled, "Radau")


@contextmanager
def _naming_integrator(integrator: str) -> Iterator[None]:
    """Add the name of an integrator to the error message of its run."""
    try:
        yield
    except NewtonEulerError as error:
        raise CrosscheckError(f"{integrator}: {error}") from error


def _measure_engine(measurement: Measurement) -> Iterator[StoredQuantity]:
    """Measure equations and a short run of MuJoCo or Pinocchio, whichever the group is named after."""
    name, scene = measurement.group, measurement.scene
    engine = ENGINES[name]
    (system,) = engine.systems(scene)  # the engine's equations of motion with rigid constraints
    yield from measurement.equations(system)
    if engine.evaluate_soft_constraints is not None:  # MuJoCo
        samples = measurement.samples(system, 0.0, initial_state(scene))
        # the constraints magnify the solver's error twice, as in reactions under rigid constraints
        soft = MUJOCO_SOLVER_TOLERANCE * samples.condition**2
        solution = engine.evaluate_soft_constraints(scene)
        tolerances = RelativeTolerances(acceleration=soft, reaction=soft)
        yield from measurement.evaluation("soft constraints", samples, solution, tolerances)
    short = measurement.short(FIXED_STEP_COUNTS[name])
    yield from measurement.end_of_run("RK4", _run_fixed_steps(name, short, measurement.plan.step))


def _run_fixed_steps(engine: str, scene: Scene, step: float) -> Trajectory:
    """Run a scene in "mujoco" or "pinocchio" with RK4 and a fixed step in s."""
    import mjcf
    import urdf

    if engine == "mujoco":
        return mjcf.simulate(scene, timestep=step)  # RK4 is the default
    assert engine == "pinocchio"
    return urdf.simulate(scene, "RK4", step=step)


def _measure_own_run(measurement: Measurement) -> Iterator[StoredQuantity]:
    """Measure the errors of the run with the settings of the model file, against a run of newton_euler."""
    if measurement.simulation is None:
        raise CrosscheckError("the model has no run with settings of its own")
    plan = measurement.plan
    # the comparison of a chaotic or unstable mechanism ends early, at `own_run_until`
    measured = measure_error(
        measurement.simulation, rtol=plan.rtol[MAIN_FORMULATION], horizons=plan.own_run_until
    )
    error, motion = measured.error, measured.scale  # `scale` is the extent of the motion
    for name, unit, value, extent in (
        ("relative error", "", error.relative, 1.0),
        ("error of position", "m", error.position, motion.length),
        ("error of rotation", "rad", error.rotation, motion.angle),
        ("loop opening", "m", measured.loop_error.opening, motion.length),
        ("loop angle", "rad", measured.loop_error.angle, motion.angle),
        ("error of energy", "relative", error.energy, 1.0),
    ):
        allowed = max(MAX_ERROR_GROWTH * value, MIN_ERROR * extent)
        quantity = measurement.quantity(name, unit, value, allowed)
        yield quantity.model_copy(update={"reason": ERROR_TOLERANCE_REASON})


GROUPS: dict[GroupName, Callable[[Measurement], Iterator[StoredQuantity]]] = {
    "model": _measure_model,
    "relative": _measure_formulation,
    "cartesian": _measure_formulation,
    "integrators": _measure_integrators,
    "mujoco": _measure_engine,
    "pinocchio": _measure_engine,
    "own_run": _measure_own_run,
}
"""Functions that measure all quantities of a group, by the name of the group."""
