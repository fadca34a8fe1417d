"""Pivot ratio of the constraints alone: the distance to a singular configuration, independent of masses.

In a singular configuration the constraints of a closed loop become dependent. The elimination of the
equations of motion has small pivots there, but also if a light body is next to a heavy one. The Gram matrix J
J^T of the constraint Jacobian J (lengths divided by the mechanism's size) contains no masses. The smallest
ratio of one of its pivots to the reference magnitude of this pivot distinguishes the two cases. The reference
magnitude is the largest value of the pivot in several sample configurations that are not singular. The
function that computes this *pivot ratio* is compiled and evaluated only if the pivots of the equations of
motion are small.

Functions marked `native` are compiled to machine code by `newton_euler.codegen`; they also run as plain
Python.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from newton_euler.codegen.native import Callback, Record, Vector, native


class Availability(IntEnum):
    """Availability of the compiled function in a `ConstraintRatio`.

    Attributes:
        NO_FUNCTION: there is no function; the integrators use the pivot ratio of the equations of motion.
        NOT_COMPILED: the function is not compiled yet; `ConstraintRatio.prepare` compiles it.
        COMPILED: the function is compiled.
    """

    NO_FUNCTION = 0
    NOT_COMPILED = 1
    COMPILED = 2


FAILED_RATIO = -1.0
"""Result in place of a pivot ratio if the function could not be compiled."""


@dataclass(frozen=True, eq=False)
class ConstraintRatio(Record):
    """The function that evaluates the pivot ratio of a scene's constraints.

    Attributes:
        availability: an `Availability`.
        prepare: compiles the function and replaces the fields that native code sees, see
            `Record.overwrite_with`. If that fails, the run ends.
        evaluate: writes the pivot ratio, at most 1, at a state with time and parameters, the input vector of
            all functions of a scene (`newton_euler.integrators.stepper`).
        results: (1,) vector that `evaluate` writes to.
    """

    availability: int
    prepare: Callback
    evaluate: Callback
    results: Vector


def no_ratio() -> ConstraintRatio:
    """Return a record without a function, for equations whose pivot ratio is independent of masses."""
    return ConstraintRatio(Availability.NO_FUNCTION, None, None, np.zeros(1))


@native
def evaluate_ratio(ratio: ConstraintRatio, x: Vector) -> float:
    """Evaluate the pivot ratio of the constraints; `FAILED_RATIO` if its function is not compiled.

    A native function reads the fields of a record when it is called. This function is therefore separate from
    `constraint_ratio`: called after `prepare`, it sees the new fields.

    Args:
        x: state with time and parameters, (inputs,).
    """
    if ratio.availability != Availability.COMPILED:
        return FAILED_RATIO
    ratio.evaluate(x, ratio.results)
    return max(ratio.results[0], 0.0)


@native
def constraint_ratio(ratio: ConstraintRatio, x: Vector) -> float:
    """Return the pivot ratio of the constraints; the first call compiles the function.

    The result is 0, as in a singular configuration, if there is no function, and `FAILED_RATIO` if the
    function cannot be compiled.

    Args:
        x: state with time and parameters, (inputs,).
    """
    if ratio.availability == Availability.NO_FUNCTION:
        return 0.0
    if ratio.availability == Availability.NOT_COMPILED:
        ratio.prepare(x, ratio.results)
    return evaluate_ratio(ratio, x)
