"""Shares of what varies in the variance of what is kept, against functions whose shares are known."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.stats import binom

import crosscheck.sweeps.analysis
from crosscheck.sweeps.analysis import MAX_SHARE_RUNS, Analysis, Effect
from crosscheck.sweeps.kept_numbers import KeptNumber, most_informative, most_varying, sample_blocks
from crosscheck.sweeps.pictures import SCATTER_COLUMNS, _scatter, share_of
from crosscheck.sweeps.sampling import samples_of

RUNS = 4096

RARE = 1e-3
"""Probability of a count of trials beyond its bound."""

UNITS = {"a": "kg", "b": "N/m", "c": ""}

ISHIGAMI = dict.fromkeys("abc", f"uniform({-np.pi}, {np.pi})")


def effects(function, vary, sampling="random", runs=RUNS, seed=5):
    """The effects on a function of the samples, by name."""
    samples = samples_of(vary, sampling, runs, seed)
    values = function(*samples.values(0, samples.runs).T)
    runs, inputs = np.arange(samples.runs), samples.values(0, samples.runs)
    analysis = Analysis(samples, runs, lambda of: dict(zip(samples.names, inputs[of].T, strict=True)))
    found = analysis.effects(KeptNumber("y", (), (), "", values, runs))
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


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.2, 0.8, 0.99])
def test_intervals_are_of_95_percent(share):
    """Of 400 runs, the fewest with shares: as many hold what they are to, and none is needlessly wide.

    Those of Sobol's sequence are of as many random runs, whose shares deviate by more.
    """
    trials, rest = 200, (1.0 / share - 1.0) ** 0.5
    vary = {"a": "normal(0, 1)", "b": "normal(0, 1)"}
    # Spearman's rank correlation of normal numbers, of their correlation r: 6/pi asin(r/2)
    rank = 6.0 / np.pi * np.arcsin(0.5 * share**0.5)
    fewest, most = binom.ppf(RARE, trials, 0.95), binom.isf(RARE, trials, 0.95)
    widths = {}
    for sampling in ("random", "sobol"):
        found = [effects(lambda a, b: a + rest * b, vary, sampling, 400, seed)["a"] for seed in range(trials)]
        shares, errors, ranks, rank_errors = np.array(
            [(each.share, each.error, each.rank, each.rank_error) for each in found]
        ).T
        widths[sampling] = errors.mean()
        assert np.sum(np.abs(shares - share) <= errors) >= fewest
        assert np.sum(np.abs(ranks - rank) <= rank_errors) >= fewest
        assert abs(shares.mean() - share) < 0.1 * widths[sampling]
        if sampling == "random":
            assert np.sum(np.abs(shares - share) <= errors) <= most
            # 1.96 deviations, of which those of 200 trials are known to a tenth, and a tenth for lack of fit
            assert 1.8 < widths[sampling] / shares.std() < 2.5
            assert 1.8 < rank_errors.mean() / ranks.std() < 2.5
    assert widths["sobol"] < 1.1 * widths["random"]


@pytest.mark.parametrize("runs", [512, 1024])
@pytest.mark.parametrize("sampling", ["random", "sobol"])
def test_shares_of_many_equal_terms_are_all_of_the_variance(sampling, runs):
    found = effects(lambda *terms: sum(terms), dict.fromkeys("abcdefghij", "uniform(-1, 1)"), sampling, runs)
    assert len(found) == 10
    # of Sobol's sequence what is left of noise; of random numbers their variances differ by 1.5/sqrt(n)
    allowed = 0.03 if sampling == "sobol" else 3.0 * 1.5 * runs**-0.5
    assert sum(each.share for each in found.values()) == pytest.approx(1.0, abs=allowed)


@pytest.mark.parametrize("levels", [2, 3, 10, 24, 100])
def test_a_few_values_have_any_effect(levels):
    """The share of each value's own effect, from its variance; more values than terms have a trend."""
    own = np.random.default_rng(1).normal(size=levels) if levels < 25 else np.arange(levels) ** 1.5
    own = own / own.std()
    grid = f"grid(0, {levels - 1}, {levels})"
    found = effects(lambda a, b: own[a.astype(int)] + b, {"a": grid, "b": "normal(0, 1)"})
    # the standard error of a half is 2 sqrt(0.5) 0.5/sqrt(4096) = 0.011
    assert found["a"].share == pytest.approx(0.5, abs=0.035)
    assert found["a"].error < 0.03


@pytest.mark.parametrize("sampling", ["random", "sobol"])
@pytest.mark.parametrize("function", [lambda a: np.sign(a - 0.3), np.abs, lambda a: np.sin(3.0 * a)])
def test_intervals_hold_what_polynomials_follow_slowly(function, sampling):
    known = function(np.random.default_rng(1).normal(size=1_000_000)).var()
    found = effects(lambda a, b: function(a) + 0.1 * b, dict.fromkeys("ab", "normal(0, 1)"), sampling)["a"]
    assert abs(found.share - known / (known + 0.01)) <= found.error < 0.04


def test_few_runs_have_ranks_alone():
    found = effects(lambda a, b: a + 0.0 * b, {"a": "normal(0, 1)", "b": "normal(0, 0.5)"}, runs=10)
    assert [found[name].share for name in "ab"] == [None, None]
    assert found["a"].rank == pytest.approx(1.0)
    assert found["b"].rank_error > 0.5


def test_shares_do_not_need_a_trend():
    found = effects(lambda a, b: a**2 + 0.0 * b, {"a": "normal(0, 1)", "b": "values(1, 2, 3)"})
    assert found["a"].share > 0.99
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


@pytest.mark.parametrize(("sampling", "runs"), [("random", 9), ("saltelli", 3 * 2**8)])
@pytest.mark.parametrize(
    "vary", [{"a": "normal(0, 1)"}, {("a", "b"): "normal([0, 0], [[1, 0.5], [0.5, 1]])"}]
)
def test_what_varies_alone_is_all_that_matters(vary, sampling, runs):
    (found,) = effects(lambda *values: np.sin(3.0 * sum(values)), vary, sampling, runs).values()
    assert share_of(found) == "100 %"


def test_intervals_of_sobol_indices_are_those_of_the_seed():
    vary = {"a": "normal(0, 1)", "b": "normal(0, 1)"}
    first, again = (effects(lambda a, b: a + b, vary, "saltelli", 4 * 2**8, seed=0) for _ in range(2))
    assert 0.0 < first["a"].error == again["a"].error


def test_correlated_parameters_share_what_they_explain_together():
    vary = {("a", "b"): "normal([0, 0], [[1, 0.9], [0.9, 1]])", "c": "normal(0, 1)"}
    found = effects(lambda a, b, c: a - b + 0.5 * a * b + c, vary)
    # of a - b the variance is 0.2, of a b it is 1.81; errors as above
    together = 0.2 + 0.25 * 1.81
    assert found["a, b"].share == pytest.approx(together / (together + 1.0), abs=0.03)
    assert found["a, b"].low < -0.5 < 0.5 < found["a, b"].high
    assert found["c"].share == pytest.approx(1.0 / (together + 1.0), abs=0.03)


def test_correlated_parameters_of_which_not_all_runs_fit_into_memory_are_analyzed(monkeypatch):
    """By as many runs as fit, from all parts of them, and by terms of second order all the same."""
    vary = {("a", "b"): "normal([0, 0], [[1, 0.5], [0.5, 1]])", "c": "normal(0, 0.5)"}
    monkeypatch.setattr(crosscheck.sweeps.analysis, "MAX_ANALYZED_NUMBERS", 6 * 1000)
    found = effects(lambda a, b, c: a * b + c, vary)
    # of a b the variance is 1.25; of 1000 runs errors of a share s are about 4 (1 - s) sqrt(s / 1000)
    assert found["a, b"].share == pytest.approx(1.25 / 1.5, abs=0.04)
    assert share_of(found["a, b"]).startswith("≥ 8")
    assert not share_of(found["c"]).startswith("≥")


def test_runs_of_a_grid_that_are_analyzed_are_of_all_its_parts():
    grid = "grid(0, 1, 60)"
    found = effects(lambda a, b, c: a + b + c, {"a": grid, "b": grid, "c": grid}, "grid", None)
    assert MAX_SHARE_RUNS < 60**3
    # errors of a share s of that many runs are about 2 s / sqrt(MAX_SHARE_RUNS)
    assert [found[name].share for name in "abc"] == pytest.approx([1.0 / 3.0] * 3, abs=0.01)
    assert [found[name].rank for name in "abc"] == pytest.approx([found["a"].rank] * 3, abs=0.01)


def test_runs_of_equal_values_are_taken_together():
    grid = "grid(0, 1, 5)"
    found = effects(lambda a, b, c: a + b + c, {"a": grid, "b": grid, "c": grid}, "grid", None)
    assert [(found[name].low, found[name].high) for name in "abc"] == [pytest.approx((1.0, 2.0))] * 3


@pytest.mark.parametrize("block", [1, 5])
def test_runs_that_are_analyzed_are_all_or_one_of_each_part(block):
    assert sample_blocks(20, 20, block).tolist() == list(range(20))
    chosen = sample_blocks(1000, 7, block)
    assert len(chosen) == 7 * block
    assert np.all(np.diff(chosen) > 0)
    starts = chosen.reshape(-1, block)
    assert np.array_equal(starts, starts[:, :1] + np.arange(block))
    assert np.all(starts[:, 0] % block == 0)
    assert np.array_equal(starts[:, 0] * 7 // 1000, np.arange(7))


def test_what_does_not_vary_has_no_effects():
    assert effects(lambda a: 1.0 + 1e-13 * a, {"a": "normal(0, 1)"}) == {}
    assert effects(lambda a: np.nan * a, {"a": "normal(0, 1)"}) == {}


def test_base_samples_with_runs_that_could_not_go_on_are_left_out():
    def function(a, b, c, d):
        values = a + 0.1 * b + 0.0 * (c + d)
        values[7] = np.nan
        return values

    vary = dict.fromkeys("abcd", "normal(0, 1)")
    found = effects(function, vary, "saltelli", 6 * 256)
    assert [found[name].total for name in "abcd"] == pytest.approx([1.0, 0.01, 0.0, 0.0], abs=0.02)
    few = effects(lambda a, b, c, d: np.where(np.abs(a) > 0.3, np.nan, a + b), vary, "saltelli", 6 * 256)
    assert [few[name].share for name in "abcd"] == [None] * 4
    assert few["b"].rank > 0.9


def test_the_telling_number_of_a_variable_is_the_one_that_varies_most():
    values = np.array([[1.0, 2.0, 9.0], [2.0, 4.0, 9.1]])
    rows = [KeptNumber("peak", (k,), (str(k),), "N", values[:, k], np.arange(2)) for k in range(3)]
    rows.append(KeptNumber("final", (), (), "m", values[:, 0], np.arange(2)))
    assert [scalar.label for scalar in most_informative(rows)] == ["peak 1", "final"]
    assert [scalar.label for scalar in most_varying(rows)] == ["peak 1", "final", "peak 0", "peak 2"]


def test_numbers_that_vary_alike_are_chosen_by_their_order_whatever_the_samples():
    """Of two that are correlated, and one with a single run that is far away."""
    for seed in range(5):
        x, y = np.random.default_rng(seed).normal(size=(2, 300))
        far = np.where(np.arange(300) == seed, 1e6, 0.1 * x)
        columns = {"far": far, "one": x + 0.05 * y, "other": x - 0.05 * y}
        rows = [KeptNumber("peak", (), (name,), "N", each, np.arange(300)) for name, each in columns.items()]
        assert [scalar.label for scalar in most_varying(rows)] == ["peak one", "peak other", "peak far"]


@pytest.mark.parametrize("size", [1e-4, 1.0, 1e5])
def test_labels_of_scatter_plots_do_not_overlap_and_have_no_offset(size):
    values = np.linspace(-1.234, 1.234, 9)
    scalar = KeptNumber("final", (), (), "m", 0.923879 + 1e-7 * values, np.arange(9))
    found = [(scalar, [Effect(name, 0.0, 0.0) for name in "abc"])]
    figure = Figure(figsize=(8.0, 2.4), layout="constrained")
    axes = figure.subplots(1, SCATTER_COLUMNS, squeeze=False)
    _scatter(axes, found, np.arange(9), dict.fromkeys("abc", 1.1 * size + 0.1 * size * values), UNITS)
    figure.draw_without_rendering()
    for ax in axes[0]:
        boxes = [label.get_window_extent() for label in ax.get_xticklabels()]
        assert all(left.x1 < right.x0 for left, right in pairwise(boxes))
        offsets = [axis.get_offset_text().get_text() for axis in (ax.xaxis, ax.yaxis)]
        assert not any("+" in text for text in offsets)
    assert axes[0, 0].get_title(loc="left") == "final - 0.923879"
    assert axes[0, 0].get_ylabel() == "m"
    assert [ax.get_xlabel().rpartition(", ")[2] for ax in axes[0, :2]] == ["kg", "N/m"]


@pytest.mark.parametrize("size", [1e-200, 1.0, 1e200])
def test_deviations_are_those_of_numbers_of_any_size(size):
    scalar = KeptNumber("final", (), (), "m", size * np.array([1.0, 3.0, np.nan]), np.arange(3))
    assert scalar.deviation == pytest.approx(size, rel=1e-15)
