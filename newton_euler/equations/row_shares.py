"""Constraint rows that imply each other in another way in each configuration.

A row that is left out is a combination of rows in use. Its shares in these are analytic functions of the
configuration. If a share is not constant, two configurations in general position differ in it. Three regular
configurations are compared, `MIN_REGULAR`: the first one may be in a special position, a symmetric one, and
the others are a random step from a regular one. If fewer regular configurations are known, all rows that have
shares in each other count as varying: to exchange rows costs little, and not to exchange them may cost a run.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from newton_euler.equations.independence import independent, shares
from newton_euler.equations.sparse import Rows
from newton_euler.scalars import Array

MIN_REGULAR = 3
"""Regular configurations that decide whether shares are constant."""

MAX_SHARE_CHANGE = 1e-6
"""Difference of a share between configurations that is round-off, and share that is none."""


class ScaledRows(NamedTuple):
    """Rows of the constraint Jacobian at a configuration.

    Attributes:
        rows: in units of `scales`.
        scales: (k,) natural magnitudes of the dimensionless rows.
    """

    rows: Rows
    scales: Array


def varying_rows(
    configurations: Sequence[ScaledRows], used: Sequence[int], others: Sequence[int]
) -> dict[int, float]:
    """Find the rows that are to be exchanged, and their largest natural magnitudes.

    Args:
        configurations: closed ones; those where the rows in use are dependent do not count.
        used: rows in use, which imply all others.
        others: rows that are left out.

    Returns:
        Rows left out with varying shares, rows in use that have shares in them, and so on.
    """
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
    while more - rows:  # rows in use that have shares in one of them, and others in which these have shares
        rows |= more
        more = {row for link in links if link & rows for row in link}
    return {row: float(max(at.scales[row] for at in regular)) for row in sorted(rows)}


def are_independent(rows: Rows, used: Sequence[int]) -> bool:
    """True if some rows of a dimensionless matrix are independent."""
    return len(independent([rows[i] for i in used], 0.0).rows) == len(used)


def _shares(at: ScaledRows, used: Sequence[int], others: Sequence[int]) -> Rows:
    """Compute shares of dimensionless rows, which do not depend on the scales of a configuration."""
    return [
        {i: x * (at.scales[other] / at.scales[i]) for i, x in each.items()}
        for other, each in zip(others, shares(at.rows, used, others), strict=True)
    ]


def _varies(found: Sequence[dict[int, float]]) -> bool:
    """True if the shares of a row differ between configurations."""
    values = np.array([[each.get(i, 0.0) for i in set().union(*found)] for each in found])
    return bool(np.any(np.ptp(values, axis=0) > MAX_SHARE_CHANGE))
