"""Constraint rows chosen anew where those in use lose a rank that all rows together keep.

Of redundant constraints some rows imply the others. With an orthonormal basis N (k, d) of what J^T maps to
zero, d rows D of the k may be left out where N[D] is regular: the smallest singular value of the others is at
least that of J times that of N[D] (by the CS decomposition, G. H. Golub, C. F. Van Loan, Matrix Computations,
4th ed., 2013, section 2.5.4). Rows that are chosen near the start may degenerate on the way, as in Bricard's
mechanism, where all of them together have one rank everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from newton_euler.equations.redundancy import mobility
from newton_euler.equations.relative import Relative
from newton_euler.equations.solve import numerical_rank, singular_values
from newton_euler.equations.system import dimensionless_jacobian
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.scalars import Array

DEGENERATE = 3e-2
"""Smallest singular value of N[D] somewhere on the way, below which digits have been lost by the choice."""

BETTER = 3.0
"""Times as large it has to be everywhere with other rows."""

LOOKS = 64
"""Configurations that are looked at, evenly spread."""

LARGEST = 1000
"""Rows; of more, singular values would take longer than a run."""


def other_rows(scene: Scene, used: Sequence[int], states: Sequence[State]) -> list[int] | None:
    """Choose rows of the joint-coordinate form that stay independent in all states where those in use do not.

    None if those in use do, if no others do better, and where the rank of all rows changes on the way.

    Args:
        scene: with redundant constraints.
        used: rows in use.
        states: in the order of a run.
    """
    system, decided = Relative(scene), mobility(scene)
    alive = sorted({*decided.independent, *decided.redundant})
    if not decided.redundant or len(alive) > LARGEST or not len(states):
        return None
    rank, spaces = len(decided.independent), []
    for k in np.unique(np.linspace(0, len(states) - 1, LOOKS).round().astype(int)):
        q, _ = system.coordinates(states[k])
        left, values, _ = singular_values(dimensionless_jacobian(system, q)[alive], full=True)
        if numerical_rank(values[:rank]) < rank:
            return None
        spaces.append(left[:, rank:])
    now = _share(spaces, [k for k, row in enumerate(alive) if row not in used])
    left_out = _pivots(spaces)
    if now > DEGENERATE or _share(spaces, left_out) < BETTER * now:
        return None
    return [row for k, row in enumerate(alive) if k not in left_out]


def _share(spaces: Sequence[Array], rows: Sequence[int]) -> float:
    """The smallest singular value of these rows of all bases."""
    return min(float(singular_values(space[list(rows)])[1][-1]) for space in spaces)


def _pivots(spaces: Sequence[Array]) -> list[int]:
    """As many rows as the bases have columns, each the largest that the ones before leave of it anywhere.

    By Gram-Schmidt with pivoting, in all bases at once.
    """
    remaining = [np.array(space) for space in spaces]
    found: list[int] = []
    for _ in range(remaining[0].shape[1]):
        lengths = np.min([np.linalg.norm(space, axis=1) for space in remaining], axis=0)
        row = int(np.argmax(lengths))
        found.append(row)
        for space in remaining:
            along = space[row] / np.linalg.norm(space[row])
            space -= np.outer(space @ along, along)
    return found
