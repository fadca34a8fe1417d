"""Checks of a verification: the largest difference of a quantity, its tolerance, and the element at fault."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from newton_euler.scalars import Array

MIN_SCALE_SHARE = 1e-3
"""Smallest scale of any row, as a fraction of the largest scale.

Scales are compared as forces at the size of the mechanism. Sums over all bodies are accurate to about 1e-16
of the largest scale, which is `READING_ROUND_OFF` times this fraction."""


class ReadingCheck(NamedTuple):
    """Check of one quantity of a scene against the file.

    Attributes:
        quantity: name and unit.
        value: largest difference.
        tolerance: largest allowed difference.
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
    """Make a check of the difference that is largest relative to its tolerance.

    Args:
        quantity: name and unit.
        gaps: (..., n) differences.
        tolerances: of a shape that broadcasts to `gaps`.
        names: (n,) elements.
    """
    limits = np.broadcast_to(tolerances, gaps.shape)
    if not gaps.size:
        return ReadingCheck(quantity, 0.0, float(np.max(tolerances)), "")
    shares = np.nan_to_num(gaps / limits, nan=np.inf)
    place = np.unravel_index(int(np.argmax(shares)), gaps.shape)
    return ReadingCheck(quantity, float(gaps[place]), float(limits[place]), names[int(place[-1])])


def closest_to_failing(figures: Iterable[ReadingCheck]) -> ReadingCheck:
    """Return the check with the largest difference relative to its tolerance."""
    return max(figures, key=lambda each: np.nan_to_num(each.value / each.tolerance, nan=np.inf))


def positive(scale: Array) -> Array:
    """Replace zero scales by the smallest positive number, so that differences can be divided by scales."""
    return np.where(scale > 0.0, scale, np.finfo(float).tiny)
