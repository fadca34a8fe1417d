"""Search for the smallest whole number that fulfills a monotonic condition, such as "enough steps"."""

from __future__ import annotations

from collections.abc import Callable


def smallest(holds: Callable[[int], bool], maximum: int) -> int | None:
    """Find about the smallest n from 1 to `maximum` for which `holds(n)` is True, by doubling and bisection.

    If `holds` is True for a number, it is assumed to be True for all larger numbers.

    Returns:
        A number for which `holds` is True, up to 1/32 larger than the smallest one; None if `holds(maximum)`
        is False.
    """
    # Doubling: holds(low) is False, holds(high) is True afterwards
    low, high = 0, 1
    while not holds(high):
        if high >= maximum:
            return None
        low, high = high, min(2 * high, maximum)
    # Bisection
    while high - low > max(1, high // 32):
        middle = (low + high) // 2
        if holds(middle):
            high = middle
        else:
            low = middle
    return high
