"""Exchange of constraint rows between two steps of a run, see `newton_euler.equations.row_choice`.

A compiled function finds the shares of the rows in use in those that are left out, after each step. Where one
has become large, Python exchanges rows. The state does not change, only the flags behind it.

Written for native code, see `newton_euler.codegen.native`; it runs as plain Python as well.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from newton_euler.codegen.native import Callback, Record, Vector, native

MAX_SHARE = 1.5
"""Share of a row in use in one that is left out, above which rows are exchanged. What is left of the first at
the end of a step counts so many times in the second; without projection twice the share costs a digit."""

EXCHANGED = -1.0
"""Value that Python writes in place of the squared share after it has exchanged rows."""


@dataclass(frozen=True, eq=False)
class RowExchange(Record):
    """The exchangeable rows of a scene.

    Attributes:
        count: their number, 0 for most scenes.
        first: place of their flags in x (inputs,).
        shares: the square of the largest share at x, then nonzeros of all rows.
        exchange: changes the flags in x to those of better rows, and writes `EXCHANGED`.
        found: what both write.
    """

    count: int
    first: int
    shares: Callback
    exchange: Callback
    found: Vector


def no_exchange(first: int) -> RowExchange:
    """Return the record of a scene without exchangeable rows, whose flags would begin at a place in x."""
    return RowExchange(0, first, None, None, np.zeros(1))


@native
def exchange_rows(rows: RowExchange, x: Vector) -> int:
    """Exchange rows if a share is too large at x (inputs,); return 1 if other rows are in use now."""
    if rows.count == 0:
        return 0
    rows.shares(x, rows.found)
    if rows.found[0] > MAX_SHARE * MAX_SHARE:
        rows.exchange(x, rows.found)
    return 1 if rows.found[0] == EXCHANGED else 0


@native
def copy_flags(rows: RowExchange, source: Vector, x: Vector) -> None:
    """Copy the flags of one x (inputs,) to another."""
    for i in range(rows.first, rows.first + rows.count):
        x[i] = source[i]
