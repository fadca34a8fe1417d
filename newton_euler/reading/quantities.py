"""Quantities of a model file's own model at a state: motion of bodies, forces, and motions left free.

Of a state at which the two are compared the one decision is which motions constraints leave free. Rows and
velocities are made dimensionless with the model's size. A motion is *free* where a singular value of the
constraint Jacobian is round-off (`FREE`), and *held* where it is beyond what the digits of a file leave open
(`DOUBT`). In between it may be either, and a scene passes whichever it says: bodies and forces are compared
where nothing holds them, to the singular value that is in doubt, accelerations along motions that are free
for certain. What is free in the scene may open the file's constraints by no more than what is in doubt.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from newton_euler.equations.dense import singular_values
from newton_euler.reading.activity import Bounds
from newton_euler.scalars import Array

FREE = 1e-10  # largest singular value that is round-off, or as a share of the largest one

DOUBT = 1e-3
"""Largest one that tilts and rounded points of a file may make of a redundant row, in whatever units of
length its rows are: ten times what a scene takes as redundant."""


class Constraints(NamedTuple):
    """Rows of constraints, made dimensionless with the model's size."""

    residual: Array
    """(k,)"""
    jacobian: Array
    """(k, nv) for dimensionless velocities."""
    owners: Sequence[str]
    """Element, as reports name it, that each row belongs to."""


class Kinematics(NamedTuple):
    """Rigid groups of bodies at a state; world frame, SI."""

    position: Array
    """(b, 3) centers of mass."""
    rotation: Array
    """(b, 3, 3) to world."""
    transformation: Array
    """(b, 6, nv): linear and angular velocity for each velocity."""
    drift: Array
    """(b, 6) accelerations where those of the coordinates are zero."""


class Forces(NamedTuple):
    """Generalized forces (nv,) of everything but constraints."""

    gravity: Array
    springs: Array
    """Of joints, balls and tendons."""
    dampers: Array
    actuators: Array
    """And all that is not among the others, such as gravity compensation."""
    bias: Array
    """Of inertia in motion, to be moved to the other side of the equations."""


KINDS = Forces._fields[:4]  # of forces that are compared apart, so that small ones do not drown


class ForceLimit(NamedTuple):
    """A limit of a force that a scene is without, watched in its runs."""

    element: str
    watched: Bounds
    """The force and the limit as the reading has them."""
    force: float
    """Without the limit, by the file's own model, N or N m."""
    low: float
    high: float
    """By the file."""


class Freedom(NamedTuple):
    """Motions that constraints leave free at a configuration."""

    basis: Array
    """(nv, d) of velocities that are not held, SI, the identity in `rows`."""
    rows: Array
    """(d,) velocities that tell all others."""
    certain: Array
    """(d, c) of those, the ones that are free."""
    condition: float
    """Of the rows that hold."""
    doubt: float
    """Largest singular value of those that do not, which may be a constraint's all the same."""


def freedom(jacobian: Array, units: Array) -> Freedom:
    """Find the motions that constraints do not hold.

    Args:
        jacobian: (k, nv) for dimensionless velocities.
        units: (nv,) of velocities.
    """
    count = len(units)
    if not jacobian.size:
        return Freedom(np.eye(count), np.arange(count), np.eye(count), 1.0, 0.0)
    _, s, vt = singular_values(jacobian, full=True)
    s = s / max(1.0, float(s[0]))
    held, unsure = int(np.sum(s > DOUBT)), int(np.sum(s > FREE))
    condition = float(s[0] / s[held - 1]) if held else 1.0
    basis, chosen = _localized(vt[held:].T)
    certain = vt[unsure:].T[chosen] / units[chosen, None]
    basis = basis * units[:, None] / units[chosen]
    return Freedom(basis, chosen, certain, condition, float(np.max(s[held:], initial=0.0)))


def _localized(null: Array) -> tuple[Array, Array]:
    """The same space with the identity in as many rows, and those rows; independent loops stay apart."""
    left, rows = null.copy(), []
    for _ in range(null.shape[1]):
        row = int(np.argmax(np.einsum("ij,ij->i", left, left)))
        along = left[row] / np.linalg.norm(left[row])
        left -= np.outer(left @ along, along)
        rows.append(row)
    chosen = np.array(sorted(rows), dtype=int)
    return null @ np.linalg.inv(null[chosen]) if rows else null, chosen
