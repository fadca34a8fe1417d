"""The tightest loops around MuJoCo: whole runs, and many at once, with nothing but poses kept.

Features that no scene has a use for are switched off. So is the warm start: the constraints are linear in
the accelerations, so one Newton step from anywhere solves them. Constraints are as stiff as the step
allows, with a time constant of two steps.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import repeat
from typing import Any

import mujoco
import mujoco.rollout
import numpy as np

from mjcf.errors import DivergenceError, MjcfError, heard_warnings
from mjcf.forces import wind_loads
from mjcf.soft import SoftMuJoCo, stiffest
from mjcf.write import controls
from newton_euler.model.scene import Scene
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array

UNUSED = (
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
"""Features that no scene has, or that cost more than they save."""

PASSIVE = ("SPRING", "DAMPER")
"""Features that scenes without springs and dampers do not have."""

PORTION = 32_000_000
"""Bytes of states that `mujoco.rollout` may fill at a time: it writes one a step."""


def compiled(scene: Scene) -> SoftMuJoCo:
    """The scene in MuJoCo with everything off that it does not need.

    Raises:
        MjcfError: for a prescribed motion, a control law that is no PD, and wind.
    """
    for motion in scene.motions:
        raise MjcfError(
            f"motion of joint {motion.joint!r}: MuJoCo has no equality that depends on time, "
            "and benchmark kernels call no Python to make one"
        )
    system = SoftMuJoCo(scene)
    for each in (*system.evaluated.values(), *wind_loads(scene)):
        raise MjcfError(f"{each.element}: no actuator of MuJoCo's, and benchmark kernels call no Python")
    disabled = [*UNUSED, *(() if scene.forces else PASSIVE), *(() if np.any(scene.gravity) else ("GRAVITY",))]
    flags = (int(getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}")) for name in disabled)
    system.model.opt.disableflags = sum(flags)
    return system


def forward(scene: Scene) -> Any:
    """A call of no arguments: one right-hand side at the initial state, `mj_forward`."""
    system = compiled(scene)
    system.place(*system.coordinates(initial_state(scene)))
    model, data, call = system.model, system.data, mujoco.mj_forward
    return lambda: call(model, data)


def steps(scene: Scene) -> Any:
    """A call that makes so many steps by `mj_step` with Euler's method from the initial state."""
    system = compiled(scene)
    system.place(*system.coordinates(initial_state(scene)))
    model, data = system.model, system.data
    system.use_integrator("Euler")
    qpos, qvel = data.qpos.copy(), data.qvel.copy()

    def call(count: int) -> None:
        data.qpos[:], data.qvel[:] = qpos, qvel
        mujoco.mj_step(model, data, count)

    return call


class Stepper:
    """A run at `number` steps from one output to the next: `reset`, then `run`, then `poses`.

    Attributes:
        position, quaternion: (n, nbody, 3) m and (n, nbody, 4) of MuJoCo's bodies at outputs, after `run`.
    """

    def __init__(
        self,
        system: SoftMuJoCo,
        integrator: str,
        intervals: list[tuple[int, float]],
        number: int,
        damping_ratio: float,
    ) -> None:
        """`intervals` are numbers of equal intervals, s, between outputs, one after the other."""
        self._system, self._intervals, self._number, self._ratio = system, intervals, number, damping_ratio
        self._integrator = integrator
        outputs = 1 + sum(count for count, _ in intervals)
        self.position = np.empty((outputs, system.model.nbody, 3))
        self.quaternion = np.empty((outputs, system.model.nbody, 4))
        self._advance = _whole_steps if integrator == "RK4" else _split_steps

    def reset(self) -> None:
        """Put everything back to the start."""
        system = self._system
        mujoco.mj_resetData(system.model, system.data)
        system.place(*system.coordinates(initial_state(system.scene)))
        system.use_integrator(self._integrator)

    def run(self) -> None:
        """Fill `position` and `quaternion`."""
        model, data = self._system.model, self._system.data
        rows = zip(self.position, self.quaternion, strict=True)
        with heard_warnings(), self._system.following():
            for count, interval in self._intervals:
                step = interval / self._number
                self._system.use_step(step, stiffest(step, self._ratio))
                self._advance(model, data, rows, count, self._number)
            mujoco.mj_kinematics(model, data)
        self.position[-1], self.quaternion[-1] = data.xpos, data.xquat

    def poses(self) -> tuple[Array, Array]:
        """Positions (n, b, 3) and quaternions (n, b, 4) of the scene's bodies, ground first.

        Raises:
            DivergenceError: for a run that is not finite.
        """
        return _of_scene(self._system, self.position, self.quaternion)


def _split_steps(model: Any, data: Any, rows: Iterator[Any], count: int, number: int) -> None:
    """Poses at the beginnings of `count` intervals, and `number` steps after each.

    Halfway through its first step MuJoCo has worked out where the bodies are before it.
    """
    first, second, step, rest = mujoco.mj_step1, mujoco.mj_step2, mujoco.mj_step, number - 1
    xpos, xquat = data.xpos, data.xquat
    for _ in repeat(None, count):
        position, quaternion = next(rows)
        first(model, data)
        position[...], quaternion[...] = xpos, xquat
        second(model, data)
        if rest:
            step(model, data, rest)


def _whole_steps(model: Any, data: Any, rows: Iterator[Any], count: int, number: int) -> None:
    """The same for RK4, which has no halves of steps."""
    step, kinematics = mujoco.mj_step, mujoco.mj_kinematics
    xpos, xquat = data.xpos, data.xquat
    for _ in repeat(None, count):
        position, quaternion = next(rows)
        kinematics(model, data)
        position[...], quaternion[...] = xpos, xquat
        step(model, data, number)


def physics_states(system: SoftMuJoCo, q: Array, v: Array) -> Array:
    """MuJoCo's full physics states (n, size) of coordinates (n, nq) and velocities (n, nv)."""
    kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
    states = np.empty((len(q), mujoco.mj_stateSize(system.model, kind)))
    for row, at, moving in zip(states, q, v, strict=True):
        system.place(at, moving)
        mujoco.mj_getState(system.model, system.data, row, kind)
    return states


class Rollout:
    """Many runs at once by `mujoco.rollout`, `number` steps from one output to the next.

    It writes time, qpos and qvel after every step; of those, qpos at outputs is kept.
    """

    def __init__(
        self, system: SoftMuJoCo, integrator: str, number: int, damping_ratio: float, threads: int
    ) -> None:
        """For a scene with equal intervals between outputs."""
        self._system, self._number = system, number
        model, times = system.model, system.scene.times
        system.use_integrator(integrator)
        step = float(times[1] - times[0]) / number
        system.use_step(step, stiffest(step, damping_ratio))
        self._datas = [mujoco.MjData(model) for _ in range(threads)]
        self._pool = mujoco.rollout.Rollout(nthread=threads if threads > 1 else 0)
        steps = number * (len(times) - 1)
        size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        runs = max(10 * threads, PORTION // (8 * steps * size))
        self._states = np.empty((runs, steps, size))
        self._control = np.tile(_held(system.scene, steps, model.opt.timestep), (runs, 1, 1))

    def __call__(self, starts: Array) -> Array:
        """qpos (runs, n, nq) at all outputs, of runs from full physics states (runs, size)."""
        model, number = self._system.model, self._number
        kept = np.empty((len(starts), len(self._system.scene.times), model.nq))
        kept[:, 0] = starts[:, 1 : 1 + model.nq]
        steps = self._states.shape[1]
        with heard_warnings():
            for begin in range(0, len(starts), len(self._states)):
                portion = starts[begin : begin + len(self._states)]
                runs = len(portion)
                states = self._states[:runs]
                self._pool.rollout(
                    [model] * runs,
                    self._datas,
                    portion,
                    self._control[:runs] if model.nu else None,
                    nstep=steps,
                    state=states,
                    sensordata=np.empty((runs, steps, model.nsensordata)),
                    skip_checks=True,
                )
                kept[begin : begin + runs, 1:] = states[:, number - 1 :: number, 1 : 1 + model.nq]
        return kept

    def poses(self, qpos: Array) -> tuple[Array, Array]:
        """Positions (n, b, 3) and quaternions (n, b, 4) of the scene's bodies of one run's qpos (n, nq).

        Raises:
            DivergenceError: for a run that is not finite.
        """
        model, data = self._system.model, self._system.data
        position, quaternion = np.empty((len(qpos), model.nbody, 3)), np.empty((len(qpos), model.nbody, 4))
        for k, row in enumerate(qpos):
            data.qpos[:] = row
            mujoco.mj_kinematics(model, data)
            position[k], quaternion[k] = data.xpos, data.xquat
        return _of_scene(self._system, position, quaternion)


def _held(scene: Scene, steps: int, step: float) -> Array:
    """(steps, nu) controls in the middle of each step, s, which is of second order for driven laws."""
    return np.array([controls(scene, (n + 0.5) * step, {}) for n in range(steps)])


def _of_scene(system: SoftMuJoCo, position: Array, quaternion: Array) -> tuple[Array, Array]:
    """The poses of the scene's bodies out of those of MuJoCo's, which start with the world."""
    ground = system.mechanism.bodies[0]
    finite = np.all(np.isfinite(position), axis=(1, 2)) & np.all(np.isfinite(quaternion), axis=(1, 2))
    if not np.all(finite):
        raise DivergenceError(float(system.scene.times[np.argmin(finite)]), "its motion is not finite")
    bodies = system.body_id[: len(system.mechanism.bodies)]
    position, quaternion = position[:, bodies], quaternion[:, bodies]
    position[:, 0], quaternion[:, 0] = ground.center_of_mass, ground.quaternion
    return position, quaternion
