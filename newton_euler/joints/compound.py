"""Several slides, then several hinges or a ball: what robot models put between two bodies at once."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from newton_euler.constraints import Constraint, Displacement, Perpendicular
from newton_euler.errors import MechanismError
from newton_euler.hinge_angles import HingeAngle, dual_axes
from newton_euler.joints.base import Joint, Motion, Pose, perpendicular_pair, unit_vector
from newton_euler.scalars import Array, cross

INDEPENDENT = 1e-3
"""Least volume (area, length) that the unit axes of independent slides or hinges span."""


@dataclass(frozen=True, eq=False)
class Compound(Joint):
    """Slides along axes of the first body, then hinges in a row whose axes all pass through the point.

    The axes need not be perpendicular. Its coordinates are the displacements along the slides, which
    add up as vectors, then the angles of the hinges; see `newton_euler.hinge_angles` for their limits.

    Attributes:
        slides: (n, 3) axes, n <= 3, world at the initial pose.
        hinges: (m, 3) axes, m <= 3, in their order from the first body to the second.
        ball: a ball joint instead of hinges.

    Raises:
        MechanismError: also for axes that are not independent.
    """

    slides: Array = field(default_factory=lambda: np.zeros((0, 3)), kw_only=True)
    hinges: Array = field(default_factory=lambda: np.zeros((0, 3)), kw_only=True)
    ball: bool = field(default=False, kw_only=True)
    kind: ClassVar[str] = "compound"

    def __post_init__(self) -> None:
        super().__post_init__()
        where = f"joint {self.name!r}"
        for name in ("slides", "hinges"):
            try:
                given = [unit_vector(self.name, name, axis) for axis in getattr(self, name)]
            except TypeError as error:
                raise MechanismError(where, f"{name} is {getattr(self, name)!r:.100}", "axes") from error
            axes = np.array(given).reshape(-1, 3)
            gram = np.sqrt(max(0.0, np.linalg.det(axes @ axes.T))) if len(axes) <= 3 else 0.0
            if gram < INDEPENDENT:
                problem = f"its {name} {axes.tolist()} depend on each other"
                raise MechanismError(where, problem, "at most three axes, not in one plane or line")
            axes.flags.writeable = False
            object.__setattr__(self, name, axes)
        if not isinstance(self.ball, bool):
            raise MechanismError(where, f"ball is {self.ball!r:.100}", "a truth value")
        if self.ball and len(self.hinges):
            raise MechanismError(where, "has a ball and hinges", "one or the other")

    @property
    def motions(self) -> tuple[Motion, ...]:
        slides = (Motion("slide", axis) for axis in self.slides)
        hinges = (Motion("hinge", axis) for axis in self.hinges)
        return (*slides, *hinges, *((Motion("ball", np.zeros(3)),) if self.ball else ()))

    def constraints(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        return (*self._placed(first, second), *self._oriented(first, second))

    def _placed(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        """What the slides leave of the equations of a common point."""
        match len(self.slides):
            case 0:
                return self._coincident(first, second)
            case 1:
                return self._on_line(self.slides[0], first, second)
            case 2:
                normal = cross(*self.slides)
                return (self._across(normal / np.linalg.norm(normal), first, second),)
        return ()

    def _oriented(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        """What the hinges leave of the equations of a common orientation."""
        if self.ball or len(self.hinges) == 3:
            return ()
        if len(self.hinges) == 2:
            a, b = self.hinges
            ends = first.vector_to_body(a), second.vector_to_body(b)
            return (Perpendicular(*ends, cosine=float(a @ b)),)
        if len(self.hinges) == 1:
            return self._parallel(self.hinges[0], first, second)
        x, y, z = np.eye(3)
        return tuple(
            Perpendicular(first.vector_to_body(a), second.vector_to_body(b))
            for a, b in ((x, y), (y, z), (z, x))
        )

    def coordinates(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        slides = (self._displacement(dual, first, second) for dual in dual_axes(self.slides))
        return (*slides, *self._angles(first, second))

    def _displacement(self, dual: Array, first: Pose, second: Pose) -> Constraint:
        return Displacement(
            first.vector_to_body(dual),
            first.point_to_body(self.point),
            second.point_to_body(self.reaction_point),
            offset=float(dual @ (self.reaction_point - self.point)),
        )

    def _angles(self, first: Pose, second: Pose) -> tuple[Constraint, ...]:
        axes = self.hinges
        if len(axes) == 0:
            return ()
        if len(axes) == 1:
            return (self._turn(axes[0], perpendicular_pair(axes[0])[0], first, second),)
        ends = (
            first.vector_to_body(axes[0]),
            first.vector_to_body(axes[1]),
            second.vector_to_body(axes[-1]),
            second.vector_to_body(axes[-2]),
        )
        if len(axes) == 2:
            return tuple(HingeAngle(k, *ends) for k in range(2))
        a, b, c = axes
        cosines = float(a @ b), float(b @ c)
        between = float(b @ cross(a, c)), float(a @ c) - cosines[0] * cosines[1]
        return tuple(HingeAngle(k, *ends, cosines, *between) for k in range(3))
