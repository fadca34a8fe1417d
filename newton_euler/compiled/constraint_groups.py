"""Groups of coordinates and velocities that constraints connect: one group per loop or set of coupled loops.

Projection returns a state to the constraints after an integration step. The integrator projects each group of
coordinates separately. Coordinates without constraints, such as those of a rotor next to a linkage, belong to
no group; projection never changes them. Input is a system of equations; output is a group number per
coordinate and velocity.
"""

from __future__ import annotations

import numpy as np

from newton_euler.equations.system import System
from newton_euler.model.state import State
from newton_euler.scalars import Array


@np.errstate(all="ignore")  # quotients of displacements may be 0 / 0
def constraint_groups(system: System) -> Array:
    """Number the groups of coordinates and velocities that constraints connect.

    Returns:
        (nq + nv,) group numbers from 1 of the elements of q and v; 0 for an element without constraints.
    """
    # groups of velocities: nonzeros of the constraint Jacobian in a random configuration, in which no
    # element vanishes because axes are aligned. Steps are random numbers times `velocity_units`: the
    # mechanism's size, m, for linear velocities, else 1
    rng, units = np.random.default_rng(0), system.velocity_units
    q, _v = system.coordinates(State.initial(system.mechanism))
    q = system.retract(q, units * rng.uniform(-0.3, 0.3, system.nv))
    groups_of_v = connected(system.phi_jacobian(q) != 0.0)
    # groups of coordinates: move along a small step, then along the same step times the group number of each
    # velocity. The ratio of the two displacements of a coordinate is the number of its group, because
    # constraints connect all velocities that move the coordinate. Only an angle of a loop-closing joint may
    # also move with a velocity without constraints; `clip` then keeps the number in the range of the groups
    shift = 1e-6  # small, so that displacements are proportional to the step
    step = shift * units * rng.uniform(0.5, 1.5, system.nv)
    plain, multiplied = (system.retract(q, factor * step) - q for factor in (np.ones(system.nv), groups_of_v))
    # smaller displacements are round-off, or of higher order in the step
    moves = np.abs(plain) > 1e-3 * shift * units.min(initial=1.0)
    numbers = np.clip(np.rint(multiplied / plain), 0.0, groups_of_v.max(initial=0.0))
    groups_of_q = np.where(moves, numbers, 0.0)
    # the four elements of a quaternion have one group, also an element that does not move here and has 0
    for quaternion in system.quaternions:
        groups_of_q[quaternion] = groups_of_q[quaternion].max()
    return np.concatenate([groups_of_q, groups_of_v])


def connected(nonzero: Array) -> Array:
    """Number the connected components of columns of a boolean matrix; a row connects the columns it marks.

    Args:
        nonzero: (k, n) matrix.

    Returns:
        (n,) component numbers from 1; 0 for a column without a True element.
    """
    labels = np.where(nonzero.any(axis=0), np.arange(1, nonzero.shape[1] + 1), 0)
    for row in nonzero[nonzero.any(axis=1)]:
        merged = np.unique(labels[row])
        labels[np.isin(labels, merged)] = merged[0]
    # renumber the remaining labels 0, 1, 2, ...; the appended 0 makes sure that 0 stays 0
    return np.unique(np.append(labels, 0), return_inverse=True)[1][:-1].astype(float)


def group_places(groups: Array, nq: int) -> Array:
    """List the indices of the members of each group in a state (q, v), in a format for native code.

    Args:
        groups: (nq + nv,) group numbers of `constraint_groups`.
        nq: number of coordinates.

    Returns:
        For each group: number of coordinates, their indices, number of velocities, their indices. All are
        floats, which native code reads.
    """
    places: list[float] = []
    for group in np.unique(groups[groups > 0.0]):
        members = np.flatnonzero(groups == group)
        for part in (members[members < nq], members[members >= nq]):
            places += [float(len(part)), *part.astype(float)]
    return np.array(places)
