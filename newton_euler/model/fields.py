"""Declarations of the numbers of an element: unit, bounds, and what other values of a number change.

A class of elements declares its numbers once, as `number_fields`. Constructors check values by these
declarations. Parameters of runs (`newton_euler.equations.parameters`), their units and the check of many
values (`newton_euler.runs.variation`) follow from the same declarations.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from newton_euler.errors import MechanismError, finite_array, is_finite_number, quoted

AllowedValues = Literal["interval", "nonzero", "direction", "axis", "joint", "inertia"]
"""Values that a number of an element may take:

- `interval`: each component an interval that contains the element's own value;
- `nonzero`: the same, without 0;
- `direction`: vectors of any length but 0;
- `axis`: the same, as long as the pair of vectors across the axis does not jump;
- `joint`: values that depend on other numbers of the element;
- `inertia`: inertias (3, 3) that a rigid body can have.
"""


@dataclass(frozen=True)
class NumberField:
    """A number, an array of numbers or a function of time that elements of a class have as an attribute.

    Attributes:
        unit: SI unit; empty for pure numbers and for arrays of several units.
        unit_about: SI unit about hinges and balls, if other than the unit along slides and lines.
        shape: of the array, () for a number; None if the constructor has a check of its own.
        least: the smallest value of a number.
        positive: True if 0 is no value of the number.
        may_be_function: True if the attribute may be a function of time, or a mapping to functions.
        displaces: True for a point of a body, (3,) in the world at the initial pose. Its parameter is a
            displacement.
        allowed: values that runs may give.
        strength: what is proportional to the attribute: "spring", "damper", "wind", ...; empty for nothing.
        moves_loops: True if other values move the closed configurations, or the zeros of joint coordinates.
        opens_joints: True if other values open joints at the initial pose.
    """

    unit: str = ""
    unit_about: str = ""
    shape: tuple[int, ...] | None = ()
    least: float = -np.inf
    positive: bool = False
    may_be_function: bool = False
    displaces: bool = False
    allowed: AllowedValues = "interval"
    strength: str = ""
    moves_loops: bool = False
    opens_joints: bool = False

    def checked(self, where: str, name: str, value: Any) -> Any:
        """Return a value of the attribute as a float or a read-only array.

        Raises:
            MechanismError: naming `where` and the attribute, for a value that the field does not take.
        """
        if self.shape:
            return finite_array(where, name, value, self.shape)
        if not is_finite_number(value) or value < self.least or (self.positive and not value > 0.0):
            raise MechanismError(where, f"{name} is {quoted(value)}", self._needed)
        return float(value)

    @property
    def _needed(self) -> str:
        """The values that an error message asks for."""
        if self.positive:
            return "a positive finite number"
        return "a finite number" if np.isinf(self.least) else f"a finite number, {self.least:g} or more"


POINT = NumberField("m", shape=(3,), displaces=True)
"""A point of a body on which a force acts."""
