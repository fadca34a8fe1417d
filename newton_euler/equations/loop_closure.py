"""Close the kinematic loops of an imported model file, as well as the rounded numbers of the file allow.

A file rounds its numbers, so that constraints that are redundant by design contradict each other slightly.
The independent constraints are closed to round-off by Newton's method. The residuals of the other constraints
remain as a constant offset. Rank decisions use dimensionless quantities
(`newton_euler.equations.redundancy`). Displacements in a step are divided by the spread of the mechanism, a
typical length. The residual of a loop is divided by its reach, the largest motion that one unit velocity
gives to the bodies of the loop.

`close` is the algorithm. `FileStart` is the base class of the readers' descriptions of a file's loops (MJCF
and URDF), and reports what closing them changes.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from newton_euler.equations.dense import largest, singular_values
from newton_euler.equations.independence import independent
from newton_euler.equations.redundancy import loose_tolerance
from newton_euler.equations.sparse import sparse_vector
from newton_euler.model.mechanism import CLOSURE_TOLERANCE
from newton_euler.model.scene import REDUNDANCY_TOLERANCE
from newton_euler.model.source_file import SourceError
from newton_euler.scalars import Array

MAX_CLOSED_RESIDUAL = 1e-12
"""Largest dimensionless residual of loops at which a file counts as closed and nothing is moved. Reports of
other files list the elements with a larger error, m or rad."""

MAX_CLOSING_STEPS = 60
"""Largest number of Newton steps."""

MAX_STEP_LENGTH = 0.2
"""Largest component of a Newton step, rad, or a length divided by the spread. Longer steps could assemble the
mechanism in another of its possible configurations."""


class Units(NamedTuple):
    """Divisors that make the loop equations of a file dimensionless.

    Attributes:
        velocities: (nv,) spread of the mechanism, m, for slides and free translations; 1 for rotations.
        rows: (k,) m or rad: `reach` of a loop; for a coupling, the norm of its Jacobian row for dimensionless
            velocities.
    """

    velocities: Array
    rows: Array

    def jacobian(self, jacobian: Array) -> Array:
        """Return a Jacobian (k, nv) in dimensionless form."""
        return np.asarray(jacobian * self.velocities / self.rows[:, None])


class Closure(NamedTuple):
    """A configuration in which the loops of a file are closed as well as possible.

    Attributes:
        q: the configuration, in the coordinates of the file's reader.
        residuals: (k,) of all constraints, m or rad.
        noise: largest residual of all constraints, dimensionless.
        independent: largest residual of the independent constraints, dimensionless.
        tolerance: dimensionless distance of a constraint's Jacobian row from the span of the other rows,
            below which the constraint counts as redundant.
    """

    q: Array
    residuals: Array
    noise: float
    independent: float
    tolerance: float

    @property
    def is_closed(self) -> bool:
        """True if the residuals are so small that rounding of the file's numbers explains them."""
        # 10 times the tolerance, since motions of several rad multiply the rounding errors of the file
        loose = loose_tolerance(max(self.tolerance, REDUNDANCY_TOLERANCE))
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
    """Close loops near a configuration by minimum-norm Newton steps.

    Args:
        q: configuration to start from.
        evaluate: computes residuals (k,), m or rad, and their Jacobian (k, nv) at a configuration.
        move: returns a configuration moved by a step (nv,).
        units: divisors that make residuals and steps dimensionless.
        tolerance: see `Closure.tolerance` and `newton_euler.Scene.redundancy_tolerance`.

    Returns:
        The configuration with the smallest residual of the independent constraints.
    """
    best: Closure | None = None
    for _ in range(MAX_CLOSING_STEPS + 1):
        # residuals of all constraints, and of the independent ones alone
        phi, jacobian = evaluate(q)
        scaled, matrix = phi / units.rows, units.jacobian(jacobian)
        rank = len(independent([sparse_vector(row) for row in matrix], tolerance).rows)
        u, s, vt = singular_values(matrix)
        components = u[:, :rank].T @ scaled  # of the residuals in the range of the independent constraints
        found = Closure(
            q,
            residuals=phi,
            noise=largest(scaled),
            independent=largest(u[:, :rank] @ components),
            tolerance=tolerance,
        )
        if best is None or found.independent < best.independent:
            best = found
        elif best.independent < CLOSURE_TOLERANCE:
            break
        # shortest step that closes the independent constraints in first order
        step = vt[:rank].T @ (components / s[:rank])
        step *= min(1.0, MAX_STEP_LENGTH / max(largest(step), 1e-300))
        q = move(q, -units.velocities * step)
    assert best is not None
    return best


def reach(motions: Sequence[Array], levers: Sequence[float], velocities: Array) -> tuple[float, float]:
    """Compute the largest motion that one unit velocity gives to the point where two bodies close a loop.

    Only velocities that move one of the two bodies alone count, since motions of both bodies cancel in the
    constraint rows, at least in part. If all entries of a row nearly vanish, the row is small relative to the
    reach, and counts as noise (`newton_euler.equations.kinematics.TreeKinematics.row_scales`).

    Args:
        motions: (6, nv) for each body: velocity of its center of mass, and its angular velocity.
        levers: for each body, distance of its center of mass from the point, m.
        velocities: (nv,) divisors that make velocities dimensionless but for time, see `Units`.

    Returns:
        Largest motion, m, and largest rotation, rad, for a unit dimensionless velocity; 1 in place of 0.
    """
    rotations, moves = np.zeros(len(velocities)), np.zeros(len(velocities))
    moves_first, moves_second = (np.any(motion != 0.0, axis=0) for motion in motions)
    moves_one = moves_first != moves_second  # velocities that move exactly one of the bodies
    for motion, lever in zip(motions, levers, strict=True):
        rotation = np.linalg.norm(motion[3:], axis=0) * velocities * moves_one
        rotations = np.maximum(rotations, rotation)
        move = np.linalg.norm(motion[:3], axis=0) * velocities * moves_one + lever * rotation
        moves = np.maximum(moves, move)
    return float(np.max(moves, initial=0.0)) or 1.0, float(np.max(rotations, initial=0.0)) or 1.0


@dataclass(frozen=True)
class MovedStart:
    """Change of the initial state of a model file that closes its loops.

    Attributes:
        open: largest loop-closure error at the initial state of the file, m or rad.
        loop: element of the file that has this error.
        body: name of the body whose center of mass moves farthest.
        displacement: distance by which this body moves, m.
        joint: name of the joint that moves most.
        joint_motion: motion of this joint, m or rad.
    """

    open: float
    loop: str
    body: str
    displacement: float
    joint: str
    joint_motion: float


class FileStart(ABC):
    """Initial state of a model file; subclasses compute its loops in the coordinates of a file format.

    A configuration q is a vector of these coordinates; a step (nv,) changes it.

    Attributes:
        path: path of the file, for error messages.
        error: class of the errors that are raised.
        owners: (k,) name of the element of the file that each residual belongs to.
    """

    path: str
    error: type[SourceError]
    owners: Sequence[str]

    @abstractmethod
    def residuals(self, q: Array) -> tuple[Array, Array]:
        """Compute residuals (k,) of the loops, m or rad, and their Jacobian (k, nv) at a configuration."""

    @abstractmethod
    def units(self) -> Units:
        """Compute the divisors of residuals and steps at the configuration of the last `residuals` call."""

    @abstractmethod
    def centers(self) -> Array:
        """Return the centers of mass (n, 3), m, world frame, at the last configuration of `residuals`."""

    @abstractmethod
    def center_names(self) -> Sequence[str]:
        """Return the names (n,) of the bodies whose centers of mass `centers` returns."""

    @abstractmethod
    def moved(self, q: Array, step: Array) -> Array:
        """Return a configuration moved by a step (nv,)."""

    @abstractmethod
    def difference(self, q: Array, other: Array) -> Array:
        """Compute the step (nv,) from the configuration q to another one."""

    @abstractmethod
    def joint_of(self, dof: int) -> str:
        """Return the name of the joint that velocity number `dof` belongs to."""

    def closed(self, q: Array, called: str, tolerance: float) -> tuple[Array, list[str], MovedStart | None]:
        """Close the loops near a configuration.

        Args:
            q: the configuration.
            called: name of the configuration in messages.
            tolerance: see `Closure.tolerance` and `newton_euler.Scene.redundancy_tolerance`.

        Returns:
            The closed configuration; lines of a report; the change of the initial state, None if the loops
            are closed already.

        Raises:
            SourceError: of the class `error`, naming the element with the largest remaining residual.
        """
        # files without loops, or with closed loops
        before, _ = self.residuals(q)
        if not len(before):
            return q, [f"starts from {called}: no loops"], None
        units, owners = self.units(), self.owners
        if largest(before / units.rows) <= MAX_CLOSED_RESIDUAL:
            return q, [f"starts from {called}: all loops closed, to {largest(before):.1e} m or rad"], None
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
        errors: dict[str, float] = {}  # largest loop-closure error of each element, m or rad
        for owner, error in zip(owners, np.abs(before).tolist(), strict=True):
            errors[owner] = max(errors.get(owner, 0.0), error)
        moved = self.difference(q, found.q)
        dof, distances = int(np.argmax(np.abs(moved))), np.linalg.norm(self.centers() - centers, axis=1)
        farthest, worst_owner = int(np.argmax(distances)), max(errors, key=lambda owner: errors[owner])
        change = MovedStart(
            open=errors[worst_owner],
            loop=worst_owner,
            body=self.center_names()[farthest],
            displacement=float(distances[farthest]),
            joint=self.joint_of(dof),
            joint_motion=float(moved[dof]),
        )
        elements = "; ".join(
            f"{owner} {error:.3g}" for owner, error in errors.items() if error > MAX_CLOSED_RESIDUAL
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
