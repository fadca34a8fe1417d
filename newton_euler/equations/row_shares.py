"""Constraint rows whose linear dependence varies from configuration to configuration.

A row that is left out is a combination of rows in use. Its coefficients, called shares, are analytic
functions of the configuration. If a share is not constant, two configurations in general position differ in
it. Three regular configurations are compared (`MIN_REGULAR`): the first may be in a special position, for
example symmetric, and the others are random steps away. If fewer regular configurations are known, all rows
with shares in each other count as varying: an unneeded exchange of rows costs little, a missing one may cost
the run.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from newton_euler.equations.independence import independent, shares
from newton_euler.equations.sparse import Rows
from newton_euler.scalars import Array

MIN_REGULAR = 3
"""Number of regular configurations that decide whether shares are constant."""

MAX_SHARE_CHANGE = 1e-6
"""Largest difference of a share between configurations that is round-off, and largest share that is zero."""


class ScaledRows(NamedTuple):
    """Rows of the constraint Jacobian at a configuration.

    Attributes:
        rows: sparse rows in units of `scales`.
        scales: (k,) natural magnitudes of the dimensionless rows.
    """

    rows: Rows
    scales: Array


def varying_rows(
    configurations: Sequence[ScaledRows], used: Sequence[int], others: Sequence[int]
) -> dict[int, float]:
    """Find the exchangeable rows, and their largest natural magnitudes.

    Args:
        configurations: closed configurations; ignored if the rows in use are dependent.
        used: numbers of rows in use, which imply all others.
        others: numbers of rows that are left out.

    Returns:
        Natural magnitudes by row: rows left out with varying shares, and all rows connected with them by
        shares.
    """
    # rows connected by shares, and rows left out whose shares vary
    regular = [at for at in configurations if are_independent(at.rows, used)]
    found = [_shares(at, used, others) for at in regular]
    links = [
        {other, *(i for at in found for i, x in at[n].items() if abs(x) > MAX_SHARE_CHANGE)}
        for n, other in enumerate(others)
    ]
    more = {
        other
        for n, other in enumerate(others)
        if len(links[n]) > 1 and (len(regular) < MIN_REGULAR or _varies([at[n] for at in found]))
    }
    rows: set[int] = set()
    # all rows connected with these
    while more - rows:
        rows |= more
        more = {row for link in links if link & rows for row in link}
    return {row: float(max(at.scales[row] for at in regular)) for row in sorted(rows)}


def are_independent(rows: Rows, used: Sequence[int]) -> bool:
    """True if some rows of a dimensionless matrix are independent."""
    return len(independent([rows[i] for i in used], 0.0).rows) == len(used)


def _shares(at: ScaledRows, used: Sequence[int], others: Sequence[int]) -> Rows:
    """Compute shares of the rows without the scales of the configuration."""
    return [
        {i: x * (at.scales[other] / at.scales[i]) for i, x in each.items()}
        for other, each in zip(others, shares(at.rows, used, others), strict=True)
    ]


def _varies(found: Sequence[dict[int, float]]) -> bool:
    """True if the shares of a row differ between configurations."""
    values = np.array([[each.get(i, 0.0) for i in set().union(*found)] for each in found])
    return bool(np.any(np.ptp(values, axis=0) > MAX_SHARE_CHANGE))
