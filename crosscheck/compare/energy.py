"""The energy balance of a run, and what energies are compared with."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from newton_euler.equations.applied_forces import energies
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

RANDOM_RATE = 1.0
"""1/s: speeds of `random_states` are of the order of 1 rad/s and one size of the mechanism a second."""


class Balance(NamedTuple):
    """Energy less its start less the work that was done on the mechanism."""

    residual: Array
    """(n,) J."""
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


def energy_balance(scene: Scene, run: Trajectory) -> Balance | None:
    """Compute the energy balance error of a run: the change of its energy less the work done on it.

    The work is what the engine integrated beside the motion, `Trajectory.work`. None if the run holds
    no energies, or no work where the scene has something that may do work.
    """
    if run.kinetic_energy is None or run.potential_energy is None:
        return None
    if scene.tracks_work and run.work is None:
        return None
    change = run.kinetic_energy + run.potential_energy
    change = change - change[0]
    exchanged = float(np.max(np.abs(change)) + np.max(run.kinetic_energy))
    return Balance(change if run.work is None else change - run.work, exchanged)
