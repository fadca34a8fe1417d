"""Random mechanisms: what the generator makes, that engines agree on it, and that a mistake is found."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from mechanisms import GRAVITY, inertia, planar_four_bar, seven_hinges

from crosscheck.studies.random import mechanisms as random_mechanisms
from crosscheck.studies.random.mechanisms import (
    ROUND_OFF,
    SYSTEMS,
    TOLERANCE,
    Comparison,
    compare_random,
    equations_of_motion,
    joint_wrenches,
    rows_of,
    stress_random,
)
from crosscheck.studies.random.scenes import KINDS, random_scene
from newton_euler.assemble import initial_state
from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.relative import Relative
from newton_euler.errors import SingularityError
from newton_euler.model.forces import BallSpring, JointSpring, PointSpring, Wrench
from newton_euler.model.joint_kinds import JOINT_KINDS, Free
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import SpanningTree
from urdf.proximal import ITERATIONS, regularized

COUNT = 16
ENGINES = ("cartesian", "pinocchio", "mujoco_rigid")
NATIVE = ("compiled relative", "compiled cartesian")


@pytest.fixture(scope="module")
def comparisons() -> list[Comparison]:
    return [compare_random(0, number, number == 0) for number in range(COUNT)]


def test_engines_agree(comparisons):
    for c in comparisons:
        assert c.refusals == {}
        assert set(ENGINES) <= set(c.systems)
        for system in c.systems:
            # condition numbers up to 1e6 on round-off of 1e-16; the worst of these is at 2e-13
            assert c.gap(system) < 1e-10, c


def test_native_code_is_compared(comparisons):
    native = [c for c in comparisons if set(NATIVE) <= set(c.systems)]
    assert [c.number for c in native] == [0]
    for c in native:
        for system in NATIVE:
            assert c.gap(system) < 1e-12, c  # the same equations, in another order


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
    assert set(KINDS) == set(JOINT_KINDS)
    assert set(kept) == set(KINDS) - {"rod"}
    # trees keep a joint of five or six equations if they can
    assert set(cut) | {"fixed", "prismatic", "translational"} == set(KINDS)
    assert set(loops) == {0, 1, 2, 3}
    assert {len(scene.mechanism.bodies) - 1 for scene in scenes} == set(range(2, 9))
    assert set(forces) == {JointSpring, BallSpring, PointSpring, Wrench, "world", "body"}
    assert sum(len(scene.armatures) > 0 for scene in scenes) > 3
    assert sum(len(scene.control) > 0 for scene in scenes) > 3
    assert sum(len(scene.motions) > 0 for scene in scenes) > 3
    assert sum(len(scene.mechanism.couplings) > 0 for scene in scenes) > 3
    assert sum(any(not k.forward for k in SpanningTree(s.mechanism).joints) for s in scenes) > 24


def test_some_are_redundant(comparisons):
    assert sum(c.redundant > 0 for c in comparisons) > 1


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


def test_wrenches_of_joints_are_what_bodies_need():
    """Newton's and Euler's equations of each body, under gravity alone; a loop of condition 1e4."""
    scene = replace(seven_hinges(), gravity=GRAVITY)
    system = Cartesian(scene)
    e = system.evaluate(*system.coordinates(initial_state(scene)))
    found = joint_wrenches(scene, e)
    for k, body in enumerate(scene.mechanism.bodies[1:], start=1):
        tensor = body.pose.rotation @ body.inertia @ body.pose.rotation.T
        force = body.mass * (e.linear_acceleration[k] - scene.gravity)
        assert found[k - 1] == pytest.approx(
            np.concatenate([force, tensor @ e.angular_acceleration[k]]), abs=1e-10
        )


def test_equations_of_free_bodies():
    """diag(1/4, 3/4 and moments over mass and size squared); two bodies 1 m apart have a size of 0.5 m."""
    bodies = [
        Body.ground(),
        Body("one", 1.0, [0.0, 0.0, 0.0], inertia(0.1, 0.2, 0.25)),
        Body("two", 3.0, [1.0, 0.0, 0.0], inertia(0.4, 0.5, 0.6)),
    ]
    joints = [Free(f"to_{body.name}", "ground", body.name, body.center_of_mass) for body in bodies[1:]]
    scene = Scene("two", Mechanism(bodies, joints), 1.0, 0.1)
    matrix, redundant = equations_of_motion(scene)
    assert redundant == 0
    wanted = [0.25] * 3 + [0.1, 0.2, 0.25] + [0.75] * 3 + [0.4, 0.5, 0.6]
    assert matrix == pytest.approx(np.diag(wanted), abs=1e-15)


def test_redundant_equations_are_left_out():
    """A flat loop of four hinges: 18 - 1 independent equations out of 20."""
    matrix, redundant = equations_of_motion(planar_four_bar())
    assert redundant == 3
    assert matrix.shape == (18 + 17, 18 + 17)
    assert np.linalg.matrix_rank(matrix) == 18 + 17


class Wrong(Cartesian):
    """Accelerations off by a millionth."""

    def evaluate(self, q, v):
        found = super().evaluate(q, v)
        return replace(found, linear_acceleration=found.linear_acceleration * (1.0 + 1e-6))


class Refusing(Cartesian):
    def evaluate(self, q, v):
        raise SingularityError("elbow", "no answer")


@pytest.mark.parametrize(("kind", "verdict"), [(Wrong, "fails"), (Refusing, "refuses")])
def test_an_error_is_found_and_named(monkeypatch, kind, verdict):
    monkeypatch.setattr(random_mechanisms, "Cartesian", kind)
    monkeypatch.setattr(random_mechanisms, "equations_of_motion", lambda scene: (np.eye(2), 0))
    c = compare_random(0, 3)
    assert c.verdict("cartesian") == verdict
    assert c.verdict("pinocchio") == c.verdict("mujoco_rigid") == "survives"
    rows = rows_of([c], 1.0)
    assert [(row.setting, row.verdict, row.passes) for row in rows] == [
        ("cartesian, floats", verdict, False),
        ("constraintDynamics", "survives", True),
        ("rigid constraints", "survives", True),
        ("cartesian, floats", verdict, False),
    ]
    assert rows[-1].name == "random_scene(0, 3)"
    if kind is Wrong:
        # largest linear accelerations are a good part of the largest accelerations here
        assert 1e-7 < rows[-1].figure < 1e-6
        assert rows[-1].bound_reason == "3.6e-15 times condition number 1.0e+00"
    else:
        assert rows[-1].figure is None
        assert "elbow" in rows[-1].reason


def test_a_reference_without_an_answer_is_named(monkeypatch):
    class Lost(Relative):
        evaluate = Refusing.evaluate

    monkeypatch.setattr(random_mechanisms, "Relative", Lost)
    c = compare_random(0, 3)
    assert c.systems == ("relative",)
    assert [row.verdict for row in rows_of([c], 1.0)] == ["refuses", "refuses"]


def test_a_condition_number_that_cannot_be_had_explains_nothing(monkeypatch):
    monkeypatch.setattr(random_mechanisms, "equations_of_motion", lambda scene: (np.full((3, 3), np.inf), 0))
    found = compare_random(0, 3)
    assert np.isnan(found.condition)
    wrong = replace(found, gaps={("cartesian", "accelerations"): 1.0})
    assert wrong.verdict("cartesian") == "fails"


def test_algebra_that_fails_is_no_answer(monkeypatch):
    def evaluate(self, q, v):
        raise np.linalg.LinAlgError("SVD did not converge")

    monkeypatch.setattr(Cartesian, "evaluate", evaluate)
    found = compare_random(0, 3)
    assert found.verdict("cartesian") == "refuses"
    assert found.refusals["cartesian"] == "SVD did not converge"


def test_condition_numbers_explain_as_much_as_round_off():
    c = replace(compare_random(0, 3), condition=1e9)
    assert c.bound == pytest.approx(16.0 * 2.0**-52 * 1e9)
    for gap, wanted in (
        (TOLERANCE, "survives"),
        (0.99 * ROUND_OFF * 1e9, "degrades"),
        (1.01 * ROUND_OFF * 1e9, "fails"),
        (np.nan, "fails"),
    ):
        found = replace(c, gaps={("pinocchio", "reactions"): gap})
        assert found.verdict("pinocchio") == wanted
        summary, *rest = rows_of([found], 1.0)
        assert (summary.verdict, summary.passes) == (wanted, wanted != "fails")
        assert [row.verdict for row in rest] == [wanted] * (wanted != "survives")


def test_weak_closures_beside_redundant_ones():
    """An eigenvalue 1e-8 of the others: at a regularization of 1e-6 of them it is never seen."""
    jacobian = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1e-4, 0.0]])
    settings = regularized(jacobian, np.eye(3), redundant=1)
    assert (settings.mu / (settings.mu + 1e-8)) ** ITERATIONS < 1e-16
    # no weak one, so what drift needs
    assert regularized(jacobian[:2], np.eye(3), redundant=1).mu == pytest.approx(1e-6)
    assert regularized(np.zeros((2, 3)), np.eye(3), redundant=2).mu == pytest.approx(1e-6)


def test_the_report_has_a_row_for_each_system():
    told: list[str] = []
    rows = stress_random(2, 5, told.append)
    compared = [SYSTEMS[name] for name in SYSTEMS if name != "relative"]
    assert [(row.engine, row.setting) for row in rows] == compared
    assert all(row.topic == "j" and row.passes and row.verdict == "survives" for row in rows)
    assert all(row.figure is not None and row.figure <= TOLERANCE for row in rows)
    assert {row.bound for row in rows} == {"<= 1e-08"}
    by_system = dict(zip(compared, (row.reason for row in rows), strict=True))
    assert by_system[SYSTEMS["pinocchio"]].startswith("2 of 2 agree; worst: random_scene(5, ")
    assert by_system[SYSTEMS["compiled relative"]] == "1 of 1 agree; worst: random_scene(5, 0)"
    assert told == ["2 of 2 random mechanisms"]


def test_states_that_native_code_leaves_are_counted():
    c = replace(compare_random(0, 3), gaps={("compiled relative", "accelerations"): 0.0})
    (row,) = rows_of([c, replace(c, gaps={}, left=("relative",))], 1.0)
    assert row.reason.startswith("1 of 1 agree, 1 left to floats; ")


@pytest.mark.slow
def test_a_thousand_mechanisms():
    rows = stress_random(1000, 0, lambda line: None)
    for row in rows:
        print(row.name, row.engine, row.setting, row.figure, row.bound, row.bound_reason, row.reason)
    assert all(row.passes for row in rows)
    counts = {
        (row.engine, row.setting): row.reason.split()[:3] for row in rows if row.name == "random mechanisms"
    }
    for system in ("cartesian", "pinocchio", "mujoco_rigid"):
        agreeing, _, count = counts[SYSTEMS[system]]
        assert int(count) == 1000
        # condition numbers beyond 1e8 are that rare
        assert int(agreeing) >= 997
