"""All equations of motion at the same states: both formulations, dense and sparse, and other engines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from armed_scenes import COMPOUNDS, armed, sprung
from ball_scenes import SCENES as BALLS
from constrained_motion import admissible_projector, states_near_start
from elements import COUPLED, ELEMENTS, MOTIONS
from finite_difference import jacobian
from mechanisms import REGULAR, SLIDER_ACCELERATIONS, bar, planar_four_bar, slider_tree
from random_chains import CHAINS, TREES

from crosscheck.engines.registry import ENGINES
from newton_euler import simulate
from newton_euler.compiled.formulations import FORMULATIONS
from newton_euler.equations.relative import Relative
from newton_euler.equations.row_choice import rows_in_use
from newton_euler.equations.system import Evaluation, System, at_time, constraint_rate
from newton_euler.model.euler_parameters import angle_between, from_rotation_vector
from newton_euler.model.joint_kinds import Fixed, Free
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.reading.excitation import random_states
from newton_euler.runs.assemble import initial_state
from urdf.errors import UrdfError

KINEMATICS = 1e-12
"""A few dozen products of order 1, each good to 1e-16, and velocities that meet constraints."""

REDUNDANT = ("planar_four_bar", "motion of a loop, redundant", "motion of a loop, redundant, armed")
"""Scenes whose reactions across a plane are not determined."""


class Group(NamedTuple):
    """Scenes, and how far equations may differ, relative to the largest value of a scene.

    Accelerations lose the condition of the equations, 1e4 to 1e5, on round-off of 1e-16; reactions lose that
    of the constraints once more.
    """

    scenes: dict[str, Scene]
    accelerations: float
    reactions: float


SMALL = {build.__name__: build() for build in (*REGULAR, planar_four_bar)}
ARMED = {f"{name}, armed": armed(scene) for name, scene in (ELEMENTS | SMALL).items() if "forces" not in name}
GROUPS = (
    Group(SMALL | CHAINS | COUPLED, 1e-10, 1e-8),
    Group(ELEMENTS | TREES | {f"{name}, armed": armed(scene) for name, scene in TREES.items()}, 1e-10, 1e-9),
    Group({name: scene for name, scene in ARMED.items() if scene.armatures} | COMPOUNDS, 1e-10, 1e-10),
    Group({f"{name}, forced": sprung(armed(scene)) for name, scene in COMPOUNDS.items()}, 1e-10, 1e-10),
    Group({f"{name}, balls": scene for name, scene in BALLS.items()}, 1e-11, 1e-11),
)
SCENES = {name: (scene, group) for group in GROUPS for name, scene in group.scenes.items()}


def systems(scene: Scene) -> list[System]:
    """One of each kind; the first is the joint-coordinate form."""
    return [system for engine in ENGINES.values() for system in engine.systems(scene)]


def check_array(found: Evaluation, wanted: Evaluation, name: str, tolerance: float, floor: float) -> None:
    """Compare an array relative to its largest value, or to a floor if that is larger."""
    x, y = getattr(found, name), getattr(wanted, name)
    assert np.max(np.abs(x - y), initial=0.0) <= tolerance * max(np.max(np.abs(y), initial=0.0), floor), name


def check(found: Evaluation, wanted: Evaluation, group: Group, determined: bool = True) -> None:
    """Compare motion, forces and energies."""
    for name in ("linear_acceleration", "angular_acceleration"):
        check_array(found, wanted, name, group.accelerations, 1e-3)  # bodies that fall freely hardly turn
    if determined:
        # joints that transmit nothing are held to the weight of 1 kg, and to that at 0.1 m
        check_array(found, wanted, "reaction_force", group.reactions, 10.0)
        check_array(found, wanted, "reaction_torque", group.reactions, 1.0)
    assert found.actuator_force == pytest.approx(wanted.actuator_force, rel=1e-10, abs=1e-10)
    energy = abs(wanted.kinetic_energy) + abs(wanted.potential_energy)
    assert abs(found.kinetic_energy - wanted.kinetic_energy) < KINEMATICS * energy
    assert abs(found.potential_energy - wanted.potential_energy) < KINEMATICS * energy
    for name in ("position", "linear_velocity", "angular_velocity"):
        x, y = getattr(found.state, name), getattr(wanted.state, name)
        assert np.max(np.abs(x - y)) < KINEMATICS * max(1.0, np.max(np.abs(y))), name
    assert np.max(angle_between(found.state.quaternion, wanted.state.quaternion)) < KINEMATICS


def check_states(
    scene: Scene, states: Sequence[State], group: Group, determined: bool = True, sparse: bool = True
) -> None:
    """Compare all systems at some states, and the sparse eliminations of both formulations."""
    first, *others = systems(scene)
    for state in states:
        wanted = first.evaluate(*first.coordinates(state))
        for system in (first, *others):
            q, v = system.coordinates(state)
            if system is not first:
                check(system.evaluate(q, v), wanted, group, determined)
            if sparse and isinstance(system, tuple(FORMULATIONS.values())):
                check(system.sparse_evaluation(q, v, rows_in_use(system))[0], wanted, group, determined)


@pytest.mark.parametrize("name", SCENES)
def test_all_equations_agree(name: str) -> None:
    scene, group = SCENES[name]
    # in floats the elimination of a hundred rows takes seconds, and shows no more than that of ten
    long = "long" in name
    states = states_near_start(scene, 1 if long else 2)
    check_states(scene, states, group, name not in REDUNDANT, not long)


def test_all_equations_agree_on_the_tracker(tracker: Scene, tracker_states: list[State]) -> None:
    """At 200 states."""
    check_states(tracker, tracker_states, GROUPS[0], sparse=False)


def test_loops_are_cut_where_the_names_of_the_cases_say() -> None:
    kinds = {
        name: [scene.mechanism.joints[k].kind for k in Relative(scene).tree.cuts]
        for name, scene in CHAINS.items()
    }
    assert kinds["loop cut at a ball"] == ["spherical"]
    assert kinds["loop cut at a ball to the ground"] == ["spherical"]
    assert kinds["loop cut at a hinge"] == ["revolute"]
    assert kinds["loop cut at a universal joint"] == ["universal"]
    assert kinds["loop cut at a cylindrical joint"] == ["cylindrical"]
    for name in ("loop through a free joint", "loop through a free joint reversed"):
        assert kinds[name] == ["free"]


@pytest.mark.parametrize("name", MOTIONS)
def test_all_equations_agree_in_prescribed_motion(name: str) -> None:
    """At a later time and in the middle of a run, which projection has closed to round-off."""
    scene, group = MOTIONS[name], SCENES[name][1]
    whole = simulate(scene)
    first, *others = systems(scene)
    for k in (1, len(whole.time) - 1):
        arrays = (whole.position, whole.quaternion, whole.linear_velocity, whole.angular_velocity)
        state = State(*(array[k] for array in arrays))  # type: ignore[index]
        then = at_time(first, float(whole.time[k]))
        wanted = then.evaluate(*then.coordinates(state))
        for system in others:
            now = at_time(system, float(whole.time[k]))
            q, v = now.coordinates(state)
            # lengths of 1 m and speeds of some m/s
            assert np.max(np.abs(now.phi(q))) < 1e-12
            assert np.max(np.abs(constraint_rate(now, q, v))) < 1e-11
            check(now.evaluate(q, v), wanted, group, name not in REDUNDANT)


def test_the_tracker_starts_with_the_published_accelerations(tracker: Scene) -> None:
    for system in systems(tracker):
        start = system.evaluate(*system.coordinates(initial_state(tracker)))
        assert start.linear_acceleration[1:3, 2] == pytest.approx(SLIDER_ACCELERATIONS, abs=1e-6)


@pytest.mark.parametrize("name", SMALL)
def test_admissible_velocities_are_the_same_in_all(name: str) -> None:
    first, *others = systems(SMALL[name])
    for state in random_states(SMALL[name], 3):
        wanted = admissible_projector(first, state)
        assert np.allclose(wanted @ wanted, wanted, atol=1e-12)
        for system in others:
            # projectors have norm 1; null spaces are found at condition numbers below 1e4
            assert np.abs(admissible_projector(system, state) - wanted).max() < 1e-11, system.name


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
