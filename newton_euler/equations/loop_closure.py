"""Assembly of a model file's loops: closed as well as the file's digits allow, and on which branch.

A file rounds its numbers, so that constraints that are redundant by design contradict each other slightly.
The independent ones are closed to round-off; the residual of the others is an offset that the loops keep.
Everything is dimensionless, as where a scene's redundant constraints are decided: velocities in the spread of
the mechanism and rad, each loop in the motion that one of these velocities gives to its bodies.

The branches of a loop (an elbow bends one way or the other) meet at dead centers, where the derivative of its
constraints by the coordinates that depend on the others is singular. Its determinant changes sign there.
"""

from __future__ import annotations

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
from newton_euler.scalars import Array

CLOSED = 1e-12
"""Dimensionless residual of loops that are closed as they stand: round-off of the file's own numbers."""

NEWTON_STEPS = 60

LONGEST_STEP = 0.2
"""rad or spreads of the mechanism, of one step of assembly, so that it stays on the branch it starts on."""

NEAR_DEAD_CENTER = 1e-3
"""Smallest singular value of a determinant's matrix to its largest, below which its sign is not trusted."""

SIDES = {
    True: "joints {1} bend the same way as in {0}",
    False: "joints {1} bend the other way than in {0}: a dead center lies between it and the closed pose",
    None: "{0} or the closed pose is so near to a dead center that either way of bending is as near",
}
"""Sentences on two configurations, with a name of the first and the joints in question."""

MOST_NAMES = 6


class Units(NamedTuple):
    """Units of the equations of a file's loops."""

    velocities: Array
    """(nv,) the spread of the mechanism, m, for slides and free translations, 1 for rotations."""
    rows: Array
    """(k,) m or rad: `reach` of a loop, the length of its own row for a coupling."""

    def jacobian(self, jacobian: Array) -> Array:
        """Divide a Jacobian (k, nv) by the units."""
        return np.asarray(jacobian * self.velocities / self.rows[:, None])


class Closure(NamedTuple):
    """A configuration in which the loops of a file are closed as well as they can be."""

    q: Array
    residuals: Array
    """(k,) m or rad."""
    noise: float
    """The largest residual, dimensionless."""
    independent: float
    """The same of the independent constraints."""
    tolerance: float
    """Dimensionless size below which constraints were taken as redundant."""

    @property
    def is_closed(self) -> bool:
        """True if rounding of the file explains the residuals."""
        # a residual that no motion removes is rounding, whichever constraints count as redundant
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
        q: where to start.
        evaluate: residuals (k,), m or rad, and their Jacobian (k, nv) at a configuration.
        move: a configuration moved by a step (nv,).
        units: of residuals and steps.
        tolerance: of the scene, see `newton_euler.Scene.redundancy_tolerance`.
    """
    best: Closure | None = None
    for _ in range(NEWTON_STEPS + 1):
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
        step = vt[:rank].T @ (shares / s[:rank])
        step *= min(1.0, LONGEST_STEP / max(largest(step), 1e-300))
        q = move(q, -units.velocities * step)
    assert best is not None
    return best


def reach(motions: Sequence[Array], levers: Sequence[float], velocities: Array) -> tuple[float, float]:
    """Compute by how much one velocity moves and rotates a closure of two bodies, at most: m and rad.

    The bodies count separately, so that a loop in which their motions cancel is stiff but for noise; see
    `newton_euler.equations.kinematics.TreeKinematics.row_scales`.

    Args:
        motions: (6, nv) of each body, velocity of its mass center and angular velocity.
        levers: m, from these centers to the point of the closure.
        velocities: (nv,) units.
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
class Branch:
    """Relation of two configurations of a loop.

    Attributes:
        columns: of the velocities that count as dependent on the others.
        same: True if no dead center lies between them; None if one is too near to a dead center to decide.
    """

    columns: tuple[int, ...]
    same: bool | None


def assembled(
    start: str, side: Branch, joints: Sequence[str], closed: Closure, moved: Array, apart: float
) -> list[str]:
    """Write lines of a report on a start that had open loops and is closed.

    Args:
        start: name of the start.
        side: its relation to the closed configuration.
        joints: names of the joints that the velocities belong to, by number.
        closed: the closed configuration.
        moved: (nv,) displacements of coordinates, m or rad.
        apart: m, largest displacement of a body.
    """
    dof = int(np.argmax(np.abs(moved)))
    bending = ", ".join(dict.fromkeys(repr(joints[k]) for k in side.columns[:MOST_NAMES]))
    offset = [
        f"loops keep an offset of {closed.offset:.1e} (m or rad), {closed.noise:.1e} of their reach: "
        "the digits of the file do not close them better"
    ]
    return [
        f"assembled next to {start}: closed to {closed.offset:.1e}, joint {joints[dof]!r} moved most, "
        f"by {moved[dof]:.3g}, bodies by up to {apart:.3g} m",
        f"branch: {SIDES[side.same].format(start, bending)}",
        *(offset if closed.noise > CLOSURE_TOLERANCE else []),
    ]


def branch(first: Array, second: Array, tolerance: float) -> Branch:
    """Compare two configurations by the dimensionless derivatives (k, nv) of the same constraints in them.

    The dependent velocities are those that the second one's derivative determines best, or the first one's
    where the second is near a dead center; rows that are redundant in both but for noise of the size of
    `tolerance` are left out.
    """
    from scipy.linalg import qr

    if first.shape != second.shape or not second.size:
        return Branch((), None)
    chosen = [(independent([sparse_vector(row) for row in at], tolerance).rows, at) for at in (second, first)]
    used, reference = max(chosen, key=lambda each: len(each[0]))
    if not used:
        return Branch((), None)
    rows = np.array(used)
    columns = np.sort(qr(reference[rows], mode="r", pivoting=True)[1][: len(rows)])
    signs = []
    for jacobian in (first, second):
        square = jacobian[np.ix_(rows, columns)]
        values = np.linalg.svd(square, compute_uv=False)
        if values[-1] < NEAR_DEAD_CENTER * values[0]:
            return Branch(tuple(map(int, columns)), None)
        signs.append(np.linalg.slogdet(square)[0])
    return Branch(tuple(map(int, columns)), bool(signs[0] == signs[1]))
