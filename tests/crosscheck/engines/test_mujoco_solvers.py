"""MuJoCo's constraint solvers as settings of the engine, of benchmarks and of stress tests."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from crosscheck.engines.mujoco import ENGINE
from crosscheck.engines.mujoco.benchmark import BENCHMARKS
from crosscheck.library import load
from mjcf.constraint_solver import SOLVERS
from newton_euler.errors import UnknownNameError


def solvers_of_ladders(name):
    """Return the names of solvers in the ladders of a scene; None stands for the default."""
    ladders = BENCHMARKS.models(load(name))["MJCF"]().ladders
    return {ladder.common.get("solver") for ladder in ladders}


def test_the_engine_simulates_with_each_solver():
    scene = replace(load("four_bar"), duration=0.1)
    for solver in SOLVERS:
        assert ENGINE.simulate(scene, {"solver": solver}).settings["solver"] == solver
    with pytest.raises(UnknownNameError, match="choose from: Newton, CG, PGS"):
        ENGINE.simulate(scene, {"solver": "SOR"})


def test_benchmarks_have_solvers_for_scenes_with_constraints_only():
    assert solvers_of_ladders("four_bar") == {None, "CG", "PGS"}
    assert solvers_of_ladders("pendulum") == {None}


def test_a_benchmark_runs_each_solver_it_names():
    """The settings share one compiled model, so that each run has to set its own solver."""
    model = BENCHMARKS.models(replace(load("tracker"), duration=0.1))["MJCF"]()
    options = {"number": 5, "integrator": "RK4", "damping_ratio": 1.0}
    wanted, _ = model.run(options).poses()
    for solver in ("CG", "PGS"):
        found, _ = model.run({**options, "solver": solver}).poses()
        assert 0.0 < np.max(np.abs(found - wanted)) < 1e-8
    again, _ = model.run(options).poses()
    assert np.array_equal(again, wanted)


def test_stress_tests_of_masses_have_each_solver():
    masses = ENGINE.stress().topics["masses"]
    assert {options.get("solver", "Newton") for options in masses} == set(SOLVERS)
