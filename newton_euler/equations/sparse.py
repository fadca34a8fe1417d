"""Sparse linear algebra for equations of motion: L D L^T factorization, constrained systems, least squares.

Numbers may be floats, or symbolic scalars when the equations are traced for compilation. The order of
operations depends only on the pattern of nonzeros, so that traced code is the same algorithm as the one over
floats. A zero of type float is a structural zero: it is not stored, multiplied or added. There is no
pivoting. `Factor.pivot_ratio` measures how close to singular a matrix is. A sparse vector is a dictionary
from index to number, a sparse matrix a list of such rows.
"""

from __future__ import annotations

import heapq
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from newton_euler.scalars import NUMBERS, Array, Scalar, minimum

SINGULAR = 1e-11
"""Ratio of a pivot to its usual magnitude below which the pivot counts as zero."""

LEFT_OUT = 1e30
"""Compliance of a constraint row that is left out, divided by the row's diagonal element.

The multiplier of such a row is zero up to round-off, and the row changes no digit of the other rows."""


def is_zero(scalar: Scalar) -> bool:
    """Return True for a structural zero: a number 0, not a symbolic scalar."""
    return isinstance(scalar, NUMBERS) and scalar == 0.0


Rows = list[dict[int, Any]]
"""A sparse matrix: for each row a dictionary from column to scalar."""


def to_array(rows: Rows, columns: int) -> Array:
    """Convert a sparse matrix of floats to an array (rows, columns)."""
    matrix = np.zeros((len(rows), columns))
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


def spread(rows: Rows, start: int, block: Array) -> None:
    """Add a dense block (rows, columns) to sparse rows; `start` is the column of its first element."""
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
        order: row numbers in the order of their elimination.
        columns: for each row k, the elements of column k of L below the diagonal, by row.
        pivots, inverse_pivots: d and 1 / d for each row.
        pivot_ratio: smallest ratio of a pivot to its usual magnitude, minus `SINGULAR`; not positive if A is
            singular.
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
        scales: usual magnitudes of the pivots; the diagonal elements if None.
        drop: ratio of a pivot to its usual magnitude below which the row counts as dependent on earlier rows.
            Such a row is left out, also of `Factor.order`. For floats only.
    """
    work = [dict(row) for row in matrix]
    usual = [row.get(k, 0.0) for k, row in enumerate(work)] if scales is None else scales
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
        if drop and not pivot > drop * usual[k]:
            continue
        # pivot and column k of L
        done.append(k)
        pivots[k] = pivot
        pivot_ratio = minimum(pivot_ratio, pivot / usual[k] - SINGULAR)
        inverse_pivots[k] = 1.0 / pivot
        for i, entry in below:
            columns[k][i] = entry * inverse_pivots[k]
        # subtract their product from the remaining matrix
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
    """Constraint rows from which all other rows follow.

    Attributes:
        numbers: row numbers.
        scales: usual magnitudes of the pivots of these rows in the Schur complement J M^-1 J^T; None if
            unknown.
        mass_scales: usual magnitudes of the pivots of the mass matrix; None if unknown.
        flags: for exchangeable rows, by number: 1 if the row is left out at present, 0 if it is in use. All
            other rows are always in use.
    """

    numbers: list[int]
    scales: list[float] | None = None
    mass_scales: list[float] | None = None
    flags: Mapping[int, Scalar] | None = None

    @property
    def in_use(self) -> list[int]:
        """Numbers of the rows that are in use at present; the flags must be floats."""
        flags = self.flags or {}
        return [number for number in self.numbers if not flags.get(number)]

    def compliance(self, matrix: Rows) -> dict[int, Scalar]:
        """Compute what to add to the diagonal of a Schur complement or Gram matrix to leave rows out.

        Args:
            matrix: the sparse matrix, whose row n belongs to constraint row `numbers[n]`.

        Returns:
            Number to add, by constraint row, for each row with a flag.
        """
        flags = self.flags or {}
        return {  # the summand 1 is for rows that are zero in some configurations
            i: flags[i] * (LEFT_OUT * matrix[n].get(n, 0.0) + 1.0)
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
        """Smallest ratio of a pivot to its usual magnitude; not positive if M is singular."""

    def lower(self, right: dict[int, Any]) -> dict[int, Any]:
        """Compute L^-1 b for a sparse vector b."""

    def scaled(self, x: dict[int, Any]) -> dict[int, Any]:
        """Compute D^-1 x for a sparse vector x."""

    def upper(self, right: dict[int, Any]) -> dict[int, Any]:
        """Compute L^-T b for a sparse vector b."""


class Equations(NamedTuple):
    """Linear equations M a = f + J^T lambda, J a + softness * lambda = gamma for a and lambda.

    Attributes:
        factor: factorization M = L D L^T.
        free: sparse vector L^-1 f.
        jacobian: sparse rows of J.
        gamma: (k,) right side of the constraints.
        rows: rows of J and gamma to use; the other rows must follow from them.
        refine: True for a second solution for the residual J a - gamma. The second solution recovers digits
            that an ill-conditioned Schur complement loses.
        softness: softness, by row number, of rows that are not rigid constraints.
    """

    factor: MassFactor
    free: dict[int, Any]
    jacobian: Rows
    gamma: Array
    rows: RowsInUse
    refine: bool
    softness: Mapping[int, Scalar] | None = None

    def extended(self, rows: Rows, gamma: Array, scales: list[float] | None) -> Equations:
        """Return the equations with additional constraints.

        Args:
            rows: additional sparse rows of J, always in use.
            gamma: (k,) right side of all rows.
            scales: usual magnitudes of the pivots of all rows in use; None if unknown.
        """
        numbers = [*self.rows.numbers, *range(len(self.jacobian), len(self.jacobian) + len(rows))]
        used = self.rows._replace(numbers=numbers, scales=scales)
        return self._replace(jacobian=[*self.jacobian, *rows], gamma=gamma, rows=used)


@dataclass(frozen=True, eq=False)
class Solution:
    """Solution of the linear equations `Equations`.

    Attributes:
        acceleration: sparse vector a.
        multipliers: sparse vector lambda, by row number.
        pivot_ratio: smaller pivot ratio of the mass matrix and the Schur complement, see `Factor`.
        pivots: pivots of the Schur complement, for the rows in use.
        mass_pivots: pivots of the mass matrix.
    """

    acceleration: dict[int, Any]
    multipliers: dict[int, Any]
    pivot_ratio: Scalar
    pivots: list[Any]
    mass_pivots: list[Any]


def solve_constrained(equations: Equations) -> Solution:
    """Solve `Equations` for accelerations a and multipliers lambda by the Schur complement J M^-1 J^T."""
    factor, total, jacobian, gamma, rows, refine, softness = equations
    # without constraints: a = L^-T D^-1 L^-1 f
    kept = rows.numbers
    acceleration = factor.upper(factor.scaled(total)) if not kept else {}
    if not kept:
        return Solution(acceleration, {}, factor.pivot_ratio, [], factor.pivots)
    # the Schur complement J M^-1 J^T = H^T D^-1 H with H = L^-1 J^T
    half = [factor.lower(jacobian[i]) for i in kept]
    weighted = [factor.scaled(row) for row in half]
    schur = gram(half, weighted)
    soft = {**(softness or {}), **rows.compliance(schur)}
    for n, i in enumerate(kept):
        if i in soft:
            add(schur[n], n, soft[i])
    complement = factorize(schur, minimum_degree(schur), rows.scales)
    right = {n: gamma[i] - dot(weighted[n], total) for n, i in enumerate(kept)}
    # multipliers, then accelerations under all forces
    multipliers: dict[int, Any] = {}
    for _ in range(2 if refine else 1):
        change = complement.solve({n: x for n, x in right.items() if not is_zero(x)})
        total = dict(total)
        for n, x in change.items():
            add(multipliers, kept[n], x)
            for k, entry in half[n].items():
                add(total, k, entry * x)
        acceleration = factor.upper(factor.scaled(total))
        right = {
            n: gamma[i] - dot(jacobian[i], acceleration) - soft.get(i, 0.0) * multipliers.get(i, 0.0)
            for n, i in enumerate(kept)
        }
    pivot_ratio = minimum(factor.pivot_ratio, complement.pivot_ratio)
    return Solution(acceleration, multipliers, pivot_ratio, complement.pivots, factor.pivots)


def gram_factor(rows: Rows, used: RowsInUse | None = None, scales: Sequence[float] | None = None) -> Factor:
    """Factorize the Gram matrix (inner products) of dimensionless sparse rows.

    Args:
        rows: the rows.
        used: constraint row number of each row, and flags of rows to leave out; None to use all rows.
        scales: usual magnitudes of the pivots; 1 for each if None.
    """
    products = gram(rows, rows)
    if used is not None:
        compliance = used.compliance(products)
        for n, i in enumerate(used.numbers):
            add(products[n], n, compliance.get(i, 0.0))
    return factorize(products, minimum_degree(products), scales or [1.0] * len(rows))


def least_squares(rows: Rows, right: Array, used: RowsInUse | None = None) -> tuple[dict[int, Any], Scalar]:
    """Compute the shortest x with rows @ x = right.

    Args:
        rows: dimensionless sparse rows.
        right: (k,) right side.
        used: flags of rows to leave out, see `gram_factor`; None to use all rows.

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
