"""Energies of `crosscheck stress`: what of an error is round-off, and what a method adds by itself."""

from __future__ import annotations

import re

import pytest

from crosscheck.studies.stress import integration, rotation
from crosscheck.studies.stress.cases import of_run
from crosscheck.studies.stress.runs import TIGHT, newton_euler


def noted(setting, scene, duration):
    """The energy error of a run and the round-off in it."""
    found = integration.measure_energy(scene, duration, setting)
    return found.figure, float(re.match(r"accumulated round-off (\S+);", found.note)[1])


def test_round_off_is_told_from_errors_of_the_method():
    """Next to passages of flat bars all of a tight run's error is round-off, next to none of a pendulum's."""
    error, rounding = noted(TIGHT, "four_bar", 20.0)
    assert 0.05 * error < rounding < 20.0 * error
    error, rounding = noted(newton_euler(integrator="RK4", step=1e-2), "pendulum", 50.0)
    assert 0.0 < rounding < 1e-5 * error


def test_an_error_far_from_round_off_is_not_held_against_it():
    found = integration.measure_energy("pendulum", 20.0, newton_euler(integrator="Euler", step=1e-2))
    assert found.figure > 1e-3
    assert "round-off" not in found.note


def test_energy_of_fixed_steps_is_what_the_gyroscopic_torque_adds():
    """To first order h omega^2 T times a number of the body's: ten times less with a tenth of the step."""
    errors = [
        of_run(
            rotation.top(rotation.FAST, 1.0),
            rotation.kinetic_energy,
            newton_euler(form, integrator="Euler", step=step),
        ).figure
        for form in ("relative", "cartesian")
        for step in (1e-4, 1e-5)
    ]
    assert errors[0] / errors[1] == pytest.approx(10.0, rel=0.05)
    assert errors[2:] == pytest.approx(errors[:2], rel=1e-6)  # the same method in other coordinates
