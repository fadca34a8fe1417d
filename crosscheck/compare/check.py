"""Checks: each compares one value with its tolerance, for a pair of engines or for a single engine.

A level is a group of checks, such as "dynamics"; levels follow each other from the model to whole simulations
(runs). The comparison modules of this package make checks; the diagnosis, the verdict and the reports read
them. This module also has the tolerances that several levels use and the sentences about checks that were not
made or are not judged (can neither pass nor fail).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from crosscheck.compare.note import Note
from crosscheck.engines.engine import MAX_RELATIVE_ERROR
from crosscheck.support.errors import CrosscheckError
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array

READING = "reading"
"""Level that compares an imported scene with its model file, before the levels that compare engines."""

LEVELS_OF_EQUATIONS = ("model", "kinematics", "dynamics", "accelerations and reactions")
"""Levels that compare the equations of motion of two engines at given states, in their order."""

LEVELS_OF_RUNS = ("trajectories", "drift", "energy")
"""Levels that compare whole simulations (runs), in their order."""

LEVELS = (READING, *LEVELS_OF_EQUATIONS, *LEVELS_OF_RUNS)
"""All levels of a comparison of engines, in their order."""

REFERENCE = "reference"
"""Level of reference values (published or exact results), after all others."""

FILE = "file"
"""Name that stands for the model file in checks of the level `READING`."""

POSES = ("positions, m", "orientations, rad")
"""Quantities at the level "trajectories": positions and orientations of all bodies."""

REACTIONS = ("reaction force, rel", "reaction torque, rel")
"""Quantities of joint reactions, relative to the largest reaction: at the level "accelerations and reactions"
or, for engines without equations of motion, at the level "trajectories"."""

CONSTRAINT_VIOLATION = "constraint violation, m or rad"
"""Quantity at the level "drift": largest residual of the joint constraints in a run."""

MOMENTUM_BALANCE = "momentum balance, rel"
"""Quantity of a check of one engine: residual of Newton's and Euler's equations of each body. The check tests
the engine's equations of motion, although its level is "energy" like that of checks of runs."""

ERROR_PER_CHANGE = 4.0
"""Bound on the error of a run, divided by the change between the run and a refined run.

Refined means half the step or a hundred times tighter tolerances. For half the step, the error is 4/3 of the
change with a method of order 2, and twice the change with a method of order 1. For tighter tolerances, the
error is about equal to the change. The bound is three times 4/3, with three as a margin.
"""

MACHINE_EPSILON = float(np.finfo(float).eps)
"""Distance from 1 to the next double precision number."""

ROUND_OFF = 1e-12
"""Relative round-off of some hundred operations in double precision. In the scenes of the library, engines
differ by at most a fiftieth of this number."""

MIN_VALUE_DIGITS, MAX_VALUE_DIGITS = 4, 17
"""Range of the number of significant digits of values in texts."""

NOISE_FACTOR = 10.0
"""Relative difference of two engines that a nearly redundant constraint causes, divided by the singular value
of that constraint. Each engine omits one of the nearly redundant equations, not always the same one, and
satisfies the others exactly."""


def round_off(condition: float, noise: float = 0.0) -> float:
    """Return the relative tolerance for round-off that a condition number magnifies.

    Args:
        condition: condition number of the matrices of the equations that are solved.
        noise: relative error of the constraints themselves, such as the largest singular value that is
            treated as redundant. Motions are not determined better than that.
    """
    return min(max(ROUND_OFF, NOISE_FACTOR * noise) * condition, MAX_RELATIVE_ERROR)


@dataclass(frozen=True)
class Check:
    """A compared value, its tolerance, and the place of the largest difference.

    Attributes:
        level: group of the check: "reading", "model", "kinematics", "dynamics", "accelerations and
            reactions", "trajectories", "drift", "energy" or "reference".
        quantity: compared quantity, with its unit.
        between: one or two names of engines or systems (formulations of an engine), or an engine and "file".
        value, tolerance: value, and the largest value that passes.
        where: body, joint, term or time of the largest difference.
        judged: False for a check that can neither pass nor fail: the value is for information only (such as a
            condition number), or an engine is `unconverged`.
        unconverged: name of the engine whose refined run reduces the value too little;
            such a check is not judged. Empty if there is none.
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
        """Place of the largest difference, with the values that differ, for messages."""
        return f"{self.where}: {self.detail}" if self.detail else self.where

    @property
    def agrees(self) -> bool:
        """True if the check passes or is not judged; NaN does not pass."""
        return not self.judged or bool(self.value <= self.tolerance)

    @property
    def tolerance_ratio(self) -> float:
        """Value divided by tolerance; NaN if the value is NaN."""
        if self.tolerance > 0.0:
            return self.value / self.tolerance
        return 0.0 if self.value == 0.0 else self.value * np.inf


def both_values(pair: tuple[str, str], one: ArrayLike, two: ArrayLike, unit: str) -> str:
    """Format the values of two engines, with enough digits to show the difference.

    Args:
        pair: names of the two engines.
        one, two: their values: numbers, vectors or matrices. For matrices, only the row with the largest
            difference is shown.
        unit: unit of the values.
    """
    values = np.array([np.atleast_1d(one), np.atleast_1d(two)], dtype=float)
    if values.ndim == 3:  # matrices: keep the row that differs most
        values = values[:, int(np.nanargmax(np.abs(values[0] - values[1]).max(axis=1)))]
    values[np.abs(values) < ROUND_OFF * np.nanmax(np.abs(values))] = 0.0
    texts: list[str] = []
    for digits in range(MIN_VALUE_DIGITS, MAX_VALUE_DIGITS + 1):
        texts = [" ".join(f"{number:.{digits}g}" for number in value) for value in values]
        if texts[0] != texts[1]:
            break
    return f"{pair[0]} {texts[0]}, {pair[1]} {texts[1]} {unit}".rstrip()


def chain_despite_errors(parts: Iterable[Iterator[Check]]) -> Iterator[Check]:
    """Yield the checks of all generators, even if some stop with an error; then raise the first error."""
    errors = []
    for part in parts:
        try:
            yield from part
        except Exception as error:
            errors.append(error)
    if errors:
        raise errors[0]


def not_judged(checks: Sequence[Check]) -> str:
    """Report how many checks are not judged because an engine is unconverged, and why; empty if none."""
    engines = [check.unconverged for check in checks if check.unconverged]
    count = "1 more check is" if len(engines) == 1 else f"{len(engines)} more checks are"
    return f"; {count} not judged: {unconverged_reason(engines)}" if engines else ""


def unconverged_reason(engines: Iterable[str]) -> str:
    """Report why checks are not judged: refined runs of these engines reduce the difference too little."""
    return f"a finer run of {' and '.join(dict.fromkeys(engines))} reduces the difference too little"


def not_compared(checks: Sequence[Check]) -> Iterator[str]:
    """Yield a line for each level at which pairs of engines differ: a pair that differs is not compared at
    later levels."""
    # Group the pairs by the last level at which they differ
    levels = LEVELS[1:]  # the first one compares engines with the model file
    pairs = (check.between for check in checks if len(check.between) == 2 and FILE not in check.between)
    pairs_by_level: dict[str, list[Sequence[str]]] = {}
    for pair in dict.fromkeys(pairs):
        failed = [check for check in checks if check.between == pair and not check.agrees]
        last = max((levels.index(check.level) for check in failed), default=len(levels) - 1)
        if last + 1 < len(levels):
            pairs_by_level.setdefault(levels[last], []).append(pair)
    for level, differing in pairs_by_level.items():
        words = "; ".join(" and ".join(pair) for pair in differing)
        # If all pairs of a level have one engine in common, name that engine once
        shared = set(differing[0]).intersection(*differing[1:])
        if len(shared) == 1:
            (common,) = shared
            others = [name for pair in differing for name in pair if name != common]
            words = f"{common} with {' and '.join(others)}"
        yield f"{Note.NOT_COMPARED} {level!r}: {words}"


def reach(scene: Scene, position: Array) -> float:
    """Return the reach, m: the mechanism's size, or the largest coordinate of any position if that is larger.

    The round-off of coordinates is proportional to the reach.

    Args:
        scene: the scene with the mechanism.
        position: (..., 3) positions in the world frame, m.
    """
    return max(scene.mechanism.size, float(np.max(np.abs(position))))


def require_finite(checks: Iterable[Check]) -> Iterator[Check]:
    """Yield the checks with finite values; then raise `CrosscheckError` for the first other check."""
    not_finite = []
    for check in checks:
        if np.isfinite(check.value):
            yield check
        else:
            not_finite.append(check)
    if not_finite:
        first = not_finite[0]
        raise CrosscheckError(
            f"no check of {first.quantity} at level {first.level!r} between "
            f"{' and '.join(first.between)}: {first.value:g} at {first.where}"
        )
