"""Bounds of how far a displaced joint makes a motion part, against runs of the changed scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import newton_euler
from crosscheck.compare.changes import CHANGE, elements
from crosscheck.compare.joint_loads import JointLoads
from crosscheck.library import load
from newton_euler.model.state import State


@pytest.fixture(scope="module")
def chain():
    """A tenth of a second of four rods: the scene, its run, and what every fifth state loads joints with."""
    scene = replace(load("chain", N=4), duration=0.1)
    run = newton_euler.simulate(scene)
    arrays = run.position, run.quaternion, run.linear_velocity, run.angular_velocity
    states = [(float(t), State(*state)) for t, *state in zip(run.time, *arrays, strict=True)][::5]
    return scene, run, JointLoads(scene, states)


def parted(chain, element):
    """How far bodies of a changed scene get from the run, m."""
    scene, run, _ = chain
    other = newton_euler.simulate(element.changed(scene))
    return np.max(np.linalg.norm(other.position - run.position, axis=-1))


@pytest.mark.slow
def test_a_displaced_joint_parts_motions_by_what_it_does_not_carry(chain):
    scene, _, loads = chain
    joints = [element for element in elements(scene) if element.displaced is not None]
    assert len(joints) == 4
    for element in joints:
        least, most = loads.motion_change(element.displaced)
        assert 1e-5 < least < parted(chain, element) < most, element.name


@pytest.mark.slow
def test_a_body_parts_motions_by_its_share(chain):
    scene, _, loads = chain
    bodies = [element for element in elements(scene) if element.body is not None]
    assert len(bodies) == 8
    for element in bodies:
        least = loads.body_effect(*element.body, CHANGE, 1.0, np.inf)
        assert 1e-6 < least < parted(chain, element), element.name


def test_a_joint_of_a_loop_parts_by_nothing_for_certain():
    scene = load("four_bar")
    run = newton_euler.simulate(replace(scene, duration=0.1))
    assert run.linear_velocity is not None
    state = State(run.position[-1], run.quaternion[-1], run.linear_velocity[-1], run.angular_velocity[-1])
    loads = JointLoads(scene, [(0.0, state), (0.1, state)])
    joints = [element.displaced for element in elements(scene) if element.displaced is not None]
    assert joints
    assert all(loads.motion_change(joint)[0] == 0.0 for joint in joints)
