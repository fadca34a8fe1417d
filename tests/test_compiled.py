"""Compiled scenes against their float form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mechanisms import REGULAR, planar_four_bar, seven_hinges

import newton_euler
from crosscheck.scenes import SCENES, load
from newton_euler import compile_scene
from newton_euler.assemble import random_states
from newton_euler.compiled import FORMULATIONS, formulate
from newton_euler.errors import IntegrationError
from newton_euler.integrate import Options
from newton_euler.simulate import run

LIBRARY = {name: lambda name=name: load(name) for name in SCENES}
BUILDS = LIBRARY | {build.__name__: build for build in REGULAR} | {"planar_four_bar": planar_four_bar}

CONDITION = {"slider_tree": 10.0}
"""Where accelerations differ by more than 1e-12 between any two forms, float forms among themselves too."""


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("name", BUILDS)
def test_accelerations_are_the_float_forms(name, formulation):
    scene = BUILDS[name]()
    system = formulate(scene, formulation)
    compiled = compile_scene(scene, formulation)
    tolerance = 1e-12 * CONDITION.get(name, 1.0)
    for state in random_states(scene, 1000 if name in LIBRARY else 20):
        q, v = system.coordinates(state)
        found = compiled.function("derivative")(compiled.packed(q, v))
        wanted = system.acceleration(q, v)
        assert found[-1] > 0.0
        assert np.abs(found[system.nq : -1] - wanted).max() < tolerance * max(np.abs(wanted).max(), 1.0)
        assert found[: system.nq] == pytest.approx(system.rate(q, v), rel=1e-13, abs=1e-14)


@pytest.mark.parametrize("formulation", ["relative", "cartesian"])
def test_runs_are_the_float_forms(tracker, formulation):
    """The same steps, so the same trajectory to the growth of round-off; scipy takes them in floats."""
    scene = replace(tracker, duration=0.5)
    compiled = newton_euler.simulate(scene, formulation, rtol=1e-10, atol=1e-12)
    floats = run(formulate(scene, formulation), "newton_euler", Options(rtol=1e-10, atol=1e-12), {})
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
    """No more than the limit study's 1,867; and 6,043, with a step of refinement on top."""
    assert compile_scene(tracker).operations["derivative"] <= 1867
    assert compile_scene(tracker, "cartesian").operations["derivative"] <= 7450


def test_gravity_costs_nothing_when_there_is_none(tracker):
    heavy = replace(tracker, gravity=(0.0, 0.0, -9.81), initial_state=None)
    light, with_gravity = (compile_scene(scene).operations["derivative"] for scene in (tracker, heavy))
    assert light < with_gravity


def test_outputs_that_are_not_asked_for_are_not_computed(tracker):
    everything = compile_scene(tracker).operations["output"]
    poses = compile_scene(replace(tracker, outputs=frozenset())).operations["output"]
    assert poses < 0.25 * everything


@pytest.mark.parametrize("stabilization", ["none", "projection"])
@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_redundant_loops_run(formulation, stabilization):
    scene = replace(planar_four_bar(), duration=0.2)
    floats = run(formulate(scene, formulation), "newton_euler", Options(projection=False), {})
    native = newton_euler.simulate(scene, formulation, stabilization=stabilization)
    energy = native.kinetic_energy + native.potential_energy
    assert np.ptp(energy) < 1e-9
    assert native.settings["dense"] == 0
    # without projection the loop opens by the integration error of 200 N bars: 1e-9 at rtol 1e-10
    assert np.abs(native.position - floats.position).max() < 1e-8
    assert np.abs(native.reaction_force - floats.reaction_force).max() < 1e-6


def test_a_singular_configuration_takes_the_dense_path():
    """Started flat, the planar loop has two freedoms in place of one; the float form knows how to go on."""
    scene = flat_four_bar()
    compiled = compile_scene(scene)
    system = compiled.system
    x = compiled.packed(*system.coordinates(scene.initial_state))
    assert compiled.function("derivative")(x)[-1] <= 0.0
    native = compile_scene(scene, stabilization="none").simulate()
    assert native.settings["dense"] > 0


def flat_four_bar():
    """A parallelogram with all four bars on one line."""
    from mechanisms import bar

    from newton_euler.joints import Revolute
    from newton_euler.mechanism import Body, Mechanism
    from newton_euler.scene import Scene

    points = {"a": [0.0, 0.0, 0.0], "b": [0.5, 0.0, 0.0], "c": [1.5, 0.0, 0.0], "d": [1.0, 0.0, 0.0]}
    bodies = [Body.ground()]
    bodies += [bar(f"{i}{j}", points[i], points[j]) for i, j in ("ab", "bc", "dc")]
    names = {"a": ("ground", "ab"), "b": ("ab", "bc"), "c": ("bc", "dc"), "d": ("ground", "dc")}
    joints = [Revolute(p, *names[p], points[p], axis=[0.0, 1.0, 0.0]) for p in "abcd"]
    return Scene("flat", Mechanism(bodies, joints), 0.01, 0.01, (0.0, 0.0, -9.81))


def test_a_step_limit_is_reported(monkeypatch):
    monkeypatch.setattr("newton_euler.steppers.run.MOST_STEPS", 3)
    with pytest.raises(IntegrationError, match=r"stopped at t = .* more than 3 steps"):
        newton_euler.simulate(seven_hinges())
