"""Pivot ratio of the constraints alone: the distance to a singular configuration, independent of masses.

In a singular configuration the constraints of a closed loop become dependent. The elimination of the
equations of motion has small pivots there, but also if a light body is next to a heavy one. The Gram matrix J
J^T of the dimensionless constraint Jacobian J contains no masses. The smallest ratio of one of its pivots to
the reference magnitude of this pivot (its largest value in several usual configurations) distinguishes the
two cases. The function that computes this *pivot ratio* is compiled and evaluated only if the pivots of the
equations of motion are small.

Functions marked `native` are compiled to machine code by `newton_euler.codegen`; they also run as plain
Python.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from newton_euler.codegen.native import Callback, Record, Vector, native


class Progress(IntEnum):
    """Availability of the compiled function in a `ConstraintRatio`.

    Attributes:
        UNKNOWN: there is no function; the pivot ratio of the equations of motion is used instead.
        UNPREPARED: the function is not compiled yet; `ConstraintRatio.prepare` compiles it.
        READY: the function is compiled.
    """

    UNKNOWN = 0
    UNPREPARED = 1
    READY = 2


UNKNOWN_RATIO = -1.0
"""Result in place of a pivot ratio if the function could not be compiled."""


@dataclass(frozen=True, eq=False)
class ConstraintRatio(Record):
    """The function that evaluates the pivot ratio of a scene's constraints.

    Attributes:
        progress: a `Progress`.
        prepare: compiles the function and fills in this record.
        evaluate: writes the pivot ratio, at most 1, at a state with time and parameters, the input vector of
            all functions of a scene (`newton_euler.integrators.stepper`).
        results: (1,) vector that `evaluate` writes to.
    """

    progress: int
    prepare: Callback
    evaluate: Callback
    results: Vector


def no_ratio() -> ConstraintRatio:
    """Return a record without a function, for equations whose pivot ratio is independent of masses."""
    return ConstraintRatio(Progress.UNKNOWN, None, None, np.zeros(1))


@native
def evaluate_ratio(ratio: ConstraintRatio, x: Vector) -> float:
    """Evaluate the pivot ratio of the constraints; `UNKNOWN_RATIO` if its function is not compiled.

    Args:
        x: state with time and parameters, (inputs,).
    """
    if ratio.progress != Progress.READY:
        return UNKNOWN_RATIO
    ratio.evaluate(x, ratio.results)
    return max(ratio.results[0], 0.0)


@native
def constraint_ratio(ratio: ConstraintRatio, x: Vector) -> float:
    """Return the pivot ratio of the constraints; the first call compiles the function.

    The result is 0 if there is no function, and `UNKNOWN_RATIO` if the function cannot be compiled.

    Args:
        x: state with time and parameters, (inputs,).
    """
    if ratio.progress == Progress.UNKNOWN:
        return 0.0
    if ratio.progress == Progress.UNPREPARED:
        ratio.prepare(x, ratio.results)
    return evaluate_ratio(ratio, x)
