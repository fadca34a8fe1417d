"""Sparse symmetric factorisation over generic scalars, laid out before any number is known.

A zero of type float is a structural zero: it is not stored, multiplied or added. Run over traced
scalars, what is left is straight-line code for exactly the nonzeros; run over floats it is the same
algorithm. No pivoting: `Factor.health` says how close to singular the matrix has come.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from newton_euler.scalars import Array, Scalar, minimum

SINGULAR = 1e-11
"""A pivot below this share of the diagonal element it came from counts as zero."""


def is_zero(scalar: Scalar) -> bool:
    """Whether a scalar is zero whatever the state."""
    return isinstance(scalar, float | int) and scalar == 0.0


Rows = list[dict[int, Any]]
"""A matrix as one dictionary a row: column to scalar."""


def rows_of(matrix: Array) -> Rows:
    """The nonzeros of a dense array."""
    return [{j: x for j, x in enumerate(row) if not is_zero(x)} for row in matrix]


def sparse_vector(vector: Array) -> dict[int, Any]:
    """The nonzeros of a vector."""
    return {k: x for k, x in enumerate(vector) if not is_zero(x)}


def add(row: dict[int, Any], column: int, scalar: Scalar) -> None:
    """row[column] += scalar, leaving no structural zero."""
    if not is_zero(scalar):
        row[column] = row[column] + scalar if column in row else scalar


def minimum_degree(pattern: Sequence[set[int]]) -> list[int]:
    """An order of elimination with little fill: always the row with fewest neighbours left.

    `pattern[i]` holds the columns of row i. On the graph of a tree it is leaves first and makes no
    fill at all (George and Liu, SIAM Review 31, 1989).
    """
    neighbours = [set(columns) - {i} for i, columns in enumerate(pattern)]
    remaining = set(range(len(neighbours)))
    order = []
    while remaining:
        k = min(remaining, key=lambda i: (len(neighbours[i]), i))
        remaining.remove(k)
        order.append(k)
        for i in neighbours[k]:
            neighbours[i] |= neighbours[k]
            neighbours[i] -= {i, k}
    return order


@dataclass(frozen=True, eq=False)
class Factor:
    """L D L^T of a symmetric positive definite matrix, eliminated in `order`.

    Attributes:
        order: rows in the order of their elimination.
        columns: for each row k the entries of L below it, {row: l}.
        inverse_pivots: 1 / d for each row.
        health: the least of d - `SINGULAR` times the diagonal; not positive if singular.
    """

    order: list[int]
    columns: Rows
    inverse_pivots: list[Any]
    health: Scalar

    def lower(self, right: dict[int, Any]) -> dict[int, Any]:
        """L^-1 b for a sparse b."""
        x = dict(right)
        for k in self.order:
            if k in x:
                for i, entry in self.columns[k].items():
                    add(x, i, -(entry * x[k]))
        return x

    def scaled(self, x: dict[int, Any]) -> dict[int, Any]:
        """D^-1 x."""
        return {k: value * self.inverse_pivots[k] for k, value in x.items()}

    def upper(self, right: dict[int, Any]) -> dict[int, Any]:
        """L^-T b."""
        x = dict(right)
        for k in reversed(self.order):
            for i, entry in self.columns[k].items():
                if i in x:
                    add(x, k, -(entry * x[i]))
        return x

    def solve(self, right: dict[int, Any]) -> dict[int, Any]:
        """A^-1 b."""
        return self.upper(self.scaled(self.lower(right)))


def factorise(matrix: Rows, order: Sequence[int]) -> Factor:
    """Eliminate the rows of a symmetric matrix in the given order."""
    work = [dict(row) for row in matrix]
    diagonal = [row[k] for k, row in enumerate(work)]
    columns: Rows = [{} for _ in work]
    inverse_pivots: list[Any] = [0.0] * len(work)
    health: Scalar = np.inf
    for k in order:
        pivot = work[k][k]
        health = minimum(health, pivot - SINGULAR * diagonal[k])
        inverse_pivots[k] = 1.0 / pivot
        below = [(i, entry) for i, entry in work[k].items() if i != k]
        for i, entry in below:
            columns[k][i] = entry * inverse_pivots[k]
            del work[i][k]
        for n, (i, _) in enumerate(below):
            for j, entry in below[n:]:
                update = -(columns[k][i] * entry)
                add(work[i], j, update)
                if i != j:
                    work[j][i] = work[i][j]
    return Factor(list(order), columns, inverse_pivots, health)


def dot(a: dict[int, Any], b: dict[int, Any]) -> Scalar:
    """Inner product of two sparse vectors."""
    if len(b) < len(a):
        a, b = b, a
    total: Scalar = 0.0
    for k, x in a.items():
        if k in b:
            total = total + x * b[k]
    return total


@dataclass(frozen=True, eq=False)
class Solution:
    """Acceleration and multipliers, and how close to singular it was."""

    acceleration: dict[int, Any]
    multipliers: dict[int, Any]
    health: Scalar


def solve_constrained(factor: Factor, force: dict[int, Any], jacobian: Rows, gamma: Array) -> Solution:
    """M a = f + J^T lambda, J a = gamma, M factorised, by the Schur complement J M^-1 J^T, all sparse."""
    half_force = factor.lower(force)
    if not jacobian:
        return Solution(factor.upper(factor.scaled(half_force)), {}, factor.health)
    kept = [i for i, row in enumerate(jacobian) if row]  # an equation that nothing can move does nothing
    half = [factor.lower(jacobian[i]) for i in kept]
    weighted = [factor.scaled(row) for row in half]
    touching: dict[int, list[int]] = {}
    for i, row in enumerate(half):
        for k in row:
            touching.setdefault(k, []).append(i)
    schur: Rows = [{} for _ in half]
    for i, row in enumerate(half):
        for j in sorted({j for k in row for j in touching[k] if j <= i}):
            entry = dot(row, weighted[j])
            if not is_zero(entry):
                schur[i][j] = schur[j][i] = entry
    right = {i: gamma[kept[i]] - dot(weighted[i], half_force) for i in range(len(half))}
    complement = factorise(schur, minimum_degree([set(row) for row in schur]))
    multipliers = complement.solve({i: x for i, x in right.items() if not is_zero(x)})
    total = dict(half_force)
    for i, x in multipliers.items():
        for k, entry in half[i].items():
            add(total, k, entry * x)
    acceleration = factor.upper(factor.scaled(total))
    multipliers = {kept[i]: x for i, x in multipliers.items()}
    return Solution(acceleration, multipliers, minimum(factor.health, complement.health))
