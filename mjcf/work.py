"""Work that is done on a mechanism during MuJoCo's steps, of the forces that the steps apply.

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

from collections.abc import Sequence

import mujoco
import numpy as np
from scipy.integrate import simpson

from mjcf.soft import SoftMuJoCo
from newton_euler.scalars import Array

RK4_WEIGHTS = np.array([1.0, 2.0, 2.0, 1.0]) / 6.0


def step(system: SoftMuJoCo, number: int, warnings: Sequence[object]) -> float:
    """Make a number of steps from the state that `data` holds; the work, J, of what has no potential.

    No more after a step of which MuJoCo has warned: it has started again from its initial state.
    """
    model, data = system.model, system.data
    integrator, size = mujoco.mjtIntegrator(model.opt.integrator), model.opt.timestep
    runge_kutta = integrator == mujoco.mjtIntegrator.mjINT_RK4
    powers, work = [system.power()] if runge_kutta else [], 0.0
    for _ in range(number):
        start = np.array(data.qvel)
        system.forget_stages()
        mujoco.mj_step(model, data)
        if warnings:
            return work
        mean = 0.5 * size * (start + data.qvel)
        if len(system.moved):
            multipliers = system.multipliers()
            weights = RK4_WEIGHTS if runge_kutta else np.ones(1)
            work += float(weights @ multipliers @ mean[system.moved])
        if runge_kutta:
            powers.append(system.power())
        else:
            work += float(_applied(system, integrator, start) @ mean)
    return work + (float(simpson(powers, dx=size)) if runge_kutta else 0.0)


def _applied(system: SoftMuJoCo, integrator: mujoco.mjtIntegrator, start: Array) -> Array:
    """(nv,) generalized forces of actuators and dampers in the step just made from velocities `start`."""
    model, data = system.model, system.data
    if integrator == mujoco.mjtIntegrator.mjINT_EULER:  # of which dampers at joints alone are implicit
        implicit = -model.dof_damping * (data.qvel - start)
        return np.asarray(data.qfrc_actuator + data.qfrc_damper + implicit)
    # positions are those that the step started from until the next one; velocities are new
    mujoco.mj_fwdVelocity(model, data)
    mujoco.mj_fwdActuation(model, data)
    return np.asarray(data.qfrc_actuator + data.qfrc_damper)
