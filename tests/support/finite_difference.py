"""The one finite-difference helper that checks every analytic derivative."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from newton_euler.scalars import Array

STEP = 1e-3


def derivative(function: Callable[[float], Array], step: float = STEP) -> Array:
    """d function / ds at s = 0 by the central difference of order 6.

    Truncation is step^6 / 140 times the seventh derivative and round-off about 2e-16 / step: with
    step 1e-3 and quantities of order 1 the result is good to 1e-12.
    """
    weights = {1: 45.0, 2: -9.0, 3: 1.0}
    total = sum(
        weight * (np.asarray(function(k * step)) - np.asarray(function(-k * step)))
        for k, weight in weights.items()
    )
    return np.asarray(total) / (60.0 * step)


def jacobian(function: Callable[[Array], Array], size: int, step: float = STEP) -> Array:
    """d function(x) / dx at x = 0, (m, size), column by column."""
    return np.column_stack([derivative(lambda s, e=e: function(s * e), step) for e in np.eye(size)])
