"""Declared control laws: those that every engine can take into its own equations."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Integral, Real

import numpy as np

from newton_euler.errors import MechanismError
from newton_euler.scalars import Scalar


def is_finite_number(value: object) -> bool:
    """Whether a value is a real number of Python or NumPy that a float can hold; truth values are none."""
    try:
        return isinstance(value, Real) and not isinstance(value, bool) and bool(np.isfinite(float(value)))
    except OverflowError:
        return False


@dataclass(frozen=True)
class PD:
    """u = -(K_p e + K_d de/dt) with e = x - target, eq. (23) with the sign that makes it stable.

    Attributes:
        joint: name of the joint it drives.
        stiffness: K_p in N/m or N m/rad.
        damping: K_d in N s/m or N m s/rad.
        target: wanted joint coordinate, m or rad from the initial pose.
        coordinate: which of the joint's coordinates, from 0.

    Raises:
        MechanismError: naming the joint and the value at fault.
    """

    joint: str
    stiffness: float
    damping: float
    target: float
    coordinate: int = 0

    def __post_init__(self) -> None:
        where = f"control of joint {self.joint!r}"
        for name in ("stiffness", "damping", "target"):
            value = getattr(self, name)
            if not is_finite_number(value):
                raise MechanismError(where, f"{name} is {value!r}", "a finite number")
            object.__setattr__(self, name, float(value))
        if not isinstance(self.coordinate, Integral) or isinstance(self.coordinate, bool):
            raise MechanismError(where, f"coordinate is {self.coordinate!r}", "an index from 0")

    def force(self, x: Scalar, x_rate: Scalar) -> Scalar:
        """The generalized force (N or N m) at coordinate x (m or rad) and its rate."""
        return -(self.stiffness * (x - self.target) + self.damping * x_rate)
