"""Linear-quadratic regulators: the cost that they promise, poles, and what they cannot do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import simpson
from scipy.linalg import solve_continuous_lyapunov

import newton_euler
from crosscheck.library import load
from newton_euler.errors import MechanismError, OptionError
from newton_euler.model.joint_kinds import Revolute, Translational
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Sine

Q, R = np.diag([4.0, 9.0, 0.1, 0.2]), np.array([[0.5]])
"""Of rail, pole and their rates, and of the force."""


def cart_pole() -> Scene:
    """A pole of 0.2 kg, 0.5 m up to its center, on a driven cart of 1 kg."""
    cart = Body("cart", 1.0, [0.0, 0.0, 0.0], 0.01 * np.eye(3))
    pole = Body("pole", 0.2, [0.0, 0.0, 0.5], np.diag([0.02, 0.02, 1e-4]))
    rail = Translational("rail", "ground", "cart", [0.0, 0.0, 0.0], axis=[1.0, 0.0, 0.0], actuated=True)
    hinge = Revolute("pole", "cart", "pole", [0.0, 0.0, 0.0], axis=[0.0, 1.0, 0.0])
    mechanism = Mechanism([Body.ground(), cart, pole], [rail, hinge])
    return Scene("cart_pole", mechanism, 8.0, 0.01, (0.0, 0.0, -9.81))


def test_a_run_costs_what_the_riccati_equation_says():
    """The integral of x^T Q x + u^T R u is x_0^T P x_0, with P of the closed loop's Lyapunov equation."""
    scene = cart_pole()
    laws = newton_euler.lqr(scene, Q, R)
    assert [law.joint for law in laws] == ["rail"]
    closed = replace(scene, control=laws)
    gains = np.array([*laws[0].gains.values()]).T.reshape(1, 4)
    model = newton_euler.linearize(closed)
    assert model.coordinates == ("rail", "pole")
    assert np.max(np.linalg.eigvals(model.A).real) < -0.5  # 1/s
    p = solve_continuous_lyapunov(model.A.T, -(Q + gains.T @ R @ gains))
    start = np.array([1e-4, 2e-4, 0.0, 0.0])
    run = newton_euler.simulate(newton_euler.start(closed, rail=(1e-4, 0.0), pole=(2e-4, 0.0)))
    motions = [run.joint(name) for name in model.coordinates]
    x = np.hstack([*(motion.coordinates for motion in motions), *(motion.rates for motion in motions)])
    u = run.actuator_force
    cost = simpson(np.sum(x @ Q * x, axis=1) + np.sum(u @ R * u, axis=1), x=run.time)
    # what is left at 8 s, and Simpson's rule at 10 ms
    assert cost == pytest.approx(float(start @ p @ start), rel=1e-5)


def test_gains_are_the_cheapest():
    """Others cost more, in the first order nothing."""
    scene = cart_pole()
    (law,) = newton_euler.lqr(scene, Q, R)
    start, costs = np.array([1.0, 2.0, 0.0, 0.0]), []
    for factor in (0.99, 1.0, 1.01):
        gains = {key: (factor * k_p, factor * k_d) for key, (k_p, k_d) in law.gains.items()}
        other = replace(law, gains=gains, targets={("pole", 0): 0.0})
        k = np.array([*gains.values()]).T.reshape(1, 4)
        a = newton_euler.linearize(replace(scene, control=(other,))).A
        costs.append(start @ solve_continuous_lyapunov(a.T, -(Q + k.T @ R @ k)) @ start)
    assert costs[1] < min(costs[0], costs[2])


@pytest.mark.slow
def test_the_tracker_is_held_and_brought_to_targets():
    """Under gravity: u_0 holds it at its initial pose; targets are followed by both sliders."""
    scene = load("tracker_gravity")
    laws = newton_euler.lqr(scene, [1e6, 1e6, 1e2, 1e2], 1.0)
    assert [law.feedforward for law in laws] == pytest.approx(newton_euler.statics(scene).actuator_force)
    held = newton_euler.simulate(replace(scene, control=laws, duration=0.1))
    assert np.max(np.abs(held.position - held.position[0])) < 1e-12
    laws = newton_euler.lqr(scene, [1e6, 1e6, 1e2, 1e2], 1.0, targets={"slide_12": 0.005, "slide_13": 0.01})
    closed = replace(scene, control=laws, duration=1.0)
    run, rest = newton_euler.simulate(closed), newton_euler.equilibrium(closed)
    for name, target in (("slide_12", 0.005), ("slide_13", 0.01)):
        # u_0 is that of another pose: some 0.5 N less, by gains of 1e3 N/m
        assert run.joint(name).coordinates[-1, 0] == pytest.approx(target, abs=1e-3)
    assert run.position[-1] == pytest.approx(rest.position, abs=1e-9)  # m: what is left at 1 s


def test_targets_may_be_functions():
    (law,) = newton_euler.lqr(cart_pole(), Q, R, targets={"rail": Sine(0.1, 1.0)})
    assert law.target == Sine(0.1, 1.0)


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        ((Q[:3], R), OptionError, "4 weights, or a symmetric matrix"),
        ((Q, [1.0, 2.0]), OptionError, "1 weights"),
        ((Q, 0.0), OptionError, r"\[\[0.0\]\]\); needed: positive weights of forces"),
        ((np.zeros((4, 4)), -1.0), OptionError, "Q and R"),
    ],
)
def test_weights_without_a_regulator_are_refused(arguments, error, words):
    with pytest.raises(error, match=words):
        newton_euler.lqr(cart_pole(), *arguments)


def test_what_cannot_be_held_is_refused():
    scene = newton_euler.start(cart_pole(), pole=(0.3, 0.0))
    with pytest.raises(MechanismError, match="body 'pole'"):
        newton_euler.lqr(scene, Q, R)
