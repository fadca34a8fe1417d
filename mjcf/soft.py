"""A scene with MuJoCo's own soft constraints: evaluation of states, and the work of MuJoCo's time steps.

`mjcf.simulate` steps a `SoftMuJoCo`. MuJoCo has no element for prescribed motions, wind, and control laws
other than PD laws with constant targets; a callback evaluates them. The work of forces without potential
(actuators, dampers, prescribed motions) is needed for the energy balance of a run.

A step of size h changes velocities from v0 to v1 by the impulse h F, where F is a mean of the forces of the
integrator's stages. The work of the impulse is h F (v0 + v1) / 2. This is exact for a constant mass matrix,
because the kinetic energy is quadratic in v. The powers at the ends of a step are inaccurate in two cases:

- Multipliers of prescribed motions: the soft constraint is a spring with a time constant of a few steps. In
  the stages of RK4, the motion deviates by about h^2 times the acceleration. The force of each stage has an
  error of 0.1 % for any step size, but the weighted mean of the stages is accurate.
- Implicit integrators change forces at the end of a step (MuJoCo's documentation, Computation, section
  Numerical integration): all of them change dampers, implicit and implicitfast also actuators. Stiff dampers
  and actuators do nearly opposite work, so that the sum of powers loses most digits.

The powers of smooth forces in RK4 are integrated by Simpson's rule, which has the order of RK4.
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
from newton_euler.equations.load_friction import EngineFriction
from newton_euler.equations.model_control import EngineControl
from newton_euler.equations.system import Evaluation
from newton_euler.model.control import PD, DeclaredLaw, TimeDependentPD
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array

RK4_WEIGHTS = np.array([1.0, 2.0, 2.0, 1.0]) / 6.0
"""Weights of the four stages in a step of RK4."""


def stiffest_solref(step: float, damping_ratio: float = 1.0) -> tuple[float, float]:
    """Return the stiffest solref that MuJoCo allows for a step, s: a time constant of two steps."""
    return 2.0 * step, damping_ratio


class SoftMuJoCo(EvaluatedScene):
    """Equations of motion by `mj_forward`, with accelerations and forces of soft constraints.

    Attributes:
        prescribed: (m,) numbers of MuJoCo's velocities that follow prescribed motions.
        driven: PD laws that depend on time, evaluated together. `driven.law_indices` are their numbers.
        evaluated: control laws of the scene without an equivalent actuator of MuJoCo (state feedback,
            computed torque, gravity compensation), by number.
    """

    name = "mujoco"

    def __init__(self, scene: Scene) -> None:
        """Compile a scene; raises `ModelError` with MuJoCo's reason."""
        super().__init__(scene)
        # `couplings` are constraints on joint coordinates: prescribed motions, then gears and the like.
        # Their equalities are MuJoCo's last ones, in the same order
        first = self.model.neq - len(self.couplings.couplings)
        self._motions = np.arange(first, first + len(scene.motions))
        self.prescribed = self.model.jnt_dofadr[self.model.eq_obj1id[self._motions]]
        self.driven = TimeDependentPD(scene.control)
        # all laws except digital ones, whose forces are constant between samples
        declared = [(k, law) for k, law in enumerate(scene.control) if isinstance(law, DeclaredLaw)]
        self.evaluated = {k: law for k, law in declared if law.uses_model or not isinstance(law, PD)}
        # The first list has at most one pair: a_ref and D (m,) of the rows of prescribed motions in the
        # latest stage of a step. The second list has the multipliers (m,) of the completed stages. Both are
        # lists, because copies of this object share them. `mjcf.simulate` makes a copy for each interval
        # with other forces of digital controllers or other set-points.
        self._latest_reference: list[tuple[Array, Array]] = []
        self._stage_multipliers: list[Array] = []

    def engine_control(self, scene: Scene) -> EngineControl:
        """Return the inverse dynamics of model-based control laws, with rigid constraints."""
        return EngineControl(scene, RigidMuJoCo)

    def engine_friction(self, scene: Scene) -> EngineFriction:
        """Return the equations for friction that grows with reactions, with rigid constraints."""
        return EngineFriction(scene, RigidMuJoCo)

    def use_integrator(self, name: str) -> None:
        """Set MuJoCo's integrator by its name in MJCF."""
        self.model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{name.upper()}")

    def use_step(self, step: float, solref: tuple[float, float] | None = None) -> None:
        """Set the time step, s, and solref; None means the stiffest constraints for the step."""
        self.model.opt.timestep = step
        self.model.eq_solref[:] = solref or stiffest_solref(step)

    def evaluate(self, q: Array, v: Array) -> Evaluation:
        """Compute accelerations, reactions and energies at a state."""
        self.set_state(q, v)
        self.data.qacc_warmstart[:] = 0.0  # the result must not depend on the previous state
        with self.following():
            mujoco.mj_forward(self.model, self.data)
        acceleration, multipliers = np.array(self.data.qacc), np.array(self.data.efc_force)
        return self.evaluation(acceleration, multipliers)

    @contextmanager
    def following(self) -> Iterator[None]:
        """Return a context in which MuJoCo follows control laws, wind, dry friction, stops and motions.

        Each evaluation of MuJoCo, including each stage of RK4, uses the controls of its time. With controls
        that stay constant during a step, the integration would be of second order at best.

        MuJoCo's equalities do not depend on time. The residual r of a constraint row enters only the
        reference acceleration (MuJoCo's documentation, Computation, section Reference), with stiffness k,
        damping b and impedance d of the row,

            a_ref = -b dr/dt - k d r.

        Before MuJoCo solves for accelerations, the callback changes a_ref to the reference acceleration of
        r = x - f(t), where x is the joint coordinate and f its prescribed motion,

            a_ref = f'' - b (dx/dt - f') - k d (x - f).
        """
        scene = self.scene
        evaluated = self.evaluated or wind_loads(scene) or scene.switched_forces
        if not (len(self.prescribed) or len(self.driven.law_indices) or evaluated):
            yield
            return
        if self.friction is not None:
            _ = self.friction.model  # no model can be compiled while the callback is set
        previous_callback = mujoco.get_mjcb_control()
        mujoco.set_mjcb_control(self._control_callback)
        try:
            yield
        finally:
            mujoco.set_mjcb_control(previous_callback)

    def _control_callback(self, model: Any, data: Any) -> None:
        """Set all that depends on time or on Python; MuJoCo calls this method in each evaluation."""
        if len(self.driven.law_indices):  # controls of other PD laws are constant
            data.ctrl[self.driven.law_indices] = self.driven.forces_at(self.scene.control, data.time)
        if self.evaluated:
            readings = self.readings(data)  # joint coordinates and rates that the laws measure
            model_forces = self.model_forces(data, readings)
            for k in self.evaluated:
                # not `evaluated[k]`: the scene of a copy for an interval may have other set-points
                data.ctrl[k] = control(self.scene.control[k], data.time, readings, model_forces)
        self.set_wind(data)
        self.set_switched_forces(data)
        if len(self.prescribed):
            self._follow_motions(data)

    def _follow_motions(self, data: Any) -> None:
        """Change a_ref of the rows of prescribed motions to the values at `data.time`, see `following`.

        If a stage of the same step precedes this evaluation, the multipliers of that stage are stored. They
        are D (a_ref - a) with MuJoCo's constraint mass D (`efc_D`) and the resulting acceleration a.
        """
        rows, motions = self._rows_of_motions(data), slice(len(self.prescribed))
        if self._latest_reference:  # qacc still has the accelerations of the previous stage
            reference, constraint_mass = self._latest_reference.pop()
            self._stage_multipliers.append(constraint_mass * (reference - data.qacc[self.prescribed]))
        # the equalities are compiled with the values f(0)
        displacement = self.couplings.value(data.time)[motions] - self.couplings.value(0.0)[motions]
        k, b, impedance = data.efc_KBIP[rows, :3].T  # k, b, d of `following`
        data.efc_aref[rows] += (
            self.couplings.acceleration(data.time)[motions]
            + b * self.couplings.rate(data.time)[motions]
            + k * impedance * displacement
        )
        self._latest_reference.append((np.array(data.efc_aref[rows]), np.array(data.efc_D[rows])))

    def _rows_of_motions(self, data: Any) -> Array:
        """Return the numbers (m,) of the constraint rows of prescribed motions; MuJoCo never drops them."""
        return np.flatnonzero(np.isin(data.efc_id, self._motions))

    def step_with_work(self, number: int, warnings: Collection[str]) -> float:
        """Take time steps from the state in `data`, and compute their work (see the start of this module).

        Args:
            number: number of steps.
            warnings: collects MuJoCo's warnings during the steps. A warning ends the steps, because MuJoCo
                then resets the state.

        Returns:
            Work, J, of actuators, dampers and prescribed motions.
        """
        model, data, step = self.model, self.data, self.model.opt.timestep
        is_rk4 = model.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
        uses_impulses = not is_rk4 or len(self.prescribed) > 0
        powers, work = list[float](), 0.0
        for _ in range(number):
            if uses_impulses:
                v0 = np.array(data.qvel)
                self._latest_reference.clear()
                self._stage_multipliers.clear()
            if is_rk4:
                powers.append(self._rk4_step())
            else:
                mujoco.mj_step(model, data)
            if warnings:
                return work
            if not uses_impulses:
                continue
            # work of the step's impulse: F . h (v0 + v1) / 2
            displacement = 0.5 * step * (v0 + data.qvel)
            if len(self.prescribed):
                # the force of a soft constraint is D (a_ref - a), with the resulting acceleration a
                last_stage = data.efc_force[self._rows_of_motions(data)]
                multipliers = np.array([*self._stage_multipliers, last_stage])
                weights = RK4_WEIGHTS if is_rk4 else np.ones(1)
                work += float(weights @ multipliers @ displacement[self.prescribed])
            if not is_rk4:
                work += float(self._applied_forces(v0) @ displacement)
        if is_rk4:
            mujoco.mj_forward(model, data)
            work += simpson(np.array([*powers, self._power()]), step)
        return work

    def _rk4_step(self) -> float:
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
        """Return the power, W, of forces without potential at the state in `data`."""
        data = self.data
        of_joints = data.qfrc_damper + self._switched_without_potential()
        return float(data.actuator_force @ data.actuator_velocity + of_joints @ data.qvel)

    def _switched_without_potential(self) -> Array:
        """Return the generalized forces (nv,) of switched forces, without their springs."""
        forces = np.array(self.data.qfrc_applied)
        if len(self._switched_v):
            np.subtract.at(forces, self._switched_v, self.applied_elastic)
        return forces

    def _applied_forces(self, v0: Array) -> Array:
        """Return the generalized forces (nv,) of actuators and dampers that the last implicit step applied.

        `v0` (nv,) are the velocities before the step.
        """
        model, data = self.model, self.data
        if model.opt.integrator == mujoco.mjtIntegrator.mjINT_EULER:  # only dampers of joints are implicit
            damper_change = -model.dof_damping * (data.qvel - v0)
            of_switched = self._switched_without_potential()
            return np.asarray(data.qfrc_actuator + data.qfrc_damper + damper_change + of_switched)
        # `data` has the quantities that depend on positions from before the step, and velocities after it
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_fwdActuation(model, data)
        return np.asarray(data.qfrc_actuator + data.qfrc_damper + self._switched_without_potential())


def simpson(values: Array, step: float) -> float:
    """Integrate values (n + 1,) at the ends of n equal steps of size `step` by Simpson's rule.

    If n is odd, the last step is integrated by the parabola through the last three values. A single step is
    integrated by the trapezoidal rule.
    """
    n = len(values) - 1
    if n == 1:
        return 0.5 * step * float(values.sum())
    even_n = n - n % 2
    total = (values[0:even_n:2] + 4.0 * values[1:even_n:2] + values[2 : even_n + 1 : 2]).sum() / 3.0
    if even_n < n:
        total += values[-3:] @ np.array([-1.0, 8.0, 5.0]) / 12.0
    return step * float(total)
