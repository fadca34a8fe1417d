"""Several slides, then several hinges or a ball: what robot models put between two bodies at once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field, replace
from typing import Any, ClassVar, Self

import numpy as np

from newton_euler.errors import MechanismError, check_flag, finite_array, quoted
from newton_euler.model.constraints import Constraint, Displacement, Perpendicular
from newton_euler.model.description import ArrayField, DefaultArrayField, description
from newton_euler.model.fields import NumberField
from newton_euler.model.hinge_angles import (
    ClosedRow,
    HingeAngle,
    HingeRow,
    RowDisplacement,
    RowSlide,
    Separation,
    dual_axes,
)
from newton_euler.model.joint import BALL_MOTION, POINTS, Joint, Motion, Pose, perpendicular_pair, unit_vector
from newton_euler.scalars import Array, cross, sqrt

INDEPENDENT = 1e-3  # least volume (area, length) that the unit axes of independent slides or hinges span


@description
class Compound(Joint):
    """Slides along axes of the first body, then hinges in a row.

    The axes need not be perpendicular, nor meet: the first hinge's passes through `point`, the last one's
    through `point_on_second`, and what is between them has no mass. Its coordinates are the displacements
    along the slides, which add up as vectors, then the angles of the hinges; see
    `newton_euler.model.hinge_angles` for their limits.

    Attributes:
        slides: (n, 3) axes, n <= 3, world at the initial pose.
        hinges: (m, 3) axes, m <= 3, in their order from the first body to the second.
        offsets: (m - 1, 3) from the axis of each hinge to that of the next, m, world at the initial pose; 0
            where all pass through the point. By their sum `point_on_second` is beyond `point`.
        ball: a ball joint instead of hinges.

    Raises:
        MechanismError: also for axes that are not independent.

    Examples:
        >>> axes = np.eye(3)
        >>> joint = Compound("joint", "ground", "body", [0.0, 0.0, 0.0], slides=axes[:1], hinges=axes[1:])
        >>> joint.coordinate_kinds
        ('slide', 'hinge', 'hinge')
    """

    slides: ArrayField = field(default=(), kw_only=True)  # type: ignore[assignment]
    hinges: ArrayField = field(default=(), kw_only=True)  # type: ignore[assignment]
    offsets: DefaultArrayField = field(default=None, kw_only=True)  # type: ignore[assignment]
    ball: bool = field(default=False, kw_only=True)
    kind: ClassVar[str] = "compound"
    number_fields: ClassVar = Joint.number_fields | {
        "axis": NumberField(shape=None, allowed="joint", moves_loops=True),
        "offsets": NumberField("m", shape=None, moves_loops=True),
    }
    vector_names: ClassVar[tuple[str, ...]] = ("slides", "hinges", "offsets")

    def __post_init__(self) -> None:
        beyond = self.point_on_second
        super().__post_init__()
        where = f"joint {quoted(self.name)}"
        for name in ("slides", "hinges"):
            try:
                given = [unit_vector(self.name, name, axis) for axis in getattr(self, name)]
            except TypeError as error:
                raise MechanismError(where, f"{name} is {quoted(getattr(self, name))}", "axes") from error
            axes = np.array(given).reshape(-1, 3)
            gram = np.sqrt(max(0.0, np.linalg.det(axes @ axes.T))) if len(axes) <= 3 else 0.0
            if gram < INDEPENDENT:
                problem = f"its {name} {axes.tolist()} depend on each other"
                raise MechanismError(where, problem, "at most three axes, not in one plane or line")
            axes.flags.writeable = False
            object.__setattr__(self, name, axes)
        check_flag(where, self, "ball")
        if self.ball and len(self.hinges):
            raise MechanismError(where, "has a ball and hinges", "one or the other")
        needed = max(len(self.hinges) - 1, 0)
        stated = np.zeros((needed, 3)) if self.offsets is None else self.offsets
        try:
            vectors = [finite_array(where, "offsets", each, (3,)) for each in stated]
        except TypeError as error:
            raise MechanismError(where, f"offsets is {quoted(self.offsets)}", "vectors") from error
        if len(vectors) != needed:
            problem = f"has {len(vectors)} offsets between {len(self.hinges)} hinges"
            raise MechanismError(where, problem, f"{needed} of them, or none")
        offsets = np.reshape(vectors, (-1, 3))
        offsets.flags.writeable = False
        object.__setattr__(self, "offsets", offsets)
        if beyond is None:
            object.__setattr__(self, "point_on_second", self.point + offsets.sum(axis=0))

    @property
    def variables(self) -> tuple[str, ...]:
        count = len(self.slides) + len(self.hinges)
        axes = (f"{k}.axis" if k else "axis" for k in range(count))
        return (*POINTS, *axes, *(("offsets",) if len(self.offsets) else ()))

    def field_of(self, name: str) -> NumberField:
        return super().field_of(name.rpartition(".")[2])  # "1.axis" is the axis of coordinate 1

    def number(self, name: str) -> Array:
        if name.endswith("axis"):
            return np.array([*self.slides, *self.hinges][_number(name)])
        return super().number(name)

    def varied(self, values: Mapping[str, Any]) -> Self:
        """See `Joint.varied`; axes and offsets are those at the initial pose, which stays closed."""
        rows = [*self.slides, *self.hinges]
        for name, axis in values.items():
            if name.endswith("axis"):
                rows[_number(name)] = axis / sqrt(axis @ axis)
        slides, hinges = rows[: len(self.slides)], rows[len(self.slides) :]
        offsets = np.asarray(values.get("offsets", self.offsets))
        changed = super().varied({name: value for name, value in values.items() if name in POINTS})
        moved = np.zeros(3)
        if slides:
            own, other = self.slides, np.array(slides)
            along = dual_axes(own) @ (self.span - self.offsets.sum(axis=0))
            moved = along @ (other - own) if np.any(along) else moved
            object.__setattr__(changed, "slides", other)
        if hinges:
            object.__setattr__(changed, "hinges", np.array(hinges))
        if "offsets" in values:
            moved = moved + (offsets - self.offsets).sum(axis=0)
            object.__setattr__(changed, "offsets", offsets)
        if np.any(moved):
            object.__setattr__(changed, "point_on_second", changed.point_on_second + moved)
            object.__setattr__(changed, "_span", self.span + moved)
        return changed

    def rebuilt(self, values: Mapping[str, Any]) -> Self:
        for name, axis in values.items():
            if name.endswith("axis"):
                unit_vector(self.name, name, axis)
        changed = self.varied(values)
        if _is_right_handed(changed.hinges) != _is_right_handed(self.described.hinges):
            problem = f"hinges are {changed.hinges.tolist()}, where the angle of the second one jumps"
            raise MechanismError(f"joint {quoted(self.name)}", problem, "axes nearer to the described ones")
        fields: dict[str, Any] = {name: getattr(changed, name) for name in ("slides", "hinges", "offsets")}
        return replace(self, point=changed.point, point_on_second=changed.point_on_second, **fields)

    @property
    def has_offsets(self) -> bool:
        """True if axes of hinges need not meet."""
        return self.offsets.dtype == object or bool(np.any(self.offsets))

    @property
    def motions(self) -> tuple[Motion, ...]:
        slides = (Motion("slide", axis) for axis in self.slides)
        hinges = (Motion("hinge", axis) for axis in self.hinges)
        return (*slides, *hinges, *((BALL_MOTION,) if self.ball else ()))

    @property
    def motion_points(self) -> tuple[Array, ...]:
        last = self.reaction_point
        hinges = [last - self.offsets[k:].sum(axis=0) for k in range(len(self.hinges))]
        return (*[hinges[0] if hinges else last] * len(self.slides), *hinges, *[last] * self.ball)

    def constraints(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        return (*self._placed(first, second), *self._oriented(first, second))

    def _placed(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        """Return the equations of a common point that the slides leave."""
        normals: tuple[Array, ...] = ()
        match len(self.slides):
            case 0 if self.has_offsets:
                return (ClosedRow(self._separation(first, second)),)
            case 0:
                return self._coincident(first, second)
            case 1:
                normals = perpendicular_pair(self.slides[0], self.described.slides[0])
            case 2:
                normal = cross(*self.slides)
                normals = (normal / np.linalg.norm(normal),)
        return tuple(self._displacement(normal, 0.0, first, second) for normal in normals)

    def _oriented(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        """Return the equations of a common orientation that the hinges leave."""
        if self.ball or len(self.hinges) == 3:
            return ()
        if len(self.hinges) == 2:
            a, b = self.hinges
            ends = first.vector_to_body(a), second.vector_to_body(b)
            return (Perpendicular(*ends, cosine=_scalar(a @ b)),)
        if len(self.hinges) == 1:
            axis = self.hinges[0]
            pair = perpendicular_pair(axis, self.described.hinges[0])
            return self._parallel(axis, pair, first, second)
        return self._aligned(first, second)

    def coordinates(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        beyond = self.span - self.offsets.sum(axis=0)
        slides = []
        for dual in dual_axes(self.slides):
            slide = self._displacement(dual, _scalar(dual @ beyond), first, second)
            if isinstance(slide, RowDisplacement):
                slide = RowSlide(slide.a_first, slide.separation, slide.offset)
            slides.append(slide)
        return (*slides, *self._angles(first, second))

    def _displacement(
        self, axis: Array, offset: float, first: Pose, second: Pose
    ) -> Displacement | RowDisplacement:
        """Compute the second body's displacement along an axis of the first, less an offset, m."""
        a = first.vector_to_body(axis)
        if self.has_offsets:
            return RowDisplacement(a, self._separation(first, second), offset)
        ends = first.point_to_body(self.point), second.point_to_body(self.reaction_point)
        return Displacement(a, *ends, offset=offset)

    def _separation(self, first: Pose, second: Pose) -> Separation:
        offsets = []
        for offset, a, b in zip(self.offsets, self.hinges[:-1], self.hinges[1:], strict=True):
            link = np.stack([a, b, cross(a, b)])
            generic = object in (link.dtype, offset.dtype)
            offsets.append(dual_axes(link) @ offset if generic else np.linalg.solve(link.T, offset))
        ends = first.point_to_body(self.point), second.point_to_body(self.reaction_point)
        return Separation(self._row(first, second), *ends, np.array(offsets))

    def _angles(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        axes = self.hinges
        if len(axes) == 0:
            return ()
        if len(axes) == 1:
            pair = perpendicular_pair(axes[0], self.described.hinges[0])
            return (self._turn(axes[0], pair[0], first, second),)
        row = self._row(first, second)
        return tuple(HingeAngle(k, row) for k in range(len(axes)))

    def _row(self, first: Pose, second: Pose) -> HingeRow:
        axes = self.hinges
        ends = (
            first.vector_to_body(axes[0]),
            first.vector_to_body(axes[1]),
            second.vector_to_body(axes[-1]),
            second.vector_to_body(axes[-2]),
        )
        if len(axes) == 2:
            return HingeRow(*ends)
        a, b, c = axes
        cosines = _scalar(a @ b), _scalar(b @ c)
        sine, cosine = _scalar(b @ cross(a, c)), _scalar(a @ c) - cosines[0] * cosines[1]
        side = 1.0 if _is_right_handed(self.described.hinges) else -1.0
        return HingeRow(*ends, cosines, sine, cosine, side)


def _is_right_handed(hinges: Array) -> bool:
    """Tell on which side of the axes of the first and the last of three hinges that of the second is."""
    if len(hinges) < 3:
        return True
    a, b, c = hinges
    return bool(b @ cross(a, c) >= 0.0)


def _scalar(value: Any) -> Any:
    """Return a float instead of one of NumPy, and generic scalars as they are."""
    return float(value) if isinstance(value, float) else value


def _number(name: str) -> int:
    """Return which of the axes a parameter is."""
    return int(name.partition(".")[0]) if name != "axis" else 0
