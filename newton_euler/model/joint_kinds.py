"""Joint kinds: Appendix A of the paper and more, one class a kind."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import field, replace
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np

from newton_euler.errors import MechanismError, is_finite_number, quoted
from newton_euler.model.compound_joint import Compound
from newton_euler.model.constraints import Constraint, Distance, Perpendicular, Reversed
from newton_euler.model.description import ArrayField, description
from newton_euler.model.fields import NumberField
from newton_euler.model.joint import (
    BALL_MOTION,
    LEAST_LENGTH,
    AxisJoint,
    Joint,
    Motion,
    Pose,
    perpendicular_pair,
)
from newton_euler.model.parallel_hinges import ParallelHinges

AXIS_TOLERANCE = 1e-9  # rad, from perpendicular, of a universal joint's axes at the initial pose


@description
class Spherical(Joint):
    """Ball joint, eq. (25): three equations.

    Examples:
        >>> Spherical("joint", "ground", "body", [0.0, 0.0, 0.0]).coordinate_kinds
        ()
    """

    kind: ClassVar[str] = "spherical"

    @property
    def motions(self) -> tuple[Motion, ...]:
        return (BALL_MOTION,)

    def constraints(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        return self._coincident(first, second)


@description
class Universal(Joint):
    """Cardan joint, eq. (26): four equations; `axis_on_first` stays perpendicular to `axis_on_second`.

    Its coordinates are the angle about the first body's axis, then that about the second's.

    Examples:
        >>> x, y, _ = np.eye(3)
        >>> joint = Universal("joint", "ground", "body", np.zeros(3), axis_on_first=x, axis_on_second=y)
        >>> joint.coordinate_kinds
        ('hinge', 'hinge')
    """

    axis_on_first: ArrayField = field(kw_only=True)
    axis_on_second: ArrayField = field(kw_only=True)
    kind: ClassVar[str] = "universal"
    axis_names: ClassVar[tuple[str, ...]] = ("axis_on_first", "axis_on_second")
    number_fields: ClassVar = Joint.number_fields | dict.fromkeys(
        ("axis_on_first", "axis_on_second"), NumberField(shape=None, allowed="joint", moves_loops=True)
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        cosine = float(self.axis_on_first @ self.axis_on_second)
        if abs(cosine) > AXIS_TOLERANCE:
            raise MechanismError(
                f"joint {quoted(self.name)}",
                f"its two axes have a cosine of {cosine:.3g}",
                f"perpendicular axes, |cosine| at most {AXIS_TOLERANCE:g}",
            )

    @property
    def motions(self) -> tuple[Motion, ...]:
        return (Motion("hinge", self.axis_on_first), Motion("hinge", self.axis_on_second))

    def constraints(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        cross_axes = Perpendicular(
            first.vector_to_body(self.axis_on_first), second.vector_to_body(self.axis_on_second)
        )
        return (*self._coincident(first, second), cross_axes)

    def coordinates(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        a, b = self.axis_on_first, self.axis_on_second
        return self._turn(a, b, first, second), Reversed(self._turn(b, a, second, first))


@description
class Revolute(AxisJoint):
    """Hinge, eq. (27): five equations.

    Examples:
        >>> Revolute("joint", "ground", "body", [0.0, 0.0, 0.0], axis=[0.0, 0.0, 1.0]).coordinate_kinds
        ('hinge',)
    """

    kind: ClassVar[str] = "revolute"
    along = ("hinge",)

    def constraints(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        return self._coincident(first, second) + self._parallel(self.axis, self.pair, first, second)


@description
class Cylindrical(AxisJoint):
    """Slide along and hinge about one axis: four equations, Phi^(p1,2) and Phi^(p2,2).

    Its coordinates are the displacement, then the angle.

    Examples:
        >>> Cylindrical("joint", "ground", "body", [0.0, 0.0, 0.0], axis=[0.0, 0.0, 1.0]).coordinate_kinds
        ('slide', 'hinge')
    """

    kind: ClassVar[str] = "cylindrical"
    along = ("slide", "hinge")

    def constraints(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        pair = self.pair
        return self._parallel(self.axis, pair, first, second) + self._on_line(pair, first, second)


@description
class Translational(AxisJoint):
    """Slide without rotation, eq. (28): five equations, h_i and h_j across the axis.

    Examples:
        >>> Translational("joint", "ground", "body", [0.0, 0.0, 0.0], axis=[0.0, 0.0, 1.0]).coordinate_kinds
        ('slide',)
    """

    kind: ClassVar[str] = "translational"
    along = ("slide",)

    def constraints(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        h_i, h_j = pair = self.pair
        return (
            *self._parallel(self.axis, pair, first, second),
            *self._on_line(pair, first, second),
            Perpendicular(first.vector_to_body(h_i), second.vector_to_body(h_j)),
        )


@description
class Prismatic(Translational):
    """The paper's translational joint under the name that robot models give it.

    Examples:
        >>> Prismatic("joint", "ground", "body", [0.0, 0.0, 0.0], axis=[0.0, 0.0, 1.0]).coordinate_kinds
        ('slide',)
    """

    kind: ClassVar[str] = "prismatic"


@description
class Screw(Cylindrical):
    """A nut on a spindle: five equations, those of `Cylindrical` and slide - pitch * angle = 0.

    Its coordinates are the displacement, then the angle. The fifth equation couples them, see
    `newton_euler.equations.couplings`, and is not among `constraints`.

    Attributes:
        pitch: meters per radian; positive for a right-handed thread.

    Examples:
        >>> joint = Screw("joint", "ground", "body", [0.0, 0.0, 0.0], axis=[0.0, 0.0, 1.0], pitch=0.002)
        >>> joint.coordinate_kinds
        ('slide', 'hinge')
    """

    pitch: float = field(kw_only=True)
    kind: ClassVar[str] = "screw"
    number_fields: ClassVar = AxisJoint.number_fields | {
        "pitch": NumberField("m/rad", shape=None, allowed="nonzero", moves_loops=True)
    }

    def __post_init__(self) -> None:
        super().__post_init__()
        if not is_finite_number(self.pitch) or self.pitch == 0.0:
            needed = "a finite number of meters per radian, not 0"
            raise MechanismError(f"joint {quoted(self.name)}", f"pitch is {quoted(self.pitch)}", needed)
        object.__setattr__(self, "pitch", float(self.pitch))


@description
class Planar(AxisJoint):
    """A plane face on another: three equations; `axis` is the normal of both.

    Its coordinates are the displacements along `perpendicular_pair(axis)`, vectors of the first
    body, then the angle about the axis.

    Examples:
        >>> Planar("joint", "ground", "body", [0.0, 0.0, 0.0], axis=[0.0, 0.0, 1.0]).coordinate_kinds
        ('slide', 'slide', 'hinge')
    """

    kind: ClassVar[str] = "planar"

    def rebuilt(self, values: Mapping[str, Any]) -> Self:
        """See `Joint.rebuilt`; the axes of the slides do not jump."""
        changed = super().rebuilt(values)
        own = perpendicular_pair(changed.axis, self.axis)
        if not np.array_equal(own, changed.pair):
            problem = f"axis is {changed.axis.tolist()}, where the slides of the plane jump"
            raise MechanismError(f"joint {quoted(self.name)}", problem, "an axis nearer to the described one")
        return changed

    @property
    def motions(self) -> tuple[Motion, ...]:
        slides = (Motion("slide", a) for a in self.pair)
        return (*slides, Motion("hinge", self.axis))

    def constraints(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        parallel = self._parallel(self.axis, self.pair, first, second)
        return (*parallel, self._displacement(self.axis, 0.0, first, second))


@description
class PointOnLine(AxisJoint):
    """The second body's point stays on a line of the first, along `axis`: two equations.

    Its coordinate is the displacement along the line.

    Examples:
        >>> PointOnLine("joint", "ground", "body", [0.0, 0.0, 0.0], axis=[0.0, 0.0, 1.0]).coordinate_kinds
        ('slide',)
    """

    kind: ClassVar[str] = "point_on_line"
    along = ("slide",)

    @property
    def motions(self) -> tuple[Motion, ...]:
        return (*super().motions, BALL_MOTION)

    def constraints(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        return self._on_line(self.pair, first, second)


@description
class Rod(Joint):
    """A massless rod on balls: one equation, the distance from `point` to `point_on_second` stays.

    Its reaction is the force along it; tension pulls the second body towards the first.

    Examples:
        >>> Rod("joint", "ground", "body", [0.0, 0.0, 0.0], point_on_second=[0.0, 0.0, 0.5]).only_closes
        True
    """

    kind: ClassVar[str] = "rod"
    number_fields: ClassVar = Joint.number_fields | {
        "length": NumberField("m", shape=None, moves_loops=True, opens_joints=True)
    }
    only_closes: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check(self.length)

    def _check(self, length: float) -> None:
        """Raise `MechanismError` for a length that no rod has."""
        if not LEAST_LENGTH <= length < math.inf:
            problem = f"its two points are {length:.3g} m apart"
            needed = f"point_on_second at least {LEAST_LENGTH:g} m from point, a ball joint otherwise"
            raise MechanismError(f"joint {quoted(self.name)}", problem, needed)

    @cached_property
    def length(self) -> float:
        """m, which stays where points vary."""
        return math.dist(self.reaction_point, self.point)

    def varied(self, values: Mapping[str, Any]) -> Self:
        return super().varied({"length": self.length, **values})

    def rebuilt(self, values: Mapping[str, Any]) -> Self:
        others = {name: value for name, value in values.items() if name != "length"}
        changed, along = super().rebuilt(others), self.reaction_point - self.point
        if "length" not in values:
            return changed
        self._check(float(values["length"]))
        along = along * (float(values["length"]) / self.length)
        return replace(changed, point_on_second=changed.point + along)

    def constraints(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        s_i, s_j = first.point_to_body(self.point), second.point_to_body(self.reaction_point)
        return (Distance(s_i, s_j, self.length),)


@description
class Fixed(Joint):
    """No motion at all: six equations.

    Examples:
        >>> Fixed("joint", "ground", "body", [0.0, 0.0, 0.0]).coordinate_kinds
        ()
    """

    kind: ClassVar[str] = "fixed"

    def constraints(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        return (*self._coincident(first, second), *self._aligned(first, second))


@description
class Free(Joint):
    """All motion: no equation. It marks a body that floats on purpose.

    Examples:
        >>> Free("joint", "ground", "body", [0.0, 0.0, 0.0]).coordinate_kinds
        ('slide', 'slide', 'slide')
    """

    kind: ClassVar[str] = "free"

    @property
    def motions(self) -> tuple[Motion, ...]:
        x, y, z = np.eye(3)
        slides = (Motion("slide", x), Motion("slide", y), Motion("slide", z))
        return (*slides, BALL_MOTION)

    def constraints(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        return ()


JOINT_KINDS: dict[str, type[Joint]] = {
    kind.kind: kind
    for kind in (
        Fixed,
        Revolute,
        Prismatic,
        Translational,
        Cylindrical,
        Screw,
        Planar,
        Universal,
        Spherical,
        PointOnLine,
        ParallelHinges,
        Compound,
        Rod,
        Free,
    )
}
"""Joint classes by the name that files use."""
