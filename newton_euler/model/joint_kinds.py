"""Joint classes, one for each kind of joint: constraint equations, elementary motions and coordinates.

The base classes are in `newton_euler.model.joint`, compound joints in `compound_joint` and `parallel_hinges`.
Equation numbers in docstrings are those of Appendix A of S. Srang, S. Ath and M. Yamakita, Advances in
Science, Technology and Engineering Systems Journal 5(5), 2020, doi:10.25046/aj050587. "Five equations" means
that the joint removes five of the six relative degrees of freedom. The coordinates of a joint are its hinge
angles, rad, and displacements of slides, m, in the order of `Joint.motions`. The mapping `JOINT_KINDS` has
all classes by the names that scene files use.

The numbers of a joint may vary from run to run. `varied` copies a joint with other numbers, without checks;
`rebuilt` constructs it again, with the checks of the constructor. `number_fields` declares unit and allowed
values of each number (`newton_euler.model.fields`). There, `shape=None` leaves the check to the constructor.
`moves_loops` means that a change moves the poses in which loops are closed. `opens_joints` means that a
change violates the joint's constraints at the initial pose.
"""

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
    MIN_POINT_DISTANCE,
    AxisJoint,
    Joint,
    Motion,
    Pose,
    perpendicular_pair,
)
from newton_euler.model.parallel_hinges import ParallelHinges

AXIS_TOLERANCE = 1e-9
"""Largest deviation from a right angle, rad, between the two axes of a universal joint at the initial
pose."""


@description
class Spherical(Joint):
    """Ball joint, eq. (25): three equations, the joint points of both bodies coincide.

    It has no coordinates, because three angles cannot describe every rotation without a singularity. An
    initial state gives such a body its orientation and its angular velocity, see `State`.

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
    """Universal (Cardan) joint, eq. (26): four equations; `axis_on_first` stays perpendicular to
    `axis_on_second`.

    The coordinates are the angle about the axis of the first body, then the angle about the axis of the
    second body.

    Attributes:
        axis_on_first: (3,) axis fixed in the first body, world at the initial pose, of any length.
        axis_on_second: (3,) axis fixed in the second body, world at the initial pose, of any length.

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
        ("axis_on_first", "axis_on_second"), NumberField(shape=None, allowed="constructor", moves_loops=True)
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
        perpendicular_axes = Perpendicular(
            first.vector_to_body(self.axis_on_first), second.vector_to_body(self.axis_on_second)
        )
        return (*self._coincident(first, second), perpendicular_axes)

    def coordinates(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        # The angle about each axis is that of the other axis, which rotates about it with the other body.
        # `Reversed` exchanges the bodies, because the second axis is fixed in the second body
        a, b = self.axis_on_first, self.axis_on_second
        return self._hinge_coordinate(a, b, first, second), Reversed(
            self._hinge_coordinate(b, a, second, first)
        )


@description
class Revolute(AxisJoint):
    """Revolute joint (hinge), eq. (27): five equations. Its coordinate is the angle about `axis`.

    Attributes:
        axis: (3,) axis of the hinge, world at the initial pose, of any nonzero length.
            Positive angles turn the second body about it by the right-hand rule.

    Examples:
        >>> hinge = Revolute("hinge", "ground", "door", [0.0, 0.0, 0.0], axis=[0.0, 0.0, 2.0])
        >>> hinge.axis.tolist(), hinge.kind, hinge.coordinate_kinds
        ([0.0, 0.0, 1.0], 'revolute', ('hinge',))
    """

    kind: ClassVar[str] = "revolute"
    motion_kinds = ("hinge",)

    def constraints(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        return self._coincident(first, second) + self._parallel(self.axis, self.pair, first, second)


@description
class Cylindrical(AxisJoint):
    """Cylindrical joint: slide along and hinge about one axis; four equations.

    Two equations keep the axes of both bodies parallel (eq. (27)), two keep the joint point on the axis (eq.
    (28)). The coordinates are the displacement along the axis, then the angle about it.

    Attributes:
        axis: (3,) common axis of slide and hinge, world at the initial pose, of any nonzero length.
            Positive coordinates move the second body along it, and turn it by the right-hand rule.

    Examples:
        >>> Cylindrical("pin", "ground", "body", [0.0, 0.0, 0.0], axis=[0.0, 0.0, 1.0]).coordinate_kinds
        ('slide', 'hinge')
    """

    kind: ClassVar[str] = "cylindrical"
    motion_kinds = ("slide", "hinge")

    def constraints(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        pair = self.pair
        return self._parallel(self.axis, pair, first, second) + self._on_line(pair, first, second)


@description
class Translational(AxisJoint):
    """Slide along `axis` without rotation, eq. (28): five equations. Its coordinate is the displacement.

    The fifth equation keeps h_i of the first body perpendicular to h_j of the second body; both vectors are
    perpendicular to the axis and to each other at the initial pose.

    Attributes:
        axis: (3,) direction of the slide, world at the initial pose, of any nonzero length.
            Positive displacements move the second body along it.

    Examples:
        >>> Translational("rail", "ground", "cart", [0.0, 0.0, 0.0], axis=[0.0, 3.0, 4.0]).axis.tolist()
        [0.0, 0.6, 0.8]
    """

    kind: ClassVar[str] = "translational"
    motion_kinds = ("slide",)

    def constraints(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        h_i, h_j = pair = self.pair
        return (
            *self._parallel(self.axis, pair, first, second),
            *self._on_line(pair, first, second),
            Perpendicular(first.vector_to_body(h_i), second.vector_to_body(h_j)),
        )


@description
class Prismatic(Translational):
    """Slide along `axis` without rotation: the same joint as `Translational`, under the name that robot
    models use.

    Attributes:
        axis: (3,) direction of the slide, world at the initial pose, of any nonzero length.
            Positive displacements move the second body along it.

    Examples:
        >>> Prismatic("rail", "ground", "cart", [0.0, 0.0, 0.0], axis=[0.0, 3.0, 4.0]).axis.tolist()
        [0.0, 0.6, 0.8]
    """

    kind: ClassVar[str] = "prismatic"


@description
class Screw(Cylindrical):
    """Screw joint (nut on a spindle): the displacement is the pitch times the angle; five equations.

    The coordinates are the displacement along the axis, then the angle about it. Both are coupled: four
    equations are those of `Cylindrical`, and the fifth is displacement - pitch * angle = 0.

    Attributes:
        axis: (3,) axis of the spindle, world at the initial pose, of any nonzero length.
            Positive coordinates move the second body along it, and turn it by the right-hand rule.
        pitch: meters per radian; positive for a right-handed thread.

    Examples:
        >>> nut = Screw("nut", "ground", "body", [0.0, 0.0, 0.0], axis=[0.0, 0.0, 1.0], pitch=0.002)
        >>> f"{1e3 * nut.pitch * 2.0 * np.pi:.2f} mm per revolution"
        '12.57 mm per revolution'
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
    """Planar joint: a plane face of one body slides on a plane face of the other; three equations.

    The coordinates are the displacements along two directions perpendicular to the axis, which are fixed in
    the first body, then the angle about the axis s. Let h be the coordinate axis (x, y or z) along which the
    component of s has the smallest absolute value, the first of equal ones. The second direction is
    w = s x h / |s x h|, the first is w x s.

    Attributes:
        axis: (3,) normal of both faces, world at the initial pose, of any nonzero length.

    Examples:
        >>> Planar("joint", "ground", "body", [0.0, 0.0, 0.0], axis=[0.0, 0.0, 1.0]).coordinate_kinds
        ('slide', 'slide', 'hinge')
    """

    kind: ClassVar[str] = "planar"

    def rebuilt(self, values: Mapping[str, Any]) -> Self:
        """Construct the joint again with other numbers, see `Joint.rebuilt`.

        Raises:
            MechanismError: also for an axis so far from the described one that the slide directions would
                jump.
        """
        changed = super().rebuilt(values)
        continuous_pair = perpendicular_pair(changed.axis, described=self.axis)
        if not np.array_equal(continuous_pair, changed.pair):
            problem = f"axis is {changed.axis.tolist()}, where the slides of the plane jump"
            raise MechanismError(f"joint {quoted(self.name)}", problem, "an axis nearer to the described one")
        return changed

    @property
    def motions(self) -> tuple[Motion, ...]:
        slides = (Motion("slide", a) for a in self.pair)
        return (*slides, Motion("hinge", self.axis))

    def constraints(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        parallel = self._parallel(self.axis, self.pair, first, second)
        return (*parallel, self._displacement(self.axis, offset=0.0, first=first, second=second))


@description
class PointOnLine(AxisJoint):
    """Point of the second body on a line of the first body, along `axis`: two equations.

    The second body may rotate freely. The coordinate is the displacement along the line.

    Attributes:
        axis: (3,) direction of the line, fixed in the first body, world at the initial pose, of any nonzero
            length.

    Examples:
        >>> PointOnLine("joint", "ground", "body", [0.0, 0.0, 0.0], axis=[0.0, 0.0, 1.0]).coordinate_kinds
        ('slide',)
    """

    kind: ClassVar[str] = "point_on_line"
    motion_kinds = ("slide",)

    @property
    def motions(self) -> tuple[Motion, ...]:
        return (*super().motions, BALL_MOTION)

    def constraints(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        return self._on_line(self.pair, first, second)


@description
class Rod(Joint):
    """Massless rod with ball joints at both ends: one equation, a constant distance of `point` and
    `point_on_second`.

    Its reaction is a force along the rod; tension pulls the second body towards the first. A rod has no
    coordinates, so that it can only close a loop of a spanning tree.

    Attributes:
        point, point_on_second: (3,) m, ends of the rod in the first and second body, world at the initial
            pose.

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
        """Raise `MechanismError` for a length, m, that is too small or not finite."""
        if not MIN_POINT_DISTANCE <= length < math.inf:
            problem = f"its two points are {length:.3g} m apart"
            needed = f"point_on_second at least {MIN_POINT_DISTANCE:g} m from point, a ball joint otherwise"
            raise MechanismError(f"joint {quoted(self.name)}", problem, needed)

    @cached_property
    def length(self) -> float:
        """Length of the rod, m: the distance of its points when it was constructed. Copies by `varied` keep
        the length, whatever their points."""
        return math.dist(self.point_on_second, self.point)

    def varied(self, values: Mapping[str, Any]) -> Self:
        # The copy stores the length, which it would else compute from its own points
        return super().varied({"length": self.length, **values})

    def rebuilt(self, values: Mapping[str, Any]) -> Self:
        others = {name: value for name, value in values.items() if name != "length"}
        changed, ends = super().rebuilt(others), self.point_on_second - self.point
        if "length" not in values:
            return changed
        # Another length moves the second body's point along the rod
        self._check(float(values["length"]))
        ends = ends * (float(values["length"]) / self.length)
        return replace(changed, point_on_second=changed.point + ends)

    def constraints(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        s_i, s_j = first.point_to_body(self.point), second.point_to_body(self.point_on_second)
        return (Distance(s_i, s_j, self.length),)


@description
class Fixed(Joint):
    """Weld: no relative motion; six equations.

    Examples:
        >>> Fixed("joint", "ground", "body", [0.0, 0.0, 0.0]).coordinate_kinds
        ()
    """

    kind: ClassVar[str] = "fixed"

    def constraints(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        return (*self._coincident(first, second), *self._aligned(first, second))


@description
class Free(Joint):
    """Free joint: all relative motions and no equation. It marks a body that floats on purpose.

    The coordinates are the displacements along x, y and z of the world at the initial pose, fixed in the
    first body. An initial state gives the body its orientation and its angular velocity, see `State`.

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
"""Joint classes by the name of the kind in scene files."""
