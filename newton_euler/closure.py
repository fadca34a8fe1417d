"""Closing the loops of a model file where it starts, as well as its own digits allow.

A file rounds its numbers, so that constraints that are redundant by design contradict each other a little.
The independent ones are closed to round-off; what is left of the others is an offset that the loops keep.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from newton_euler.redundancy import apparent_rank
from newton_euler.scalars import Array
from newton_euler.scene import REDUNDANCY_TOLERANCE
from newton_euler.solve import minimum_norm, singular_values
from newton_euler.stabilize import largest

CLOSED = 1e-12
"""m or rad, of what is closed as it stands: round-off of the file's own numbers."""

MUST_CLOSE = 1e-9
"""m or rad, of the independent constraints after assembly."""

LARGEST_OFFSET = 1e-5
"""m or rad: files round to 1e-6 at the worst, and several such errors add up."""

NEWTON_STEPS = 60

LONGEST_STEP = 0.2
"""rad or m, of one step of assembly, so that it stays on the branch it starts on."""


class Closure(NamedTuple):
    """A configuration in which the loops of a file are closed as well as they can be."""

    q: Array
    residuals: Array
    """(k,) m or rad."""
    independent: Array
    """(k,) what could be closed of the residuals and is not."""

    @property
    def is_closed(self) -> bool:
        """Whether what is left is no more than rounding of the file explains."""
        return largest(self.independent) <= MUST_CLOSE and self.offset <= LARGEST_OFFSET

    @property
    def offset(self) -> float:
        """The largest residual, m or rad."""
        return largest(self.residuals)


def close(
    q: Array, evaluate: Callable[[Array], tuple[Array, Array]], move: Callable[[Array, Array], Array]
) -> Closure:
    """Close loops near a configuration by Newton's steps of least length.

    Args:
        q: where to start.
        evaluate: residuals (k,), m or rad, and their Jacobian (k, nv) at a configuration.
        move: a configuration moved by a step (nv,).
    """
    best: Closure | None = None
    for _ in range(NEWTON_STEPS + 1):
        phi, jacobian = evaluate(q)
        u, s, _ = singular_values(jacobian)
        rank = apparent_rank(s, REDUNDANCY_TOLERANCE)
        found = Closure(q, phi, u[:, :rank] @ (u[:, :rank].T @ phi))
        if best is None or largest(found.independent) < largest(best.independent):
            best = found
        elif largest(best.independent) < MUST_CLOSE:
            break
        step = minimum_norm(jacobian, phi, np.ones(len(phi)), np.ones(jacobian.shape[1]), rank)
        step *= min(1.0, LONGEST_STEP / max(largest(step), 1e-300))
        q = move(q, -step)
    assert best is not None
    return best
