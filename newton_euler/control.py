"""Declared control laws: those that every engine can take into its own equations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from newton_euler.errors import MechanismError
from newton_euler.scalars import Scalar


@dataclass(frozen=True)
class PD:
    """u = -(K_p e + K_d de/dt) with e = x - target, eq. (23) with the sign that makes it stable.

    Attributes:
        joint: name of the joint it drives.
        stiffness: K_p in N/m or N m/rad.
        damping: K_d in N s/m or N m s/rad.
        target: wanted joint coordinate, m or rad from the initial pose.
        coordinate: which of the joint's coordinates, from 0.
    """

    joint: str
    stiffness: float
    damping: float
    target: float
    coordinate: int = 0

    def __post_init__(self) -> None:
        for name in ("stiffness", "damping", "target"):
            value = getattr(self, name)
            if not isinstance(value, int | float) or not np.isfinite(value):
                raise MechanismError(
                    f"control of joint {self.joint!r}", f"{name} is {value!r}", "a finite number"
                )

    def force(self, x: Scalar, x_rate: Scalar) -> Scalar:
        """The generalized force (N or N m) at coordinate x (m or rad) and its rate."""
        return -(self.stiffness * (x - self.target) + self.damping * x_rate)
