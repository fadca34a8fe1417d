"""Branches of an arm of two links: the sign of its determinant l_1 l_2 sin(q_2)."""

from __future__ import annotations

import numpy as np
import pytest

from newton_euler.equations.loop_closure import branch
from newton_euler.scalars import Array


def arm(first: float, elbow: float) -> Array:
    """(3, 2) derivative of where its tip is by both angles, a row out of the plane too; links of 1, 0.8 m."""
    both = first + elbow
    upper, lower = np.array([-np.sin(first), np.cos(first)]), 0.8 * np.array([-np.sin(both), np.cos(both)])
    return np.column_stack([[*(upper + lower), 0.0], [*lower, 0.0]])


@pytest.mark.parametrize(
    ("elbows", "same"), [((0.9, 0.4), True), ((0.9, -0.4), False), ((-2.0, -0.1), True), ((0.9, 1e-5), None)]
)
def test_the_side_of_an_elbow(elbows: tuple[float, float], same: bool | None) -> None:
    found = branch(arm(0.3, elbows[0]), arm(-0.2, elbows[1]), 1e-4)
    assert found.same is same
    assert found.columns == (0, 1)


def test_without_constraints_or_with_others_nothing_is_told() -> None:
    assert branch(np.zeros((0, 2)), np.zeros((0, 2)), 0.0).same is None
    assert branch(arm(0.0, 1.0)[:2], arm(0.0, 1.0), 0.0).same is None
    assert branch(np.zeros((3, 2)), np.zeros((3, 2)), 0.0).same is None
