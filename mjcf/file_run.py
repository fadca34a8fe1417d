"""Simulate an MJCF file in MuJoCo with the file's own time step, integrator, solver and soft constraints.

A scene is the mechanism with forces and control laws that `mjcf.reader` imports from the file. crosscheck
compares a run of the file with an accurate reference solution of the scene, to measure the error of the
file's settings and the causes of the error. The run has the initial state and the controls of the scene. In a
complete run, all elements of the file act, and the run records when each contact, limit and dry friction acts
first. In a reduced run, the elements that the scene does not have, such as contacts, are switched off.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import mujoco
import numpy as np

from mjcf.errors import collected_warnings
from mjcf.layout import element_name
from mjcf.modes import MujocoSmallMotions
from mjcf.reference import UNSIMULATED_FEATURES, MjcfReference
from mjcf.report_audit import switch_off_left_out
from newton_euler.equations.dense import least_squares
from newton_euler.model.euler_parameters import continuous
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Sine
from newton_euler.model.trajectory import Trajectory
from newton_euler.reading.file_run import (
    CONTACT_OF,
    INTEGRATOR,
    TIME_STEP,
    Cause,
    Event,
    FileRun,
    FileSimulation,
    LoopErrors,
    evaluations_per_step,
)
from newton_euler.reading.import_report import ImportReport
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array

DEFAULT_SOLIMP = (0.9, 0.95, 0.001)
"""MuJoCo's default of the first three numbers of `solimp`: impedances dmin and dmax, and width, m."""

RIGID_SOLIMP = (0.9999, 0.9999, 0.001)
"""First three numbers of `solimp` for the largest impedances that MuJoCo accepts, with the default width."""

CONVERGED_SOLVER: dict[str, Any] = {"solver": "Newton", "iterations": 1000, "tolerance": 1e-14}
"""Settings of the constraint solver with which it iterates until round-off ends its progress."""

DEFAULT_SOLVER: dict[str, Any] = {"solver": "Newton", "iterations": 100, "tolerance": 1e-8}
"""MuJoCo's default settings of the constraint solver; Newton's method converges in a few iterations."""

FINE_STEP_DIVISOR = 10
"""Divisor of the time step in a run that shows the error of the step: methods of order 1 leave a tenth of it.
"""

MAX_LISTED = 5
"""Largest number of equalities that a comment in an XML fragment names."""

INTEGRATORS = ("Euler", "implicit", "implicitfast", "RK4")
"""MuJoCo's integrators by their name in MJCF."""

EVENT_KINDS = {
    mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT: ("limits", "joint"),
    mujoco.mjtConstraint.mjCNSTR_LIMIT_TENDON: ("limits", "tendon"),
    mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF: ("dry friction", "joint"),
    mujoco.mjtConstraint.mjCNSTR_FRICTION_TENDON: ("dry friction", "tendon"),
}
"""Topic and kind of element, by type of MuJoCo's constraint rows, of limits and dry friction, which the
imported scene does not have."""


@dataclass(frozen=True)
class MujocoSettings:
    """Settings of a run in MuJoCo, with the names of MJCF.

    Attributes:
        timestep: s.
        integrator: one of `INTEGRATORS`.
        solver: "Newton", "CG" or "PGS".
        iterations: largest number of iterations of the constraint solver.
        tolerance: relative improvement at which the constraint solver stops.
        solref: softness of all equalities; None keeps the softness that each equality has in the file.
        solimp: first three numbers of the impedance of all equalities; None keeps the numbers in the file.
    """

    timestep: float
    integrator: str
    solver: str
    iterations: int
    tolerance: float
    solref: tuple[float, float] | None = None
    solimp: tuple[float, float, float] | None = None

    @classmethod
    def of(cls, model: Any) -> MujocoSettings:
        """Read the settings of a compiled model; the softness of equalities stays as in the model (None)."""
        # MuJoCo's constants are in capital letters, the names of MJCF are not
        integrator = mujoco.mjtIntegrator(model.opt.integrator).name.removeprefix("mjINT_")
        solver = mujoco.mjtSolver(model.opt.solver).name.removeprefix("mjSOL_")
        return cls(
            timestep=float(model.opt.timestep),
            integrator=integrator if integrator == "RK4" else integrator.lower().replace("euler", "Euler"),
            solver=solver if solver != "NEWTON" else "Newton",
            iterations=int(model.opt.iterations),
            tolerance=float(model.opt.tolerance),
        )

    def apply(self, model: Any) -> None:
        """Set these settings in a compiled model."""
        model.opt.timestep = self.timestep
        model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{self.integrator.upper()}")
        model.opt.solver = getattr(mujoco.mjtSolver, f"mjSOL_{self.solver.upper()}")
        model.opt.iterations, model.opt.tolerance = self.iterations, self.tolerance
        if self.solref is not None:
            model.eq_solref[:] = self.solref
        if self.solimp is not None:
            model.eq_solimp[:, :3] = self.solimp


class Inputs:
    """Controls of a run: constants, and sines about them.

    Attributes:
        control: (nu,) controls at the start.
        activation: (na,) activations at the start.
    """

    def __init__(self, model: Any, control: Array, activation: Array, sines: Mapping[int, Sine]) -> None:
        """Take the inputs of an imported scene.

        For an activation a(t) = a_0 + A sin(w t), an actuator with dynamics "integrator" needs the control
        da/dt. An actuator with dynamics "filter" needs a + tau da/dt (MuJoCo's documentation, Modeling,
        Actuator, attribute dyntype).

        Args:
            model: compiled model.
            control: (nu,) controls at the start.
            activation: (na,) activations at the start.
            sines: sine of the control, or of the activation of an actuator with dynamics, by number of the
                actuator.
        """
        self.control, self.activation = control, activation
        self._control_indices = np.array([model.actuator_ctrladr[k] for k in sines], dtype=int)
        self._frequency = np.array([sine.angular_frequency for sine in sines.values()])
        # amplitudes of sin(w t) and cos(w t) in the control of each actuator
        by_sine, by_cosine = [], []
        for actuator, sine in sines.items():
            rate = sine.amplitude * sine.angular_frequency
            match mujoco.mjtDyn(model.actuator_dyntype[actuator]):
                case mujoco.mjtDyn.mjDYN_NONE:
                    of_sine, of_cosine = sine.amplitude, 0.0
                case mujoco.mjtDyn.mjDYN_INTEGRATOR:
                    of_sine, of_cosine = 0.0, rate
                case mujoco.mjtDyn.mjDYN_FILTER | mujoco.mjtDyn.mjDYN_FILTEREXACT:
                    tau = float(model.actuator_dynprm[actuator, 0])
                    of_sine, of_cosine = sine.amplitude, rate * tau
                case kind:
                    raise NotImplementedError(f"sine of an actuator with dynamics {kind.name}")
            by_sine.append(of_sine)
            by_cosine.append(of_cosine)
        self._by_sine, self._by_cosine = np.array(by_sine), np.array(by_cosine)

    @property
    def are_constant(self) -> bool:
        """True if no control follows a sine."""
        return not len(self._control_indices)

    def at(self, times: float | Array) -> Array:
        """Return the controls (nu,) at a time, s, or (n, nu) at n times."""
        phase = np.multiply.outer(times, self._frequency)
        controls = np.broadcast_to(self.control, (*phase.shape[:-1], len(self.control))).copy()
        sines = self._by_sine * np.sin(phase) + self._by_cosine * np.cos(phase)
        controls[..., self._control_indices] += sines
        return controls

    @property
    def terms(self) -> dict[str, list[float]]:
        """Numbers (nu,) of the controls constant + sine sin(w t) + cosine cos(w t), by name.

        "angular_frequency" is w, rad/s; it is 0 for a constant control.
        """
        frequency, sine, cosine = np.zeros((3, len(self.control)))
        frequency[self._control_indices] = self._frequency
        sine[self._control_indices], cosine[self._control_indices] = self._by_sine, self._by_cosine
        terms = {"constant": self.control, "sine": sine, "cosine": cosine, "angular_frequency": frequency}
        return {name: values.tolist() for name, values in terms.items()}


def _numbers(values: tuple[float, ...] | None) -> str:
    """Write numbers as in MJCF; "" for None."""
    return "" if values is None else " ".join(f"{x:.10g}" for x in values)


def _attributes(values: Mapping[str, str]) -> str:
    """Write attributes as in XML."""
    return " ".join(f'{name}="{value}"' for name, value in values.items())


def _differing_numbers(model: Any, changed: Any) -> dict[str, Any]:
    """Return the numbers and arrays of a changed `MjModel` that differ from those of a model.

    Keys are the attributes of the `MjModel` in Python, such as "opt.disableflags".
    """
    differing: dict[str, Any] = {}
    for prefix, before, after in (("opt.", model.opt, changed.opt), ("", model, changed)):
        for name in dir(before):
            value = getattr(after, name)
            is_number = isinstance(value, int | float | np.ndarray) and not name.startswith("_")
            if is_number and not np.array_equal(getattr(before, name), value, equal_nan=True):
                differing[prefix + name] = np.asarray(value).tolist()
    return differing


class MujocoFile(FileSimulation[MujocoSettings]):
    """MJCF file with its own settings, at the start of an imported scene.

    Attributes:
        scene: imported scene.
        settings: settings of the file.
        own_softness: equalities of the file that take `solref` or `solimp` from elsewhere than the top-level
            `<default>`, such as "connect 'loop'". A change of `<default>` does not reach them.
    """

    own_softness: Sequence[str] = ()

    engine = f"MuJoCo {mujoco.__version__}"

    def __init__(
        self, model: Any, reference: MjcfReference, scene: Scene, report: ImportReport, inputs: Inputs
    ) -> None:
        """Take a compiled model, which is not changed.

        Args:
            model: compiled model of the file.
            reference: compiled model with which the import of the scene is verified. Its start, qpos with
                closed loops, is the start of the run. It also maps MuJoCo's bodies to bodies of the scene.
            scene: imported scene.
            report: import report, which lists the elements that the scene does not have.
            inputs: controls of the scene.
        """
        self._model, self.scene, self._report, self._inputs = model, scene, report, inputs
        self.settings = MujocoSettings.of(model)
        self._start = reference.start
        # bodies of the scene, and the rigid groups of MuJoCo's bodies that each of them represents
        self._names = reference.names
        self._groups = reference.groups
        self._prepared_models: dict[bool, tuple[Any, Array]] = {}
        # qvel from the initial velocities of the scene's bodies
        state = initial_state(scene)
        bodies = [scene.mechanism.body_names.index(name) for name in self._names]
        body_velocities = np.hstack([state.linear_velocity[bodies], state.angular_velocity[bodies]])
        # Jacobian (g, 6, nv) of the linear, then angular velocities of the rigid groups
        jacobian = reference.kinematics(self._start, np.zeros(model.nv)).transformation
        self._velocity = least_squares(jacobian.reshape(-1, model.nv), body_velocities.ravel())

    def words(self) -> str:
        """Describe the settings of the file in one short text, such as "implicitfast, 2 ms, solref 0.02"."""
        settings = self.settings
        words = [settings.integrator, f"{1e3 * settings.timestep:g} ms"]
        if settings.solver != "Newton":
            words.append(f"solver {settings.solver}")
        if self._model.neq:
            time_constants = np.unique(self._model.eq_solref[:, 0])
            words.append(f"solref {' and '.join(f'{value:g}' for value in time_constants)}")
            is_raised = not self._model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_REFSAFE
            if is_raised and np.any((time_constants > 0.0) & (time_constants < 2.0 * settings.timestep)):
                words.append(f"raised by MuJoCo to two steps, {2.0 * settings.timestep:g}")
            impedances = np.unique(self._model.eq_solimp[:, :3], axis=0)
            if np.any(impedances != DEFAULT_SOLIMP):
                texts = [" ".join(f"{x:g}" for x in row) for row in impedances]
                words.append(f"solimp {' and '.join(texts)}")
        return ", ".join(words)

    def changes(self, settings: MujocoSettings) -> dict[str, str]:
        """Map the settings that differ from those of the file to their values as text, by name in MJCF."""
        given = {
            "timestep": f"{settings.timestep:.10g}",
            "integrator": settings.integrator,
            "solver": settings.solver,
            "iterations": f"{settings.iterations}",
            "tolerance": f"{settings.tolerance:g}",
            "solref": _numbers(settings.solref),
            "solimp": _numbers(settings.solimp),
        }
        of_file = vars(self.settings)
        return {
            name: value for name, value in given.items() if value and vars(settings)[name] != of_file[name]
        }

    def fragment(self, settings: MujocoSettings) -> str:
        """Return the XML elements that give the file these settings.

        A comment names the equalities that `<default>` does not reach.
        """
        changes = self.changes(settings)
        softness: dict[str, str] = {}
        for name in ("solref", "solimp"):
            if name in changes:
                softness[name] = changes.pop(name)
        lines = [f"<option {_attributes(changes)}/>"] if changes else []
        if softness:
            lines.append(f"<default><equality {_attributes(softness)}/></default>")
            if self.own_softness:
                elements = ", ".join(self.own_softness[:MAX_LISTED])
                more = len(self.own_softness) - MAX_LISTED
                lines.append(
                    f"<!-- {_attributes(softness)} also in equalities with solref, solimp or class of their "
                    f"own: {elements}{f' and {more} more' if more > 0 else ''} -->"
                )
        return "\n".join(lines)

    def run_inputs(self, reduced: bool) -> dict[str, Any]:
        """Return start and controls of a run, as numbers for JSON, so that MuJoCo alone can repeat the run.

        Args:
            reduced: True for a run without the elements that the imported scene does not have.

        Returns:
            Initial "qpos", "qvel", "act" and "eq_active"; "ctrl", see `Inputs.terms`; "model", the numbers
            and arrays of the compiled file that the run changes, such as "opt.disableflags"; and "bodies",
            MuJoCo's indices of the bodies that are one body of the scene, by its name, the root first.
        """
        model, active = self._prepared(reduced)
        self.settings.apply(model)
        return {
            "qpos": self._start.tolist(),
            "qvel": self._velocity.tolist(),
            "act": self._inputs.activation.tolist(),
            "eq_active": active.tolist(),
            "ctrl": self._inputs.terms,
            "model": _differing_numbers(self._model, model),
            "bodies": {
                name: [root, *(member for member in members.tolist() if member != root)]
                for name, (root, members) in zip(self._names, self._groups, strict=True)
            },
        }

    def causes(self) -> Iterator[Cause[MujocoSettings]]:
        """Yield the properties of the file's settings that can cause an error.

        The contribution of a cause is the difference of two runs: with the settings `without` the cause, and
        with the settings `against` (those of the file by default).
        """
        of_file = self.settings
        fine = replace(of_file, timestep=of_file.timestep / FINE_STEP_DIVISOR)
        if self._model.neq:
            *_, stiffest = self.softness(fine)
            yield Cause("soft constraints", without=stiffest, against=fine)
        yield Cause(TIME_STEP, without=fine)
        for name in INTEGRATORS:
            if name != of_file.integrator:
                # a time step with equal cost per second of motion
                cost = evaluations_per_step(name) / evaluations_per_step(of_file.integrator)
                other = replace(of_file, integrator=name, timestep=of_file.timestep * cost)
                yield Cause(INTEGRATOR, without=other, is_choice=True)
        yield Cause("solver iterations", without=replace(of_file, **CONVERGED_SOLVER))

    def softness(self, settings: MujocoSettings) -> tuple[MujocoSettings, ...]:
        """Return variants of settings, from soft to stiff equalities.

        They are the given settings, the same with the stiffest `solref` that MuJoCo allows for the time step
        (a time constant of two steps), and in addition with `RIGID_SOLIMP`. Without equalities, only the
        given settings are returned.
        """
        if not self._model.neq:
            return (settings,)
        stiff = replace(settings, solref=(2.0 * settings.timestep, 1.0))
        return settings, stiff, replace(stiff, solimp=RIGID_SOLIMP)

    def alternatives(self, divisor: int) -> Iterator[MujocoSettings]:
        """Yield other settings that may reduce the error, with the file's time step divided by `divisor`.

        They combine all integrators, all variants of `softness`, and the default solver if the file's solver
        is weaker.
        """
        of_file = self.settings
        step = of_file.timestep / divisor
        solvers: list[dict[str, Any]] = [{}]  # the file's solver
        is_weak = of_file.iterations < DEFAULT_SOLVER["iterations"]
        is_weak = is_weak or of_file.tolerance > DEFAULT_SOLVER["tolerance"]
        if self._model.neq and (is_weak or of_file.solver != DEFAULT_SOLVER["solver"]):
            solvers.append(DEFAULT_SOLVER)
        for solver in solvers:
            for integrator in dict.fromkeys([of_file.integrator, *INTEGRATORS]):
                yield from self.softness(replace(of_file, timestep=step, integrator=integrator, **solver))

    def at_divisor(self, settings: MujocoSettings, divisor: float) -> MujocoSettings:
        """Return the same settings with the file's time step divided by `divisor`.

        A `solref` in the settings becomes the stiffest one for the new step.
        """
        step = self.settings.timestep / divisor
        solref = None if settings.solref is None else (2.0 * step, 1.0)
        return replace(settings, timestep=step, solref=solref)

    def run(self, settings: MujocoSettings, steps: int, every: int, reduced: bool = False) -> FileRun:
        """Simulate the file.

        Args:
            settings: settings of the run.
            steps: number of time steps.
            every: number of steps from one output to the next.
            reduced: True to switch off all elements that the imported scene does not have.
        """
        # the model, and its state and controls at the start
        model, active = self._prepared(reduced)
        settings.apply(model)
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = self._start, self._velocity
        data.act[:], data.eq_active[:] = self._inputs.activation, active
        data.ctrl[:] = self._inputs.control
        recorder = _Recorder(model, data, self._groups)
        events = None if reduced else _EventRecorder(model, data)
        # steps of one call of `mj_step`: one, if Python has to change controls or examine each step
        steps_per_call = every if events is None and self._inputs.are_constant else 1
        thread_time = 0.0
        with collected_warnings(data) as warnings:
            recorder.record()
            for _ in range(steps // every):
                # times of the steps, summed as MuJoCo sums them. Controls are held during a step: those of
                # its middle, as an earlier time would delay the input
                periods = np.full(every // steps_per_call, settings.timestep)
                periods[0] = data.time
                controls = self._inputs.at(np.cumsum(periods) + 0.5 * settings.timestep)
                start = time.thread_time()
                for control in controls:
                    data.ctrl[:] = control
                    mujoco.mj_step(model, data, steps_per_call)
                    if events is not None:
                        paused = time.thread_time()
                        events.record()
                        start += time.thread_time() - paused
                thread_time += time.thread_time() - start
                # MuJoCo checks only the state before each step
                mujoco.mj_checkPos(model, data)
                mujoco.mj_checkVel(model, data)
                if warnings:  # MuJoCo resets a diverged run
                    break
                recorder.record()
        stopped = next((f"{text} at {now:.4g} s" for text, now in warnings.items()), "")
        return FileRun(
            trajectory=recorder.trajectory(self.engine, self.scene, self._names, vars(settings), thread_time),
            loop_errors=recorder.loop_errors(),
            events=tuple(events.events) if events else (),
            stopped=stopped,
            states=tuple(recorder.states),
        )

    def _prepared(self, reduced: bool) -> tuple[Any, Array]:
        """Return a model and the equalities (neq,) that act, of a reduced run or of the file's run.

        The model has the softness of the file. It is the same object at each call, as copies of models with
        meshes take more time than runs.
        """
        if reduced not in self._prepared_models:
            self._prepared_models[reduced] = self._model_of_run(reduced)
        model, active = self._prepared_models[reduced]
        model.eq_solref[:], model.eq_solimp[:] = self._model.eq_solref, self._model.eq_solimp
        return model, active

    def _model_of_run(self, reduced: bool) -> tuple[Any, Array]:
        """Return a new copy of the model with the settings of the file, see `_prepared`."""
        model = copy.copy(self._model)
        active = model.eq_active0.copy()
        if reduced:
            for name in UNSIMULATED_FEATURES:
                model.opt.disableflags |= int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}"))
            # switches off all left-out elements but equalities, and returns the numbers of these equalities
            active[switch_off_left_out(model, self._report)] = 0
        return model, active

    def small_motions(self, run: FileRun, outputs: Sequence[int]) -> MujocoSmallMotions:
        """Return the analysis of small motions about states of a run, to find modes that grow.

        Args:
            run: reduced run of the file.
            outputs: numbers of the outputs of the run; if empty, the start of the file.
        """
        states = [(run.trajectory.time[k], *run.states[k]) for k in outputs]
        if not states:
            states = [(0.0, self._start, self._velocity, self._inputs.activation)]
        times = np.array([now for now, _, _, _ in states])
        with_controls = [(q, v, activation, self._inputs.at(now)) for now, q, v, activation in states]
        model, active = self._prepared(reduced=True)
        return MujocoSmallMotions(self.settings, model, active, times, with_controls)

    def changed(self, change: Callable[[Any], None]) -> MujocoFile:
        """Return the simulation of a changed model.

        Args:
            change: function that changes its argument, a compiled model.
        """
        other = copy.copy(self)
        other._model, other._prepared_models = copy.copy(self._model), {}
        change(other._model)
        return other


def _is_angle(model: Any, equality: int) -> bool:
    """Return whether an equality constrains an angle: of a hinge, or of a tendon over hinges."""
    hinges = mujoco.mjtJoint.mjJNT_HINGE
    first = int(model.eq_obj1id[equality])
    match mujoco.mjtEq(model.eq_type[equality]):
        case mujoco.mjtEq.mjEQ_JOINT:
            return bool(model.jnt_type[first] == hinges)
        case mujoco.mjtEq.mjEQ_TENDON:
            start, count = int(model.tendon_adr[first]), int(model.tendon_num[first])
            wraps = slice(start, start + count)
            joints = model.wrap_objid[wraps][model.wrap_type[wraps] == mujoco.mjtWrap.mjWRAP_JOINT]
            return bool(len(joints) == count and np.all(model.jnt_type[joints] == hinges))
        case _:
            return False


class _Recorder:
    """Poses of rigid groups, energies and loop errors at the outputs of a run.

    Attributes:
        times: s.
        positions: for each output, centers of mass (g, 3) of the g rigid groups, m, world frame.
        quaternions: for each output, orientations (g, 4) of the root bodies of the groups.
        energies: for each output, potential and kinetic energy, J.
        openings: for each output, violations (neq,) of the equalities, m; 0 for those of angles.
        angles: for each output, violations (neq,) of the equalities, rad; 0 for those of lengths.
        states: for each output, configuration (nq,), velocities (nv,) and activations (na,).
    """

    def __init__(self, model: Any, data: Any, groups: list[tuple[int, Array]]) -> None:
        """Take a model and the data of the run; `groups` are root body and members of each rigid group."""
        self._model, self._data = model, data
        self._roots = np.array([root for root, _ in groups], dtype=int)
        # mass of each body of the model as a fraction of the mass of each group (g, nbody)
        self._mass_fractions = np.zeros((len(groups), model.nbody))
        for fractions, (_, members) in zip(self._mass_fractions, groups, strict=True):
            fractions[members] = model.body_mass[members] / max(model.body_mass[members].sum(), 1e-300)
        self._output_data = mujoco.MjData(model)  # so that outputs do not change the warm start of the run
        self.times: list[float] = []
        self.positions: list[Array] = []
        self.quaternions: list[Array] = []
        self.energies: list[Array] = []
        self.openings: list[Array] = []
        self.angles: list[Array] = []
        self.states: list[tuple[Array, Array, Array]] = []
        self._is_weld = model.eq_type == mujoco.mjtEq.mjEQ_WELD
        self._is_angle = np.array([_is_angle(model, k) for k in range(model.neq)], dtype=bool)

    def record(self) -> None:
        """Add the present state as an output."""
        model, output = self._model, self._output_data
        output.qpos[:], output.qvel[:] = self._data.qpos, self._data.qvel
        output.eq_active[:] = self._data.eq_active
        self.states.append((self._data.qpos.copy(), self._data.qvel.copy(), self._data.act.copy()))
        mujoco.mj_fwdPosition(model, output)
        mujoco.mj_fwdVelocity(model, output)
        mujoco.mj_energyPos(model, output)
        mujoco.mj_energyVel(model, output)
        self.times.append(self._data.time)
        self.positions.append(self._mass_fractions @ output.xipos)
        self.quaternions.append(output.xquat[self._roots])
        self.energies.append(np.array(output.energy))
        self._record_loops()

    def _record_loops(self) -> None:
        """Add the violations of all equalities: the rows of each one follow each other."""
        model, output = self._model, self._output_data
        rows = np.flatnonzero(output.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY)
        equality, residual = output.efc_id[rows], output.efc_pos[rows]
        # of a weld, the last three rows are half of a small rotation, times the torque scale
        number_in_equality = np.arange(len(rows)) - np.searchsorted(equality, equality)
        turns = self._is_weld[equality] & (number_in_equality >= 3)
        residual = np.where(turns, 2.0 * residual / np.maximum(model.eq_data[equality, 10], 1e-300), residual)
        is_angle = turns | self._is_angle[equality]
        for kept, into in ((~is_angle, self.openings), (is_angle, self.angles)):
            squares = np.bincount(equality, weights=kept * residual**2, minlength=model.neq)
            into.append(np.sqrt(squares))

    def loop_errors(self) -> LoopErrors:
        """Return the violations of all equalities at the recorded times."""
        names = tuple(element_name(self._model, "equality", k) for k in range(self._model.neq))
        return LoopErrors(names, np.array(self.openings), np.array(self.angles))

    def trajectory(
        self,
        engine: str,
        scene: Scene,
        names: tuple[str, ...],
        settings: Mapping[str, Any],
        thread_time: float,
    ) -> Trajectory:
        """Return the motion of the scene's bodies.

        Args:
            engine: name and version of the engine.
            scene: imported scene.
            names: name of the scene's body for each rigid group; other bodies rest.
            settings: settings of the run, by name.
            thread_time: processor time of the steps, s.
        """
        bodies = scene.mechanism.body_names
        count = len(self.times)
        position, quaternion = np.zeros((count, len(bodies), 3)), np.zeros((count, len(bodies), 4))
        position[:], quaternion[:] = initial_state(scene).position, initial_state(scene).quaternion
        for group, name in enumerate(names):
            body = bodies.index(name)
            position[:, body] = np.array(self.positions)[:, group]
            quaternion[:, body] = np.array(self.quaternions)[:, group]
        potential, kinetic = np.array(self.energies).T
        return Trajectory(
            engine=engine,
            settings=dict(settings),
            wall_time=thread_time,  # here processor time of the steps alone
            time=np.array(self.times),
            body_names=bodies,
            joint_names=scene.mechanism.joint_names,
            position=position,
            # signs of quaternions such that they do not jump from output to output
            quaternion=continuous(quaternion, quaternion[0]),
            kinetic_energy=kinetic,
            potential_energy=potential,
            mechanism=scene.mechanism,
        )


class _EventRecorder:
    """First contact of each pair of bodies, and first action of each limit and dry friction, in a run.

    Attributes:
        events: events so far, in the order of time.
    """

    def __init__(self, model: Any, data: Any) -> None:
        """Take a model and the data of the run."""
        self._model, self._data = model, data
        # (type of constraint row, number of the element), or numbers of the bodies of a contact
        self._known_limits: set[tuple[int, int]] = set()
        self._known_contacts: set[tuple[int, ...]] = set()
        self.events: list[Event] = []

    def record(self) -> None:
        """Add an event for each element that acts in the last step for the first time."""
        model, data = self._model, self._data
        # the first `ne` of the `nefc` constraint rows are those of equalities
        if data.nefc == data.ne:
            return
        row_types, numbers = data.efc_type[data.ne :], data.efc_id[data.ne :]
        for row_type, number in {*zip(row_types.tolist(), numbers.tolist(), strict=True)}:
            topic_and_kind = EVENT_KINDS.get(mujoco.mjtConstraint(row_type))
            if topic_and_kind is None:  # a contact; the numbers of contacts change from step to step
                contact = data.contact[number]
                bodies = tuple(sorted(int(model.geom_bodyid[geom]) for geom in contact.geom if geom >= 0))
                if bodies not in self._known_contacts:
                    self._known_contacts.add(bodies)
                    names = " and ".join(repr(model.body(body).name or f"body {body}") for body in bodies)
                    self._add_event(f"{CONTACT_OF}{names}")
            elif (row_type, number) not in self._known_limits:
                self._known_limits.add((row_type, number))
                topic, kind = topic_and_kind
                # MuJoCo numbers the friction of joints by degree of freedom
                is_of_dof = topic == "dry friction" and kind == "joint"
                owner = int(model.dof_jntid[number]) if is_of_dof else number
                self._add_event(f"{topic} of {element_name(model, kind, owner)}")

    def _add_event(self, element: str) -> None:
        """Add an event of an element at the beginning of the last step."""
        self.events.append(Event(float(self._data.time - self._model.opt.timestep), element))
