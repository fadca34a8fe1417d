"""Numbers of differences of two model files in words: values, sizes, and effects on the motion."""

from __future__ import annotations

from crosscheck.differences.difference import Difference, Quantity, Value
from crosscheck.own_run.allowed import length
from crosscheck.report.own_run import angle, percent
from crosscheck.support.units import significant

MAX_PERCENT = 10.0
"""Relative difference from which on a factor takes the place of percent."""

MIN_EFFECT = 1e-6
"""Relative change of accelerations below which a difference has no effect in words."""

MAX_DIGITS = 17
"""Number of digits that tells any two numbers of double precision apart."""

ABSOLUTE = {
    Quantity.CENTER,
    Quantity.INERTIA_AXES,
    Quantity.FRAME,
    Quantity.JOINT_ORIGIN,
    Quantity.JOINT_AXIS,
    Quantity.JOINT_ORIENTATION,
    Quantity.ZERO,
    Quantity.REST,
    Quantity.LIMITS,
    Quantity.LOOP_POINT,
    Quantity.LOOP_AXIS,
    Quantity.LOOP_LENGTH,
    Quantity.SPRING_POINT,
    Quantity.START,
    Quantity.START_SPEED,
    Quantity.TRANSMISSION_OFFSET,
    Quantity.PLACE,
    Quantity.ORIENTATION,
}
"""Quantities whose difference is a length or an angle; that of others is relative."""


def effect_text(row: Difference) -> str:
    """Format the change of accelerations; "none" below round-off, "" if it was not computed."""
    if row.effect is None:
        return ""
    return "none" if row.effect < MIN_EFFECT else change_text(row.effect)


def change_text(change: float) -> str:
    """Format a relative change in percent; a large one as a factor."""
    return percent(change) if change < MAX_PERCENT else f"{_number(change)} times"


def _number(value: float) -> str:
    """Format a number with three digits, and a short exponent from a million on."""
    return significant(value).replace("e+0", "e").replace("e+", "e")


def value_texts(row: Difference) -> tuple[str, str]:
    """Format both values of a difference with six digits, or with as many as show the difference."""
    for digits in range(6, MAX_DIGITS + 1):
        first, second = _value_text(row.first, digits), _value_text(row.second, digits)
        if first != second or row.first == row.second:
            break
    return first, second


def _value_text(value: Value, digits: int) -> str:
    """Format a value of a model file; "none" if it has none."""
    if value is None:
        return "none"
    if isinstance(value, str):
        return value
    numbers = value if isinstance(value, tuple) else (value,)
    return " ".join(f"{number:.{digits}g}" for number in numbers)


def size_text(row: Difference) -> str:
    """Format the size of a difference: a length, an angle, percent or a factor; "" if words differ."""
    has_numbers = not any(value is None or isinstance(value, str) for value in (row.first, row.second))
    if row.quantity is Quantity.PRESENCE or not has_numbers:
        return ""
    is_place = row.quantity is Quantity.SETTING and row.unit
    if row.quantity not in ABSOLUTE and not is_place:
        if row.size < MAX_PERCENT:
            return percent(row.size)
        if isinstance(row.first, float) and isinstance(row.second, float):
            return f"times {_number(row.second / row.first)}"
        return change_text(row.size)
    return length(row.size) if row.unit == "m" else angle(row.size)
