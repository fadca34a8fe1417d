"""Splines through few samples, which lie on one polynomial."""

from __future__ import annotations

import numpy as np
import pytest

from newton_euler import Spline


@pytest.mark.parametrize("count", [2, 3, 4, 5, 6])
def test_few_samples_lie_on_one_polynomial(count):
    times = np.linspace(0.0, 0.05, count) ** 1.2  # not equally spaced
    values = np.cos(3.0 * np.arange(count))
    spline = Spline(tuple(times), tuple(values))
    assert spline.knots == ()
    known = np.polynomial.Polynomial.fit(times, values, count - 1)
    for time in np.linspace(times[0], times[-1], 7):
        # round-off of polynomials of degree 5 and of their derivatives over 0.03 s
        assert spline.value(time) == pytest.approx(known(time), abs=1e-12)
        assert spline.rate(time) == pytest.approx(known.deriv()(time), abs=1e-9)
