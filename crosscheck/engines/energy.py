"""Energy balance of a run, and lower bound of the energy scale by which comparisons divide differences."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from newton_euler.equations.applied_forces import energies
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

RANDOM_RATE = 1.0
"""Order of magnitude of velocities in the random states at which engines are compared, 1/s.

It stands for 1 rad/s and one mechanism size per second."""


class Balance(NamedTuple):
    """Energy balance of a run.

    Attributes:
        residual: (n,) change of the energy since the start, minus the work done on the mechanism, J, at n
            output times.
        scale: energy scale of the run, J, by which comparisons divide its energy errors: the largest change
            of the energy plus the largest kinetic energy.
    """

    residual: Array
    scale: float


def min_energy_scale(scene: Scene, states: list[State]) -> float:
    """Return the smallest energy, J, by which comparisons of engines divide differences of energies.

    It is used if the energy scale of the run (`Balance.scale`) is smaller, as in a run near rest. The result
    is the largest of three: the kinetic energy at the given states, the mechanism's weight times its size,
    and the kinetic energy (times two) of the mechanism's mass at one size per second.

    Args:
        scene: the scene.
        states: states at which engines are compared: the initial state and random ones.
    """
    size = scene.mechanism.size
    mass = sum(body.mass for body in scene.mechanism.bodies[1:])  # without the ground
    inertias = [body.inertia for body in scene.mechanism.bodies]
    kinetic_and_potential = [energies(scene, state.frames(), inertias) for state in states]
    kinetic = max(kinetic for kinetic, _ in kinetic_and_potential)
    weight = mass * float(np.linalg.norm(scene.gravity))
    return max(kinetic, weight * size, mass * (size * RANDOM_RATE) ** 2)


def energy_change(run: Trajectory) -> Array:
    """Return the change (n,) of the kinetic and potential energy of a run since its start, J."""
    assert run.kinetic_energy is not None
    assert run.potential_energy is not None
    energy = run.kinetic_energy + run.potential_energy
    return np.asarray(energy - energy[0])


def energy_balance(scene: Scene, run: Trajectory) -> Balance | None:
    """Compute the energy balance of a run: the change of its energy minus the work done on it.

    The work of forces without potential energy is integrated by the engine (`Trajectory.work`).

    Returns:
        The balance; None if the run does not contain energies, or if it does not contain the work although
        elements of the scene may do work.
    """
    if run.kinetic_energy is None or run.potential_energy is None:
        return None
    if scene.tracks_work and run.work is None:
        return None
    change = energy_change(run)
    scale = float(np.max(np.abs(change)) + np.max(run.kinetic_energy))
    return Balance(change if run.work is None else change - run.work, scale)
