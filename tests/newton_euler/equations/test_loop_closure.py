"""The scales of a closure: how far one velocity moves and rotates its bodies."""

from __future__ import annotations

import numpy as np
import pytest

from newton_euler.equations.loop_closure import reach


def test_reach_counts_all_directions_and_leaves_out_what_moves_both_bodies() -> None:
    """Velocity 0 moves the first body alone, velocity 1 both bodies, velocity 2 the second body alone."""
    first, second = np.zeros((6, 3)), np.zeros((6, 3))
    first[:, 0] = 1.0, 2.0, 2.0, 0.0, 3.0, 4.0  # 3 m/s and 5 rad/s
    first[:, 1] = second[:, 1] = 100.0
    second[:, 2] = 0.0, 0.0, 6.0, 0.0, 0.0, 0.5
    moved, rotated = reach((first, second), (0.2, 4.0), np.array([2.0, 1.0, 0.5]))
    assert rotated == pytest.approx(2.0 * 5.0)
    assert moved == pytest.approx(2.0 * (3.0 + 0.2 * 5.0))
    # the second body alone moves by 0.5 (6 + 4 * 0.5) = 4 m
    assert reach((np.zeros((6, 3)), second), (0.2, 4.0), np.array([2.0, 0.0, 0.5]))[0] == pytest.approx(4.0)
