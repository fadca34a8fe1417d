"""Angles that one file has as a short decimal fraction of pi, such as 1.57 instead of 1.5707963.

A file that says 1.57 means a right angle: its 8e-4 rad from a file with more digits are rounding.
"""

from __future__ import annotations

import math
from itertools import product

SHORT_DECIMALS = (2, 3, 4, 5)
"""Decimals with which files write fractions of pi."""

FRACTIONS = tuple(sorted({n * math.pi / parts for parts in (2, 3, 4, 6) for n in range(1, 4 * parts + 1)}))
"""Numbers that files write with few decimals: multiples of 30 and 45 degrees up to two revolutions."""

TURNS = tuple(math.pi / parts for parts in (1, 2, 3, 4, 6))
"""Turns of frames that files write with few decimals."""


def _errors() -> tuple[float, ...]:
    """Return the differences, rad, of turns from their short decimals, rounded or cut off."""
    errors: set[float] = set()
    for angle, decimals in product(TURNS, SHORT_DECIMALS):
        errors.add(abs(angle - round(angle, decimals)))
        if decimals > 3:
            errors.add(angle - math.floor(angle * 10**decimals) / 10**decimals)
    return tuple(sorted(errors))


_ERRORS = _errors()


def is_short_pi(first: float, second: float) -> bool:
    """Return whether one number is the other one, written with fewer decimals.

    The shorter number needs four digits, or the longer one has to be a fraction of pi.
    """
    for short, long in ((first, second), (second, first)):
        if not (math.isfinite(short) and math.isfinite(long)) or short == long:
            continue
        decimals = len(repr(abs(short)).partition(".")[2]) if "e" not in repr(short) else 17
        digits = len(repr(abs(short)).replace(".", "").lstrip("0"))
        is_fraction = any(abs(abs(long) - angle) < 1e-6 for angle in FRACTIONS)
        # A fraction of pi may also be cut off, as in 3.1415
        units = abs(short - long) * 10**decimals
        if units <= 0.5000001 and digits >= 4 and decimals <= 5:
            return True
        if units < 1.0 and is_fraction and 2 <= decimals <= 5:
            return True
    return False


def is_turn_by_short_pi(turn: float, uncertainty: float) -> bool:
    """Return whether short decimals of pi explain the angle between two directions or frames.

    Up to three angles of a frame have the same digits; their errors add up like perpendicular vectors.

    Args:
        turn: rad.
        uncertainty: of the turn, rad.
    """
    # The error of a rotation that is the product of several has terms of second order
    slack = max(uncertainty, 1e-3 * turn)
    return slack < 0.02 * turn and any(
        abs(turn - math.sqrt(angles) * error) <= slack for error in _ERRORS for angles in (1, 2, 3)
    )
