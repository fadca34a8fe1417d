"""Quantities of a reference model at one state: motion of bodies, forces, and free motions.

A reference model is a model file as an independent parser compiles it; an imported scene is compared with
these quantities. The comparison at a state needs one decision: which motions the constraints leave free.
Constraint rows and velocities are made dimensionless with the size of the model. Each singular value of the
constraint Jacobian belongs to a motion, its right singular vector. A motion is *free* if its singular value
is round-off (`FREE_SINGULAR_VALUE`). A motion is *held* if its singular value exceeds the effect of rounded
digits in a file (`HELD_SINGULAR_VALUE`). A motion with a singular value in between is
*in doubt*: it may be free or held, and a scene passes the checks in both cases:

- bodies and forces are compared along all motions that are not held; the tolerance includes the largest
  singular value in doubt;
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
"""Largest singular value that is round-off, divided by the largest singular value or by 1 if that is more."""

HELD_SINGULAR_VALUE = 1e-3
"""Largest singular value of a motion that is not held, divided by the largest one or by 1 if that is more.

An exactly redundant constraint holds no further motion: its singular value is zero. Rounded points and axes
of a file make this value a small number, in rows as scenes scale them up to `REDUNDANCY_TOLERANCE` (1e-4) of
`newton_euler.model.scene`. The factor of ten is a margin for the other scaling of the rows here."""


class Constraints(NamedTuple):
    """The k constraint rows of a model with nv velocities; lengths are divided by the size of the model."""

    residual: Array
    """(k,) constraint errors."""
    jacobian: Array
    """(k, nv) derivatives of the residuals with respect to dimensionless velocities."""
    owners: Sequence[str]
    """(k,) the element of each row, as reports name it."""


class Kinematics(NamedTuple):
    """Motion of b rigid groups of the file's links at a state; world frame, SI.

    A rigid group is a set of links that fixed joints hold together: a body of the scene, or one half of a
    body that the file cuts to open a loop.
    """

    position: Array
    """(b, 3) centers of mass."""
    rotation: Array
    """(b, 3, 3) rotation matrices from group frames to the world frame."""
    transformation: Array
    """(b, 6, nv) Jacobian of linear and angular velocities with respect to the velocities of the model."""
    drift: Array
    """(b, 6) linear and angular accelerations at zero accelerations of the coordinates."""


class MassMatrices(NamedTuple):
    """Mass matrices (nv, nv) in the velocities of a model, SI; the complete mass matrix is their sum."""

    bodies: Array
    armatures: Array
    """Mass matrix of the rotor inertias of motors."""


class Forces(NamedTuple):
    """Generalized forces (nv,) by kind, without constraint forces; N at slides, N m at hinges and balls."""

    gravity: Array
    springs: Array
    """Springs of hinges and slides, of ball joints and of tendons."""
    dampers: Array
    actuators: Array
    """Actuators and all other forces, such as gravity compensation."""
    friction_and_stops: Array
    """Dry friction and limits that the scene has as regularized friction and as stops."""
    bias: Array
    """Velocity-dependent inertia terms, on the left side of the equations of motion."""


FORCE_KINDS = Forces._fields[:5]
"""Kinds of forces (all but the bias) that are compared separately, so that errors of small forces show."""


class ForceLimit(NamedTuple):
    """Limit of a force, such as an actuator's range, that scenes do not simulate.

    After a run of the scene, the force is computed again to find out whether the limit would have acted.
    """

    element: str
    """Element of the file with the limit."""
    watched: Bounds
    """The limit as the scene's reader imported it, to be compared with the three fields below. It has a lower
    and an upper limit, and the force as a constant (which contains the controls of the actuators) plus gains
    times a weighted sum of joint coordinates and its rate."""
    force: float
    """Force that the reference model would have without the limit, N or N m."""
    low: float
    """Lower limit in the file, N or N m."""
    high: float
    """Upper limit in the file, N or N m."""


class Freedom(NamedTuple):
    """Motions that the constraints of a file leave free at a configuration, see the text of the module."""

    basis: Array
    """(nv, d) basis of the velocities that are not held, SI. Its rows `independent` are the identity, so that
    d independent velocities determine all."""
    independent: Array
    """(d,) indices of the independent velocities among the nv velocities."""
    certain_basis: Array
    """(d, c) basis of the motions that are certainly free, in the independent velocities."""
    condition: float
    """Condition number of the constraint Jacobian without motions that are free or in doubt."""
    doubtful_value: float
    """Largest singular value of a motion that is not held, divided by the largest singular value or by 1 if
    that is more; 0 or round-off if no motion is in doubt."""


def freedom(jacobian: Array, units: Array) -> Freedom:
    """Find the motions that constraints do not hold, from the singular value decomposition of their Jacobian.

    Args:
        jacobian: (k, nv) derivatives of constraint rows with respect to dimensionless velocities.
        units: (nv,) units of the velocities: the size of the model, m, or 1 for angles.
    """
    count = len(units)
    if not jacobian.size:
        return Freedom(
            np.eye(count), np.arange(count), certain_basis=np.eye(count), condition=1.0, doubtful_value=0.0
        )
    _, s, vt = singular_values(jacobian, full=True)
    s = s / max(1.0, float(s[0]))
    # singular values descend: held motions first, then motions in doubt, then free motions
    held, not_free = int(np.sum(s > HELD_SINGULAR_VALUE)), int(np.sum(s > FREE_SINGULAR_VALUE))
    condition = float(s[0] / s[held - 1]) if held else 1.0
    basis, chosen = _with_identity_rows(vt[held:].T)
    certain_basis = units[chosen, None] * vt[not_free:].T[chosen]
    basis = basis * units[:, None] / units[chosen]
    return Freedom(
        basis, chosen, certain_basis, condition, doubtful_value=float(np.max(s[held:], initial=0.0))
    )


def _with_identity_rows(null: Array) -> tuple[Array, Array]:
    """Return a basis of a column space with the identity in d of its rows, and the numbers of these rows.

    The rows are chosen by pivoting: each has the largest norm of the part that the rows before it do not
    span. Because of the identity, loops that share no joint have separate columns.

    Args:
        null: (nv, d) orthonormal columns.
    """
    remaining, rows = null.copy(), []
    for _ in range(null.shape[1]):
        row = int(np.argmax(np.einsum("ij,ij->i", remaining, remaining)))
        along = remaining[row] / np.linalg.norm(remaining[row])
        remaining -= np.outer(remaining @ along, along)
        rows.append(row)
    chosen = np.array(sorted(rows), dtype=int)
    return null @ np.linalg.inv(null[chosen]) if rows else null, chosen
