"""Projection of several states at once."""

import numpy as np
import pytest

from crosscheck.scenes import load
from newton_euler.codegen.native_functions import NativeFunctions
from newton_euler.codegen.trigonometry import LANES
from newton_euler.integrators import stepper as m
from newton_euler.integrators.projection import ROUND_OFF, project_rows
from newton_euler.integrators.run import Fallback, Projection, equations
from newton_euler.simulate import CompiledScene


def recorded(code, times, table):
    """The rows after the first, and what came of it."""
    assert code.function("position").lanes == code.function("velocity").lanes == LANES > 1
    counts, table = np.zeros(m.COUNTS), table.copy()
    system = equations(code, Fallback(code), code.function("derivative"), np.zeros(code.size), counts)
    x = code.start.copy()
    target = m.Table(len(table), code.size, 1, 1, np.zeros(1), times, x, table, counts)
    status = NativeFunctions([project_rows])(project_rows, system, target, table, 1, len(table), 0, x)
    return status, table, int(counts[m.WRITTEN])


@pytest.mark.parametrize("far", [(), (3,), (1, 6)])
@pytest.mark.parametrize("scene", ["tracker", "four_bar", "slider_crank"])
def test_rows_are_what_each_is_alone(scene, far):
    """A group of as many as there are lanes and one of fewer, with and without rows that need more steps."""
    code, rng = CompiledScene(load(scene)), np.random.default_rng(0)
    rows, start = 1 + LANES + 2, code.start
    times, table = np.linspace(0.0, 1.0, rows), np.tile(start[: code.size], (rows, 1))
    table[1:] += 1e-6 * rng.standard_normal((rows - 1, code.size))
    for row in far:
        table[row] += 3e-2 * rng.standard_normal(code.size)
    status, found, written = recorded(code, times, table)
    assert (status, written) == (m.DONE, rows)
    assert np.array_equal(found[0], table[0])
    for row in range(1, rows):
        alone = start.copy()
        alone[: code.size], alone[code.size] = table[row], times[row]
        assert Projection(code)(alone)
        assert np.array_equal(found[row], alone[: code.size])
        q = found[row, : code.system.nq]
        assert (
            np.abs(code.system.phi(q)).max() < 10.0 * ROUND_OFF
        )  # in m and rad, of mechanisms of some meters


def test_a_row_that_cannot_be_closed_ends_it_and_those_before_it_are_kept():
    code = CompiledScene(load("four_bar"))
    rows = 1 + 2 * LANES
    times, table = np.linspace(0.0, 1.0, rows), np.tile(code.start[: code.size], (rows, 1))
    table[1 + LANES + 1] = np.nan
    status, found, written = recorded(code, times, table)
    assert status != m.DONE
    assert written == 1 + LANES + 1
    assert np.isfinite(found[:written]).all()


def test_states_without_constraints_are_left_as_they_are() -> None:
    """A scene that has nothing to project onto has no code for it either."""
    code = CompiledScene(load("pendulum"))
    x = code.start + 0.1
    before = x.copy()
    assert Projection(code)(x)
    assert np.array_equal(x, before)
