"""Moves with trapezoidal speed: the function by itself, and runs that follow it in all engines."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from mechanisms import MASS, STIFFNESS, mass_on_rail
from scipy.integrate import cumulative_trapezoid, solve_ivp
from simulations import SIMULATIONS

import newton_euler
from crosscheck.library import load
from crosscheck.library.scene_file import content, write_scene
from newton_euler.errors import MechanismError
from newton_euler.model.control import PD
from newton_euler.model.splines import Moves

DAMPING = 4.0
"""N s/m, of the controller."""

MOVES = Moves((0.25, 1.0, 1.3, 1.7), (0.05, 0.2, 0.2, -0.1), (0.2, 0.1, 0.2))
"""A trapezoid, a rest, and a triangle."""

SPEEDS = {0.25: 0.0, 0.45: 0.15 / 0.55, 0.8: 0.15 / 0.55, 1.0: 0.0, 1.3: 0.0, 1.5: -1.5, 1.7: 0.0}
"""Corners of the speed: distance over time less one ramp."""


def test_speeds_are_trapezoids():
    """Against the integral of the speed, which is linear between its corners."""
    times = np.linspace(0.0, 2.0, 4001)  # the corners are among them
    speed = np.interp(times, list(SPEEDS), list(SPEEDS.values()))
    value = 0.05 + cumulative_trapezoid(speed, times, initial=0.0)
    assert np.abs([MOVES.rate(t) for t in times] - speed).max() < 1e-12
    assert np.abs([MOVES.value(t) for t in times] - value).max() < 1e-12
    assert MOVES.acceleration(0.3) == pytest.approx(0.15 / 0.55 / 0.2)
    assert [MOVES.acceleration(t) for t in (0.6, 1.1, 1.9)] == [0.0, 0.0, 0.0]
    assert MOVES.knots == pytest.approx(list(SPEEDS))
    assert [MOVES.is_constant_at(t) for t in (0.1, 0.3, 0.6, 1.1, 1.4, 1.8)] == [1, 0, 0, 1, 0, 1]


@pytest.mark.parametrize("ramp", [0.0, -0.1, 0.51, np.nan])
def test_ramps_that_are_none(ramp):
    with pytest.raises(MechanismError, match="ramps"):
        Moves((0.0, 1.0), (0.0, 1.0), (ramp,))


@pytest.mark.parametrize("engine", [name for name in SIMULATIONS if name != "relative in floats"])
def test_laws_follow_moves(engine):
    """MuJoCo's steps of 1 ms do not end at corners of the speed, where accelerations jump."""
    scene = mass_on_rail(duration=1.8, control=(PD("rail", STIFFNESS, DAMPING, MOVES, feedforward=MOVES),))
    scene = replace(scene, output_period=0.05)

    def rates(t, y):
        force = MOVES.value(t) + STIFFNESS * (MOVES.value(t) - y[0]) + DAMPING * (MOVES.rate(t) - y[1])
        return [y[1], force / MASS]

    y, expected, edges = np.zeros(2), [0.0], np.union1d(scene.times, MOVES.knots)
    for begin, end in pairwise(edges):
        y = solve_ivp(rates, (begin, end), y, method="DOP853", rtol=1e-11, atol=1e-13).y[:, -1]
        if end in scene.times:
            expected.append(y[0])
    found = SIMULATIONS[engine](scene)
    limit = 1e-6 if engine == "mujoco" else 1e-9
    assert np.abs(found.position[:, 1, 2] - expected).max() < limit


def test_rests_between_moves_are_skipped():
    """A move of 5 s every 10 minutes; what is left of the last one dies away in a second."""
    times = np.array([0.0, 5.0, 600.0, 605.0, 1200.0, 1205.0, 1800.0])
    moves = Moves(times, [0.0, 0.1, 0.1, 0.3, 0.3, 0.2, 0.2], [1.0, 270.0] * 3)
    scene = mass_on_rail(duration=1800.0, control=(PD("rail", STIFFNESS, DAMPING, moves),))
    whole, skipped = newton_euler.simulate(scene), newton_euler.simulate(scene, rest=1e-10)
    assert skipped.settings["steps"] < 0.5 * whole.settings["steps"]
    assert np.abs(whole.position - skipped.position).max() < 1e-9


def test_outputs_at_chosen_times():
    scene = mass_on_rail(duration=1.8, control=(PD("rail", STIFFNESS, DAMPING, MOVES),))
    compiled, times = newton_euler.compile_scene(scene), np.array([0.0, 0.33, 0.45, 0.451, 1.8])
    found = compiled.simulate(times=times)
    assert np.array_equal(found.time, times)
    whole = newton_euler.simulate(replace(scene, output_period=0.001, duration=1.8))
    rows = np.searchsorted(whole.time, times - 1e-9)
    assert np.abs(found.position - whole.position[rows]).max() < 1e-9


def test_moves_in_scene_files(tmp_path):
    law = PD("rail", STIFFNESS, DAMPING, MOVES)
    write_scene(mass_on_rail(control=(law,)), tmp_path / "moves.yaml")
    (read,) = load(str(tmp_path / "moves.yaml")).control
    assert content(read) == content(law)


def test_moves_may_begin_before_zero():
    """A move from -2 to 4 s with ramps of 3 s: half of the way at 1 s, symmetric around it."""
    moves = Moves((-2.0, 4.0), (0.0, 0.3), (3.0,))
    assert moves.value(1.0) == pytest.approx(0.15)
    assert moves.value(0.9) == pytest.approx(0.3 - moves.value(1.1))
    assert on_piece_value(moves, 0.9) == pytest.approx(moves.value(0.9), rel=1e-14)


def on_piece_value(function, time):
    """The value of the smooth function that compiled code has between two knots."""
    return function.on_piece(function.piece(time)).value(time)
