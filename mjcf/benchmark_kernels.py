"""Benchmark kernels of MuJoCo: single runs and batches of runs with as little Python overhead as possible.

crosscheck's benchmarks measure MuJoCo's speed with these kernels, on scenes (mechanisms with forces, control
laws and initial state). They store poses at output times only. Features that no scene uses are switched off.
The warm start of the solver is switched off as well: one Newton step solves equality constraints, which are
linear in the accelerations, and conjugate gradients (CG) with a warm start end before they are accurate.
Constraints are as stiff as the step allows, with a time constant of two steps. A `SoftMuJoCo` is a scene
compiled for MuJoCo, with soft constraints.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import repeat
from typing import Any

import mujoco
import mujoco.rollout
import numpy as np

from mjcf.constraint_solver import ConstraintSolver, SolverName
from mjcf.errors import DivergenceError, MjcfError, collected_warnings
from mjcf.forces import wind_loads
from mjcf.reading.start import PASSIVE_FEATURES
from mjcf.soft import SoftMuJoCo, stiffest_solref
from mjcf.write import controls
from newton_euler.model.scene import Scene
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array

UNUSED_FEATURES = (
    "CONTACT",
    "LIMIT",
    "FRICTIONLOSS",
    "SENSOR",
    "CLAMPCTRL",
    "MIDPHASE",
    "NATIVECCD",
    "ISLAND",
    "WARMSTART",
    "AUTORESET",
)
"""MuJoCo's features that no scene has, or that cost more time than they save."""

MAX_ROLLOUT_BYTES = 32_000_000
"""Largest size, bytes, of the states of one call of `mujoco.rollout`, which stores every step."""


def compiled(scene: Scene) -> SoftMuJoCo:
    """Compile a scene without the features of MuJoCo that the scene does not need.

    Raises:
        MjcfError: for a prescribed motion, wind, dry friction, a stop, or a control law other than PD, which
            need a callback.
    """
    # the first element that MuJoCo cannot simulate without Python
    for motion in scene.motions:
        raise MjcfError(
            f"motion of joint {motion.joint!r}: MuJoCo has no time-dependent equality, "
            "and benchmark kernels call no Python"
        )
    system = SoftMuJoCo(scene)
    # `evaluated`: control laws that no actuator of MuJoCo is equivalent to
    for law_or_load in (*system.evaluated.values(), *wind_loads(scene), *scene.switched_forces):
        raise MjcfError(
            f"{law_or_load.element}: MuJoCo has no such actuator, and benchmark kernels call no Python"
        )
    # features
    disabled = [*UNUSED_FEATURES]
    if not scene.forces:
        disabled += PASSIVE_FEATURES  # scenes without springs and dampers do not need them
    if not np.any(scene.gravity):
        disabled.append("GRAVITY")
    flags = (int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}")) for name in disabled)
    system.model.opt.disableflags = sum(flags)
    return system


def forward(scene: Scene) -> Any:
    """Return a function without arguments that evaluates `mj_forward` at the initial state."""
    system = compiled(scene)
    system.set_state(*system.coordinates(initial_state(scene)))
    model, data, call = system.model, system.data, mujoco.mj_forward
    return lambda: call(model, data)


def steps(scene: Scene) -> Any:
    """Return a function of a number n, which takes n Euler steps from the initial state by `mj_step`."""
    system = compiled(scene)
    system.set_state(*system.coordinates(initial_state(scene)))
    model, data = system.model, system.data
    system.use_integrator("Euler")
    qpos, qvel = data.qpos.copy(), data.qvel.copy()

    def call(count: int) -> None:
        """Take `count` steps from the initial state."""
        data.qpos[:], data.qvel[:] = qpos, qvel
        mujoco.mj_step(model, data, count)

    return call


class Stepper:
    """Single run with a fixed number of steps per output interval.

    Call `reset`, then `run`, whose time is measured, then `poses`.

    Attributes:
        position: (n, nbody, 3) m, positions of MuJoCo's bodies at outputs, filled by `run`.
        quaternion: (n, nbody, 4) orientations of MuJoCo's bodies at outputs, filled by `run`.
    """

    def __init__(
        self,
        system: SoftMuJoCo,
        integrator: str,
        intervals: list[tuple[int, float]],
        number: int,
        damping_ratio: float,
        solver: SolverName = "Newton",
    ) -> None:
        """Prepare a run.

        Args:
            system: compiled scene.
            integrator: name of MuJoCo's integrator.
            intervals: groups of equal output intervals in order of time: number of intervals, length in s.
            number: number of steps per output interval.
            damping_ratio: damping ratio of the constraints, the second number of `solref`.
            solver: name of MuJoCo's constraint solver.
        """
        self._solver = ConstraintSolver(solver)
        self._system, self._intervals, self._number, self._ratio = system, intervals, number, damping_ratio
        self._integrator = integrator
        outputs = 1 + sum(count for count, _ in intervals)
        self.position = np.empty((outputs, system.model.nbody, 3))
        self.quaternion = np.empty((outputs, system.model.nbody, 4))
        self._advance = _advance_by_whole_steps if integrator == "RK4" else _advance_by_split_steps

    def reset(self) -> None:
        """Reset MuJoCo to the initial state."""
        system = self._system
        mujoco.mj_resetData(system.model, system.data)
        system.set_state(*system.coordinates(initial_state(system.scene)))
        system.use_integrator(self._integrator)
        self._solver.apply(system.model)

    def run(self) -> None:
        """Run the scene and fill `position` and `quaternion`."""
        model, data = self._system.model, self._system.data
        rows = zip(self.position, self.quaternion, strict=True)
        # `following` updates the controls of PD laws that depend on time, in each evaluation
        with collected_warnings(), self._system.following():
            for count, interval in self._intervals:
                step = interval / self._number
                self._system.use_step(step, stiffest_solref(step, self._ratio))
                self._advance(model, data, rows, count, self._number)
            mujoco.mj_kinematics(model, data)
        self.position[-1], self.quaternion[-1] = data.xpos, data.xquat

    def poses(self) -> tuple[Array, Array]:
        """Return positions (n, b, 3), m, and quaternions (n, b, 4) of the scene's bodies, ground first.

        Raises:
            DivergenceError: for a motion that is not finite.
        """
        return _scene_poses(self._system, self.position, self.quaternion)


def _advance_by_split_steps(model: Any, data: Any, rows: Iterator[Any], count: int, number: int) -> None:
    """Store the poses at the beginning of each interval, and take the steps of the interval.

    `mj_step1`, the first half of a step, computes the poses at the beginning of the step.

    Args:
        model: `MjModel`.
        data: `MjData`.
        rows: next rows of positions and quaternions to fill.
        count: number of intervals.
        number: number of steps in each interval.
    """
    first_half, second_half, whole_steps = mujoco.mj_step1, mujoco.mj_step2, mujoco.mj_step
    remaining = number - 1
    xpos, xquat = data.xpos, data.xquat
    for _ in repeat(None, count):
        position, quaternion = next(rows)
        first_half(model, data)
        position[...], quaternion[...] = xpos, xquat
        second_half(model, data)
        if remaining:
            whole_steps(model, data, remaining)


def _advance_by_whole_steps(model: Any, data: Any, rows: Iterator[Any], count: int, number: int) -> None:
    """Store poses and take steps like `_advance_by_split_steps`, for RK4, whose steps cannot be split."""
    step, kinematics = mujoco.mj_step, mujoco.mj_kinematics
    xpos, xquat = data.xpos, data.xquat
    for _ in repeat(None, count):
        position, quaternion = next(rows)
        kinematics(model, data)
        position[...], quaternion[...] = xpos, xquat
        step(model, data, number)


def physics_states(system: SoftMuJoCo, q: Array, v: Array) -> Array:
    """Return MuJoCo's full physics states (n, size) for tree coordinates (n, nq) and velocities (n, nv)."""
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    states = np.empty((len(q), mujoco.mj_stateSize(system.model, kind)))
    for state, q_of_run, v_of_run in zip(states, q, v, strict=True):
        system.set_state(q_of_run, v_of_run)
        mujoco.mj_getState(system.model, system.data, state, kind)
    return states


class Rollout:
    """Batch of runs by `mujoco.rollout`, with a fixed number of steps per output interval.

    `mujoco.rollout` stores time, qpos and qvel of every step; this class keeps qpos at output times.
    """

    def __init__(
        self, system: SoftMuJoCo, integrator: str, number: int, damping_ratio: float, threads: int
    ) -> None:
        """Prepare runs of a scene with equal output intervals.

        Args:
            system: compiled scene.
            integrator: name of MuJoCo's integrator.
            number: number of steps per output interval.
            damping_ratio: damping ratio of the constraints, the second number of `solref`.
            threads: number of threads.
        """
        self._system, self._number = system, number
        model, times = system.model, system.scene.times
        system.use_integrator(integrator)
        step = float(times[1] - times[0]) / number
        system.use_step(step, stiffest_solref(step, damping_ratio))
        self._data_of_threads = [mujoco.MjData(model) for _ in range(threads)]
        self._pool = mujoco.rollout.Rollout(nthread=threads if threads > 1 else 0)
        # runs of one call: as many as fit into `MAX_ROLLOUT_BYTES`, but at least ten for each thread
        steps = number * (len(times) - 1)
        size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        runs = max(10 * threads, MAX_ROLLOUT_BYTES // (8 * steps * size))
        self._states = np.empty((runs, steps, size))
        self._controls = np.tile(_controls_of_steps(system.scene, steps, model.opt.timestep), (runs, 1, 1))

    def __call__(self, starts: Array) -> Array:
        """Return qpos (runs, n, nq) at all outputs, for runs from full physics states (runs, size)."""
        model, number = self._system.model, self._number
        # a full physics state is time, qpos, qvel and more
        in_state = slice(1, 1 + model.nq)
        qpos = np.empty((len(starts), len(self._system.scene.times), model.nq))
        qpos[:, 0] = starts[:, in_state]
        steps = self._states.shape[1]
        with collected_warnings():
            for begin in range(0, len(starts), len(self._states)):
                portion = starts[begin : begin + len(self._states)]
                runs = len(portion)
                states = self._states[:runs]
                self._pool.rollout(
                    [model] * runs,
                    self._data_of_threads,
                    portion,
                    self._controls[:runs] if model.nu else None,
                    nstep=steps,
                    state=states,
                    sensordata=np.empty((runs, steps, model.nsensordata)),
                    skip_checks=True,
                )
                # states after the last step of each output interval
                qpos[begin : begin + runs, 1:] = states[:, number - 1 :: number, in_state]
        return qpos

    def poses(self, qpos: Array) -> tuple[Array, Array]:
        """Return positions (n, b, 3), m, and quaternions (n, b, 4) of the bodies, from qpos (n, nq) of a run.

        Raises:
            DivergenceError: for a motion that is not finite.
        """
        model, data = self._system.model, self._system.data
        position, quaternion = np.empty((len(qpos), model.nbody, 3)), np.empty((len(qpos), model.nbody, 4))
        for k, row in enumerate(qpos):
            data.qpos[:] = row
            mujoco.mj_kinematics(model, data)
            position[k], quaternion[k] = data.xpos, data.xquat
        return _scene_poses(self._system, position, quaternion)


def _controls_of_steps(scene: Scene, steps: int, step: float) -> Array:
    """Return the controls (steps, nu) that are constant during each step.

    They are the controls at the middle of the step, for an error of second order in the step. PD laws need no
    measured coordinates, because MuJoCo's actuators add the feedback.
    """
    return np.array([controls(scene, (n + 0.5) * step, readings={}) for n in range(steps)])


def _scene_poses(system: SoftMuJoCo, position: Array, quaternion: Array) -> tuple[Array, Array]:
    """Return positions (n, b, 3), m, and quaternions (n, b, 4) of the scene's bodies, ground first.

    Args:
        system: compiled scene.
        position: (n, nbody, 3) m, positions of MuJoCo's bodies at outputs.
        quaternion: (n, nbody, 4) orientations of MuJoCo's bodies.

    Raises:
        DivergenceError: for a motion that is not finite.
    """
    ground = system.mechanism.bodies[0]
    finite = np.all(np.isfinite(position), axis=(1, 2)) & np.all(np.isfinite(quaternion), axis=(1, 2))
    if not np.all(finite):
        raise DivergenceError(float(system.scene.times[np.argmin(finite)]), "its motion is not finite")
    # MuJoCo's ids of the scene's bodies; the ids after them are halves of bodies cut to open loops
    bodies = system.body_id[: len(system.mechanism.bodies)]
    position, quaternion = position[:, bodies], quaternion[:, bodies]
    position[:, 0], quaternion[:, 0] = ground.center_of_mass, ground.quaternion
    return position, quaternion
