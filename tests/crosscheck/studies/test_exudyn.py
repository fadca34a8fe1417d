"""Scenes in Exudyn move as in newton_euler."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import newton_euler
from crosscheck.errors import CrosscheckError
from crosscheck.scenes import load
from crosscheck.studies.benchmark import exudyn
from crosscheck.studies.benchmark.batch import Exudyn
from crosscheck.studies.benchmark.ladders import poses_only
from crosscheck.studies.benchmark.reference import pose_errors
from newton_euler.exercise import random_states
from newton_euler.model.forces import JointSpring

pytest.importorskip("exudyn")


def moving(name, **options):
    """The scene for 0.2 s from two random states, and newton_euler's poses."""
    scene = replace(poses_only(load(name, **options)), duration=0.2, output_period=0.05)
    if name == "chain":
        scene = replace(scene, forces=(JointSpring("hinge_1", 30.0, 2.0, 0.1),))
    states = random_states(scene, 2)
    runs = [newton_euler.simulate(replace(scene, initial_state=state), rtol=1e-12) for state in states]
    return scene, states, [(run.position, run.quaternion) for run in runs]


@pytest.mark.parametrize(
    ("name", "element", "solver", "order", "number"),
    [
        ("tracker", "bodies", "GeneralizedAlpha", 2, 20),
        ("tracker", "tree", "GeneralizedAlpha", 2, 20),
        ("four_bar", "bodies", "GeneralizedAlpha", 2, 20),
        ("four_bar", "tree", "GeneralizedAlpha", 2, 20),
        ("stewart", "bodies", "GeneralizedAlpha", 2, 20),
        ("slider_crank", "bodies", "GeneralizedAlpha", 2, 20),
        ("chain", "tree", "RK44", 4, 5),
    ],
)
def test_runs_converge_to_newton_eulers(name, element, solver, order, number):
    scene, states, exact = moving(name)
    engine = Exudyn(scene)
    errors = []
    for n in (number, 2 * number):
        options = {"element": element, "solver": solver, "number": n}
        done = engine.run(options, states, threads=1)
        assert done.failed == 0
        errors.append(max(max(pose_errors(*pair)) for pair in zip(done.poses(), exact, strict=True)))
    # at half the step the error of the method's order is left, with a fifth for those of higher order
    assert errors[1] < 1.2 * 0.5**order * errors[0]
    assert errors[0] < 1e-3


def test_processes_make_the_same_runs():
    scene, states, _ = moving("four_bar")
    options = {"element": "tree", "solver": "GeneralizedAlpha", "number": 2}
    engine = Exudyn(scene)
    one, two = (engine.run(options, states, threads=n).poses() for n in (1, 2))
    assert all(np.array_equal(a, b) for k in range(2) for a, b in zip(one[k], two[k], strict=True))


@pytest.mark.parametrize(("name", "problem"), [("tracker_on_boat", "motion"), ("tracker_wind", "wind")])
def test_what_is_not_translated_is_refused(name, problem):
    with pytest.raises(CrosscheckError, match=f"{problem}.*no translation to Exudyn"):
        exudyn.redundant(load(name))
