"""Groups of coordinates and velocities that constraints connect: each loop, or each set of coupled loops.

Projection changes the coordinates and velocities of one group without those of another, and leaves alone what
no constraint touches: a rotor or a cart beside a linkage.
"""

from __future__ import annotations

import numpy as np

from newton_euler.equations.system import System
from newton_euler.model.state import State
from newton_euler.scalars import Array

TURN = 0.3
"""Dimensionless size of a random step to a configuration in which no elements vanish by alignment."""

SHIFT = 1e-6
"""Dimensionless size of a step that shows which coordinates move with which velocities."""


@np.errstate(all="ignore")
def constraint_groups(system: System) -> Array:
    """Number the groups of q and v (nq + nv,) that constraints connect, from 1; 0 for what none touches.

    The numbers come from the nonzeros of the constraint Jacobian in one configuration.
    """
    rng, units = np.random.default_rng(0), system.velocity_units
    q = system.coordinates(State.initial(system.mechanism))[0]
    q = system.retract(q, units * rng.uniform(-TURN, TURN, system.nv))
    of_v = connected(system.phi_jacobian(q) != 0.0)
    # each coordinate moves by the number of its group times what it moves if all groups move alike
    step, at = SHIFT * units * rng.uniform(0.5, 1.5, system.nv), system.retract(q, np.zeros(system.nv))
    alike, numbered = (system.retract(q, factor * step) - at for factor in (np.ones(system.nv), of_v))
    moves = np.abs(alike) > 1e-3 * SHIFT * units.min(initial=1.0)
    of_q = np.where(moves, np.clip(np.rint(numbered / alike), 0.0, of_v.max(initial=0.0)), 0.0)
    for place in system.quaternions:
        of_q[place] = of_q[place].max()
    return np.concatenate([of_q, of_v])


def connected(nonzero: Array) -> Array:
    """Number the columns (n,) that rows of a matrix of booleans (k, n) connect, from 1; 0 for empty ones."""
    labels = np.where(nonzero.any(axis=0), np.arange(1, nonzero.shape[1] + 1), 0)
    for row in nonzero[nonzero.any(axis=1)]:
        met = np.unique(labels[row])
        labels[np.isin(labels, met)] = met[0]
    return np.unique(np.append(labels, 0), return_inverse=True)[1][:-1].astype(float)


def group_places(groups: Array, nq: int) -> Array:
    """List the places in a state (q, v) of the members of each group, for native code.

    Each group is written as: number of coordinates, their places, number of velocities, their places.
    """
    found: list[float] = []
    for group in np.unique(groups[groups > 0.0]):
        members = np.flatnonzero(groups == group)
        for part in (members[members < nq], members[members >= nq]):
            found += [float(len(part)), *part.astype(float)]
    return np.array(found)
