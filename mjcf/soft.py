"""MuJoCo's soft constraints at single states, and the work of MuJoCo's time steps.

A step h changes velocities from v0 to v1 by the impulse h F, where F is a mean of the forces of the stages.
The work of the impulse is h F (v0 + v1) / 2. This is exact for constant masses, because the kinetic energy is
quadratic in v. Powers at the ends of steps are no substitute in two cases:

- Multipliers of prescribed motions. The constraint is a spring with a time constant of a few steps. The
  stages
  of RK4 leave it by about h^2 times the acceleration, which is an error of 0.1 % in each stage for any step.
  The weighted mean of the stages is accurate.
- Implicit integrators, which change forces at the end of a step (MuJoCo's documentation, Computation, section
  Numerical integration): dampers in all of them, actuators in implicit and implicitfast. Stiff dampers and
  actuators do nearly opposite work, so that powers lose most digits.

Smooth forces in RK4 are integrated by Simpson's rule, which has the order of RK4.
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
    """Equations of motion by `mj_forward`, with accelerations and forces of soft constraints.

    Attributes:
        moved: (m,) numbers of MuJoCo's velocities that follow prescribed motions.
        driven: PD laws that depend on time continuously; the scene holds laws that jump.
        evaluated: declared laws without an equivalent actuator of MuJoCo, by number.
    """

    name = "mujoco"

    def __init__(self, scene: Scene) -> None:
        """Compile a scene; raises `ModelError` with MuJoCo's reason."""
        super().__init__(scene)
        first = self.model.neq - len(self.couplings.couplings)
        self._motions = np.arange(first, first + len(scene.motions))  # the first of the couplings
        self.moved = self.model.jnt_dofadr[self.model.eq_obj1id[self._motions]]
        self.driven = DrivenLaws(scene.control)
        declared = [(k, law) for k, law in enumerate(scene.control) if isinstance(law, DeclaredLaw)]
        self.evaluated = {k: law for k, law in declared if law.uses_model or not isinstance(law, PD)}
        # stages of a step, shared by copies of this object, because MuJoCo calls one of the copies
        self._asked: list[tuple[Array, Array]] = []
        self._stages: list[Array] = []

    def engine_control(self, scene: Scene) -> EngineControl:
        return EngineControl(scene, RigidMuJoCo)

    def use_integrator(self, name: str) -> None:
        """Set MuJoCo's integrator by its name in MJCF."""
        self.model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{name.upper()}")

    def use_step(self, step: float, solref: tuple[float, float] | None = None) -> None:
        """Set the time step, s, and solref; without solref, the stiffest constraints for the step."""
        self.model.opt.timestep = step
        self.model.eq_solref[:] = solref or stiffest(step)

    def evaluate(self, q: Array, v: Array) -> Evaluation:
        """Compute accelerations, reactions and energies at a state."""
        self.place(q, v)
        self.data.qacc_warmstart[:] = 0.0  # the result must not depend on the previous state
        with self.following():
            mujoco.mj_forward(self.model, self.data)
        return self.evaluation(np.array(self.data.qacc), np.array(self.data.efc_force))

    @contextmanager
    def following(self) -> Iterator[None]:
        """Return a context in which MuJoCo follows the scene's control laws, wind and prescribed motions.

        Each evaluation of MuJoCo, including the stages of RK4, uses the controls at its own time. Controls
        that are held during a step would be of second order at best, and their power would jump.

        MuJoCo's equalities do not depend on time. A constraint row uses its residual r only in the reference
        acceleration (MuJoCo's documentation, Computation, section Reference),

            a_ref = -b dr/dt - k d r.

        Before each solve, this is changed to the reference acceleration of r = x - f(t),

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
        """Set time-dependent controls, wind and motions; MuJoCo calls this in each evaluation."""
        if len(self.driven.places):  # driven laws only; other controls are already set
            data.ctrl[self.driven.places] = self.driven.at(self.scene.control, data.time)
        if self.evaluated:
            readings = self.readings(data)
            model = self.model_forces(data, readings)
            for k in self.evaluated:  # the scene of this copy has the present laws
                data.ctrl[k] = control(self.scene.control[k], data.time, readings, model)
        self.blow(data)
        if len(self.moved):
            self._follow(data)

    def _follow(self, data: Any) -> None:
        """Change a_ref of the rows of prescribed motions to MuJoCo's time."""
        rows, functions = self._rows_of_motions(data), slice(len(self.moved))
        if self._asked:  # qacc still has the accelerations of the previous stage
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
        """Return the rows (m,) of prescribed motions, which MuJoCo never drops."""
        return np.flatnonzero(np.isin(data.efc_id, self._motions))

    def step_with_work(self, number: int, warnings: Collection[str]) -> float:
        """Take steps from the state in `data`; return the work, J, of forces without potential.

        Args:
            number: number of steps.
            warnings: MuJoCo's warnings. A warning ends the steps, because MuJoCo then resets the state.
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
                # the force of a soft constraint is D (a_ref - a), with the resulting acceleration a
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
        """Take a step of RK4 like `mj_step`; return the power, W, of actuators and dampers before it."""
        model, data = self.model, self.data
        mujoco.mj_checkPos(model, data)
        mujoco.mj_checkVel(model, data)
        mujoco.mj_forward(model, data)
        mujoco.mj_checkAcc(model, data)
        power = self._power()
        mujoco.mj_RungeKutta(model, data, len(RK4_WEIGHTS))
        return power

    def _power(self) -> float:
        """Return the power, W, of actuators and dampers at the state in `data`."""
        data = self.data
        return float(data.actuator_force @ data.actuator_velocity + data.qfrc_damper @ data.qvel)

    def _applied(self, start: Array) -> Array:
        """Return forces (nv,) of actuators and dampers in the last step, from velocities `start`."""
        model, data = self.model, self.data
        if model.opt.integrator == mujoco.mjtIntegrator.mjINT_EULER:  # only dampers at joints are implicit
            implicit = -model.dof_damping * (data.qvel - start)
            return np.asarray(data.qfrc_actuator + data.qfrc_damper + implicit)
        # data has positions before the step and velocities after the step
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fwdActuation(model, data)
        return np.asarray(data.qfrc_actuator + data.qfrc_damper)


def simpson(values: Array, step: float) -> float:
    """Integrate values (n + 1,) at the ends of n equal steps by Simpson's rule.

    If n is odd, the last step is integrated by the parabola through the last three values. A single step is
    integrated by the trapezoidal rule.
    """
    last = len(values) - 1
    if last == 1:
        return 0.5 * step * float(values.sum())
    paired = last - last % 2
    total = (values[0:paired:2] + 4.0 * values[1:paired:2] + values[2 : paired + 1 : 2]).sum() / 3.0
    if paired < last:
        total += values[-3:] @ np.array([-1.0, 8.0, 5.0]) / 12.0
    return step * float(total)
