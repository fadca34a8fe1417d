"""Find redundant constraint rows whose linear dependence changes with the configuration.

A constraint row is one scalar constraint equation, and its row of the constraint Jacobian. A redundant row
that is left out is a linear combination of the rows in use. Its coefficients are called shares. If a share
depends on the configuration, a run may have to exchange the row for a row in use
(`newton_euler.equations.row_choice`). The shares of several configurations of a mechanism are compared. The
first configuration may be special, for example symmetric; the others are random steps away. If fewer than
`MIN_REGULAR` regular (not singular) configurations are known, all shares count as varying. To prepare an
exchange that is never needed costs little, but a missing exchange may stop a run.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from newton_euler.equations.independence import independent, shares
from newton_euler.equations.sparse import Rows
from newton_euler.scalars import Array

MIN_REGULAR = 3
"""Number of regular configurations needed to decide whether shares are constant."""

SHARE_ROUND_OFF = 1e-6
"""Largest change of a share between configurations that counts as round-off, so that the share is constant.
A share below this number counts as zero."""


class ScaledRows(NamedTuple):
    """Rows of the constraint Jacobian at a configuration, scaled to length about 1.

    The natural magnitude of a row of a loop is the largest motion that one joint gives to one of the two
    bodies whose motions the row compares.

    Attributes:
        rows: sparse dimensionless rows, each divided by its natural magnitude.
        scales: (k,) natural magnitude by which each row is divided.
    """

    rows: Rows
    scales: Array


def varying_rows(
    configurations: Sequence[ScaledRows], used: Sequence[int], others: Sequence[int]
) -> dict[int, float]:
    """Find the rows that a run may have to exchange, and their natural magnitudes.

    Args:
        configurations: closed configurations. A configuration in which the rows in use are dependent is
            singular and ignored.
        used: numbers of the rows in use; all other rows are combinations of them.
        others: numbers of the rows that are left out.

    Returns:
        Largest natural magnitude, by row number, for left-out rows with varying shares and for all rows that
        are connected to them. A left-out row is connected to the rows in use that have a share in it, and
        through them to further left-out rows.
    """
    # each left-out row and the rows with a share in it are connected
    regular = [at for at in configurations if are_independent(at.rows, used)]
    shares_at = [_unscaled_shares(at, used, others) for at in regular]
    connected = [
        {other, *(i for of_rows in shares_at for i, x in of_rows[n].items() if abs(x) > SHARE_ROUND_OFF)}
        for n, other in enumerate(others)
    ]
    # left-out rows whose shares vary
    added = {
        other
        for n, other in enumerate(others)
        if len(connected[n]) > 1
        and (len(regular) < MIN_REGULAR or _vary([of_rows[n] for of_rows in shares_at]))
    }
    # all rows connected to them, directly or through other rows
    rows: set[int] = set()
    while added - rows:
        rows |= added
        added = {row for group in connected if group & rows for row in group}
    return {row: float(max(at.scales[row] for at in regular)) for row in sorted(rows)}


def are_independent(rows: Rows, used: Sequence[int]) -> bool:
    """Return True if the rows with the numbers `used` of a dimensionless matrix are independent."""
    return len(independent([rows[i] for i in used], tolerance=0.0).rows) == len(used)


def _unscaled_shares(at: ScaledRows, used: Sequence[int], others: Sequence[int]) -> Rows:
    """Compute the shares of the rows `used` in each of the rows `others`, for rows without the scaling."""
    return [
        {i: x * (at.scales[other] / at.scales[i]) for i, x in each.items()}
        for other, each in zip(others, shares(at.rows, used, others), strict=True)
    ]


def _vary(shares_of_row: Sequence[dict[int, float]]) -> bool:
    """Return True if the shares in a left-out row differ between configurations.

    Args:
        shares_of_row: for each configuration, the shares by number of the row in use.
    """
    numbers = set().union(*shares_of_row)
    values = np.array([[each.get(i, 0.0) for i in numbers] for each in shares_of_row])
    return bool(np.any(np.ptp(values, axis=0) > SHARE_ROUND_OFF))
