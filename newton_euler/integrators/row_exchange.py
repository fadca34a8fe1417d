"""Exchange redundant constraint rows between two steps of a run, so that the rows in use stay independent.

A constraint row is one scalar constraint equation. If constraints are redundant, each row that is left out is
a linear combination of the rows in use, with coefficients called *shares*. If the shares depend on the
configuration, the rows are *exchangeable* (`newton_euler.equations.row_choice`).

A compiled function computes the shares after each step. If a share becomes large, Python exchanges the row
that is left out for the row in use with this share. For this purpose Python changes the flags of both rows: 1
for a row that is left out, 0 for a row in use. The flags follow the state and the time in the vector x.

Functions marked `native` are compiled to machine code by `newton_euler.codegen`; they also run as plain
Python. A `Record` is a dataclass that such a function takes as one argument.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from newton_euler.codegen.native import Callback, Record, Vector, native

MAX_SHARE = 1.5
"""Share above which rows are exchanged. The constraint violation of a row in use appears in the row that is
left out, multiplied by the share. Twice this limit costs a digit of accuracy in runs without projection."""

EXCHANGED = -1.0
"""Value that Python writes in place of the squared share to report that rows were exchanged."""


@dataclass(frozen=True, eq=False)
class RowExchange(Record):
    """The exchangeable constraint rows of a scene, and the functions that exchange them.

    Both functions take x (inputs,), a state with time, flags and parameters, and write to `results`.

    Attributes:
        count: number of exchangeable rows, 0 for most scenes.
        first: index in x of the flag of the first exchangeable row.
        shares: writes the square of the largest share, then the nonzeros of all constraint rows, which
            `exchange` reads.
        exchange: changes the flags in x to those of a better choice of rows, and writes `EXCHANGED`.
        results: vector that both functions write to.
    """

    count: int
    first: int
    shares: Callback
    exchange: Callback
    results: Vector


def no_exchange(first: int) -> RowExchange:
    """Return the record of a scene without exchangeable rows; `first` is the index of flags in x, if any."""
    return RowExchange(0, first, None, None, np.zeros(1))


@native
def exchange_rows(rows: RowExchange, x: Vector) -> int:
    """Exchange rows if a share is larger than `MAX_SHARE`; return 1 if the rows in use have changed, else 0.

    Args:
        rows: exchangeable rows of the scene.
        x: state with time, flags and parameters (inputs,), whose flags may change.
    """
    if rows.count == 0:
        return 0
    rows.shares(x, rows.results)
    if rows.results[0] > MAX_SHARE * MAX_SHARE:
        rows.exchange(x, rows.results)
    return 1 if rows.results[0] == EXCHANGED else 0
