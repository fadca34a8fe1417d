"""Selection of independent rows of a sparse dimensionless matrix, such as a constraint Jacobian.

The independent part of a row is the length of its component orthogonal to the selected rows. A row counts as
dependent if its independent part is below a tolerance, and also `MIN_GAP_RATIO` times below that of the
weakest selected row. Equations in joint coordinates, equations in body poses, comparisons with other engines
and readers of model files all decide in this way. A sparse row is a dictionary from column to number; there
may be thousands of rows. The rows have length about 1, so that all limits are absolute.
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
"""Independent part below which a row counts as dependent, also with tolerance 0: it is round-off."""

MIN_INEXACT = 1e-13
"""Independent part above which a dependent row is not exactly redundant; smaller ones are round-off."""

CERTAIN_PIVOT = 1e-4
"""Pivot of the Gram matrix above which a row is certainly independent.

A pivot is the square of the row's independent part."""

MIN_GAP_RATIO = 10.0
"""Smallest ratio of the weakest selected row's independent part to that of the strongest dependent row."""


class Independent(NamedTuple):
    """A selection of independent rows of a matrix; the other rows depend on them up to noise.

    Attributes:
        factor: factor of the Gram matrix (inner products) of the selected rows.
        weak: independent parts, by row number, of the selected rows whose independent part is so small that
            the row may have been dependent by design; in descending order.
        strong: smallest independent part of the other selected rows.
        noise: largest independent part of a row that is not selected.
    """

    factor: Factor
    weak: dict[int, float]
    strong: float
    noise: float

    @property
    def rows(self) -> list[int]:
        """Numbers of the selected rows, ascending."""
        return sorted(self.factor.order)


def independent(rows: Rows, tolerance: float) -> Independent:
    """Select independent rows of a dimensionless matrix.

    Rows are added in descending order of their independent parts. The selection ends at a gap: the next
    independent part is below `tolerance`, and below the smallest one so far divided by `MIN_GAP_RATIO`.
    Without such a gap the selection ends when the remaining rows are dependent up to round-off.

    Args:
        rows: sparse rows of the matrix, each of length about 1.
        tolerance: independent part below which a row counts as dependent.
    """
    # rows that are zero up to round-off count as zero
    lengths = [length(row) for row in rows]
    noise = max((each for each in lengths if each <= ROW_ROUND_OFF), default=0.0)
    rows = [row if each > ROW_ROUND_OFF else {} for row, each in zip(rows, lengths, strict=True)]
    # rows that are certainly independent, far above the tolerance, in one sparse factorization, which drops
    # rows with pivots below `drop`
    products = gram(rows, rows)
    order = [i for i in minimum_degree(products) if rows[i]]
    certain = max(CERTAIN_PIVOT, (MIN_GAP_RATIO * tolerance) ** 2)
    factor = factorize(products, order, scales=[1.0] * len(rows), drop=certain)
    used = set(factor.order)
    doubtful = [i for i in order if i not in used]
    least = float(np.sqrt(min((factor.pivots[i] for i in factor.order), default=1.0)))
    # the doubtful rows one by one, the largest independent part first. Before each search for the largest
    # part, one random sum of all doubtful rows shows cheaply whether any of them is independent
    weak, strong = dict[int, float](), least
    while doubtful and (of_sum := _independent_part_of_sum(rows, factor, doubtful)) > MIN_INEXACT:
        # the sum may hide a part a few times as large, hence the additional factor `MIN_GAP_RATIO`
        if of_sum <= ROW_ROUND_OFF or MIN_GAP_RATIO * of_sum <= min(tolerance, least / MIN_GAP_RATIO):
            noise = max(noise, of_sum)
            break
        parts = {i: remainder(rows, factor, rows[i]) for i in doubtful}
        best = max(parts, key=lambda i: parts[i])
        part = parts[best]
        if part <= ROW_ROUND_OFF or (part <= tolerance and MIN_GAP_RATIO * part <= least):
            noise = max(noise, part)
            break
        # select the row
        least = min(least, part)
        if part < np.sqrt(CERTAIN_PIVOT):
            weak[best] = part
        else:
            strong = least
        doubtful.remove(best)
        factor = factorize(products, [*factor.order, best])
    return Independent(factor, weak, strong, noise)


def length(row: dict[int, float]) -> float:
    """Compute the Euclidean norm of a sparse vector."""
    return float(np.sqrt(sum(x * x for x in row.values())))


def remainder(rows: Rows, factor: Factor, row: dict[int, float]) -> float:
    """Compute the independent part of a row: its distance from the span of the selected rows.

    Solving with the Gram matrix loses digits; a second solution for the remaining vector recovers them.

    Args:
        rows: sparse rows of the matrix.
        factor: factor of the Gram matrix of the selected rows.
        row: the examined sparse row.
    """
    remaining = dict(row)
    for _ in range(2):
        right = {j: dot(rows[j], remaining) for j in factor.order}
        for j, share in factor.solve({j: x for j, x in right.items() if x != 0.0}).items():
            for k, x in rows[j].items() if share != 0.0 else ():
                remaining[k] = remaining.get(k, 0.0) - share * x
    return length(remaining)


def shares(rows: Rows, used: Sequence[int], others: Sequence[int]) -> Rows:
    """Express dependent rows as combinations of independent rows: (dependent rows) = X @ (independent rows).

    The coefficients X are called shares. A second solution recovers the digits that the Gram matrix loses.

    Args:
        rows: sparse rows of a dimensionless matrix.
        used: numbers of the independent rows.
        others: numbers of the dependent rows.

    Returns:
        For each of the dependent rows, its shares by number of the independent row.
    """
    products = gram([rows[i] for i in used], [rows[i] for i in used])
    factor = factorize(products, minimum_degree(products))
    found: Rows = []
    for other in others:
        remaining, total_shares = dict(rows[other]), dict[int, float]()
        for _ in range(2):
            right = {n: dot(rows[i], remaining) for n, i in enumerate(used)}
            for n, share in factor.solve({n: x for n, x in right.items() if x != 0.0}).items():
                add(total_shares, used[n], share)
                for k, x in rows[used[n]].items():
                    add(remaining, k, -share * x)
        found.append(total_shares)
    return found


def least_step(rows: Rows, factor: Factor, right: Array, columns: int) -> Array:
    """Compute the shortest x with rows @ x = right for the selected rows.

    Args:
        rows: sparse rows of the matrix.
        factor: factor of the Gram matrix of the selected rows.
        right: (k,) right side of all rows.
        columns: length of x.

    Returns:
        x (columns,).
    """
    used = set(factor.order)
    weights = factor.solve({i: x for i, x in sparse_vector(right).items() if i in used})
    step = np.zeros(columns)
    for i in factor.order:
        for k, x in rows[i].items():
            step[k] += x * weights.get(i, 0.0)
    return step


def _independent_part_of_sum(rows: Rows, factor: Factor, doubtful: list[int]) -> float:
    """Compute the independent part of a random sum of rows: round-off if all rows are exactly dependent."""
    weights = np.random.default_rng(1).uniform(1.0, 2.0, len(doubtful))
    total: dict[int, float] = {}
    for i, weight in zip(doubtful, weights, strict=True):
        for k, x in rows[i].items():
            add(total, k, weight * x)
    return remainder(rows, factor, total)
