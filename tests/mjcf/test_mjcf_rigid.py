"""MuJoCo's model under rigid constraints against this package's two formulations."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from finite_difference import derivative, jacobian
from mechanisms import bolted, planar_four_bar, scaled
from random_chains import CHAINS

from crosscheck.scenes.tracker import tracker as make_tracker
from mjcf.inspect import move_anchor
from mjcf.rigid import RigidMuJoCo
from mjcf.soft import SoftMuJoCo
from newton_euler.assemble import initial_state
from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.relative import Relative
from newton_euler.equations.system import Evaluation, System
from newton_euler.exercise import random_states
from newton_euler.model.joint import Joint
from newton_euler.model.joint_kinds import Fixed, Free, Revolute, Spherical
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.state import State

KINEMATICS = 1e-12
"""A few dozen products of order 1, each good to 1e-16, and velocities that meet constraints."""

ACCELERATIONS = 1e-10
"""Relative to the largest: condition numbers of 1e4 to 1e5 on round-off of 1e-16."""

REACTIONS = 1e-8
"""Relative to the largest: the multipliers lose the constraints' condition once more."""


def gap(found: Evaluation, wanted: Evaluation, name: str, scale: float = 0.0) -> float:
    """Largest difference over all bodies or joints relative to the largest value, or to `scale`."""
    x, y = getattr(found, name), getattr(wanted, name)
    return float(np.max(np.abs(x - y)) / max(np.max(np.abs(y)), scale))


def both(scene: Scene, states: Sequence[State], *systems: System) -> Iterator[tuple[Evaluation, Evaluation]]:
    """What MuJoCo's rigid model gives at each state, with what each of the systems does."""
    rigid = RigidMuJoCo(scene)
    for state in states:
        found = rigid.evaluate(*rigid.coordinates(state))
        for system in systems:
            yield found, system.evaluate(*system.coordinates(state))


def assert_same_kinematics(found: Evaluation, wanted: Evaluation) -> None:
    for name in ("position", "linear_velocity", "angular_velocity"):
        x, y = getattr(found.state, name), getattr(wanted.state, name)
        assert np.max(np.abs(x - y)) < KINEMATICS * max(1.0, np.max(np.abs(y))), name
    cosines = np.abs(np.sum(found.state.quaternion * wanted.state.quaternion, axis=1))
    assert np.max(np.abs(cosines - 1.0)) < KINEMATICS


def assert_same_energies(found: Evaluation, wanted: Evaluation) -> None:
    scale = abs(wanted.kinetic_energy) + abs(wanted.potential_energy)
    assert abs(found.kinetic_energy - wanted.kinetic_energy) < KINEMATICS * scale
    assert abs(found.potential_energy - wanted.potential_energy) < KINEMATICS * scale


def assert_same_accelerations(found: Evaluation, wanted: Evaluation) -> None:
    for name in ("linear_acceleration", "angular_acceleration"):
        # a body that falls freely has hardly any angular acceleration to be relative to
        assert gap(found, wanted, name, scale=1e-3) < ACCELERATIONS, name


def assert_same_reactions(found: Evaluation, wanted: Evaluation) -> None:
    # joints that transmit nothing are held to the weight of a body of 1 kg at 0.1 m
    assert gap(found, wanted, "reaction_force", scale=10.0) < REACTIONS
    assert gap(found, wanted, "reaction_torque", scale=1.0) < REACTIONS


def test_tracker_agrees_at_200_states(tracker: Scene, tracker_states: list[State]) -> None:
    for found, wanted in both(tracker, tracker_states, Relative(tracker), Cartesian(tracker)):
        assert_same_kinematics(found, wanted)
        assert_same_energies(found, wanted)
        assert_same_accelerations(found, wanted)
        assert gap(found, wanted, "reaction_force") < REACTIONS
        assert gap(found, wanted, "reaction_torque") < REACTIONS
        # forces of some 10 N out of products of order 1
        assert np.max(np.abs(found.actuator_force - wanted.actuator_force)) < 1e-11


def test_tracker_coordinates_are_those_of_the_relative_form(
    tracker: Scene, tracker_states: list[State]
) -> None:
    rigid, relative = RigidMuJoCo(tracker), Relative(tracker)
    for state in tracker_states[:20]:
        q, v = relative.coordinates(state)
        # the work comes last in q
        found, wanted = rigid.acceleration(q[: rigid.nq], v), relative.acceleration(q, v)
        assert np.max(np.abs(found - wanted)) < ACCELERATIONS * np.max(np.abs(wanted))


def test_tracker_starts_as_published(tracker: Scene) -> None:
    rigid = RigidMuJoCo(tracker)
    start = rigid.evaluate(*rigid.coordinates(initial_state(tracker)))
    # the reference values have six decimals
    assert start.linear_acceleration[1, 2] == pytest.approx(0.277549, abs=1e-6)
    assert start.linear_acceleration[2, 2] == pytest.approx(1.394930, abs=1e-6)


def test_inertia_that_mujoco_refuses_is_run_as_printed() -> None:
    literal, realisable = make_tracker(panel_inertia="literal"), make_tracker()
    accelerations = {}
    for name, scene in (("literal", literal), ("realisable", realisable)):
        rigid, relative = RigidMuJoCo(scene), Relative(scene)
        q, v = relative.coordinates(initial_state(scene))
        # the work comes last in q
        found, wanted = rigid.acceleration(q[: rigid.nq], v), relative.acceleration(q, v)
        assert np.max(np.abs(found - wanted)) < ACCELERATIONS * np.max(np.abs(wanted))
        accelerations[name] = found
    # so the literal inertia is not replaced by the realisable one: they differ in the 2nd digit
    assert np.max(np.abs(accelerations["literal"] - accelerations["realisable"])) > 1e-3


def test_refused_inertia_along_the_axes_of_a_body() -> None:
    """MuJoCo treats a single body with principal axes as a simpler case, with a constant M."""
    inertia = np.diag([3e-3, 1e-3, 0.9e-3])
    body = Body("odd", 1.0, np.zeros(3), inertia, allow_unrealisable_inertia=True)
    free = Free("float", "ground", "odd", np.zeros(3))
    scene = Scene("odd", Mechanism([Body.ground(), body], [free]), 1.0, 0.1)
    for found, wanted in both(scene, random_states(scene, 3), Relative(scene)):
        assert_same_accelerations(found, wanted)
        assert_same_energies(found, wanted)


@pytest.mark.parametrize("name", CHAINS)
def test_chains_agree(name: str) -> None:
    scene = CHAINS[name]
    for found, wanted in both(scene, random_states(scene, 5), Relative(scene), Cartesian(scene)):
        assert_same_kinematics(found, wanted)
        assert_same_energies(found, wanted)
        assert_same_accelerations(found, wanted)
        assert_same_reactions(found, wanted)
        assert np.allclose(found.actuator_force, wanted.actuator_force, rtol=1e-12, atol=1e-12)


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


@pytest.mark.parametrize(
    ("name", "types"),
    [
        ("loop through a free joint", ["BALL", "SLIDE", "SLIDE", "SLIDE", "BALL"]),
        ("loop through a free joint reversed", ["BALL", "BALL", "SLIDE", "SLIDE", "SLIDE"]),
    ],
)
def test_free_joints_in_loops_are_the_way_round_that_the_cases_say(name: str, types: list[str]) -> None:
    found = [mujoco.mjtJoint(kind).name for kind in RigidMuJoCo(CHAINS[name]).model.jnt_type]
    assert found == [f"mjJNT_{kind}" for kind in types]


def test_planar_four_bar_agrees_in_accelerations() -> None:
    """Its equations are redundant in space, so reactions out of the plane are not determined."""
    scene = planar_four_bar()
    for found, wanted in both(scene, random_states(scene, 10), Relative(scene), Cartesian(scene)):
        assert_same_kinematics(found, wanted)
        assert_same_accelerations(found, wanted)


def test_a_planar_four_bar_of_any_size_moves_alike() -> None:
    scene = planar_four_bar()
    relative = Relative(scene)
    for factor in (1e-2, 1.0, 1e2):  # MuJoCo takes no inertia below 1e-15 kg m^2
        rigid = RigidMuJoCo(scaled(scene, factor))
        for state in random_states(scene, 3):
            grown = replace(
                state, position=factor * state.position, linear_velocity=factor * state.linear_velocity
            )
            found = rigid.evaluate(*rigid.coordinates(grown))
            found = replace(found, linear_acceleration=found.linear_acceleration / factor)
            assert_same_accelerations(found, relative.evaluate(*relative.coordinates(state)))


@pytest.mark.parametrize(
    ("kind", "axes"), [(Fixed, {}), (Spherical, {}), (Revolute, {"axis": [0.3, 0.5, -0.2]})]
)
def test_a_second_bolt_changes_nothing(kind: type[Joint], axes: dict[str, list[float]]) -> None:
    """Its rows are round-off, which MuJoCo drops at some states only; none of it is a constraint."""
    relative, rigid = Relative(bolted(None)), RigidMuJoCo(bolted(kind, **axes))
    for state in random_states(relative.scene, 5):
        q, v = rigid.coordinates(state)
        assert len(rigid.phi(q)) == len(rigid.phi_jacobian(q)) == len(rigid.phi_units)
        found = rigid.evaluate(q, v)
        assert_same_accelerations(found, relative.evaluate(*relative.coordinates(state)))


def test_a_loop_between_fixed_bodies_does_nothing() -> None:
    y = np.array([0.0, 1.0, 0.0])
    bodies = [Body.ground(), Body("post", 1.0, y, np.eye(3)), Body("arm", 1.0, 2.0 * y, np.eye(3))]
    joints: list[Joint] = [
        Fixed("foot", "ground", "post", np.zeros(3)),
        Spherical("stay", "post", "ground", np.ones(3)),
        Revolute("hinge", "post", "arm", np.ones(3), axis=y),
    ]
    scene = Scene("post", Mechanism(bodies, joints), 0.1, 0.1, gravity=-9.81 * np.eye(3)[0])
    ((found, wanted),) = both(scene, [initial_state(scene)], Relative(scene))
    assert_same_accelerations(found, wanted)
    assert_same_reactions(found, wanted)
    assert np.max(np.abs(found.angular_acceleration)) > 1.0


@pytest.mark.parametrize("name", [name for name in CHAINS if "loop" in name])
def test_constraint_derivatives(name: str) -> None:
    """Also where the loop is open: soft constraints always leave it so."""
    rigid = RigidMuJoCo(CHAINS[name])
    rng = np.random.default_rng(7)
    q, _ = rigid.coordinates(initial_state(rigid.scene))
    q = rigid.retract(q, rng.uniform(-0.3, 0.3, rigid.nv))
    v = rng.normal(size=rigid.nv)
    assert np.max(np.abs(rigid.phi(q))) > 0.01
    # the differences are good to 1e-12, third derivatives reach 10 to 100 here
    wanted = jacobian(lambda step: rigid.phi(rigid.retract(q, step)), rigid.nv)
    assert np.max(np.abs(rigid.phi_jacobian(q) - wanted)) < 1e-9
    wanted = derivative(lambda t: rigid.phi_jacobian(rigid.retract(q, t * v)) @ v)
    assert np.max(np.abs(rigid.velocity_product(q, v) - wanted)) < 1e-9
    wanted = derivative(lambda t: rigid.retract(q, t * v))
    assert np.max(np.abs(rigid.rate(q, v) - wanted)) < 1e-11


def test_soft_constraints_are_a_little_off_at_rest(tracker: Scene) -> None:
    rigid, soft = RigidMuJoCo(tracker), SoftMuJoCo(tracker)
    q, v = rigid.coordinates(initial_state(tracker))
    wanted, found = rigid.evaluate(q, v), soft.evaluate(q, v)
    # solimp is capped at 0.9999: a row keeps 1e-4 of its own compliance, several rows add up
    assert 1e-4 < gap(found, wanted, "linear_acceleration") < 1e-2
    assert 1e-4 < gap(found, wanted, "reaction_force") < 1e-2


def test_soft_answers_do_not_depend_on_what_was_asked_before(
    tracker: Scene, tracker_states: list[State]
) -> None:
    soft = SoftMuJoCo(tracker)
    q, v = soft.coordinates(tracker_states[0])
    before = soft.evaluate(q, v)
    soft.place(*soft.coordinates(tracker_states[1]))
    mujoco.mj_step(soft.model, soft.data, 200)
    after = soft.evaluate(q, v)
    assert np.array_equal(before.linear_acceleration, after.linear_acceleration)
    assert np.array_equal(before.reaction_force, after.reaction_force)


def test_an_anchor_is_moved_whatever_its_weld_is_called() -> None:
    scene = planar_four_bar()
    names = {"at_a": "at_c_weld", "at_b": "at_b", "at_c": "at_c", "at_d": "at_d"}
    joints = [replace(joint, name=names[joint.name]) for joint in scene.mechanism.joints]
    for chosen in (scene, replace(scene, mechanism=Mechanism(scene.mechanism.bodies, joints))):
        system = RigidMuJoCo(chosen)
        (cut,) = system.welded.tree.cuts
        owner = next(
            joint.name
            for joint, own in zip(system.welded.mechanism.joints, chosen.mechanism.joints, strict=False)
            if {joint.first, joint.second} != {own.first, own.second}
        )
        q, _ = system.coordinates(initial_state(chosen))
        assert np.max(np.abs(system.phi(q))) < 1e-14
        move_anchor(system, owner, np.array([0.0, 0.0, 1e-3]))
        # the point of the second body has gone up, and residuals are of the first less it
        assert system.phi(q)[:3] == pytest.approx([0.0, 0.0, -1e-3], abs=1e-14), (owner, cut)
