"""Shares of what varies in the variance of what is kept, against functions whose shares are known."""

from __future__ import annotations

import numpy as np
import pytest

from crosscheck.sweeps.analysis import Analysis, Scalar, telling
from crosscheck.sweeps.sampling import samples_of

RUNS = 4096

ISHIGAMI = dict.fromkeys("abc", f"uniform({-np.pi}, {np.pi})")


def effects(function, vary, sampling="random", runs=RUNS):
    """The effects on a function of the samples, by name."""
    samples = samples_of(vary, sampling, runs, 5)
    values = function(*samples.values(0, samples.runs).T)
    found = Analysis(samples).effects(Scalar("y", (), (), "", values))
    return {effect.name: effect for effect in found}


def ishigami(a, b, c):
    """Compute the function of Ishigami and Homma, 1990, whose Sobol indices are known."""
    return np.sin(a) + 7.0 * np.sin(b) ** 2 + 0.1 * c**4 * np.sin(a)


@pytest.mark.parametrize("sampling", ["random", "latin_hypercube", "sobol"])
def test_shares_of_a_sum_are_those_of_its_terms(sampling):
    vary = {"a": "normal(1, 3)", "b": "normal(2, 1)", "c": "uniform(0, 1)"}
    found = effects(lambda a, b, c: -a + b, vary, sampling)
    assert list(found) == ["a", "b", "c"]
    # of 4096 runs; errors of a share s are about 2 s / sqrt(4096)
    assert found["a"].share == pytest.approx(0.9, abs=0.03)
    assert found["b"].share == pytest.approx(0.1, abs=0.03)
    assert found["c"].share == pytest.approx(0.0, abs=0.03)
    assert found["a"].rank == pytest.approx(-0.95, abs=0.02)
    assert found["a"].low > found["a"].high


def test_shares_do_not_need_a_trend():
    found = effects(lambda a, b: a**2 + 0.0 * b, {"a": "normal(0, 1)", "b": "values(1, 2, 3)"})
    assert found["a"].share > 0.9  # what is left is within the outer bins
    assert found["b"].share < 0.01
    assert abs(found["a"].rank) < 0.05


@pytest.mark.parametrize(("sampling", "runs"), [("random", 2**15), ("saltelli", 5 * 2**13)])
def test_sobol_indices_of_ishigami(sampling, runs):
    found = effects(ishigami, ISHIGAMI, sampling, runs)
    # errors of 2^13 base runs
    assert [found[name].share for name in "abc"] == pytest.approx([0.3139, 0.4424, 0.0], abs=0.02)
    if sampling == "saltelli":
        assert [found[name].total for name in "abc"] == pytest.approx([0.5576, 0.4424, 0.2437], abs=0.02)
        assert all(0.0 < found[name].error < 0.05 for name in "abc")


def test_correlated_parameters_are_one():
    vary = {("a", "b"): "normal([0, 0], [[1, 0.9], [0.9, 1]])", "c": "normal(0, 0.1)"}
    found = effects(lambda a, b, c: a + c, vary, "saltelli", 4 * 2**10)
    assert list(found) == ["a, b", "c"]
    assert found["a, b"].total == pytest.approx(1.0 / 1.01, abs=0.02)
    assert found["a, b"].rank is None


def test_what_does_not_vary_has_no_effects():
    assert effects(lambda a: 1.0 + 1e-13 * a, {"a": "normal(0, 1)"}) == {}
    assert effects(lambda a: np.nan * a, {"a": "normal(0, 1)"}) == {}


def test_runs_that_could_not_go_on_are_left_out():
    found = effects(lambda a: np.where(a > 1.0, np.nan, a), {"a": "normal(0, 1)"}, "saltelli", 3 * 1024)
    assert found["a"].share > 0.95


def test_the_telling_number_of_a_variable_is_its_largest_that_varies():
    values = np.array([[1.0, 2.0, 9.0], [2.0, 4.0, 9.0]])
    rows = [Scalar("peak", (k,), (str(k),), "N", values[:, k]) for k in range(3)]
    assert [scalar.label for scalar in telling(rows)] == ["peak 1"]
