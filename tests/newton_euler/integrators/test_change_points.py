"""Four-bars whose lengths let all bars lie on one line, and the same with lengths as a file rounds them.

If crank + ground = coupler + rocker, the linkage passes the flat configuration and its coupler folds over. If
the ground is longer or shorter by a small share, the linkage turns there: the crank turns back before it is
flat, at coupler + rocker in a row, or goes past the flat configuration and the coupler does not fold over.
"""

from __future__ import annotations

import re

import numpy as np
import pytest

from newton_euler.model.joint_kinds import Revolute
from newton_euler.model.mechanism import Body, Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import IntegrationError
from newton_euler.runs.batch import simulate_batch
from newton_euler.runs.variation import start

CRANK, COUPLER, ROCKER = 0.6, 1.3, 1.7
GROUND = COUPLER + ROCKER - CRANK
ANGLE, SPEED = 2.2, 5.0
OFF = np.array([1e-4, -1e-4, 1e-6, -1e-6, 1e-10, -1e-10, 1e-16, 0.0])
"""m, by which the ground is longer than a change point asks for."""


def change_point():
    """Return the four-bar with its crank at `ANGLE`, driven by its initial speed, gravity along -y."""
    b = CRANK * np.array([np.cos(ANGLE), np.sin(ANGLE), 0.0])
    d = np.array([GROUND, 0.0, 0.0])
    distance = np.linalg.norm(d - b)
    along = (d - b) / distance
    x = (COUPLER**2 - ROCKER**2 + distance**2) / (2.0 * distance)
    c = b + x * along + np.sqrt(COUPLER**2 - x**2) * np.array([-along[1], along[0], 0.0])
    bodies = [Body.ground()]
    for name, p, q, mass in (("crank", 0.0 * b, b, 1.0), ("coupler", b, c, 1.5), ("rocker", d, c, 0.8)):
        inertia = mass * ((q - p) @ (q - p)) / 12.0 * np.diag([1.0, 1.0, 1.01])
        bodies.append(Body(name, mass, (p + q) / 2.0, inertia))
    ends = (("a", "ground", "crank", 0.0 * b), ("b", "crank", "coupler", b))
    ends += (("c", "coupler", "rocker", c), ("d", "ground", "rocker", d))
    hinges = [Revolute(name, first, second, p, axis=[0.0, 0.0, 1.0]) for name, first, second, p in ends]
    scene = Scene("change_point", Mechanism(bodies, hinges), 0.6, 0.02, gravity=[0.0, -9.81, 0.0])
    return start(scene, a=(0.0, SPEED))


@pytest.fixture(scope="module", params=["relative", "cartesian"])
def runs(request):
    """Runs at rtol 1e-8 with the ground longer by each of `OFF`."""
    lengths = {"d.point_on_first.x": OFF}
    return simulate_batch(change_point(), None, lengths, formulation=request.param, rtol=1e-8, atol=1e-10)


def folding(run, off):
    """Return whether the crank went past the flat configuration and whether the coupler folded over."""
    angle = ANGLE + run.joint("a").coordinates[:, 0]
    b = CRANK * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    d = np.array([GROUND + off, 0.0])
    c = 2.0 * run.position[:, 3, :2] - d
    side = (c - b)[:, 0] * (d - c)[:, 1] - (c - b)[:, 1] * (d - c)[:, 0]
    return bool(angle[-1] > np.pi), bool(side[0] * side[-1] < 0.0)


@pytest.mark.parametrize("number", range(4))
def test_lengths_that_miss_a_change_point_turn_there(runs, number):
    longer = OFF[number] > 0.0
    assert folding(runs[number], OFF[number]) == ((False, True) if longer else (True, False))


@pytest.mark.parametrize("number", [6, 7])
def test_lengths_that_are_exact_but_for_round_off_pass(runs, number):
    assert folding(runs[number], OFF[number]) == (True, True)


@pytest.mark.parametrize("number", [4, 5])
def test_what_is_neither_stops_and_says_how_near_it_is(runs, number):
    """The angle of the bars at the miss is sqrt(1e-10 m / 1 m): constraints are as near to dependent."""
    with pytest.raises(IntegrationError) as caught:
        runs[number]
    value = float(re.search(r"singular value ([0-9.e-]+)", caught.value.reason)[1])
    assert 1e-7 < value < 1e-4
    assert "rtol" in caught.value.reason
