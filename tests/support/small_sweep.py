"""A small sweep: what it is called with, and whether two of it are equal."""

from __future__ import annotations

import numpy as np

from crosscheck import Sweep

ARGUMENTS = (
    "pendulum",
    {"dumbbell.mass": "uniform(1, 2)"},
    60,
    "peak:reaction_force,at(1;2):dumbbell.position",
)


def assert_equal(found: Sweep, reference: Sweep) -> None:
    """Check that what is drawn, kept and said of each run is equal to the last bit."""
    assert set(found.dataset) == set(reference.dataset)
    for name, values in reference.dataset.items():
        assert np.array_equal(found.dataset[name].values, values.values), name
