"""Rows that have one cause become one row: what remains is what the owner of a file has to look at.

In: rows of single elements, as `crosscheck.differences.rows` finds them. Out: fewer rows. Each hypothesis,
such as "all masses times 1000" or "two elements exchanged", says which rows it explains. The hypothesis that
leaves the fewest rows is taken, again and again, until none explains more than one row.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations, product

import numpy as np

from crosscheck.differences.difference import Difference, Quantity, Standing, Value
from newton_euler.reading.robot import RobotFile
from newton_euler.scalars import Array
from urdf.errors import IN_MEMORY

RATIO_TOLERANCE = 1e-4
"""Relative difference of factors that count as one, such as 2.2046 and 2.20462."""

MASS_UNITS = {1000.0: "kg against g", 2.2046226: "kg against pounds"}
"""Factors between units of mass, with words for the units."""

LENGTH_UNITS = {1000.0: "m against mm", 100.0: "m against cm", 39.370079: "m against inches"}
"""Factors between units of length, with words for the units."""

OTHER_UNITS = {1e6: "m^2 against mm^2", 1e9: "kg m^2 against g mm^2", 180.0 / math.pi: "rad against degrees"}
"""Factors between units of other quantities, with words for the units."""

LACKING = {
    "URDF": (Quantity.ARMATURE, Quantity.STIFFNESS, Quantity.GRAVITY, Quantity.PRESENCE),
    "MJCF": (Quantity.SPEED,),
    IN_MEMORY: (Quantity.STIFFNESS, Quantity.PRESENCE),
}
"""Quantities that no model of a format has; presence is that of drives."""

LENGTHS = (Quantity.CENTER, Quantity.JOINT_ORIGIN, Quantity.LOOP_POINT, Quantity.LOOP_LENGTH)
"""Quantities that grow with all lengths of a robot."""

COLUMNS = (
    Quantity.DAMPING,
    Quantity.ARMATURE,
    Quantity.FRICTION,
    Quantity.STIFFNESS,
    Quantity.LIMITS,
    Quantity.EFFORT,
    Quantity.SPEED,
    Quantity.CONTROL_LIMITS,
    Quantity.FORCE_LIMITS,
)
"""Quantities that a whole file may lack: zero or no limit at every element."""


@dataclass(frozen=True)
class Hypothesis:
    """Rows that one cause explains, and the row that takes their place."""

    explains: frozenset[int]
    row: Difference


def with_causes(
    rows: Iterable[Difference], first: RobotFile, second: RobotFile, tolerance: float | None = None
) -> list[Difference]:
    """Return one row for each cause: true differences, then rounding, then conventions.

    Args:
        rows: rows of single elements, after `with_joint_causes`.
        first, second: the files.
        tolerance: relative difference that counts as rounding; None for the digits of the files.
    """
    by_standing: dict[Standing, list[Difference]] = defaultdict(list)
    for row in rows:
        by_standing[row.standing].append(row)
    different = by_standing[Standing.DIFFERENT]
    formats = first.format, second.format
    hypotheses: list[Callable[[list[Difference]], Iterator[Hypothesis]]] = [
        lambda those: _missing_columns(those, formats),
        _exchanged,
        _scaled_lengths,
        _servo_gains,
        lambda those: _only_in_one(those, formats),
        _same_everywhere,
        _rounded_off,
        _scaled_masses,
        _scaled,
    ]
    while True:
        found = [each for suggest in hypotheses for each in suggest(different)]
        found = [each for each in found if len(each.explains) > 1]
        if not found:
            break
        best = max(found, key=lambda each: len(each.explains))
        position = min(best.explains)
        kept = [row for index, row in enumerate(different) if index not in best.explains]
        different = [*kept[:position], best.row, *kept[position:]]
    allowed = "digits of the files" if tolerance is None else "within the tolerance"
    return [
        *different,
        *_by_quantity(by_standing[Standing.ROUNDING], allowed),
        *_by_cause(by_standing[Standing.CONVENTION]),
    ]


def _by_quantity(rows: list[Difference], cause: str) -> Iterator[Difference]:
    """Yield one row for each quantity of a kind of elements, with the elements of all rows."""
    groups: dict[tuple[str, Quantity], list[Difference]] = defaultdict(list)
    for row in rows:
        groups[row.element_kind, row.quantity].append(row)
    for group in groups.values():
        yield merged_rows(group, cause)


def _by_cause(rows: list[Difference]) -> Iterator[Difference]:
    """Yield one row for each quantity and cause, so that the cause is that of all elements."""
    groups: dict[tuple[object, ...], list[Difference]] = defaultdict(list)
    for row in rows:
        key = row.element_kind, row.quantity, row.cause, row.first is None, row.second is None
        groups[key].append(row)
    for group in groups.values():
        yield merged_rows(group, group[0].cause)


def merged_rows(rows: list[Difference], cause: str) -> Difference:
    """Return the largest of some rows, with the elements of all of them."""
    elements = tuple(dict.fromkeys(name for row in rows for name in row.elements))
    # Six digits: round-off does not decide which of equal rows is shown
    largest = max(rows, key=lambda row: float(f"{row.size:.6g}"))
    consequences = tuple(dict.fromkeys(name for row in rows for name in row.consequences))
    return replace(largest, elements=elements, cause=cause, consequences=consequences)


# Hypotheses


def _numbers(value: Value) -> Array | None:
    """Return a value as an array of finite numbers; None if the value is anything else."""
    if value is None or isinstance(value, str):
        return None
    numbers = np.atleast_1d(np.array(value, dtype=float))
    return numbers if np.isfinite(numbers).all() else None


def _factor(row: Difference) -> float | None:
    """Return the factor from the first to the second value; None if the values are not proportional."""
    first, second = _numbers(row.first), _numbers(row.second)
    if first is None or second is None or len(first) != len(second):
        return None
    square = float(first @ first)
    factor = float(first @ second) / square if square else 0.0
    close = np.linalg.norm(second - factor * first) <= RATIO_TOLERANCE * np.linalg.norm(second)
    return factor if factor and close else None


def _with_one_factor(
    rows: list[Difference], indices: list[int], power: Callable[[Difference], float] = lambda row: 1.0
) -> Iterator[tuple[float, list[int]]]:
    """Yield groups of rows whose values have one factor, and the factor.

    Args:
        rows: all rows.
        indices: of the rows that are looked at.
        power: of the common factor that a row's values have, such as 2 for areas.
    """
    factors = []
    for index in indices:
        factor = _factor(rows[index])
        if factor is not None and factor > 0:
            factors.append((factor ** (1.0 / power(rows[index])), index))
        elif factor is not None and power(rows[index]) == 1.0:
            factors.append((factor, index))
    factors.sort()
    group: list[tuple[float, int]] = []
    for each in [*factors, (math.inf, -1)]:
        if group and not math.isclose(each[0], group[0][0], rel_tol=RATIO_TOLERANCE):
            yield group[len(group) // 2][0], sorted(index for _, index in group)
            group = []
        group.append(each)


def _times(factor: float, units: Mapping[float, str]) -> str:
    """Return a factor in words, with the units that it is between."""
    words = _units(factor, units)
    return f"times {factor:.6g} ({words})" if words else f"times {factor:.6g}"


def _units(factor: float, units: Mapping[float, str]) -> str:
    """Return words for the units that a factor is between; "" for other factors."""
    for known, words in units.items():
        if math.isclose(factor, known, rel_tol=1e-3) or math.isclose(factor, 1.0 / known, rel_tol=1e-3):
            return words
    return ""


def _lack(format: str, quantity: Quantity) -> str:
    """Return words for a quantity that no model of a format has; "" for other quantities."""
    return f"; {format} has none" if quantity in LACKING.get(format, ()) else ""


def _missing_columns(rows: list[Difference], formats: tuple[str, str]) -> Iterator[Hypothesis]:
    """Suggest that one file lacks a quantity that the other file has at many elements."""
    for quantity in COLUMNS:
        for where, other in ((0, 1), (1, 0)):
            group = [
                index
                for index, row in enumerate(rows)
                if row.quantity == quantity
                and (row.first, row.second)[other] in (None, 0.0)
                and (row.first, row.second)[where] not in (None, 0.0)
            ]
            if len(group) < 2:
                continue
            values = [_numbers((rows[index].first, rows[index].second)[where]) for index in group]
            finite = np.concatenate([value for value in values if value is not None] or [np.zeros(1)])
            span = f"{finite.min():.4g}" + (f" to {finite.max():.4g}" if np.ptp(finite) else "")
            cause = _lack(formats[other], quantity).removeprefix("; ") or "only in one robot"
            found = merged_rows([rows[index] for index in group], cause)
            found = replace(found, first=span) if where == 0 else replace(found, second=span)
            yield Hypothesis(frozenset(group), found)


def _scaled_masses(rows: list[Difference]) -> Iterator[Hypothesis]:
    """Suggest that masses, and inertias with them, are times one factor."""
    indices = [i for i, row in enumerate(rows) if row.quantity == Quantity.MASS and not row.cause]
    for factor, group in _with_one_factor(rows, indices):
        elements = {rows[index].element for index in group}
        inertias = [
            index
            for index, row in enumerate(rows)
            if row.quantity == Quantity.INERTIA
            and row.element in elements
            and (own := _factor(row))
            and math.isclose(own, factor, rel_tol=10 * RATIO_TOLERANCE)
        ]
        if len(group) == 1 and Quantity.CENTER in {row.quantity for row in rows if row.element in elements}:
            # A body of another shape
            continue
        words = f"{len(group)} masses" if len(group) > 1 else "mass"
        words += (" and inertias" if len(group) > 1 else " and inertia") if inertias else ""
        row = merged_rows([rows[index] for index in group], f"{words} {_times(factor, MASS_UNITS)}")
        yield Hypothesis(frozenset([*group, *inertias]), row)


def _scaled_lengths(rows: list[Difference]) -> Iterator[Hypothesis]:
    """Suggest that all lengths, and inertias with their squares, are times one factor."""
    indices = [i for i, row in enumerate(rows) if row.quantity in LENGTHS or row.quantity == Quantity.INERTIA]
    for factor, group in _with_one_factor(
        rows, indices, lambda row: 2.0 if row.quantity == Quantity.INERTIA else 1.0
    ):
        lengths = [rows[index] for index in group if rows[index].quantity in LENGTHS]
        if len(lengths) >= 3 and len({row.quantity for row in lengths}) > 1:
            row = merged_rows(lengths, f"{len(lengths)} lengths {_times(factor, LENGTH_UNITS)}")
            yield Hypothesis(frozenset(group), row)


def _scaled(rows: list[Difference]) -> Iterator[Hypothesis]:
    """Suggest that one quantity of many elements is times one factor."""
    by_quantity: dict[Quantity, list[int]] = defaultdict(list)
    for index, row in enumerate(rows):
        if not row.cause or row.quantity not in (Quantity.MASS, Quantity.INERTIA):
            by_quantity[row.quantity].append(index)
    for quantity, indices in by_quantity.items():
        if quantity in (Quantity.SIGN, Quantity.ZERO, Quantity.JOINT_AXIS, Quantity.GRAVITY):
            continue
        for factor, group in _with_one_factor(rows, indices):
            if len(group) > 2:
                those = [rows[index] for index in group]
                kind = those[0].element_kind
                times = _times(factor, OTHER_UNITS)
                row = merged_rows(those, f"{quantity} of {len(group)} {_plural(kind)} {times}")
                yield Hypothesis(frozenset(group), row)


def _servo_gains(rows: list[Difference]) -> Iterator[Hypothesis]:
    """Suggest that the gain of a servo follows its kp, or that all numbers of a drive follow the gear."""
    for one, other in combinations(range(len(rows)), 2):
        pair = {rows[index].quantity: index for index in (one, other)}
        same = rows[one].element_kind == rows[other].element_kind == "drive"
        if same and rows[one].element == rows[other].element and pair.keys() == {Quantity.GAIN, Quantity.KP}:
            factors = [_factor(rows[index]) for index in (one, other)]
            if None not in factors and math.isclose(*factors, rel_tol=RATIO_TOLERANCE):  # type: ignore[arg-type]
                yield Hypothesis(frozenset((one, other)), rows[pair[Quantity.KP]])


def _rounded_off(rows: list[Difference]) -> Iterator[Hypothesis]:
    """Suggest that one file has the numbers of the other one with few decimals."""
    for quantities in ((Quantity.MASS,), LENGTHS):
        for decimals, (coarse, fine, name) in product((2, 3, 4, 5), ((0, 1, "first"), (1, 0, "second"))):
            group = []
            for index, row in enumerate(rows):
                values = [_numbers(value) for value in (row.first, row.second)]
                if row.quantity in quantities and _is_rounded(values[fine], values[coarse], decimals):
                    group.append(index)
            # zeros alone are numbers that one file lacks
            has_numbers = any(np.any(_numbers((rows[k].first, rows[k].second)[coarse])) for k in group)
            if has_numbers and len({rows[index].element for index in group}) > 2:
                cause = f"{len(group)} numbers are rounded to {decimals} decimals in the {name} file"
                yield Hypothesis(frozenset(group), merged_rows([rows[index] for index in group], cause))


def _is_rounded(fine: Array | None, coarse: Array | None, decimals: int) -> bool:
    """Return whether numbers are other numbers with some decimals."""
    if fine is None or coarse is None or len(fine) != len(coarse):
        return False
    unit = 10.0**-decimals
    is_short = np.abs(np.round(coarse, decimals) - coarse).max() < 1e-3 * unit
    # of two numbers that are as near, such as 0.01 and 0.02 for 0.015, tools choose either
    return bool(is_short and np.abs(fine - coarse).max() < 0.501 * unit)


def _exchanged(rows: list[Difference]) -> Iterator[Hypothesis]:
    """Suggest that two elements have each other's numbers."""
    of_element: dict[tuple[str, str], dict[Quantity, int]] = defaultdict(dict)
    for index, row in enumerate(rows):
        if len(row.elements) == 1 and row.quantity is not Quantity.PRESENCE:
            of_element[row.element_kind, row.element][row.quantity] = index
    explained: set[int] = set()
    names: list[str] = []
    for (key, own), (other_key, other) in combinations(of_element.items(), 2):
        if key[0] != other_key[0] or own.keys() != other.keys() or explained & {*own.values()}:
            continue
        if own.keys() == {Quantity.INERTIA_AXES}:
            # Left and right differ alike
            continue
        pairs = [(rows[own[quantity]], rows[other[quantity]]) for quantity in own]
        if all(_are_exchanged(a, b) for a, b in pairs):
            explained.update(own.values(), other.values())
            names.extend((key[1], other_key[1]))
    if explained:
        those = [rows[index] for index in sorted(explained)]
        pairs_of_names = [f"{a} and {b}" for a, b in zip(names[::2], names[1::2], strict=True)]
        row = merged_rows(those, f"exchanged: {', '.join(pairs_of_names)}")
        row = replace(those[0], elements=tuple(names), cause=row.cause, consequences=row.consequences)
        yield Hypothesis(frozenset(explained), row)


def _are_exchanged(row: Difference, other: Difference) -> bool:
    """Return whether two elements have each other's values of one quantity."""
    if row.quantity == Quantity.INERTIA_AXES:
        # The axes themselves are not part of the row
        return _same(row.size, other.size)
    return _same(row.first, other.second) and _same(row.second, other.first)


def _same(value: Value, other: Value) -> bool:
    """Return whether two values are equal to six digits."""
    first, second = _numbers(value), _numbers(other)
    if first is None or second is None or len(first) != len(second):
        return value == other
    return bool(np.linalg.norm(second - first) <= 1e-5 * np.linalg.norm(first))


def _only_in_one(rows: list[Difference], formats: tuple[str, str]) -> Iterator[Hypothesis]:
    """Suggest that one file has elements of a kind that the other file lacks."""
    groups: dict[tuple[str, bool], list[int]] = defaultdict(list)
    for index, row in enumerate(rows):
        if row.quantity == Quantity.PRESENCE:
            groups[row.element_kind, row.second is None].append(index)
    for (kind, in_first), group in groups.items():
        those = [rows[index] for index in group]
        lack = _lack(formats[1 if in_first else 0], Quantity.PRESENCE) if kind == "drive" else ""
        cause = lack.removeprefix("; ")
        yield Hypothesis(frozenset(group), merged_rows(those, cause))


def _same_everywhere(rows: list[Difference]) -> Iterator[Hypothesis]:
    """Suggest that several elements, also on the left and on the right, have the same difference."""
    groups: dict[tuple[object, ...], list[int]] = defaultdict(list)
    for index, row in enumerate(rows):
        if row.quantity != Quantity.PRESENCE:
            what = row.cause if row.quantity is Quantity.SETTING else row.quantity
            key = (row.element_kind, what, row.unit, *_without_side(row))
            groups[key].append(index)
    for group in groups.values():
        those = [rows[index] for index in group]
        same = f"the same at {len(those)} {_plural(those[0].element_kind)}"
        factor = _factor(those[0])
        if factor is not None and _units(factor, OTHER_UNITS):
            elements = f"{len(those)} {_plural(those[0].element_kind)}"
            same = f"{those[0].quantity} of {elements} {_times(factor, OTHER_UNITS)}"
        cause = "; ".join(dict.fromkeys(row.cause for row in those if row.cause)) or same
        yield Hypothesis(frozenset(group), merged_rows(those, cause))


def _without_side(row: Difference) -> tuple[object, ...]:
    """Return both values, equal for an element on the left and its mirror image on the right."""
    first, second = row.first, row.second
    if row.quantity is Quantity.SHAPE:  # all meshes that a tool has simplified have one cause
        return ()
    if row.quantity == Quantity.LIMITS:
        mirrored = tuple(
            value and tuple(-number for number in reversed(value)) if isinstance(value, tuple) else value
            for value in (first, second)
        )
        return min((_rounded(first), _rounded(second)), tuple(map(_rounded, mirrored)), key=str)
    if row.quantity in (*LENGTHS, Quantity.JOINT_AXIS, Quantity.PLACE):
        first, second = (
            tuple(map(abs, value)) if isinstance(value, tuple) else value for value in (first, second)
        )
    return _rounded(first), _rounded(second)


def _rounded(value: Value) -> object:
    """Return a value with its numbers rounded to five digits."""
    if isinstance(value, tuple):
        return tuple(float(f"{number:.5g}") + 0.0 for number in value)
    return float(f"{value:.5g}") + 0.0 if isinstance(value, float) else value


def _plural(kind: str) -> str:
    """Return the plural of a kind of element."""
    return "bodies" if kind == "body" else f"{kind}es" if kind.endswith(("box", "mesh")) else f"{kind}s"
