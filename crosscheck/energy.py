"""The energy balance of a run, and how well its output times resolve it."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from newton_euler.scalars import Array
from newton_euler.scene import Scene
from newton_euler.state import State, energies
from newton_euler.trajectory import Trajectory

RANDOM_RATE = 1.0
"""1/s: speeds of `random_states` are of the order of 1 rad/s and one size of the mechanism a second."""

COARSE_SHARE = 0.1
"""How much of the difference that every other output makes to the work is taken for its error. Twice
the points gained a factor of 10 or more wherever the difference was below 1 % (a spline of degree 7
can gain 256) and nothing jumped, for damping of 0.1 to 1000 times that of the tracker and of a spatial
four-bar."""

JUMP_SHARE = 6.0
"""Energy that jumps between two outputs shows as a fifth of the jump, at least, where a spline of
degree 7 through every other output misses the outputs in between."""


class Balance(NamedTuple):
    """Energy less its start less the actuators' work, and what of it may be the quadrature's."""

    residual: Array
    """(n,) J."""
    quadrature: float
    """Estimated error of the work, J; infinite where there are too few outputs to tell."""
    exchanged: float
    """The largest change of the energy and the largest kinetic energy together, J."""


def energy_scale(scene: Scene, states: list[State]) -> float:
    """The energy, J, that differences are relative to at least: none is worth more than round-off.

    The largest of the kinetic energy at the given states, of the mechanism's weight lifted by its
    size, and of its mass at `RANDOM_RATE`.
    """
    size = scene.mechanism.size
    mass = sum(body.mass for body in scene.mechanism.bodies[1:])
    inertias = [body.inertia for body in scene.mechanism.bodies]
    kinetic = max(energies(scene, state.frames(), inertias)[0] for state in states)
    weight = mass * float(np.linalg.norm(scene.gravity))
    return max(kinetic, weight * size, mass * (size * RANDOM_RATE) ** 2)


def actuated_rates(scene: Scene, run: Trajectory) -> Array:
    """(n, a) rates of the actuated coordinates, m/s or rad/s, from body velocities."""
    assert run.linear_velocity is not None
    assert run.angular_velocity is not None
    rates = np.zeros((len(run.time), len(scene.control)))
    for n in range(len(run.time)):
        frames = State(
            run.position[n], run.quaternion[n], run.linear_velocity[n], run.angular_velocity[n]
        ).frames()
        for k, law in enumerate(scene.control):
            equations = scene.mechanism.equations[scene.mechanism.joint_index(law.joint)]
            first, second = frames[equations.first], frames[equations.second]
            coordinate = equations.coordinates[law.coordinate]
            rates[n, k] = coordinate.jacobian(first, second).rate(first, second)[0]
    return rates


def energy_balance(scene: Scene, run: Trajectory) -> Balance | None:
    """Whether the energy of a run changes by the work of its actuators.

    The work is the integral of actuator power, by a spline of degree 7 through the output times. Its
    error is estimated from every other output: `COARSE_SHARE` of what they make of the work, and
    `JUMP_SHARE` of how far they miss the residual in between, because what a transient shorter than
    an output period takes or gives shows in no power but as a jump of the residual. A leak shows as
    neither. None if the run holds no energies, velocities or actuator forces, and for sampled
    controllers, whose forces jump where no output may be.
    """
    if (
        scene.sampled
        or run.kinetic_energy is None
        or run.potential_energy is None
        or run.actuator_force is None
        or run.linear_velocity is None
    ):
        return None
    energy = run.kinetic_energy + run.potential_energy
    residual = energy - energy[0]
    exchanged = float(np.max(np.abs(residual)) + np.max(run.kinetic_energy))
    if not scene.control:
        return Balance(residual, 0.0, exchanged)
    power = np.sum(run.actuator_force * actuated_rates(scene, run), axis=1)
    if not np.all(np.isfinite(power + energy)):
        return Balance(np.full_like(energy, np.nan), 0.0, exchanged)
    work = _spline(run.time, power).antiderivative()(run.time)
    residual = residual - work
    if len(run.time) < 3:
        return Balance(residual, np.inf, exchanged)
    covered = run.time[: len(run.time) - 1 + len(run.time) % 2]  # the last output may be left over
    coarse_work = _spline(run.time[::2], power[::2]).antiderivative()(covered)
    coarse_residual = _spline(run.time[::2], residual[::2])(covered)
    quadrature = max(
        COARSE_SHARE * np.max(np.abs(work[: len(covered)] - coarse_work)),
        JUMP_SHARE * np.max(np.abs(residual[: len(covered)] - coarse_residual)),
    )
    return Balance(residual, float(quadrature), exchanged)


def _spline(time: Array, values: Array) -> Any:
    """The interpolating spline of degree 7, or the odd degree that the points are enough for."""
    from scipy.interpolate import make_interp_spline

    return make_interp_spline(time, values, k=min(7, len(time) - 1 - len(time) % 2))
