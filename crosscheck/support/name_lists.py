"""Lists of names in sentences."""

from __future__ import annotations

from collections.abc import Sequence


def first_names(names: Sequence[str], most: int) -> str:
    """List the first names, and the number of the others.

    Args:
        names: the names.
        most: largest number of listed names.

    Examples:
        >>> first_names(["crank", "coupler", "rocker"], most=2)
        'crank, coupler and 1 more'
    """
    others = len(names) - most
    return ", ".join(names[:most]) + (f" and {others} more" if others > 0 else "")
