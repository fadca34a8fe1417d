"""States of many runs at once: the coordinates and the verdicts are those of one state by itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from crosscheck.scenes import load
from newton_euler import Body, Mechanism, PointSpring, Scene, State
from newton_euler.assemble import VELOCITY_TOLERANCE, initial_state
from newton_euler.conversion import PORTION, check, coordinates
from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.relative import Relative
from newton_euler.errors import MechanismError
from newton_euler.exercise import random_states
from newton_euler.model.euler_parameters import from_rotation_vector
from newton_euler.model.joint_kinds import Free

COUNT = 30


@pytest.mark.parametrize("formulation", [Relative, Cartesian])
@pytest.mark.parametrize("name", ["tracker", "four_bar", "chain", "free_top", "stewart"])
def test_coordinates_are_those_one_by_one(name, formulation):
    scene = load(name)
    states = random_states(scene, COUNT)
    system = formulation(scene)
    check(scene, states)
    found = coordinates(system, states)
    expected = zip(*(system.coordinates(state) for state in states), strict=True)
    for one, other in zip(found, expected, strict=True):
        # round-off: dozens of operations on numbers of the order of 1
        assert np.abs(one - np.array(other)).max() < 1e-13


def test_half_turns_of_a_ball_keep_their_digits():
    """A free body whose own frame is turned; rotations up to a whole turn, e0 small and negative too."""
    tilt = from_rotation_vector(np.array([0.3, -0.8, 0.5]))
    body = Body("top", 1.0, np.zeros(3), np.diag([1.0, 2.0, 2.5]), tilt)
    mechanism = Mechanism([Body.ground(), body], [Free("free", "ground", "top", np.zeros(3))])
    scene = Scene("top", mechanism, 1.0, 0.1)
    states = []
    for angle in (0.0, 1e-9, 1.0, np.pi - 1e-9, np.pi, np.pi + 1e-9, 5.0, 2.0 * np.pi):
        turn = from_rotation_vector(angle * np.array([2.0, -1.0, 2.0]) / 3.0)
        a, b = np.array([[1.0, 0.0, 0.0, 0.0], turn]), State.initial(mechanism)
        states.append(State(b.position, a, b.linear_velocity, np.array([[0.0] * 3, [1.0, 2.0, 3.0]])))
    system = Relative(scene)
    q, v = coordinates(system, states)
    for k, state in enumerate(states):
        back = system.state(q[k], v[k])
        sign = np.sign(back.quaternion[1] @ state.quaternion[1])
        # round-off of two products of quaternions
        assert np.abs(sign * back.quaternion[1] - state.quaternion[1]).max() < 1e-15
        assert np.abs(back.angular_velocity - state.angular_velocity).max() < 1e-14
        ball = q[k, 3:7]
        assert ball[0] >= 0.0
        assert np.linalg.norm(ball) == pytest.approx(1.0, abs=1e-15)


def test_more_states_than_a_portion(tracker, tracker_states):
    states = [tracker_states[k % 7] for k in range(PORTION + 3)]
    q, v = coordinates(Relative(tracker), states)
    assert len(q) == len(v) == PORTION + 3
    assert np.array_equal(q[PORTION], q[PORTION % 7])
    states[PORTION + 1] = changed(states[PORTION + 1], "position", (3, 0), 1e-3)
    with pytest.raises(MechanismError, match=f"run {PORTION + 1}: joint "):
        check(tracker, states)


def changed(state: State, name: str, place: tuple[int, ...], by: float) -> State:
    """A state with one number changed."""
    array = getattr(state, name).copy()
    array[place] += by
    return replace(state, **{name: array})


@pytest.mark.parametrize(
    ("name", "place", "by", "message"),
    [
        ("position", (6, 0), 1e-6, r"joint '.*': is open by 1e-06 m in the initial state"),
        ("quaternion", (6, 1), 2e-9, "joint 'universal_47': opens at"),
        ("quaternion", (6, slice(None)), 1e-6, "body 'panel_7': initial quaternion has norm"),
        ("linear_velocity", (6, 2), 1e-3, r"joint '.*': opens at 0\.001 m/s"),
        ("angular_velocity", (6, 2), 1e-3, r"joint '.*': opens at"),
        ("position", (0, 0), 1e-6, "ground 'base': is not at its own pose"),
        ("quaternion", (0, 1), 1e-8, "ground 'base': is not at its own pose"),
        ("angular_velocity", (0, 2), 1e-12, "ground 'base': moves"),
        ("position", (3, 1), np.nan, "position has another shape or holds what is not finite"),
        (
            "angular_velocity",
            (3, 1),
            np.inf,
            "angular_velocity has another shape or holds what is not finite",
        ),
    ],
)
def test_a_bad_state_is_refused_with_its_number(tracker, tracker_states, name, place, by, message):
    states = list(tracker_states[:8])
    states[5] = changed(states[5], name, place, by)
    with pytest.raises(MechanismError, match=f"run 5: .*({message})") as caught:
        check(tracker, states)
    with pytest.raises(MechanismError) as alone:
        initial_state(replace(tracker, initial_state=states[5]))
    assert str(caught.value) == f"run 5: {alone.value}"


@pytest.mark.parametrize(
    "state", [None, State(np.zeros((2, 3)), np.zeros((2, 4)), np.zeros((2, 3)), np.zeros((2, 3)))]
)
def test_what_is_no_state_of_the_mechanism_is_refused(tracker, tracker_states, state):
    with pytest.raises(MechanismError, match="run 1: "):
        check(tracker, [tracker_states[0], state])


@pytest.mark.parametrize("share", [0.5, 0.995, 1.5])
def test_tolerances_are_those_of_the_scene(tracker, tracker_states, share):
    """On either side of the limit, and where only the scene itself can tell."""
    state = tracker_states[0]
    speed = np.linalg.norm(state.linear_velocity, axis=1).max()
    speed += tracker.mechanism.size * np.linalg.norm(state.angular_velocity, axis=1).max()
    state = changed(state, "linear_velocity", (6, 1), share * VELOCITY_TOLERANCE * speed)
    verdicts = []
    for judge in (
        lambda: check(tracker, [state]),
        lambda: initial_state(replace(tracker, initial_state=state)),
    ):
        try:
            judge()
            verdicts.append(True)
        except MechanismError:
            verdicts.append(False)
    assert verdicts[0] == verdicts[1]
    if share != 0.995:  # the panel's joints see the whole change at most
        assert verdicts[0] == (share < 1.0)


def test_a_spring_needs_a_direction_in_every_state():
    body = Body("mass", 1.0, np.array([0.0, 0.0, 1.0]), np.eye(3))
    mechanism = Mechanism([Body.ground(), body], [Free("free", "ground", "mass", np.zeros(3))])
    ends = np.zeros(3), np.array([0.0, 0.0, 1.0])
    spring = PointSpring("spring", "ground", "mass", *ends, stiffness=1.0, rest_length=0.5)
    scene = Scene("spring", mechanism, 1.0, 0.1, forces=(spring,))
    apart = initial_state(scene)
    together = changed(apart, "position", (1, 2), -1.0)
    check(scene, [apart, apart])
    with pytest.raises(MechanismError, match="run 1: point spring 'spring': its points coincide"):
        check(scene, [apart, together])
