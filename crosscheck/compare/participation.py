"""Participation of engines in checks: how many compare an engine with another one, and levels without it.

Not every engine is compared at every level. An engine without equations of motion is compared by its runs
only, and an engine that stopped before its first output has no run. Pairs of engines that differ are not
compared at later levels. In: the engines and the checks of a comparison. Out: a `Participation` per engine.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from crosscheck.compare.check import FILE, LEVELS, LEVELS_OF_EQUATIONS, LEVELS_OF_RUNS, Check
from crosscheck.compare.diagnosis import FORMULATION_NAMES, SOLVER_NAME


class Participation(NamedTuple):
    """Numbers of checks that an engine takes part in.

    Attributes:
        with_engines: number of judged checks that compare the engine with another engine.
        with_file: number of judged checks that compare the engine with the model file.
        alone: number of judged checks of the engine by itself, such as its energy balance or the comparison
            of its formulations with each other.
        not_judged: number of checks with another engine that are not judged since an engine is unconverged.
        no_part_in: levels that have checks of other engines, and none of this engine.
    """

    with_engines: int
    with_file: int
    alone: int
    not_judged: int
    no_part_in: tuple[str, ...]


def participation(engines: Sequence[str], checks: Sequence[Check]) -> dict[str, Participation]:
    """Count the checks of each engine, and find the levels in which it has no part.

    The engines of a check that is not judged have a part in its level, if one of them is unconverged. Checks
    for information, such as condition numbers, do not count.

    Args:
        engines: names of the engines.
        checks: all checks.
    """
    compared = [(check, _parties(check)) for check in checks if check.judged or check.unconverged]
    levels = [level for level in LEVELS if any(check.level == level for check, _ in compared)]
    found = {}
    for engine in engines:
        own = [(check, parties) for check, parties in compared if engine in parties]
        judged = [parties for check, parties in own if check.judged]
        present = {check.level for check, _ in own}
        with_file = sum(FILE in parties for parties in judged)
        alone = sum(parties == {engine} for parties in judged)
        found[engine] = Participation(
            with_engines=len(judged) - with_file - alone,
            with_file=with_file,
            alone=alone,
            not_judged=sum(len(parties) > 1 for check, parties in own if not check.judged),
            no_part_in=tuple(level for level in levels if level not in present),
        )
    return found


def missing_levels(checks: Sequence[Check]) -> tuple[str, ...]:
    """Return the levels of equations and runs that have no checks at all, as if no runs could be compared."""
    present = {check.level for check in checks if check.judged or check.unconverged}
    return tuple(level for level in (*LEVELS_OF_EQUATIONS, *LEVELS_OF_RUNS) if level not in present)


def by_runs_only(engines: Sequence[str], checks: Sequence[Check]) -> tuple[str, ...]:
    """Return the engines whose equations of motion were not compared; most of them have none.

    Args:
        engines: names of the engines.
        checks: all checks.
    """
    of_equations = (_parties(check) for check in checks if check.level in LEVELS_OF_EQUATIONS)
    compared = set[str]().union(*of_equations)
    return tuple(engine for engine in engines if engine not in compared)


def _parties(check: Check) -> set[str]:
    """Return the engines of a check, and `FILE` for the model file; a formulation stands for its engine."""
    return {SOLVER_NAME if name in FORMULATION_NAMES else name for name in check.between}
