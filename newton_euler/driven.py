"""Joint coordinates that control laws measure, for formulations that do not have them as their own.

A slide is measured from the poses of its two bodies. An angle cannot be: poses are the same after a
full turn. It is carried along in q, as the integral of its rate, and starts within half a turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from newton_euler.constraints import Constraint, Frame, Jacobian
from newton_euler.control import Law
from newton_euler.joints import JointEquations
from newton_euler.scalars import Array, Scalar


@dataclass(frozen=True, eq=False)
class Driven:
    """What one control law drives.

    Attributes:
        law: the control law.
        equations: of its joint.
        carried: where in q its angle is carried; None for a slide.
    """

    law: Law
    equations: JointEquations
    carried: int | None

    @property
    def coordinate(self) -> Constraint:
        return self.equations.coordinates[self.law.coordinate]

    @property
    def bodies(self) -> tuple[int, int]:
        return self.equations.first, self.equations.second

    def measure(self, q: Array, first: Frame, second: Frame) -> tuple[Scalar, Scalar, Jacobian]:
        """The coordinate (m or rad), its rate, and the Jacobian through which a force on it acts."""
        jacobian = self.coordinate.jacobian(first, second)
        x = self.coordinate.phi(first, second)[0] if self.carried is None else q[self.carried]
        return x, jacobian.rate(first, second)[0], jacobian


def driven(laws: list[tuple[Law, JointEquations]], size: int) -> tuple[Driven, ...]:
    """What these laws drive; angles are carried from place `size` of q on."""
    found: list[Driven] = []
    for law, equations in laws:
        turns = not equations.coordinates[law.coordinate].is_length
        carried = sum(d.carried is not None for d in found)
        found.append(Driven(law, equations, size + carried if turns else None))
    return tuple(found)


def carried_angles(driven: tuple[Driven, ...], frames: Sequence[Frame]) -> Array:
    """The carried angles within half a turn, rad."""
    angles = [d.coordinate.phi(*(frames[k] for k in d.bodies)) for d in driven if d.carried is not None]
    return np.concatenate([np.zeros(0), *angles])


def carried_rates(driven: tuple[Driven, ...], frames: Sequence[Frame]) -> Array:
    """Rates of the carried angles, rad/s."""
    rates = [np.zeros(0)]
    for drive in driven:
        if drive.carried is not None:
            first, second = (frames[body] for body in drive.bodies)
            rates.append(drive.coordinate.jacobian(first, second).rate(first, second))
    return np.concatenate(rates)
