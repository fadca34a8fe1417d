"""SweepSamples of sweeps: their distributions, their independence of chunks, and texts that are none."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from SALib.sample import sobol

from crosscheck.support.errors import CrosscheckError
from crosscheck.sweeps.distributions import Correlated, parse, parse_vary
from crosscheck.sweeps.sampling import SAMPLINGS, samples_of
from newton_euler.errors import NewtonEulerError

RUNS = 4096

COVARIANCE = [[4.0, 1.5], [1.5, 1.0]]

TEXTS = {
    "a": "normal(14, 0.5)",
    "b": "uniform(-1e-3,1e-3)",
    ("c", "d"): f"normal([1, 2], {COVARIANCE})",
    "e": "truncated_normal(0, 1, 0.5, 3)",
}


def sample(sampling, vary=TEXTS, runs=RUNS, seed=7):
    """Make samples; Saltelli's plan has a number of runs of its own."""
    blocks = len(vary) + 2
    return samples_of(vary, sampling, runs // 8 * blocks if sampling == "saltelli" else runs, seed)


@pytest.mark.parametrize("sampling", SAMPLINGS)
def test_values_of_a_run_do_not_depend_on_what_they_are_drawn_with(sampling):
    vary = {"a": "values(1, 2, 3)", "b": "grid(0, 1, 11)"} if sampling == "grid" else TEXTS
    found = samples_of(vary, "grid", None, 7) if sampling == "grid" else sample(sampling)
    whole = found.values(0, found.runs)
    edges = [0, 1, 2, 9, 30, found.runs]
    parts = [found.values(first, last) for first, last in pairwise(edges)]
    assert np.array_equal(np.concatenate(parts), whole)
    assert np.all(np.isfinite(whole))
    assert len(np.unique(whole, axis=0)) == found.runs


@pytest.mark.parametrize("sampling", ["random", "latin_hypercube", "sobol", "saltelli"])
def test_samples_have_the_moments_of_their_distributions(sampling):
    values = sample(sampling).values(0, RUNS)
    # three standard errors of 4096 random runs; the others are nearer
    error = 3.0 / np.sqrt(RUNS)
    assert values[:, 0].mean() == pytest.approx(14.0, abs=0.5 * error)
    assert values[:, 0].std() == pytest.approx(0.5, rel=error)
    assert np.all(np.abs(values[:, 1]) <= 1e-3)
    assert values[:, 1].std() == pytest.approx(1e-3 / np.sqrt(3.0), rel=error)
    assert values[:, 2:4].mean(axis=0) == pytest.approx([1.0, 2.0], abs=2.0 * error)
    assert np.cov(values[:, 2:4].T) == pytest.approx(np.array(COVARIANCE), abs=8.0 * error)
    assert np.all((values[:, 4] >= 0.5) & (values[:, 4] <= 3.0))


def test_saltelli_plans_are_those_of_salib():
    samples, size = sample("saltelli"), len(TEXTS) + 1
    owners = ["a", "b", "cd", "cd", "e"]
    problem = {"num_vars": size, "names": list("abcde"), "groups": owners, "bounds": [[0.0, 1.0]] * size}
    plan = sobol.sample(problem, samples.runs // samples.block, calc_second_order=False, seed=7)
    assert np.array_equal(samples._probabilities(0, samples.runs), plan)


def test_a_latin_hypercube_has_one_run_in_each_share():
    values = samples_of({"a": f"uniform(0, {RUNS})"}, "latin_hypercube", RUNS, 1).values(0, RUNS)
    assert np.array_equal(np.sort(values[:, 0].astype(int)), np.arange(RUNS))


def test_a_grid_has_all_combinations():
    found = samples_of({"a": [1.0, 2.0], "b": "grid(0, 1, 3)"}, "grid", None, 0)
    assert found.values(0, found.runs).tolist() == [[a, b] for a in (1.0, 2.0) for b in (0.0, 0.5, 1.0)]


@pytest.mark.parametrize("sampling", ["random", "latin_hypercube", "sobol", "saltelli"])
def test_seeds_decide(sampling):
    first, same, other = (sample(sampling, seed=seed).values(0, 8) for seed in (1, 1, 2))
    assert np.array_equal(first, same)
    assert not np.any(np.isclose(first, other))


@pytest.mark.parametrize(
    ("distribution", "reference"),
    [
        # half of the tail beyond 8, 6.2e-16 of all, lies beyond 8.0849; its mirror image alone is accurate
        ("truncated_normal(0, 1, 8, 20)", 8.0849),
        ("truncated_normal(0, 1, -20, -8)", -8.0849),
        ("normal(1, 2)", 1.0),
        ("values(3, 1)", 1.0),
        ("uniform(1, 3)", 2.0),
    ],
)
def test_medians(distribution, reference):
    assert parse(distribution).quantile(np.array([0.5]))[0] == pytest.approx(reference, abs=5e-5)


def test_covariances_are_symmetric_but_for_round_off():
    covariance = np.array(COVARIANCE)
    covariance[0, 1] *= 1.0 + 1e-15
    assert Correlated.normal([1, 2], covariance).correlation == pytest.approx(
        np.array([[1.0, 0.75], [0.75, 1.0]]), rel=1e-14
    )


def test_correlated_numbers_keep_their_own_distributions():
    group = "correlated(uniform(0, 1), normal(0, 1), [[1, 1], [1, 1]])"
    values = samples_of({("a", "b"): group}, "sobol", RUNS, 3).values(0, RUNS)
    assert np.array_equal(np.argsort(values[:, 0]), np.argsort(values[:, 1]))
    assert values[:, 0].mean() == pytest.approx(0.5, abs=1e-3)


@pytest.mark.parametrize("text", [text for text in TEXTS.values() if "[" not in text] + ["values(1, 2)"])
def test_texts_of_distributions_are_read_back(text):
    assert parse(str(parse(text))) == parse(text)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a", "not of the form NAME=DISTRIBUTION"),
        ("a=", "not of the form NAME=DISTRIBUTION"),
        ("=normal(1,2)", "not of the form NAME=DISTRIBUTION"),
        ("a=normal", "is no number"),
        ("a=3", "a number is no distribution; one value for all runs is values(3)"),
        ("a=[3]", "it is no distribution; choose from"),
        ("a=normal(1,2", "'(' was never closed"),
        ("a=normal(1)", "normal takes 2 numbers, MEAN, DEVIATION, not 1"),
        ("a=norml(1,2)", "did you mean 'normal'?"),
        ("a=normal(1,2)+1", "is no number"),
        ("a=normal(1,1_0)", "'1_0' is no number"),
        ("a=normal(1,1e999)", "'1e999' is too large"),
        ("a=normal(1,nan)", "is no number"),
        ("a=normal(1,0)", "DEVIATION is 0.0; needed: a positive number"),
        ("a=uniform(2,2)", "uniform(2, 2) is an empty distribution"),
        ("a=truncated_normal(0,1,60,50)", "is an empty distribution"),
        ("a=values()", "values() is an empty distribution"),
        ("a=grid(0,1,1.5)", "COUNT is 1.5"),
        ("a=__import__('os')", "is no number"),
        ("a,b=normal([1,2],[[1,2],[2,1]])", "covariance has a negative eigenvalue"),
        ("a,b=normal([1,2],[[1,2],[3,1]])", "covariance is not symmetric"),
        ("a,b=normal([1,2],[[1,0],[0,0]])", "covariance has a diagonal that is not positive"),
        ("a,b=correlated(normal(1,2),uniform(1,2),[[1,0.5]])", "no matrix of 2 rows"),
        ("a,b=correlated([[1]])", "correlated takes DISTRIBUTION"),
        ("a=normal(1;2)", "--vary 'a=normal(1;2)': there is a semicolon, where commas are needed"),
        ("a,b=normal([1,2],[[1,0],[0,1])", "does not match"),
        ("a=" + "(" * 5000 + ")" * 5000, "too many nested parentheses"),
    ],
)
def test_texts_that_are_no_distribution_are_one_line(text, words):
    with pytest.raises(CrosscheckError) as caught:
        parse_vary([text])
    assert words in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
    assert len(str(caught.value)) < 500


MANY = {f"p{k}": [1.0] for k in range(10_601)}


@pytest.mark.parametrize(
    ("vary", "sampling", "runs", "words"),
    [
        ({}, "random", 3, "nothing varies"),
        ({"a": "uniform(0,1)", ("a", "b"): TEXTS["c", "d"]}, "random", 3, "a varies twice"),
        ({("a", "b"): "uniform(0,1)"}, "random", 3, "a distribution of 1 numbers, not of 2"),
        ({"a": "uniform(0,1)"}, "grid", None, "needed: values(...) or grid(...)"),
        ({"a": [1, 2]}, "grid", 3, "the grid has 2 runs, not 3"),
        ({"a": "uniform(0,1)"}, "random", None, "needs a number of runs"),
        ({"a": "uniform(0,1)"}, "random", 0, "runs is 0"),
        ({"a": "uniform(0,1)"}, "saltelli", 100, "a power of 2 times 3 runs: 96 or 192, not 100"),
        ({"a": "uniform(0,1)"}, "sobl", 3, "unknown sampling 'sobl'; did you mean 'sobol'?"),
        ({"a": "uniform(0,1)"}, "latin_hypercube", 2**30, "at most; sobol has no limit"),
        (MANY, "saltelli", 10_603, "saltelli takes 10600 parameters at most, not 10601; random has no limit"),
        (MANY | {f"q{k}": [1.0] for k in range(10_601)}, "sobol", 2, "sobol takes 21201 parameters"),
        ({"a": []}, "random", 3, "empty distribution"),
        ({"a": 3.0}, "random", 3, "is no distribution"),
        ({"a": b"12"}, "random", 3, "is no distribution"),
    ],
)
def test_impossible_plans_are_one_line(vary, sampling, runs, words):
    with pytest.raises((CrosscheckError, NewtonEulerError)) as caught:
        samples_of(vary, sampling, runs, 0)
    assert words in str(caught.value)


@pytest.mark.parametrize("seed", [-1, 1.5, 2**64])
def test_impossible_seeds_are_refused(seed):
    with pytest.raises(CrosscheckError, match="seed is"):
        samples_of({"a": [1.0]}, "random", 3, seed)
