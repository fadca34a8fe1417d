"""What a body looks like. Shapes carry no mass; viewers and model files draw them.

All coordinates are in the world at the mechanism's initial pose, metres, like those of joints.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from newton_euler.errors import MechanismError
from newton_euler.scalars import Array

UNIT_TOLERANCE = 1e-9
"""How far from 1 the norm of a quaternion may be."""


def _set_array(shape: Box | Capsule, name: str, size: tuple[int, ...]) -> Array:
    """Replace an attribute by a read-only array of its own; raises `MechanismError`."""
    raw = getattr(shape, name)
    try:
        value = np.array(raw, dtype=float)
    except (TypeError, ValueError):
        value = np.full(1, np.nan)
    if value.shape != size or not np.all(np.isfinite(value)):
        needed = f"{size[0]} finite numbers" if size else "a finite number"
        raise MechanismError(type(shape).__name__.lower(), f"{name} is {raw!r}", needed)
    value.flags.writeable = False
    object.__setattr__(shape, name, value)
    return value


@dataclass(frozen=True, eq=False)
class Box:
    """A box of half sizes (3,) along the axes of a frame with the given centre and quaternion w-x-y-z.

    Raises:
        MechanismError: naming the attribute at fault.
    """

    half_sizes: Array
    center: Array
    quaternion: Array = (1.0, 0.0, 0.0, 0.0)  # type: ignore[assignment]

    def __post_init__(self) -> None:
        if np.any(_set_array(self, "half_sizes", (3,)) <= 0.0):
            raise MechanismError("box", f"half_sizes is {self.half_sizes.tolist()}", "three positive lengths")
        _set_array(self, "center", (3,))
        norm = float(np.linalg.norm(_set_array(self, "quaternion", (4,))))
        if abs(norm - 1.0) > UNIT_TOLERANCE:
            raise MechanismError("box", f"quaternion has norm {norm:.9g}", "a unit quaternion, w-x-y-z")


@dataclass(frozen=True, eq=False)
class Capsule:
    """A round bar of the given radius from `start` to `end`, (3,) each.

    Raises:
        MechanismError: naming the attribute at fault.
    """

    start: Array
    end: Array
    radius: float

    def __post_init__(self) -> None:
        _set_array(self, "start", (3,))
        _set_array(self, "end", (3,))
        if _set_array(self, "radius", ()) <= 0.0:
            raise MechanismError("capsule", f"radius is {self.radius}", "a positive length")
        object.__setattr__(self, "radius", float(self.radius))


Shape = Box | Capsule
