"""Consistent states: what runs start from, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from armed_scenes import COMPOUNDS
from elements import COUPLED, ELEMENTS
from mechanisms import ball_loop, pendulum

from crosscheck.library import load
from newton_euler import State, assemble
from newton_euler.compiled.formulations import FORMULATIONS
from newton_euler.errors import MechanismError
from newton_euler.model.mechanism import CLOSURE_TOLERANCE
from newton_euler.reading.excitation import random_states
from newton_euler.runs.assemble import check_states, coordinates_of, initial_state
from newton_euler.runs.simulate import CompiledScene


def moved(state: State, quantity: str, body: int, change: list[float]) -> State:
    values = getattr(state, quantity).copy()
    values[body] += change
    return replace(state, **{quantity: values})


def test_velocities_must_meet_the_joints():
    scene = pendulum()  # the rod lies along x, its hinge along y
    sideways = moved(initial_state(scene), "linear_velocity", 1, [0.0, 0.5, 0.0])
    with pytest.raises(MechanismError) as caught:
        initial_state(replace(scene, initial_state=sideways))
    assert "joint 'pivot': opens at 0.5 m/s in the initial state" in str(caught.value)
    assert "newton_euler.assemble(scene, guess)" in str(caught.value)
    # about its center's path: the pivot stays, but the hinge tilts
    tilting = moved(initial_state(scene), "linear_velocity", 1, [0.0, 1.0, 0.0])
    tilting = moved(tilting, "angular_velocity", 1, [0.0, 0.0, 2.0])
    with pytest.raises(MechanismError, match="joint 'pivot': opens at 2 rad/s"):
        initial_state(replace(scene, initial_state=tilting))


@pytest.mark.parametrize("factor", [1e-6, 1.0, 1e6])
def test_assembled_states_are_accepted_at_any_speed(factor):
    scene = ball_loop()
    rng = np.random.default_rng(1)
    start = initial_state(scene)
    guess = replace(
        start,
        linear_velocity=factor * rng.standard_normal(start.position.shape),
        angular_velocity=factor * rng.standard_normal(start.position.shape),
    )
    with pytest.raises(MechanismError, match="in the initial state"):
        initial_state(replace(scene, initial_state=guess))
    state = assemble(scene, guess)
    assert initial_state(replace(scene, initial_state=state)) is state


@pytest.mark.parametrize("name", ["tracker", "stewart", "heavy_top", "flyball_governor", "chain"])
def test_many_states_are_checked_as_one_alone_is(name):
    scene = load(name)
    states = random_states(scene, 7)
    states[1] = moved(states[1], "position", 1, [0.0, 2.0 * CLOSURE_TOLERANCE, 0.0])
    states[2] = moved(states[2], "linear_velocity", -1, [1e-3, 1e-3, 1e-3])
    states[3] = moved(states[3], "quaternion", 1, [0.0, 1e-3, 0.0, 0.0])
    states[4] = moved(states[4], "angular_velocity", 0, [1e-3, 0.0, 0.0])
    states[5] = moved(states[5], "position", -1, [np.nan, 0.0, 0.0])
    errors = check_states(scene, states)
    assert set(errors) >= {1, 3, 4, 5}
    assert not {0, 6} & set(errors)
    for k, error in errors.items():
        with pytest.raises(MechanismError) as alone:
            initial_state(replace(scene, initial_state=states[k]))
        assert str(error).startswith(f"run {k}: ")
        assert k == 5 or str(error).removeprefix(f"run {k}: ") == str(alone.value)


SCENES = ELEMENTS | COUPLED | COMPOUNDS
SCENES |= {name: load(name) for name in ("tracker", "stewart", "heavy_top", "flyball_governor", "four_bar")}


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("title", SCENES)
def test_runs_of_a_batch_start_as_each_alone(title, formulation):
    """Whatever the states: these are near the scene's own, and open."""
    scene, rng = SCENES[title], np.random.default_rng(0)
    own = initial_state(scene)
    states = [own, *(State(*(x + rng.normal(0.0, 0.1, x.shape) for x in own.arrays)) for _ in range(2))]
    compiled = CompiledScene(scene, formulation)
    found = coordinates_of(compiled.system, states)
    assert np.array_equal(found[0], compiled.start[: compiled.size])
    for coordinates, state in zip(found, states, strict=True):
        assert np.array_equal(coordinates, coordinates_of(compiled.system, [state])[0])
        # some ten operations each, on numbers up to 10
        assert np.abs(coordinates - np.concatenate(compiled.system.coordinates(state))).max() < 1e-13
