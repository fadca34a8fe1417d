"""Joint coordinates that control laws, springs and couplings act on.

A slide is measured from the poses of its two bodies. They determine an angle only within a
revolution; the number of revolutions follows from the integral of its rate, which is carried along in q
and starts within half a revolution.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from newton_euler.model.constraints import Constraint, Frame
from newton_euler.model.joint import JointEquations, Key
from newton_euler.scalars import Array, Scalar, arctan2, cos, sin


class Measured(NamedTuple):
    """A joint coordinate at a state, with d2x/dt2 = jacobian . accelerations - gamma."""

    x: Scalar
    """m or rad from the initial pose."""
    rate: Scalar
    jacobian: Any
    """A `Jacobian` between two bodies, blocks (1, 3); in joint coordinates the nonzeros of a row over v."""
    gamma: Scalar


@dataclass(frozen=True, eq=False)
class Coordinate:
    """A hinge or slide that is measured between two bodies.

    Attributes:
        first, second: the bodies.
        constraint: its residual is the coordinate.
        carried: where in q its angle is carried; None for a slide, and where its revolutions do not matter.
    """

    first: int
    second: int
    constraint: Constraint
    carried: int | None

    def measure(self, q: Array, frames: Sequence[Frame]) -> Measured:
        """Measure the coordinate where the bodies have these frames."""
        first, second = frames[self.first], frames[self.second]
        jacobian = self.constraint.jacobian(first, second)
        x = self.constraint.phi(first, second)[0]
        if self.carried is not None:
            past = x - q[self.carried]
            x = q[self.carried] + arctan2(sin(past), cos(past))
        rate = jacobian.rate(first, second)[0]
        return Measured(x, rate, jacobian, self.constraint.gamma(first, second)[0])


def coordinates(
    keys: dict[Key, JointEquations], size: int, counted: Collection[Key]
) -> dict[Key, Coordinate]:
    """Describe coordinates of joints; those of `counted` angles are carried from place `size` of q on."""
    found: dict[Key, Coordinate] = {}
    for key, equations in keys.items():
        constraint = equations.coordinates[key[1]]
        carried = None if constraint.is_length or key not in counted else size
        size += carried is not None
        found[key] = Coordinate(equations.first, equations.second, constraint, carried)
    return found


def _carried(
    measured: dict[Key, Coordinate], frames: Sequence[Frame]
) -> Iterator[tuple[Constraint, Frame, Frame]]:
    for each in measured.values():
        if each.carried is not None:
            yield each.constraint, frames[each.first], frames[each.second]


def carried_angles(measured: dict[Key, Coordinate], frames: Sequence[Frame]) -> Array:
    """Compute the carried angles within half a revolution, rad."""
    return np.array([angle.phi(*ends)[0] for angle, *ends in _carried(measured, frames)])


def carried_rates(measured: dict[Key, Coordinate], frames: Sequence[Frame]) -> Array:
    """Compute the rates of the carried angles, rad/s."""
    return np.array([angle.jacobian(*ends).rate(*ends)[0] for angle, *ends in _carried(measured, frames)])
