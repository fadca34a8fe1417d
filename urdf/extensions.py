"""Loops, springs and rotors of a URDF beyond its links and joints, as plain numbers.

`urdf.reading.extensions` reads them. The reader makes joints and forces of them, and `urdf.reference` rows
and forces of Pinocchio's own model, each in its own way.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

from urdf.loops import Loops


class PointSpringElement(NamedTuple):
    """A spring and damper between two points: names of frames, N/m, m and N s/m."""

    name: str
    frames: tuple[str, str]
    stiffness: float
    rest_length: float
    damping: float


@dataclass
class Extensions:
    """Elements of a URDF that act beyond its links and joints.

    Attributes:
        text: the URDF with a frame for each end of a loop and of a spring.
        closed_loop, kinds: pairs of those frames, and what closes them: kinds of `urdf.loops`.
        springs: stiffness, N m/rad or N/m, and rest, rad or m, by the name of a joint.
        dampings: N m s/rad or N s/m beside those of `<dynamics>`, by the name of a joint.
        armatures: kg m^2 or kg, by the name of a joint.
        point_springs: between points of two links.
    """

    text: str
    closed_loop: list[tuple[str, str]] = field(default_factory=list)
    kinds: list[str] = field(default_factory=list)
    springs: dict[str, tuple[float, float]] = field(default_factory=dict)
    dampings: dict[str, float] = field(default_factory=dict)
    armatures: dict[str, float] = field(default_factory=dict)
    point_springs: list[PointSpringElement] = field(default_factory=list)

    def added_to(self, loops: Loops) -> Loops:
        """A loop file's loops, and those of the URDF after them."""
        return replace(
            loops, closed_loop=(*loops.closed_loop, *self.closed_loop), type=(*loops.type, *self.kinds)
        )
