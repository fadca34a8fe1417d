"""Find the outlier of a comparison: the engine that differs from the others, and the level where it begins.

In: the checks of a comparison. A `Check` compares a value with its tolerance: the difference of a pair of
engines, or an error of a single engine. Checks are grouped in levels, from the model to whole simulations
(runs). Out: a `Diagnosis` for the first level at which engines differ, and further ones for the remaining
engines.

Participants are the engines, the formulations of newton_euler if these differ from each other, and the model
file at the level `READING`. If a participant differs from all others, and the others agree with each other,
the participant is the outlier. Otherwise (with two engines, for example) checks of a single engine and
reference values (published or exact results) decide.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from crosscheck.compare.check import (
    CONSTRAINT_VIOLATION,
    FILE,
    LEVELS,
    LEVELS_OF_RUNS,
    MOMENTUM_BALANCE,
    READING,
    REFERENCE,
    Check,
)
from crosscheck.compare.diagnosis import FORMULATION_NAMES, NEARER_RATIO, SOLVER_NAME, Diagnosis
from crosscheck.compare.reference_values import ReferenceCheck
from newton_euler.equations.redundancy import NearlyRedundant

LEVEL_ORDER = (*LEVELS, REFERENCE)
"""All levels at which participants can differ, in their order."""


def diagnose(
    engines: Sequence[str],
    checks: Iterable[Check],
    reference_checks: Sequence[ReferenceCheck] = (),
    soft_engines: Mapping[str, float] = MappingProxyType({}),
    nearly_redundant: Sequence[NearlyRedundant] = (),
    without_equations: Collection[str] = (),
    ends: Mapping[str, float] = MappingProxyType({}),
) -> tuple[Diagnosis, ...]:
    """Find the outlier at the first level with a difference, then the outlier of the remaining ones, and so
    on.

    Args:
        engines: names of the engines, in the order of the comparison.
        checks: all checks except those against reference values.
        reference_checks: checks against reference values.
        soft_engines: `SoftConstraints.smallest_resisted` of engines with soft constraints. They do not omit
            nearly redundant constraints, as engines with rigid constraints do.
        nearly_redundant: nearly redundant constraints of the scene.
        without_equations: engines whose equations were not compared. Differences of their runs may come from
            their models.
        ends: times, s, at which runs stopped early, by engine. A run is no evidence about later times.

    Returns:
        One diagnosis for each outlier, in the order of their levels. The last diagnosis may have no outlier.
    """
    judged = [check for check in checks if check.judged]  # others can neither pass nor fail
    names = [*engines, *([FILE] if any(FILE in check.between for check in judged) else [])]
    wrong = {check.engine for check in reference_checks if not check.agrees}
    diagnoses = []
    while (diagnosis := _first_difference(names, judged, wrong, ends)) is not None:
        if diagnosis.level in LEVELS_OF_RUNS and diagnosis.quantity != MOMENTUM_BALANCE:
            # The equations agree, only runs differ: look for a cause in soft constraints
            drift = [
                check
                for check in judged
                if check.between == (diagnosis.outlier,) and check.quantity == CONSTRAINT_VIOLATION
            ]
            if diagnosis.fault == "integration" and diagnosis.outlier in without_equations:
                diagnosis = replace(diagnosis, fault="model or integration")
            resisted = min(
                (soft_engines.get(name, math.inf) for name in _concerned(diagnosis)), default=math.inf
            )
            redundancy = "; ".join(str(each) for each in nearly_redundant if each.singular_value > resisted)
            if redundancy:
                diagnosis = replace(diagnosis, fault="redundancy", evidence=redundancy)
            elif diagnosis.outlier in soft_engines and not all(check.agrees for check in drift):
                diagnosis = replace(diagnosis, fault="softness", evidence=_violation_text(drift[0]))
            elif diagnosis.outlier in soft_engines and diagnosis.detail:
                # A check of runs has a detail if the refined run (half the step) changes too much
                diagnosis = replace(diagnosis, fault="resolution")
        diagnoses.append(diagnosis)
        if not diagnosis.outlier:
            break
        names, judged = _without(diagnosis.outlier, names, judged)
    if not diagnoses and wrong:
        diagnoses.append(_against_reference(names, judged, reference_checks))
    return tuple(diagnoses)


def _violation_text(check: Check) -> str:
    """Format the joint, the size and the time of the largest constraint violation of a run."""
    joint, _, time = check.where.partition(" at ")
    return f"constraint violation of {joint} is {check.value:.1e} (m or rad) at {time}"


def _concerned(diagnosis: Diagnosis) -> Collection[str]:
    """Return the outlier or, without an outlier, the differing engines."""
    return [diagnosis.outlier] if diagnosis.outlier else diagnosis.differing


def _without(outlier: str, names: Sequence[str], checks: Iterable[Check]) -> tuple[list[str], list[Check]]:
    """Return participants and checks without an outlier.

    If the outlier is a formulation, the other formulation stands for `SOLVER_NAME`. If the outlier is
    `SOLVER_NAME`, the momentum balances of all engines are removed, since they use forces of `SOLVER_NAME`.
    """
    if outlier in FORMULATION_NAMES:
        kept = [check for check in checks if outlier not in check.between and _is_of_one_formulation(check)]
        return list(names), [_renamed(check, dict.fromkeys(FORMULATION_NAMES, SOLVER_NAME)) for check in kept]
    removed = {outlier, *(FORMULATION_NAMES if outlier == SOLVER_NAME else ())}
    if outlier == SOLVER_NAME:
        checks = [check for check in checks if check.quantity != MOMENTUM_BALANCE]
    remaining = [name for name in names if name != outlier]
    return remaining, [check for check in checks if not removed & set(check.between)]


def _by_formulation(names: Sequence[str], checks: Iterable[Check]) -> tuple[list[str], list[Check]]:
    """Return participants and checks with the formulations in place of `SOLVER_NAME`."""
    participants: list[str] = []
    for name in names:
        participants += FORMULATION_NAMES if name == SOLVER_NAME else (name,)
    kept = [check for check in checks if _is_of_one_formulation(check)]
    return participants, [_renamed(check, {SOLVER_NAME: FORMULATION_NAMES[0]}) for check in kept]


def _is_of_one_formulation(check: Check) -> bool:
    """Return False for a check of `SOLVER_NAME` at a level of equations: the worst over all formulations.

    At the level `READING` and in runs, the checks of `SOLVER_NAME` use the first formulation only.
    """
    return SOLVER_NAME not in check.between or check.level in (READING, *LEVELS_OF_RUNS)


def _renamed(check: Check, new_names: Mapping[str, str]) -> Check:
    """Return a check with other names of participants; `new_names` maps old to new names."""
    return replace(check, between=tuple(new_names.get(name, name) for name in check.between))


def _first_difference(
    names: Sequence[str], checks: Sequence[Check], wrong: Collection[str], ends: Mapping[str, float]
) -> Diagnosis | None:
    """Make the diagnosis at the first level at which any of the participants differ; None if all agree.

    Args:
        names: participants that remain.
        checks: judged checks.
        wrong: engines that differ from reference values.
        ends: times, s, at which runs stopped early, by engine.
    """
    with_formulations = {*names, *(FORMULATION_NAMES if SOLVER_NAME in names else ())}
    checks = [check for check in checks if set(check.between) <= with_formulations]
    failed = [check for check in checks if not check.agrees]
    if not failed:
        return None
    # The model file first
    if (of_file := _file_diagnosis(names, checks)) is not None:
        return of_file
    # Then the first level, with the formulations as participants if these differ from each other there
    without_file = [check for check in failed if FILE not in check.between] or failed
    level = min((check.level for check in without_file), key=LEVEL_ORDER.index)
    if any(check.level == level and set(check.between) == set(FORMULATION_NAMES) for check in without_file):
        names, checks = _by_formulation(names, checks)
        wrong = {FORMULATION_NAMES[0] if name == SOLVER_NAME else name for name in wrong}
    checks = [check for check in checks if set(check.between) <= set(names)]
    failed_at_level = [
        check for check in checks if check.level == level and not check.agrees and FILE not in check.between
    ]
    failed_pairs = [check for check in failed_at_level if len(check.between) == 2]
    if failed_pairs:
        return _pairs_diagnosis(names, checks, failed_pairs, wrong, ends if level in LEVELS_OF_RUNS else {})
    # Only checks of single participants fail
    suspects = _ordered(names, (check.between[0] for check in failed_at_level))
    others = [name for name in names if name not in suspects]
    outlier = suspects[0] if len(suspects) == 1 and others else ""
    decided_by = failed_at_level[0].quantity if outlier else "own"
    return _diagnosis(outlier, suspects, others, failed_at_level[0], checks, decided_by)


def _file_diagnosis(names: Sequence[str], checks: Sequence[Check]) -> Diagnosis | None:
    """Make the diagnosis of differences from the model file.

    If a single engine differs from the file, the engine is the outlier. If the models of all engines agree
    with each other and none agrees with the file, the outlier is `FILE`: the reading of the file is wrong.

    Returns:
        The diagnosis; None if nothing differs from the file, or if the engines differ from each other and
        have to be compared first.
    """
    with_file = [check for check in checks if FILE in check.between]
    failed = [check for check in with_file if not check.agrees]
    if not failed:
        return None
    compared = _ordered(names, (name for check in with_file for name in check.between if name != FILE))
    differing = _ordered(names, (name for check in failed for name in check.between if name != FILE))
    of_models = [check for check in checks if check.level not in LEVELS_OF_RUNS]
    if len(differing) == 1 and len(compared) > 1:
        outlier = differing[0]
        others = [name for name in compared if name != outlier]
        # Prefer a check between engines: its detail has both values, which checks with the file do not have
        with_values = [
            check for check in of_models if check.detail and not check.agrees and outlier in check.between
        ]
        shown = [*with_values, *failed][0]
        return _diagnosis(outlier, [*differing, FILE], [*others, FILE], shown, checks, "others")
    between_engines = [check for check in of_models if set(check.between) <= set(compared)]
    if not all(check.agrees for check in between_engines):
        return None
    outlier = FILE if differing == compared and len(compared) > 1 else ""
    others = [name for name in compared if outlier or name not in differing]
    return _diagnosis(outlier, [*differing, FILE], others, failed[0], checks, "others")


def _pairs_diagnosis(
    names: Sequence[str],
    checks: Sequence[Check],
    failed: Sequence[Check],
    wrong: Collection[str],
    ends: Mapping[str, float],
) -> Diagnosis:
    """Make the diagnosis at a level at which pairs of participants differ.

    Args:
        names: participants.
        checks: judged checks of these participants.
        failed: failing checks of pairs, all at one level.
        wrong: engines that differ from reference values.
        ends: times, s, at which runs stopped early, by engine; empty at levels of equations.
    """
    level = failed[0].level
    pairs = {frozenset(check.between) for check in checks if check.level == level and len(check.between) == 2}
    differing_pairs = {frozenset(check.between) for check in failed}
    present = _ordered(names, (name for pair in pairs for name in pair))
    # One that differs from all others, while the others agree with each other
    alone = [name for name in present if all(pair in differing_pairs for pair in pairs if name in pair)]
    rest = [name for name in present if name not in alone]
    if alone and len(rest) > 1 and not any(pair <= set(rest) for pair in differing_pairs):
        if set(FORMULATION_NAMES) <= set(alone):  # neither formulation agrees with the rest
            of_formulation = _outlier_diagnosis(FORMULATION_NAMES[0], present, rest, checks, failed, "others")
            return replace(of_formulation, outlier=SOLVER_NAME)
        return _outlier_diagnosis(alone[0], present, rest, checks, failed, "others")
    # Two that differ from each other only: the outlier is much farther from all others than the other one
    suspects = _ordered(names, (name for pair in differing_pairs for name in pair))
    # Others are runs with the same end as both suspects: checks up to another time are not comparable
    suspects_end = {ends.get(name, np.inf) for name in suspects}
    others = [name for name in present if name not in suspects and {ends.get(name, np.inf)} == suspects_end]
    if len(suspects) == 2 and others:
        for outlier, other in (suspects, suspects[::-1]):
            if all(_is_nearer(other, outlier, third, failed[0], checks) for third in others):
                return _outlier_diagnosis(outlier, suspects, [other, *others], checks, failed, "nearness")
    # A single one that fails a check of one participant (such as its energy balance), or reference values
    decided = _decided_by_single_check(suspects, checks, level, wrong, ends)
    if decided is not None:
        outlier, decided_by = decided
        rest = _ordered(names, {*suspects, *others} - {outlier})
        return _outlier_diagnosis(outlier, suspects, rest, checks, failed, decided_by)
    return _diagnosis("", suspects, others, failed[0], checks)


def _outlier_diagnosis(
    outlier: str,
    differing: Sequence[str],
    others: Sequence[str],
    checks: Sequence[Check],
    failed: Sequence[Check],
    decided_by: str,
) -> Diagnosis:
    """Make the diagnosis of an outlier, with the first of the `failed` checks that concerns the outlier."""
    check = next(check for check in failed if outlier in check.between)
    return _diagnosis(outlier, differing, others, check, checks, decided_by)


def _is_nearer(near: str, far: str, third: str, check: Check, checks: Sequence[Check]) -> bool:
    """Return True if `near` is `NEARER_RATIO` times nearer to a third participant than `far` is.

    Args:
        near, far, third: participants.
        check: check in which `near` and `far` differ. Distances are the values of checks of this quantity.
        checks: judged checks.
    """
    distances = {
        frozenset(other.between): other.value
        for other in checks
        if (other.level, other.quantity) == (check.level, check.quantity)
    }
    to_near, to_far = (distances.get(frozenset((name, third))) for name in (near, far))
    return to_near is not None and to_far is not None and NEARER_RATIO * to_near <= to_far


def _decided_by_single_check(
    names: Sequence[str],
    checks: Sequence[Check],
    level: str,
    wrong: Collection[str],
    ends: Mapping[str, float],
) -> tuple[str, str] | None:
    """Find the only one of several differing participants that fails a check of one participant.

    Differences at levels of equations are decided by momentum balances only: an exact model may be integrated
    with a large error, so checks of runs are no evidence about models. A failure after the first end of the
    runs is no evidence about their difference.

    Args:
        names: the differing participants.
        checks: judged checks.
        level: level of the difference.
        wrong: engines that differ from reference values.
        ends: times, s, at which runs stopped early, by engine; empty at levels of equations.

    Returns:
        The participant and the quantity of its failing check, or "reference" for the only participant that
        differs from reference values. None if no participant, or more than one, fails.
    """
    failed = {
        check.between[0]: check.quantity
        for check in reversed(checks)  # so that the first failing check of each participant is kept
        if len(check.between) == 1
        and not check.agrees
        and check.between[0] in names
        # the momentum balance at levels of equations, all other checks at levels of runs
        and (check.quantity == MOMENTUM_BALANCE) == (level not in LEVELS_OF_RUNS)
    }
    first_end = min(ends.get(name, np.inf) for name in names)
    if len(failed) == 1:
        (outlier, quantity), *_ = failed.items()
    elif len(suspects := [name for name in names if name in wrong]) == 1:
        outlier, quantity = suspects[0], "reference"
    else:
        return None
    return (outlier, quantity) if ends.get(outlier, np.inf) <= first_end else None


def _diagnosis(
    outlier: str,
    differing: Sequence[str],
    agree: Sequence[str],
    check: Check,
    checks: Sequence[Check],
    decided_by: str = "",
) -> Diagnosis:
    """Make a diagnosis, and measure how well the participants other than the outlier agree.

    Args:
        outlier, differing, agree, decided_by: attributes of the diagnosis.
        check: failing check that the diagnosis shows.
        checks: judged checks.
    """
    of_agreeing = [other for other in checks if set(other.between) <= set(agree)]
    pairs = [other for other in of_agreeing if len(other.between) == 2]
    # If the file differs, take pairs of all levels: only the file is compared at the level `READING`
    at_level = [other for other in pairs if other.level == check.level or FILE in differing]
    agree_at_level = all(other.agrees for other in at_level)
    everywhere = agree_at_level and all(other.agrees for other in of_agreeing)
    values = [other.value for other in (pairs if everywhere else at_level)]
    within = max(values, default=None) if agree_at_level else None
    fault = ""
    if outlier == FILE:
        fault = "reading"
    elif outlier:
        tests_run = check.level in LEVELS_OF_RUNS and check.quantity != MOMENTUM_BALANCE
        fault = "integration" if tests_run else "model"
        if tests_run and check.quantity.startswith("reaction "):  # compared only if poses agree
            fault = "reactions"
    return Diagnosis(
        outlier=outlier,
        differing=tuple(differing),
        agree=tuple(agree) if agree_at_level or not outlier else (),
        within=within,
        everywhere=everywhere,
        level=check.level,
        quantity=check.quantity,
        value=check.value,
        tolerance=check.tolerance,
        where=check.where,
        decided_by=decided_by,
        fault=fault,
        detail=check.detail,
    )


def _against_reference(
    names: Sequence[str], checks: Sequence[Check], reference_checks: Sequence[ReferenceCheck]
) -> Diagnosis:
    """Make the diagnosis of engines that agree with each other, but not with reference values."""
    failed = [check for check in reference_checks if not check.agrees]
    suspects = _ordered(names, (check.engine for check in failed))
    others = [name for name in names if name not in suspects and name != FILE]
    outlier = suspects[0] if len(suspects) == 1 and others else ""
    diagnosis = _diagnosis(outlier, suspects, others, failed[0], checks, "reference" if outlier else "")
    return replace(diagnosis, fault="integration" if outlier else "")


def _ordered(names: Sequence[str], some: Iterable[str]) -> list[str]:
    """Return some of the names in the order of all `names`, each once."""
    wanted = set(some)
    return [name for name in names if name in wanted]
