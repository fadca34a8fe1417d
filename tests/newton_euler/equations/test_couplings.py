"""Screws, gears and prescribed motions against closed forms, and their derivatives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from finite_difference import derivative
from mechanisms import GRAVITY, ORIGIN, X, Y, Z, bar, wheel

import newton_euler
from newton_euler import Body, Gear, Mechanism, Polynomial, PrescribedMotion, Scene, Sine, Sum
from newton_euler.errors import MechanismError, UnknownNameError
from newton_euler.model.forces import Wrench
from newton_euler.model.joint import Joint
from newton_euler.model.joint_kinds import Prismatic, Revolute, Screw, Spherical, Translational, Universal
from newton_euler.model.state import State
from newton_euler.runs.assemble import initial_state

FORMULATIONS = ("relative", "cartesian")
INTEGRATED = 2e-8
"""Relative error that rtol = 1e-10 leaves where Euler parameters turn through several turns."""


# Screw: m dv/dt = F - lambda, I domega/dt = T + lambda p, v = p omega

PITCH, MASS, INERTIA = 0.02, 3.0, 0.004


def nut(loads: dict[str, list[float]], swapped: bool = False) -> Scene:
    """A nut on a fixed spindle along z."""
    bodies = [Body.ground(), Body("nut", MASS, [0, 0, 0.1], np.diag([0.003, 0.003, INERTIA]))]
    pair = ("nut", "ground") if swapped else ("ground", "nut")
    mechanism = Mechanism(bodies, [Screw("thread", *pair, ORIGIN, axis=Z, pitch=PITCH)])
    return Scene("nut", mechanism, 2.0, 0.25, forces=(Wrench("load", "nut", ORIGIN, **loads),))


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("swapped", [False, True])
def test_a_screw_turns_force_into_rotation(formulation, swapped):
    """Force 5 N: a = F / (m + I / p^2). Torque 0.3 N m: a = T p / (m p^2 + I)."""
    for loads, force in (({"force": [0, 0, 5.0]}, 5.0), ({"torque": [0, 0, 0.3]}, 0.3 / PITCH)):
        run = newton_euler.simulate(nut(loads, swapped), formulation)
        a = force / (MASS + INERTIA / PITCH**2)
        wanted = 0.1 + 0.5 * a * run.time**2
        assert np.abs(run.position[:, 1, 2] - wanted).max() < INTEGRATED
        assert run.angular_velocity[-1, 1, 2] == pytest.approx(a * 2.0 / PITCH, rel=INTEGRATED)
        assert run.constraint_violation.max() < 1e-13
        sign = -1.0 if swapped else 1.0  # the reaction is that on the second body
        thrust = MASS * a - loads.get("force", [0, 0, 0])[2]
        assert run.reaction_force[:, 0, 2] == pytest.approx(sign * thrust, rel=INTEGRATED)
        assert run.reaction_torque[:, 0, 2] == pytest.approx(-sign * thrust * PITCH, rel=INTEGRATED)


# Gears


def gear_pair(ratio: float = -2.5, swapped: bool = False) -> Scene:
    """Two wheels on parallel shafts, a sampled controller that holds 3 N m on the driver."""
    bodies = [Body.ground(), wheel("one", ORIGIN, 1.0), wheel("two", X, 0.3)]
    pair = ("two", "ground") if swapped else ("ground", "two")
    joints: list[Joint] = [
        Revolute("shaft_1", "ground", "one", ORIGIN, axis=Z, actuated=True),
        Revolute("shaft_2", *pair, X, axis=Z),
    ]
    mechanism = Mechanism(bodies, joints, [Gear("mesh", "shaft_1", "shaft_2", ratio)])
    law = newton_euler.Sampled("shaft_1", lambda t, x, rate: 3.0, 1.0)
    return Scene("gears", mechanism, 4.0, 0.5, control=(law,))


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("swapped", [False, True])
def test_a_gear_pair_has_the_equivalent_inertia(formulation, swapped):
    """alpha = T / (I_1 + ratio^2 I_2), through several turns; the follower's reaction is I_2 alpha_2."""
    run = newton_euler.simulate(gear_pair(swapped=swapped), formulation)
    sign = -1.0 if swapped else 1.0
    alpha = 3.0 / (1.0 + 2.5**2 * 0.3)
    assert run.angular_velocity[:, 1, 2] == pytest.approx(alpha * run.time, rel=INTEGRATED)
    assert run.angular_velocity[:, 2, 2] == pytest.approx(-2.5 * sign * alpha * run.time, rel=INTEGRATED)
    assert 0.5 * 2.5 * alpha * 4.0**2 > 6.0 * np.pi  # three turns
    assert run.constraint_violation.max() < 1e-12  # 20 rad, round-off 4e-15
    # the mesh puts 0.3 * 2.5 alpha on the follower, and 2.5 times that on the driver
    assert run.reaction_torque[:, 1, 2] == pytest.approx(-0.3 * 2.5 * alpha, rel=INTEGRATED)
    assert run.reaction_torque[:, 0, 2] == pytest.approx(alpha - 3.0, rel=INTEGRATED)
    poses = run.quaternion[:, 2]
    angle = -2.5 * sign * 0.5 * alpha * run.time**2
    expected = np.stack([np.cos(angle / 2), 0 * angle, 0 * angle, np.sin(angle / 2)], axis=1)
    assert np.abs(np.abs((poses * expected).sum(axis=1)) - 1.0).max() < 1e-12  # squares of angles of 1e-7


@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_a_rack_and_pinion(formulation):
    """m a = m g - T / r with T = I a / r, for a rack that falls and turns a pinion of radius r."""
    r, m, inertia = 0.05, 2.0, 0.01
    rack = Body("rack", m, [0.05, 0, 0], 0.01 * np.eye(3))
    joints: list[Joint] = [
        Revolute("shaft", "ground", "pinion", ORIGIN, axis=Z),
        Translational("guide", "ground", "rack", [0.05, 0, 0], axis=Y),
    ]
    gear = Gear("mesh", "shaft", "guide", r)
    mechanism = Mechanism([Body.ground(), wheel("pinion", ORIGIN, inertia), rack], joints, [gear])
    scene = Scene("rack", mechanism, 2.0, 0.2, gravity=[0, -9.81, 0])
    run = newton_euler.simulate(scene, formulation)
    a = -m * 9.81 / (m + inertia / r**2)
    assert run.position[:, 2, 1] == pytest.approx(0.5 * a * run.time**2, rel=INTEGRATED)
    # a turn is told from the rack: a state far along is one that the scene can start from
    last = State(run.position[-1], run.quaternion[-1], run.linear_velocity[-1], run.angular_velocity[-1])
    assert abs(0.5 * a * 4.0 / r) > 4.0 * np.pi
    again = replace(scene, initial_state=newton_euler.assemble(scene, last))
    assert np.abs(initial_state(again).position - last.position).max() < INTEGRATED


# Prescribed motion

CRANK, ROD, OMEGA = 0.2, 0.7, 12.0


def slider_crank(motion: newton_euler.PrescribedMotion, gravity=(0.0, 0.0, 0.0)) -> Scene:
    """A crank about y and a slider along x, spatial joints so that nothing is redundant."""
    b, c = [CRANK, 0.0, 0.0], [CRANK + ROD, 0.0, 0.0]
    bodies = [
        Body.ground(),
        bar("crank", ORIGIN, b),
        bar("rod", b, c, 2.0),
        Body("slider", 1.5, c, 0.01 * np.eye(3)),
    ]
    joints: list[Joint] = [
        Revolute("main", "ground", "crank", ORIGIN, axis=Y),
        Spherical("pin", "crank", "rod", b),
        Universal("wrist", "rod", "slider", c, axis_on_first=Y, axis_on_second=Z),
        Prismatic("guide", "ground", "slider", c, axis=X),
    ]
    return Scene("crank", Mechanism(bodies, joints), 3.0, 0.1, gravity, motions=(motion,))


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("rtol", [1e-10, 1e-4])
def test_a_crank_at_constant_speed(formulation, rtol):
    """x = r cos wt + sqrt(l^2 - r^2 sin^2 wt), whatever the tolerance of the integration."""
    scene = slider_crank(PrescribedMotion("main", Polynomial([0.0, OMEGA])), GRAVITY)
    run = newton_euler.simulate(scene, formulation, rtol=rtol, atol=1e-2 * rtol)
    phase = OMEGA * run.time
    wanted = CRANK * np.cos(phase) + np.sqrt(ROD**2 - (CRANK * np.sin(phase)) ** 2)
    assert np.abs(run.position[:, 3, 0] - wanted).max() < 1e-13  # round-off of angles up to 36 rad
    speed = (
        -CRANK
        * OMEGA
        * np.sin(phase)
        * (1.0 + CRANK * np.cos(phase) / np.sqrt(ROD**2 - (CRANK * np.sin(phase)) ** 2))
    )
    assert np.abs(run.linear_velocity[:, 3, 0] - speed).max() < 1e-12
    assert run.constraint_violation.max() < 1e-13
    assert run.time[-1] * OMEGA > 10 * np.pi


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("swapped", [False, True])
def test_an_accelerated_slide_pushes_with_its_mass(formulation, swapped):
    """Reaction m f'' along the slide; a pendulum on it would not care who pushes."""
    function = Sine(0.3, 4.0, offset=0.05)
    pair = ("cart", "ground") if swapped else ("ground", "cart")
    cart = Body("cart", 2.5, ORIGIN, 0.1 * np.eye(3))
    sign = -1.0 if swapped else 1.0
    mechanism = Mechanism([Body.ground(), cart], [Translational("rail", *pair, ORIGIN, axis=X)])
    scene = Scene("cart", mechanism, 1.0, 0.1, motions=(PrescribedMotion("rail", function),))
    run = newton_euler.simulate(scene, formulation)
    assert run.position[0, 1, 0] == pytest.approx(sign * 0.05, abs=1e-14)  # assembled: x = f(0)
    assert run.linear_velocity[0, 1, 0] == pytest.approx(sign * 1.2, abs=1e-13)  # and dx/dt = f'(0)
    x = [sign * function.value(float(t)) for t in run.time]
    assert np.abs(run.position[:, 1, 0] - x).max() < 1e-14
    # the force on the second body, which is the ground if swapped
    force = [2.5 * function.acceleration(float(t)) for t in run.time]
    assert np.abs(run.reaction_force[:, 0, 0] - force).max() < 1e-12


FUNCTIONS = [Polynomial([0.3, -1.0, 0.5, 2.0]), Sine(0.7, 3.0, 0.4, -0.2)]


@pytest.mark.parametrize("function", [*FUNCTIONS, Sum(FUNCTIONS)], ids=["polynomial", "sine", "sum"])
def test_functions_and_their_derivatives(function):
    for t in (0.0, 0.8):
        rate = derivative(lambda s, t=t: np.array([function.value(t + s)]))
        second = derivative(lambda s, t=t: np.array([function.rate(t + s)]))
        assert rate[0] == pytest.approx(function.rate(t), abs=1e-11)  # the helper's own error
        assert second[0] == pytest.approx(function.acceleration(t), abs=1e-11)
    assert FUNCTIONS[0].value(2.0) == 0.3 - 2.0 + 2.0 + 16.0
    assert FUNCTIONS[1].value(0.5) == pytest.approx(-0.2 + 0.7 * np.sin(1.9))


# What cannot be


def test_states_that_do_not_follow_are_refused():
    scene = slider_crank(PrescribedMotion("main", Polynomial([0.1, 2.0])))
    rest = State.initial(scene.mechanism)
    with pytest.raises(
        MechanismError, match=r"motion of joint 'main': has an error of -0.1 rad in the initial"
    ):
        initial_state(replace(scene, initial_state=rest))
    fast = (PrescribedMotion("main", Polynomial([0.0, 2.0])),)
    with pytest.raises(
        MechanismError, match=r"motion of joint 'main': has an error of -2 rad/s in the initial"
    ):
        initial_state(replace(scene, initial_state=rest, motions=fast))
    state = newton_euler.assemble(scene, rest)
    assert initial_state(replace(scene, initial_state=state)) is state
    assert np.linalg.norm(state.angular_velocity[1]) == pytest.approx(2.0, abs=1e-12)


def test_gears_and_motions_name_what_is_wrong():
    pair = gear_pair().mechanism

    def gears(*wrong):
        return lambda: Mechanism(pair.bodies, pair.joints, [Gear(*wrong)])

    for build, error, message in (
        (gears("mesh", "shaft_1", "shaft_3", 1.0), UnknownNameError, "shaft_3.*shaft_1, shaft_2"),
        (gears("mesh", "shaft_1", "shaft_2", 0.0), MechanismError, "gear 'mesh': ratio is 0"),
        (gears("mesh", "shaft_1", "shaft_1", 1.0), MechanismError, "couples joint 'shaft_1' to itself"),
        (gears("shaft_1", "shaft_1", "shaft_2", 1.0), MechanismError, "gear 'shaft_1': 2 of that name"),
        (
            gears("mesh", "shaft_1", "shaft_2", 1.0, 0, 1),
            MechanismError,
            "'shaft_2': coordinate is 1; .*below 1",
        ),
        (gears("a b", "shaft_1", "shaft_2", 1.0), MechanismError, "gear 'a b': has an unusable name"),
        (lambda: Polynomial([]), MechanismError, "polynomial: coefficients"),
        (lambda: Sine(1.0, float("nan")), MechanismError, "sine: angular_frequency is nan"),
        (lambda: Sum([1.0]), MechanismError, "sum: terms"),
        (lambda: PrescribedMotion("j", 1.0), MechanismError, "motion of joint 'j': function is 1.0"),
    ):
        with pytest.raises(error, match=message):
            build()
    scene = gear_pair()
    motion = PrescribedMotion("shaft_1", Polynomial([0.0]))
    with pytest.raises(MechanismError, match=r"'shaft_1': coordinate is 1; .*below 1"):
        replace(scene, motions=(PrescribedMotion("shaft_1", Polynomial([0.0]), 1),))
    with pytest.raises(MechanismError, match=r"motion of coordinate 0 .* 2 of that name"):
        replace(scene, motions=(motion, motion))
    with pytest.raises(MechanismError, match="a tuple of PrescribedMotion"):
        replace(scene, motions=(1.0,))
