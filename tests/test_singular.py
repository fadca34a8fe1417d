"""Runs through configurations where the constraints lose rank: right or refused, never another motion."""

from __future__ import annotations

import numpy as np
import pytest
from mechanisms import bar
from scipy.integrate import solve_ivp

import newton_euler
from newton_euler.errors import IntegrationError
from newton_euler.joints import Revolute
from newton_euler.mechanism import Body, Mechanism
from newton_euler.scene import Scene
from newton_euler.state import MassProperties, State

Y = np.array([0.0, 1.0, 0.0])
MASSES = (1.0, 2.0, 1.5)


def parallelogram(angle, speed):
    """Cranks of 1 m on a base of 2 m, unequal bars, from an angle above the base (rad) at a speed (rad/s)."""
    a, d = np.zeros(3), np.array([2.0, 0.0, 0.0])
    along = np.array([np.cos(angle), 0.0, np.sin(angle)])
    b, c = a + along, d + along
    ends = (("crank", a, b), ("coupler", b, c), ("rocker", d, c))
    bodies = [bar(name, *pair, mass) for (name, *pair), mass in zip(ends, MASSES, strict=True)]
    joints = [
        Revolute("A", "ground", "crank", a, axis=Y),
        Revolute("B", "crank", "coupler", b, axis=Y),
        Revolute("C", "coupler", "rocker", c, axis=Y),
        Revolute("D", "ground", "rocker", d, axis=Y),
    ]
    mechanism = Mechanism([Body.ground(), *bodies], joints)
    state, turning = State.initial(mechanism), -speed * Y
    tip = np.cross(turning, along)
    state.linear_velocity[1:] = [0.5 * tip, tip, 0.5 * tip]
    state.angular_velocity[[1, 3]] = turning
    gravity = np.array([0.0, 0.0, -9.81])
    return Scene("parallelogram", mechanism, 2.0, 0.1, gravity, initial_state=state)


def crank(scene):
    """(n, 3) centre of the crank: one angle describes it all."""
    about_y = [float(Y @ inertia @ Y) for inertia in MassProperties.of(scene.mechanism).inertia]
    inertia = about_y[1] + about_y[3] + 0.25 * (MASSES[0] + MASSES[2]) + MASSES[1]
    weight = 9.81 * (0.5 * (MASSES[0] + MASSES[2]) + MASSES[1])
    x, _, z = scene.mechanism.bodies[1].center_of_mass
    start = [np.arctan2(z, x), -scene.initial_state.angular_velocity[1, 1]]
    angle = solve_ivp(
        lambda t, y: [y[1], -weight / inertia * np.cos(y[0])],
        (0.0, scene.duration), start, method="DOP853", rtol=1e-13, atol=1e-14, t_eval=scene.times,
    ).y[0]  # fmt: skip
    return 0.5 * np.column_stack([np.cos(angle), 0.0 * angle, np.sin(angle)])


STARTS = [(0.01273512508226915, 0.9629523373408642), (0.0331005, 6.3064917), (-0.0946231, 7.5090199)]


def refusal(scene, tolerance, **options):
    """Why a run stopped; empty if it went through, and then it is right."""
    try:
        run = newton_euler.simulate(scene, **options)
    except IntegrationError as caught:
        return str(caught)
    assert np.abs(run.position[:, 1] - crank(scene)).max() < tolerance  # another branch is off by 1
    return ""


@pytest.mark.parametrize("rtol", [1e-9, 1e-10, 1e-11, 1e-12, 1e-13])
@pytest.mark.parametrize(("angle", "speed"), STARTS)
def test_projection_passes_or_refuses(angle, speed, rtol):
    """From a few hundredths of a radian off flat, where the other branch is a metre away."""
    reason = refusal(parallelogram(angle, speed), 1e-6, rtol=rtol, atol=1e-2 * rtol)
    assert not reason or "near a singular configuration" in reason
    assert not reason or rtol < 1e-10  # tighter than round-off allows there


def test_a_flat_start_goes_on():
    scene = parallelogram(0.0, 2.0)
    run = newton_euler.simulate(scene)
    assert np.abs(run.position[:, 1] - crank(scene)).max() < 1e-8


@pytest.mark.parametrize(
    "options",
    [
        {"stabilization": "baumgarte"},
        {"stabilization": "none"},
        {"integrator": "Radau", "rtol": 1e-8, "atol": 1e-10},
        {"integrator": "Radau", "rtol": 1e-6, "atol": 1e-8},
    ],
)
@pytest.mark.parametrize(("angle", "speed"), [*STARTS, (-1.0, -5.0)])
def test_what_cannot_pass_says_so(angle, speed, options):
    reason = refusal(parallelogram(angle, speed), 1e-3, **options)
    assert not reason or "near a singular configuration" in reason
