"""Checks of an imported scene: the largest difference of a quantity, its tolerance, and where it occurs.

A scene is checked against the model file from which it was imported, see `newton_euler.reading.verify`. Each
check compares one quantity, such as masses, of all bodies or joints.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from newton_euler.scalars import Array

MIN_SCALE_SHARE = 1e-3
"""Smallest scale by which a difference is divided, as a fraction of the largest scale of the quantity.

Modules that compute relative differences, such as `newton_euler.reading.forces`, apply this limit. Each entry
of a quantity, such as the force on one joint, has a scale: the sum of the magnitudes of its terms. Torques
are divided by the size of the mechanism before scales are compared. Sums over all bodies are accurate to
about 1e-16 of the largest scale. This is less than the tolerance of checks, 1e-12, times the fraction."""


class ReadingCheck(NamedTuple):
    """Check of one quantity of a scene against the file.

    Attributes:
        quantity: name and unit, such as "mass, rel"; "rel" stands for a relative difference.
        value: largest difference, in this unit.
        tolerance: largest allowed difference, in this unit.
        where: element of the file, or body or joint of the scene, with the largest difference.
    """

    quantity: str
    value: float
    tolerance: float
    where: str

    @property
    def agrees(self) -> bool:
        """True if the difference is within its tolerance; False for NaN."""
        return bool(self.value <= self.tolerance)


def worst_entry(quantity: str, gaps: Array, tolerances: Array | float, names: Sequence[str]) -> ReadingCheck:
    """Make a check of the one among several differences that is largest relative to its tolerance.

    Args:
        quantity: name and unit.
        gaps: (..., n) absolute differences; the leading axes are samples.
        tolerances: largest allowed differences, of a shape that broadcasts to `gaps`.
        names: (n,) names of the elements, bodies or joints that the last axis of `gaps` counts.
    """
    limits = np.broadcast_to(tolerances, gaps.shape)
    if not gaps.size:
        return ReadingCheck(quantity, 0.0, float(np.max(tolerances)), "")
    ratios = np.nan_to_num(gaps / limits, nan=np.inf)
    worst = np.unravel_index(int(np.argmax(ratios)), gaps.shape)
    return ReadingCheck(quantity, float(gaps[worst]), float(limits[worst]), names[int(worst[-1])])


def closest_to_failing(checks: Iterable[ReadingCheck]) -> ReadingCheck:
    """Return the check with the largest difference relative to its tolerance; NaN counts as the largest."""
    return max(checks, key=lambda each: np.nan_to_num(each.value / each.tolerance, nan=np.inf))


def positive(scale: Array) -> Array:
    """Replace zero scales by the smallest positive number, so that differences can be divided by scales."""
    return np.where(scale > 0.0, scale, np.finfo(float).tiny)
