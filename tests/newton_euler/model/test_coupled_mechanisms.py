"""Screws, gears and prescribed motions in one mechanism: derivatives, compiled programs, integrators."""

from __future__ import annotations

import numpy as np
import pytest
from constrained_motion import SYSTEMS, check_agreement, check_compiled, check_rates
from mechanisms import GRAVITY, ORIGIN, X, Y, Z, bar, wheel

import newton_euler
from newton_euler import Body, Gear, Mechanism, PrescribedMotion, Scene, Sine
from newton_euler.equations.relative import Relative
from newton_euler.equations.system import constraint_rate
from newton_euler.exercise import random_states
from newton_euler.integrators.compiled import FORMULATIONS
from newton_euler.model.joint import Joint
from newton_euler.model.joint_kinds import Cylindrical, Revolute, Screw, Universal


def everything() -> Scene:
    """A tree with a screw, a gear and a motion."""
    bodies = [
        Body.ground(),
        bar("arm", ORIGIN, [0.1, 0.1, 0.5]),
        bar("nut", [0.1, 0.1, 0.5], [0.4, 0.3, 0.6]),
        wheel("wheel", [0.5, -0.3, 0.2], 0.2),
    ]
    joints: list[Joint] = [
        Revolute("shoulder", "ground", "arm", ORIGIN, axis=[0.2, 1.0, 0.1]),
        Screw("thread", "nut", "arm", [0.1, 0.1, 0.5], axis=[0.6, 0.0, 0.8], pitch=0.15),
        Revolute("shaft", "ground", "wheel", [0.5, -0.3, 0.2], axis=[0.1, 0.2, 1.0]),
    ]
    motion = PrescribedMotion("shaft", Sine(0.4, 2.0, 0.5))
    gears = [Gear("mesh", "shaft", "shoulder", 0.7)]
    return Scene("tree", Mechanism(bodies, joints, gears), 0.5, 0.1, GRAVITY, motions=(motion,))


AXES = {"tip": (Z, X), "fork": ([0.6, 0.8, 0.0], [0.8, -0.6, 0.0])}


def loop(cut: str) -> Scene:
    """A loop with the same, and the joint that the tree cuts: a universal joint or the screw."""
    points = [ORIGIN, [0.1, 0.1, 0.5], [0.4, 0.3, 0.6], [0.9, 0.3, 0.8], X]
    names = ["ground", "arm", "nut", "strut", "link", "ground"]
    bodies = [Body.ground()] + [
        bar(name, a, b) for name, a, b in zip(names[1:-1], points[:-1], points[1:], strict=True)
    ]
    bodies.append(wheel("wheel", [0.5, -0.3, 0.2], 0.2))
    order = ["thread", "tip", "fork"] if cut == "tip" else ["tip", "thread", "fork"]
    joints: list[Joint] = [
        Universal("shoulder", "ground", "arm", ORIGIN, axis_on_first=Y, axis_on_second=[0.6, 0.0, -0.8]),
        Revolute("shaft", "ground", "wheel", [0.5, -0.3, 0.2], axis=[0.1, 0.2, 1.0]),
        Cylindrical("foot", "ground", "link", X, axis=[0.0, 0.6, 0.8]),
    ]
    for k, name in enumerate(order, start=1):
        ends = (name, names[k], names[k + 1], points[k])
        joints.append(
            Screw(*ends, axis=[0.6, 0.0, 0.8], pitch=0.15)
            if name == "thread"
            else Universal(*ends, axis_on_first=AXES[name][0], axis_on_second=AXES[name][1])
        )
    motion = PrescribedMotion(cut, Sine(0.2, 3.0, 0.1), coordinate=1)
    gears = [Gear("mesh", "shaft", "tip", 0.7), Gear("rack", "fork", "foot", 0.3)]
    return Scene(f"{cut}_loop", Mechanism(bodies, joints, gears), 0.5, 0.1, GRAVITY, motions=(motion,))


SCENES = {"tree": everything, "tip": lambda: loop("tip"), "thread": lambda: loop("thread")}


@pytest.fixture(params=SCENES, ids=str)
def scene(request):
    return SCENES[request.param]()


@pytest.fixture(params=FORMULATIONS)
def formulation(request):
    return request.param


def test_rates_and_second_rates_of_all_rows(scene, formulation):
    check_rates(SYSTEMS[formulation](scene))


def test_formulations_agree(scene):
    check_agreement(scene)


def test_compiled_programs_are_those_of_floats(scene, formulation):
    check_compiled(scene, formulation, (0.0, 0.1, 0.2, 0.3, 0.4))


@pytest.mark.parametrize(
    ("integrator", "options", "allowed"),
    [
        # not one tolerance of lengths of 1 m: 2e-12 is measured, and a tenth of that at a tenth of it
        ("Radau", {"rtol": 1e-8, "atol": 1e-10}, 1e-8),
        # h^4 and h of motions of 10 rad/s
        ("RK4", {"step": 2e-3}, 1e-6),
        ("Euler", {"step": 1e-3}, 1e-2),
    ],
)
def test_all_integrators_follow(integrator, options, allowed):
    reference = newton_euler.simulate(loop("tip"))
    run = newton_euler.simulate(loop("tip"), "relative", integrator, **options)
    assert np.abs(run.position - reference.position).max() < allowed
    assert run.constraint_violation.max() < 1e-12


def test_both_formulations_run_alike(scene):
    one, two = (newton_euler.simulate(scene, formulation) for formulation in FORMULATIONS)
    assert np.abs(one.position - two.position).max() < 1e-8  # what rtol = 1e-10 leaves
    assert max(run.constraint_violation.max() for run in (one, two)) < 1e-12


def test_cut_coordinates_are_what_they_are_meant_to_be():
    for cut, count in (("tip", 2), ("thread", 2)):
        system = Relative(loop(cut))
        assert [system.mechanism.joint_names[k] for k in system.tree.cuts] == [cut]
        assert len(system.between) == count
    assert len(Relative(everything()).between) == 0


def test_baumgarte_follows_the_motion_too(formulation):
    scene = everything()
    run = newton_euler.simulate(scene, formulation, stabilization="baumgarte")
    wanted = newton_euler.simulate(scene, formulation)
    assert np.abs(run.position - wanted.position).max() < 1e-8  # what rtol = 1e-10 leaves


def test_random_states_follow_couplings():
    scene = everything()
    for formulation in FORMULATIONS:
        system = SYSTEMS[formulation](scene)
        for state in random_states(scene, 3):
            q, v = system.coordinates(state)
            assert np.abs(system.phi(q)).max() < 1e-12
            assert np.abs(constraint_rate(system, q, v)).max() < 1e-11
