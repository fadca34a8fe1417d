"""Consistent states: what runs start from, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mechanisms import ball_loop, pendulum, planar_four_bar, slider_tree

from crosscheck.scenes import load
from newton_euler import PrescribedMotion, Sine, State, assemble, simulate, start
from newton_euler.assemble import VELOCITY_TOLERANCE, check_states, coordinates_of, initial_state
from newton_euler.errors import MechanismError, UnknownNameError
from newton_euler.exercise import random_states
from newton_euler.integrators.formulations import FORMULATIONS, formulate
from newton_euler.model.mechanism import CLOSURE_TOLERANCE


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


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("name", ["tracker", "stewart", "heavy_top", "flyball_governor", "four_bar"])
def test_coordinates_of_many_states_are_those_of_each(name, formulation):
    scene = load(name)
    system, states = formulate(scene, formulation), random_states(scene, 3)
    alone = [np.concatenate(system.coordinates(state)) for state in states]
    # some ten operations each, on numbers up to 10
    assert np.abs(coordinates_of(system, states) - alone).max() < 1e-13


@pytest.mark.parametrize("angle", [0.3, -2.0, 3.0, 7.0])
def test_a_loop_starts_at_the_angle_and_the_rate_of_its_crank(angle):
    scene = start(planar_four_bar(), at_a=(angle, 2.0))
    assert initial_state(scene) is scene.initial_state
    motion = simulate(replace(scene, duration=0.1)).joint("at_a")
    off = np.remainder(motion.coordinates[0, 0] - angle + np.pi, 2.0 * np.pi) - np.pi
    assert abs(off) < CLOSURE_TOLERANCE
    assert motion.rates[0, 0] == pytest.approx(2.0, rel=VELOCITY_TOLERANCE)


def test_a_moving_loop_starts_at_rest():
    scene = start(load("slider_crank"), pivot=(0.3, 0.0))
    run = simulate(replace(scene, duration=0.1))
    assert run.linear_velocity is not None
    assert np.abs(run.linear_velocity[0]).max() < 1e-12  # of 0.5 m/s before


def test_joints_of_several_coordinates_start_and_others_stay():
    scene = start(slider_tree(), sleeve_on_cart=[(0.2, -0.1), (1.5, 3.0)])
    assert scene.initial_state is not None
    run = simulate(replace(scene, duration=0.1))
    sleeve, rail, collar = (run.joint(name) for name in ("sleeve_on_cart", "rail", "collar_on_sleeve"))
    np.testing.assert_allclose(sleeve.coordinates[0], [0.2, 1.5], atol=CLOSURE_TOLERANCE)
    np.testing.assert_allclose(sleeve.rates[0], [-0.1, 3.0], atol=VELOCITY_TOLERANCE)
    for motion in (rail, collar):
        np.testing.assert_allclose([motion.coordinates[0], motion.rates[0]], 0.0, atol=CLOSURE_TOLERANCE)


def test_coordinates_that_are_not_given_follow_from_the_loops():
    scene = start(load("stewart"), leg_1=[(0.05, 0.1), None])
    assert scene.initial_state is not None
    leg = simulate(replace(scene, duration=0.1)).joint("leg_1")
    assert abs(leg.coordinates[0, 0] - 0.05) < CLOSURE_TOLERANCE
    assert leg.rates[0, 0] == pytest.approx(0.1, rel=VELOCITY_TOLERANCE)


@pytest.mark.parametrize(
    ("joints", "message"),
    [
        ({"at_d": (2.5, 0.0)}, "joint 'at_d': cannot start at 2.5 at rate 0: "),
        ({"at_a": (0.3, 1.0), "at_d": (0.3, 0.0)}, "cannot start at 0.3 at rate "),
        ({"at_a": 0.3}, "joint 'at_a': start is 0.3; needed: 2 finite numbers"),
        ({"at_a": (0.3, float("nan"))}, "joint 'at_a': start is "),
        ({}, "has no joint to start"),
    ],
)
def test_starts_that_loops_do_not_allow_name_the_joint(joints, message):
    with pytest.raises(MechanismError, match=message):
        start(planar_four_bar(), **joints)


def test_starts_of_joints_that_cannot_be_given():
    with pytest.raises(UnknownNameError, match="unknown joint 'at_e'"):
        start(planar_four_bar(), at_e=(0.0, 0.0))
    with pytest.raises(MechanismError, match="joint 'bob_on_sleeve': has no coordinate to start at"):
        start(slider_tree(), bob_on_sleeve=(0.0, 0.0))
    with pytest.raises(MechanismError, match=r"start is \(0.0, 0.0, 0.0\); needed: a list of 2 pairs"):
        start(slider_tree(), sleeve_on_cart=(0.0, 0.0, 0.0))
    driven = replace(planar_four_bar(), motions=(PrescribedMotion("at_a", Sine(0.1, 1.0)),))
    with pytest.raises(MechanismError, match="joint 'at_a': follows a prescribed motion"):
        start(driven, at_a=(0.1, 0.0))
