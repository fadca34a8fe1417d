"""Simulate an MJCF file in MuJoCo as it stands: its time step, integrator, solver and soft constraints.

Start and inputs are those of the imported scene. Contacts, limits, friction and everything else of the file
act, and the run notes when each of them does so first. A reduced run leaves out what the scene does not have.
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
    INTEGRATOR,
    TIME_STEP,
    Cause,
    Event,
    FileRun,
    FileSimulation,
    evaluations_per_step,
)
from newton_euler.reading.import_report import ImportReport
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array

DEFAULT_SOLIMP = (0.9, 0.95, 0.001)
"""MuJoCo's default for the first three numbers of `solimp`."""

RIGID_SOLIMP = (0.9999, 0.9999, 0.001)
"""Largest impedances that MuJoCo accepts, and its default width, m."""

CONVERGED_ITERATIONS, CONVERGED_TOLERANCE = 1000, 1e-14
"""Settings of a constraint solver that runs until round-off ends its progress."""

DEFAULT_SOLVER: dict[str, Any] = {"solver": "Newton", "iterations": 100, "tolerance": 1e-8}
"""MuJoCo's default settings of the constraint solver; Newton's method converges in a few iterations."""

FINE_STEP_DIVISOR = 10
"""Factor on the step of a run that shows the error of the step: order 1 leaves a tenth of it."""

MAX_LISTED = 5
"""Largest number of equalities that a text names."""

INTEGRATORS = ("Euler", "implicit", "implicitfast", "RK4")
"""MuJoCo's integrators by their name in MJCF."""

EVENT_KINDS = {
    mujoco.mjtConstraint.mjCNSTR_LIMIT_JOINT: ("limits", "joint"),
    mujoco.mjtConstraint.mjCNSTR_LIMIT_TENDON: ("limits", "tendon"),
    mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF: ("dry friction", "joint"),
    mujoco.mjtConstraint.mjCNSTR_FRICTION_TENDON: ("dry friction", "tendon"),
}
"""Topic and kind of element of constraint rows that the reference does not have."""


@dataclass(frozen=True)
class MujocoSettings:
    """Settings of a run in MuJoCo.

    Attributes:
        timestep: s.
        integrator: "Euler", "RK4", "implicit" or "implicitfast".
        solver: "Newton", "CG" or "PGS".
        iterations: largest number of iterations of the solver.
        tolerance: relative improvement at which the solver stops.
        solref: softness of all equalities; None keeps the softness of each one in the file.
        solimp: first three numbers of the impedance of all equalities; None keeps those in the file.
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
        """Read the settings of a compiled model."""
        integrator = mujoco.mjtIntegrator(model.opt.integrator).name.removeprefix("mjINT_")
        solver = mujoco.mjtSolver(model.opt.solver).name.removeprefix("mjSOL_")
        return cls(
            float(model.opt.timestep),
            integrator if integrator == "RK4" else integrator.lower().replace("euler", "Euler"),
            solver if solver != "NEWTON" else "Newton",
            int(model.opt.iterations),
            float(model.opt.tolerance),
        )

    def apply(self, model: Any) -> None:
        """Give a compiled model these settings."""
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

        An activation a(t) = a_0 + A sin(w t) needs the control da/dt of an integrator, and a + tau da/dt of a
        filter (MuJoCo's documentation, Modeling, Actuator, attribute dyntype).

        Args:
            model: compiled model.
            control: (nu,) controls at the start.
            activation: (na,) activations at the start.
            sines: sine of the control, or of the activation of an actuator with dynamics, by actuator.
        """
        self.control, self.activation = control, activation
        self._places = np.array([model.actuator_ctrladr[k] for k in sines], dtype=int)
        self._frequency = np.array([sine.angular_frequency for sine in sines.values()])
        by_sine, by_cosine = [], []
        for actuator, sine in sines.items():
            rate = sine.amplitude * sine.angular_frequency
            match mujoco.mjtDyn(model.actuator_dyntype[actuator]):
                case mujoco.mjtDyn.mjDYN_NONE:
                    weights = sine.amplitude, 0.0
                case mujoco.mjtDyn.mjDYN_INTEGRATOR:
                    weights = 0.0, rate
                case mujoco.mjtDyn.mjDYN_FILTER | mujoco.mjtDyn.mjDYN_FILTEREXACT:
                    weights = sine.amplitude, rate * float(model.actuator_dynprm[actuator, 0])
                case kind:
                    raise NotImplementedError(f"sine of an actuator with dynamics {kind.name}")
            by_sine.append(weights[0])
            by_cosine.append(weights[1])
        self._by_sine, self._by_cosine = np.array(by_sine), np.array(by_cosine)

    @property
    def are_constant(self) -> bool:
        """True without sines."""
        return not len(self._places)

    def at(self, now: float) -> Array:
        """Return the controls (nu,) at a time, s."""
        control, phase = self.control.copy(), self._frequency * now
        control[self._places] += self._by_sine * np.sin(phase) + self._by_cosine * np.cos(phase)
        return control

    @property
    def terms(self) -> dict[str, list[float]]:
        """Terms of the controls, (nu,) each: constant + sine sin(w t) + cosine cos(w t), w in rad/s."""
        frequency, sine, cosine = np.zeros((3, len(self.control)))
        frequency[self._places] = self._frequency
        sine[self._places], cosine[self._places] = self._by_sine, self._by_cosine
        terms = {"constant": self.control, "sine": sine, "cosine": cosine, "angular_frequency": frequency}
        return {name: values.tolist() for name, values in terms.items()}


def _numbers(values: tuple[float, ...] | None) -> str:
    """Write numbers as in MJCF; "" for None."""
    return "" if values is None else " ".join(f"{x:.10g}" for x in values)


def _attributes(values: Mapping[str, str]) -> str:
    """Write attributes as in XML."""
    return " ".join(f'{name}="{value}"' for name, value in values.items())


def _differing_numbers(model: Any, changed: Any) -> dict[str, Any]:
    """Return the numbers of a changed compiled model that differ from another one, by name in Python."""
    found: dict[str, Any] = {}
    for prefix, one, other in (("opt.", model.opt, changed.opt), ("", model, changed)):
        for name in dir(one):
            value = getattr(other, name)
            is_number = isinstance(value, int | float | np.ndarray) and not name.startswith("_")
            if is_number and not np.array_equal(getattr(one, name), value, equal_nan=True):
                found[prefix + name] = np.asarray(value).tolist()
    return found


class MujocoFile(FileSimulation[MujocoSettings]):
    """MJCF file with its own settings, at the start of an imported scene.

    Attributes:
        own_softness: equalities of the file that do not have the softness of `<default>`, such as
            "connect 'loop'".
    """

    own_softness: Sequence[str] = ()

    engine = f"MuJoCo {mujoco.__version__}"

    def __init__(
        self, model: Any, reference: MjcfReference, scene: Scene, report: ImportReport, inputs: Inputs
    ) -> None:
        """Take a compiled model, which is not changed.

        Args:
            model: compiled model of the file.
            reference: reference model of the scene; its start is the configuration of the run.
            scene: imported scene.
            report: import report, which lists what the scene does not have.
            inputs: controls of the scene.
        """
        self._model, self.scene, self._report, self._inputs = model, scene, report, inputs
        self.settings = MujocoSettings.of(model)
        self._start = reference.start
        self._names = reference.names
        self._groups = reference.groups
        # joint velocities from the velocities of the bodies
        state = initial_state(scene)
        places = [scene.mechanism.body_names.index(name) for name in self._names]
        motion = np.hstack([state.linear_velocity[places], state.angular_velocity[places]])
        rows = reference.kinematics(self._start, np.zeros(model.nv)).transformation
        self._velocity = least_squares(rows.reshape(-1, model.nv), motion.ravel())

    def words(self) -> str:
        settings = self.settings
        words = [settings.integrator, f"{1e3 * settings.timestep:g} ms"]
        if settings.solver != "Newton":
            words.append(f"solver {settings.solver}")
        if self._model.neq:
            constants = np.unique(self._model.eq_solref[:, 0])
            words.append(f"solref {' and '.join(f'{value:g}' for value in constants)}")
            softness = np.unique(self._model.eq_solimp[:, :3], axis=0)
            if np.any(softness != DEFAULT_SOLIMP):
                words.append(f"solimp {' and '.join(' '.join(f'{x:g}' for x in row) for row in softness)}")
        return ", ".join(words)

    def changes(self, settings: MujocoSettings) -> dict[str, str]:
        """Map the attributes of MJCF that differ from the file to their values."""
        given = {
            "timestep": f"{settings.timestep:.10g}",
            "integrator": settings.integrator,
            "solver": settings.solver,
            "iterations": f"{settings.iterations}",
            "tolerance": f"{settings.tolerance:g}",
            "solref": _numbers(settings.solref),
            "solimp": _numbers(settings.solimp),
        }
        own = vars(self.settings)
        return {name: value for name, value in given.items() if value and vars(settings)[name] != own[name]}

    def fragment(self, settings: MujocoSettings) -> str:
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
        """Return qpos, qvel, act, eq_active and controls; and arrays of the model that the run changes.

        See `FileSimulation.run_inputs`. Arrays are named as in Python, such as "opt.disableflags".
        """
        model, active = self._prepared(reduced)
        return {
            "qpos": self._start.tolist(),
            "qvel": self._velocity.tolist(),
            "act": self._inputs.activation.tolist(),
            "eq_active": active.tolist(),
            "ctrl": self._inputs.terms,
            "model": _differing_numbers(self._model, model),
        }

    def causes(self) -> Iterator[Cause[MujocoSettings]]:
        own = self.settings
        fine = replace(own, timestep=own.timestep / FINE_STEP_DIVISOR)
        if self._model.neq:
            stiff = self.softness(fine)[-1]
            yield Cause("soft constraints", without=stiff, against=fine)
        yield Cause(TIME_STEP, without=fine)
        for name in INTEGRATORS:
            if name != own.integrator:
                cost = evaluations_per_step(name) / evaluations_per_step(own.integrator)
                yield Cause(INTEGRATOR, replace(own, integrator=name, timestep=own.timestep * cost))
        converged = replace(
            own, iterations=CONVERGED_ITERATIONS, tolerance=CONVERGED_TOLERANCE, solver="Newton"
        )
        yield Cause("solver iterations", without=converged)

    def softness(self, settings: MujocoSettings) -> tuple[MujocoSettings, ...]:
        """Return settings with the file's softness, with the stiffest solref, and with the largest solimp."""
        if not self._model.neq:
            return (settings,)
        stiff = replace(settings, solref=(2.0 * settings.timestep, 1.0))
        return settings, stiff, replace(stiff, solimp=RIGID_SOLIMP)

    def alternatives(self, divisor: int) -> Iterator[MujocoSettings]:
        own = self.settings
        step = own.timestep / divisor
        solvers: list[dict[str, Any]] = [{}]
        is_weak = own.iterations < DEFAULT_SOLVER["iterations"] or own.tolerance > DEFAULT_SOLVER["tolerance"]
        if self._model.neq and (is_weak or own.solver != DEFAULT_SOLVER["solver"]):
            solvers.append(DEFAULT_SOLVER)
        for solver in solvers:
            for integrator in dict.fromkeys([own.integrator, *INTEGRATORS]):
                yield from self.softness(replace(own, timestep=step, integrator=integrator, **solver))

    def at_divisor(self, settings: MujocoSettings, divisor: float) -> MujocoSettings:
        step = self.settings.timestep / divisor
        solref = None if settings.solref is None else (2.0 * step, 1.0)
        return replace(settings, timestep=step, solref=solref)

    def run(self, settings: MujocoSettings, steps: int, every: int, reduced: bool = False) -> FileRun:
        model, active = self._prepared(reduced)
        settings.apply(model)
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = self._start, self._velocity
        data.act[:], data.eq_active[:] = self._inputs.activation, active
        data.ctrl[:] = self._inputs.control
        recorder = _Recorder(model, data, self._groups)
        watch = None if reduced else _Watch(model, data)
        at_once = every if watch is None and self._inputs.are_constant else 1
        wall_time = 0.0
        with collected_warnings(data) as warnings:
            recorder.record()
            for _ in range(steps // every):
                for _ in range(every // at_once):
                    if not self._inputs.are_constant:
                        data.ctrl[:] = self._inputs.at(data.time)
                    start = time.thread_time()
                    mujoco.mj_step(model, data, at_once)
                    wall_time += time.thread_time() - start
                    if watch is not None:
                        watch.look()
                mujoco.mj_checkPos(model, data)
                mujoco.mj_checkVel(model, data)
                if warnings:  # MuJoCo resets a diverged run
                    break
                recorder.record()
        stopped = next((f"{text} at {now:.4g} s" for text, now in warnings.items()), "")
        return FileRun(
            recorder.trajectory(self.engine, self.scene, self._names, vars(settings), wall_time),
            np.array(recorder.opening),
            tuple(watch.events) if watch else (),
            stopped,
            tuple(recorder.states),
        )

    def _prepared(self, reduced: bool) -> tuple[Any, Array]:
        """Return a copy of the model and the equalities (neq,) that act, of a reduced run or the file's."""
        model = copy.copy(self._model)
        active = model.eq_active0.copy()
        if reduced:
            for name in UNSIMULATED_FEATURES:
                model.opt.disableflags |= int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}"))
            active[switch_off_left_out(model, self._report)] = 0
        return model, active

    def small_motions(self, run: FileRun, outputs: Sequence[int]) -> MujocoSmallMotions:
        states = [(run.trajectory.time[k], *run.states[k]) for k in outputs]
        if not states:
            states = [(0.0, self._start, self._velocity, self._inputs.activation)]
        with_controls = [(q, v, activation, self._inputs.at(now)) for now, q, v, activation in states]
        model, active = self._prepared(reduced=True)
        return MujocoSmallMotions(
            self.settings, model, active, np.array([state[0] for state in states]), with_controls
        )

    def changed(self, change: Callable[[Any], None]) -> MujocoFile:
        """Return the simulation of a changed model.

        Args:
            change: function that changes a compiled model.
        """
        other = copy.copy(self)
        other._model = copy.copy(self._model)
        change(other._model)
        return other


class _Recorder:
    """Poses of rigid groups, energies and loop errors of a run."""

    def __init__(self, model: Any, data: Any, groups: list[tuple[int, Array]]) -> None:
        """Take a model and its data; `groups` are root body and members of each rigid group."""
        self._model, self._data, self._groups = model, data, groups
        self._seen = mujoco.MjData(model)  # so that outputs do not change the warm start of the run
        self.times: list[float] = []
        self.positions: list[Array] = []
        self.turns: list[Array] = []
        self.energies: list[Array] = []
        self.opening: list[float] = []
        self.states: list[tuple[Array, Array, Array]] = []  # configuration, velocities, activations
        self._scales = np.where(model.eq_type == mujoco.mjtEq.mjEQ_WELD, model.eq_data[:, 10], 1.0)

    def record(self) -> None:
        """Add the present state."""
        model, seen = self._model, self._seen
        seen.qpos[:], seen.qvel[:] = self._data.qpos, self._data.qvel
        seen.eq_active[:] = self._data.eq_active
        self.states.append((self._data.qpos.copy(), self._data.qvel.copy(), self._data.act.copy()))
        mujoco.mj_fwdPosition(model, seen)
        mujoco.mj_fwdVelocity(model, seen)
        mujoco.mj_energyPos(model, seen)
        mujoco.mj_energyVel(model, seen)
        self.times.append(self._data.time)
        mass = model.body_mass
        self.positions.append(
            np.array([mass[k] @ seen.xipos[k] / max(mass[k].sum(), 1e-300) for _, k in self._groups])
        )
        self.turns.append(np.array([seen.xquat[root] for root, _ in self._groups]))
        self.energies.append(np.array(seen.energy))
        loops = seen.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
        self.opening.append(float(np.max(np.abs(seen.efc_pos[loops]), initial=0.0)))

    def trajectory(
        self, engine: str, scene: Scene, names: tuple[str, ...], settings: Mapping[str, Any], wall_time: float
    ) -> Trajectory:
        """Return the motion of the scene's bodies."""
        bodies = scene.mechanism.body_names
        count = len(self.times)
        position, quaternion = np.zeros((count, len(bodies), 3)), np.zeros((count, len(bodies), 4))
        position[:], quaternion[:] = initial_state(scene).position, initial_state(scene).quaternion
        for k, name in enumerate(names):
            place = bodies.index(name)
            position[:, place] = np.array(self.positions)[:, k]
            quaternion[:, place] = np.array(self.turns)[:, k]
        potential, kinetic = np.array(self.energies).T
        return Trajectory(
            engine,
            dict(settings),
            wall_time,
            np.array(self.times),
            bodies,
            scene.mechanism.joint_names,
            position,
            continuous(quaternion, quaternion[0]),
            kinetic_energy=kinetic,
            potential_energy=potential,
            mechanism=scene.mechanism,
        )


class _Watch:
    """First contact, and first action of each limit and dry friction, in a run."""

    def __init__(self, model: Any, data: Any) -> None:
        self._model, self._data = model, data
        self._known: set[tuple[int, int]] = set()
        self.events: list[Event] = []

    def look(self) -> None:
        """Note what acts in the last step."""
        model, data = self._model, self._data
        if data.nefc == data.ne:
            return
        kinds, numbers = data.efc_type[data.ne :], data.efc_id[data.ne :]
        for kind, number in {*zip(kinds.tolist(), numbers.tolist(), strict=True)}:
            named = EVENT_KINDS.get(mujoco.mjtConstraint(kind))
            if named is None:  # a contact; the numbers of contacts change from step to step
                contact = data.contact[number]
                pair = sorted(int(model.geom_bodyid[geom]) for geom in contact.geom if geom >= 0)
                key = (-1, hash(tuple(pair)))
                if key not in self._known:
                    names = " and ".join(repr(model.body(body).name or "world") for body in pair)
                    self._note(key, f"contact of {names}")
                continue
            key = (kind, number)
            if key in self._known:
                continue
            topic, of = named
            owner = int(model.dof_jntid[number]) if topic == "dry friction" and of == "joint" else number
            self._note(key, f"{topic} of {element_name(model, of, owner)}")

    def _note(self, key: tuple[int, int], element: str) -> None:
        self._known.add(key)
        self.events.append(Event(float(self._data.time - self._model.opt.timestep), element))
