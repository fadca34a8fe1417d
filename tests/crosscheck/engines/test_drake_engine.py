"""Drake as an engine: equations and runs against newton_euler's and closed forms, and what it refuses."""

from __future__ import annotations

from dataclasses import replace

import ball_scenes
import numpy as np
import pytest
from armed_scenes import COMPOUNDS, armed, sprung
from elements import COUPLED, ELEMENTS
from engine_equations import failures
from mechanisms import GRAVITY, bar, pendulum

pytest.importorskip("pydrake")

from crosscheck.engines.benchmarks import poses_only
from crosscheck.engines.drake import ENGINE
from crosscheck.engines.drake.equations import DrakeSystem
from crosscheck.engines.drake.simulate import simulate
from crosscheck.engines.limits import no_limits
from crosscheck.engines.registry import choose
from crosscheck.library import SCENES, load
from crosscheck.studies.benchmark.reference import pose_errors
from crosscheck.studies.conformance_tests import EngineConformance
from newton_euler import simulate as reference
from newton_euler.errors import OptionError, SingularityError, UnknownNameError
from newton_euler.model.digital_control import Sampled
from newton_euler.model.forces import PointSpring
from newton_euler.model.joint_kinds import Fixed, Revolute, Universal
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import IntegrationError, distance
from newton_euler.runs.assemble import initial_state

FAST_SCENES = ("bricard", "chain", "four_bar", "heavy_top", "tracker_on_boat", "tracker_computed_torque")
"""Scenes of the library whose equations are compared in the fast tests."""

FAST_ELEMENTS = (
    "planar, cut",
    "screw, cut",
    "rods",
    "motion, cut",
    "forces, slider_tree",
    "friction of loaded joints",
)
"""Elements whose equations are compared in the fast tests."""

ROTORS = ball_scenes.SCENES | {
    f"armed {name}": sprung(armed(scene))
    for name, scene in COMPOUNDS.items()
    if name not in ball_scenes.SCENES
}
"""Scenes with rotors, and with springs of Drake's own, on hinges, slides and balls."""


@pytest.mark.slow  # CI runs `crosscheck engine-check` with this engine, too
class TestContract(EngineConformance):
    engine = ENGINE


@pytest.mark.parametrize("name", FAST_SCENES)
def test_equations(name):
    scene = load(name)
    assert failures(scene, DrakeSystem(scene), others=1) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(SCENES.keys() - set(FAST_SCENES)))
def test_equations_of_the_other_scenes(name):
    scene = load(name)
    assert failures(scene, DrakeSystem(scene)) == []


@pytest.mark.parametrize("name", FAST_ELEMENTS)
def test_equations_of_elements(name):
    scene = ELEMENTS[name]
    assert failures(scene, DrakeSystem(scene), others=1) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", [*ELEMENTS, *COUPLED])
def test_equations_of_all_elements(name):
    scene = (ELEMENTS | COUPLED)[name]
    assert failures(scene, DrakeSystem(scene)) == []


@pytest.mark.parametrize("name", ROTORS)
def test_rotors_and_springs(name):
    scene = ROTORS[name]
    assert failures(scene, DrakeSystem(scene), others=1) == []


def test_springs_of_joints_and_points_are_those_of_drake():
    scene = ELEMENTS["forces, slider_tree"]
    springs = DrakeSystem(scene).placed.built.springs
    assert {spring.kind for spring in springs} == {"joint_spring", "point_spring"}


def test_a_wrong_force_of_newton_euler_is_found(monkeypatch):
    """Drake's forces do not come from the methods that newton_euler's equations call."""
    scene = load("tracker_wind")
    kind = type(scene.body_forces[0])
    right = kind.wrenches
    monkeypatch.setattr(kind, "wrenches", lambda self, at: [(b, 1.01 * w) for b, w in right(self, at)])
    found = failures(scene, DrakeSystem(scene), others=1)
    assert ("dynamics", "effective force, rel") in found


def test_a_mechanism_that_cannot_move():
    body = Body("post", 2.0, [0.1, 0.2, 0.3], 0.1 * np.eye(3))
    mechanism = Mechanism([Body.ground(), body], [Fixed("foot", "ground", "post", np.zeros(3))])
    run = simulate(Scene("post", mechanism, 0.1, 0.1, [0.0, 0.0, -10.0]))
    np.testing.assert_allclose(run.reaction_force[-1], [[0.0, 0.0, 20.0]], atol=1e-12)
    np.testing.assert_allclose(run.reaction_torque[-1], [[4.0, -2.0, 0.0]], atol=1e-12)


@pytest.mark.parametrize(("name", "duration"), [("pendulum", 0.5), ("four_bar", 0.2), ("tracker", 0.02)])
def test_default_runs(name, duration):
    scene = replace(load(name), duration=duration, output_period=0.2 * duration)
    run, exact = ENGINE.simulate(scene), reference(scene, rtol=1e-12, atol=1e-14)
    # both integrate with rtol 1e-10
    assert distance(run, exact) < 1e-8
    for quantity in ("reaction_force", "actuator_force", "work", "kinetic_energy"):
        if (needed := getattr(exact, quantity)) is not None and needed.size:
            found = getattr(run, quantity)
            np.testing.assert_allclose(found, needed, atol=1e-7 * np.max(np.abs(needed)), err_msg=quantity)


def swing_with(law) -> Scene:
    """A bar on a hinge with a control law."""
    hinge = Revolute("hinge", "ground", "bar", np.zeros(3), axis=[0.0, 1.0, 0.2], actuated=True)
    mechanism = Mechanism([Body.ground(), bar("bar", [0.0, 0.0, 0.0], [0.4, 0.1, 0.0])], [hinge])
    return Scene("swing", mechanism, 0.2, 0.1, GRAVITY, control=(law,))


def test_a_sampled_controller():
    scene = swing_with(Sampled("hinge", lambda t, x, rate: 3.0 * np.cos(7.0 * t) - x[0], period=0.04))
    run, exact = simulate(scene), reference(scene, rtol=1e-12, atol=1e-14)
    assert distance(run, exact) < 1e-9
    np.testing.assert_allclose(run.work, exact.work, atol=1e-9)


def test_a_diverging_run_stops():
    scene = load("flyball_governor")
    with pytest.raises(IntegrationError) as caught:
        simulate(scene, "Euler", step=0.05)
    assert caught.value.partial is not None


@pytest.mark.parametrize(
    ("settings", "error"),
    [
        ({"stabilization": "baumgarte"}, UnknownNameError),
        ({"rest": 1e-3}, OptionError),
        ({"alpha": 1.0}, UnknownNameError),
    ],
)
def test_unknown_settings(settings, error):
    with pytest.raises(error):
        simulate(pendulum(), **settings)


def test_equations_have_no_limits():
    assert ENGINE.limits is no_limits


def test_an_error_of_drake_is_one_of_the_equations():
    """Drake raises an exception for a spring of its own at length zero, where its force has no direction."""
    scene = pendulum()
    point = scene.mechanism.bodies[1].center_of_mass
    spring = PointSpring(
        "cord", "ground", scene.mechanism.body_names[1], point, point, stiffness=1.0, rest_length=0.1
    )
    system = DrakeSystem(replace(scene, forces=(spring,)))
    with pytest.raises(SingularityError, match="Drake") as caught:
        system.acceleration(*system.coordinates(initial_state(scene)))
    assert caught.value.joint is None


def test_a_state_that_is_not_finite_is_attributed_to_no_joint():
    system = DrakeSystem(pendulum())
    q, _ = system.coordinates(initial_state(system.scene))
    with pytest.raises(SingularityError) as caught:
        system.acceleration(q, np.full(system.nv, np.nan))
    assert caught.value.joint is None
    assert "joint" not in str(caught.value)


@pytest.mark.parametrize(
    ("scene", "joint", "level"),
    [
        (load("four_bar"), "ball_1", "model"),
        (load("bricard"), "hinge_4", "kinematics"),  # a hinge: a weld of two halves of a body closes the loop
        (ball_scenes.two_ball_loop(loaded="at_c"), "at_b", "model"),
    ],
)
def test_a_moved_anchor_is_found(scene, joint, level):
    system = ENGINE.with_moved_anchor(scene, joint, np.array([0.0, 0.0, 1e-3]))
    assert level in {found for found, _ in failures(scene, system, others=1)}
    with pytest.raises(UnknownNameError) as caught:  # a joint of the tree
        ENGINE.with_moved_anchor(scene, scene.mechanism.joint_names[0], np.ones(3))
    assert joint in caught.value.valid


def test_names_that_could_clash_in_drake():
    """A joint of two motions beside joints with the names of these motions in files, and names of Drake's."""
    bodies = ["world", "WorldBody", "a"]
    bars = [bar(name, [0.4 * k, 0.0, 0.0], [0.4 * k + 0.4, 0.1, 0.0]) for k, name in enumerate(bodies)]
    axes = {"axis_on_first": [0.0, 1.0, 0.0], "axis_on_second": [0.0, 0.0, 1.0]}
    joints = [
        Universal("a", "ground", "world", np.zeros(3), **axes),
        Revolute("a_1", "world", "WorldBody", [0.4, 0.0, 0.0], axis=[0.0, 1.0, 0.3]),
        Revolute("a_2", "WorldBody", "a", [0.8, 0.0, 0.0], axis=[0.3, 1.0, 0.0]),
    ]
    scene = Scene("names", Mechanism([Body.ground(), *bars], joints), 0.1, 0.1, GRAVITY)
    assert failures(scene, DrakeSystem(scene), others=1) == []


def test_benchmarks_become_more_accurate_from_setting_to_setting():
    scene = poses_only(replace(load("chain"), duration=0.2, output_period=0.1))
    exact = reference(scene, rtol=1e-12, atol=1e-14)
    for name, make in ENGINE.benchmarks().models(scene).items():
        model = make()
        (ladder,) = model.ladders
        assert 6 <= len(ladder.numbers) <= 10  # more would take minutes
        coarse, fine = (
            max(pose_errors(model.run(options).poses(), (exact.position, exact.quaternion)))
            for _, options in (ladder.setting(ladder.numbers[end]) for end in (0, -1))
        )
        assert fine < 0.03 * coarse, name  # SAP, of order 1: a fiftieth of the step


def test_the_registry_has_the_engine():
    assert choose(["drake"]) == [ENGINE]
