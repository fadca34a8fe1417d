"""Sensitivities that are refused, each with its reason."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from ball_scenes import sphere
from mechanisms import carts, line_spring, mass_on_rail, pendulum

from crosscheck.library import load
from newton_euler import BallSpring, sensitivities, start
from newton_euler.errors import NewtonEulerError, SensitivityError
from newton_euler.model.digital_control import Sampled
from newton_euler.model.trajectory import IntegrationError


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"parameters": []}, "parameters is []"),
        ({"parameters": {}}, "or values by name"),
        ({"parameters": ["rod.mass", "rod.mass"]}, "each once"),
        ({"parameters": "rod.mass"}, "parameters is 'rod.mass'"),
        ({"parameters": {"rod.mass": -1.0}}, "parameter 'rod.mass': is -1.0; needed: a positive mass"),
        ({"parameters": {"rod.mass": [1.0, 2.0]}}, "parameter 'rod.mass': has values of shape (2,)"),
        ({"parameters": ["rod.color"]}, "unknown parameter 'rod.color'"),
        ({"parameters": ["rod.mass"], "rest": 1e-6}, "rest is 1e-06; needed: 0"),
        (
            {"parameters": ["rod.mass"], "integrator": "RK4"},
            "integrator is 'RK4'; needed: DOP853, which deriv",
        ),
        (
            {"parameters": ["rod.mass"], "stabilization": "none"},
            "stabilization is 'none'; needed: projection",
        ),
        ({"parameters": ["rod.mass"], "rtol": 2.0}, "rtol is 2.0"),
        ({"parameters": ["rod.mass"], "formulation": "lagrange"}, "unknown formulation 'lagrange'"),
    ],
)
def test_impossible_requests_are_refused(arguments, message):
    with pytest.raises(NewtonEulerError) as caught:
        sensitivities(pendulum(), **arguments)
    assert message in str(caught.value)


def test_masses_beyond_all_forces_are_refused_in_silence():
    """Warnings of NumPy would fail here; the float form looks at reactions that are not finite."""
    with pytest.raises(IntegrationError, match=r"t = 0 s: .*not finite"):
        sensitivities(load("slider_crank"), {"rod.mass": 1e308})


def test_sampled_controllers_have_no_derivatives():
    scene = carts(Sampled("rail_0", lambda t, x, v: -x[0], 0.1))
    with pytest.raises(NewtonEulerError, match="sampled controller of joint 'rail_0' has none"):
        sensitivities(scene, ["cart_0.mass"])


def swung(**values):
    """A globe that passes half a revolution at 0.32 s; derivatives by the stiffness lack half of it there."""
    spring = BallSpring("ball", **values)
    return replace(sphere(spring, spin=10.0), duration=0.4, output_period=0.1)


def thrown(**values):
    """A mass that passes the end of its spring at 0.22 s."""
    scene = mass_on_rail(line_spring(**values), gravity=(0.0, 0.0, -9.81), duration=0.4)
    return start(scene, rail=(0.0, 10.0))


@pytest.mark.parametrize(
    ("scene", "name", "refused"),
    [
        (swung(stiffness=0.5), "ball.ball.stiffness", "spring of the ball of joint 'ball' jumps at t = 0.3"),
        (swung(damping=0.5), "ball.ball.damping", ""),
        (thrown(rest_length=1.0), "mass.mass", "point spring 'line' jumps at t = 0.2"),
        (thrown(rest_length=0.0, damping=0.3), "mass.mass", ""),
    ],
)
def test_forces_that_jump_where_the_motion_takes_them_have_no_derivatives(scene, name, refused):
    """Of springs alone, and the run itself goes on: dampers act alike on both sides."""
    with pytest.raises(SensitivityError, match=refused) if refused else nullcontext():
        sensitivities(scene, [name])


def test_a_coordinate_that_loops_hold_has_no_derivatives():
    with pytest.raises(NewtonEulerError, match=r"start\.pivot cannot vary alone: joint '.*' stays open"):
        sensitivities(load("slider_crank"), ["start.pivot", "start.guide"])


def test_derivatives_of_starts_next_to_a_singular_configuration_are_refused():
    """Of a rhombus 0.01 rad before it folds: differences by 1e-4 of its size are 13 % off there."""
    still = replace(load("four_bar", N=1), gravity=np.zeros(3), duration=0.02, output_period=0.01)
    for gap, refused in ((0.3, False), (0.01, True)):
        folding = start(still, pivot_0=(gap - np.pi / 2.0, 0.1 * gap))
        with pytest.raises(SensitivityError, match="not known") if refused else nullcontext():
            sensitivities(folding, ["ball_0.point_on_first.x"])
