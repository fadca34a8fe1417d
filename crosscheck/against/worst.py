"""A figure of the bodies, joints or terms that it was taken of: the largest."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from crosscheck.comparison.rows import Row
from newton_euler.scalars import Array


def worst_row(
    level: str, quantity: str, pair: tuple[str, str], gap: Array, tolerance: float, names: Sequence[str]
) -> Row:
    """The largest of gaps (n,), or (m, n) at m states, of what goes by n names."""
    each = gap.max(axis=0) if gap.ndim == 2 else gap
    where = int(np.argmax(each))
    return Row(level, quantity, pair, float(each[where]), tolerance, names[where])
