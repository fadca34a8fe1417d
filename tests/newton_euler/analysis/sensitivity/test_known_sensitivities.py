"""Sensitivities that are known: by equations written by hand with a complex step, by formulas, of starts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from mechanisms import CART, STIFFNESS, carts, line_spring, mass_on_rail, pendulum, planar_four_bar
from scipy.integrate import solve_ivp
from test_sensitivity import TIGHT, short

from newton_euler import sensitivities, start, with_parameters
from newton_euler.analysis.sensitivity.tangent_run import TOLERANCE_FACTOR
from newton_euler.integrators.options import Options
from newton_euler.model.control import PD
from newton_euler.model.euler_parameters import rotation


def bar_pendulum(t, state, gravity, length, mass, moment):
    """Rates of angle and rate of a bar on a hinge, from horizontal."""
    return [state[1], mass * gravity * 0.5 * length * np.cos(state[0]) / (moment + mass * 0.25 * length**2)]


def complex_step(rates, start, end, values, k):
    """Differentiate the state at the end by value k, by a complex step: no difference is taken.

    Error control sees the real part alone, for the imaginary one is below what doubles hold beside it.
    """
    h = 1e-30
    moved = [value + 1j * h * (number == k) for number, value in enumerate(values)]
    found = solve_ivp(rates, (0.0, end), np.array(start, dtype=complex), "DOP853", args=moved, **LOOSER)
    return found.y[:, -1].imag / h


LOOSER = {"rtol": 1e-13, "atol": 1e-14}
"""Of scipy, which refuses less."""


def test_a_pendulum_against_complex_steps():
    """Gravity, mass and moment of inertia, from equations written by hand."""
    scene = short(pendulum(), 2.0)
    rod = scene.mechanism.bodies[1]
    values = [9.81, 1.0, rod.mass, moment_about_y(rod)]
    found = sensitivities(scene, ["gravity", "rod.mass", "rod.inertia"], **TIGHT).joint("pivot")
    row = rotation(rod.quaternion)[1]  # of the frame that the body's inertia is in
    on_moment = [row[i] * row[j] for i in range(3) for j in range(i, 3)]
    for k, weights in ((0, [0, 0, -1.0]), (2, [0, 0, 0, 1.0]), (3, [0, 0, 0, 0, *on_moment])):
        angle, rate = complex_step(bar_pendulum, [0.0, 0.0], 2.0, values, k)
        weights = np.array([*weights, *np.zeros(10 - len(weights))])
        assert found.rates is not None
        # both are integrated to 1e-13, over one swing
        assert found.coordinates[-1, 0] @ weights == pytest.approx(angle, rel=1e-10)
        assert found.rates[-1, 0] @ weights == pytest.approx(rate, rel=1e-10)


def test_the_energy_of_a_spring_of_no_length():
    """By its stiffness half the square of the distance, which is 0 at first."""
    scene = start(mass_on_rail(line_spring(rest_length=0.0), duration=0.2), rail=(2.0, -3.0))
    found = sensitivities(scene, ["line.stiffness"])
    distance = found.run.position[:, 1, 2] - 2.0
    by_stiffness = STIFFNESS * distance * found.position[:, 1, 2, 0] + 0.5 * distance**2
    assert distance[0] == 0.0
    assert by_stiffness[-1] > 0.01
    # round-off
    assert np.abs(found.potential_energy[:, 0] - by_stiffness).max() < 1e-14


def test_starts_turn_alike_in_mechanisms_of_all_sizes():
    """By angles and axes of a pendulum of 10 micrometers as by those of one of 1 m."""
    found = []
    for length in (1.0, 1e-5):
        scene = start(short(pendulum(length), 1e-3), pivot=(0.5, 0.0))
        found.append(sensitivities(scene, ["start.pivot", "pivot.axis"]).quaternion[0, 1])
    assert np.abs(found[0][:, 1:]).max() > 0.1
    # differences over 1e-4 rad of numbers of order 1 with round-off
    assert np.abs(found[1] - found[0]).max() < 2e-11


def moment_about_y(body):
    a = rotation(body.quaternion)
    return (a @ body.inertia @ a.T)[1, 1]


def four_bar_rates(t, state, gravity, m1, m2, m3):
    """Rates of the three angles of `planar_four_bar` by Newton and Euler with multipliers; any scalars.

    Bars from a to b, b to c and d to c, at angles from x towards z.
    """
    angles, speeds = state[:3], state[3:]
    lengths = np.array([np.hypot(0.1, 0.4), np.hypot(0.8, 0.3), np.hypot(0.1, 0.7)])
    masses = np.array([m1, m2, m3])
    cosines, sines = lengths * np.cos(angles), lengths * np.sin(angles)
    # centers of mass: half of bar 1; bar 1 and half of bar 2; half of bar 3
    shares = np.array([[0.5, 0.0, 0.0], [1.0, 0.5, 0.0], [0.0, 0.0, 0.5]])
    closing = np.array([1.0, 1.0, -1.0])
    matrix, right = np.zeros((5, 5), dtype=state.dtype), np.zeros(5, dtype=state.dtype)
    for mass, share in zip(masses, shares, strict=True):
        on_x, on_z = -share * sines, share * cosines
        drift_x, drift_z = -(share * cosines) @ speeds**2, -(share * sines) @ speeds**2
        matrix[:3, :3] += mass * (np.outer(on_x, on_x) + np.outer(on_z, on_z))
        right[:3] -= mass * (on_x * drift_x + on_z * (drift_z + gravity))
    matrix[range(3), range(3)] += MOMENTS
    matrix[3, :3], matrix[4, :3] = -closing * sines, closing * cosines
    matrix[:3, 3:] = matrix[3:, :3].T
    right[3:] = (closing * cosines) @ speeds**2, (closing * sines) @ speeds**2
    return np.concatenate([speeds, np.linalg.solve(matrix, right)[:3]])


MOMENTS = np.array([moment_about_y(body) for body in planar_four_bar().mechanism.bodies[1:]])


def test_a_four_bar_against_complex_steps():
    """Gravity and masses, from equations of three angles with multipliers, written by hand."""
    scene = short(planar_four_bar(), 0.5)
    start = [np.arctan2(0.4, 0.1), np.arctan2(0.3, 0.8), np.arctan2(0.7, -0.1), 0.0, 0.0, 0.0]
    values = [-scene.gravity[2], *(body.mass for body in scene.mechanism.bodies[1:])]
    names = ["gravity", "crank.mass", "coupler.mass", "rocker.mass"]
    found = sensitivities(scene, names, **TIGHT)
    joints = [found.joint(name) for name in ("at_a", "at_d")]
    for label, k, sign in ((2, 0, -1.0), (3, 1, 1.0), (4, 2, 1.0), (5, 3, 1.0)):
        expected = complex_step(four_bar_rates, start, 0.5, values, k)
        for motion, bar in zip(joints, (0, 2), strict=True):
            assert motion.rates is not None
            # y is towards the back, so that angles about it are the other way round; both to 1e-13
            angle, rate = -sign * expected[[bar, 3 + bar]]
            assert motion.coordinates[-1, 0, label] == pytest.approx(angle, rel=1e-9, abs=1e-11)
            assert motion.rates[-1, 0, label] == pytest.approx(rate, rel=1e-9, abs=1e-11)


def test_a_pendulum_at_rest_has_the_derivatives_of_one_that_swings():
    """By its angle they are cos(omega t), however long the steps of a state at rest are."""
    scene = replace(pendulum(angle=0.0), duration=20.0, output_period=0.5)
    found = sensitivities(scene, ["start.pivot"])
    rod = scene.mechanism.bodies[1]
    omega = np.sqrt(9.81 * rod.mass * 0.5 / (moment_about_y(rod) + rod.mass * 0.5**2))
    error = found.joint("pivot").coordinates[:, 0, 0] - np.cos(omega * found.run.time)
    assert np.abs(error).max() < FEW * TOLERANCE_FACTOR * Options().rtol


FEW = 10.0
"""Errors of a part of a step are to the tolerance; those of runs are a few of them, as vibrations go on."""


@pytest.mark.parametrize("rtol", [1e-10, 1e-6])
@pytest.mark.parametrize("stiffness", [40.0, 4000.0])
@pytest.mark.parametrize("beside", [PD("rail_1", 30.0, 1.0, 0.0), PD("rail_1", 3.0, 0.1, 0.2)])
def test_a_cart_at_rest_has_the_derivative_of_its_answer_to_a_step(beside, stiffness, rtol):
    """By its set-point, beside a cart that is at rest as well, or a slow one."""
    scene = carts(PD("rail_0", stiffness, 3.0, 0.0), beside, duration=10.0, output_period=0.1)
    found = sensitivities(scene, ["rail_0.target"], rtol=rtol, atol=0.01 * rtol)
    t, decay = found.run.time, 3.0 / (2.0 * CART)
    omega = np.sqrt(stiffness / CART - decay**2)
    answer = 1.0 - np.exp(-decay * t) * (np.cos(omega * t) + decay / omega * np.sin(omega * t))
    error = found.joint("rail_0").coordinates[:, 0, 0] - answer
    assert np.abs(error).max() < FEW * TOLERANCE_FACTOR * rtol


@pytest.mark.parametrize(
    ("scene", "name", "value"),
    [(pendulum(), "start.pivot.rate", 1e5), (mass_on_rail(), "start.rail", 2e4)],
)
def test_large_rates_and_slides_at_the_start_are_no_angles(scene, name, value):
    far = with_parameters(replace(scene, duration=1e-5, output_period=1e-5), {name: value})
    joint = sensitivities(far, [name]).joint(scene.mechanism.joint_names[0])
    derivatives = joint.rates if name.endswith("rate") else joint.coordinates
    assert derivatives[0, 0, 0] == pytest.approx(1.0)
