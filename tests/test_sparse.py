"""Sparse elimination against dense linear algebra."""

from __future__ import annotations

import numpy as np
import pytest

from newton_euler.sparse import (
    factorise,
    minimum_degree,
    rows_of,
    solve_constrained,
    sparse_vector,
)


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
    factor = factorise(rows_of(matrix), range(len(PARENTS) - 1, -1, -1))
    below = {(i, k) for k, column in enumerate(factor.columns) for i in column}
    assert below == {(i, k) for i, k in zip(*np.nonzero(np.triu(matrix, 1)), strict=True)}


def test_solutions_are_those_of_dense_algebra():
    rng = np.random.default_rng(1)
    matrix = tree_matrix(rng, PARENTS)
    right = rng.standard_normal(len(PARENTS))
    right[3] = 0.0
    for order in (range(7, -1, -1), minimum_degree([set(row) for row in rows_of(matrix)])):
        solution = factorise(rows_of(matrix), order).solve(sparse_vector(right))
        found = [solution.get(k, 0.0) for k in range(len(PARENTS))]
        assert found == pytest.approx(np.linalg.solve(matrix, right), rel=1e-12)  # condition below 100


def test_constrained_solution_is_the_saddle_points():
    rng = np.random.default_rng(2)
    mass, jacobian = tree_matrix(rng, PARENTS), rng.standard_normal((3, 8))
    jacobian[0, 4:] = jacobian[1, :4] = 0.0
    force, gamma = rng.standard_normal(8), rng.standard_normal(3)
    factor = factorise(rows_of(mass), range(7, -1, -1))
    solution = solve_constrained(factor, sparse_vector(force), rows_of(jacobian), gamma)
    saddle = np.block([[mass, -jacobian.T], [jacobian, np.zeros((3, 3))]])
    expected = np.linalg.solve(saddle, np.concatenate([force, gamma]))
    assert [solution.acceleration[k] for k in range(8)] == pytest.approx(expected[:8], rel=1e-11)
    assert [solution.multipliers[k] for k in range(3)] == pytest.approx(expected[8:], rel=1e-11)
    assert solution.health > 0.0


def test_health_sees_dependent_constraints():
    rng = np.random.default_rng(3)
    mass = tree_matrix(rng, PARENTS)
    row = rng.standard_normal(8)
    factor = factorise(rows_of(mass), range(7, -1, -1))
    for size, healthy in ((1e-3, True), (1e-8, False), (0.0, False)):
        jacobian = np.array([row, 2.0 * row + size * rng.standard_normal(8)])
        solution = solve_constrained(factor, {}, rows_of(jacobian), np.ones(2))
        assert (solution.health > 0.0) == healthy
