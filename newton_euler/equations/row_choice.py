"""Choice of the constraint rows in use, for scenes with redundant constraints.

A constraint row is one scalar constraint equation, and its row of the constraint Jacobian J. If constraints
are redundant, the equations use an independent subset of the rows. In most mechanisms a row that is left out
is a combination of the rows in use with constant coefficients, called shares. In Bennett's linkage and
Bricard's mechanism the shares depend on the configuration. All rows together have the same rank everywhere,
but any fixed subset becomes dependent in some configuration. Near this configuration the shares grow without
bound.

Such rows are *exchangeable*. The compiled equations contain all exchangeable rows, each with a flag: 1 if the
row is left out, 0 if it is in use (`newton_euler.equations.sparse.RowsInUse`). Between two steps of a run, a
row that is left out is exchanged for a row in use whose share in it is larger than 1. Each exchange
multiplies the volume of the rows in use by the share, so that the exchanges end at a local maximum of the
volume (S. A. Goreinov, I. V. Oseledets, D. V. Savostyanov, E. E. Tyrtyshnikov, N. L. Zamarashkin, How to
find a good submatrix, in: Matrix Methods: Theory, Algorithms and Applications, World Scientific 2010). At a
state that satisfies the constraints, the accelerations do not depend on the choice. An exchange therefore
does not change the motion.

If all shares are small and a pivot of the elimination is small as well, all rows together lose rank: this is
a singular configuration (`newton_euler.integrators.singular`).

The equations of motion have two forms (`Formulation`). The joint-coordinate form has constraint rows only for
joints that close loops and for couplings such as gears. The Cartesian form has these rows, with other
numbers, and rows for all other joints.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from newton_euler.equations.formulation import Formulation
from newton_euler.equations.independence import shares
from newton_euler.equations.redundancy import mobility
from newton_euler.equations.row_shares import SHARE_ROUND_OFF, are_independent
from newton_euler.equations.sparse import Rows, RowsInUse, gram_factor
from newton_euler.equations.system import dimensionless_jacobian
from newton_euler.model.state import State
from newton_euler.scalars import Array

MIN_EXCHANGED_SHARE = 1.1
"""Share above which two rows are exchanged. Each exchange multiplies the volume of the rows in use by this
factor at least."""

MAX_EXCHANGES = 100
"""Largest number of exchanges at one state; only round-off or infinite numbers would cause more."""


class ExchangeableRows(NamedTuple):
    """Constraint rows that a run may exchange for each other.

    Attributes:
        numbers: row numbers in the residuals `phi`, ascending.
        left_out: flags before the first exchange: 1 for a row that is left out, 0 for a row in use.
        units: natural magnitudes of the dimensionless rows, the sizes of the motions that they compare
            (`newton_euler.equations.kinematics.TreeKinematics.row_scales`).
    """

    numbers: list[int]
    left_out: list[float]
    units: list[float]


NO_ROWS = ExchangeableRows([], [], [])
"""Record of a scene without exchangeable rows."""


def exchangeable_rows(system: Formulation) -> ExchangeableRows:
    """Return the exchangeable rows of a form of the equations, from the scene's mobility analysis."""
    # the analysis has row numbers of the joint-coordinate form (and a natural magnitude for each exchangeable
    # row); `closing_rows` translates them into row numbers of this form
    decided, numbers = mobility(system.scene), system.closing_rows()
    ordered = sorted((numbers[row], row) for row in decided.exchangeable)
    return ExchangeableRows(
        numbers=[number for number, _ in ordered],
        left_out=[float(row in decided.redundant) for _, row in ordered],
        units=[decided.exchangeable[row] for _, row in ordered],
    )


def candidate_rows(
    system: Formulation, used: Sequence[int] | None = None, exchangeable: ExchangeableRows = NO_ROWS
) -> tuple[list[int], list[int]]:
    """List the rows of the joint-coordinate form that are in use, and the exchangeable rows left out.

    See `rows_in_use` for the arguments.
    """
    used = mobility(system.scene).independent if used is None else list(used)
    flagged = set(exchangeable.numbers)
    numbered = enumerate(system.closing_rows())
    return used, [row for row, number in numbered if number in flagged and row not in used]


def rows_in_use(
    system: Formulation, used: Sequence[int] | None = None, exchangeable: ExchangeableRows = NO_ROWS
) -> RowsInUse:
    """Select independent constraint rows of a form of the equations, with reference magnitudes of the pivots.

    The reference magnitude of a pivot is its largest value at several states that are not singular. Much
    smaller pivots during a run show a singular configuration.

    Args:
        system: the form of the equations.
        used: row numbers of the joint-coordinate form to select; None for the independent rows of the
            scene's mobility analysis.
        exchangeable: rows to select in addition, with flags that leave out those not in `used`.
    """
    # pivots of the Schur complement J M^-1 J^T and of the mass matrix M at states that are not singular
    choices = list(regular_choices(system, used, exchangeable))
    pivots = []
    for state, rows in choices:
        q, _ = system.coordinates(state)
        solution = system.sparse_solution(q, np.zeros(system.nv), rows)
        pivots.append((in_use_alone(solution.pivots, rows), solution.mass_pivots))
    # largest value of each pivot
    scales, mass_scales = (
        [float(max(column)) for column in zip(*each, strict=True)] for each in zip(*pivots, strict=True)
    )
    flags = dict(zip(exchangeable.numbers, exchangeable.left_out, strict=True)) or None
    _, first_choice = choices[0]  # all choices have the same row numbers
    return RowsInUse(first_choice.numbers, scales, mass_scales, flags)


def constraint_scales(
    system: Formulation, used: Sequence[int] | None = None, exchangeable: ExchangeableRows = NO_ROWS
) -> list[float]:
    """Find the reference magnitudes of the pivots of the Gram matrix J J^T of dimensionless constraint rows.

    These pivots do not depend on masses. See `rows_in_use` for the arguments and for reference magnitudes.
    """
    pivots = []
    for state, rows in regular_choices(system, used, exchangeable):
        jacobian = system.phi_and_jacobian(system.coordinates(state)[0])[1]
        factor = gram_factor(dimensionless_rows(system, jacobian, rows.numbers), rows)
        pivots.append(in_use_alone(factor.pivots, rows))
    return [float(max(column)) for column in zip(*pivots, strict=True)]


def dimensionless_rows(system: Formulation, jacobian: Rows, numbers: Sequence[int]) -> Rows:
    """Select rows of a sparse constraint Jacobian by their numbers, in dimensionless form."""
    units = system.velocity_units
    return [{k: x * (units[k] / system.phi_units[i]) for k, x in jacobian[i].items()} for i in numbers]


def regular_choices(
    system: Formulation, used: Sequence[int] | None = None, exchangeable: ExchangeableRows = NO_ROWS
) -> Iterator[tuple[State, RowsInUse]]:
    """Yield states that are not singular with choices of independent rows; each row is in one of the choices.

    The states are those of the scene's mobility analysis. See `rows_in_use` for the arguments.
    """
    decided, flagged = mobility(system.scene), exchangeable.numbers
    used, others = candidate_rows(system, used, exchangeable)
    numbers = system.rows_of([*used, *others])
    for at, state in zip(decided.configurations, decided.states, strict=True):
        # in a singular configuration, such as a flat four-bar, pivots are zero or round-off
        if not are_independent(at.rows, used):
            continue
        # the rows in use; then, for each left-out row, the choice with this row in place of the row in use
        # that has the largest share in the left-out row
        choices = [used]
        for other, of_rows in zip(others, shares(at.rows, used, others), strict=True):
            replaced = max(of_rows, key=lambda row: abs(of_rows[row]), default=other)
            if abs(of_rows.get(replaced, 0.0)) > SHARE_ROUND_OFF:  # else the share is zero
                choices.append([other if row == replaced else row for row in used])
        for chosen in choices:
            in_use = set(system.rows_of(chosen))
            flags = {number: float(number not in in_use) for number in flagged}
            yield state, RowsInUse(numbers, flags=flags or None)


def in_use_alone(pivots: Sequence[float], rows: RowsInUse) -> list[float]:
    """Return the pivots of an elimination of `rows`, with 0 for rows that flags leave out."""
    flags = rows.flags or {}
    left_out = {n for n, number in enumerate(rows.numbers) if flags.get(number)}
    return [0.0 if n in left_out else pivot for n, pivot in enumerate(pivots)]


def flags_at(system: Formulation, q: Array, numbers: Sequence[int], exchangeable: ExchangeableRows) -> Array:
    """Choose the exchangeable rows in use at a configuration so that the rows in use are well-conditioned.

    Args:
        system: the form of the equations.
        q: (nq,) configuration.
        numbers: row numbers of all rows that are in use or exchangeable.
        exchangeable: the exchangeable rows.

    Returns:
        Flags (m,) of the exchangeable rows: 1 for a row that is left out, 0 for a row in use.
    """
    jacobian = dimensionless_jacobian(system, q)[list(numbers)]
    rows = [numbers.index(number) for number in exchangeable.numbers]
    return exchanged(jacobian, rows, np.array(exchangeable.units), np.array(exchangeable.left_out))


def exchanged(jacobian: Array, rows: Sequence[int], units: Array, left_out: Array) -> Array:
    """Exchange rows in use for those left out while a share is larger than `MIN_EXCHANGED_SHARE`.

    Args:
        jacobian: (k, nv) dimensionless rows, in use or left out.
        rows: (m,) indices of the exchangeable rows in `jacobian`.
        units: (m,) natural magnitudes of the exchangeable rows.
        left_out: (m,) flags: 1 for a row left out, 0 for a row in use.

    Returns:
        Flags (m,) after the exchanges.
    """
    flags, indices = left_out.copy(), np.array(rows)
    if not np.isfinite(jacobian).all():
        return flags
    # components of the exchangeable rows orthogonal to the rows that are always in use
    always = jacobian[np.delete(np.arange(len(jacobian)), indices)]
    complement = np.linalg.qr(always.T, mode="complete")[0][:, len(always) :]
    components = jacobian[indices] @ complement
    # exchange the pair of rows with the largest share, for rows divided by their natural magnitudes
    for _ in range(MAX_EXCHANGES):
        used, out = np.flatnonzero(flags == 0.0), np.flatnonzero(flags == 1.0)
        found = np.linalg.lstsq(components[used].T, components[out].T, rcond=None)[0]
        sizes = np.abs(found) * units[used][:, None] / units[out]
        row, other = np.unravel_index(np.argmax(sizes), sizes.shape)
        if not sizes[row, other] > MIN_EXCHANGED_SHARE:
            break
        flags[used[row]], flags[out[other]] = 1.0, 0.0
    return flags
