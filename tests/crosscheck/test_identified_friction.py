"""Mass, viscous and Coulomb friction of the tracker from noisy motions that Pinocchio made."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import binom, chi2, norm

import urdf
from crosscheck.library import load
from newton_euler import (
    IdentificationWarning,
    JointFriction,
    JointSpring,
    Measurements,
    identify,
    with_parameters,
)

TRUTH = {
    "panel_7.mass": 0.95,
    "slide_12.spring.damping": 2.0,
    "slide_13.spring.damping": 3.0,
    "slide_12.friction.coulomb": 0.3,
    "slide_13.friction.coulomb": 0.2,
}

NOISE = {"coordinate.slide_12": 1e-5, "coordinate.slide_13": 1e-5, "coordinate.hinge_14": 1e-4}
"""m, m, rad."""

FAST_TRIALS = 10

RARE = 1e-6
"""Probability with which chance fails the fast test if it is right."""


def tracker():
    """The tracker under gravity, with viscous and dry friction of both slides."""
    scene = replace(load("tracker_gravity"), duration=2.0, output_period=0.02)
    slides = ("slide_12", "slide_13")
    viscous = [JointSpring(slide, damping=1.0) for slide in slides]
    dry = [JointFriction(slide, 0.1, transition_speed=2e-3) for slide in slides]
    return replace(scene, forces=(*scene.forces, *viscous, *dry))


@cache
def motion():
    """Columns of the motion by Pinocchio, without noise."""
    run = urdf.simulate(with_parameters(tracker(), TRUTH), rtol=1e-9, atol=1e-11)
    columns = {name: run.joint(name.partition(".")[2]).coordinates[:, 0] for name in NOISE}
    return run.time, columns


def errors(seed):
    """Errors of the fitted parameters (5,), in standard deviations, of one realization of the noise.

    The fit begins at a third to a half of the true friction.
    """
    time, exact = motion()
    rng = np.random.default_rng(seed)
    columns = {name: exact[name] + level * rng.normal(size=len(time)) for name, level in NOISE.items()}
    scene = tracker()
    found = identify(scene, list(TRUTH), Measurements(time, columns, NOISE))
    assert found.doubts == []
    return (found.values - list(TRUTH.values())) / found.standard_deviations


@pytest.mark.slow
def test_friction_is_recovered_within_its_uncertainty():
    """Squares of the errors of each parameter add up to chi squared."""
    squares = np.sum([errors(seed) ** 2 for seed in range(FAST_TRIALS)], axis=0)
    assert np.all(squares > chi2.ppf(RARE, FAST_TRIALS))
    assert np.all(squares < chi2.isf(RARE, FAST_TRIALS))


@pytest.mark.slow
def test_friction_of_drives_is_suggested():
    """Without the elements of dry friction the tracker cannot move as measured; one of the two is named."""
    time, exact = motion()
    columns = {name: exact[name] + level * np.sin(1e4 * time) for name, level in NOISE.items()}
    scene = tracker()
    bare = replace(scene, forces=tuple(each for each in scene.forces if not isinstance(each, JointFriction)))
    bare = with_parameters(bare, {name: value for name, value in TRUTH.items() if name.endswith("damping")})
    with pytest.warns(IdentificationWarning, match="residuals change with the direction of joint slide_1"):
        found = identify(bare, ["panel_7.mass"], Measurements(time, columns, NOISE))
    assert found.missing_friction is not None
    assert set(found.missing_friction.coulomb) <= {"slide_12", "slide_13"}


@pytest.mark.slow
def test_true_values_are_in_their_intervals_in_95_percent_of_the_trials():
    """Of each parameter, in 200 trials: 91 to 98 %, bounds that chance leaves less than once in 60 times."""
    trials = 200
    inside = np.sum([np.abs(errors(1000 + seed)) < norm.isf(0.025) for seed in range(trials)], axis=0)
    assert 1.0 - (binom.cdf(196, trials, 0.95) - binom.cdf(181, trials, 0.95)) < 1.0 / 60.0
    assert np.all((inside >= 182) & (inside <= 196)), inside.tolist()
