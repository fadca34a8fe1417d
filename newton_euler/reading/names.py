"""Names of the elements of a model file, also of those that the file leaves without name."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence


def unique_names(given: Sequence[str], others: Iterable[str]) -> list[str]:
    """Return names that tell elements of one kind apart.

    Args:
        given: names in the file; "" for an element without name.
        others: for each element, its name if the file gives none.

    Returns:
        names as given, and the others; a name that is taken already has a number.

    Examples:
        >>> unique_names(["", "arm", ""], ["arm", "hand", "arm"])
        ['arm (2)', 'arm', 'arm (3)']
    """
    taken = {name for name in given if name}
    seen: set[str] = set()
    found = []
    for name, other in zip(given, others, strict=True):
        free = name if name and name not in seen else _free_name(name or other, taken)
        seen.add(free)
        taken.add(free)
        found.append(free)
    return found


def _free_name(name: str, taken: set[str]) -> str:
    """Return a name, with a number if it is taken."""
    if name not in taken:
        return name
    number = 2
    while f"{name} ({number})" in taken:
        number += 1
    return f"{name} ({number})"


def body_names(given: Sequence[str]) -> list[str]:
    """Return names of bodies, by number if the file gives none; the first body is 1, as in MuJoCo.

    Examples:
        >>> body_names(["base", "", "hand"])
        ['base', 'body 2', 'hand']
    """
    return unique_names(given, (f"body {number}" for number in range(1, len(given) + 1)))


def names_by_kind(elements: Sequence[str]) -> str:
    """List elements in one short text: the first one of each kind, and how many more there are.

    Args:
        elements: elements such as "<limit> of joint 'elbow'". They are of one kind if they differ only in
            what stands in quotation marks.

    Examples:
        >>> names_by_kind(["arm 'left'", "hand", "arm 'right'"])
        "arm 'left' and 1 more, hand"
    """
    kinds: dict[str, list[str]] = {}
    for element in elements:
        kinds.setdefault(re.sub("'[^']*'", "", element), []).append(element)
    return ", ".join(f"{first} and {len(more)} more" if more else first for first, *more in kinds.values())
