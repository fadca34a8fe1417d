"""Verdicts: sound mechanisms agree however they move or rest, and small errors are found and placed."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mechanisms import GRAVITY, REGULAR, bar, pendulum, planar_four_bar, scaled, seven_hinges
from verdicts import ALL, figure, verdicts

import mjcf
from crosscheck.compare.check import LEVELS_OF_EQUATIONS, Check, not_compared
from crosscheck.compare.levels import compare, compare_equations, sample_engines
from crosscheck.compare.momentum import momentum_check
from crosscheck.compare.runs import compare_runs
from crosscheck.compare.samples import Samples, States
from crosscheck.engines.registry import ENGINES
from crosscheck.library import load
from crosscheck.studies.stress.noise import sarrus
from crosscheck.support.errors import CrosscheckError
from mjcf.loops import loops_with_rows
from mjcf.rigid import RigidMuJoCo
from newton_euler.equations.redundancy import mobility
from newton_euler.equations.relative import Relative
from newton_euler.model.couplings import Gear
from newton_euler.model.joint_kinds import Free, Revolute
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.reading.excitation import random_states
from newton_euler.runs.assemble import initial_state

EXAMPLE = str(Path(__file__).parents[3] / "examples" / "four_bar.yaml")
PAIRS = (("newton_euler", "mujoco"), ("newton_euler", "pinocchio"), ("mujoco", "pinocchio"))


def assert_agrees(rows):
    assert rows
    assert [row for row in rows if not row.agrees] == []


def free_body(gravity=(0.0, 0.0, 0.0)):
    body = bar("stone", [1.0, 1.0, 1.0], [1.2, 1.0, 1.3])
    mechanism = Mechanism([Body.ground(), body], [Free("floats", "ground", "stone", [0.0, 0.0, 0.0])])
    return Scene("free_body", mechanism, 0.2, 0.02, gravity)


def truss(gravity=(0.0, 0.0, 0.0)):
    """Two bars and three parallel hinges: a loop that cannot move."""
    a, b, c = [0.0, 0.0, 0.0], [0.4, 0.0, 0.5], [1.0, 0.0, 0.0]
    joints = [
        Revolute("at_a", "ground", "left", a, axis=[0.0, 1.0, 0.0]),
        Revolute("at_b", "left", "right", b, axis=[0.0, 1.0, 0.0]),
        Revolute("at_c", "ground", "right", c, axis=[0.0, 1.0, 0.0]),
    ]
    mechanism = Mechanism([Body.ground(), bar("left", a, b), bar("right", b, c)], joints)
    return Scene("truss", mechanism, 0.2, 0.02, gravity)


RESTING = {
    "free body at rest": free_body,
    "free fall": lambda: free_body(GRAVITY),
    "truss": truss,
    "truss with a weight": lambda: truss(GRAVITY),
    "hanging pendulum": lambda: pendulum(angle=0.0),
    "planar four-bar without gravity": lambda: replace(planar_four_bar(), gravity=np.zeros(3)),
    "seven hinges without gravity": lambda: replace(seven_hinges(), gravity=np.zeros(3)),
    "four-bar that nothing drives": lambda: replace(load(EXAMPLE), control=(), gravity=np.zeros(3)),
}


@pytest.mark.parametrize("kind", RESTING)
def test_what_rests_or_falls_agrees(kind):
    assert_agrees(verdicts(replace(RESTING[kind](), duration=0.2, output_period=0.02)))


@pytest.mark.parametrize("build", [*REGULAR, planar_four_bar], ids=lambda build: build.__name__)
def test_mechanisms_agree(build):
    assert_agrees(verdicts(replace(build(), duration=0.3, output_period=0.02)))


@pytest.mark.parametrize("factor", [0.05, 1e3])
def test_mechanisms_of_other_sizes_agree(factor):
    scene = scaled(replace(planar_four_bar(), duration=0.1, output_period=0.02), factor)
    assert_agrees(verdicts(scene))


def test_errors_that_grow_are_measured():
    """After 3 s the swinging loop has made 1e-10 a step into 3e-8, and MuJoCo's springs into 5e-5."""
    rows = verdicts(replace(planar_four_bar(), duration=3.0))
    assert_agrees(rows)
    own, soft = (
        figure(rows, "trajectories", "positions, m", "newton_euler", name) for name in ("pinocchio", "mujoco")
    )
    assert own.value > 2e-9  # more than the fixed shares of the two
    assert soft.value > 1e-5


def test_tracker_is_held_to_what_it_can_meet(tracker, tracker_run):
    engines = [ENGINES["newton_euler"], ENGINES["mujoco"]]
    rows = compare(tracker, engines, {"newton_euler": tracker_run(), "mujoco": mjcf.simulate(tracker)}, 5)
    assert_agrees(rows)
    for row in rows:
        if row.level in LEVELS_OF_EQUATIONS and row.judged:
            # round-off at condition 1e4, relative to the mechanism's motion. In differences over 1e-3 rad
            # the round-off of velocities, 1e-16, counts 1e3 times
            bound = 1e-12 if row.quantity == "joint acceleration, rel" else 1e-13
            assert row.value < bound, row
    # errors of order 2 in a step of 1 ms: 7.3e-9 m, and a bound three times that
    assert 1e-8 < figure(rows, "trajectories", "positions, m", "newton_euler", "mujoco").tolerance < 5e-8
    # a spline through points 10 ms apart misses 1e-6 where the dampers act within 9 ms
    assert figure(rows, "energy", "energy balance error, rel", "newton_euler").tolerance < 5e-5


def test_a_ball_on_the_axis_of_a_hinge_is_a_joint_of_both_models(tmp_path):
    """Nothing that moves opens it, so MuJoCo has no rows for it."""
    (tmp_path / "held.xml").write_text(
        '<mujoco><worldbody><body name="arm"><joint name="hinge" axis="0 1 0"/>'
        '<geom size="0.1" pos="1 0 0"/></body></worldbody>'
        '<equality><connect name="ball" body1="arm" body2="world" anchor="0 0.3 0"/></equality></mujoco>'
    )
    scene = mjcf.read(tmp_path / "held.xml", duration=0.1, output_period=0.05).scene
    system = RigidMuJoCo(scene)
    ball = system.joint_geometry()["ball"]
    assert ball.kinds == ("ball",)
    assert ball.points == pytest.approx(np.array([[0.0, 0.3, 0.0]] * 2), abs=1e-15)  # round-off
    assert loops_with_rows(system.model, system.data) == []
    assert_agrees(verdicts(scene))


def test_drift_of_mujoco_counts_its_soft_gears():
    """Open at the follower by what the poses of two geared bars say; more if it is softer."""
    ends = [0.0, 0.0, 0.0], [2.0, 0.0, 0.0]
    hinges = [
        Revolute(name, "ground", name, end, axis=[0.0, 1.0, 0.0])
        for name, end in zip(("one", "two"), ends, strict=True)
    ]
    bars = [bar(joint.name, joint.point, joint.point + np.array([0.5, 0.0, 0.0])) for joint in hinges]
    mechanism = Mechanism([Body.ground(), *bars], hinges, [Gear("pair", "one", "two", -2.0)])
    scene = Scene("geared", mechanism, 0.5, 0.05, GRAVITY)
    stiff, soft = mjcf.simulate(scene), mjcf.simulate(scene, solref=[0.02, 1.0])
    for run in (stiff, soft):
        half = np.unwrap(np.arctan2(run.quaternion[..., 2], run.quaternion[..., 0]), axis=0)
        _, one, two = 2.0 * (half - half[0]).T
        assert run.constraint_violation[:, 0] == pytest.approx(0.0, abs=1e-15)  # a hinge of the tree
        opened = np.abs(two + 2.0 * one)
        assert run.constraint_violation[:, 1] == pytest.approx(opened, abs=1e-13)  # round-off
    assert np.max(soft.constraint_violation) > 10.0 * np.max(stiff.constraint_violation) > 1e-9
    row = figure(verdicts(scene), "drift", "constraint violation, m or rad", "mujoco")
    assert row.value == np.max(stiff.constraint_violation)
    assert row.agrees
    assert row.where.startswith("two")


def with_joint(scene, index, **values):
    joints = list(scene.mechanism.joints)
    joints[index] = replace(joints[index], **values)
    return replace(scene, mechanism=Mechanism(scene.mechanism.bodies, joints), initial_state=None)


def with_body(scene, index, **values):
    bodies = list(scene.mechanism.bodies)
    bodies[index] = replace(bodies[index], **values)
    return replace(scene, mechanism=Mechanism(bodies, scene.mechanism.joints), initial_state=None)


def heavier(scene, share=1e-6):
    return with_body(scene, 2, mass=(1.0 + share) * scene.mechanism.bodies[2].mass)


def with_other_inertia(scene):
    changed = np.array(scene.mechanism.bodies[2].inertia)
    changed[1, 1] *= 1.0 + 1e-6
    return with_body(scene, 2, inertia=changed)


def with_other_point(scene):
    point = scene.mechanism.joints[1].point + np.array([1e-6 * scene.mechanism.size, 0.0, 0.0])
    return with_joint(scene, 1, point=point, point_on_second=point)


def with_other_axis(scene):
    return with_joint(scene, 3, axis=[1e-6, 1.0, 0.0])


def with_other_gain(scene):
    (law,) = scene.control
    return replace(scene, control=(replace(law, stiffness=(1.0 + 1e-6) * law.stiffness),))


def mistaken(engine, mistake):
    """An engine that takes every scene for another."""
    return replace(
        engine,
        simulate=lambda scene: engine.simulate(mistake(scene)),
        refined=lambda scene: engine.refined(mistake(scene)),
        systems=lambda scene: engine.systems(mistake(scene)),
        soft_constraints=None,
    )


def with_other_gravity(scene):
    return replace(scene, gravity=scene.gravity + np.array([1e-5, 0.0, 0.0]))


MISTAKES = [
    (heavier, "model", "mass, rel", "coupler"),
    (with_other_inertia, "model", "inertia, rel", "coupler"),
    (with_other_point, "model", "joint points, m", "elbow"),
    (with_other_axis, "model", "joint axes, rad", "pivot"),
    (with_other_gain, "dynamics", "actuator force, rel", "motor"),
    (with_other_gravity, "dynamics", "potential energy, rel", "gravity"),
]


@pytest.mark.parametrize("name", ["newton_euler", "mujoco", "pinocchio"])
@pytest.mark.parametrize(("mistake", "level", "quantity", "where"), MISTAKES)
def test_an_error_of_a_millionth_in_one_engine_is_found_and_placed(name, mistake, level, quantity, where):
    scene = load(EXAMPLE)
    engines = [replace(engine, soft_constraints=None) for engine in ALL]
    engines = [mistaken(e, mistake) if e.name == name else e for e in engines]
    states = States(scene, (initial_state(scene), *random_states(scene, 5)))
    found = compare_equations(engines, sample_engines(engines, states))
    rows = [row for row in found if row.between in PAIRS]
    failed = [row for row in rows if not row.agrees]
    assert {row.between for row in failed} == {pair for pair in PAIRS if name in pair}
    assert all((row.level, row.where) == (level, where) for row in failed)
    assert quantity in {row.quantity for row in failed}
    others = [other for pair in PAIRS if name in pair for other in pair if other != name]
    assert list(not_compared(rows)) == [f"not compared after {level!r}: {name} with {' and '.join(others)}"]
    for pair in PAIRS:
        last = [row.level for row in rows if row.between == pair][-1]
        assert last == (level if name in pair else "accelerations and reactions")


@pytest.mark.parametrize(("mistake", "where"), [(heavier, "coupler"), (with_other_inertia, "coupler")])
def test_momentum_tells_of_one_engine_alone(mistake, where):
    """Accelerations and reactions of a wrong body do not satisfy the equations of the right one."""
    scene = load(EXAMPLE)
    states = States(scene, (initial_state(scene), *random_states(scene, 2)))
    for engine in ALL:
        (right, *_), (wrong, *_) = (
            sample_engines([e], states)[engine.name] for e in (engine, mistaken(engine, mistake))
        )
        row = momentum_check(engine.name, right)
        assert row.value < 1e-13  # some hundred operations at 1e-16 each
        assert row.agrees
        row = momentum_check(engine.name, wrong)
        assert not row.agrees
        assert row.where == where


def test_noise_in_runs_counts_with_the_condition_of_the_constraints():
    """As at the levels before: two forms that omit other combinations of rows are 10 singular values apart
    times the condition, here 9."""
    scene = replace(sarrus(1e-4), duration=0.3)
    engines = [engine for engine in ALL if engine.soft_constraints is None]
    runs = {engine.name: engine.simulate(scene) for engine in engines}
    rows = list(compare_runs(scene, engines, runs, energy=1.0))
    assert all(row.agrees for row in rows)
    (apart,) = (row for row in rows if row.quantity == "orientations, rad")
    assert apart.value > 10.0 * mobility(scene).residual


def test_levels_that_were_not_compared_are_left_out_of_runs():
    scene = replace(load(EXAMPLE), duration=0.1)
    rows = verdicts(scene, [ENGINES["newton_euler"], mistaken(ENGINES["pinocchio"], heavier)])
    pair = [row for row in rows if len(row.between) == 2 and set(row.between) <= set(ENGINES)]
    assert {row.level for row in pair} == {"model"}
    alone = {(row.level, row.between) for row in rows if len(row.between) == 1}
    assert ("drift", ("newton_euler",)) in alone
    assert ("energy", ("pinocchio",)) in alone


def test_refinement_does_not_excuse_a_wrong_model():
    """The refined run has the same error; only what the step is to blame for may differ."""
    scene = replace(load(EXAMPLE), duration=0.3)
    wrong = mistaken(ENGINES["mujoco"], lambda scene: heavier(scene, 1e-3))
    rows = verdicts(scene, [ENGINES["newton_euler"], replace(wrong, systems=ENGINES["mujoco"].systems)])
    assert next(row for row in rows if not row.agrees).level == "trajectories"


def test_systems_are_made_once_and_runs_refined_once_if_at_all():
    calls = Counter()

    def counted(engine):
        def count(what):
            def call(scene):
                calls[engine.name, what] += 1
                return getattr(engine, what)(scene)

            return call

        return replace(engine, systems=count("systems"), refined=count("refined"))

    engines = [counted(engine) for engine in ALL]
    verdicts(replace(pendulum(angle=0.0), duration=0.1), engines)
    assert calls == {(name, "systems"): 1 for name in ENGINES}
    calls.clear()
    verdicts(replace(planar_four_bar(), duration=0.3), engines)
    assert calls["mujoco", "refined"] == 1
    assert max(calls.values()) == 1


class Broken(Relative):
    """Constraints or velocities that are not finite."""

    broken = ""

    def phi_jacobian(self, q):
        return super().phi_jacobian(q) * (np.nan if self.broken == "constraints" else 1.0)

    def velocity_transformation(self, q):
        return super().velocity_transformation(q) * (np.inf if self.broken == "velocities" else 1.0)


@pytest.mark.parametrize(
    ("broken", "figure", "words"),
    [
        ("constraints", "bases", "independent velocities"),
        ("velocities", "free_motions", "effective inertia and force"),
    ],
)
def test_equations_that_are_not_finite_are_named(broken, figure, words):
    scene = planar_four_bar()
    system = Broken(scene)
    system.broken = broken
    samples = Samples(system, States(scene, (initial_state(scene),)))
    with np.errstate(all="ignore"), pytest.raises(CrosscheckError, match=rf"relative: {words} cannot be"):
        getattr(samples, figure)


def test_a_mass_matrix_without_a_condition_is_named(monkeypatch):
    def negative(system, q, v):
        return -np.eye(system.nv), np.zeros(system.nv)

    monkeypatch.setattr(Relative, "mass_and_force", negative)
    scene = planar_four_bar()
    states = States(scene, (initial_state(scene),))
    with pytest.raises(CrosscheckError, match="relative: the condition of the mass matrix cannot be"):
        _ = states.mass_condition


def test_a_check_without_a_verdict_agrees():
    row = Check("drift", "constraint violation, m or rad", ("mujoco",), 0.5, 1e-2, "pin")
    assert not row.agrees
    assert replace(row, judged=False).agrees
    assert not replace(row, value=float("nan")).agrees
