"""Numbers as attributes of MJCF."""

from __future__ import annotations

from collections.abc import Iterable


def number(value: float) -> str:
    """The shortest text that reads back as the same float."""
    return repr(float(value) + 0.0).removesuffix(".0")  # + 0.0 turns -0.0 into 0.0


def numbers(values: Iterable[float]) -> str:
    """Several, with spaces between."""
    return " ".join(number(value) for value in values)
