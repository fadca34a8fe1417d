"""The joint or body that a difference of two engines is placed at."""

from __future__ import annotations

import numpy as np
import pytest
from mechanisms import seven_hinges, slider_tree

from crosscheck.comparison.blame import kinematic_cause
from crosscheck.comparison.samples import Samples, States
from crosscheck.studies.faults.plant import joint_axes
from newton_euler.equations.relative import Relative
from newton_euler.exercise import random_states
from newton_euler.model.joint_kinds import Revolute, Translational

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
