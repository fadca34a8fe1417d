"""Data of the loops, springs and rotors that tools such as Gazebo and Drake add to a URDF.

`urdf.reading.extensions` reads these elements. `urdf.reader` converts them to joints and forces of a scene.
To verify the scene, `urdf.reference` independently converts them to constraints and forces of Pinocchio's
model.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

from urdf.loops import Loops

ARMATURE = "armature"
"""Name of rotor inertias as the property of a joint that an entry of an import report is about."""

STIFFNESS = "stiffness"
"""Name of joint springs as the property of a joint that an entry of an import report is about."""


class PointSpringElement(NamedTuple):
    """Spring and damper between two points.

    Attributes:
        name: name of the spring.
        frames: names of the frames at both ends.
        stiffness: N/m.
        rest_length: m.
        damping: N s/m.
    """

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
        closed_loop: pairs of frames that a loop closure connects.
        closure_types: for each pair, the type of the loop closure, see `urdf.loops`: "3d" if the origins of
            the frames coincide, "6d" if the frames coincide, "revolute" for a hinge about their x axes.
        springs: stiffness, N m/rad or N/m, and rest position, rad or m, by joint name.
        dampings: damping in addition to that of the joint's `<dynamics>`, N m s/rad or N s/m, by joint name.
        armatures: rotor inertias, kg m^2 or kg, by joint name.
        point_springs: springs between points of two links.
    """

    text: str
    closed_loop: list[tuple[str, str]] = field(default_factory=list)
    closure_types: list[str] = field(default_factory=list)
    springs: dict[str, tuple[float, float]] = field(default_factory=dict)
    dampings: dict[str, float] = field(default_factory=dict)
    armatures: dict[str, float] = field(default_factory=dict)
    point_springs: list[PointSpringElement] = field(default_factory=list)

    def added_to(self, loops: Loops) -> Loops:
        """Return the loops of a loop file (YAML that accompanies a URDF), followed by those of the URDF."""
        return replace(
            loops,
            closed_loop=(*loops.closed_loop, *self.closed_loop),
            type=(*loops.type, *self.closure_types),
        )
