"""Angles that one file has as a short decimal fraction of pi, such as 1.57 instead of 1.5707963.

A file that says 1.57 means a right angle: its 8e-4 rad from a file with more digits are rounding.
"""

from __future__ import annotations

import math
from itertools import product

SHORT_DECIMALS = (2, 3, 4, 5)
"""Decimals with which files write fractions of pi."""

FRACTIONS = tuple(sorted({n * math.pi / parts for parts in (2, 3, 4, 6) for n in range(1, 4 * parts + 1)}))
"""Angles that files write with few decimals: multiples of 30 and 45 degrees up to two revolutions."""


def _errors() -> tuple[float, ...]:
    """Return the differences, rad, of fractions of pi from their short decimals, rounded or cut off."""
    errors: set[float] = set()
    for angle, decimals in product(FRACTIONS, SHORT_DECIMALS):
        unit = 10.0**-decimals
        rounded, cut = round(angle, decimals), math.floor(angle / unit) * unit
        errors.update((abs(angle - rounded), abs(angle - cut)))
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
        if decimals <= 5 and abs(short - long) <= 0.5000001 * 10.0**-decimals:
            is_fraction = any(abs(abs(long) - angle) < 1e-6 for angle in FRACTIONS)
            if digits >= 4 or (is_fraction and decimals >= 2):
                return True
    return False


def is_turn_by_short_pi(turn: float, uncertainty: float) -> bool:
    """Return whether short decimals of pi explain the angle between two directions or frames.

    Up to three angles of a frame have the same digits; their errors add up like perpendicular vectors.

    Args:
        turn: rad.
        uncertainty: of the turn, rad.
    """
    slack = max(uncertainty, 1e-4 * turn)
    return turn < 0.01 and any(
        abs(turn - math.sqrt(angles) * error) <= slack for error in _ERRORS for angles in (1, 2, 3)
    )
