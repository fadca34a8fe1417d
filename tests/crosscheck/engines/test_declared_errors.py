"""Expected errors that an engine declares: above 0, and at most the largest error that comparisons accept."""

from __future__ import annotations

from dataclasses import replace

import pytest

from crosscheck.engines.engine import MAX_RELATIVE_ERROR
from crosscheck.engines.registry import ENGINES, SOLVER
from crosscheck.support.errors import CrosscheckError

NAMES = ("trajectory_error", "drift", "energy_error")


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("value", [0.0, -1e-9, 1.0, 1.001 * MAX_RELATIVE_ERROR, float("nan"), "1e-9", True])
def test_errors_that_would_hide_differences_are_refused(name, value):
    with pytest.raises(CrosscheckError) as error:
        replace(SOLVER, **{name: value})
    assert all(part in str(error.value) for part in ("newton_euler", name, repr(value), "0.01"))


@pytest.mark.parametrize("name", NAMES)
def test_the_largest_error_that_comparisons_accept_may_be_declared(name):
    assert getattr(replace(SOLVER, **{name: MAX_RELATIVE_ERROR}), name) == MAX_RELATIVE_ERROR


def test_the_force_error_of_soft_constraints_is_bounded():
    soft = ENGINES["mujoco"].soft_constraints._replace(force_error=2.0 * MAX_RELATIVE_ERROR)
    with pytest.raises(CrosscheckError, match="force_error of soft_constraints"):
        replace(ENGINES["mujoco"], soft_constraints=soft)
