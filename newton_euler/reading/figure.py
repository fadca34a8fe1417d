"""Figures of a verification: a difference, what it may be at most, and where it is worst."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from newton_euler.scalars import Array

SPREAD = 1e-3
"""Share of the largest scale that any row's is at least, in forces at the size: independent velocities, and
what readers work out of sums over all bodies, are known to some 1e-16, `ROUND_OFF` times this, of that."""


class Figure(NamedTuple):
    """One compared figure.

    Attributes:
        quantity: what is compared, with its unit.
        value, tolerance: the largest difference and what it may be at most.
        where: the element of the file, or the body or joint of the scene, of the largest difference.
    """

    quantity: str
    value: float
    tolerance: float
    where: str

    @property
    def agrees(self) -> bool:
        """NaN does not agree with anything."""
        return bool(self.value <= self.tolerance)


def figure(quantity: str, gaps: Array, tolerances: Array | float, names: Sequence[str]) -> Figure:
    """The worst of differences (..., names) for tolerances of a shape that goes with that."""
    limits = np.broadcast_to(tolerances, gaps.shape)
    if not gaps.size:
        return Figure(quantity, 0.0, float(np.max(tolerances)), "")
    shares = np.nan_to_num(gaps / limits, nan=np.inf)
    place = np.unravel_index(int(np.argmax(shares)), gaps.shape)
    return Figure(quantity, float(gaps[place]), float(limits[place]), names[int(place[-1])])


def worst(figures: Iterable[Figure]) -> Figure:
    """The one of a quantity that is largest for its tolerance."""
    return max(figures, key=lambda each: np.nan_to_num(each.value / each.tolerance, nan=np.inf))


def positive(scale: Array) -> Array:
    """A scale for differences; where there is nothing at all, any number is as good."""
    return np.where(scale > 0.0, scale, np.finfo(float).tiny)
