"""Accelerations of joints: those of each engine's own coordinates, which body accelerations do not show."""

from __future__ import annotations

import numpy as np
import pytest
from elements import ELEMENTS

from crosscheck.compare.accelerations import acceleration_checks
from crosscheck.compare.levels import compare_equations, compare_pair, sample_engines
from crosscheck.compare.samples import RATE_ERROR, Samples, States
from crosscheck.engines.registry import ENGINES
from crosscheck.library import load
from newton_euler.equations.relative import Relative
from newton_euler.reading.excitation import random_states
from newton_euler.runs.assemble import initial_state

QUANTITY = "joint acceleration, rel"


def states_of(scene):
    return States(scene, (initial_state(scene), *random_states(scene, 3)))


class Wrong(Relative):
    """Equations whose first coordinate's acceleration is off by a share of its velocity's square."""

    share = 1e-6

    def acceleration(self, q, v):
        found = np.array(super().acceleration(q, v))
        found[0] += self.share * v[0] ** 2
        return found


@pytest.mark.parametrize("name", ["free_top", "four_bar", "tracker_on_boat", "chain"])
def test_engines_agree_far_below_the_tolerance(name):
    scene = load(name)
    rows = compare_equations(list(ENGINES.values()), sample_engines(list(ENGINES.values()), states_of(scene)))
    found = [row for row in rows if row.quantity == QUANTITY]
    assert {row.between for row in found} >= {("newton_euler", "mujoco"), ("newton_euler", "pinocchio")}
    assert all(row.value < 0.01 * RATE_ERROR for row in found)


@pytest.mark.parametrize("name", sorted(ELEMENTS))
def test_accelerations_of_coordinates_are_those_of_bodies(name):
    """Both ways lead to the same body accelerations, at states off the start, to the error of differences."""
    scene = ELEMENTS[name]
    samples = Samples(Relative(scene), states_of(scene))
    linear, angular = samples.coordinate_accelerations
    unit = samples.scales.acceleration
    assert np.abs(linear - samples.stack("linear_acceleration")).max() < RATE_ERROR * unit
    size = samples.scales.size
    assert np.abs(angular - samples.stack("angular_acceleration")).max() * size < RATE_ERROR * unit


def test_a_wrong_acceleration_of_a_coordinate_is_found_there_alone():
    scene = load("chain")
    states = states_of(scene)
    pair = ("newton_euler", "wrong")
    both = [Samples(Relative(scene), states)], [Samples(Wrong(scene), states)]
    rows = list(compare_pair(pair, *both, [acceleration_checks]))
    (row,) = [row for row in rows if not row.agrees]
    assert row.quantity == QUANTITY
    assert row.where in scene.mechanism.joint_names
    assert 1e-8 < row.value < 1e-5
    assert row.level == "accelerations and reactions"
