"""The smallest number that suffices."""

from __future__ import annotations

from collections.abc import Callable


def smallest(holds: Callable[[int], bool], most: int) -> int | None:
    """Return the smallest n from 1 to `most` that holds, within a 32nd, by doubling and bisection.

    All larger ones are taken to hold too, as they do for numbers of steps. None if none does.
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
