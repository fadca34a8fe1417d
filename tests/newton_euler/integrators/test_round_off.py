"""Tolerances below the round-off of the equations: steps do not follow the noise, and a warning says so."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hanging_chains import hanging_chain, lagrange

from newton_euler.batch import simulate_batch
from newton_euler.errors import RoundOffWarning
from newton_euler.simulate import simulate

LINKS, LENGTH, ANGLE = 20, 0.1, 1.2
RTOL = 1e-13


def chain():
    return hanging_chain([0.2] * LINKS, LENGTH, ANGLE, 0.3)


def test_steps_do_not_follow_round_off() -> None:
    """Joint coordinates of 20 links have accelerations of 500 rad/s^2 with a round-off of 5e-10 rad/s^2."""
    scene = chain()
    with pytest.warns(RoundOffWarning) as heard:
        run = simulate(scene, "relative", rtol=RTOL, atol=RTOL / 100)
    cartesian = simulate(scene, "cartesian", rtol=RTOL, atol=RTOL / 100)
    assert run.settings["steps"] < 1.5 * cartesian.settings["steps"]
    exact = lagrange([0.2] * LINKS, LENGTH, ANGLE, scene.times)
    error = np.abs(run.position[:, 1:, ::2] - exact.transpose(0, 2, 1)).max()
    assert error < 1e-11  # the reference is no better than 1e-12 per step
    assert heard[0].message.excess == run.settings["round_off"]
    with warnings.catch_warnings():  # the tolerance that the warning names can be met
        warnings.simplefilter("error", RoundOffWarning)
        rtol = heard[0].message.rtol
        simulate(scene, "relative", rtol=rtol, atol=rtol / 100)


def test_default_tolerances_are_above_round_off() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error", RoundOffWarning)
        assert "round_off" not in simulate(chain(), "relative").settings


def test_batches_warn_once() -> None:
    masses = {"link_0.mass": [0.2, 0.3]}
    with pytest.warns(RoundOffWarning) as heard:
        batch = simulate_batch(chain(), None, masses, formulation="relative", rtol=RTOL, atol=RTOL / 100)
    assert len(heard) == 1
    assert heard[0].message.excess == max(run.settings["round_off"] for run in batch)
