"""Sparse elimination against dense linear algebra."""

from __future__ import annotations

import numpy as np
import pytest

from newton_euler.equations.sparse import (
    Equations,
    RowsInUse,
    factorize,
    minimum_degree,
    solve_constrained,
    sparse_vector,
)


def rows_of(matrix):
    """The nonzeros of a dense array, row by row."""
    return [{j: x for j, x in enumerate(row) if x != 0.0} for row in matrix]


def tree_matrix(rng, parents):
    """A positive definite matrix with the sparsity of a tree: nonzero along paths to the root."""
    n = len(parents)
    matrix = np.zeros((n, n))
    for leaf in range(n):
        path, k = [], leaf
        while k >= 0:
            path.append(k)
            k = parents[k]
        column = np.zeros(n)
        column[path] = rng.standard_normal(len(path))
        matrix += np.outer(column, column)
    return matrix + np.diag(0.5 + rng.random(n))


PARENTS = [-1, 0, 1, 1, 0, 4, 4, 6]


def test_leaves_first_makes_no_fill_on_a_tree():
    matrix = tree_matrix(np.random.default_rng(0), PARENTS)
    factor = factorize(rows_of(matrix), range(len(PARENTS) - 1, -1, -1))
    below = {(i, k) for k, column in enumerate(factor.columns) for i in column}
    assert below == {(i, k) for i, k in zip(*np.nonzero(np.triu(matrix, 1)), strict=True)}


def test_solutions_are_those_of_dense_algebra():
    rng = np.random.default_rng(1)
    matrix = tree_matrix(rng, PARENTS)
    right = rng.standard_normal(len(PARENTS))
    right[3] = 0.0
    for order in (range(7, -1, -1), minimum_degree(rows_of(matrix))):
        solution = factorize(rows_of(matrix), order).solve(sparse_vector(right))
        found = [solution.get(k, 0.0) for k in range(len(PARENTS))]
        assert found == pytest.approx(np.linalg.solve(matrix, right), rel=1e-12)  # condition below 100


def test_constrained_solution_is_the_saddle_points():
    rng = np.random.default_rng(2)
    mass, jacobian = tree_matrix(rng, PARENTS), rng.standard_normal((3, 8))
    jacobian[0, 4:] = jacobian[1, :4] = 0.0
    force, gamma = rng.standard_normal(8), rng.standard_normal(3)
    factor = factorize(rows_of(mass), range(7, -1, -1))
    solution = solve_constrained(
        Equations(
            factor,
            factor.lower(sparse_vector(force)),
            rows_of(jacobian),
            gamma,
            RowsInUse([0, 1, 2]),
            refine=False,
        )
    )
    saddle = np.block([[mass, -jacobian.T], [jacobian, np.zeros((3, 3))]])
    expected = np.linalg.solve(saddle, np.concatenate([force, gamma]))
    assert [solution.acceleration[k] for k in range(8)] == pytest.approx(expected[:8], rel=1e-11)
    assert [solution.multipliers[k] for k in range(3)] == pytest.approx(expected[8:], rel=1e-11)
    assert solution.pivot_ratio > 0.0


def test_health_sees_dependent_constraints():
    rng = np.random.default_rng(3)
    mass = tree_matrix(rng, PARENTS)
    row = rng.standard_normal(8)
    factor = factorize(rows_of(mass), range(7, -1, -1))
    for size, healthy in ((1e-3, True), (1e-8, False), (0.0, False)):
        jacobian = np.array([row, 2.0 * row + size * rng.standard_normal(8)])
        solution = solve_constrained(
            Equations(factor, {}, rows_of(jacobian), np.ones(2), RowsInUse([0, 1]), refine=False)
        )
        assert (solution.pivot_ratio > 0.0) == healthy


def test_refinement_regains_the_digits_of_a_badly_conditioned_complement():
    """Masses far apart: the complement has condition 1e10, J and a harmless one."""
    rng = np.random.default_rng(4)
    masses = np.geomspace(1e-5, 1e5, 8)
    jacobian, force = rng.standard_normal((3, 8)), rng.standard_normal(8)
    gamma = rng.standard_normal(3)
    factor = factorize(rows_of(np.diag(masses)), range(8))
    errors = []
    for refine in (False, True):
        rows = RowsInUse([0, 1, 2])
        equations = Equations(
            factor, factor.lower(sparse_vector(force)), rows_of(jacobian), gamma, rows, refine
        )
        solution = solve_constrained(equations)
        acceleration = np.array([solution.acceleration[k] for k in range(8)])
        errors.append(np.abs(jacobian @ acceleration - gamma).max() / np.abs(acceleration).max())
    assert errors[1] < 1e-15  # a few roundings of the product J a itself
    assert errors[1] < 0.1 * errors[0]


def test_dependent_rows_are_dropped_and_nothing_else():
    rng = np.random.default_rng(5)
    rows = rng.standard_normal((4, 8))
    rows = np.vstack([rows[0], rows[1], rows[0] - 2.0 * rows[1], rows[2], np.zeros(8), rows[3]])
    factor = factorize(rows_of(rows @ rows.T), range(6), drop=1e-11)
    assert factor.order == [0, 1, 3, 5]
