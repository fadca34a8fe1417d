"""Compound joint: up to three slides, then up to three hinges or a ball, between two bodies.

MJCF and URDF files often have several elementary motions between two bodies. `newton_euler.model.joint_parts`
combines them to this class if no special joint class fits. The angles of the hinges are those of
`newton_euler.model.hinge_angles`.
"""

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

MIN_SPANNED_VOLUME = 1e-3
"""Smallest volume (area for two axes) that the unit axes of the slides, or of the hinges, must span. Axes
that span less are nearly linearly dependent. Two axes span the sine of their angle: 1e-3 is 0.06 degrees."""


@description
class Compound(Joint):
    """Slides along axes of the first body, then hinges in a row or a ball.

    The axes need not be perpendicular and need not meet. The axis of the first hinge passes through `point`,
    the axis of the last hinge through `point_on_second`; the links between the hinges have no mass. The
    coordinates are the displacements along the slides, which add up as vectors, then the angles of the
    hinges. With three hinges the angles are singular where all axes lie in one plane (gimbal lock).

    Attributes:
        slides: (n, 3) axes of the n slides, n at most 3, fixed in the first body, world at the initial pose.
        hinges: (m, 3) axes of the m hinges, m at most 3, in order from the first body to the second, world at
            the initial pose.
        offsets: (m - 1, 3) m, from a point on the axis of each hinge to a point on the axis of the next
            hinge, world at the initial pose, such as [[0, 0, 0.1]] for two hinges 0.1 m apart. Zeros (the
            default) if all axes pass through `point`. `point_on_second` is `point` plus all offsets unless it
            is given.
        ball: True for a ball instead of hinges.

    Raises:
        MechanismError: naming the joint and the invalid value, such as axes that are linearly dependent.

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
    # "axis" declares each axis, whose parameters are named "axis", "1.axis", "2.axis", ... (see `variables`).
    # `allowed`: the constructor checks new values; `moves_loops`: they move the poses in which loops close
    number_fields: ClassVar = Joint.number_fields | {
        "axis": NumberField(shape=None, allowed="constructor", moves_loops=True),
        "offsets": NumberField("m", shape=None, moves_loops=True),
    }
    vector_names: ClassVar[tuple[str, ...]] = ("slides", "hinges", "offsets")

    def __post_init__(self) -> None:
        given_point = self.point_on_second
        super().__post_init__()
        where = f"joint {quoted(self.name)}"

        # Convert the axes to unit vectors, and check that they are independent
        for name in ("slides", "hinges"):
            try:
                given = [unit_vector(self.name, name, axis) for axis in getattr(self, name)]
            except TypeError as error:
                raise MechanismError(where, f"{name} is {quoted(getattr(self, name))}", "axes") from error
            axes = np.array(given).reshape(-1, 3)
            # the volume is the root of the Gram determinant
            volume = np.sqrt(max(0.0, np.linalg.det(axes @ axes.T))) if len(axes) <= 3 else 0.0
            if volume < MIN_SPANNED_VOLUME:
                problem = f"its {name} {axes.tolist()} depend on each other"
                raise MechanismError(where, problem, "at most three axes, not in one plane or line")
            axes.flags.writeable = False
            object.__setattr__(self, name, axes)
        check_flag(where, self, "ball")
        if self.ball and len(self.hinges):
            raise MechanismError(where, "has a ball and hinges", "one or the other")

        # Check the offsets, one between each two neighboring hinges
        needed = max(len(self.hinges) - 1, 0)
        given_offsets = np.zeros((needed, 3)) if self.offsets is None else self.offsets
        try:
            vectors = [finite_array(where, "offsets", each, (3,)) for each in given_offsets]
        except TypeError as error:
            raise MechanismError(where, f"offsets is {quoted(self.offsets)}", "vectors") from error
        if len(vectors) != needed:
            problem = f"has {len(vectors)} offsets between {len(self.hinges)} hinges"
            raise MechanismError(where, problem, f"{needed} of them, or none")
        offsets = np.reshape(vectors, (-1, 3))
        offsets.flags.writeable = False
        object.__setattr__(self, "offsets", offsets)
        if given_point is None:
            object.__setattr__(self, "point_on_second", self.point + offsets.sum(axis=0))

    @property
    def variables(self) -> tuple[str, ...]:
        """Names of the numbers that may vary: joint points, "axis", "1.axis", ... of the slides and hinges in
        order, and "offsets"."""
        count = len(self.slides) + len(self.hinges)
        axes = (f"{k}.axis" if k else "axis" for k in range(count))
        return (*POINTS, *axes, *(("offsets",) if len(self.offsets) else ()))

    def field_of(self, name: str) -> NumberField:
        return super().field_of(name.rpartition(".")[2])  # "axis" for "1.axis", the axis of coordinate 1

    def number(self, name: str) -> Array:
        if name.endswith("axis"):
            return np.array([*self.slides, *self.hinges][_axis_index(name)])
        return super().number(name)

    def varied(self, values: Mapping[str, Any]) -> Self:
        """Copy the joint with other, unchecked numbers, see `Joint.varied`.

        Axes and offsets are those at the initial pose. The second body's point moves with them, so that the
        joint stays closed there.
        """
        # The new axes, of unit length
        axes = [*self.slides, *self.hinges]
        for name, axis in values.items():
            if name.endswith("axis"):
                axes[_axis_index(name)] = axis / sqrt(axis @ axis)
        slides, hinges = axes[: len(self.slides)], axes[len(self.slides) :]
        offsets = np.asarray(values.get("offsets", self.offsets))
        changed = super().varied({name: value for name, value in values.items() if name in POINTS})

        # Shift of the second body's point. The slides keep their displacements at the initial pose along new
        # axes, and new offsets move the axis of the last hinge. `span` leads from the first body's point to
        # the second body's point where the coordinates are zero
        shift = np.zeros(3)
        if slides:
            new_slides = np.array(slides)
            displacements = dual_axes(self.slides) @ (self.span - self.offsets.sum(axis=0))
            shift = displacements @ (new_slides - self.slides) if np.any(displacements) else shift
            object.__setattr__(changed, "slides", new_slides)
        if hinges:
            object.__setattr__(changed, "hinges", np.array(hinges))
        if "offsets" in values:
            shift = shift + (offsets - self.offsets).sum(axis=0)
            object.__setattr__(changed, "offsets", offsets)
        if np.any(shift):
            object.__setattr__(changed, "point_on_second", changed.point_on_second + shift)
            object.__setattr__(changed, "_span", self.span + shift)
        return changed

    def rebuilt(self, values: Mapping[str, Any]) -> Self:
        for name, axis in values.items():
            if name.endswith("axis"):
                unit_vector(self.name, name, axis)  # raises an error for an invalid axis
        changed = self.varied(values)
        # The angle of the second of three hinges jumps where its axis passes through the plane of the others.
        # `described` is the joint as the user gave it, before any `varied`
        if _is_on_positive_side(changed.hinges) != _is_on_positive_side(self.described.hinges):
            problem = f"hinges are {changed.hinges.tolist()}, where the angle of the second one jumps"
            raise MechanismError(f"joint {quoted(self.name)}", problem, "axes nearer to the described ones")
        fields: dict[str, Any] = {name: getattr(changed, name) for name in ("slides", "hinges", "offsets")}
        return replace(self, point=changed.point, point_on_second=changed.point_on_second, **fields)

    @property
    def has_offsets(self) -> bool:
        """True if the hinge axes do not all meet in one point, or if the offsets are symbols."""
        return self.offsets.dtype == object or bool(np.any(self.offsets))

    @property
    def motions(self) -> tuple[Motion, ...]:
        slides = (Motion("slide", axis) for axis in self.slides)
        hinges = (Motion("hinge", axis) for axis in self.hinges)
        return (*slides, *hinges, *((BALL_MOTION,) if self.ball else ()))

    @property
    def motion_points(self) -> tuple[Array, ...]:
        # The axis of the last hinge passes through `point_on_second`; offsets lead to the axes before it
        last = self.point_on_second
        on_hinges = [last - self.offsets[k:].sum(axis=0) for k in range(len(self.hinges))]
        on_slides = [on_hinges[0] if on_hinges else last] * len(self.slides)
        on_ball = [last] if self.ball else []
        return (*on_slides, *on_hinges, *on_ball)

    def constraints(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        return (*self._position_constraints(first, second), *self._orientation_constraints(first, second))

    def _position_constraints(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        """Return 3 - n equations for n slides: the second body's point has no displacement normal to the
        slides."""
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

    def _orientation_constraints(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        """Return 3 - m equations for m hinges, none for a ball: no relative rotation about other axes."""
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
        # Displacement of the slides where their coordinates are zero. A dual axis of the slides is
        # perpendicular to the other slides, so that it measures the displacement along one slide
        initial = self.span - self.offsets.sum(axis=0)
        slides = []
        for dual in dual_axes(self.slides):
            slide = self._displacement(dual, _scalar(dual @ initial), first, second)
            if isinstance(slide, RowDisplacement):
                slide = RowSlide(slide.a_first, slide.separation, slide.offset)
            slides.append(slide)
        return (*slides, *self._angles(first, second))

    def _displacement(
        self, axis: Array, offset: float, first: Pose, second: Pose
    ) -> Displacement | RowDisplacement:
        """Return the displacement of the second body's point along an axis of the first body, minus an
        offset, m.

        If the hinge axes do not meet, the displacement is that of a point on the first hinge axis instead,
        see `Separation`.
        """
        a = first.vector_to_body(axis)
        if self.has_offsets:
            return RowDisplacement(a, self._separation(first, second), offset)
        ends = first.point_to_body(self.point), second.point_to_body(self.point_on_second)
        return Displacement(a, *ends, offset=offset)

    def _separation(self, first: Pose, second: Pose) -> Separation:
        """Return the separation D of the row of hinges, see `newton_euler.model.hinge_angles`."""
        # Components u, v, w of each offset along the axes a and b of its hinges and along a x b. NumPy does
        # not solve equations in symbols
        offsets = []
        for offset, a, b in zip(self.offsets, self.hinges[:-1], self.hinges[1:], strict=True):
            link = np.stack([a, b, cross(a, b)])
            generic = object in (link.dtype, offset.dtype)
            offsets.append(dual_axes(link) @ offset if generic else np.linalg.solve(link.T, offset))
        ends = first.point_to_body(self.point), second.point_to_body(self.point_on_second)
        return Separation(self._row(first, second), *ends, np.array(offsets))

    def _angles(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        """Return the coordinates of the hinges."""
        axes = self.hinges
        if len(axes) == 0:
            return ()
        if len(axes) == 1:
            pair = perpendicular_pair(axes[0], self.described.hinges[0])
            return (self._hinge_coordinate(axes[0], pair[0], first, second),)
        row = self._row(first, second)
        return tuple(HingeAngle(k, row) for k in range(len(axes)))

    def _row(self, first: Pose, second: Pose) -> HingeRow:
        """Return the row of two or three hinges between bodies with these poses at the initial pose."""
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
        return HingeRow(
            *ends,
            cosines=cosines,
            sine=_scalar(b @ cross(a, c)),
            cosine=_scalar(a @ c) - cosines[0] * cosines[1],
            side=1.0 if _is_on_positive_side(self.described.hinges) else -1.0,
        )


def _is_on_positive_side(hinges: Array) -> bool:
    """Return True if b . (a x c) >= 0 for three hinge axes a, b, c (3, 3), so that b is on the side of a x c
    of the plane of a and c; True for fewer axes."""
    if len(hinges) < 3:
        return True
    a, b, c = hinges
    return bool(b @ cross(a, c) >= 0.0)


def _scalar(value: Any) -> Any:
    """Convert a NumPy float to a Python float; return other scalars, such as symbols, unchanged."""
    return float(value) if isinstance(value, float) else value


def _axis_index(name: str) -> int:
    """Return the index of an axis among the slides and hinges from its parameter name: "axis", "1.axis",
    "2.axis"."""
    return int(name.partition(".")[0]) if name != "axis" else 0
