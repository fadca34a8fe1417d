"""Identification from motions that Pinocchio made, with noise; `crosscheck identify`."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from command_line import run
from mechanisms import planar_four_bar
from scipy.stats import binom, chi2, norm

import urdf
from crosscheck.library import load
from newton_euler import JointSpring, Measurements, identify, with_parameters
from newton_euler.analysis.identification.identify import MAX_CURVATURE
from newton_euler.analysis.sensitivity.tangent_starts import own_numbers

RARE = 1e-6
"""Probability with which chance fails a test that is right."""

LEVEL = 0.95


def tracker():
    """The tracker under gravity, its own start, and ten of its parameters."""
    scene = replace(load("tracker_gravity"), duration=3.0, output_period=0.03)
    masses = ["panel_7.mass", "panel_7.center_of_mass.z", "column_4.mass", "leg_5.mass", "leg_6.mass"]
    laws = ["slide_12.stiffness", "slide_12.damping", "slide_13.stiffness", "slide_13.damping"]
    return scene, [{}], [*masses, *laws, "slide_12.target"], ("slide_12", "slide_13", "hinge_14")


def four_bar():
    """A four-bar of unequal bars with springs, two starts, and ten of its parameters."""
    springs = (
        JointSpring("at_a", 3.0, 0.15, 0.4),
        JointSpring("at_b", 2.0, 0.1, -0.3),
        JointSpring("at_d", 1.0, 0.12, 0.5),
    )
    scene = replace(planar_four_bar(), forces=springs, duration=4.0, output_period=0.04)
    masses = ["crank.mass", "coupler.mass", "rocker.mass", "coupler.center_of_mass.x"]
    of_springs = [f"{joint}.spring.{name}" for joint in ("at_a", "at_b") for name in ("stiffness", "damping")]
    second = {"start.at_a": 0.6, "start.at_a.rate": 0.0}
    names = [*masses, "coupler.center_of_mass.z", *of_springs, "at_d.spring.rest"]
    return scene, [{}, second], names, ("at_a", "at_d")


@cache
def case(make):
    """Exact motions by Pinocchio, the scene with its parameters off by a few percent, and the true ones."""
    scene, starts, names, joints = make()
    runs = []
    for begun in starts:
        motion = urdf.simulate(with_parameters(scene, begun) if begun else scene, rtol=1e-11, atol=1e-13)
        columns = {f"coordinate.{name}": motion.joint(name).coordinates[:, 0] for name in joints}
        runs.append(Measurements(motion.time, columns, dict.fromkeys(columns, NOISE), begun))
    truth = own_numbers(scene, names)
    off = truth * (1.0 + np.random.default_rng(11).uniform(-0.05, 0.05, len(truth)))
    return with_parameters(scene, dict(zip(names, off, strict=True))), names, truth, runs


def with_noise(run, rng):
    columns = {name: column + NOISE * rng.normal(size=len(column)) for name, column in run.columns.items()}
    return replace(run, columns=columns)


NOISE = 1e-4
"""m or rad."""


def trial(make, seed):
    """Errors of fitted parameters in standard deviations, all together by the covariance, and misfit.

    The misfit, by how much the true ones fit worse, is a difference of sums of squares, distributed as chi
    squared of the number of parameters. So is the square of all errors by the covariance, unless
    uncertainties are so large that the region around the fit is bent: the ellipsoid of 95 % has the true
    parameters in 52 of 60 trials of the tracker; of the four-bar, whose parameters are known to 0.1 to 1 %
    and correlated by up to 0.99, in half of the trials at this noise, in 71 of 80 at 3 % of it.
    """
    scene, names, truth, runs = case(make)
    rng = np.random.default_rng(seed)
    noisy = [with_noise(each, rng) for each in runs]
    found = identify(scene, names, noisy)
    assert found.undetermined == ()
    assert found.stopped == ""
    assert found.curvature > MAX_CURVATURE
    assert len(found.notes) == 1
    pairs = zip(noisy, runs, found.residuals, strict=True)
    worse = 0.0
    for measured, exact, residuals in pairs:
        for name, column in measured.columns.items():  # what Pinocchio made has the true parameters
            worse += np.sum((column - exact.columns[name]) ** 2) - np.sum(residuals[name] ** 2)
    errors = found.values - truth
    together = errors @ np.linalg.solve(found.covariance, errors)
    return errors / found.standard_deviations, together, worse / NOISE**2


def is_chi_squared(squares, count):
    """True if a sum of squares of so many normal numbers is neither too small nor too large."""
    return chi2.ppf(RARE, count) < squares < chi2.isf(RARE, count)


@pytest.mark.parametrize("make", [tracker, pytest.param(four_bar, marks=pytest.mark.slow)])
def test_ten_parameters_are_recovered_within_their_uncertainty(make):
    """Sums of chi squared of ten are distributed as chi squared of their number."""
    trials = 3
    errors, together, worse = zip(*(trial(make, seed) for seed in range(trials)), strict=True)
    assert is_chi_squared(sum(worse), 10 * trials)
    # errors beyond this are as rare, in any of them
    assert np.abs(errors).max() < norm.isf(0.5 * RARE / (10 * trials))
    if make is tracker:  # whose region is bent less
        assert is_chi_squared(sum(together), 10 * trials)


@pytest.mark.slow
@pytest.mark.parametrize("make", [tracker, four_bar])
def test_uncertainties_are_right_in_many_trials(make):
    """Each parameter is in its interval of 95 %, and all are in their region, in 95 % of 200 trials.

    As far as counts tell, which cannot say that intervals are too large: squares of errors do.
    """
    trials = 200
    errors, _, worse = map(np.array, zip(*(trial(make, 1000 + seed) for seed in range(trials)), strict=True))
    inside = np.sum(np.abs(errors) < norm.isf(0.5 * (1.0 - LEVEL)), axis=0)
    assert inside.min() >= binom.ppf(RARE, trials, LEVEL)
    assert np.sum(worse < chi2.ppf(LEVEL, 10)) >= binom.ppf(RARE, trials, LEVEL)
    assert all(is_chi_squared(squares, trials) for squares in np.sum(errors**2, axis=0))
    assert is_chi_squared(worse.sum(), 10 * trials)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Measurements of the tracker with a heavier panel."""
    motion = urdf.simulate(with_parameters(load("tracker_gravity"), {"panel_7.mass": 0.95}))
    path = tmp_path_factory.mktemp("measured") / "motion.csv"
    noise, rng = 1e-5, np.random.default_rng(3)
    rows = [f"time,coordinate.slide_12,coordinate.slide_13\nnoise,{noise},{noise}"]
    slides = np.hstack([motion.joint(name).coordinates for name in ("slide_12", "slide_13")])
    for t, places in zip(motion.time, slides + noise * rng.normal(size=slides.shape), strict=True):
        rows.append(",".join(map(str, (t, *places))))
    path.write_text("\n".join(rows))
    return path


def test_identify_prints_a_table_and_writes_its_numbers(capsys, tmp_path, data):
    fit = ("--fit", "panel_7.mass", "--fit", "slide_12.stiffness")
    status, out, err = run(capsys, "identify", "tracker_gravity", data, *fit, "--output", tmp_path)
    assert (status, err) == (0, "")
    assert "tracker_gravity: 2 parameters fitted to 1,002 numbers of 1 run" in " ".join(out.split())
    assert all(len(line) <= 80 for line in out.splitlines() if str(tmp_path) not in line)
    found = json.loads((tmp_path / "identify.json").read_text())
    mass = found["parameters"]["panel_7.mass"]
    # five deviations: once in two million times
    assert abs(mass["fitted"] - 0.95) < 5.0 * mass["deviation"] < 1e-2
    assert found["undetermined"] == []
    assert run(capsys, "report", tmp_path)[0] == 0
    assert "reduced chi-squared" in (tmp_path / "report.html").read_text()


def test_identify_names_what_the_data_do_not_determine(capsys, tmp_path, data):
    """Status 3: not all of it was found."""
    fit = ("--fit", "panel_7.mass", "--fit", "slider_2.inertia.xx")
    status, out, _ = run(capsys, "identify", "tracker_gravity", data, *fit, "--output", tmp_path)
    assert status == 3
    assert "slider_2.inertia.xx is not identifiable" in out
    found = json.loads((tmp_path / "identify.json").read_text())
    assert found["parameters"]["slider_2.inertia.xx"]["deviation"] == "inf"


@pytest.mark.slow
def test_identify_says_if_the_scene_cannot_move_as_was_measured(capsys, tmp_path, data):
    """Status 3: values are not to be trusted."""
    fit = ("--fit", "panel_7.mass")
    status, out, _ = run(capsys, "identify", "tracker", data, *fit, "--output", tmp_path)
    assert status == 3
    assert "the scene cannot move as measured" in " ".join(out.split())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["tracker_gravity", "none.csv", "--fit", "panel_7.mass"], "none.csv: cannot be read"),
        (["tracker_gravity", "DATA", "--fit", "panel_7.color"], "unknown parameter 'panel_7.color'"),
        (["pendulum", "DATA", "--fit", "dumbbell.mass"], "unknown column 'coordinate.slide_12'"),
        (["tracker_gravity", "DATA", "--fit", "panel_7.mass", "--output", "DATA"], "cannot write"),
        (["tracker_gravity", "DATA"], "Missing option '--fit'"),
    ],
)
def test_bad_input_is_one_line(capsys, tmp_path, data, monkeypatch, arguments, message):
    monkeypatch.chdir(tmp_path)
    status, out, err = run(capsys, "identify", *(str(data) if word == "DATA" else word for word in arguments))
    assert (status, out) == (2, "")
    assert len(err.splitlines()) == 1
    assert message in err
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]
