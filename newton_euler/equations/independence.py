"""Independent rows of a dimensionless matrix: one decision for all formulations, engines and readers.

The independent part of a row is its component orthogonal to the other rows. A row counts as dependent if the
length of this part is below a tolerance and several times below that of the weakest independent row. All
matrices are sparse: there may be thousands of rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from newton_euler.equations.sparse import (
    Factor,
    Rows,
    add,
    dot,
    factorize,
    gram,
    minimum_degree,
    sparse_vector,
)
from newton_euler.scalars import Array

ROW_ROUND_OFF = 1e-10
"""Independent part of a row below which it is round-off, whatever the tolerance."""

MIN_INEXACT = 1e-13
"""Independent part of a row above which the row is not exactly redundant."""

CERTAIN_PIVOT = 1e-4
"""Pivot of the Gram matrix, the square of the independent part, above which a row surely is independent."""

MIN_GAP_RATIO = 10.0
"""Least ratio of the independent parts of the weakest independent row and the strongest redundant row."""


class Independent(NamedTuple):
    """A selection of rows that imply all others except for noise."""

    factor: Factor
    """Factor of the Gram matrix of these rows."""
    weak: dict[int, float]
    """Small independent parts, by number of the row, the largest first."""
    strong: float
    """The smallest independent part of the other selected rows."""
    noise: float
    """The largest independent part of a row that is not selected."""

    @property
    def rows(self) -> list[int]:
        """Numbers of the selected rows, ascending."""
        return sorted(self.factor.order)


def independent(rows: Rows, tolerance: float) -> Independent:
    """Select independent rows of a dimensionless matrix.

    Rows are added in the order of their independent parts, the largest first. The selection ends where these
    drop below `tolerance` and below the last one divided by `MIN_GAP_RATIO`; without such a gap, where the
    rest is round-off.

    Args:
        rows: of the matrix, about 1 long.
        tolerance: independent part below which a row counts as dependent.
    """
    # rows without round-off
    lengths = [length(row) for row in rows]
    noise = max((each for each in lengths if each <= ROW_ROUND_OFF), default=0.0)
    rows = [row if each > ROW_ROUND_OFF else {} for row, each in zip(rows, lengths, strict=True)]
    # rows that are certainly independent, in one sparse factorization
    products = gram(rows, rows)
    order = [i for i in minimum_degree(products) if rows[i]]
    certain = max(CERTAIN_PIVOT, (MIN_GAP_RATIO * tolerance) ** 2)
    factor = factorize(products, order, scales=[1.0] * len(rows), drop=certain)
    used = set(factor.order)
    doubtful = [i for i in order if i not in used]
    least = float(np.sqrt(min((factor.pivots[i] for i in factor.order), default=1.0)))
    # the other rows one by one, the largest independent part first
    weak, strong = dict[int, float](), least
    while doubtful and (new := _together(rows, factor, doubtful)) > MIN_INEXACT:
        if new <= ROW_ROUND_OFF or MIN_GAP_RATIO * new <= min(tolerance, least / MIN_GAP_RATIO):
            noise = max(noise, new)
            break
        shares = {i: remainder(rows, factor, rows[i]) for i in doubtful}
        found = max(shares, key=lambda i: shares[i])
        share = shares[found]
        if share <= ROW_ROUND_OFF or (share <= tolerance and MIN_GAP_RATIO * share <= least):
            noise = max(noise, share)
            break
        least = min(least, share)
        if share < np.sqrt(CERTAIN_PIVOT):
            weak[found] = share
        else:
            strong = least
        doubtful.remove(found)
        factor = factorize(products, [*factor.order, found])
    return Independent(factor, weak, strong, noise)


def length(row: dict[int, float]) -> float:
    """Compute the Euclidean norm of a sparse vector."""
    return float(np.sqrt(sum(x * x for x in row.values())))


def remainder(rows: Rows, factor: Factor, row: dict[int, float]) -> float:
    """Compute the length of the part of a row that is independent of the rows of a factor.

    A second solution recovers the digits that the Gram matrix loses.
    """
    left = dict(row)
    for _ in range(2):
        right = {j: dot(rows[j], left) for j in factor.order}
        for j, share in factor.solve({j: x for j, x in right.items() if x != 0.0}).items():
            for k, x in rows[j].items() if share != 0.0 else ():
                left[k] = left.get(k, 0.0) - share * x
    return length(left)


def shares(rows: Rows, used: Sequence[int], others: Sequence[int]) -> Rows:
    """Compute the shares X of independent rows in others that follow from them: others = X @ used.

    A second solution recovers the digits that the Gram matrix loses.

    Args:
        rows: of a dimensionless matrix.
        used: numbers of independent rows.
        others: numbers of the other rows.

    Returns:
        For each of the others, its shares by number of the row in use.
    """
    products = gram([rows[i] for i in used], [rows[i] for i in used])
    factor = factorize(products, minimum_degree(products))
    found: Rows = []
    for other in others:
        left, total = dict(rows[other]), dict[int, float]()
        for _ in range(2):
            right = {n: dot(rows[i], left) for n, i in enumerate(used)}
            for n, share in factor.solve({n: x for n, x in right.items() if x != 0.0}).items():
                add(total, used[n], share)
                for k, x in rows[used[n]].items():
                    add(left, k, -share * x)
        found.append(total)
    return found


def least_step(rows: Rows, factor: Factor, right: Array, columns: int) -> Array:
    """Compute the shortest x (columns,) with rows @ x = right (k,) for the rows of a factor."""
    used = set(factor.order)
    weights = factor.solve({i: x for i, x in sparse_vector(right).items() if i in used})
    step = np.zeros(columns)
    for i in factor.order:
        for k, x in rows[i].items():
            step[k] += x * weights.get(i, 0.0)
    return step


def _together(rows: Rows, factor: Factor, doubtful: list[int]) -> float:
    """Compute the independent part of a random combination of rows: round-off if each row is dependent."""
    weights = np.random.default_rng(1).uniform(1.0, 2.0, len(doubtful))
    together: dict[int, float] = {}
    for i, weight in zip(doubtful, weights, strict=True):
        for k, x in rows[i].items():
            add(together, k, weight * x)
    return remainder(rows, factor, together)
