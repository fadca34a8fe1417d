"""MuJoCo as it is, with its soft constraints, at single states, and the work that its steps do.

A step h from v0 to v1 gives a mechanism the momentum h F, where F is a mean of what its stages find, and the
work of that is h F (v0 + v1) / 2: exact for constant masses, whose kinetic energy is half of them times v^2.
Powers at the steps' ends are no substitute where forces differ between stages or are not of the state that a
step starts from:

- The multiplier of a prescribed motion. Its constraint is a spring with a time constant of some steps, which
  stages of RK4 leave by parts of h^2 times the acceleration, so that it is off by some 0.1 % in each stage,
  however small the step, and right in their weighted mean.
- What implicit integrators take at the end of a step (MuJoCo's documentation, Computation, section Numerical
  integration): dampers in all of them, actuators in implicit and implicitfast. Stiff ones do nearly opposite
  work there, of which little is left.

Smooth forces in RK4 are integrated by Simpson's rule, which is of its order.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from typing import Any

import mujoco
import numpy as np

from mjcf.evaluate import EvaluatedScene
from mjcf.forces import wind_loads
from mjcf.rigid import RigidMuJoCo
from mjcf.write import control
from newton_euler.equations.model_control import EngineControl
from newton_euler.equations.system import Evaluation
from newton_euler.model.control import PD, DeclaredLaw, DrivenLaws
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array


def stiffest(step: float, damping_ratio: float = 1.0) -> tuple[float, float]:
    """Return the stiffest solref that MuJoCo allows: a time constant of two steps."""
    return 2.0 * step, damping_ratio


RK4_WEIGHTS = np.array([1.0, 2.0, 2.0, 1.0]) / 6.0


class SoftMuJoCo(EvaluatedScene):
    """Equations by `mj_forward`: accelerations and constraint forces of soft constraints.

    Attributes:
        moved: (m,) places in MuJoCo's velocities of the joint coordinates that follow prescribed motions.
        driven: the PD laws that depend on time; those that jump are held by the scene.
        evaluated: declared laws that are more than an actuator of MuJoCo's, by their numbers.
    """

    name = "mujoco"

    def __init__(self, scene: Scene) -> None:
        """Compile; raises `ModelError` with MuJoCo's reason if it refuses."""
        super().__init__(scene)
        first = self.model.neq - len(self.couplings.couplings)
        self._motions = np.arange(first, first + len(scene.motions))  # the first of the couplings
        self.moved = self.model.jnt_dofadr[self.model.eq_obj1id[self._motions]]
        self.driven = DrivenLaws(scene.control)
        declared = [(k, law) for k, law in enumerate(scene.control) if isinstance(law, DeclaredLaw)]
        self.evaluated = {k: law for k, law in declared if law.uses_model or not isinstance(law, PD)}
        # of the evaluations in a step; shared by copies of this object, one of which MuJoCo calls
        self._asked: list[tuple[Array, Array]] = []
        self._stages: list[Array] = []

    def engine_control(self, scene: Scene) -> EngineControl:
        return EngineControl(scene, RigidMuJoCo)

    def use_integrator(self, name: str) -> None:
        """Have MuJoCo integrate by the method that MJCF calls so."""
        self.model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{name.upper()}")

    def use_step(self, step: float, solref: tuple[float, float] | None = None) -> None:
        """Have MuJoCo make steps, s, with the stiffest constraints that they allow if no solref is given."""
        self.model.opt.timestep = step
        self.model.eq_solref[:] = solref or stiffest(step)

    def evaluate(self, q: Array, v: Array) -> Evaluation:
        """Accelerations, reactions and energies at a state."""
        self.place(q, v)
        self.data.qacc_warmstart[:] = 0.0  # so that the answer does not depend on the state before
        with self.following():
            mujoco.mj_forward(self.model, self.data)
        return self.evaluation(np.array(self.data.qacc), np.array(self.data.efc_force))

    @contextmanager
    def following(self) -> Iterator[None]:
        """Within it MuJoCo's actuators follow the scene's laws and wind, and joints its functions of time.

        Each of MuJoCo's evaluations, those of the stages of RK4 too, gets the controls at its own time. What
        is held for a step instead would be of second order at best, and its power would jump.

        MuJoCo's equalities do not depend on time. But all that a constraint row knows of its residual r
        is the acceleration that it asks for (its documentation, Computation, section Reference),

            a_ref = -b dr/dt - k d r,

        which is changed here, before each of MuJoCo's solves, to that of r = x - f(t),

            a_ref = f'' - b (dx/dt - f') - k d (x - f).
        """
        if not (len(self.moved) or len(self.driven.places) or self.evaluated or wind_loads(self.scene)):
            yield
            return
        before = mujoco.get_mjcb_control()
        mujoco.set_mjcb_control(self._act)
        try:
            yield
        finally:
            mujoco.set_mjcb_control(before)

    def _act(self, model: Any, data: Any) -> None:
        """Callback of MuJoCo in each evaluation."""
        if len(self.driven.places):  # of the others those that are sampled have changed since
            data.ctrl[self.driven.places] = self.driven.at(self.scene.control, data.time)
        if self.evaluated:
            readings = self.readings(data)
            model = self.model_forces(data, readings)
            for k in self.evaluated:  # as the scene has them at present
                data.ctrl[k] = control(self.scene.control[k], data.time, readings, model)
        self.blow(data)
        if len(self.moved):
            self._follow(data)

    def _follow(self, data: Any) -> None:
        """Change a_ref of the rows of prescribed motions at MuJoCo's time."""
        rows, functions = self._rows_of_motions(data), slice(len(self.moved))
        if self._asked:  # accelerations are still those of the stage before
            asked, stiffness = self._asked.pop()
            self._stages.append(stiffness * (asked - data.qacc[self.moved]))
        ahead = self.couplings.value(data.time)[functions] - self.couplings.value(0.0)[functions]
        k, b, impedance = data.efc_KBIP[rows, :3].T
        data.efc_aref[rows] += (
            self.couplings.acceleration(data.time)[functions]
            + b * self.couplings.rate(data.time)[functions]
            + k * impedance * ahead
        )
        self._asked.append((np.array(data.efc_aref[rows]), np.array(data.efc_D[rows])))

    def _rows_of_motions(self, data: Any) -> Array:
        """(m,) the rows of prescribed motions, which are never dropped: each moves a joint."""
        return np.flatnonzero(np.isin(data.efc_id, self._motions))

    def step_with_work(self, number: int, warnings: Collection[str]) -> float:
        """Make a number of steps from the state that `data` holds; the work, J, of what has no potential.

        No more after a step of which MuJoCo has warned: it has started again from its initial state.
        """
        model, data, size = self.model, self.data, self.model.opt.timestep
        runge_kutta = model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
        by_momentum = not runge_kutta or len(self.moved) > 0
        powers, work = list[float](), 0.0
        for _ in range(number):
            if by_momentum:
                start = np.array(data.qvel)
                self._asked.clear()
                self._stages.clear()
            if runge_kutta:
                powers.append(self._runge_kutta_step())
            else:
                mujoco.mj_step(model, data)
            if warnings:
                return work
            if not by_momentum:
                continue
            mean = 0.5 * size * (start + data.qvel)
            if len(self.moved):
                # a soft constraint's force is D (a_ref - a) with the acceleration a that comes about
                multipliers = np.array([*self._stages, data.efc_force[self._rows_of_motions(data)]])
                weights = RK4_WEIGHTS if runge_kutta else np.ones(1)
                work += float(weights @ multipliers @ mean[self.moved])
            if not runge_kutta:
                work += float(self._applied(start) @ mean)
        if runge_kutta:
            mujoco.mj_forward(model, data)
            work += simpson(np.array([*powers, self._power()]), size)
        return work

    def _runge_kutta_step(self) -> float:
        """Make a step of RK4 as `mj_step` does; the power, W, of actuators and dampers before it."""
        model, data = self.model, self.data
        mujoco.mj_checkPos(model, data)
        mujoco.mj_checkVel(model, data)
        mujoco.mj_forward(model, data)
        mujoco.mj_checkAcc(model, data)
        power = self._power()
        mujoco.mj_RungeKutta(model, data, len(RK4_WEIGHTS))
        return power

    def _power(self) -> float:
        """Power, W, of actuators and dampers, worked out for the state that `data` holds."""
        data = self.data
        return float(data.actuator_force @ data.actuator_velocity + data.qfrc_damper @ data.qvel)

    def _applied(self, start: Array) -> Array:
        """(nv,) generalized forces of actuators and dampers in the step just made from velocities `start`."""
        model, data = self.model, self.data
        if model.opt.integrator == mujoco.mjtIntegrator.mjINT_EULER:  # only dampers at joints are implicit
            implicit = -model.dof_damping * (data.qvel - start)
            return np.asarray(data.qfrc_actuator + data.qfrc_damper + implicit)
        # positions are those that the step started from until the next one; velocities are new
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fwdActuation(model, data)
        return np.asarray(data.qfrc_actuator + data.qfrc_damper)


def simpson(values: Array, step: float) -> float:
    """Integrate a function by Simpson's rule, whose values (n + 1,) at the ends of n equal steps are given.

    If n is odd, the last step is integrated by the parabola through the last three values, a single step by
    the trapezoidal rule.
    """
    last = len(values) - 1
    if last == 1:
        return 0.5 * step * float(values.sum())
    paired = last - last % 2
    total = (values[0:paired:2] + 4.0 * values[1:paired:2] + values[2 : paired + 1 : 2]).sum() / 3.0
    if paired < last:
        total += values[-3:] @ np.array([-1.0, 8.0, 5.0]) / 12.0
    return step * float(total)
