"""Constraint rows chosen anew where those in use lose a rank that all rows together keep.

Of redundant constraints some rows imply the others. With an orthonormal basis N (k, d) of what J^T maps to
zero, d rows D of the k may be left out where N[D] is regular: the smallest singular value of the others is at
least that of J times that of N[D] (by the CS decomposition, G. H. Golub, C. F. Van Loan, Matrix Computations,
4th ed., 2013, section 2.5.4). Rows that are chosen near the start may degenerate on the way, as in Bricard's
mechanism, where all of them together have one rank everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from newton_euler.scalars import Array
from newton_euler.solve import numerical_rank, singular_values
from newton_euler.sparse import RowsInUse
from newton_euler.system import dimensionless_jacobian

if TYPE_CHECKING:
    from newton_euler.compiled import Formulation

DEGENERATE = 3e-2
"""Smallest singular value of N[D] somewhere on the way, below which digits have been lost by the choice."""

BETTER = 3.0
"""Times as large it has to be everywhere with other rows."""

LOOKS = 64
"""Configurations that are looked at, evenly spread."""

LARGEST = 1000
"""Rows; of more, singular values would take longer than a run."""


def other_rows(
    system: Formulation, rows: RowsInUse, redundant: Sequence[int], configurations: Sequence[Array]
) -> tuple[RowsInUse, list[int]] | None:
    """Rows that stay independent in all configurations where those in use do not, and the redundant ones.

    None if those in use do, if no others do better, and where the rank of all rows changes on the way.

    Args:
        rows, redundant: those in use, and the others that are not zero everywhere.
        configurations: q (nq,) each, in the order of a run.
    """
    alive = sorted([*rows.numbers, *redundant])
    if not redundant or len(alive) > LARGEST or not len(configurations):
        return None
    looked = np.unique(np.linspace(0, len(configurations) - 1, LOOKS).round().astype(int))
    spaces = []
    for k in looked:
        left, values, _ = singular_values(dimensionless_jacobian(system, configurations[k])[alive], full=True)
        spaces.append(left[:, numerical_rank(values) :])
    if any(space.shape[1] != len(redundant) for space in spaces):
        return None
    now = _share(spaces, [alive.index(row) for row in redundant])
    left_out = _pivots(spaces)
    if now > DEGENERATE or _share(spaces, left_out) < BETTER * now:
        return None
    others = sorted(alive[k] for k in left_out)
    return RowsInUse([row for row in alive if row not in others]), others


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
