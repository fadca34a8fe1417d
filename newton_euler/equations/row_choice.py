"""Constraint rows in use: the choice for a scene, and exchangeable rows among which a run chooses.

If constraints are redundant, some rows imply all others. In most mechanisms a row left out is a combination
of rows in use with constant coefficients (shares). In Bennett's linkage or Bricard's mechanism the shares
depend on the configuration. The loop has the same rank everywhere, but any choice of rows becomes dependent
in some configuration, and shares grow without bound near this configuration.

Such rows are *exchangeable*. The compiled equations contain all of them, each with a flag that leaves it out
(`newton_euler.equations.sparse.RowsInUse`). Between two steps of a run, a row in use is exchanged for a row
left out while its share in that row is larger than 1. Each exchange multiplies the volume of the rows
in use by the share, so the exchanges end at a local maximum of the volume (S. A. Goreinov, I. V. Oseledets,
D. V. Savostyanov, E. E. Tyrtyshnikov, N. L. Zamarashkin, How to find a good submatrix, in: Matrix Methods:
Theory, Algorithms and Applications, World Scientific 2010). The accelerations of a state that meets the
constraints are the same with any choice, so a run keeps its steps.

A small pivot in spite of small shares is a loss of rank of all rows: a singular configuration
(`newton_euler.integrators.singular`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from newton_euler.equations.formulation import Formulation
from newton_euler.equations.independence import shares
from newton_euler.equations.redundancy import mobility
from newton_euler.equations.row_shares import MAX_SHARE_CHANGE, are_independent
from newton_euler.equations.sparse import Rows, RowsInUse, gram_factor
from newton_euler.equations.system import dimensionless_jacobian
from newton_euler.model.state import State
from newton_euler.scalars import Array

MIN_EXCHANGED_SHARE = 1.1
"""Share above which rows are exchanged. Each exchange multiplies the volume by at least this factor."""

MAX_EXCHANGES = 100
"""Number of exchanges at one state. More are caused by round-off or numbers that are not finite."""


class ExchangeableRows(NamedTuple):
    """Constraint rows among which a run chooses.

    Attributes:
        numbers: numbers of the rows in `phi`, ascending.
        left_out: 1 for rows that are left out at first, 0 for rows in use.
        units: natural magnitudes of the dimensionless rows.
    """

    numbers: list[int]
    left_out: list[float]
    units: list[float]


NO_ROWS = ExchangeableRows([], [], [])


def exchangeable_rows(system: Formulation) -> ExchangeableRows:
    """Return the exchangeable rows of a form of the equations, as decided once for the scene."""
    decided, places = mobility(system.scene), system.closing_rows()
    ordered = sorted((places[row], row) for row in decided.exchangeable)
    return ExchangeableRows(
        [number for number, _ in ordered],
        [float(row in decided.redundant) for _, row in ordered],
        [decided.exchangeable[row] for _, row in ordered],
    )


def candidate_rows(
    system: Formulation, used: Sequence[int] | None = None, exchangeable: ExchangeableRows = NO_ROWS
) -> tuple[list[int], list[int]]:
    """Return the rows of the joint-coordinate form in use, and the others that are exchangeable.

    See `rows_in_use` for the arguments.
    """
    used = mobility(system.scene).independent if used is None else list(used)
    flagged = set(exchangeable.numbers)
    places = enumerate(system.closing_rows())
    return used, [row for row, number in places if number in flagged and row not in used]


def rows_in_use(
    system: Formulation, used: Sequence[int] | None = None, exchangeable: ExchangeableRows = NO_ROWS
) -> RowsInUse:
    """Select rows of a form of the equations that are independent and imply all others.

    Args:
        system: the form of the equations.
        used: rows of the joint-coordinate form to select; None for the independent rows of its mobility.
        exchangeable: rows to select in addition, with flags that leave them out.
    """
    choices = list(regular_choices(system, used, exchangeable))
    pivots = []
    for state, rows in choices:
        q, _ = system.coordinates(state)
        solution = system.sparse_solution(q, np.zeros(system.nv), rows)
        pivots.append((in_use_alone(solution.pivots, rows), solution.mass_pivots))
    scales, mass_scales = (
        [float(max(column)) for column in zip(*each, strict=True)] for each in zip(*pivots, strict=True)
    )
    flags = dict(zip(*exchangeable[:2], strict=True)) or None
    return RowsInUse(choices[0][1].numbers, scales, mass_scales, flags)


def constraint_scales(
    system: Formulation, used: Sequence[int] | None = None, exchangeable: ExchangeableRows = NO_ROWS
) -> list[float]:
    """Find the usual sizes of the pivots of the constraints alone, of the Gram matrix of their rows.

    See `rows_in_use` for the arguments.
    """
    pivots = []
    for state, rows in regular_choices(system, used, exchangeable):
        jacobian = system.phi_and_jacobian(system.coordinates(state)[0])[1]
        factor = gram_factor(dimensionless_rows(system, jacobian, rows.numbers), rows)
        pivots.append(in_use_alone(factor.pivots, rows))
    return [float(max(column)) for column in zip(*pivots, strict=True)]


def dimensionless_rows(system: Formulation, jacobian: Rows, numbers: Sequence[int]) -> Rows:
    """Return some rows of Phi_q, dimensionless."""
    units = system.velocity_units
    return [{k: x * (units[k] / system.phi_units[i]) for k, x in jacobian[i].items()} for i in numbers]


def regular_choices(
    system: Formulation, used: Sequence[int] | None = None, exchangeable: ExchangeableRows = NO_ROWS
) -> Iterator[tuple[State, RowsInUse]]:
    """Yield choices of independent rows at states of the mobility; each row is in one of the choices.

    See `rows_in_use` for the arguments.
    """
    decided, flagged = mobility(system.scene), exchangeable.numbers
    used, others = candidate_rows(system, used, exchangeable)
    numbers = system.rows_of([*used, *others])
    for at, state in zip(decided.configurations, decided.states, strict=True):
        # in a singular configuration, such as a flat four-bar, pivots are zero or round-off
        if not are_independent(at.rows, used):
            continue
        choices = [used]
        for other, share in zip(others, shares(at.rows, used, others), strict=True):
            largest = max(share, key=lambda row: abs(share[row]), default=other)
            if abs(share.get(largest, 0.0)) > MAX_SHARE_CHANGE:
                choices.append([other if row == largest else row for row in used])
        for chosen in choices:
            in_use = set(system.rows_of(chosen))
            flags = {number: float(number not in in_use) for number in flagged}
            yield state, RowsInUse(numbers, flags=flags or None)


def in_use_alone(pivots: Sequence[float], rows: RowsInUse) -> list[float]:
    """Return the pivots of an elimination, 0 for rows that are left out."""
    flags = rows.flags or {}
    left_out = {n for n, number in enumerate(rows.numbers) if flags.get(number)}
    return [0.0 if n in left_out else pivot for n, pivot in enumerate(pivots)]


def flags_at(system: Formulation, q: Array, numbers: Sequence[int], exchangeable: ExchangeableRows) -> Array:
    """Choose rows that are well conditioned at q (nq,): flags (m,), see `exchanged`.

    Args:
        system: the form of the equations.
        q: (nq,).
        numbers: of all rows that are independent or exchangeable.
        exchangeable: rows to choose from.
    """
    jacobian = dimensionless_jacobian(system, q)[list(numbers)]
    places = [numbers.index(number) for number in exchangeable.numbers]
    return exchanged(jacobian, places, np.array(exchangeable.units), np.array(exchangeable.left_out))


def exchanged(jacobian: Array, rows: Sequence[int], units: Array, left_out: Array) -> Array:
    """Exchange rows in use for those left out while a share is larger than `MIN_EXCHANGED_SHARE`.

    Args:
        jacobian: (k, nv), dimensionless, of independent rows and of rows left out.
        rows: (m,) indices of exchangeable rows in `jacobian`.
        units: (m,) natural magnitudes of exchangeable rows.
        left_out: (m,) 1 for rows left out, 0 for rows in use.

    Returns:
        `left_out` (m,) after the exchanges.
    """
    flags, places = left_out.copy(), np.array(rows)
    if not np.isfinite(jacobian).all():
        return flags
    always = jacobian[np.delete(np.arange(len(jacobian)), places)]
    beside = np.linalg.qr(always.T, mode="complete")[0][:, len(always) :]
    own = jacobian[places] @ beside  # what rows add to those that are always in use
    for _ in range(MAX_EXCHANGES):
        used, out = np.flatnonzero(flags == 0.0), np.flatnonzero(flags == 1.0)
        found = np.linalg.lstsq(own[used].T, own[out].T, rcond=None)[0]
        sizes = np.abs(found) * units[used][:, None] / units[out]
        row, other = np.unravel_index(np.argmax(sizes), sizes.shape)
        if not sizes[row, other] > MIN_EXCHANGED_SHARE:
            break
        flags[used[row]], flags[out[other]] = 1.0, 0.0
    return flags
