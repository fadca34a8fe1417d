"""Search for the smallest number that fulfills a monotonic condition."""

from __future__ import annotations

from collections.abc import Callable


def smallest(holds: Callable[[int], bool], most: int) -> int | None:
    """Find the smallest n from 1 to `most` for which `holds(n)` is True, by doubling and bisection.

    If `holds` is True for a number, it is assumed to be True for all larger numbers. The result is up to 1/32
    larger than the smallest number. None if `holds(most)` is False.
    """
    low, high = 0, 1
    while not holds(high):
        if high >= most:
            return None
        low, high = high, min(2 * high, most)
    while high - low > max(1, high // 32):
        middle = (low + high) // 2
        if holds(middle):
            high = middle
        else:
            low = middle
    return high
