"""The energy balance of runs: energy changes by the work that is integrated beside the motion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from armed_scenes import COMPOUNDS, armed, sprung
from ball_scenes import twisted_loop
from elements import forced
from mechanisms import ball_loop, pendulum, planar_four_bar, seven_hinges
from verdicts import verdicts

import mjcf
import newton_euler
from crosscheck.engines.energy import energy_balance
from crosscheck.engines.registry import ENGINES
from crosscheck.library import load
from newton_euler import PD, Body, JointSpring, Mechanism, Scene
from newton_euler.compiled.formulations import FORMULATIONS
from newton_euler.model.joint_kinds import Prismatic
from newton_euler.model.motions import PrescribedMotion
from newton_euler.model.smooth_functions import Sine

EXAMPLE = str(Path(__file__).parents[3] / "examples" / "four_bar.yaml")


def share(scene, run):
    """The largest residual of the balance relative to the energy scale of the run."""
    balance = energy_balance(scene, run)
    return np.abs(balance.residual).max() / balance.scale


@pytest.mark.parametrize(
    ("integrator", "formulation"),
    [
        ("DOP853", "relative"),
        ("DOP853", "cartesian"),
        ("Radau", "relative"),
        pytest.param("Radau", "cartesian", marks=pytest.mark.slow),  # 7 s to compile the Jacobian
    ],
)
def test_the_trackers_balance(tracker, tracker_run, formulation, integrator):
    """1e-9: the integration at a tolerance of 1e-10 a step."""
    assert share(tracker, tracker_run(formulation=formulation, integrator=integrator)) < 1e-9


def test_the_balance_sees_missing_energy(tracker, tracker_run):
    run = tracker_run()
    for lost in ("kinetic_energy", "work"):
        lossy = replace(run, **{lost: getattr(run, lost) * (1.0 - 1e-7)})
        assert share(tracker, lossy) > 1e-8


@pytest.mark.parametrize("damping", [0.05, 50.0])
@pytest.mark.parametrize("period", [0.01, 0.5])
def test_the_balance_does_not_depend_on_the_outputs(period, damping):
    """Down to a single output between start and end, and transients of 1 ms (50 N m s/rad)."""
    scene = replace(load(EXAMPLE), output_period=period)
    scene = replace(scene, control=(replace(scene.control[0], damping=damping),))
    assert share(scene, newton_euler.simulate(scene)) < 1e-8


BALANCED = {
    "springs, dampers and wrenches, cut at a ball": replace(forced(ball_loop()), duration=2.0),
    "springs, dampers and wrenches, cut at a hinge": replace(forced(seven_hinges()), duration=2.0),
    "springs, dampers and rotors on balls": twisted_loop(),
    "rotors and compound joints": replace(armed(COMPOUNDS["compound, cut"]), duration=0.6),
    "springs on redundant hinges": sprung(planar_four_bar()),
}


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("name", BALANCED)
def test_loops_keep_the_balance(name, formulation):
    """1e-8: a few hundred steps at a tolerance of 1e-10."""
    scene = BALANCED[name]
    run = newton_euler.simulate(scene, formulation)
    assert share(scene, run) < 1e-8
    assert np.ptp(run.kinetic_energy) > 0.1  # J
    if scene.tracks_work:
        assert np.abs(run.work).max() > 0.1  # J


def driven_pendulum():
    """A pendulum of 1 kg whose hinge is on a cart of 2 kg that swings to and fro by 5 cm, from rest."""
    cart = Body("cart", 2.0, np.zeros(3), np.eye(3))
    rail = Prismatic("rail", "ground", "cart", np.zeros(3), axis=[1.0, 0.0, 0.0])
    scene = pendulum(angle=0.5)
    pivot = replace(scene.mechanism.joints[0], first="cart")
    mechanism = Mechanism([Body.ground(), cart, scene.mechanism.bodies[1]], [rail, pivot])
    swing = PrescribedMotion("rail", Sine(0.05, 8.0, 0.5 * np.pi, -0.05))
    return Scene("driven", mechanism, 1.0, 0.05, scene.gravity, motions=(swing,))


def test_mujocos_work_of_a_prescribed_motion_is_that_of_its_steps():
    """Its multiplier is off by 0.1 % in each stage of RK4, at any step; that leaves as much of the energy."""
    scene = driven_pendulum()
    coarse, fine = (share(scene, mjcf.simulate(scene, timestep=step)) for step in (1e-3, 5e-4))
    assert coarse < 1e-5
    assert fine < 0.6 * coarse  # order 1


@pytest.mark.parametrize("integrator", ["Euler", "implicit", "implicitfast"])
def test_mujocos_work_of_a_stiff_damper_is_that_of_its_steps(integrator):
    """What servo and damper do is opposite but for a thousandth; powers at outputs make 10 % of nothing."""
    scene = replace(pendulum(), duration=0.5)
    joint = replace(scene.mechanism.joints[0], actuated=True)
    scene = replace(scene, mechanism=Mechanism(scene.mechanism.bodies, [joint]))
    damper = JointSpring("pivot", stiffness=0.0, damping=2e3)
    scene = replace(scene, control=(PD("pivot", 2e3, 0.0, 0.5),), forces=(damper,))
    assert share(scene, mjcf.simulate(scene, timestep=1e-3, integrator=integrator)) < 1e-2


def test_energy_needs_its_outputs():
    scene = replace(pendulum(), outputs=frozenset({"velocities", "reactions", "violation"}), duration=0.1)
    rows = verdicts(scene, [ENGINES["newton_euler"], ENGINES["pinocchio"]])
    assert not [row for row in rows if "energy" in row.quantity and row.level == "energy"]


def test_no_balance_without_the_work(tracker, tracker_run):
    run = tracker_run()
    assert energy_balance(tracker, replace(run, work=None)) is None
    assert energy_balance(tracker, replace(run, kinetic_energy=None)) is None
    assert energy_balance(replace(tracker, control=()), replace(run, work=None)) is not None


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize(
    ("build", "joint"), [(pendulum, "pivot"), (planar_four_bar, "at_a"), (ball_loop, "at_a")]
)
def test_prescribed_motions_work(formulation, build, joint):
    """Motors that enforce a motion, beside a damped spring; joints kept and cut, redundant rows or none."""
    scene = replace(
        build(),
        motions=(PrescribedMotion(joint, Sine(0.3, 4.0)),),
        forces=(JointSpring(joint, 3.0, 0.5),),
        initial_state=None,
    )
    run = newton_euler.simulate(scene, formulation)
    assert np.abs(run.work).max() > 0.1  # J
    assert share(scene, run) < 1e-9
