"""MuJoCo's model under rigid constraints against this package's two formulations."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from mechanisms import planar_four_bar

from crosscheck.library.tracker import tracker as make_tracker
from mjcf.rigid import RigidMuJoCo
from mjcf.soft import SoftMuJoCo
from newton_euler.equations.relative import Relative
from newton_euler.equations.system import Evaluation, System
from newton_euler.errors import UnknownNameError
from newton_euler.model.joint import Joint
from newton_euler.model.joint_kinds import Fixed, Free, Revolute, Spherical
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.reading.excitation import random_states
from newton_euler.runs.assemble import initial_state

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
    """Evaluate MuJoCo's rigid model and each of the systems at each state."""
    rigid = RigidMuJoCo(scene)
    for state in states:
        found = rigid.evaluate(*rigid.coordinates(state))
        for system in systems:
            yield found, system.evaluate(*system.coordinates(state))


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
    soft.set_state(*soft.coordinates(tracker_states[1]))
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
        system.move_anchor(owner, np.array([0.0, 0.0, 1e-3]))
        # the point of the second body has gone up, and residuals are of the first less it
        assert system.phi(q)[:3] == pytest.approx([0.0, 0.0, -1e-3], abs=1e-14), (owner, cut)
        with pytest.raises(UnknownNameError):
            system.move_anchor(chosen.mechanism.joint_names[1], np.ones(3))  # a joint of the tree
