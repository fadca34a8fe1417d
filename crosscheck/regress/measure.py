"""Measure the quantities of a scene that `crosscheck regress` compares with a baseline.

A scene is a mechanism (bodies and joints) with forces, inputs, initial state and duration. The quantities
come in groups: properties of the model; equations and runs of the solver newton_euler in each of its two
formulations; its other integrators; other engines; and the "own run". The own run is the run of a
model file (MJCF or URDF) in the file's engine with the time step and solver settings of the file. A
formulation is a choice of coordinates: "relative" are joint coordinates, "cartesian" are the positions and
orientations of all bodies.

newton_euler runs the whole scene in joint coordinates, and a tenth of its duration in Cartesian coordinates,
at tight tolerances; `crosscheck.regress.plan` chooses these settings. The other integrators and engines make
a few dozen steps of one size. Such short runs execute all of their code, cost the same for every scene, and
accumulate little round-off.

The tolerance of a quantity is the largest change that passes as round-off. Tolerances of equations and runs
for round-off come from `crosscheck.regress.quantities`. A new baseline adds the change of each quantity in a
second run with tighter error control.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, cast

import numpy as np

from crosscheck.compare.check import ERROR_PER_CHANGE, round_off
from crosscheck.engines.energy import energy_balance
from crosscheck.engines.limits import require_expressed
from crosscheck.engines.registry import SOLVER, choose
from crosscheck.own_run.judge import measure_error
from crosscheck.regress.baseline import (
    OPERATIONS_PREFIX,
    OWN_RUN_GROUP,
    GroupName,
    MeasurementPlan,
    StoredQuantity,
)
from crosscheck.regress.plan import MAIN_FORMULATION, TIGHTER_FACTOR, shortened_scene
from crosscheck.regress.quantities import XYZ, Measurement, RelativeTolerances
from crosscheck.support.errors import CrosscheckError, reason_of
from newton_euler import compile_scene
from newton_euler.compiled.formulations import FORMULATIONS, formulate
from newton_euler.errors import NewtonEulerError
from newton_euler.integrators.options import FormulationName
from newton_euler.model.euler_parameters import rotation
from newton_euler.model.scene import Scene
from newton_euler.reading.file_run import FileSimulation
from newton_euler.runs.assemble import initial_state

FIXED_STEPS = 40
"""Number of steps of short runs of newton_euler's integrators without error control."""

MAX_SLOW_OPERATIONS = 1500
"""Largest number of arithmetic operations of the compiled right-hand side dv/dt for which code that is slow
to compile is measured, too.

Slow to compile are the derivatives of the right-hand side for Radau, and Cartesian equations with Baumgarte's
stabilization. In larger scenes they would take longer than all other measurements, and test no further
code."""

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


def measure_group(
    group: GroupName, scene: Scene, plan: MeasurementPlan, simulation: FileSimulation[Any] | None = None
) -> list[StoredQuantity] | str:
    """Measure the quantities of one group, with tolerances for round-off only.

    Args:
        group: name of the group.
        scene: a result of `crosscheck.regress.plan.regress_scene`.
        plan: settings of the measurement.
        simulation: the model file in its own engine; None for scenes that are not read from such a file.

    Returns:
        The quantities, or the message of the first error of any kind: an error of the tested code is a result
        that is compared with the baseline, too.
    """
    measure = GROUPS.get(group, _measure_engine)
    try:
        return list(measure(Measurement(group, scene, plan, simulation)))
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
        scene: a result of `crosscheck.regress.plan.regress_scene`.
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
    step, short = measurement.plan.step, measurement.short(FIXED_STEPS)
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
    """Measure equations and a short run of the engine that the group is named after."""
    scene = measurement.scene
    (engine,) = choose([measurement.group])
    require_expressed(engine.name, engine.limits(scene))
    system, *_ = engine.systems(scene) or (None,)  # equations of motion with rigid constraints
    if system is None and engine.fixed_steps is None:
        raise CrosscheckError(f"{engine.name} has neither equations of motion nor runs of fixed steps")
    if system is not None:
        yield from measurement.equations(system)
    if system is not None and engine.soft_constraints is not None:
        samples = measurement.samples(system, 0.0, initial_state(scene))
        # the constraints magnify the solver's error twice, as in reactions under rigid constraints
        soft = engine.soft_constraints.solver_tolerance * samples.condition**2
        solution = engine.soft_constraints.evaluate(scene)
        tolerances = RelativeTolerances(acceleration=soft, reaction=soft)
        yield from measurement.evaluation("soft constraints", samples, solution, tolerances)
    if (fixed := engine.fixed_steps) is not None:
        settings = fixed.settings(measurement.plan.step)
        run = engine.simulate(measurement.short(fixed.steps), settings)
        yield from measurement.end_of_run(fixed.integrator, run)


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
    OWN_RUN_GROUP: _measure_own_run,
}
"""Functions that measure all quantities of a group, by the name of the group; other groups are engines."""


def groups_with(engines: Iterable[str]) -> list[GroupName]:
    """Return the names of all groups, with those of engines, in the order of a baseline."""
    fixed = [group for group in GROUPS if group != OWN_RUN_GROUP]
    return [*fixed, *(name for name in engines if name != SOLVER.name), OWN_RUN_GROUP]
