"""Checks that a comparison yields, each with its tolerance, at one of the levels."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from newton_euler.model.scene import Scene
from newton_euler.scalars import Array

READING = "reading"
"""The level before those of engines: what a file says."""

OF_EQUATIONS = ("model", "kinematics", "dynamics", "accelerations and reactions")

OF_RUNS = ("trajectories", "drift", "energy")
"""Levels of whole runs; those before are of models."""

LEVELS = (READING, *OF_EQUATIONS, *OF_RUNS)

REFERENCE = "reference"
"""The level after all others: checks that are known from elsewhere."""

FILE = "file"
"""What engines are compared with at the level `READING`, see `newton_euler.reading.verify`."""

POSES = ("positions, m", "orientations, rad")
"""Quantities of trajectories."""

OPEN = "open joints, m or rad"
"""Quantity of drift."""

START = "start"
"""Of two models, the level after "model": engines start from one scene, models where each file says."""

OWN_ERROR = 4.0
"""Share of the difference between a run and a finer one that the run may be off: three times 4/3, which
is its error where half a step leaves a quarter of it. Where it leaves half, its error is twice the
difference; where error control is a hundred times tighter, the difference itself."""

UNRESOLVED = 1e-2
"""Largest share of reach, 1 rad or energy that a refinement may excuse."""


EPSILON = float(np.finfo(float).eps)

ROUND_OFF = 1e-12
"""Relative: numbers written with 17 digits and rotated a few times, and some hundred operations in a row,
each to 1e-16. Engines lose a fiftieth of it in the scenes of the library."""


FEWEST_DIGITS, MOST_DIGITS = 4, 17
"""Of values in words."""

NOISE = 10.0
"""Difference that a nearly redundant constraint makes in units of its singular value: each form of the
equations omits another combination of rows."""


def round_off(condition: float, noise: float = 0.0) -> float:
    """Relative difference that double precision may make where a condition number magnifies it.

    Nor are motions determined better than the largest singular value that was taken as redundant, `noise`.
    """
    return min(max(ROUND_OFF, NOISE * noise) * condition, UNRESOLVED)


@dataclass(frozen=True)
class Check:
    """A compared value, its tolerance, and where it is worst.

    Attributes:
        level: one of `LEVELS`, or `START`.
        quantity: what is compared, with its unit.
        between: the engines or systems compared, one or two; or an engine and `FILE`.
        value, tolerance: the check and what it may be at most, or usually is where it only informs.
        where: the body, joint, term or time of the largest difference.
        informs: a check that says how an engine works and is not judged.
        unsettled: the engine whose error does not fall where its step or tolerance is refined, so that the
            figure is not judged; empty if there is none.
        detail: the values that differ there, in words, as far as they are known.
    """

    level: str
    quantity: str
    between: tuple[str, ...]
    value: float
    tolerance: float
    where: str
    judged: bool = True
    unsettled: str = ""
    detail: str = ""

    @property
    def place(self) -> str:
        """The place, and the values that differ there."""
        return f"{self.where}: {self.detail}" if self.detail else self.where

    @property
    def agrees(self) -> bool:
        """NaN does not agree with anything."""
        return not self.judged or bool(self.value <= self.tolerance)

    @property
    def share(self) -> float:
        """The value in units of the tolerance, which may be 0; of NaN it is NaN."""
        if self.tolerance > 0.0:
            return self.value / self.tolerance
        return 0.0 if self.value == 0.0 else self.value * np.inf


def both_values(pair: tuple[str, str], one: ArrayLike, two: ArrayLike, unit: str) -> str:
    """Word two different numbers or vectors, each after whose it is, in as many digits as they differ in.

    Of matrices the rows that differ most.
    """
    values = np.array([np.atleast_1d(one), np.atleast_1d(two)], dtype=float)
    if values.ndim == 3:
        values = values[:, int(np.nanargmax(np.abs(values[0] - values[1]).max(axis=1)))]
    values[np.abs(values) < ROUND_OFF * np.nanmax(np.abs(values))] = 0.0
    texts: list[str] = []
    for digits in range(FEWEST_DIGITS, MOST_DIGITS + 1):
        texts = [" ".join(f"{number:.{digits}g}" for number in value) for value in values]
        if texts[0] != texts[1]:
            break
    return f"{pair[0]} {texts[0]}, {pair[1]} {texts[1]} {unit}".rstrip()


def worst_figure(
    level: str, quantity: str, between: tuple[str, ...], gap: Array, tolerance: float, names: Sequence[str]
) -> Check:
    """The largest of gaps (n,), or (m, n) at m states, of what goes by n names."""
    each = gap.max(axis=0) if gap.ndim == 2 else gap
    where = int(np.argmax(each))
    return Check(level, quantity, between, float(each[where]), tolerance, names[where])


def in_full(parts: Iterable[Iterator[Check]]) -> Iterator[Check]:
    """The rows of all parts, each as far as it goes; then raises the first error that ended one."""
    errors = []
    for part in parts:
        try:
            yield from part
        except Exception as error:
            errors.append(error)
    if errors:
        raise errors[0]


def not_judged(rows: Sequence[Check]) -> str:
    """Word the checks that are not judged for a verdict; empty if there are none."""
    found = [row.unsettled for row in rows if row.unsettled]
    count = "1 more check is" if len(found) == 1 else f"{len(found)} more checks are"
    return f"; {count} not judged: {not_settled(found)}" if found else ""


def not_settled(engines: Iterable[str]) -> str:
    """Word why a check is not judged: a finer run is not nearer by as much as its own error would be."""
    return f"a finer run of {' and '.join(dict.fromkeys(engines))} reduces the difference too little"


def not_compared(rows: Sequence[Check]) -> Iterator[str]:
    """A line for each level at which pairs part: those after it were not compared."""
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
    """The size of a mechanism or how far (..., 3) positions lie from the origin, whichever is larger, m.

    Coordinates carry round-off in proportion to it.
    """
    return max(scene.mechanism.size, float(np.max(np.abs(position))))
