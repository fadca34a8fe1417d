"""Reactions that nothing determines are found, named, and not held against anybody."""

from __future__ import annotations

import numpy as np
import pytest
from mechanisms import planar_four_bar, seven_hinges

from crosscheck.compare.levels import compare_equations, sample_engines
from crosscheck.compare.samples import Samples, States
from crosscheck.engines.registry import ENGINES
from crosscheck.library import load
from crosscheck.studies.random_scenes import random_scene
from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.undetermined import determined, undetermined, undetermined_joints
from newton_euler.reading.excitation import random_states
from newton_euler.runs.assemble import initial_state


@pytest.mark.parametrize("name", ["tracker", "pendulum", "chain", "slider_crank", "stewart", "free_top"])
def test_reactions_without_redundancy_are_unique(name):
    scene = load(name)
    assert undetermined(scene, initial_state(scene)).shape == (6 * len(scene.mechanism.joints), 0)
    assert undetermined_joints(scene, initial_state(scene)) == (0, [])


def test_bricard_has_one_everywhere_through_all_hinges():
    scene = load("bricard")
    for state in random_states(scene, 3):
        assert undetermined_joints(scene, state) == (1, [f"hinge_{k}" for k in range(1, 7)])


def test_windows_and_flat_loops():
    # a window closed by a ball has one equation too many, across it; closed by a hinge it has three
    assert undetermined_joints(load("four_bar", N=3), initial_state(load("four_bar", N=3)))[0] == 3
    scene = planar_four_bar()
    assert undetermined_joints(scene, initial_state(scene))[0] == 3


@pytest.mark.parametrize(
    "make",
    [lambda: load("bricard"), planar_four_bar, lambda: random_scene(0, 2)],
    ids=["bricard", "planar_four_bar", "with a redundant coupling"],
)
def test_what_is_undetermined_acts_on_no_body(make):
    scene = make()
    (state,) = random_states(scene, 1)
    size, frames = scene.mechanism.size, state.frames()
    basis = undetermined(scene, state)
    assert basis.shape[1] > 0
    for column in basis.T:
        total = np.zeros((len(frames), 6))
        for wrench, equations in zip(column.reshape(-1, 6), scene.mechanism.equations, strict=True):
            force, torque = wrench[:3], size * wrench[3:]
            second = frames[equations.second]
            pose = scene.mechanism.bodies[equations.second].pose
            point = second.position + second.rotation @ pose.point_to_body(equations.joint.point_on_second)
            for body, sign in ((equations.first, -1.0), (equations.second, 1.0)):
                moment = torque + np.cross(point - frames[body].position, force)
                total[body] += sign * np.concatenate([force, moment / size])
        assert abs(total[1:]).max() < 1e-12  # a unit wrench, of condition below 1e3


def test_determined_keeps_what_is_across():
    basis = np.zeros((12, 1))
    basis[[0, 6]] = np.sqrt(0.5)
    force, torque = np.zeros((1, 2, 3)), np.ones((1, 2, 3))
    force[0, :, 0] = 3.0, 1.0
    left, kept = determined(force, torque, [basis], 2.0)
    assert left[0, :, 0] == pytest.approx([1.0, -1.0])
    assert kept == pytest.approx(torque)


@pytest.mark.parametrize(
    "make",
    [lambda: load("bricard"), seven_hinges, lambda: random_scene(0, 2)],
    ids=["bricard", "seven_hinges", "with a redundant coupling"],
)
def test_engines_agree_on_what_is_determined_and_an_error_there_is_found(make):
    scene = make()
    engines = [ENGINES["newton_euler"], ENGINES["pinocchio"]]
    states = States(scene, (initial_state(scene), *random_states(scene, 2)))

    class Pushed(Cartesian):
        """The first joint's force is off by a thousandth."""

        def evaluate(self, q, v):
            found = super().evaluate(q, v)
            found.reaction_force[0] *= 1.001
            return found

    samples = sample_engines(engines, states)
    rows = [row for row in compare_equations(engines, samples) if "reaction" in row.quantity]
    assert len(rows) == 4  # forces and torques of two pairs: engines, formulations
    assert all(row.agrees for row in rows)
    samples["newton_euler"] = [Samples(Pushed(scene), states)]
    rows = list(compare_equations(engines, samples))
    failed = {row.quantity for row in rows if not row.agrees}
    assert "reaction force, rel" in failed
    assert failed <= {"reaction force, rel", "reaction torque, rel"}  # what is left has parts of both
