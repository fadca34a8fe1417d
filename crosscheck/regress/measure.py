"""Measure the quantities of a scene that `crosscheck regress` compares with a baseline.

The quantities come in groups (`GROUPS`): properties of the model, equations and runs of newton_euler in two
formulations, its other integrators, the engines MuJoCo and Pinocchio, and the error of the run that a model
file's own engine makes with the settings of the file. A formulation is a choice of
coordinates: "relative" are joint coordinates, "cartesian" are the positions and orientations of all bodies.

newton_euler runs the whole scene in joint coordinates, and a tenth of its duration in Cartesian coordinates,
at tight tolerances. The other integrators and engines make a few dozen steps of one size. Such short runs
execute all of their code, cost the same for every scene, and accumulate little round-off. The equations of
all engines are evaluated at the initial state and at one state of the run. newton_euler's equations are also
evaluated with joints pulled apart, where Baumgarte's stabilization (feedback of constraint violations) acts.

Tolerances follow `crosscheck.compare`. Tolerances of equations are round-off times condition number.
Tolerances of runs add the change of each quantity in a second run with tighter error control.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from crosscheck.compare.check import OWN_ERROR, reach, round_off
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

CARTESIAN_FRACTION, MAX_CARTESIAN_STEPS = 0.1, 1000
"""Limits of the run in Cartesian coordinates: fraction of the scene's duration, and number of fixed steps.

With redundant or nearly singular constraints a run costs a hundred times as much as in joint coordinates, and
both use the same integrator."""

MAX_SLOW_OPERATIONS = 1500
"""Largest number of operations of a compiled right-hand side for which slow code is measured, too.

Slow to compile are the traced derivatives of Radau, and Cartesian equations with Baumgarte's stabilization.
In larger scenes they would take longer than all other measurements, and test no further code."""

RADAU_RTOL = 1e-10
"""Relative tolerance of Radau (implicit, order 5): a few hundred steps in a short run."""

COUNT_RTOL, MAX_COUNT_GROWTH = 1e-6, 0.02
"""Relative tolerance of the runs whose steps are counted, and fraction by which a count may grow.

At the tighter tolerances of other runs the number of steps depends on the round-off of the processor. Other
versions of libraries round constants differently, which can add or remove a step."""

JOINT_GAP = 1e-3
"""Distance by which joints are pulled apart, in sizes of the mechanism or rad; velocities the same per
second."""

MUJOCO_SOLVER_TOLERANCE = 1e-8
"""Relative improvement below which MuJoCo's iteration of soft constraint forces ends; MuJoCo's default."""

CANDIDATE_RTOLS = (1e-12, 1e-11, 1e-10, 1e-9, 1e-8)
"""Relative tolerances of runs: a plan takes the first at which a run, and a run with a tenth of it,
complete."""

TIGHTER_FACTOR = 0.1
"""Factor of the relative tolerances in the second run, whose changes show the error of the first run."""

MAX_ERROR_GROWTH, MIN_ERROR = 0.02, 1e-6
"""Fraction by which errors of a file's own run may grow, and relative error below which growth is no change.

Engines repeat a run to the last digit: an error that grows by 2 % shows a change of the model, its settings
or the engine. Below a millionth of the motion, round-off and the tolerances of solvers decide."""

ERROR_TOLERANCE_REASON = (
    f"{100 * MAX_ERROR_GROWTH:g} % of the error or {MIN_ERROR:g} of the motion, the larger one, plus "
    f"{OWN_ERROR:g} times the change of the error with a reference of a tenth of the tolerance"
)
"""Reason of the tolerances of a file's own run, stored beside them."""

RK4_EVALUATIONS = 4
"""Evaluations of the equations per step of RK4."""

XYZ, WXYZ = ("x", "y", "z"), ("w", "x", "y", "z")
"""Labels of the components of vectors and quaternions."""


def regress_scene(scene: Scene) -> Scene:
    """Return the scene with all kinds of outputs at `OUTPUT_COUNT` times after the initial one.

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
        The quantities, or the message of the first error: an error of the tested code is a result, too.
    """
    try:
        return list(GROUPS[group](Measurement(group, scene, plan, simulation)))
    except Exception as error:
        return reason_of(error)


def measure_group_with_errors(
    group: GroupName, scene: Scene, plan: MeasurementPlan, simulation: FileSimulation[Any] | None = None
) -> list[StoredQuantity] | str:
    """Measure the quantities of one group for a new baseline.

    The group is measured twice, the second time with tighter error control. `OWN_ERROR` times the change of
    each quantity is added to its tolerance.

    Args:
        group: name of the group.
        scene: a result of `regress_scene`.
        plan: settings of the first measurement.
        simulation: the model file in its own engine; None for scenes that are not read from such a file.

    Returns:
        The quantities, or the reason why the group is left out.
    """
    found = measure_group(group, scene, plan, simulation)
    tighter = measure_group(group, scene, plan.tighter(TIGHTER_FACTOR), simulation)
    if isinstance(found, str) or isinstance(tighter, str):
        return found if isinstance(found, str) else tighter
    if wrong := [quantity.name for quantity in found if not np.all(np.isfinite(quantity.array))]:
        return f"{wrong[0]} is not finite"
    quantities = []
    for quantity, other in zip(found, tighter, strict=True):
        changes = np.max(np.abs(other.array - quantity.array), axis=1, initial=0.0)
        if quantity.over_time:
            changes = np.maximum.accumulate(changes)  # errors grow along a run
        else:
            changes = np.full(len(changes), np.max(changes, initial=0.0))
        tolerance = (np.array(quantity.tolerance) + OWN_ERROR * changes).tolist()
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
    # as many evaluations per second as the adaptive run needs, so that RK4 is stable but not exact
    step = float(f"{RK4_EVALUATIONS * scene.duration / run.settings['evaluations']:.1e}")
    for formulation in FORMULATIONS:
        if formulation != MAIN_FORMULATION:
            rtol[formulation] = _feasible_rtol(shortened_scene(scene, formulation, step), formulation)
    return MeasurementPlan(rtol=rtol, step=step, time=float(run.time[n]), state=StoredState.of(run.state(n)))


def _feasible_rtol(scene: Scene, formulation: FormulationName) -> float:
    """Return the first of `CANDIDATE_RTOLS` at which runs complete, also with a tenth of it.

    Raises:
        NewtonEulerError: if no run in `MAIN_FORMULATION` completes. For other formulations the last candidate
            is returned: their group fails later, and is left out with the reason.
    """
    compiled = compile_scene(scene, formulation)
    for rtol in CANDIDATE_RTOLS:
        try:
            for each in (rtol, TIGHTER_FACTOR * rtol):
                compiled.simulate(rtol=each, atol=0.01 * each)
            return rtol
        except NewtonEulerError:
            if rtol == CANDIDATE_RTOLS[-1] and formulation == MAIN_FORMULATION:
                raise
    return CANDIDATE_RTOLS[-1]


def main_run(scene: Scene, rtol: float) -> Trajectory:
    """Run a scene in newton_euler in joint coordinates over its whole duration."""
    return compile_scene(scene, MAIN_FORMULATION).simulate(rtol=rtol, atol=0.01 * rtol)


def shortened_scene(scene: Scene, formulation: str, step: float) -> Scene:
    """Return the scene with the duration of its run in a formulation.

    In `MAIN_FORMULATION` this is the whole duration. In other formulations it is a fraction with one output
    at its end, see `CARTESIAN_FRACTION`.

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
    """Measurement of one group of quantities of a scene.

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
        """Evaluate the equations of a system at a state, time in s."""
        return Samples(at_time(system, time), States(self.scene, (state,)))

    @cached_property
    def run_tolerance(self) -> dict[str, float]:
        """Relative tolerance of accelerations at both states, by formulation; also that of all short runs.

        In a few dozen steps, velocities sum up accelerations, and positions sum up velocities.
        """
        systems = {name: formulate(self.scene, name) for name in FORMULATIONS}
        return {
            name: max(
                _relative_tolerances(self.samples(system, time, state))[0] for _, time, state in self.states
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
            yield from self.evaluation(label, samples, samples.evaluations[0], *_relative_tolerances(samples))

    def evaluation(
        self,
        label: str,
        samples: Samples,
        found: Evaluation,
        acceleration_tolerance: float,
        reaction_tolerance: float,
    ) -> Iterator[StoredQuantity]:
        """Measure accelerations of all bodies and reactions at all joints.

        The part of the reactions that redundant constraints leave undetermined is removed.

        Args:
            label: start of the names, such as "moving".
            samples: equations at one state, with their typical acceleration and force.
            found: accelerations and reactions at the state.
            acceleration_tolerance, reaction_tolerance: relative to typical acceleration and force.
        """
        mechanism, scales = self.scene.mechanism, samples.scales
        bodies, joints, size = mechanism.body_names[1:], mechanism.joint_names, scales.size
        reactions = found.reaction_force[None], found.reaction_torque[None]
        (force,), (torque,) = determined(*reactions, samples.states.undetermined, size)
        acceleration = acceleration_tolerance * scales.acceleration
        reaction = reaction_tolerance * scales.force
        for name, unit, rows, array, allowed in (
            ("linear acceleration", "m/s^2", bodies, found.linear_acceleration[1:], acceleration),
            ("angular acceleration", "rad/s^2", bodies, found.angular_acceleration[1:], acceleration / size),
            ("reaction force", "N", joints, force, reaction),
            ("reaction torque", "N m", joints, torque, reaction * size),
        ):
            yield self.quantity(f"{label}: {name}", unit, array, allowed, rows, XYZ)

    def open_joints(self, formulation: str) -> StoredQuantity:
        """Measure accelerations with joints pulled apart and moving apart, under Baumgarte's stabilization.

        The tolerance uses the condition number of the constraints in this state: constraints that are
        redundant with closed joints are only nearly redundant with open joints.
        """
        system = at_time(formulate(self.scene, formulation, PAPER_ALPHA), self.plan.time)
        q, v = system.coordinates(self.plan.state.state())
        step = JOINT_GAP * system.velocity_units * np.cos(1.0 + np.arange(system.nv))
        opened = system.retract(q, step)
        acceleration = system.acceleration(opened, v + step) / system.velocity_units
        columns = [str(k) for k in range(system.nv)]
        states = States(self.scene, (self.plan.state.state(),))
        condition = admissible_basis(system, opened, states.units)[1] * states.mass_condition
        allowed = round_off(condition, states.noise) * float(np.max(np.abs(acceleration), initial=0.0))
        return self.quantity("open joints: acceleration", "1/s^2", acceleration, allowed, columns=columns)

    def over_time(self, run: Trajectory) -> Iterator[StoredQuantity]:
        """Measure positions and quaternions of all bodies at all output times of a run."""
        rows = [f"{time:.9g} s" for time in run.time]
        for name, unit, array, letters, scale in (
            ("position over time", "m", run.position, XYZ, reach(self.scene, run.position)),
            ("quaternion over time", "", run.quaternion, WXYZ, 1.0),
        ):
            columns = [f"{body} {letter}" for body in run.body_names[1:] for letter in letters]
            yield self.quantity(name, unit, array[:, 1:], round_off(1.0) * scale, rows, columns)

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
        length = relative * reach(self.scene, run.position)
        linear, angular = run.linear_velocity, run.angular_velocity
        speed = relative * max(size, float(np.max(np.abs(linear))), size * float(np.max(np.abs(angular))))
        for name, unit, array, allowed, letters in (
            ("position", "m", run.position, length, XYZ),
            ("quaternion", "", run.quaternion, relative, WXYZ),
            ("linear velocity", "m/s", linear, speed, XYZ),
            ("angular velocity", "rad/s", angular, speed / size, XYZ),
        ):
            yield self.quantity(f"{label}: {name} at the end", unit, array[-1, 1:], allowed, bodies, letters)
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


def _relative_tolerances(samples: Samples) -> tuple[float, float]:
    """Return the relative tolerances of accelerations and of reactions for round-off.

    Condition numbers of constraints and masses magnify round-off, see `crosscheck.compare.accelerations`.
    """
    masses, noise = samples.states.mass_condition, samples.states.noise
    return round_off(samples.condition * masses, noise), round_off(samples.condition**2 * masses, noise)


def _measure_model(here: Measurement) -> Iterator[StoredQuantity]:
    """Measure properties of the model at its initial pose."""
    mechanism = here.scene.mechanism
    bodies, joints = mechanism.bodies[1:], mechanism.joints
    inertias = [rotation(body.quaternion) @ body.inertia @ rotation(body.quaternion).T for body in bodies]
    moments = {"xx": 0, "yy": 4, "zz": 8, "xy": 1, "xz": 2, "yz": 5}  # indices of a flattened 3 x 3 matrix
    tensors = np.reshape(inertias, (-1, 9))[:, list(moments.values())]
    for name, unit, array, rows, columns in (
        ("mass", "kg", [[body.mass] for body in bodies], mechanism.body_names[1:], ("",)),
        ("center of mass", "m", [body.center_of_mass for body in bodies], mechanism.body_names[1:], XYZ),
        ("inertia in world axes", "kg m^2", tensors, mechanism.body_names[1:], tuple(moments)),
        ("joint point", "m", [joint.point for joint in joints], mechanism.joint_names, XYZ),
        ("gravity", "m/s^2", [here.scene.gravity], ("",), XYZ),
    ):
        allowed = round_off(1.0) * float(np.max(np.abs(array), initial=0.0))
        yield here.quantity(name, unit, array, allowed, rows, columns)


def _measure_formulation(here: Measurement) -> Iterator[StoredQuantity]:
    """Measure equations, compiled code and an adaptive run of newton_euler in one formulation."""
    formulation, plan = cast(FormulationName, here.group), here.plan
    yield from here.equations(formulate(here.scene, formulation))
    yield here.open_joints(formulation)
    compiled = compile_scene(shortened_scene(here.scene, formulation, plan.step), formulation)
    for name, operations in compiled.operations.items():
        yield here.count(f"{OPERATIONS_PREFIX}{name}", operations)
    run = compiled.simulate(rtol=plan.rtol[formulation], atol=0.01 * plan.rtol[formulation])
    if formulation == MAIN_FORMULATION:
        yield from here.over_time(run)
    yield from here.end_of_run("DOP853", run, formulation)
    balance = energy_balance(here.scene, run)
    assert balance is not None
    error = float(np.max(np.abs(balance.residual))) / (balance.exchanged or 1.0)
    yield here.quantity("DOP853: energy error", "relative", error, here.run_tolerance[formulation])
    yield from here.counts(compiled, "DOP853")


def _measure_integrators(here: Measurement) -> Iterator[StoredQuantity]:
    """Measure short runs of newton_euler's other integrators, and runs with Baumgarte's stabilization."""
    step, short = here.plan.step, here.short(FIXED_STEP_COUNTS["newton_euler"])
    compiled = compile_scene(short, MAIN_FORMULATION)
    for integrator in ("RK4", "Euler"):
        with _naming_integrator(integrator):
            run = compiled.simulate(integrator, step=step)
        yield from here.end_of_run(integrator, run)
    is_small = compiled.operations["derivative"] <= MAX_SLOW_OPERATIONS
    for formulation in FORMULATIONS if is_small else (MAIN_FORMULATION,):
        name = f"RK4, {formulation}, Baumgarte"
        with _naming_integrator(name):
            run = compile_scene(short, formulation, "baumgarte").simulate("RK4", step=step)
        yield from here.end_of_run(name, run, formulation)
    if is_small:
        rtol = here.plan.rtol["Radau"]
        with _naming_integrator("Radau"):
            run = compiled.simulate("Radau", rtol=rtol, atol=0.01 * rtol)
        yield from here.end_of_run("Radau", run)
        yield from here.counts(compiled, "Radau")


@contextmanager
def _naming_integrator(integrator: str) -> Iterator[None]:
    """Add the name of an integrator to the error message of its run."""
    try:
        yield
    except NewtonEulerError as error:
        raise CrosscheckError(f"{integrator}: {error}") from error


def _measure_engine(here: Measurement) -> Iterator[StoredQuantity]:
    """Measure equations and a short run of MuJoCo or Pinocchio, whichever the group is named after."""
    engine, short = ENGINES[here.group], here.short(FIXED_STEP_COUNTS[here.group])
    (system,) = engine.systems(here.scene)
    yield from here.equations(system)
    if engine.evaluate_soft_constraints is not None:
        samples = here.samples(system, 0.0, initial_state(here.scene))
        soft = MUJOCO_SOLVER_TOLERANCE * samples.condition**2
        found = engine.evaluate_soft_constraints(here.scene)
        yield from here.evaluation("soft constraints", samples, found, soft, soft)
    yield from here.end_of_run("RK4", _run_fixed_steps(here.group, short, here.plan.step))


def _run_fixed_steps(engine: str, scene: Scene, step: float) -> Trajectory:
    """Run a scene in "mujoco" or "pinocchio" with RK4 and a fixed step in s."""
    import mjcf
    import urdf

    if engine == "mujoco":
        return mjcf.simulate(scene, timestep=step)
    assert engine == "pinocchio"
    return urdf.simulate(scene, "RK4", step=step)


def _measure_own_run(here: Measurement) -> Iterator[StoredQuantity]:
    """Measure the errors of the run with the settings of the model file."""
    if here.simulation is None:
        raise CrosscheckError("the model has no run with settings of its own")
    found = measure_error(here.simulation, here.plan.rtol[MAIN_FORMULATION], here.plan.own_run_until)
    error, scale = found.error, found.scale
    for name, unit, value, motion in (
        ("relative error", "", error.relative, 1.0),
        ("error of position", "m", error.position, scale.length),
        ("error of rotation", "rad", error.rotation, scale.angle),
        ("loop opening", "m or rad", found.opening, scale.length),
        ("error of energy", "relative", error.energy, 1.0),
    ):
        allowed = max(MAX_ERROR_GROWTH * value, MIN_ERROR * motion)
        quantity = here.quantity(name, unit, value, allowed)
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
