"""Pivot ratio of the constraints alone: the distance to a singular configuration, whatever the masses are.

The elimination of the equations of motion has small pivots near a singular configuration, and where a light
body is next to a heavy one. The Gram matrix of the dimensionless constraint Jacobian has no masses. Its
pivots, in units of what they usually are, tell the two apart. They are compiled and evaluated only where the
pivots of the equations of motion are small.

Written for native code, see `newton_euler.codegen.native`; it runs as plain Python as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from newton_euler.codegen.native import Callback, Record, Vector, native


class Progress(IntEnum):
    """Values of `ConstraintRatio.progress`: without a function, before and after `prepare` was called."""

    UNKNOWN = 0
    UNPREPARED = 1
    READY = 2


UNKNOWN_RATIO = -1.0
"""Stands for the pivot ratio if the function cannot be compiled."""


@dataclass(frozen=True, eq=False)
class ConstraintRatio(Record):
    """The function of a scene's constraints alone.

    Attributes:
        progress: a `Progress`.
        prepare: fills in this record.
        evaluate: writes the pivot ratio at x (inputs,), 1 or less.
        found: (1,) what it writes.
    """

    progress: int
    prepare: Callback
    evaluate: Callback
    found: Vector


def no_ratio() -> ConstraintRatio:
    """Return the record of equations whose own pivot ratio is that of the constraints."""
    return ConstraintRatio(Progress.UNKNOWN, None, None, np.zeros(1))


@native
def evaluate_ratio(ratio: ConstraintRatio, x: Vector) -> float:
    """Evaluate the pivot ratio of the constraints at x (inputs,) by a function that is ready."""
    if ratio.progress != Progress.READY:
        return UNKNOWN_RATIO
    ratio.evaluate(x, ratio.found)
    return max(ratio.found[0], 0.0)


@native
def constraint_ratio(ratio: ConstraintRatio, x: Vector) -> float:
    """Return the pivot ratio of the constraints at x (inputs,), 0 if it is unknown; compile it if need be."""
    if ratio.progress == Progress.UNKNOWN:
        return 0.0
    if ratio.progress == Progress.UNPREPARED:
        ratio.prepare(x, ratio.found)
    return evaluate_ratio(ratio, x)
