"""Quantities of a reference model at one state: motion of bodies, forces, and free motions.

The only decision at a state is which motions the constraints leave free. Rows and velocities are made
dimensionless with the size of the model. A motion is *free* if its singular value of the constraint Jacobian
is round-off (`FREE_SINGULAR_VALUE`). A motion is *held* if its singular value exceeds the rounding of the
digits of a file (`HELD_SINGULAR_VALUE`). In between, the motion may be either, and a scene passes both ways:

- bodies and forces are compared along all motions that are not held, to the singular value in doubt;
- accelerations are compared along motions that are certainly free;
- motions that the scene leaves free may violate the constraints of the file by the singular value in doubt.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from newton_euler.equations.dense import singular_values
from newton_euler.reading.activity import Bounds
from newton_euler.scalars import Array

FREE_SINGULAR_VALUE = 1e-10
"""Largest singular value that is round-off, relative to 1 or to the largest singular value."""

HELD_SINGULAR_VALUE = 1e-3
"""Largest singular value of a redundant row with rounded points and axes in the file.

The value is ten times the limit below which scenes treat rows as redundant."""


class Constraints(NamedTuple):
    """Constraint rows, dimensionless with the size of the model."""

    residual: Array
    """(k,) constraint errors."""
    jacobian: Array
    """(k, nv) derivatives by dimensionless velocities."""
    owners: Sequence[str]
    """(k,) the element of each row, as reports name it."""


class Kinematics(NamedTuple):
    """Motion of rigid groups of bodies at a state; world frame, SI."""

    position: Array
    """(b, 3) centers of mass."""
    rotation: Array
    """(b, 3, 3) rotations to the world frame."""
    transformation: Array
    """(b, 6, nv) linear and angular velocities per velocity of the model."""
    drift: Array
    """(b, 6) accelerations for zero accelerations of the coordinates."""


class Forces(NamedTuple):
    """Generalized forces (nv,) without constraint forces."""

    gravity: Array
    springs: Array
    """Springs of joints, balls and tendons."""
    dampers: Array
    actuators: Array
    """Actuators and all other forces, such as gravity compensation."""
    bias: Array
    """Velocity-dependent inertia terms, on the left side of the equations of motion."""


FORCE_KINDS = Forces._fields[:4]
"""Kinds of forces that are compared separately, so that errors of small forces show."""


class ForceLimit(NamedTuple):
    """Limit of a force that scenes do not simulate and runs are watched for."""

    element: str
    watched: Bounds
    """Force and limit as the reader imported them."""
    force: float
    """Force without the limit by the reference model, N or N m."""
    low: float
    high: float
    """Upper limit in the file; `low` is the lower limit."""


class Freedom(NamedTuple):
    """Free motions at a configuration."""

    basis: Array
    """(nv, d) basis of the velocities that are not held, SI; the identity in `rows`."""
    rows: Array
    """(d,) numbers of independent velocities."""
    certain: Array
    """(d, c) basis of the motions that are certainly free, in the independent velocities."""
    condition: float
    """Condition number of the rows that certainly hold."""
    doubt: float
    """Largest singular value of the other rows, which may belong to a constraint."""


def freedom(jacobian: Array, units: Array) -> Freedom:
    """Find the motions that constraints do not hold.

    Args:
        jacobian: (k, nv) derivatives of constraint rows by dimensionless velocities.
        units: (nv,) units of the velocities: the size of the model, or 1 for angles.
    """
    count = len(units)
    if not jacobian.size:
        return Freedom(np.eye(count), np.arange(count), np.eye(count), 1.0, 0.0)
    _, s, vt = singular_values(jacobian, full=True)
    s = s / max(1.0, float(s[0]))
    held, unsure = int(np.sum(s > HELD_SINGULAR_VALUE)), int(np.sum(s > FREE_SINGULAR_VALUE))
    condition = float(s[0] / s[held - 1]) if held else 1.0
    basis, chosen = _localized(vt[held:].T)
    certain = vt[unsure:].T[chosen] / units[chosen, None]
    basis = basis * units[:, None] / units[chosen]
    return Freedom(basis, chosen, certain, condition, float(np.max(s[held:], initial=0.0)))


def _localized(null: Array) -> tuple[Array, Array]:
    """Return a basis of the same space with the identity in some rows, and these rows.

    The rows are chosen by pivoting, so that independent loops have separate columns.
    """
    left, rows = null.copy(), []
    for _ in range(null.shape[1]):
        row = int(np.argmax(np.einsum("ij,ij->i", left, left)))
        along = left[row] / np.linalg.norm(left[row])
        left -= np.outer(left @ along, along)
        rows.append(row)
    chosen = np.array(sorted(rows), dtype=int)
    return null @ np.linalg.inv(null[chosen]) if rows else null, chosen
