"""Assembly of a model file's loops: closed as well as the file's digits allow.

A file rounds its numbers, so that constraints that are redundant by design contradict each other slightly.
The independent constraints are closed to round-off. The residual of the others is an offset that the loops
keep. All quantities are dimensionless, as in the decision on redundant constraints
(`newton_euler.equations.redundancy`): velocities in spreads of the mechanism and rad, the residual of a loop
in units of the largest motion that one of these velocities gives to its bodies.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from newton_euler.equations.dense import largest, singular_values
from newton_euler.equations.independence import independent
from newton_euler.equations.redundancy import loosely_closed
from newton_euler.equations.sparse import sparse_vector
from newton_euler.model.mechanism import CLOSURE_TOLERANCE
from newton_euler.model.scene import REDUNDANCY_TOLERANCE
from newton_euler.model.source_file import SourceError
from newton_euler.scalars import Array

MAX_CLOSED_RESIDUAL = 1e-12
"""Dimensionless residual of loops that need no assembly: the file's round-off."""

MAX_CLOSING_STEPS = 60
"""Number of Newton's steps."""

MAX_STEP_LENGTH = 0.2
"""Longest step, rad or spreads of the mechanism, so that the mechanism stays on its branch."""


class Units(NamedTuple):
    """Units of the equations of a file's loops."""

    velocities: Array
    """(nv,) spread of the mechanism, m, for slides and free translations, 1 for rotations."""
    rows: Array
    """(k,) m or rad: `reach` of a loop, length of the dimensionless row for a coupling."""

    def jacobian(self, jacobian: Array) -> Array:
        """Divide a Jacobian (k, nv) by the units."""
        return np.asarray(jacobian * self.velocities / self.rows[:, None])


class Closure(NamedTuple):
    """A configuration in which the loops of a file are closed as well as they can be."""

    q: Array
    residuals: Array
    """(k,) m or rad."""
    noise: float
    """Largest residual, dimensionless."""
    independent: float
    """Largest residual of the independent constraints, dimensionless."""
    tolerance: float
    """Dimensionless size below which constraints were taken as redundant."""

    @property
    def is_closed(self) -> bool:
        """True if rounding of the file explains the residuals."""
        # rounding may exceed a tight tolerance: no motion removes these residuals
        loose = loosely_closed(max(self.tolerance, REDUNDANCY_TOLERANCE))
        return self.independent <= CLOSURE_TOLERANCE and self.noise <= loose

    @property
    def offset(self) -> float:
        """The largest residual, m or rad."""
        return largest(self.residuals)


def close(
    q: Array,
    evaluate: Callable[[Array], tuple[Array, Array]],
    move: Callable[[Array, Array], Array],
    units: Units,
    tolerance: float,
) -> Closure:
    """Close loops near a configuration by Newton's steps of least length.

    Args:
        q: configuration to start from.
        evaluate: computes residuals (k,), m or rad, and their Jacobian (k, nv) at a configuration.
        move: moves a configuration by a step (nv,).
        units: of residuals and steps.
        tolerance: of the scene, see `newton_euler.Scene.redundancy_tolerance`.
    """
    best: Closure | None = None
    for _ in range(MAX_CLOSING_STEPS + 1):
        # residuals of all constraints, and of the independent ones alone
        phi, jacobian = evaluate(q)
        scaled, matrix = phi / units.rows, units.jacobian(jacobian)
        rank = len(independent([sparse_vector(row) for row in matrix], tolerance).rows)
        u, s, vt = singular_values(matrix)
        shares = u[:, :rank].T @ scaled
        found = Closure(q, phi, largest(scaled), largest(u[:, :rank] @ shares), tolerance)
        if best is None or found.independent < best.independent:
            best = found
        elif best.independent < CLOSURE_TOLERANCE:
            break
        # shortest step that closes the independent constraints in first order
        step = vt[:rank].T @ (shares / s[:rank])
        step *= min(1.0, MAX_STEP_LENGTH / max(largest(step), 1e-300))
        q = move(q, -units.velocities * step)
    assert best is not None
    return best


def reach(motions: Sequence[Array], levers: Sequence[float], velocities: Array) -> tuple[float, float]:
    """Compute the largest motion, m and rad, that one velocity gives to a closure between two bodies.

    The bodies count separately. If their motions cancel, the row of the loop is therefore small: noise. See
    `newton_euler.equations.kinematics.TreeKinematics.row_scales`.

    Args:
        motions: (6, nv) for each body: velocity of its center of mass, and angular velocity.
        levers: m, distances of the two centers of mass from the point of the closure.
        velocities: (nv,) units of velocities.
    """
    rotations, moves = np.zeros(len(velocities)), np.zeros(len(velocities))
    first, second = (np.any(motion != 0.0, axis=0) for motion in motions)
    own = first != second
    for motion, lever in zip(motions, levers, strict=True):
        turning = np.linalg.norm(motion[3:], axis=0) * velocities * own
        rotations = np.maximum(rotations, turning)
        moves = np.maximum(moves, np.linalg.norm(motion[:3], axis=0) * velocities * own + lever * turning)
    return float(np.max(moves, initial=0.0)) or 1.0, float(np.max(rotations, initial=0.0)) or 1.0


@dataclass(frozen=True)
class MovedStart:
    """The change of a file's start that closes its loops.

    Attributes:
        open: largest loop-closure error of the file's own start, m or rad.
        loop: element of the file with that error.
        body, displacement: body whose center of mass moves farthest, and its distance, m.
        joint, joint_motion: joint that moves most, and its motion, m or rad.
    """

    open: float
    loop: str
    body: str
    displacement: float
    joint: str
    joint_motion: float


class FileStart(ABC):
    """The start of a model file in the coordinates of the file's own reader.

    Attributes:
        path: path of the file, for errors.
        error: class of the errors.
        owners: (k,) element of the file that each residual belongs to.
    """

    path: str
    error: type[SourceError]
    owners: Sequence[str]

    @abstractmethod
    def residuals(self, q: Array) -> tuple[Array, Array]:
        """Compute residuals (k,) of the loops, m or rad, and their Jacobian (k, nv) at a configuration."""

    @abstractmethod
    def units(self) -> Units:
        """Compute the units of the residuals at the configuration of the last call of `residuals`."""

    @abstractmethod
    def centers(self) -> Array:
        """Return the bodies' centers of mass (n, 3), m, world, at that configuration."""

    @abstractmethod
    def center_names(self) -> Sequence[str]:
        """Return the names (n,) of the bodies that `centers` are of."""

    @abstractmethod
    def moved(self, q: Array, step: Array) -> Array:
        """Move a configuration by a step (nv,)."""

    @abstractmethod
    def difference(self, q: Array, other: Array) -> Array:
        """Compute the step (nv,) from one configuration to another."""

    @abstractmethod
    def joint_of(self, dof: int) -> str:
        """Return the name of the joint that a velocity belongs to."""

    def closed(self, q: Array, called: str, tolerance: float) -> tuple[Array, list[str], MovedStart | None]:
        """Close the loops near a configuration.

        Args:
            q: the configuration.
            called: its name in messages.
            tolerance: of the scene, see `newton_euler.Scene.redundancy_tolerance`.

        Returns:
            The closed configuration, lines of a report, and the change of the start; None if the loops are
            closed already.

        Raises:
            SourceError: of the class `error`, naming the element that stays open the most.
        """
        # files without loops, or with closed loops
        before, _ = self.residuals(q)
        if not len(before):
            return q, [f"starts from {called}: no loops"], None
        units, owners = self.units(), self.owners
        if largest(before / units.rows) <= MAX_CLOSED_RESIDUAL:
            return q, [f"starts from {called}: all loops closed, to {largest(before):.1e}"], None
        # close the loops
        centers = self.centers()
        found = close(q, self.residuals, self.moved, units, tolerance)
        after, _ = self.residuals(found.q)
        if not found.is_closed:
            worst = int(np.argmax(np.abs(after)))
            raise self.error(
                self.path,
                f"{owners[worst]} cannot be closed from {called}: open by {abs(before[worst]):.3g} there, "
                f"and by {found.offset:.3g} (m or rad) at best",
            )
        # report the loops that were open, and the joint and the body that moved most
        opened: dict[str, float] = {}
        for owner, gap in zip(owners, np.abs(before).tolist(), strict=True):
            opened[owner] = max(opened.get(owner, 0.0), gap)
        moved = self.difference(q, found.q)
        dof, distances = int(np.argmax(np.abs(moved))), np.linalg.norm(self.centers() - centers, axis=1)
        farthest, widest = int(np.argmax(distances)), max(opened, key=lambda owner: opened[owner])
        change = MovedStart(
            opened[widest],
            widest,
            self.center_names()[farthest],
            float(distances[farthest]),
            self.joint_of(dof),
            float(moved[dof]),
        )
        elements = "; ".join(
            f"{owner} {gap:.3g}" for owner, gap in opened.items() if gap > MAX_CLOSED_RESIDUAL
        )
        lines = [
            f"open at {called}, in m or rad: {elements}",
            f"assembled next to {called}: closed to {found.offset:.1e}, joint {self.joint_of(dof)!r} "
            f"moved most, by {moved[dof]:.3g}, bodies by up to {np.max(distances):.3g} m",
        ]
        if found.noise > CLOSURE_TOLERANCE:
            lines.append(
                f"loops keep an offset of {found.offset:.1e} (m or rad), {found.noise:.1e} of their reach: "
                "the digits of the file do not close them better"
            )
        return found.q, lines, change
