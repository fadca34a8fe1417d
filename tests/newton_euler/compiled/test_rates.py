"""Integration of rates that Python evaluates: closed forms, and runs that end early."""

from __future__ import annotations

import numpy as np
import pytest

from newton_euler.compiled.rates import integrate_rates
from newton_euler.integrators.options import Options
from newton_euler.scalars import Array

TOLERANCES = Options(rtol=1e-10, atol=1e-12)


def test_oscillator_at_all_steps() -> None:
    times, states = integrate_rates(
        lambda y: np.array([y[1], -y[0]]), np.array([1.0, 0.0]), 3.0, TOLERANCES, 100
    )
    assert (times[0], times[-1]) == (0.0, 3.0)
    assert np.all(np.diff(times) > 0.0)
    # some ten steps, each with an error of at most the tolerance
    np.testing.assert_allclose(states, np.stack([np.cos(times), -np.sin(times)], axis=1), atol=1e-9)


def test_a_run_ends_after_its_steps() -> None:
    times, states = integrate_rates(lambda y: -1e6 * y, np.ones(1), 1.0, TOLERANCES, 10)
    # stability of an explicit method: steps of order 8 are at most about 6e-6 s
    assert 0.0 < times[-1] < 1e-4
    assert len(times) == len(states) <= 11
    np.testing.assert_allclose(states[:, 0], np.exp(-1e6 * times), atol=1e-9)


def test_a_run_ends_where_rates_have_no_value() -> None:
    def rates(y: Array) -> Array:
        if y[0] > 0.5:
            raise np.linalg.LinAlgError
        return np.ones(1)

    times, states = integrate_rates(rates, np.zeros(1), 2.0, TOLERANCES, 100)
    # y = t up to 0.5, approached by ever smaller steps
    assert 0.4 < times[-1] <= 0.5
    np.testing.assert_allclose(states[:, 0], times, atol=1e-12)


def test_other_errors_are_raised() -> None:
    def rates(y: Array) -> Array:
        raise KeyError("y")

    with pytest.raises(KeyError):
        integrate_rates(rates, np.ones(1), 1.0, TOLERANCES, 10)
