"""Constraint rows that close the loops of the spanning tree, from Drake's kinematics.

With the anchors p1 and p2 of a loop in its first and second body:

- ball: Phi = p1 - p2 (3 rows);
- weld: Phi = p1 - p2, and the rotation vector from the first body to the second since the initial pose, in
  the frame of the first (6 rows);
- rod of length L: Phi = |p2 - p1| - L (1 row).

Multipliers lambda exert the generalized forces Phi_q^T lambda. Drake's own constraints of the same kinds
belong to its discrete solver alone, which has no equations of motion to compare.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from crosscheck.engines.drake.placed import PlacedPlant
from crosscheck.engines.drake.plant import Anchors
from newton_euler.model.balls import rotation_vector
from newton_euler.scalars import Array, tilde

ROWS = {"ball": 3, "weld": 6, "rod": 1}
"""Number of rows of each kind of loop."""


class Ends(NamedTuple):
    """Anchors of a loop at the present state, world frame.

    Attributes:
        line: (3,) m, from the anchor in the first body to that in the second.
        turn: (3, 3) rotation matrix of the first body since the initial pose.
        between: (3,) rad, rotation vector from the first body to the second, in the frame of the first.
    """

    line: Array
    turn: Array
    between: Array


class Closures:
    """Residuals, Jacobian, right side and wrenches of all loops.

    Attributes:
        units: (k,) divisors that make the rows dimensionless: `size`, m, for lengths, else 1.
    """

    def __init__(self, placed: PlacedPlant, size: float) -> None:
        self._placed, self._loops = placed, placed.built.anchors
        units = {"ball": [size] * 3, "weld": [size] * 3 + [1.0] * 3, "rod": [size]}
        self.units = np.concatenate([np.zeros(0), *(units[loop.kind] for loop in self._loops)])

    def _ends(self, loop: Anchors) -> Ends:
        """Evaluate the anchors of a loop."""
        (first, turn), (second, other) = self._placed.pose(loop.first), self._placed.pose(loop.second)
        between = rotation_vector(turn.T @ other) if loop.kind == "weld" else np.zeros(3)
        return Ends(second - first, turn, between)

    def _rows(self, loop: Anchors, ends: Ends, of_frame: Callable[[object], Array]) -> Array:
        """Return the rows of a loop for twists (6, ...) of its frames: the rate of Phi, or Phi_q."""
        apart = of_frame(loop.second) - of_frame(loop.first)
        if loop.kind == "rod":
            return np.asarray((ends.line / np.linalg.norm(ends.line)) @ apart[:3])[None]
        rows = [-apart[:3]]
        if loop.kind == "weld":
            rows.append(_turn_rate(ends) @ apart[3:])
        return np.concatenate(rows)

    def phi(self) -> Array:
        """Compute the residuals (k,), m or rad."""
        rows = [np.zeros(0)]
        for loop in self._loops:
            ends = self._ends(loop)
            if loop.kind == "rod":
                rows.append(np.array([np.linalg.norm(ends.line) - loop.length]))
            else:
                rows += [-ends.line, ends.between] if loop.kind == "weld" else [-ends.line]
        return np.concatenate(rows)

    def jacobian(self, nv: int) -> Array:
        """Compute the Jacobian (k, nv)."""
        rows = (self._rows(loop, self._ends(loop), self._placed.jacobian) for loop in self._loops)
        return np.concatenate([np.zeros((0, nv)), *rows])

    def gamma(self) -> Array:
        """Compute gamma (k,) of Phi_q dv/dt = gamma, for loops that are closed."""
        rows = [np.zeros(0)]
        for loop in self._loops:
            ends = self._ends(loop)
            row = -self._rows(loop, ends, self._placed.bias)
            if loop.kind == "rod":
                length = float(np.linalg.norm(ends.line))
                rate = (self._placed.velocity(loop.second) - self._placed.velocity(loop.first))[:3]
                row -= (rate @ rate - (ends.line @ rate / length) ** 2) / length
            rows.append(row)
        return np.concatenate(rows)

    def wrenches(self, multipliers: Array) -> Iterator[tuple[Anchors, Array]]:
        """Yield each loop with its wrench (6,) on the second body, about the anchor there, world frame.

        Args:
            multipliers: (k,) Lagrange multipliers.
        """
        row = 0
        for loop in self._loops:
            part, wrench, ends = multipliers[row : row + ROWS[loop.kind]], np.zeros(6), self._ends(loop)
            row += len(part)
            if loop.kind == "rod":
                wrench[:3] = part[0] * ends.line / np.linalg.norm(ends.line)
            else:
                wrench[:3] = -part[:3]
            if loop.kind == "weld":
                wrench[3:] = _turn_rate(ends).T @ part[3:]
            yield loop, wrench


def _turn_rate(ends: Ends) -> Array:
    """Return the derivative (3, 3) of the rotation vector with respect to the relative angular velocity.

    The angular velocity is that of the second body relative to the first, world frame. The matrix is the
    inverse of the left Jacobian of the rotation group.
    """
    angle, cross = float(np.linalg.norm(ends.between)), tilde(ends.between)
    # the limit of the factor for small angles is 1/12; its series has an error of angle^2 / 720
    factor = 1.0 / 12.0 if angle < 1e-4 else (1.0 - 0.5 * angle / np.tan(0.5 * angle)) / angle**2
    return np.asarray((np.eye(3) - 0.5 * cross + factor * cross @ cross) @ ends.turn.T)
