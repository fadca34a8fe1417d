"""Declarations of the numbers of bodies, joints, forces and control laws: units and allowed values.

Each class of the model declares its numbers once, as `number_fields`: a mapping from attribute names to
`NumberField` records. Constructors check values by these declarations. The parameters that may differ from
run to run (`newton_euler.equations.parameters`), their units and their checks (`newton_euler.runs.variation`)
follow from the same declarations.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from newton_euler.errors import MechanismError, finite_array, is_finite_number, quoted

AllowedValues = Literal["interval", "nonzero", "direction", "axis", "constructor", "inertia"]
"""Rule for the values that a number may take in a run:

- `interval`: in each component any value of the interval, around the scene's own value, that the element's
  constructor accepts;
- `nonzero`: the same, without 0;
- `direction`: a vector of any nonzero length;
- `axis`: a direction near enough to the scene's own axis that the two unit vectors chosen perpendicular to
  the axis (`newton_euler.model.joint.perpendicular_pair`) vary continuously;
- `constructor`: values whose validity depends on other numbers of the element, checked by its constructor;
- `inertia`: inertia tensors (3, 3) that a rigid body can have.
"""


@dataclass(frozen=True)
class NumberField:
    """Declaration of one attribute: a number, an array of numbers, or a function of time.

    Attributes:
        unit: SI unit; empty for dimensionless numbers and for arrays with several units.
        unit_about: SI unit at a hinge or ball, if it differs from the unit at a slide, such as N m/rad
            instead of N/m.
        shape: shape of the array, () for a number; None if the constructor checks the attribute without this
            record.
        least: smallest allowed value of a number.
        positive: True if the number must be greater than 0.
        may_be_function: True if the attribute may be a function of time, or a mapping whose values may be
            functions of time.
        displaces: True for a point fixed in a body, (3,) m in the world at the initial pose. The parameter of
            a run is then the displacement of the point.
        allowed: rule for the values in a run, see `AllowedValues`.
        strength: name of the physical effect that is proportional to the attribute: "spring", "damper",
            "friction", "stop", "rotor", "wind", "wrench" or "actuator"; empty if no effect is proportional to
            it. Scaling the attributes of one effect shows whether a motion depends on the effect.
        moves_loops: True if a change moves the poses in which loops are closed, or the zeros of joint
            coordinates, such as the axis of a hinge.
        opens_joints: True if a change also violates the joint's own constraints at the initial pose, such as
            the length of a rod, so that the pose must be solved again.
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
        """Convert a value of the attribute to a float or a read-only array.

        Args:
            where: name of the element, for the error message.
            name: name of the attribute.
            value: the value that a user passed to the constructor.

        Raises:
            MechanismError: naming `where` and the attribute, for a value outside of the declared shape or
                bounds.
        """
        if self.shape:
            return finite_array(where, name, value, self.shape)
        if not is_finite_number(value) or value < self.least or (self.positive and not value > 0.0):
            raise MechanismError(where, f"{name} is {quoted(value)}", self._needed)
        return float(value)

    @property
    def _needed(self) -> str:
        """Description of the allowed values of a number, for error messages."""
        if self.positive:
            return "a positive finite number"
        return "a finite number" if np.isinf(self.least) else f"a finite number, {self.least:g} or more"


POINT = NumberField("m", shape=(3,), displaces=True)
"""Declaration of a point fixed in a body, at which a force acts or a joint is."""
