"""All rigid systems of equations, engine by engine, on the tracker and small mechanisms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from constrained_motion import admissible_projector
from finite_difference import jacobian
from mechanisms import REGULAR, SLIDER_ACCELERATIONS, bar, slider_tree

from crosscheck.engines import ENGINES
from newton_euler.assemble import initial_state
from newton_euler.exercise import random_states
from newton_euler.model.euler_parameters import angle_between, from_rotation_vector
from newton_euler.model.joint_kinds import Fixed, Free
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from urdf.errors import UrdfError


def systems(scene):
    return [system for engine in ENGINES.values() for system in engine.systems(scene)]


def test_all_four_give_the_published_accelerations(tracker):
    found = [s.evaluate(*s.coordinates(initial_state(tracker))) for s in systems(tracker)]
    assert len(found) == 4
    for evaluation in found:
        assert evaluation.linear_acceleration[1:3, 2] == pytest.approx(SLIDER_ACCELERATIONS, abs=1e-6)


def test_all_four_agree_at_200_random_states(tracker, tracker_states):
    """To 1e-10 (accelerations) and 1e-8 (reactions) of the largest: condition 1e4 to 1e5 times 1e-16."""
    reference, *others = systems(tracker)
    for state in tracker_states:
        wanted = reference.evaluate(*reference.coordinates(state))
        for system in others:
            found = system.evaluate(*system.coordinates(state))
            for name, tolerance in (
                ("linear_acceleration", 1e-10),
                ("angular_acceleration", 1e-10),
                ("reaction_force", 1e-8),
                ("reaction_torque", 1e-8),
            ):
                x, y = getattr(found, name), getattr(wanted, name)
                assert np.abs(x - y).max() < tolerance * np.abs(y).max(), (system.name, name)


@pytest.mark.parametrize("build", REGULAR, ids=lambda build: build.__name__)
def test_admissible_velocities_are_the_same_in_all(build):
    scene = build()
    reference, *others = systems(scene)
    for state in random_states(scene, 3):
        wanted = admissible_projector(reference, state)
        assert np.allclose(wanted @ wanted, wanted, atol=1e-12)
        for system in others:
            found = admissible_projector(system, state)
            # projectors have norm 1; null spaces are found at condition numbers below 1e4
            assert np.abs(found - wanted).max() < 1e-11, system.name


@pytest.mark.parametrize("build", REGULAR, ids=lambda build: build.__name__)
def test_velocity_transformation_is_the_derivative_of_poses(build):
    for system in systems(build()):
        q, _ = system.coordinates(initial_state(system.scene))
        bodies = len(system.mechanism.bodies)

        def positions(x, system=system, q=q):
            return system.state(system.retract(q, x), np.zeros(system.nv)).position.ravel()

        linear = system.velocity_transformation(q).reshape(bodies, 6, system.nv)[:, :3]
        found = jacobian(positions, system.nv)
        # see finite_difference.derivative
        assert np.allclose(found, linear.reshape(-1, system.nv), atol=1e-10), system.name


def test_poses_survive_the_way_through_coordinates(tracker, tracker_states):
    for scene, states in ((tracker, tracker_states[:5]), (slider_tree(), random_states(slider_tree(), 5))):
        for system in systems(scene):
            for state in states:
                back = system.state(*system.coordinates(state))
                # a dozen rotations of 1e-16 each
                assert np.abs(back.position - state.position).max() < 1e-14
                assert angle_between(back.quaternion, state.quaternion).max() < 1e-14
                assert np.abs(back.linear_velocity - state.linear_velocity).max() < 1e-13
                assert np.abs(back.angular_velocity - state.angular_velocity).max() < 1e-13


@pytest.mark.parametrize("forward", [True, False])
def test_free_joint_between_two_points_either_way_round(forward):
    """The ball of a free joint sits at the second body's point, whichever body is the second."""
    ends = ("ground", "stone") if forward else ("stone", "ground")
    stone = bar("stone", [1.0, 1.0, 1.0], [1.2, 1.0, 1.3])
    joint = Free("floats", *ends, [0.3, 0.0, 0.1], point_on_second=[0.9, 0.5, 0.2])
    mechanism = Mechanism([Body.ground(), stone], [joint])
    turned = from_rotation_vector(np.array([0.5, -1.0, 2.0]))
    state = State(
        np.array([np.zeros(3), [3.0, -2.0, 1.0]]),
        np.array([[1.0, 0.0, 0.0, 0.0], turned]),
        np.array([np.zeros(3), [0.1, 0.2, 0.3]]),
        np.array([np.zeros(3), [1.0, -2.0, 0.5]]),
    )
    scene = Scene("stone", mechanism, 1.0, 0.1, initial_state=state)
    for system in systems(scene):
        back = system.state(*system.coordinates(state))
        assert np.abs(back.position - state.position).max() < 1e-14
        assert angle_between(back.quaternion, state.quaternion).max() < 1e-14
        assert np.abs(back.linear_velocity - state.linear_velocity).max() < 1e-13


def test_ground_may_be_turned():
    """The frame of the ground is where it says it is, for the joints on it as well."""
    scene = REGULAR[0]()
    turned = replace(scene.mechanism.bodies[0], quaternion=from_rotation_vector(np.array([0.4, 0.2, 1.0])))
    other = replace(
        scene,
        mechanism=Mechanism([turned, scene.mechanism.bodies[1]], scene.mechanism.joints),
        initial_state=None,
    )
    wanted = systems(scene)[0].evaluate(*systems(scene)[0].coordinates(initial_state(scene)))
    for system in systems(other):
        found = system.evaluate(*system.coordinates(initial_state(other)))
        assert found.linear_acceleration[1] == pytest.approx(wanted.linear_acceleration[1], rel=1e-12)


def test_a_mechanism_that_cannot_move_stays():
    shelf = bar("shelf", [0.0, 0.0, 1.0], [0.5, 0.0, 1.0])
    mechanism = Mechanism([Body.ground(), shelf], [Fixed("screws", "ground", "shelf", [0.0, 0.0, 1.0])])
    scene = Scene("shelf", mechanism, 1.0, 0.5, gravity=(0.0, 0.0, -9.81))
    with pytest.raises(UrdfError, match="no joint can move"):
        ENGINES["pinocchio"].systems(scene)
    for system in ENGINES["newton_euler"].systems(scene) + ENGINES["mujoco"].systems(scene):
        at = system.evaluate(*system.coordinates(initial_state(scene)))
        assert np.abs(at.linear_acceleration).max() < 1e-12
        assert at.reaction_force[0] == pytest.approx([0.0, 0.0, 9.81 * shelf.mass], abs=1e-12)
