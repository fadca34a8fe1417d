"""Rows of one joint that have one cause, such as a reversed axis and limits that are not mirrored.

In: rows of single elements. Out: fewer rows.
"""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import replace

import numpy as np

from crosscheck.differences.difference import Difference, Quantity, Standing


def with_joint_causes(rows: list[Difference]) -> list[Difference]:
    """Return rows in which a joint's reversed axis, moved zero and forgotten limits are one row."""
    of_joint: dict[str, dict[Quantity, Difference]] = defaultdict(dict)
    for row in rows:
        if row.element_kind == "joint" and row.standing is not Standing.ROUNDING:
            of_joint[row.element][row.quantity] = row
    replaced: dict[int, Difference | None] = {}
    for found in of_joint.values():
        sign, zero = found.get(Quantity.SIGN), found.get(Quantity.ZERO)
        axis = found.get(Quantity.JOINT_AXIS)
        dependent = [found[quantity] for quantity in (Quantity.LIMITS, Quantity.REST) if quantity in found]
        unchanged = [row for row in dependent if _is_as_written(row, sign, zero)]
        if not unchanged:
            continue
        replaced.update((id(row), None) for row in unchanged)
        what = " and ".join(row.quantity for row in unchanged)
        if sign is not None:
            words = f"{sign.cause}, {what} not mirrored"
            if zero is not None:
                # limits that are as written show that nothing but the axis is reversed, in a pose that has
                # another coordinate than zero
                words = f"{sign.cause}, its zero is elsewhere, {what} not mirrored"
                replaced[id(zero)] = None
            replaced[id(sign)] = replace(sign, cause=words, effect=None, convention=False)
        if zero is not None and axis is not None and axis.cause:
            # A turn about any direction is a turn of the axis and a turn about the axis
            turn = 2.0 * math.acos(math.cos(0.5 * axis.size) * math.cos(0.5 * zero.size))
            words = f"the link is turned at its parent by {math.degrees(turn):.4g} degrees"
            replaced[id(axis)] = replace(axis, size=turn, cause=words)
            replaced[id(zero)] = None
        elif zero is not None and sign is None:
            words = f"{zero.cause}, {what} not moved"
            replaced[id(zero)] = replace(zero, cause=words, effect=None, convention=False)
    kept = (replaced.get(id(row), row) for row in rows)
    return [row for row in kept if row is not None]


def _is_as_written(row: Difference, sign: Difference | None, zero: Difference | None) -> bool:
    """Return whether limits or rest are equal in both files, in spite of another sign or zero."""
    if row.first is None or row.second is None or not (sign or zero):
        return False
    sense = -1 if sign else 1
    offset = zero.second if zero and isinstance(zero.second, float) else 0.0
    as_written = (sense * np.atleast_1d(row.second) + offset)[::sense]
    return bool(np.allclose(as_written, np.atleast_1d(row.first), rtol=1e-5, atol=1e-6 + row.uncertainty))
