"""Rows that imply each other in another way in each configuration, and the sizes of their pivots."""

from __future__ import annotations

import numpy as np
import pytest
from overconstrained import LOOPS, linkage

from crosscheck.library import load
from newton_euler.equations.cartesian import Cartesian
from newton_euler.equations.redundancy import mobility
from newton_euler.equations.relative import Relative
from newton_euler.equations.row_choice import constraint_scales, exchangeable_rows, rows_in_use
from newton_euler.equations.row_shares import MIN_REGULAR, ScaledRows, varying_rows
from newton_euler.runs.variation import start


def configurations(*shares, scales=(1.0, 1.0, 2.0)):
    """Return configurations of two unit rows and one with shares in them, each row in its own unit."""
    return [
        ScaledRows([{0: 1.0 / scales[0]}, {1: 1.0 / scales[1]}, {0: a / scales[2], 1: b / scales[2]}], scales)
        for a, b in shares
    ]


@pytest.mark.parametrize(
    ("shares", "rows"),
    [
        ([(0.5, 0.2)] * 3, []),
        ([(0.5, 0.2), (0.5, 0.2), (0.5, 0.3)], [0, 1, 2]),
        ([(0.5, 0.0), (0.6, 0.0), (0.7, 0.0)], [0, 2]),
        ([(0.5, 0.2)] * 2, [0, 1, 2]),  # too few to tell
        ([(0.0, 0.0)] * 2, []),
        ([(9e-7, 0.0), (-9e-7, 0.0), (0.0, 0.0)], []),  # shares that are none never come into use
    ],
)
def test_rows_whose_shares_vary_are_exchanged(shares, rows):
    assert list(varying_rows(configurations(*shares), [0, 1], [2])) == rows


def test_shares_are_those_of_rows_in_one_unit():
    """A row whose natural size changes is the same row."""
    seen = [configurations((0.5, 0.2), scales=(1.0, 1.0, size))[0] for size in (1.0, 2.0, 3.0)]
    assert varying_rows(seen, [0, 1], [2]) == {}


def test_configurations_where_rows_in_use_are_dependent_do_not_count():
    singular = ScaledRows([{0: 1.0}, {0: 2.0}, {0: 1.0}], np.ones(3))
    assert varying_rows([singular, *configurations(*[(0.5, 0.2)] * 3)], [0, 1], [2]) == {}
    assert list(varying_rows([singular, *configurations(*[(0.5, 0.2)] * 2)], [0, 1], [2])) == [0, 1, 2]


@pytest.mark.parametrize("name", LOOPS)
def test_the_decision_does_not_depend_on_the_start(name):
    """Also next to configurations where a choice of rows is dependent, as there are in each revolution."""
    scene = linkage(name)
    for angle in np.linspace(0.0, 6.0, 9):
        decided = mobility(start(scene, h0=(angle, 1.0)))
        regular = [at for at in decided.configurations if at.rank == len(decided.independent)]
        assert len(regular) >= MIN_REGULAR
        # every row left out may come into use, and some row in use may be left out
        assert set(decided.redundant) < set(decided.exchangeable)


@pytest.mark.parametrize("form", [Relative, Cartesian])
@pytest.mark.parametrize("name", [*LOOPS, "bricard", "four_bar"])
def test_every_row_is_in_use_somewhere(name, form):
    """So its pivots have a usual size, which others are divided by."""
    scene = linkage(name) if name in LOOPS else load(name)
    system = form(scene)
    exchangeable = exchangeable_rows(system)
    rows = rows_in_use(system, exchangeable=exchangeable)
    assert min(rows.scales) > 0.0
    assert min(constraint_scales(system, exchangeable=exchangeable)) > 0.0
