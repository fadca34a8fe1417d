"""Units that users may give, and numbers with units for texts.

The unit of a text is chosen after rounding, as 999.6 um is 1 mm and not 1e+03 um.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

LENGTHS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6}
"""Units of lengths in options and in columns of logs, m."""

ANGLES = {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180.0}
"""Units of angles in options and in columns of logs, rad."""

TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
"""Units of short times, s, the largest first."""

SECONDS_AND_MS = {"s": 1.0, "ms": 1e-3}
"""Units of times that are seldom shorter than a millisecond, s, the largest first."""


def significant(value: float, digits: int = 3) -> str:
    """Format a number with some significant digits, and without an exponent from 1e-4 to below a million.

    Examples:
        >>> significant(999.6), significant(1234.0), significant(2.5e7)
        ('1000', '1230', '2.5e+07')
    """
    return f"{float(f'{value:.{digits}g}'):.{max(6, digits)}g}"


def quantity_text(value: float, units: Mapping[str, float], digits: int = 3) -> str:
    """Format a number in the largest unit of which it is at least 1 after rounding, or in the smallest unit.

    With two digits it is at least 0.1 of the unit: 230 ms has three digits before the point, 0.23 s has two.

    Args:
        value: number that is not negative, such as a length in m.
        units: sizes of the units by name, such as 0.001 for "mm"; the largest first.
        digits: number of significant digits.

    Examples:
        >>> quantity_text(999.6e-6, TIME_UNITS), quantity_text(0.23, TIME_UNITS, digits=2)
        ('1 ms', '0.23 s')
    """
    rounded = float(f"{value:.{digits}g}")
    least = 0.1 if digits == 2 else 1.0
    # 1e-12 allows for the round-off of the products of `least` and sizes
    fitting = [unit for unit, size in units.items() if rounded >= least * size * (1.0 - 1e-12)]
    unit = fitting[0] if fitting else list(units)[-1]
    return f"{significant(value / units[unit], digits)} {unit}"
