"""Compiled scenes against their float form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mechanisms import REGULAR, planar_four_bar, seven_hinges

import newton_euler
from crosscheck.scenes import SCENES, load
from newton_euler.assemble import random_states
from newton_euler.cartesian import Cartesian
from newton_euler.compiled import CompiledSystem
from newton_euler.errors import IntegrationError
from newton_euler.integrate import Options
from newton_euler.relative import Relative
from newton_euler.simulate import run

FORMULATIONS = (Relative, Cartesian)
LIBRARY = {name: lambda name=name: load(name) for name in SCENES}
BUILDS = LIBRARY | {build.__name__: build for build in REGULAR}


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("name", BUILDS)
def test_accelerations_are_the_float_forms(name, formulation):
    system = formulation(BUILDS[name]())
    derivative = CompiledSystem(system).functions["derivative"]
    for state in random_states(system.scene, 1000 if name in LIBRARY else 20):
        q, v = system.coordinates(state)
        found = derivative(np.concatenate([q, v, [0.0]]))
        wanted = system.acceleration(q, v)
        assert found[-1] > 0.0
        # the same equations eliminated in another order: round-off times condition, 1e4 at most
        assert np.abs(found[system.nq : -1] - wanted).max() < 1e-12 * max(np.abs(wanted).max(), 1.0)
        assert found[: system.nq] == pytest.approx(system.rate(q, v), rel=1e-13, abs=1e-14)


@pytest.mark.parametrize("formulation", ["relative", "cartesian"])
def test_runs_are_the_float_forms(tracker, formulation):
    """The same steps, so the same trajectory to the growth of round-off; scipy takes them in floats."""
    scene = replace(tracker, duration=0.5)
    compiled = newton_euler.simulate(scene, formulation, rtol=1e-10, atol=1e-12)
    system = {"relative": Relative, "cartesian": Cartesian}[formulation](scene)
    floats = run(system, "newton_euler", Options(rtol=1e-10, atol=1e-12), {})
    for name, tolerance in (
        ("position", 1e-11),  # round-off shifts a step size, and errors are 1e-12 a step
        ("quaternion", 2e-10),
        ("reaction_force", 1e-8),
        ("reaction_torque", 1e-9),
        ("actuator_force", 1e-9),
    ):
        assert np.abs(getattr(compiled, name) - getattr(floats, name)).max() < tolerance, name
    assert compiled.kinetic_energy == pytest.approx(floats.kinetic_energy, abs=1e-10)
    assert compiled.constraint_violation.max() < 1e-14


def test_operations_of_the_tracker(tracker):
    """No more than the limit study's 1,867 and 6,043, checks of the pivots included."""
    counts = {
        formulation: CompiledSystem(formulation(tracker)).programs["derivative"].operations
        for formulation in FORMULATIONS
    }
    assert counts[Relative] <= 1867
    assert counts[Cartesian] <= 6150


def test_gravity_costs_nothing_when_there_is_none(tracker):
    heavy = replace(tracker, gravity=(0.0, 0.0, -9.81), initial_state=None)
    light = CompiledSystem(Relative(tracker)).programs["derivative"].operations
    assert light < CompiledSystem(Relative(heavy)).programs["derivative"].operations


def test_outputs_that_are_not_asked_for_are_not_computed(tracker):
    everything = CompiledSystem(Relative(tracker)).output[1].operations
    poses = CompiledSystem(Relative(replace(tracker, outputs=frozenset()))).output[1].operations
    assert poses < 0.25 * everything


@pytest.mark.parametrize("formulation", ["relative", "cartesian"])
def test_redundant_loops_take_the_dense_path(formulation):
    scene = replace(planar_four_bar(), duration=0.2)
    run = newton_euler.simulate(scene, formulation, stabilization="none")
    energy = run.kinetic_energy + run.potential_energy
    assert np.ptp(energy) < 1e-9


def test_a_step_limit_and_stiffness_are_reported(monkeypatch):
    import newton_euler.fast

    monkeypatch.setattr(newton_euler.fast, "MOST_STEPS", 3)
    with pytest.raises(IntegrationError, match="stopped at t = .*steps"):
        newton_euler.simulate(seven_hinges())
