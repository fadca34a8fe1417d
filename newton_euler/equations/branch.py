"""On which branch a loop is closed: which way an elbow bends.

The ways in which a loop can be closed meet at dead centres, where the derivative of its constraints by the
coordinates that depend on the others is singular. Its determinant has another sign beyond.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from newton_euler.equations.closure import Closure
from newton_euler.equations.independence import independent
from newton_euler.equations.sparse import sparse_vector
from newton_euler.model.mechanism import CLOSURE_TOLERANCE
from newton_euler.scalars import Array

NEAR = 1e-3
"""Of the least of the factors of a determinant to the largest: nearer to a dead centre no side is told."""

SIDES = {
    True: "joints {1} bend the same way as in {0}",
    False: "joints {1} bend the other way than in {0}: a dead centre lies between it and the closed pose",
    None: "{0} or the closed pose is so near to a dead centre that either way of bending is as near",
}
"""What to say of two configurations, with a name of the first and the joints in question."""

MOST_NAMES = 6


@dataclass(frozen=True)
class Branch:
    """How one configuration lies to another.

    Attributes:
        columns: of the velocities that were taken as those that depend on the others.
        same: whether both lie on the same side of the dead centres of these; None if one is too near to tell.
    """

    columns: tuple[int, ...]
    same: bool | None


def assembled(
    start: str, side: Branch, joints: Sequence[str], closed: Closure, moved: Array, apart: float
) -> list[str]:
    """Lines for a report on a start that was open and is closed.

    Args:
        start: what it is called.
        side: how it lies to the closed configuration.
        joints: names of the joints that the velocities belong to, by number.
        closed: the closed configuration.
        moved: (nv,) how far coordinates moved, m or rad.
        apart: m, how far bodies moved at most.
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
    where the second is near a dead centre; what is redundant in both but for noise of the size of `tolerance`
    is left out.
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
        if values[-1] < NEAR * values[0]:
            return Branch(tuple(map(int, columns)), None)
        signs.append(np.linalg.slogdet(square)[0])
    return Branch(tuple(map(int, columns)), bool(signs[0] == signs[1]))
