"""Noise and misfit of linear models, whose estimates are known in closed form or by their likelihood."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.stats import chi2, kstest

from newton_euler import Measurements
from newton_euler.analysis.identification.noise import Noise

RARE = 1e-6
"""Probability with which chance fails a test that is right."""


def measurements(columns, **noise):
    """Columns of any numbers, the noise of some of which is given."""
    (count,) = {len(column) for column in columns.values()}
    return Measurements(np.arange(count), columns, noise)


def fitted(matrices, columns, **noise):
    """Noise of columns that a linear model with these matrices (n, p) is fitted to; residuals, by column."""
    estimate = Noise([measurements(columns, **noise)])
    matrix, data = np.vstack(list(matrices.values())), np.concatenate(list(columns.values()))
    for _ in range(100):
        weights = 1.0 / estimate.effective
        basis, triangle = np.linalg.qr(matrix * weights[:, None])
        residuals = data - matrix @ np.linalg.solve(triangle, basis.T @ (data * weights))
        if np.abs(estimate.estimate(residuals, basis) - 1.0).max() < 1e-6:
            break
    return estimate, dict(zip(columns, np.split(residuals, len(columns)), strict=True))


def test_each_column_loses_what_parameters_take_of_its_own():
    """One column determines all three parameters, another none."""
    rng = np.random.default_rng(0)
    matrices = {"a": rng.normal(size=(12, 3)), "b": np.zeros((12, 3))}
    columns = {"a": 1e-3 * rng.normal(size=12), "b": 5.0 * rng.normal(size=12)}
    noise, residuals = fitted(matrices, columns)
    squares = [np.sum(residuals[name] ** 2) for name in ("a", "b")]
    assert noise.levels[1:] == pytest.approx([np.sqrt(squares[0] / 9.0), np.sqrt(squares[1] / 12.0)])
    assert noise.undetermined == ()
    assert np.isnan(noise.probability)


def test_noise_is_that_of_the_restricted_likelihood():
    """Of three columns that determine the same parameters, one of given noise."""
    rng = np.random.default_rng(1)
    deviations = np.array([0.1, 0.3, 2.0])
    matrices = {name: rng.normal(size=(15, 4)) for name in "abc"}
    columns = {name: level * rng.normal(size=15) for name, level in zip(matrices, deviations, strict=True)}
    noise, _ = fitted(matrices, columns, a=0.1)
    matrix, data = np.vstack(list(matrices.values())), np.concatenate(list(columns.values()))

    def unlikely(logarithms):
        inverse = np.repeat(np.exp(-2.0 * np.concatenate([[np.log(0.1)], logarithms])), 15)
        information = matrix.T @ (inverse[:, None] * matrix)
        residuals = data - matrix @ np.linalg.solve(information, matrix.T @ (inverse * data))
        squares = residuals @ (inverse * residuals)
        return 0.5 * (squares - np.sum(np.log(inverse)) + np.linalg.slogdet(information)[1])

    best = minimize(unlikely, np.log(deviations[1:]), method="Nelder-Mead", options={"xatol": 1e-7}).x
    # what the search leaves
    assert noise.levels[1:] == pytest.approx(np.exp(best), rel=1e-5)


def test_of_given_noise_alone_the_misfit_is_chi_squared():
    rng = np.random.default_rng(2)
    matrices, columns = {"a": rng.normal(size=(12, 3))}, {"a": 0.1 * rng.normal(size=12)}
    noise, residuals = fitted(matrices, columns, a=0.1)
    squares = np.sum((residuals["a"] / 0.1) ** 2)
    assert noise.freedom == pytest.approx(9.0)
    assert noise.misfit == pytest.approx(np.sqrt(squares / 9.0))
    assert noise.probability == pytest.approx(chi2.sf(squares, 9))


@pytest.mark.slow
def test_probabilities_are_uniform_beside_columns_of_unknown_noise():
    """Of a right model, over 500 draws; the fit takes a fifth of the column with given noise.

    Residuals of the other columns are as large as their noise by definition: counted with the others, they
    would have nearly all probabilities around a half.
    """
    rng = np.random.default_rng(3)
    matrices = {name: rng.normal(size=(12, 4)) for name in "abcdef"}

    def probability():
        columns = {name: (1.0 if name == "a" else 4.0) * rng.normal(size=12) for name in matrices}
        return fitted(matrices, columns, a=1.0)[0].probability

    assert kstest([probability() for _ in range(500)], "uniform").pvalue > RARE


def test_given_noise_is_taken_for_larger_only_if_it_is_wrong():
    rng = np.random.default_rng(4)
    matrices, columns = {"a": np.ones((50, 1))}, {"a": rng.normal(size=50)}
    right, _ = fitted(matrices, columns, a=1.0)
    wrong, _ = fitted(matrices, columns, a=0.5)
    assert right.levels == [1.0]
    assert wrong.levels == [wrong.misfit] == pytest.approx([2.0 * right.misfit])


def test_noise_of_a_column_that_the_fit_takes_is_not_determined():
    """As many numbers as parameters that nothing else determines."""
    rng = np.random.default_rng(5)
    matrices = {"a": np.eye(5)[[4] * 4], "b": np.eye(4, 5)}
    columns = {name: rng.normal(size=4) for name in matrices}
    noise, _ = fitted(matrices, columns)
    assert noise.undetermined == ("b",)
