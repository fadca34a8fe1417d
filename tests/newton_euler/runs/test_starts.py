"""Starts at coordinates and rates of joints, of a scene and of each run of a batch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mechanisms import planar_four_bar, slider_tree

from crosscheck.library import load
from newton_euler import Wrench, simulate, simulate_batch, start, with_parameters
from newton_euler.errors import MechanismError, UnknownNameError
from newton_euler.model.mechanism import CLOSURE_TOLERANCE
from newton_euler.model.motions import PrescribedMotion
from newton_euler.model.smooth_functions import Sine
from newton_euler.model.state import State
from newton_euler.runs.assemble import VELOCITY_TOLERANCE, initial_state, measured_coordinate
from newton_euler.runs.initial_coordinates import initial_names, initial_numbers

VELOCITIES = ("linear_velocity", "angular_velocity")


@pytest.fixture(scope="module")
def crank():
    """A spatial loop of one freedom, on the move."""
    return replace(start(load("slider_crank"), pivot=(0.4, 2.0)), duration=0.3, output_period=0.1)


@pytest.mark.parametrize("angle", [0.3, -2.0, 3.0, 7.0])
def test_a_loop_starts_at_the_angle_and_the_rate_of_its_crank(angle):
    scene = start(planar_four_bar(), at_a=(angle, 2.0))
    assert initial_state(scene) is scene.initial_state
    motion = simulate(replace(scene, duration=0.1)).joint("at_a")
    off = np.remainder(motion.coordinates[0, 0] - angle + np.pi, 2.0 * np.pi) - np.pi
    assert abs(off) < CLOSURE_TOLERANCE
    assert motion.rates[0, 0] == pytest.approx(2.0, rel=VELOCITY_TOLERANCE)


def test_a_moving_loop_starts_slowly():
    """As states of other speeds do, it meets its joints to a share of its own."""
    scene = start(load("slider_crank"), guide=(0.01, 1e-9))
    _, rate = measured_coordinate(scene, initial_state(scene), ("guide", 0))
    assert rate == pytest.approx(1e-9, rel=VELOCITY_TOLERANCE)


def test_a_moving_loop_starts_at_rest():
    scene = start(load("slider_crank"), pivot=(0.3, 0.0))
    run = simulate(replace(scene, duration=0.1))
    assert not run.linear_velocity[0].any()  # of 0.5 m/s before


def test_joints_of_several_coordinates_start_and_others_stay():
    scene = start(slider_tree(), sleeve_on_cart=[(0.2, -0.1), (1.5, 3.0)])
    assert scene.initial_state is not None
    run = simulate(replace(scene, duration=0.1))
    sleeve, rail, collar = (run.joint(name) for name in ("sleeve_on_cart", "rail", "collar_on_sleeve"))
    np.testing.assert_allclose(sleeve.coordinates[0], [0.2, 1.5], atol=CLOSURE_TOLERANCE)
    np.testing.assert_allclose(sleeve.rates[0], [-0.1, 3.0], atol=VELOCITY_TOLERANCE)
    for motion in (rail, collar):
        np.testing.assert_allclose([motion.coordinates[0], motion.rates[0]], 0.0, atol=CLOSURE_TOLERANCE)


@pytest.mark.slow
def test_coordinates_that_are_not_given_follow_from_the_loops():
    scene = start(load("stewart"), leg_1=[(0.05, 0.1), None])
    assert scene.initial_state is not None
    leg = simulate(replace(scene, duration=0.1)).joint("leg_1")
    assert abs(leg.coordinates[0, 0] - 0.05) < CLOSURE_TOLERANCE
    assert leg.rates[0, 0] == pytest.approx(0.1, rel=VELOCITY_TOLERANCE)


@pytest.mark.parametrize(
    ("joints", "message"),
    [
        (
            {"at_d": (2.5, 0.0)},
            "joint '.*' stays open by .* to start.at_d = 2.5, start.at_d.rate = 0.0",
        ),
        ({"at_a": (0.3, 1.0), "at_d": (0.3, 0.0)}, "joint '.*' stays open by .* to start.at_a = 0.3, "),
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


def test_starts_do_not_depend_on_grouping(tracker):
    rng = np.random.default_rng(0)
    short = replace(tracker, duration=0.02, output_period=0.01)
    values = {
        "ball_57.point_on_first": 1e-3 * rng.uniform(-1.0, 1.0, (6, 3)),
        "start.slide_12": 0.1 * rng.random(6),
    }
    together = simulate_batch(short, parameters=values, threads=2)
    for k in (0, 5):
        alone = simulate_batch(short, parameters={name: given[k : k + 1] for name, given in values.items()})
        assert np.array_equal(together.stacked("position")[k], alone.stacked("position")[0])
        assert together[k].joint("slide_12").coordinates[0] == pytest.approx(
            values["start.slide_12"][k], abs=1e-15
        )


def test_a_given_state_begins_at_its_own_coordinates(tracker, tracker_states):
    """Coordinates that are not given stay those of the state, not of the scene."""
    short = replace(tracker, duration=0.02, output_period=0.01)
    values = {"start.slide_12.rate": [0.3, 0.3], "panel_7.center_of_mass.z": [2.0, 2.1]}
    batch = simulate_batch(short, tracker_states[:2], parameters=values)
    for run, state in zip(batch, tracker_states, strict=False):
        own = simulate(replace(short, initial_state=state)).joint("slide_12")
        found = run.joint("slide_12")
        assert found.coordinates[0] == pytest.approx(own.coordinates[0], abs=1e-14)
        assert found.rates[0] == pytest.approx(0.3, abs=1e-14)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (
            {"ball.point_on_first.y": [0.0, 5.0]},
            "stays open by .* from the scene's own start to ball.point_on_first.y = 5.0",
        ),
        ({"start.pivot": [0.4, np.inf]}, "run 1: parameter 'start.pivot': is inf"),
        ({"start.pivot": [0.4, 0.4], "start.guide": [0.0, 3.0]}, "joint '.*' stays open by"),
        (
            {"start.pivot.rate": [1.0, 1.0], "start.guide.rate": [0.0, 5.0]},
            "loops do not allow start.pivot.rate = 1.0, start.guide.rate = 5.0",
        ),
        (
            {"start.pivot": [0.4, 0.5], "start.guide.rate": [0.0, 0.0]},
            "stays open by .* to start.pivot = 0.5, .*, with start.guide of the scene itself",
        ),
    ],
)
def test_a_start_that_cannot_be_is_an_error_of_its_run_alone(crank, values, message):
    if "start.guide" in values:
        values["start.guide"][0] = simulate(crank).joint("guide").coordinates[0, 0]
    if "start.pivot.rate" in values:
        (alone,) = simulate_batch(crank, parameters={"start.pivot.rate": [1.0]})
        values["start.guide.rate"][0] = alone.joint("guide").rates[0, 0]
    if "start.guide.rate" in values and "start.pivot" in values:
        values["start.pivot"][0] = simulate(crank).joint("pivot").coordinates[0, 0]
        values["start.guide.rate"][0] = simulate(crank).joint("guide").rates[0, 0]
    batch = simulate_batch(crank, parameters=values)
    assert list(batch.errors) == [1]
    with pytest.raises(MechanismError, match=message):
        batch[1]


@pytest.mark.parametrize(
    ("name", "error", "message"),
    [
        ("start.pivott", UnknownNameError, "did you mean 'pivot'?"),
        ("start.ball", MechanismError, "joint 'ball'"),
        ("start.wrist.2", MechanismError, "joint 'wrist'"),
    ],
)
def test_initial_coordinates_are_checked(crank, name, error, message):
    with pytest.raises(error) as caught:
        simulate_batch(crank, parameters={name: [0.0]})
    assert message in str(caught.value)


def test_a_force_may_be_called_start(crank):
    """Names of its numbers begin like those of initial coordinates."""
    body = crank.mechanism.bodies[1].name
    scene = replace(crank, forces=(Wrench("start", body, [0.0, 0.0, 0.0], force=[1.0, 0.0, 0.0]),))
    assert initial_numbers(scene, ["start.force", "start.pivot"]) == {"start.pivot": (("pivot", 0), 0)}


def test_all_coordinates_and_rates_of_a_motion_are_a_start():
    """Of a mechanism with two freedoms, far from its own start."""
    scene = replace(load("tracker"), duration=1.0, output_period=0.5)
    run = simulate(scene)
    state = State(*(getattr(run, name)[-1] for name in ("position", "quaternion", *VELOCITIES)))
    given = {}
    for name in initial_names(scene):
        (number,) = initial_numbers(scene, [name]).values()
        given[name] = measured_coordinate(scene, state, number.key)[number.order]
    begun = initial_state(with_parameters(scene, given))
    # to what positions and rates of the motion are known to
    np.testing.assert_allclose(begun.position, state.position, atol=1e-9)
    np.testing.assert_allclose(begun.linear_velocity, state.linear_velocity, atol=1e-9)


def test_rates_that_nobody_gave_yield_to_loops(crank):
    """Coordinates of one freedom that fit each other are those of another time of a run."""
    run, own = simulate(replace(crank, duration=3.0)), simulate(crank)
    pivot, guide = run.joint("pivot"), run.joint("guide")
    late = int(np.argmax(np.abs(pivot.coordinates[:, 0] - pivot.coordinates[0, 0]) > 1.0))
    values = {"start.pivot": [pivot.coordinates[late, 0]], "start.guide": [guide.coordinates[late, 0]]}
    (found,) = simulate_batch(crank, parameters=values)
    for name, motion in (("pivot", pivot), ("guide", guide)):
        assert found.joint(name).coordinates[0] == pytest.approx(motion.coordinates[late], abs=1e-14)
    # the first of the two has its own rate
    assert found.joint("pivot").rates[0] == pytest.approx(own.joint("pivot").rates[0], abs=1e-13)
    (found,) = simulate_batch(crank, parameters=values | {"start.guide.rate": [guide.rates[late, 0]]})
    for name, motion in (("pivot", pivot), ("guide", guide)):
        # of runs to 1e-10
        assert found.joint(name).rates[0] == pytest.approx(motion.rates[late], rel=1e-9)
