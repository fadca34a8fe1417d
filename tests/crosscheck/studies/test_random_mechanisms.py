"""Random mechanisms: what the generator makes, that engines agree on it, and that a mistake is found."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from crosscheck.engines.registry import ENGINES
from crosscheck.studies.random_scenes import KINDS, random_scene
from crosscheck.studies.stress import random_mechanisms
from crosscheck.studies.stress.cases import run_case
from crosscheck.studies.stress.random_mechanisms import (
    NATIVE_SETTINGS,
    NATIVE_TOLERANCE,
    compare_on_mechanism,
    compared_systems,
    measure,
)
from crosscheck.studies.stress.topics import stress
from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.relative import Relative
from newton_euler.equations.undetermined import undetermined_joints
from newton_euler.errors import SingularityError
from newton_euler.model.forces import BallSpring, JointSpring, PointSpring, Wrench
from newton_euler.model.joint_kinds import JOINT_KINDS
from newton_euler.model.spanning_tree import SpanningTree
from newton_euler.model.wind import WindLoad
from newton_euler.runs.assemble import initial_state
from urdf.proximal import MAX_PROXIMAL_ITERATIONS, regularized

COUNT = 16

COMPARED = compared_systems([*ENGINES.values()])


@pytest.mark.slow
@pytest.mark.parametrize("setting", COMPARED, ids=lambda setting: setting.engine)
def test_engines_agree(setting):
    """At the tolerances of a crosscheck, of which the worst of these takes a tenth."""
    found = measure(0, range(COUNT), setting)
    assert found.value < 1.0, found.note
    assert found.note.startswith(f"{COUNT} of {COUNT} agree; worst: random_scene(0, ")


@pytest.mark.parametrize("setting", NATIVE_SETTINGS, ids=lambda setting: setting.options["formulation"])
def test_native_code_is_its_float_form_in_another_order(setting):
    assert compare_on_mechanism(random_scene(0, 0), setting).ratio < 1e-12 / NATIVE_TOLERANCE


@pytest.mark.slow
def test_what_they_cover():
    """All kinds of joints in trees and in loops, all sizes, redundancy, everything that pushes."""
    scenes = [random_scene(0, number) for number in range(48)]
    kept, cut, forces, loops = Counter(), Counter(), Counter(), Counter()
    for scene in scenes:
        joints, tree = scene.mechanism.joints, SpanningTree(scene.mechanism)
        kept.update(joints[k.joint].kind for k in tree.joints if k.joint < len(joints))
        cut.update(joints[k].kind for k in tree.cuts)
        loops[sum(joint.name.startswith("loop") for joint in joints)] += 1
        forces.update(type(force) for force in scene.forces)
        forces.update(force.frame for force in scene.forces if isinstance(force, Wrench))
    assert {*KINDS, "parallel_hinges"} == set(JOINT_KINDS)
    assert set(kept) == set(JOINT_KINDS) - {"rod"}
    # trees keep a joint of five or six equations if they can
    assert set(cut) | {"fixed", "prismatic", "translational"} == set(JOINT_KINDS)
    assert set(loops) == {0, 1, 2, 3}
    assert {len(scene.mechanism.bodies) - 1 for scene in scenes} == set(range(2, 9))
    assert set(forces) == {JointSpring, BallSpring, PointSpring, Wrench, WindLoad, "world", "body"}
    assert sum(len(scene.armatures) > 0 for scene in scenes) > 3
    assert sum(len(scene.control) > 0 for scene in scenes) > 3
    assert sum(len(scene.motions) > 0 for scene in scenes) > 3
    assert sum(len(scene.mechanism.couplings) > 0 for scene in scenes) > 3
    assert sum(any(not k.forward for k in SpanningTree(s.mechanism).joints) for s in scenes) > 24


@pytest.mark.slow
def test_some_are_redundant():
    scenes = [random_scene(0, number) for number in range(COUNT)]
    assert sum(undetermined_joints(scene, initial_state(scene))[0] > 0 for scene in scenes) > 1


def test_mechanisms_are_reproducible_and_move():
    one, again, other = random_scene(3, 14), random_scene(3, 14), random_scene(3, 15)
    assert one.name == "random_3_14"
    assert one.mechanism.joint_names == again.mechanism.joint_names
    for name in ("position", "quaternion", "linear_velocity", "angular_velocity"):
        x, y = (getattr(initial_state(scene), name) for scene in (one, again))
        assert x.tobytes() == y.tobytes()
    assert initial_state(one).position.shape != initial_state(other).position.shape
    for scene in (one, other):
        drawn = np.array([body.center_of_mass for body in scene.mechanism.bodies])
        size = scene.mechanism.size
        assert np.max(np.abs(initial_state(scene).position - drawn)) > 0.01 * size
        assert np.max(np.abs(initial_state(scene).angular_velocity)) > 0.1  # rad/s


@pytest.mark.parametrize("number", range(20))
def test_states_are_consistent(number):
    """Joints closed to round-off of the size, and opening no faster than round-off of the speed."""
    scene = random_scene(1, number)
    system = Relative(scene)
    q, v = system.coordinates(initial_state(scene))
    size, speed = scene.mechanism.size, float(np.max(np.abs(v / system.velocity_units)))
    assert np.max(np.abs(system.joint_phi(q)), initial=0.0) < 1e-13 * max(size, 1.0)
    if not scene.motions:
        opening = system.phi_jacobian(q) @ v / system.phi_units
        assert np.max(np.abs(opening), initial=0.0) < 1e-13 * speed
    e = system.evaluate(q, v)
    for name in ("position", "quaternion", "linear_velocity", "angular_velocity"):
        x, y = getattr(e.state, name), getattr(initial_state(scene), name)
        if name == "quaternion":
            x = x * np.sign(np.sum(x * y, axis=1))[:, None]
        assert np.max(np.abs(x - y)) < 1e-12 * max(size, 1.0) * max(speed, 1.0)


class Wrong(Cartesian):
    """Accelerations off by a millionth."""

    def evaluate(self, q, v):
        found = super().evaluate(q, v)
        return replace(found, linear_acceleration=found.linear_acceleration * (1.0 + 1e-6))


class Refusing(Cartesian):
    def evaluate(self, q, v):
        raise SingularityError("elbow", "no answer")


class Failing(Cartesian):
    def evaluate(self, q, v):
        raise np.linalg.LinAlgError("SVD did not converge")


@pytest.mark.parametrize(
    ("kind", "named"),
    [(Wrong, "effective force"), (Refusing, "elbow"), (Failing, "SVD did not converge")],
)
def test_an_error_is_found_and_named(monkeypatch, kind, named):
    monkeypatch.setattr(random_mechanisms, "Cartesian", kind)
    case = next(random_mechanisms.cases(False, [ENGINES["newton_euler"]]))
    row = run_case(replace(case, measure=partial(measure, 0, [3])))
    assert (row.verdict, row.passes, np.isinf(row.value)) == ("fails", False, kind is not Wrong)
    assert row.reason.startswith("0 of 1 agree; worst: random_scene(0, 3), ")
    assert named in row.reason


def test_weak_closures_beside_redundant_ones():
    """An eigenvalue 1e-8 of the others: at a regularization of 1e-6 of them it is never seen."""
    jacobian = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1e-4, 0.0]])
    settings, ratio = regularized(jacobian, np.eye(3), redundant=1)
    assert (settings.mu / (settings.mu + 1e-8)) ** MAX_PROXIMAL_ITERATIONS < 1e-16
    assert ratio * settings.mu == pytest.approx(2.0 / 3.0)
    # no weak one, so what drift needs
    assert regularized(jacobian[:2], np.eye(3), redundant=1)[0].mu == pytest.approx(1e-6)
    assert regularized(np.zeros((2, 3)), np.eye(3), redundant=2)[0].mu == pytest.approx(1e-6)


def test_every_mechanism_has_a_case_of_every_system():
    found = Counter()
    for case in random_mechanisms.cases(True, [*ENGINES.values()]):
        found[case.setting.engine, str(case.setting)] += len(case.measure.args[1])
    assert found == {
        (setting.engine, str(setting)): count
        for settings, count in ((COMPARED, 1000), (NATIVE_SETTINGS, 20))
        for setting in settings
    }


@pytest.mark.slow
def test_a_thousand_mechanisms():
    rows = stress("h", True, [*ENGINES.values()], lambda line: None)
    assert [row for row in rows if not row.passes] == []
