"""Simulate an MJCF file in MuJoCo with the file's own time step, integrator, solver and soft constraints.

A scene is the mechanism with forces and control laws that `mjcf.reader` imports from the file. crosscheck
compares a run of the file with an accurate reference solution of the scene, to measure the error of the
file's settings and the causes of the error. The run has the initial state and the controls of the scene. In a
complete run, all elements of the file act, and the run records when each contact, limit and dry friction
that the scene does not have acts first. In a reduced run, the elements that the scene does not have, such as
contacts, are switched off. Dry friction and limits that the scene approximates by forces act in both runs.
"""

from __future__ import annotations

import copy
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product
from typing import Any

import mujoco
import numpy as np

from mjcf.errors import collected_warnings
from mjcf.layout import element_name
from mjcf.modes import MujocoSmallMotions
from mjcf.reference import UNSIMULATED_FEATURES, MjcfReference
from mjcf.report_audit import switch_off_left_out
from mjcf.run_record import EventRecorder, Recorder
from mjcf.run_settings import INTEGRATORS, Inputs, MujocoSettings
from mjcf.soft import stiffest_solref
from newton_euler.equations.dense import least_squares
from newton_euler.model.scene import Scene
from newton_euler.reading.file_run import (
    Cause,
    CauseName,
    FileRun,
    FileSimulation,
    evaluations_per_step,
)
from newton_euler.reading.import_report import FRICTION, LIMITS, ImportReport
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

TOPICS = {"LIMIT": LIMITS, "FRICTIONLOSS": FRICTION}
"""Topic in the import report of a feature of MuJoCo."""

MAX_LISTED = 5
"""Largest number of equalities that a comment in an XML fragment names."""


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
                closed loops, and its mocap poses are the start of the run. It also maps MuJoCo's bodies to
                bodies of the scene.
            scene: imported scene.
            report: import report, which lists the elements that the scene does not have.
            inputs: controls of the scene.
        """
        self._model, self.scene, self._report, self._inputs = model, scene, report, inputs
        self.settings = MujocoSettings.of(model)
        self.approximated = [f"{topic} of {element}" for element, topic in sorted(report.approximated_topics)]
        self.stiffer_limits = self._stiffer_limits()
        self._start, self._mocap_poses = reference.start, reference.mocap_poses
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

    def _stiffer_limits(self) -> str:
        """Return attributes that make the limits of joints as stiff as the time step permits."""
        stiffest = stiffest_solref(self.settings.timestep)
        is_soft = self._model.jnt_solref[:, 0] > stiffest[0] * (1.0 + 1e-9)
        names = (element_name(self._model, "joint", k) for k in np.flatnonzero(is_soft).tolist())
        soft = [name for name in names if (name, LIMITS) in self._report.approximated_topics]
        others = f" and {len(soft) - 1} more" if soft[1:] else ""
        return f'solreflimit="{_numbers(stiffest)}" in {soft[0]}{others}' if soft else ""

    def words(self) -> str:
        """Describe the settings of the file in one short text, such as "implicitfast, 2 ms, solref 0.02"."""
        settings = self.settings
        words = [settings.integrator, f"{1e3 * settings.timestep:g} ms"]
        if settings.solver != "Newton":
            words.append(f"solver {settings.solver}")
        if settings.sleep:
            words.append("sleep")
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
            "sleep": "enable" if settings.sleep else "disable",
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
        flags = {"sleep": changes.pop("sleep")} if "sleep" in changes else {}
        lines = [f"<option {_attributes(changes)}/>"] if changes else []
        lines += [f"<option><flag {_attributes(flags)}/></option>"] if flags else []
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
            yield Cause(CauseName.SOFT_CONSTRAINTS, without=stiffest, against=fine)
        yield Cause(CauseName.TIME_STEP, without=fine)
        for name in INTEGRATORS:
            if name != of_file.integrator:
                # a time step with equal cost per second of motion
                cost = evaluations_per_step(name) / evaluations_per_step(of_file.integrator)
                other = replace(of_file, integrator=name, timestep=of_file.timestep * cost)
                yield Cause(CauseName.INTEGRATOR, without=other, is_choice=True)
        yield Cause(CauseName.SOLVER_ITERATIONS, without=replace(of_file, **CONVERGED_SOLVER))
        if of_file.sleep:
            yield Cause(CauseName.SLEEP, without=replace(of_file, sleep=False))

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

        They combine all integrators, all variants of `softness`, no sleep if the file has it, and the default
        solver if the file's solver is weaker.
        """
        of_file = self.settings
        step = of_file.timestep / divisor
        solvers: list[dict[str, Any]] = [{}]  # the file's solver
        is_weak = of_file.iterations < DEFAULT_SOLVER["iterations"]
        is_weak = is_weak or of_file.tolerance > DEFAULT_SOLVER["tolerance"]
        if self._model.neq and (is_weak or of_file.solver != DEFAULT_SOLVER["solver"]):
            solvers.append(DEFAULT_SOLVER)
        integrators = dict.fromkeys([of_file.integrator, *INTEGRATORS])
        sleeps = dict.fromkeys([of_file.sleep, False])
        for solver, integrator, sleep in product(solvers, integrators, sleeps):
            own = replace(of_file, timestep=step, integrator=integrator, sleep=sleep, **solver)
            yield from self.softness(own)

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
        recorder = Recorder(model, data, self._groups)
        events = None if reduced else EventRecorder(model, data, self._report.approximated_topics)
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
        """Return a new copy of the model with settings of the file and mocap poses of the start."""
        model = copy.copy(self._model)
        # new data of a model have the mocap bodies where the model has them
        mocap_bodies = np.flatnonzero(model.body_mocapid >= 0)
        mocap_numbers = model.body_mocapid[mocap_bodies]
        for poses, of_keyframe in zip((model.body_pos, model.body_quat), self._mocap_poses, strict=True):
            poses[mocap_bodies] = of_keyframe[mocap_numbers]
        active = model.eq_active0.copy()
        if reduced:
            simulated = {topic for _, topic in self._report.approximated_topics}
            for name in UNSIMULATED_FEATURES:
                if TOPICS.get(name) not in simulated:
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
        if self.approximated:  # small motions are those without dry friction and limits
            model = copy.copy(model)
            for name in UNSIMULATED_FEATURES:
                model.opt.disableflags |= int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}"))
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
