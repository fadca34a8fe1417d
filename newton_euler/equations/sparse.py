"""Sparse linear algebra for equations of motion: L D L^T factorization, constrained systems, least squares.

Numbers may be floats, or symbolic scalars when the equations are traced for compilation. The order of
operations depends only on the pattern of nonzeros, so that traced code is the same algorithm as the one over
floats. A zero of type float is a structural zero: it is not stored, multiplied or added. A sparse vector is a
dictionary from index to number, a sparse matrix a list of such rows.

There is no pivoting. Instead each pivot is compared with its reference magnitude: the largest value of this
pivot in several sample configurations of the mechanism that are not singular
(`newton_euler.equations.row_choice.rows_in_use`). A small ratio shows that the matrix is almost singular
(`Factor.pivot_ratio`).
"""

from __future__ import annotations

import heapq
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from newton_euler.scalars import NUMBERS, Array, Scalar, Stack, minimum

SINGULAR_PIVOT_RATIO = 1e-11
"""Ratio of a pivot to its reference magnitude below which the pivot counts as zero, mostly round-off."""

OMITTED_ROW_COMPLIANCE = 1e30
"""Number that is added to the diagonal element of an omitted constraint row, divided by this element.

The row then has no effect: its multiplier is zero up to round-off, and no digit of the other rows changes."""


def is_zero(scalar: Scalar) -> bool:
    """Return True for a structural zero: a number 0, not a symbolic scalar."""
    return isinstance(scalar, NUMBERS) and scalar == 0.0


Rows = list[dict[int, Any]]
"""A sparse matrix: for each row a dictionary from column to scalar."""


def to_array(rows: Rows, columns: int) -> Array:
    """Convert a sparse matrix of floats or `Stack`s to an array (rows, columns)."""
    stacks = any(isinstance(x, Stack) for row in rows for x in row.values())
    matrix = np.zeros((len(rows), columns), dtype=object if stacks else float)
    for i, row in enumerate(rows):
        for j, x in row.items():
            matrix[i, j] = x
    return matrix


def sparse_vector(vector: Array | Sequence[Scalar]) -> dict[int, Any]:
    """Convert a vector to a sparse vector."""
    return {k: x for k, x in enumerate(vector) if not is_zero(x)}


def add(row: dict[int, Any], column: int, scalar: Scalar) -> None:
    """Compute row[column] += scalar for a sparse row; a structural zero is not stored."""
    if not is_zero(scalar):
        row[column] = row[column] + scalar if column in row else scalar


def add_block(rows: Rows, start: int, block: Array) -> None:
    """Add a dense block (k, m) to k sparse rows, in place, from the column `start` on."""
    for row, entries in zip(rows, block, strict=True):
        for k, entry in enumerate(entries):
            add(row, start + k, entry)


def add_symmetric(rows: Rows, i: int, j: int, scalar: Scalar) -> None:
    """Compute rows[i][j] += scalar for a symmetric sparse matrix, and store the same number in rows[j][i]."""
    add(rows[i], j, scalar)
    if i != j and j in rows[i]:
        rows[j][i] = rows[i][j]


def minimum_degree(matrix: Sequence[Collection[int]]) -> list[int]:
    """Compute an elimination order with few new nonzeros: the row with the fewest neighbors is next.

    Two rows are neighbors if the matrix has a nonzero that connects them, or if elimination has made one.
    The matrix of a tree is eliminated from the leaves to the root, without new nonzeros (A. George,
    J. W. H. Liu, The evolution of the minimum degree ordering algorithm, SIAM Review 31, 1989).

    Args:
        matrix: columns of the nonzeros of each row; the matrix is symmetric.
    """
    neighbors = [set(columns) - {i} for i, columns in enumerate(matrix)]
    waiting = [(len(others), i) for i, others in enumerate(neighbors)]
    heapq.heapify(waiting)
    order, done = [], set()
    while waiting:
        degree, k = heapq.heappop(waiting)
        if k in done or degree != len(neighbors[k]):
            continue  # an outdated entry of the heap
        done.add(k)
        order.append(k)
        for i in neighbors[k]:
            neighbors[i] |= neighbors[k]
            neighbors[i] -= {i, k}
            heapq.heappush(waiting, (len(neighbors[i]), i))
    return order


@dataclass(frozen=True, eq=False)
class Factor:
    """Factorization A = L D L^T of a symmetric positive definite sparse matrix.

    Attributes:
        order: row numbers in the order of their elimination, without rows that `factorize` has dropped.
        columns: for each row k, the elements of column k of L below the diagonal, by row.
        pivots, inverse_pivots: d and 1 / d for each row.
        pivot_ratio: smallest ratio of a pivot to its reference magnitude. `SINGULAR_PIVOT_RATIO` is
            subtracted from it, so that the result is not positive if A is singular.
    """

    order: list[int]
    columns: Rows
    pivots: list[Any]
    inverse_pivots: list[Any]
    pivot_ratio: Scalar

    def lower(self, right: dict[int, Any]) -> dict[int, Any]:
        """Compute L^-1 b for a sparse b."""
        x = dict(right)
        for k in self.order:
            if k in x:
                for i, entry in self.columns[k].items():
                    add(x, i, -(entry * x[k]))
        return x

    def scaled(self, x: dict[int, Any]) -> dict[int, Any]:
        """Compute D^-1 x."""
        return {k: value * self.inverse_pivots[k] for k, value in x.items()}

    def upper(self, right: dict[int, Any]) -> dict[int, Any]:
        """Compute L^-T b."""
        x = dict(right)
        for k in reversed(self.order):
            for i, entry in self.columns[k].items():
                if i in x:
                    add(x, k, -(entry * x[i]))
        return x

    def solve(self, right: dict[int, Any]) -> dict[int, Any]:
        """Compute A^-1 b."""
        return self.upper(self.scaled(self.lower(right)))


def factorize(
    matrix: Rows, order: Sequence[int], scales: Sequence[float] | None = None, drop: float = 0.0
) -> Factor:
    """Factorize a symmetric sparse matrix by elimination in a given order.

    Args:
        matrix: all nonzeros, on both sides of the diagonal.
        order: row numbers in the order of elimination.
        scales: reference magnitude of the pivot of each row; the diagonal elements if None.
        drop: ratio of a pivot to its reference magnitude below which the row counts as dependent on earlier
            rows. The factorization omits such a row. 0 keeps all rows; other values are for floats only.
    """
    work = [dict(row) for row in matrix]
    reference = [row.get(k, 0.0) for k, row in enumerate(work)] if scales is None else scales
    pivots: list[Any] = [0.0] * len(work)
    columns: Rows = [{} for _ in work]
    inverse_pivots: list[Any] = [0.0] * len(work)
    pivot_ratio: Scalar = np.inf
    done = []
    for k in order:
        # take row and column k out of the remaining matrix
        pivot = work[k].get(k, 0.0)
        below = [(i, entry) for i, entry in work[k].items() if i != k]
        for i, _ in below:
            del work[i][k]
        if drop and not pivot > drop * reference[k]:
            continue
        # pivot and column k of L
        done.append(k)
        pivots[k] = pivot
        pivot_ratio = minimum(pivot_ratio, pivot / reference[k] - SINGULAR_PIVOT_RATIO)
        inverse_pivots[k] = 1.0 / pivot
        for i, entry in below:
            columns[k][i] = entry * inverse_pivots[k]
        # subtract pivot * (column k of L) (column k of L)^T from the remaining matrix, which stays symmetric
        for n, (i, _) in enumerate(below):
            for j, entry in below[n:]:
                add(work[i], j, -(columns[k][i] * entry))
                if i != j and j in work[i]:
                    work[j][i] = work[i][j]
    return Factor(done, columns, pivots, inverse_pivots, pivot_ratio)


def dot(a: dict[int, Any], b: dict[int, Any]) -> Scalar:
    """Compute the inner product of two sparse vectors."""
    if len(b) < len(a):
        a, b = b, a
    total: Scalar = 0.0
    for k, x in a.items():
        if k in b:
            total = total + x * b[k]
    return total


def gram(rows: Rows, others: Rows) -> Rows:
    """Compute the matrix of inner products of sparse rows with other rows of the same pattern of nonzeros.

    The matrix must be symmetric, as for others = rows or others = rows @ (diagonal matrix).
    """
    touching: dict[int, list[int]] = {}
    for i, row in enumerate(rows):
        for k in row:
            touching.setdefault(k, []).append(i)
    products: Rows = [{} for _ in rows]
    for i, row in enumerate(rows):
        for j in sorted({j for k in row for j in touching[k] if j <= i}):
            entry = dot(row, others[j])
            if not is_zero(entry):
                products[i][j] = products[j][i] = entry
    return products


class RowsInUse(NamedTuple):
    """Selection of rows of a constraint Jacobian J from which all other rows follow.

    In some mechanisms no fixed selection stays independent in all configurations. Compiled code then contains
    more rows than are independent, the exchangeable rows, and flags determine at each call which of them are
    omitted. A run changes the flags when the rows in use become dependent
    (`newton_euler.equations.row_choice`).

    Attributes:
        numbers: numbers of the selected rows in J, exchangeable rows included.
        scales: reference magnitude of the pivot of each selected row in the Schur complement J M^-1 J^T; None
            if unknown.
        mass_scales: reference magnitudes of the pivots of the mass matrix M; None if unknown.
        flags: by number of an exchangeable row: 1 if the row is omitted at present, 0 if it is in use. All
            other selected rows are always in use.
    """

    numbers: list[int]
    scales: list[float] | None = None
    mass_scales: list[float] | None = None
    flags: Mapping[int, Scalar] | None = None

    @property
    def in_use(self) -> list[int]:
        """Numbers of the selected rows that no flag omits at present; the flags must be floats."""
        flags = self.flags or {}
        return [number for number in self.numbers if not flags.get(number)]

    def compliance(self, matrix: Rows) -> dict[int, Scalar]:
        """Compute the numbers that omit rows if they are added to the diagonal of a matrix.

        Args:
            matrix: sparse Schur complement or Gram matrix, whose row n belongs to constraint row
                `numbers[n]`.

        Returns:
            Number to add, by number of the exchangeable constraint row; 0 for a row in use.
        """
        flags = self.flags or {}
        return {  # the summand 1 is for rows that are zero in some configurations
            i: flags[i] * (OMITTED_ROW_COMPLIANCE * matrix[n].get(n, 0.0) + 1.0)
            for n, i in enumerate(self.numbers)
            if i in flags
        }


class MassFactor(Protocol):
    """Interface of a factorization M = L D L^T of a mass matrix; see `Factor` for its members."""

    @property
    def pivots(self) -> list[Any]:
        """Pivots d, the diagonal of D."""

    @property
    def pivot_ratio(self) -> Scalar:
        """Smallest pivot ratio, less `SINGULAR_PIVOT_RATIO` as in `Factor`; not positive if M is singular."""

    def lower(self, right: dict[int, Any]) -> dict[int, Any]:
        """Compute L^-1 b for a sparse vector b."""

    def scaled(self, x: dict[int, Any]) -> dict[int, Any]:
        """Compute D^-1 x for a sparse vector x."""

    def upper(self, right: dict[int, Any]) -> dict[int, Any]:
        """Compute L^-T b for a sparse vector b."""


class Equations(NamedTuple):
    """Linear equations M a = f + J^T lambda, J a + softness * lambda = gamma for a and lambda.

    M is the mass matrix, a are the accelerations, f the forces, J is the constraint Jacobian, and lambda are
    the multipliers.

    Attributes:
        factor: factorization M = L D L^T.
        reduced_force: sparse vector L^-1 f.
        jacobian: sparse rows of J.
        gamma: (k,) right side of the constraints.
        rows: rows of J and gamma to use; the other rows must follow from them.
        refine: True for one step of iterative refinement, which solves again for the residual gamma - J a -
            softness * lambda. This recovers digits that an ill-conditioned Schur complement loses.
        softness: by row number, for rows that are soft constraints; 0 for all other rows. Exchangeable rows
            are never soft.
    """

    factor: MassFactor
    reduced_force: dict[int, Any]
    jacobian: Rows
    gamma: Array
    rows: RowsInUse
    refine: bool
    softness: Mapping[int, Scalar] | None = None

    def extended(self, rows: Rows, gamma: Array, scales: list[float] | None) -> Equations:
        """Return the equations with additional constraints.

        Args:
            rows: additional sparse rows of J, always in use.
            gamma: (k,) right side of all rows of J, the additional ones last.
            scales: reference magnitudes of the pivots of all selected rows, the additional ones last; None if
                unknown.
        """
        numbers = [*self.rows.numbers, *range(len(self.jacobian), len(self.jacobian) + len(rows))]
        selected = self.rows._replace(numbers=numbers, scales=scales)
        return self._replace(jacobian=[*self.jacobian, *rows], gamma=gamma, rows=selected)


@dataclass(frozen=True, eq=False)
class Solution:
    """Solution of the linear equations `Equations`.

    Attributes:
        acceleration: sparse vector a.
        multipliers: sparse vector lambda, by row number.
        pivot_ratio: smaller one of the pivot ratios of M and of the Schur complement, see `Factor`.
        pivots: pivots of the Schur complement, for the selected rows in their order.
        mass_pivots: pivots of the mass matrix.
    """

    acceleration: dict[int, Any]
    multipliers: dict[int, Any]
    pivot_ratio: Scalar
    pivots: list[Any]
    mass_pivots: list[Any]


def solve_constrained(equations: Equations) -> Solution:
    """Solve `Equations` for accelerations a and multipliers lambda by the Schur complement J M^-1 J^T."""
    factor, reduced_force, jacobian, gamma, rows, refine, softness = equations
    # without constraints: a = L^-T D^-1 L^-1 f
    numbers = rows.numbers
    acceleration = factor.upper(factor.scaled(reduced_force)) if not numbers else {}
    if not numbers:
        return Solution(acceleration, {}, factor.pivot_ratio, [], factor.pivots)
    # the Schur complement J M^-1 J^T = H^T D^-1 H with H = L^-1 J^T
    half = [factor.lower(jacobian[i]) for i in numbers]
    weighted = [factor.scaled(row) for row in half]
    schur = gram(half, weighted)
    # soft and omitted rows add to the diagonal
    soft = {**(softness or {}), **rows.compliance(schur)}
    for n, i in enumerate(numbers):
        if i in soft:
            add(schur[n], n, soft[i])
    complement = factorize(schur, minimum_degree(schur), rows.scales)
    # residuals gamma - J a - softness * lambda, first of the accelerations without constraints (lambda = 0)
    right = {n: gamma[i] - dot(weighted[n], reduced_force) for n, i in enumerate(numbers)}
    # multipliers for these residuals, then accelerations under the forces f + J^T lambda; with `refine`, a
    # second time for the residuals that remain
    multipliers: dict[int, Any] = {}
    for _ in range(2 if refine else 1):
        change = complement.solve({n: x for n, x in right.items() if not is_zero(x)})
        reduced_force = dict(reduced_force)
        for n, x in change.items():
            add(multipliers, numbers[n], x)
            for k, entry in half[n].items():
                add(reduced_force, k, entry * x)
        acceleration = factor.upper(factor.scaled(reduced_force))
        right = {
            n: gamma[i] - dot(jacobian[i], acceleration) - soft.get(i, 0.0) * multipliers.get(i, 0.0)
            for n, i in enumerate(numbers)
        }
    pivot_ratio = minimum(factor.pivot_ratio, complement.pivot_ratio)
    return Solution(acceleration, multipliers, pivot_ratio, complement.pivots, factor.pivots)


def gram_factor(rows: Rows, used: RowsInUse | None = None, scales: Sequence[float] | None = None) -> Factor:
    """Factorize the Gram matrix (inner products) of dimensionless sparse rows.

    Args:
        rows: the rows.
        used: constraint row number of each row, and flags of the rows to omit; None to use all rows.
        scales: reference magnitudes of the pivots; 1 for each if None.
    """
    products = gram(rows, rows)
    if used is not None:
        compliance = used.compliance(products)
        for n, i in enumerate(used.numbers):
            add(products[n], n, compliance.get(i, 0.0))
    return factorize(products, minimum_degree(products), scales or [1.0] * len(rows))


def least_squares(rows: Rows, right: Array, used: RowsInUse | None = None) -> tuple[dict[int, Any], Scalar]:
    """Compute the shortest x with rows @ x = right: x = rows^T (rows rows^T)^-1 right.

    Args:
        rows: dimensionless sparse rows.
        right: (k,) right side.
        used: flags of the rows to omit, see `gram_factor`; None to use all rows.

    Returns:
        The sparse vector x, and the pivot ratio of the Gram matrix.
    """
    factor = gram_factor(rows, used)
    weights = factor.solve(sparse_vector(right))
    x: dict[int, Any] = {}
    for i, weight in weights.items():
        for k, entry in rows[i].items():
            add(x, k, entry * weight)
    return x, factor.pivot_ratio
