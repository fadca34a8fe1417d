"""States of a file's own model, with its kinematics, constraints and forces there.

The one decision is which motions constraints leave free. Rows and velocities are made dimensionless with the
model's size. A motion is *free* where a singular value of the constraint Jacobian is round-off (`FREE`), and
*held* where it is beyond what the digits of a file leave open (`DOUBT`). In between it may be either, and a
scene passes whichever it says: bodies and forces are compared where nothing holds them, to the singular
value that is in doubt, accelerations along motions that are free for certain. What is free in the scene may
open the file's constraints by no more than what is in doubt.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from newton_euler.equations.dense import singular_values
from newton_euler.scalars import Array

if TYPE_CHECKING:
    from newton_euler.verification.original import Original

ROUND_OFF = 1e-12
"""Relative: some hundred operations in a row, each to 1e-16, on numbers that went through a compiler."""

LOOSEST = 1e-4
"""Tolerance beyond which a state says next to nothing."""

FREE = 1e-10
"""Largest singular value that is round-off, of a dimensionless Jacobian or as a share of its largest."""

DOUBT = 1e-3
"""Largest one that tilts and rounded points of a file may make of a redundant row, in whatever units of
length its rows are: ten times what a scene takes as redundant."""

STENCIL = ((1, 4.0 / 5.0), (2, -1.0 / 5.0), (3, 4.0 / 105.0), (4, -1.0 / 280.0))
STEPS = (2.5e-4, 1e-3)
"""s, of derivatives of J v along a motion by central differences of eighth order: off by 1e-13 relative to
what turns at 1 rad/s. Short rods turn faster; by how much the two steps differ is allowed for."""


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


KINDS = Forces._fields[:4]
"""Of forces that are compared apart, so that small ones do not drown."""


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


@dataclass(frozen=True, eq=False)
class Sample:
    """A state, and what the file's own model says there, each worked out when first asked for.

    Attributes:
        original: the model.
        q, v: configuration, and velocities (nv,), SI.
        opening: of the constraints there, in sizes or rad.
        freedom: motions that these do not hold.
    """

    original: Original
    q: Array
    v: Array
    opening: float
    freedom: Freedom

    @property
    def tolerance(self) -> float:
        """Relative, of forces and velocities there: round-off and what is open, times the condition."""
        return (ROUND_OFF + 10.0 * self.opening) * self.freedom.condition

    @property
    def tolerance_of_motion(self) -> float:
        """The same of motions, which are known to ten times the singular value that is in doubt.

        Each form of the equations omits another combination of the rows.
        """
        return self.tolerance + 10.0 * self.freedom.doubt * self.freedom.condition

    @property
    def tells(self) -> bool:
        """True if differences of more than `LOOSEST` show there."""
        return self.tolerance_of_motion <= LOOSEST

    @cached_property
    def kinematics(self) -> Kinematics:
        """Of the rigid groups."""
        return self.original.kinematics(self.q, self.v)

    @cached_property
    def constraints(self) -> Constraints:
        """At the configuration."""
        return self.original.constraints(self.q)

    @cached_property
    def mass_matrices(self) -> tuple[Array, Array]:
        """(nv, nv) of the bodies, and of the rotors."""
        return self.original.mass_matrix(self.q)

    @cached_property
    def forces(self) -> Forces:
        """Of everything but constraints."""
        return self.original.forces(self.q, self.v)

    @cached_property
    def energies(self) -> tuple[float, float]:
        """Kinetic and potential, J."""
        return self.original.energies(self.q, self.v)

    @cached_property
    def velocity_products(self) -> tuple[Array, Array]:
        """(k,) dJ/dt v of the constraints along the motion of constant velocities, at both `STEPS`."""
        found = []
        for step in STEPS:
            total = np.zeros(len(self.constraints.residual))
            for number, weight in STENCIL:
                for sign in (1.0, -1.0):
                    q = self.original.moved(self.q, sign * number * step * self.v)
                    rate = self.original.constraints(q).jacobian @ (self.v / self.original.units)
                    total += sign * weight / step * rate
            found.append(total)
        return found[0], found[1]


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
