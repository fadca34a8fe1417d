"""Tolerances below the round-off of the equations: steps do not follow the noise, and a warning says so."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hanging_chains import hanging_chain, lagrange

from newton_euler.errors import RoundOffWarning
from newton_euler.model.forces import JointSpring
from newton_euler.model.joint_kinds import Prismatic
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.runs.batch import simulate_batch
from newton_euler.runs.simulate import simulate

MASSES, LENGTH, ANGLE = [0.01] * 19 + [1e3], 0.1, 1.2
RTOL = 1e-13


def chain():
    """Return a load of 1,000 kg on light links; the Cartesian form has a large round-off there."""
    return hanging_chain(MASSES, LENGTH, ANGLE, 0.01)


def test_steps_do_not_follow_round_off() -> None:
    scene = chain()
    with pytest.warns(RoundOffWarning) as heard:
        run = simulate(scene, "cartesian", rtol=RTOL, atol=RTOL / 100)
    with warnings.catch_warnings():  # joint coordinates, by articulated bodies, have no such round-off
        warnings.simplefilter("error", RoundOffWarning)
        relative = simulate(scene, "relative", rtol=RTOL, atol=RTOL / 100)
    assert run.settings["steps"] < 1.5 * relative.settings["steps"]
    exact = lagrange(MASSES, LENGTH, ANGLE, scene.times)
    for each in (run, relative):
        error = np.abs(each.position[:, 1:, ::2] - exact.transpose(0, 2, 1)).max()
        assert error < 1e-11  # the reference is no better than 1e-12 per step
    assert heard[0].message.excess == run.settings["round_off"]
    with warnings.catch_warnings():  # the tolerance that the warning names can be met
        warnings.simplefilter("error", RoundOffWarning)
        rtol = heard[0].message.rtol
        simulate(scene, "cartesian", rtol=rtol, atol=rtol / 100)


def test_default_tolerances_are_above_round_off() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error", RoundOffWarning)
        assert "round_off" not in simulate(chain(), "cartesian").settings


def test_batches_warn_once() -> None:
    masses = {"link_0.mass": [1e-3, 2e-3]}
    short = hanging_chain([1e-3] * 3 + [1e3], LENGTH, ANGLE, 0.01)
    with pytest.warns(RoundOffWarning) as heard:
        batch = simulate_batch(short, None, masses, formulation="cartesian", rtol=RTOL, atol=RTOL / 100)
    assert len(heard) == 1
    assert heard[0].message.excess == max(run.settings["round_off"] for run in batch)


def test_a_stiff_spring_is_no_round_off() -> None:
    """A spring of 1e8 N/m that yields 1e-7 m has the round-off of that length, not of the size."""
    body = Body("slider", 1.0, [0.0, 0.0, 0.0], 0.01 * np.eye(3))
    rail = Prismatic("rail", "ground", "slider", [0.0, 0.0, 0.0], axis=[1.0, 0.0, 0.0])
    damped = [JointSpring("rail", stiffness=1e8, damping=2.2e4)]
    mechanism = Mechanism([Body.ground(), body], [rail])
    scene = Scene("stiff", mechanism, 0.1, 0.05, gravity=[9.81, 0.0, 0.0], forces=damped)
    run = simulate(scene, "relative", rtol=1e-10, atol=1e-12)
    assert "round_off" not in run.settings
    assert run.position[-1, 1, 0] == pytest.approx(9.81e-8, abs=1e-12)  # atol
