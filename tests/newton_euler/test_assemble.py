"""Consistent states: what runs start from, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mechanisms import ball_loop, pendulum

from newton_euler import State, assemble
from newton_euler.assemble import initial_state
from newton_euler.errors import MechanismError


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
