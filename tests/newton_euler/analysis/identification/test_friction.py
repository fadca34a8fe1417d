"""Identification of dry friction: starts, bounds, joints that stick, and friction that a scene lacks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mechanisms import MASS, STIFFNESS, line_spring, mass_on_rail

from newton_euler import (
    IdentificationWarning,
    JointFriction,
    Measurements,
    identify,
    sensitivities,
    simulate,
    with_parameters,
)

AMPLITUDE = 0.2
"""m, of the mass on its spring at the start, where it is at rest."""

COULOMB = "rail.friction.coulomb"

NAMES = ["mass.mass", "line.damping", COULOMB]


def oscillator(coulomb=None, damping=0.5, duration=3.0, **fields):
    """A mass on a spring with a damper and dry friction, thrown out of balance by `AMPLITUDE`."""
    scene = mass_on_rail(line_spring(rest_length=2.0 - AMPLITUDE, damping=damping))
    scene = replace(scene, duration=duration, output_period=0.02)
    if coulomb is None:
        return scene
    return replace(scene, forces=(*scene.forces, JointFriction("rail", coulomb, **fields)))


def measured(scene, noise=1e-4, seed=0):
    """Noisy coordinates of the rail."""
    run, rng = simulate(scene), np.random.default_rng(seed)
    column = run.joint("rail").coordinates[:, 0] + noise * rng.normal(size=len(run.time))
    return Measurements(run.time, {"coordinate.rail": column}, {"coordinate.rail": noise})


def test_derivatives_at_zero_friction_are_those_of_the_first_friction():
    """A period later the amplitude is smaller by 4 F / k, for friction F (Coulomb's oscillator)."""
    period = 2.0 * np.pi * np.sqrt(MASS / STIFFNESS)
    scene = oscillator(0.0, damping=0.0, transition_speed=1e-4)
    scene = replace(scene, duration=period, output_period=period)
    by = sensitivities(scene, [COULOMB], rtol=1e-11, atol=1e-13)
    # the mass begins at 0 and swings about its rest; the transition at 1e-4 of the largest rate, 1 m/s
    assert abs(by.position[-1, 1, 2, 0]) == pytest.approx(4.0 / STIFFNESS, rel=1e-3)


@pytest.mark.parametrize("guess", [0.0, 0.3, 0.6])
def test_friction_is_found_from_any_start(guess):
    truth = oscillator(0.3)
    wrong = with_parameters(truth, {"mass.mass": 1.9, "line.damping": 0.4, COULOMB: guess})
    found = identify(wrong, NAMES, measured(truth))
    assert found.doubts == []
    # five deviations: once in two million times
    assert np.all(np.abs(found.values - [MASS, 0.5, 0.3]) < 5.0 * found.standard_deviations)
    assert found.standard_deviations[2] < 0.01


@pytest.mark.parametrize("guess", [(0.0, 0.0, 0.05), (0.6, 0.4, 0.1)])
def test_the_stribeck_curve_is_found(guess):
    truth = oscillator(0.3, 0.1, stribeck=0.2, stribeck_speed=0.05)
    names = [*NAMES, "rail.friction.stribeck", "rail.friction.stribeck_speed"]
    found = identify(
        with_parameters(truth, dict(zip(names[2:], guess, strict=True))), names, measured(truth, 1e-5)
    )
    assert found.doubts == []
    assert np.all(np.abs(found.values - [MASS, 0.1, 0.3, 0.2, 0.05]) < 5.0 * found.standard_deviations)


@pytest.mark.parametrize("guess", [0.0, 0.3])
@pytest.mark.parametrize(("seed", "held"), [(0, False), (1, True), (2, True), (3, False)])
def test_friction_that_noise_would_make_negative_is_held_at_zero(seed, held, guess):
    """Other parameters are those of the fit of a scene without friction."""
    data = measured(oscillator(), seed=seed)
    found = identify(oscillator(guess), NAMES, data)
    assert found.doubts == []
    assert found.at_bound == ((COULOMB,) if held else ())
    if not held:
        assert 0.0 < found.values[2] < 5.0 * found.standard_deviations[2]
        return
    without = identify(oscillator(), NAMES[:2], data)
    assert found.values[2] == 0.0
    assert found.values[:2] == pytest.approx(without.values, rel=1e-6)
    assert found.standard_deviations[:2] == pytest.approx(without.standard_deviations, rel=1e-4)
    assert np.isnan(found.standard_deviations[2])
    assert found.misfit == pytest.approx(without.misfit, rel=1e-6)
    assert found.table[3][-1] == "at edge"


def test_a_friction_alone_may_be_held():
    """Nothing is left to fit; the scene, of too much damping, is wrong."""
    with pytest.warns(IdentificationWarning, match="cannot move as measured"):
        found = identify(oscillator(0.2, damping=0.7), [COULOMB], measured(oscillator(damping=0.6)))
    assert found.at_bound == (COULOMB,)
    assert found.values.tolist() == [0.0]


def test_the_speed_of_a_stribeck_effect_that_is_not_there_is_not_identifiable():
    names = [*NAMES, "rail.friction.stribeck", "rail.friction.stribeck_speed"]
    guess = oscillator(0.3, stribeck=0.2, stribeck_speed=0.05)
    with pytest.warns(IdentificationWarning, match="identifiable"):
        found = identify(guess, names, measured(oscillator(0.3)))
    assert not found.is_wrong
    assert np.isfinite(found.values).all()
    assert not np.isfinite(found.standard_deviations[4])
    assert found.values[4] >= 1e-3  # the transition speed
    assert np.all(np.abs(found.values[:3] - [MASS, 0.5, 0.3]) < 5.0 * found.standard_deviations[:3])


def test_friction_of_a_joint_that_sticks_is_not_identifiable():
    """The spring pulls with 10 N: what a fit finds from the creep has no small deviation."""
    truth = oscillator(20.0)
    with pytest.warns(IdentificationWarning, match="joint rail sticks in all runs"):
        found = identify(oscillator(40.0), [COULOMB], measured(truth))
    assert np.isinf(found.standard_deviations).tolist() == [True]
    assert found.table[1][-1] == "-"


def test_friction_that_the_scene_lacks_is_suggested():
    truth = oscillator(0.3)
    with pytest.warns(IdentificationWarning, match="residuals change with the direction of joint rail"):
        found = identify(oscillator(), NAMES[:2], measured(truth))
    assert found.is_wrong
    assert found.missing_friction is not None
    assert found.missing_friction.coulomb == {"rail": pytest.approx(0.3, rel=0.05)}
    assert found.missing_friction.misfit < 0.1 * found.misfit


@pytest.mark.parametrize(
    ("changes", "names"),
    [
        ({"mass.mass": 2.2}, ["line.damping"]),
        ({"line.stiffness": 45.0}, ["line.damping"]),
        ({"line.damping": 0.9}, ["mass.mass"]),
        ({"line.rest_length": 1.81}, ["mass.mass", "line.damping"]),
    ],
)
def test_no_friction_is_suggested_for_other_errors(changes, names):
    with pytest.warns(IdentificationWarning, match="cannot move as measured"):
        found = identify(with_parameters(oscillator(), changes), names, measured(oscillator()))
    assert found.is_wrong
    assert found.missing_friction is None


def test_no_friction_is_suggested_for_noise():
    """Neither if the noise is right, nor if it is larger than given."""
    data = measured(oscillator())
    assert identify(oscillator(), NAMES[:2], data).missing_friction is None
    with pytest.warns(IdentificationWarning, match="noise is larger than given"):
        found = identify(oscillator(), NAMES[:2], replace(data, noise={"coordinate.rail": 3e-5}))
    assert found.missing_friction is None
