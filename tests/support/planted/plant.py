"""A planted difference: what was changed in a model file, and the rows that `crosscheck diff` owes for it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from crosscheck.differences.difference import Difference, Quantity, Standing
from crosscheck.differences.result import FileComparison
from newton_euler.scalars import Array

SIZE_TOL = 0.02
"""Largest relative error of a reported size: sizes of principal moments depend on all moments."""


class NotApplicable(Exception):
    """A file does not have what a change needs."""


@dataclass(frozen=True)
class Expected:
    """Row that a planted change should give.

    Attributes:
        element: name of the changed element in the file; "" for any, such as the model.
        quantity: what was changed.
        size: of the change, as `Difference.size` counts; None if only the element and the quantity count.
        cause: words that the cause should contain.
        others: quantities that the row may have instead, such as another length where all lengths change.
    """

    element: str
    quantity: Quantity
    size: float | None = None
    cause: str = ""
    others: tuple[Quantity, ...] = ()

    def is_named_by(self, row: Difference) -> bool:
        """Return whether a row names quantity, element, size and cause."""
        if row.quantity not in (self.quantity, *self.others) or self.cause not in row.cause:
            return False
        if self.element and self.element not in (row.element, *row.elements):
            return False
        tolerance = SIZE_TOL * (self.size or 0.0) + row.uncertainty
        return self.size is None or math.isclose(row.size, self.size, rel_tol=0.0, abs_tol=tolerance)


@dataclass(frozen=True)
class Coordinate:
    """Joint of the changed file: its coordinate is sense * q + offset for the coordinate q of the file."""

    name: str
    sense: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Plant:
    """A change of a file and what it should give.

    Attributes:
        rows: expected true differences; none if the robot stays the same but for words and digits.
        conventions: quantities of rows that should say that the file uses other words for the same robot.
        touched: names of the changed elements. Changes that share no element can be combined.
        coordinates: joints whose name, sign or zero is another one in the changed file, by their name.
        has_truth: False if accelerations cannot be compared joint by joint, as with another base.
    """

    rows: tuple[Expected, ...] = ()
    conventions: tuple[Quantity, ...] = ()
    touched: frozenset[str] = frozenset()
    coordinates: Mapping[str, Coordinate] = field(default_factory=dict)
    has_truth: bool = True


def mistakes(comparison: FileComparison, plants: list[Plant]) -> list[str]:
    """Return what a comparison says wrong about planted changes, in words; an empty list if all is right."""
    expected = [row for plant in plants for row in plant.rows]
    found = comparison.differences
    missing = [each for each in expected if not any(each.is_named_by(row) for row in found)]
    surplus = [row for row in found if not any(each.is_named_by(row) for each in expected)]
    wrong = [f"missing: {each.quantity} of {each.element or 'the model'}" for each in missing]
    wrong += [
        f"not planted: {row.quantity} of {row.element} ({row.size:.4g}) {row.cause}".rstrip()
        for row in surplus
    ]
    conventions = {row.quantity for row in comparison.of_standing(Standing.CONVENTION)}
    for plant in plants:
        wrong += [f"missing convention: {each}" for each in plant.conventions if each not in conventions]
    if not expected and not comparison.outcome.passes() and not surplus:
        wrong.append(f"motion differs by {comparison.motion.change:.2g}")
    return wrong


def turn(axis: Array, angle: float) -> Array:
    """Return the rotation matrix (3, 3) of a turn about a direction (3,) by an angle, rad."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    matrix: Array = np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross
    return matrix


def across(axis: Array) -> Array:
    """Return a unit vector (3,) perpendicular to a direction (3,)."""
    direction = np.asarray(axis) / np.linalg.norm(axis)
    other = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
    unit: Array = other / np.linalg.norm(other)
    return unit


def text(*values: float, digits: int = 10) -> str:
    """Format numbers for an attribute."""
    return " ".join(f"{float(value) + 0.0:.{digits}g}" for value in np.ravel(values))


def numbers(text: str | None, default: str) -> Array:
    """Return the numbers of an attribute."""
    return np.array((text or default).split(), dtype=float)


def point_mass_inertia(mass: float, offset: Array) -> Array:
    """Return the inertia (3, 3), kg m^2, of a point mass, kg, at an offset (3,), m."""
    matrix: Array = mass * (offset @ offset * np.eye(3) - np.outer(offset, offset))
    return matrix
