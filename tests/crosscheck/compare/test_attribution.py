"""The joint or body that a difference of two engines is placed at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mechanisms import pendulum, seven_hinges, slider_tree

from crosscheck.compare.attribution import dynamic_cause, kinematic_cause
from crosscheck.compare.samples import Samples, States
from crosscheck.studies.faults.injection import inertia_entry, joint_axes
from newton_euler.equations.relative import Relative
from newton_euler.model.forces import JointSpring
from newton_euler.model.joint_kinds import Revolute, Translational
from newton_euler.reading.excitation import random_states

LOOP, TREE = seven_hinges(), slider_tree()

AXES = [
    (scene, joint)
    for scene in (LOOP, TREE)
    for joint in scene.mechanism.joints
    if isinstance(joint, Revolute | Translational)
]


@pytest.mark.parametrize(
    ("scene", "joint"), AXES, ids=[f"{scene.name}, {joint.name}" for scene, joint in AXES]
)
def test_a_joint_whose_axis_is_wrong_is_blamed(scene, joint):
    states = States(scene, tuple(random_states(scene, 2)))
    wrong = joint_axes(joint.name, {"axis": joint.axis + 1e-4 * np.roll(joint.axis, 1)})(scene)
    found = kinematic_cause(Samples(Relative(scene), states), Samples(Relative(wrong), states))
    assert found == joint.name


@pytest.mark.parametrize(
    ("spring", "detail"),
    [
        (JointSpring("pivot", damping=0.3), "damping 0.3 instead of 0"),
        (JointSpring("pivot", stiffness=0.3), "stiffness 0.3 instead of 0"),
        (JointSpring("pivot", stiffness=0.3, rest=1.0), ""),  # two parameters: not one alone
    ],
)
def test_a_spring_that_the_scene_does_not_have_is_blamed_with_its_parameter(spring, detail):
    scene = pendulum()
    states = States(scene, tuple(random_states(scene, 5)))
    wrong = Samples(Relative(replace(scene, forces=(spring,))), states)
    found = dynamic_cause(Samples(Relative(scene), states), wrong)
    assert (found.where, found.detail) == ("pivot" if detail else "rod", detail)


def test_forces_that_are_the_same_in_all_states_are_no_parameters():
    """At one state three times, any spring would explain another inertia of the rod."""
    scene = pendulum()
    states = States(scene, tuple(random_states(scene, 1)) * 3)
    wrong = Samples(Relative(inertia_entry("rod", 1, 1, 0.01)(scene)), states)
    assert dynamic_cause(Samples(Relative(scene), states), wrong) == ("rod", "")
