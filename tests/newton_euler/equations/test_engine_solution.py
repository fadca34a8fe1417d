"""Solutions of the equations of other engines, from their matrices, against closed forms."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from newton_euler.equations import engine_solution
from newton_euler.equations.engine_solution import Redundancy, servo_forces, solve_rigidly
from newton_euler.errors import SingularityError


def masses(rows: int) -> SimpleNamespace:
    """Two masses on a line with a number of constraint rows."""
    mechanism = SimpleNamespace(size=1.0, is_slide=lambda *key: True)
    return SimpleNamespace(
        name="engine", phi_units=np.ones(rows), velocity_units=np.ones(2), mechanism=mechanism
    )


def test_rows_that_are_almost_redundant_have_no_force():
    """Masses of 1 kg and 3 kg at a fixed distance, and a row of the same distance with a rounding error."""
    rows = np.array([[1.0, -1.0], [1.0, -1.0 - 1e-7]]), np.array([0.0, 1e-3])
    acceleration, forces = solve_rigidly(
        masses(2), Redundancy([1], 1), (np.diag([1.0, 3.0]), np.array([6.0, 2.0])), rows
    )
    np.testing.assert_allclose(acceleration, [2.0, 2.0], rtol=1e-14)
    np.testing.assert_allclose(forces, [-4.0, 0.0], rtol=1e-14)


@pytest.mark.parametrize("mass", [np.nan, 0.0, -1.0])
@pytest.mark.parametrize("force", [1.0, np.inf])
def test_equations_without_a_solution_are_attributed_to_no_joint(mass, force):
    matrices = np.diag([1.0, mass]), np.array([1.0, force])
    with pytest.raises(SingularityError) as caught:
        solve_rigidly(masses(0), Redundancy([], 0), matrices, (np.zeros((0, 2)), np.zeros(0)))
    assert caught.value.joint is None
    assert caught.value.reason.startswith("engine: ")


def servo_force(monkeypatch, acceleration, force):
    """The force on the first of two masses of 1 kg and 3 kg at a fixed distance."""
    monkeypatch.setattr(engine_solution, "rows_left_out", lambda system: [])
    matrices = np.diag([1.0, 3.0]), np.array([6.0, force])
    rows = np.array([[1.0, -1.0]]), np.zeros(1)
    prescribed = np.array([[1.0, 0.0]]), np.array([acceleration])
    return servo_forces(masses(1), matrices, rows, [("rail", 0)], prescribed)


def test_servo_forces_are_those_of_newtons_law(monkeypatch):
    """4 kg at 3 m/s^2 need 12 N, of which 8 N are there."""
    np.testing.assert_allclose(servo_force(monkeypatch, 3.0, 2.0), [4.0], rtol=1e-14)


def test_servo_forces_of_a_state_that_is_not_finite_are_attributed_to_no_joint(monkeypatch):
    with pytest.raises(SingularityError) as caught:
        servo_force(monkeypatch, 3.0, np.nan)
    assert caught.value.joint is None
