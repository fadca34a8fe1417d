"""Figures of a scene, measured in groups: equations and runs of each engine, with their tolerances.

newton_euler runs the whole scene in joint coordinates and a tenth of it in Cartesian ones, at tight
tolerances. Its other integrators, MuJoCo and Pinocchio make a few dozen steps of one size: that takes all of
their code, costs the same for every scene, and lets round-off grow little. The equations of all engines are
evaluated at the initial state and at one that the scene passes through, those of newton_euler also with the
joints open, where Baumgarte's gains act.

Tolerances are those of the levels of `crosscheck.compare`: of equations round-off times condition, of runs
that and what they change by where their error control is tighter.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Final, cast

import numpy as np
from numpy.typing import ArrayLike

from crosscheck.compare.check import OWN_ERROR, reach, round_off
from crosscheck.compare.energy import energy_balance
from crosscheck.compare.samples import Samples, States, admissible_basis
from crosscheck.engines.engine import ENGINES
from crosscheck.regress.baseline import (
    COUNTED,
    OPERATIONS,
    GroupName,
    Plan,
    StoredFigure,
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
from newton_euler.runs.assemble import initial_state
from newton_euler.runs.simulate import CompiledScene

OUTPUT_COUNT = 25
"""Output times of a whole run beside the start: enough to tell when it parts from the baseline."""

STEPS = {"newton_euler": 40, "mujoco": 40, "pinocchio": 10}
"""Numbers of steps of runs with fixed steps. Python calls Pinocchio four times per step."""

SHARE, MOST_STEPS = 0.1, 1000
"""Fraction of the scene's duration, and largest number of fixed steps, of the run in Cartesian coordinates.
For redundant or nearly singular constraints it costs a hundred times as much as in joint coordinates, and
both use the same integrator."""

MOST_OPERATIONS = 1500
"""Largest number of operations of a right-hand side for which Radau's traced derivatives, and the Cartesian
form with Baumgarte gains, are compiled too. In larger scenes they take longer than everything else, and test
no further code."""

RADAU: Final = "Radau"
"""The method of order 5."""

RADAU_RTOL = 1e-10
"""Its tolerance: a few hundred steps for as long as the others' short runs."""

COUNT_RTOL, COUNT_SHARE = 1e-6, 0.02
"""Relative tolerance of the runs whose steps are counted, and the fraction by which a count may grow. At the
tolerances of other runs the number of steps depends on the round-off of the processor. Other versions of
libraries round constants differently, which can add or remove a step."""

OPEN = 1e-3
"""Distance of coordinates from the constraints, sizes of the mechanism or rad; of velocities the same per
second."""

SOFT = 1e-8
"""Relative improvement below which MuJoCo stops to iterate soft constraint forces, its default."""

RTOLS = (1e-12, 1e-11, 1e-10, 1e-9, 1e-8)
"""Relative tolerances of runs: the first one is used at which a run with a tenth of it also completes."""

TIGHTER = 0.1
"""Times the tolerances of a run, for what it changes by."""

EVALUATIONS = 4
"""Evaluations of the equations in a step of RK4."""

XYZ, WXYZ = ("x", "y", "z"), ("w", "x", "y", "z")
MOMENTS = ("xx", "yy", "zz", "xy", "xz", "yz")


def regress_scene(scene: Scene) -> Scene:
    """The scene with all outputs at `OUTPUT_COUNT` times.

    Reactions at an output of a mechanism with redundant constraints are worked out in Python, so that
    hundreds of outputs would take longer than all else.
    """
    return replace(scene, output_period=scene.duration / OUTPUT_COUNT, outputs=frozenset(OUTPUTS))


def measure_group(group: GroupName, scene: Scene, plan: Plan) -> list[StoredFigure] | str:
    """The figures of one group, or why there are none.

    Whatever goes wrong in it is a result, as figures are: that of the code which is guarded.
    """
    try:
        return list(GROUPS[group](Measurement(group, scene, plan)))
    except Exception as error:
        return reason_of(error)


def with_own_errors(group: GroupName, scene: Scene, plan: Plan) -> list[StoredFigure] | str:
    """The figures of one group, with what tighter error control changes of them in their tolerances."""
    found = measure_group(group, scene, plan)
    tighter = measure_group(group, scene, plan.tighter(TIGHTER))
    if isinstance(found, str) or isinstance(tighter, str):
        return found if isinstance(found, str) else tighter
    if wrong := [figure.name for figure in found if not np.all(np.isfinite(figure.array))]:
        return f"{wrong[0]} is not finite"
    figures = []
    for figure, other in zip(found, tighter, strict=True):
        changes = np.max(np.abs(other.array - figure.array), axis=1, initial=0.0)
        if figure.over_time:
            changes = np.maximum.accumulate(changes)
        else:
            changes = np.full(len(changes), np.max(changes, initial=0.0))
        tolerance = (np.array(figure.tolerance) + OWN_ERROR * changes).tolist()
        figures.append(figure.model_copy(update={"tolerance": tolerance}))
    return figures


def make_plan(scene: Scene) -> Plan:
    """Settings of the measurement of a scene.

    Raises:
        NewtonEulerError: for a scene that newton_euler cannot run at any tolerance.
    """
    rtol: dict[str, float] = {MAIN: _tolerance(scene, MAIN), RADAU: RADAU_RTOL}
    run = main_run(scene, rtol[MAIN])
    assert run.kinetic_energy is not None
    # half of the largest kinetic energy: all moves, nothing is special
    n = int(np.argmin(np.abs(run.kinetic_energy - 0.5 * np.max(run.kinetic_energy))))
    # as many evaluations a second as the adaptive run needs, so that RK4 is stable and not exact
    step = float(f"{EVALUATIONS * scene.duration / run.settings['evaluations']:.1e}")
    for formulation in FORMULATIONS:
        if formulation != MAIN:
            rtol[formulation] = _tolerance(part(scene, formulation, step), formulation)
    return Plan(rtol=rtol, step=step, time=float(run.time[n]), state=StoredState.of(run.state(n)))


def _tolerance(scene: Scene, formulation: FormulationName) -> float:
    """The first of the `RTOLS` that works, also a tenth as large."""
    compiled = compile_scene(scene, formulation)
    for rtol in RTOLS:
        try:
            for each in (rtol, TIGHTER * rtol):
                compiled.simulate(rtol=each, atol=0.01 * each)
            return rtol
        except NewtonEulerError:
            if rtol == RTOLS[-1] and formulation == MAIN:
                raise
    return RTOLS[-1]  # the group fails at it, and is left out with the reason


def main_run(scene: Scene, rtol: float) -> Trajectory:
    """The run that a recording shows: newton_euler in joint coordinates."""
    return compile_scene(scene, MAIN).simulate(rtol=rtol, atol=0.01 * rtol)


def part(scene: Scene, formulation: str, step: float) -> Scene:
    """The part of a scene that is run in a formulation: all output times, or the end of a part."""
    if formulation == MAIN:
        return scene
    duration = min(SHARE * scene.duration, MOST_STEPS * step)
    return replace(scene, duration=duration, output_period=duration)


@dataclass(frozen=True, eq=False)
class Measurement:
    """The measurement of one group of figures of a scene, as a plan says."""

    group: GroupName
    scene: Scene
    plan: Plan

    @cached_property
    def states(self) -> tuple[tuple[str, float, State], ...]:
        """Names, times (s) and states at which equations are evaluated."""
        return ("start", 0.0, initial_state(self.scene)), ("moving", self.plan.time, self.plan.state.state())

    def samples(self, system: System, time: float, state: State) -> Samples:
        return Samples(at_time(system, time), States(self.scene, (state,)))

    @cached_property
    def share(self) -> dict[str, float]:
        """Round-off of accelerations at both states: the tolerance of their level, and of all short runs.

        A few dozen steps add up velocities from accelerations, and lengths from velocities.
        """
        systems = {name: formulate(self.scene, name) for name in FORMULATIONS}
        return {
            name: max(_shares(self.samples(system, time, state))[0] for _, time, state in self.states)
            for name, system in systems.items()
        }

    def figure(
        self,
        name: str,
        unit: str,
        array: ArrayLike,
        tolerance: float,
        rows: Sequence[str] = ("",),
        columns: Sequence[str] = ("",),
    ) -> StoredFigure:
        """(rows, columns) numbers, each with the same tolerance."""
        return StoredFigure.model_construct(
            group=self.group,
            name=name,
            unit=unit,
            rows=list(rows),
            columns=list(columns),
            value=np.reshape(array, (len(rows), len(columns))).tolist(),
            tolerance=[tolerance] * len(rows),
        )

    def count(self, name: str, value: int) -> StoredFigure:
        """A number of steps, evaluations or operations."""
        return self.figure(name, "", float(value), float(np.ceil(COUNT_SHARE * value)))

    def equations(self, system: System) -> Iterator[StoredFigure]:
        """Accelerations and reactions of a system at both states."""
        for label, time, state in self.states:
            samples = self.samples(system, time, state)
            yield from self.evaluation(label, samples, samples.evaluations[0], *_shares(samples))

    def evaluation(
        self, label: str, samples: Samples, found: Evaluation, share: float, looser: float
    ) -> Iterator[StoredFigure]:
        """Accelerations of all bodies and reactions at all joints, as far as they are determined."""
        mechanism, scales = self.scene.mechanism, samples.scales
        bodies, joints, size = mechanism.body_names[1:], mechanism.joint_names, scales.size
        reactions = found.reaction_force[None], found.reaction_torque[None]
        (force,), (torque,) = determined(*reactions, samples.states.undetermined, size)
        acceleration, reaction = share * scales.acceleration, looser * scales.force
        for name, unit, rows, array, allowed in (
            ("linear acceleration", "m/s^2", bodies, found.linear_acceleration[1:], acceleration),
            ("angular acceleration", "rad/s^2", bodies, found.angular_acceleration[1:], acceleration / size),
            ("reaction force", "N", joints, force, reaction),
            ("reaction torque", "N m", joints, torque, reaction * size),
        ):
            yield self.figure(f"{label}: {name}", unit, array, allowed, rows, XYZ)

    def open_joints(self, formulation: str) -> StoredFigure:
        """Accelerations where joints are open and opening, under Baumgarte's gains.

        The tolerance is that of accelerations with the condition there: rows that are redundant where joints
        are closed are nearly so.
        """
        system = at_time(formulate(self.scene, formulation, PAPER_ALPHA), self.plan.time)
        q, v = system.coordinates(self.plan.state.state())
        step = OPEN * system.velocity_units * np.cos(1.0 + np.arange(system.nv))
        opened = system.retract(q, step)
        acceleration = system.acceleration(opened, v + step) / system.velocity_units
        columns = [str(k) for k in range(system.nv)]
        states = States(self.scene, (self.plan.state.state(),))
        condition = admissible_basis(system, opened, states.units)[1] * states.mass_condition
        allowed = round_off(condition, states.noise) * float(np.max(np.abs(acceleration), initial=0.0))
        return self.figure("open joints: acceleration", "1/s^2", acceleration, allowed, columns=columns)

    def over_time(self, run: Trajectory) -> Iterator[StoredFigure]:
        """Positions and quaternions of all bodies at all output times."""
        rows = [f"{time:.9g} s" for time in run.time]
        for name, unit, array, letters, scale in (
            ("position over time", "m", run.position, XYZ, reach(self.scene, run.position)),
            ("quaternion over time", "", run.quaternion, WXYZ, 1.0),
        ):
            columns = [f"{body} {letter}" for body in run.body_names[1:] for letter in letters]
            yield self.figure(name, unit, array[:, 1:], round_off(1.0) * scale, rows, columns)

    def end_of_run(
        self, label: str, run: Trajectory, formulation: str = "relative"
    ) -> Iterator[StoredFigure]:
        """Poses and velocities of all bodies at the end, and by how much joints were open at most."""
        assert run.linear_velocity is not None
        assert run.angular_velocity is not None
        assert run.constraint_violation is not None
        bodies, size = run.body_names[1:], self.scene.mechanism.size
        share = self.share[formulation]
        length = share * reach(self.scene, run.position)
        linear, angular = run.linear_velocity, run.angular_velocity
        speed = share * max(size, float(np.max(np.abs(linear))), size * float(np.max(np.abs(angular))))
        for name, unit, array, allowed, letters in (
            ("position", "m", run.position, length, XYZ),
            ("quaternion", "", run.quaternion, share, WXYZ),
            ("linear velocity", "m/s", linear, speed, XYZ),
            ("angular velocity", "rad/s", angular, speed / size, XYZ),
        ):
            yield self.figure(f"{label}: {name} at the end", unit, array[-1, 1:], allowed, bodies, letters)
        drift = np.max(run.constraint_violation, initial=0.0)
        yield self.figure(f"{label}: drift", "m or rad", drift, share * max(size, 1.0))

    def counts(self, compiled: CompiledScene, integrator: IntegratorName) -> Iterator[StoredFigure]:
        """Steps and evaluations of a run at `COUNT_RTOL`."""
        run = compiled.simulate(integrator, rtol=COUNT_RTOL, atol=0.01 * COUNT_RTOL)
        for name in COUNTED:
            key = name.removeprefix(": ")
            yield self.count(f"{integrator}, rtol {COUNT_RTOL:g}{name}", run.settings[key])

    def short(self, steps: int) -> Scene:
        """A few steps from the moving state; from the start where motions are prescribed from there."""
        start = initial_state(self.scene) if self.scene.motions else self.plan.state.state()
        duration = steps * self.plan.step
        return replace(self.scene, duration=duration, output_period=duration, initial_state=start)


def _shares(samples: Samples) -> tuple[float, float]:
    """Round-off of accelerations and of reactions, relative, see `comparison.accelerations`."""
    masses, noise = samples.states.mass_condition, samples.states.noise
    return round_off(samples.condition * masses, noise), round_off(samples.condition**2 * masses, noise)


def _model(here: Measurement) -> Iterator[StoredFigure]:
    """Measure what the scene is made of, at its initial pose: its changes explain those of other figures."""
    mechanism = here.scene.mechanism
    bodies, joints = mechanism.bodies[1:], mechanism.joints
    turned = [rotation(body.quaternion) @ body.inertia @ rotation(body.quaternion).T for body in bodies]
    tensors = np.reshape(turned, (-1, 9))[:, [0, 4, 8, 1, 2, 5]]
    for name, unit, array, rows, columns in (
        ("mass", "kg", [[body.mass] for body in bodies], mechanism.body_names[1:], ("",)),
        ("center of mass", "m", [body.center_of_mass for body in bodies], mechanism.body_names[1:], XYZ),
        ("inertia in world axes", "kg m^2", tensors, mechanism.body_names[1:], MOMENTS),
        ("joint point", "m", [joint.point for joint in joints], mechanism.joint_names, XYZ),
        ("gravity", "m/s^2", [here.scene.gravity], ("",), XYZ),
    ):
        allowed = round_off(1.0) * float(np.max(np.abs(array), initial=0.0))
        yield here.figure(name, unit, array, allowed, rows, columns)


def _formulation(here: Measurement) -> Iterator[StoredFigure]:
    formulation, plan = cast(FormulationName, here.group), here.plan
    yield from here.equations(formulate(here.scene, formulation))
    yield here.open_joints(formulation)
    compiled = compile_scene(part(here.scene, formulation, plan.step), formulation)
    for name, operations in compiled.operations.items():
        yield here.count(f"{OPERATIONS}{name}", operations)
    run = compiled.simulate(rtol=plan.rtol[formulation], atol=0.01 * plan.rtol[formulation])
    if formulation == MAIN:
        yield from here.over_time(run)
    yield from here.end_of_run("DOP853", run, formulation)
    found = energy_balance(here.scene, run)
    assert found is not None
    error = float(np.max(np.abs(found.residual))) / (found.exchanged or 1.0)
    yield here.figure("DOP853: energy error", "relative", error, here.share[formulation])
    yield from here.counts(compiled, "DOP853")


def _integrators(here: Measurement) -> Iterator[StoredFigure]:
    step, short = here.plan.step, here.short(STEPS["newton_euler"])
    compiled = compile_scene(short, MAIN)
    for integrator in ("RK4", "Euler"):
        with _named(integrator):
            run = compiled.simulate(integrator, step=step)
        yield from here.end_of_run(integrator, run)
    small = compiled.operations["derivative"] <= MOST_OPERATIONS
    for formulation in FORMULATIONS if small else (MAIN,):
        name = f"RK4, {formulation}, Baumgarte"
        with _named(name):
            run = compile_scene(short, formulation, "baumgarte").simulate("RK4", step=step)
        yield from here.end_of_run(name, run, formulation)
    if small:
        rtol = here.plan.rtol[RADAU]
        with _named(RADAU):
            run = compiled.simulate(RADAU, rtol=rtol, atol=0.01 * rtol)
        yield from here.end_of_run(RADAU, run)
        yield from here.counts(compiled, RADAU)


@contextmanager
def _named(integrator: str) -> Iterator[None]:
    """Name the integrator in the error of a run."""
    try:
        yield
    except NewtonEulerError as error:
        raise CrosscheckError(f"{integrator}: {error}") from error


def _engine(here: Measurement) -> Iterator[StoredFigure]:
    engine, short = ENGINES[here.group], here.short(STEPS[here.group])
    (system,) = engine.systems(here.scene)
    yield from here.equations(system)
    if engine.evaluate_soft_constraints is not None:
        samples = here.samples(system, 0.0, initial_state(here.scene))
        soft = SOFT * samples.condition**2
        yield from here.evaluation(
            "soft constraints", samples, engine.evaluate_soft_constraints(here.scene), soft, soft
        )
    yield from here.end_of_run("RK4", _fixed_run(here.group, short, here.plan.step))


def _fixed_run(engine: str, scene: Scene, step: float) -> Trajectory:
    import mjcf
    import urdf

    if engine == "mujoco":
        return mjcf.simulate(scene, timestep=step)
    assert engine == "pinocchio"
    return urdf.simulate(scene, "RK4", step=step)


MAIN: FormulationName = "relative"
"""The formulation and group whose run is stored over time."""

GROUPS: dict[GroupName, Callable[[Measurement], Iterator[StoredFigure]]] = {
    "model": _model,
    "relative": _formulation,
    "cartesian": _formulation,
    "integrators": _integrators,
    "mujoco": _engine,
    "pinocchio": _engine,
}
"""Measurements of figures, by name."""
