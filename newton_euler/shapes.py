"""What a body looks like. Shapes carry no mass; viewers and model files draw them.

All coordinates are in the world at the mechanism's initial pose, metres, like those of joints.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from newton_euler.scalars import Array


@dataclass(frozen=True, eq=False)
class Box:
    """A box of half sizes (3,) along the axes of a frame with the given centre and quaternion."""

    half_sizes: Array
    center: Array
    quaternion: Array = (1.0, 0.0, 0.0, 0.0)  # type: ignore[assignment]

    def __post_init__(self) -> None:
        for name in ("half_sizes", "center", "quaternion"):
            object.__setattr__(self, name, np.array(getattr(self, name), dtype=float))


@dataclass(frozen=True, eq=False)
class Capsule:
    """A round bar of the given radius from `start` to `end`, (3,) each."""

    start: Array
    end: Array
    radius: float

    def __post_init__(self) -> None:
        for name in ("start", "end"):
            object.__setattr__(self, name, np.array(getattr(self, name), dtype=float))


Shape = Box | Capsule
