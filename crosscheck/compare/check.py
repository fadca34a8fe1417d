"""Checks of a comparison: a value, its tolerance, and its level."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from crosscheck.support.errors import CrosscheckError
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array

READING = "reading"
"""Level of the verification of an imported scene against its model file, before the levels of engines."""

OF_EQUATIONS = ("model", "kinematics", "dynamics", "accelerations and reactions")

OF_RUNS = ("trajectories", "drift", "energy")
"""Levels of whole runs; the other levels compare equations."""

LEVELS = (READING, *OF_EQUATIONS, *OF_RUNS)

REFERENCE = "reference"
"""Level of reference values, after all others."""

FILE = "file"
"""Name of the model file in checks of the level `READING`, see `newton_euler.reading.verify`."""

POSES = ("positions, m", "orientations, rad")
"""Quantities at the level "trajectories"."""

CONSTRAINT_VIOLATION = "constraint violation, m or rad"
"""Quantity at the level "drift"."""

START = "start"
"""Level after "model" if two models are compared, since each model has its own initial state."""

OWN_ERROR = 4.0
"""Error of a run in units of its change in a finer run: 3 times 4/3.

If half the step leaves a quarter of the error (order 2), the error is 4/3 of the change. If half the step
leaves half of the error (order 1), the error is twice the change; with a hundred times tighter tolerances, it
is the change.
"""

UNRESOLVED = 1e-2
"""Largest tolerance that a refinement can add, relative to reach, 1 rad or energy."""

EPSILON = float(np.finfo(float).eps)

ROUND_OFF = 1e-12
"""Relative round-off of some hundred operations on numbers with 17 digits. The differences between engines in
the scenes of the library are up to a fiftieth of it."""

MIN_VALUE_DIGITS, MAX_VALUE_DIGITS = 4, 17
"""Significant digits of values in texts."""

NOISE = 10.0
"""Difference caused by a nearly redundant constraint, in units of its singular value: different forms of the
equations omit different combinations of rows."""


def round_off(condition: float, noise: float = 0.0) -> float:
    """Return the relative tolerance for round-off that a condition number magnifies.

    Args:
        condition: condition number.
        noise: largest singular value that was taken as redundant; motions are not determined better than
            that.
    """
    return min(max(ROUND_OFF, NOISE * noise) * condition, UNRESOLVED)


@dataclass(frozen=True)
class Check:
    """A compared value, its tolerance, and the place of the largest difference.

    Attributes:
        level: one of `LEVELS`, or `START`.
        quantity: compared quantity, with its unit.
        between: one or two names of engines or systems, or an engine and `FILE`.
        value, tolerance: value, and the largest value that passes.
        where: body, joint, term or time of the largest difference.
        judged: False for a check without a verdict: it describes an engine, or could not be resolved.
        unconverged: engine whose error does not decrease in a refined run, so that the check is not judged;
            empty if there is none.
        detail: the values that differ, as text; empty if unknown.
    """

    level: str
    quantity: str
    between: tuple[str, ...]
    value: float
    tolerance: float
    where: str
    judged: bool = True
    unconverged: str = ""
    detail: str = ""

    @property
    def place(self) -> str:
        """Place of the largest difference, with the values that differ."""
        return f"{self.where}: {self.detail}" if self.detail else self.where

    @property
    def agrees(self) -> bool:
        """True if the check passes or has no verdict; NaN does not pass."""
        return not self.judged or bool(self.value <= self.tolerance)

    @property
    def tolerance_ratio(self) -> float:
        """Value divided by tolerance; NaN if the value is NaN."""
        if self.tolerance > 0.0:
            return self.value / self.tolerance
        return 0.0 if self.value == 0.0 else self.value * np.inf


def both_values(pair: tuple[str, str], one: ArrayLike, two: ArrayLike, unit: str) -> str:
    """Format two values after the names of their owners, with as many digits as they need to differ.

    Args:
        pair: names of the owners.
        one, two: numbers, vectors or matrices; of matrices the rows that differ most are shown.
        unit: unit of the values.
    """
    values = np.array([np.atleast_1d(one), np.atleast_1d(two)], dtype=float)
    if values.ndim == 3:
        values = values[:, int(np.nanargmax(np.abs(values[0] - values[1]).max(axis=1)))]
    values[np.abs(values) < ROUND_OFF * np.nanmax(np.abs(values))] = 0.0
    texts: list[str] = []
    for digits in range(MIN_VALUE_DIGITS, MAX_VALUE_DIGITS + 1):
        texts = [" ".join(f"{number:.{digits}g}" for number in value) for value in values]
        if texts[0] != texts[1]:
            break
    return f"{pair[0]} {texts[0]}, {pair[1]} {texts[1]} {unit}".rstrip()


def worst_check(
    level: str, quantity: str, between: tuple[str, ...], gap: Array, tolerance: float, names: Sequence[str]
) -> Check:
    """Make the check of the largest gap.

    Args:
        level, quantity, between, tolerance: attributes of the check.
        gap: (n,) gaps of n elements, or (m, n) at m states.
        names: (n,) names of the elements.
    """
    each = gap.max(axis=0) if gap.ndim == 2 else gap
    where = int(np.argmax(each))
    return Check(level, quantity, between, float(each[where]), tolerance, names[where])


def in_full(parts: Iterable[Iterator[Check]]) -> Iterator[Check]:
    """Yield the checks of all parts, and then raise the first error that ended a part."""
    errors = []
    for part in parts:
        try:
            yield from part
        except Exception as error:
            errors.append(error)
    if errors:
        raise errors[0]


def not_judged(rows: Sequence[Check]) -> str:
    """Report the number of checks that are not judged, and why; empty if there are none."""
    found = [row.unconverged for row in rows if row.unconverged]
    count = "1 more check is" if len(found) == 1 else f"{len(found)} more checks are"
    return f"; {count} not judged: {unconverged_reason(found)}" if found else ""


def unconverged_reason(engines: Iterable[str]) -> str:
    """Report why checks are not judged: a refined run does not reduce the difference as its error would."""
    return f"a finer run of {' and '.join(dict.fromkeys(engines))} reduces the difference too little"


def not_compared(rows: Sequence[Check]) -> Iterator[str]:
    """Yield a line for each level at which pairs differ: the following levels were not compared."""
    levels = ("model", START, *OF_EQUATIONS[1:], *OF_RUNS)
    pairs = (row.between for row in rows if len(row.between) == 2 and FILE not in row.between)
    parted: dict[str, list[Sequence[str]]] = {}
    for between in dict.fromkeys(pairs):
        failed = [row for row in rows if row.between == between and not row.agrees]
        last = max((levels.index(row.level) for row in failed), default=len(levels) - 1)
        if last + 1 < len(levels):
            parted.setdefault(levels[last], []).append(between)
    for level, found in parted.items():
        words = "; ".join(" and ".join(between) for between in found)
        shared = set(found[0]).intersection(*found[1:])
        if len(shared) == 1:
            (one,) = shared
            others = [name for between in found for name in between if name != one]
            words = f"{one} with {' and '.join(others)}"
        yield f"not compared after {level!r}: {words}"


def reach(scene: Scene, position: Array) -> float:
    """Return the larger of the mechanism's size and the largest distance of positions (..., 3) from the
    origin, m.

    The round-off of coordinates is proportional to the reach.
    """
    return max(scene.mechanism.size, float(np.max(np.abs(position))))


def finite(rows: Iterable[Check]) -> Iterator[Check]:
    """Yield the finite checks; then raise `CrosscheckError` for the first check that is not finite."""
    wrong = []
    for row in rows:
        if np.isfinite(row.value):
            yield row
        else:
            wrong.append(row)
    for row in wrong:
        raise CrosscheckError(
            f"no check of {row.quantity} at level {row.level!r} between "
            f"{' and '.join(row.between)}: {row.value:g} at {row.where}"
        )
