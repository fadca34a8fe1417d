"""Elastic gears: a lead screw that raises a weight, lowers it, or holds it; springs with play."""

from dataclasses import replace

import numpy as np
import pytest
from mechanisms import MASS as BLOCK
from mechanisms import mass_on_rail

import newton_euler
from newton_euler import (
    PD,
    Body,
    ElasticGear,
    JointStop,
    Mechanism,
    Prismatic,
    Revolute,
    Scene,
    Trajectory,
    statics,
)
from newton_euler.equations.applied_forces import stiffest_switch, surroundings
from newton_euler.errors import MechanismError
from newton_euler.model.initial_pose import described_at

MASS, INERTIA, GRAVITY, LEAD = 40.0, 2e-4, 9.81, 0.005
RATIO = LEAD / (2.0 * np.pi)
WEIGHT = MASS * GRAVITY


def screw(torque: float = 0.0, duration: float = 0.5, **numbers: float) -> Scene:
    """A nut with a weight on a vertical rail, and the shaft of its screw with a motor of constant torque."""
    nut = Body("nut", MASS, np.zeros(3), np.eye(3))
    shaft = Body("shaft", 1.0, np.zeros(3), INERTIA * np.eye(3))
    vertical = {"axis": [0.0, 0.0, 1.0], "actuated": True}
    joints = [
        Prismatic("rail", "ground", "nut", np.zeros(3), **vertical),
        Revolute("bearing", "ground", "shaft", np.zeros(3), **vertical),
    ]
    gear = ElasticGear("screw", "bearing", "rail", RATIO, **{"stiffness": 1e8, "dissipation": 20.0} | numbers)
    # at the start the screw carries the weight
    gear = replace(gear, rest=-WEIGHT / gear.stiffness - 0.5 * gear.play)
    return Scene(
        "screw",
        Mechanism([Body.ground(), nut, shaft], joints),
        duration,
        duration / 100,
        gravity=[0.0, 0.0, -GRAVITY],
        control=(PD("bearing", 0.0, 0.0, 0.0, feedforward=torque),),
        forces=(gear,),
    )


def height(run: Trajectory) -> np.ndarray:
    return run.joint("rail").coordinates[:, 0]


def slow(scene: Scene) -> Trajectory:
    return newton_euler.simulate(scene, integrator="Radau", rtol=1e-9, atol=1e-13)


@pytest.mark.parametrize("efficiency", [1.0, 0.35])
def test_a_motor_raises_a_weight_against_the_friction_of_the_screw(efficiency):
    """(J + m r^2 / eta) alpha = T - r m g / eta, with the lead r per radian and a stiff screw."""
    torque = 1.5 * RATIO * WEIGHT / efficiency
    run = slow(screw(torque, forward_efficiency=efficiency))
    alpha = (torque - RATIO * WEIGHT / efficiency) / (INERTIA + MASS * RATIO**2 / efficiency)
    exact = 0.5 * RATIO * alpha * run.time**2
    # the screw's deflection changes by m a / k, 3e-6 m, and swings around it
    assert np.abs(height(run) - exact).max() < 2e-5
    assert exact[-1] > 0.05


def test_a_weight_drives_a_screw_of_positive_backward_efficiency():
    """(J + m r^2 eta) alpha = -r m g eta."""
    efficiency = 0.4
    run = slow(screw(backward_efficiency=efficiency))
    alpha = -RATIO * WEIGHT * efficiency / (INERTIA + MASS * RATIO**2 * efficiency)
    exact = 0.5 * RATIO * alpha * run.time**2
    assert exact[-1] < -0.03
    # the friction sets in over the transition speed of 1e-5 m/s
    assert np.abs(height(run) - exact).max() < 2e-5


@pytest.mark.parametrize("backward", [-0.3, -0.01])
def test_a_self_locking_screw_holds_but_for_its_creep(backward):
    """The creep s v_t at which the load on the driver, 1 + a s + b s^2, vanishes."""
    transition, forward = 1e-5, 0.3
    numbers = {"forward_efficiency": forward, "backward_efficiency": backward, "transition_speed": transition}
    run = slow(screw(duration=20.0, **numbers))
    b, a = 0.5 * (1.0 / forward + backward) - 1.0, 0.5 * (1.0 / forward - backward)
    (s,) = (root for root in np.roots([b, a, 1.0]) if -1.0 < root < 0.0)
    creep = run.linear_velocity[-1, 1, 2]
    assert creep == pytest.approx(s * transition, rel=1e-6)
    assert height(run)[-1] == pytest.approx(s * transition * 20.0, rel=1e-2)  # 2e-4 m or less in 20 s


def test_a_mass_between_two_stops_is_a_spring_with_play():
    """Free vibration through the play at a speed v: the period is 2 (play / v + pi sqrt(m / k))."""
    play, speed, stiffness = 0.02, 0.5, 1e4
    stops = [
        JointStop("rail", side, sign * 0.5 * play, stiffness) for side, sign in (("low", -1.0), ("high", 1.0))
    ]
    period = 2.0 * (play / speed + np.pi * np.sqrt(BLOCK / stiffness))
    scene = mass_on_rail(*stops, duration=5.0 * period)
    run = newton_euler.simulate(newton_euler.start(replace(scene, output_period=period), rail=(0.0, speed)))
    # rtol 1e-10 in some hundred steps
    assert np.abs(height(run)).max() < 1e-9
    assert np.abs(run.linear_velocity[:, 1, 2] - speed).max() < 1e-8


def test_a_gear_with_play_transmits_nothing_until_it_is_used_up():
    """The shaft turns alone by play / r, at the acceleration T / J."""
    play, torque = 1e-3, 0.1
    scene = replace(screw(torque, play=play), gravity=[0.0, 0.0, 0.0])
    gear = replace(scene.forces[0], rest=0.5 * play)  # y = -play / 2 at the start: contact on the other side
    free = np.sqrt(2.0 * play / RATIO * INERTIA / torque)
    scene = replace(scene, forces=(gear,), duration=float(free), output_period=float(free) / 10)
    run = newton_euler.simulate(scene)
    assert np.abs(height(run)).max() == 0.0
    angle = run.joint("bearing").coordinates[:, 0]
    assert np.abs(angle - 0.5 * torque / INERTIA * run.time**2).max() < 1e-9
    longer = newton_euler.simulate(replace(scene, duration=1.05 * float(free)))
    assert height(longer)[-1] > 0.0


@pytest.mark.parametrize(
    ("numbers", "problem"),
    [
        ({"ratio": 0.0}, "ratio is 0"),
        ({"forward_efficiency": 0.0}, "forward_efficiency is 0"),
        ({"forward_efficiency": 1.2}, "forward_efficiency is 1.2"),
        ({"backward_efficiency": 1.5}, "backward_efficiency is 1.5"),
        ({"play": -1.0}, "play is -1"),
        ({"driver": "rail"}, "connects joint 'rail' to itself"),
    ],
)
def test_impossible_gears_are_refused(numbers, problem):
    given = {"name": "g", "driver": "bearing", "follower": "rail", "ratio": 1.0, "stiffness": 1.0}
    with pytest.raises(MechanismError) as caught:
        ElasticGear(**given | numbers)
    assert "elastic gear 'g'" in str(caught.value)
    assert problem in str(caught.value)


def test_a_gear_needs_both_joints():
    scene = screw()
    with pytest.raises(MechanismError, match="unknown joint 'nowhere'"):
        replace(scene, forces=(ElasticGear("g", "bearing", "nowhere", 1.0, 1.0),))


def test_the_deflection_stays_when_the_scene_is_described_elsewhere():
    """With another rest at another initial pose, here a tenth of a second later."""
    scene = screw(1.5 * RATIO * WEIGHT, duration=0.2)
    whole = newton_euler.simulate(scene)
    half = len(whole.time) // 2
    elsewhere = described_at(scene, whole.state(half))
    assert elsewhere.forces[0].rest != scene.forces[0].rest
    start = replace(whole.state(half), angles={})  # angles are counted from the new pose
    rest_of_run = newton_euler.simulate(replace(elsewhere, duration=0.1, initial_state=start))
    # 1e-10 of the height of 0.01 m that the run reaches
    assert np.abs(rest_of_run.position[-1] - whole.position[-1]).max() < 1e-9


def test_rigid_gears_are_made_once():
    """Compiled equations are kept by the scene: another one would be compiled again."""
    scene = screw()
    assert scene.with_rigid_gears is scene.with_rigid_gears
    assert replace(scene, duration=1.0).with_rigid_gears.duration == 1.0


def test_statics_take_gears_as_rigid_and_without_friction():
    """The torque that holds the weight is r m g, also at a state with play and deflection."""
    scene = screw(forward_efficiency=0.3, backward_efficiency=-0.5, play=1e-4)
    run = newton_euler.simulate(replace(scene, duration=0.01, output_period=0.01), integrator="Radau")
    for state in (None, run.state(1)):
        held = statics(scene, state)
        assert held.actuators == ("bearing",)
        assert held.actuator_force == pytest.approx([RATIO * WEIGHT], rel=1e-12)


@pytest.mark.parametrize(
    ("numbers", "blamed"),
    [
        ({}, "stiffness of 1e+08 N/m"),  # no friction
        ({"forward_efficiency": 0.8, "transition_speed": 0.25}, "transition_speed of 0.25 m/s"),
    ],
)
def test_what_makes_steps_short_is_the_friction_or_the_stiffness_of_a_gear(numbers, blamed):
    scene = screw(**numbers)  # at rest, the gear carries the weight
    named = stiffest_switch(scene, surroundings(scene, newton_euler.initial_state(scene)))
    assert named.startswith("elastic gear 'screw' ")
    assert blamed in named
