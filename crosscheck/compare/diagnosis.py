"""Diagnosis of a comparison: which engine is the outlier, at which level, and whether its model is wrong.

In: the checks of a comparison (`Check`). Out: a `Diagnosis` for the first level at which engines differ, and
further ones for the remaining engines.

Participants are the engines, the formulations of newton_euler if these differ from each other, and the model
file at the level `READING`. A formulation is a form of the equations of motion: in joint coordinates
("relative") or in Cartesian ones. If a participant differs from all others, and the others agree with each
other, the participant is the outlier. Otherwise (with two engines, for example) checks of a single engine and
reference values decide.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from crosscheck.compare.check import CONSTRAINT_VIOLATION, FILE, LEVELS, OF_RUNS, READING, REFERENCE, Check
from crosscheck.compare.reference_values import ReferenceCheck
from newton_euler.compiled.formulations import FORMULATIONS
from newton_euler.equations.redundancy import NearlyRedundant

OWNER = "newton_euler"
"""The engine that has several formulations, `SYSTEMS`."""

SYSTEMS = tuple(FORMULATIONS)
"""Names of the formulations of `OWNER`. Runs of `OWNER` use the first formulation."""

ORDER = (*LEVELS, REFERENCE)
"""All levels at which participants can differ, in their order."""

MOMENTUM = "momentum balance, rel"
"""Quantity of a check of one engine that tests the engine's model, although its level is "energy"."""

NEARER_RATIO = 10.0
"""Ratio of the distances of two participants from a third one, beyond which the farther one is the
outlier."""

MIN_SOFT_SINGULAR_VALUE = 1e-7
"""Smallest singular value s of a nearly redundant constraint that affects a run with soft constraints.
MuJoCo's constraints (compliance 1e-4, time constant 2e-3 s) exert s^2 / (1e-4 (2e-3 s)^2) on such a motion:
1 % of the inertia within 20 s."""

FAULTS = {
    "model": "{} model is wrong",
    "integration": "{} integration is at fault",
    "reading": "the reading of the file is wrong",
    "softness": "{} constraints are too soft: {}",
    "resolution": "{} step is too large for this model, or its soft constraints resist each other",
    "redundancy": "what each makes of nearly redundant constraints is the difference: {1}",
}
"""Sentence for each likely cause. {0} stands for the possessive of the outlier, {1} for the evidence."""


@dataclass(frozen=True)
class Diagnosis:
    """Diagnosis of the differences at one level.

    Attributes:
        outlier: name of the participant that is likely wrong; empty if the checks do not determine it.
        differing: all participants that differ at the level.
        agree: participants other than the outlier that agree with each other.
        within: largest judged difference between the participants in `agree`, m, rad or relative: over all
            levels if they agree in all checks, otherwise at this level. None if there are fewer than two.
        everywhere: True if the participants in `agree` agree in all checks.
        level, quantity, value, tolerance, where, detail: attributes of the first failing check.
        decided_by: what determines the outlier. "others": all others agree with each other. "nearness": the
            other one is nearer to a third participant. "reference": reference values. "own": several
            participants fail checks of their own, so there is no outlier. Otherwise the quantity of the
            outlier's own failing check.
        fault: likely cause, a key of `FAULTS`; empty if the cause is not determined.
        evidence: nearly redundant constraints, or the violation of soft constraints, as text.
    """

    outlier: str
    differing: tuple[str, ...]
    agree: tuple[str, ...]
    within: float | None
    everywhere: bool
    level: str
    quantity: str
    value: float
    tolerance: float
    where: str
    decided_by: str = ""
    fault: str = ""
    evidence: str = ""
    detail: str = ""

    def summary(self) -> dict[str, Any]:
        """Attributes for JSON, and `engine`: the outlier, or the engine of the formulation that is."""
        engine = OWNER if self.outlier in SYSTEMS else "" if self.outlier == FILE else self.outlier
        return {"engine": engine, **asdict(self)}

    @property
    def who(self) -> str:
        """Sentence on which participants differ, and how well the others agree."""
        others = _listed(self.agree)
        agreement = ""
        if self.within is not None:
            scope = "all checks" if self.everywhere else f"level '{self.level}'"
            agreement = f"{others} agree within {self.within:.0e} ({scope})"
        if not self.outlier:
            return self._without_outlier
        name = _named(self.outlier)
        if self.decided_by == "reference":
            agreement = f"{others} agree{'s' if len(self.agree) == 1 else ''} with the reference"
        elif self.decided_by == "nearness":
            agreement = f"{others} are {NEARER_RATIO:g} times nearer to each other"
        elif self.decided_by != "others":
            agreement = "; ".join(filter(None, [f"its own {self.decided_by} fails", agreement]))
        return f"{name} differs; {agreement}" if agreement else f"{name} differs"

    @property
    def _without_outlier(self) -> str:
        """Sentence on the differing participants if the checks determine no outlier."""
        names = _listed(self.differing)
        if self.level == REFERENCE:
            return f"{names} and the reference differ"
        if len(self.differing) == 1:
            return f"{names} fails"
        if self.decided_by == "own":
            return f"{names} fail by themselves"
        if self.level == READING and len(self.differing) > 2:
            return f"{_listed(self.differing[:-1])} differ from the file, {_listed(self.agree)} do not"
        if len(self.differing) > 2:
            return f"{names} all differ from each other"
        if self.agree:
            verb = "agrees" if len(self.agree) == 1 else "agree"
            return f"{names} differ; {_listed(self.agree)} {verb} with both"
        another = "other" if FILE in self.differing else "third"
        return f"{names} differ, and no {another} engine decides which is right"

    @property
    def place(self) -> str:
        """Text on the first failing check: level, quantity, value, tolerance and place."""
        failing = f"{self.quantity}: {self.value:.3g} > {self.tolerance:.3g}"
        if self.level == REFERENCE:
            return f"against the reference: {failing}, {self.where}"
        detail = f": {self.detail}" if self.detail else ""
        return f"at level '{self.level}': {failing}, worst at {self.where}{detail}"

    @property
    def fault_text(self) -> str:
        """Sentence on the likely cause; empty if the cause is not determined."""
        return FAULTS[self.fault].format(f"{_named(self.outlier)}'s", self.evidence) if self.fault else ""


def _named(participant: str) -> str:
    """Return the name of a participant for sentences."""
    if participant == FILE:
        return "the file"
    return f"{OWNER}'s {participant} formulation" if participant in SYSTEMS else participant


def _listed(participants: Sequence[str]) -> str:
    """Return the names of participants for sentences, as "a, b and c"."""
    names = [_named(name) for name in participants]
    return " and ".join(filter(None, [", ".join(names[:-1]), *names[-1:]]))


def diagnose(
    engines: Sequence[str],
    rows: Iterable[Check],
    measured: Sequence[ReferenceCheck] = (),
    soft: Collection[str] = (),
    nearly: Sequence[NearlyRedundant] = (),
) -> tuple[Diagnosis, ...]:
    """Find the outlier at the first level with a difference, then the outlier of the remaining ones, and so
    on.

    Args:
        engines: names of the engines, in the order of the comparison.
        rows: all checks.
        measured: checks against reference values.
        soft: names of engines with soft constraints. They do not omit nearly redundant constraints, as
            engines with rigid constraints do.
        nearly: nearly redundant constraints of the scene.

    Returns:
        One diagnosis for each outlier, in the order of their levels. The last diagnosis may have no outlier.
    """
    shown = "; ".join(str(each) for each in nearly if each.singular_value > MIN_SOFT_SINGULAR_VALUE)
    judged = [row for row in rows if row.judged]
    names = [*engines, *([FILE] if any(FILE in row.between for row in judged) else [])]
    wrong = {known.engine for known in measured if not known.agrees}
    found = []
    while (diagnosis := _first_difference(names, judged, wrong)) is not None:
        if diagnosis.level in OF_RUNS and diagnosis.quantity != MOMENTUM:
            # The equations agree, only runs differ: look for a cause in soft constraints
            drift = [
                row
                for row in judged
                if row.between == (diagnosis.outlier,) and row.quantity == CONSTRAINT_VIOLATION
            ]
            if shown and _concerns(diagnosis, soft):
                diagnosis = replace(diagnosis, fault="redundancy", evidence=shown)
            elif diagnosis.outlier in soft and not all(row.agrees for row in drift):
                diagnosis = replace(diagnosis, fault="softness", evidence=_violation_text(drift[0]))
            elif diagnosis.outlier in soft and diagnosis.detail:  # a refined run changes too much
                diagnosis = replace(diagnosis, fault="resolution")
        found.append(diagnosis)
        if not diagnosis.outlier:
            break
        names, judged = _without(diagnosis.outlier, names, judged)
    if not found and wrong:
        found.append(_against_reference(names, judged, measured))
    return tuple(found)


def _violation_text(row: Check) -> str:
    """Format the joint, the size and the time of the largest constraint violation of a run."""
    joint, _, time = row.where.partition(" at ")
    return f"constraint violation of {joint} is {row.value:.1e} (m or rad) at {time}"


def _concerns(diagnosis: Diagnosis, engines: Collection[str]) -> bool:
    """Return True if one of the engines is the outlier or, without an outlier, one of the differing ones."""
    concerned = {diagnosis.outlier} if diagnosis.outlier else set(diagnosis.differing)
    return bool(concerned & set(engines))


def _without(outlier: str, names: Sequence[str], rows: Iterable[Check]) -> tuple[list[str], list[Check]]:
    """Return participants and checks without an outlier.

    If the outlier is a formulation, the other formulation stands for `OWNER`. If the outlier is `OWNER`, the
    momentum balances are removed for all engines, since they use forces of `OWNER`.
    """
    if outlier in SYSTEMS:
        kept = [row for row in rows if outlier not in row.between and _is_of_one_formulation(row)]
        return list(names), [_renamed(row, dict.fromkeys(SYSTEMS, OWNER)) for row in kept]
    gone = {outlier, *(SYSTEMS if outlier == OWNER else ())}
    if outlier == OWNER:
        rows = [row for row in rows if row.quantity != MOMENTUM]
    return [name for name in names if name != outlier], [row for row in rows if not gone & set(row.between)]


def _by_formulation(names: Sequence[str], rows: Iterable[Check]) -> tuple[list[str], list[Check]]:
    """Return participants and checks with the formulations in place of `OWNER`."""
    participants: list[str] = []
    for name in names:
        participants += SYSTEMS if name == OWNER else (name,)
    kept = [row for row in rows if _is_of_one_formulation(row)]
    return participants, [_renamed(row, {OWNER: SYSTEMS[0]}) for row in kept]


def _is_of_one_formulation(row: Check) -> bool:
    """Return False for a check of `OWNER` that is the worst over all formulations."""
    return OWNER not in row.between or row.level in (READING, *OF_RUNS)


def _renamed(row: Check, new_names: Mapping[str, str]) -> Check:
    """Return a check with participants renamed, by old name."""
    return replace(row, between=tuple(new_names.get(name, name) for name in row.between))


def _first_difference(
    names: Sequence[str], rows: Sequence[Check], wrong: Collection[str]
) -> Diagnosis | None:
    """Make the diagnosis at the first level at which any of the participants differ; None if all agree.

    Args:
        names: participants that remain.
        rows: judged checks.
        wrong: engines that differ from reference values.
    """
    known = {*names, *(SYSTEMS if OWNER in names else ())}
    rows = [row for row in rows if set(row.between) <= known]
    failed = [row for row in rows if not row.agrees]
    if not failed:
        return None
    # The model file first
    if (of_file := _file_diagnosis(names, rows)) is not None:
        return of_file
    # Then the first level, with the formulations as participants if these differ from each other there
    between = [row for row in failed if FILE not in row.between] or failed
    level = min((row.level for row in between), key=ORDER.index)
    if any(row.level == level and set(row.between) == set(SYSTEMS) for row in between):
        names, rows = _by_formulation(names, rows)
        wrong = {SYSTEMS[0] if name == OWNER else name for name in wrong}
    rows = [row for row in rows if set(row.between) <= set(names)]
    at_level = [row for row in rows if row.level == level and not row.agrees and FILE not in row.between]
    failed_pairs = [row for row in at_level if len(row.between) == 2]
    if failed_pairs:
        return _pairs_diagnosis(names, rows, failed_pairs, wrong)
    # Only checks of single participants fail
    suspects = _ordered(names, (row.between[0] for row in at_level))
    others = [name for name in names if name not in suspects]
    outlier = suspects[0] if len(suspects) == 1 and others else ""
    decided_by = at_level[0].quantity if outlier else "own"
    return _diagnosis(outlier, suspects, others, at_level[0], rows, decided_by)


def _file_diagnosis(names: Sequence[str], rows: Sequence[Check]) -> Diagnosis | None:
    """Make the diagnosis of differences from the model file.

    If a single engine differs from the file, the engine is the outlier. If the models of all engines agree
    with each other and none agrees with the file, the reading of the file is. None if nothing differs from
    the file, or if the engines differ from each other and have to be compared first.
    """
    with_file = [row for row in rows if FILE in row.between]
    failed = [row for row in with_file if not row.agrees]
    if not failed:
        return None
    compared = _ordered(names, (name for row in with_file for name in row.between if name != FILE))
    differing = _ordered(names, (name for row in failed for name in row.between if name != FILE))
    if len(differing) == 1 and len(compared) > 1:
        others = [name for name in compared if name not in differing]
        # Prefer a check between engines: its detail has both values, which checks with the file do not have
        of_models = [row for row in rows if row.level not in OF_RUNS]
        own = [row for row in of_models if row.detail and not row.agrees and differing[0] in row.between]
        first = [*own, *failed][0]
        return _diagnosis(differing[0], [*differing, FILE], [*others, FILE], first, rows, "others")
    among = [row for row in rows if set(row.between) <= set(compared) and row.level not in OF_RUNS]
    if not all(row.agrees for row in among):
        return None
    outlier = FILE if differing == compared and len(compared) > 1 else ""
    others = [name for name in compared if outlier or name not in differing]
    return _diagnosis(outlier, [*differing, FILE], others, failed[0], rows, "others")


def _pairs_diagnosis(
    names: Sequence[str], rows: Sequence[Check], failed: Sequence[Check], wrong: Collection[str]
) -> Diagnosis:
    """Make the diagnosis at a level at which pairs of participants differ.

    Args:
        names: participants.
        rows: judged checks between them.
        failed: failing checks of pairs, all at the level.
        wrong: engines that differ from reference values.
    """
    level = failed[0].level
    pairs = {frozenset(row.between) for row in rows if row.level == level and len(row.between) == 2}
    differing_pairs = {frozenset(row.between) for row in failed}
    present = _ordered(names, (name for pair in pairs for name in pair))
    # One that differs from all others, while the others agree with each other
    alone = [name for name in present if all(pair in differing_pairs for pair in pairs if name in pair)]
    rest = [name for name in present if name not in alone]
    if alone and len(rest) > 1 and not any(pair <= set(rest) for pair in differing_pairs):
        if set(SYSTEMS) <= set(alone):  # neither formulation agrees with the rest
            found = _outlier_diagnosis(SYSTEMS[0], present, rest, rows, failed, "others")
            return replace(found, outlier=OWNER)
        return _outlier_diagnosis(alone[0], present, rest, rows, failed, "others")
    # Two that differ from each other only: the outlier is much farther from all others
    suspects = _ordered(names, (name for pair in differing_pairs for name in pair))
    others = [name for name in present if name not in suspects]
    if len(suspects) == 2 and others:
        for outlier, other in (suspects, suspects[::-1]):
            if all(_is_nearer(other, outlier, third, failed[0], rows) for third in others):
                return _outlier_diagnosis(outlier, suspects, [other, *others], rows, failed, "nearness")
    # One that alone fails a check of its own, or differs from reference values
    decided = _decided_by_own_check(suspects, rows, level, wrong)
    if decided is not None:
        outlier, decided_by = decided
        rest = [name for name in present if name != outlier]
        return _outlier_diagnosis(outlier, suspects, rest, rows, failed, decided_by)
    return _diagnosis("", suspects, others, failed[0], rows)


def _outlier_diagnosis(
    outlier: str,
    differing: Sequence[str],
    others: Sequence[str],
    rows: Sequence[Check],
    failed: Sequence[Check],
    decided_by: str,
) -> Diagnosis:
    """Make the diagnosis of an outlier, with the first of the `failed` checks that concerns the outlier."""
    row = next(row for row in failed if outlier in row.between)
    return _diagnosis(outlier, differing, others, row, rows, decided_by)


def _is_nearer(near: str, far: str, third: str, row: Check, rows: Sequence[Check]) -> bool:
    """Return True if `near` is `NEARER_RATIO` times nearer to a third participant than `far` is.

    Args:
        near, far, third: participants.
        row: check in which `near` and `far` differ. Its quantity is what the distances are measured in.
        rows: judged checks.
    """
    values = {
        frozenset(other.between): other.value
        for other in rows
        if (other.level, other.quantity) == (row.level, row.quantity)
    }
    near_value, far_value = (values.get(frozenset((name, third))) for name in (near, far))
    return near_value is not None and far_value is not None and NEARER_RATIO * near_value <= far_value


def _decided_by_own_check(
    names: Sequence[str], rows: Sequence[Check], level: str, wrong: Collection[str]
) -> tuple[str, str] | None:
    """Find the only one of several differing participants that fails a check of its own.

    Differences at levels of equations are decided by momentum balances only: an exact model may be integrated
    with a large error, so checks of runs are no evidence about models.

    Returns:
        The participant and the quantity of its failing check, or "reference" for the only participant that
        differs from reference values. None if no participant, or more than one, fails.
    """
    failed = {
        row.between[0]: row.quantity
        for row in reversed(rows)  # so that the first failing check of each participant is kept
        if len(row.between) == 1
        and not row.agrees
        and row.between[0] in names
        and (row.quantity == MOMENTUM) == (level not in OF_RUNS)
    }
    if len(failed) == 1:
        return next(iter(failed.items()))
    suspects = [name for name in names if name in wrong]
    return (suspects[0], "reference") if len(suspects) == 1 else None


def _diagnosis(
    outlier: str,
    differing: Sequence[str],
    agree: Sequence[str],
    row: Check,
    rows: Sequence[Check],
    decided_by: str = "",
) -> Diagnosis:
    """Make a diagnosis, and measure how well the participants other than the outlier agree.

    Args:
        outlier, differing, agree, decided_by: attributes of the diagnosis.
        row: failing check that the diagnosis shows.
        rows: judged checks.
    """
    among = [other for other in rows if set(other.between) <= set(agree)]
    pairs = [other for other in among if len(other.between) == 2]
    # Engines are compared with each other at other levels than with the file: take all levels then
    at_level = [other for other in pairs if other.level == row.level or FILE in differing]
    all_agree = all(other.agrees for other in at_level)
    everywhere = all_agree and all(other.agrees for other in among)
    values = [other.value for other in (pairs if everywhere else at_level)]
    within = max(values, default=None) if all_agree else None
    fault = ""
    if outlier == FILE:
        fault = "reading"
    elif outlier:
        fault = "integration" if row.level in OF_RUNS and row.quantity != MOMENTUM else "model"
    return Diagnosis(
        outlier=outlier,
        differing=tuple(differing),
        agree=tuple(agree) if all_agree or not outlier else (),
        within=within,
        everywhere=everywhere,
        level=row.level,
        quantity=row.quantity,
        value=row.value,
        tolerance=row.tolerance,
        where=row.where,
        decided_by=decided_by,
        fault=fault,
        detail=row.detail,
    )


def _against_reference(
    names: Sequence[str], rows: Sequence[Check], measured: Sequence[ReferenceCheck]
) -> Diagnosis:
    """Make the diagnosis of engines that agree with each other, but not with reference values."""
    failed = [known for known in measured if not known.agrees]
    suspects = _ordered(names, (known.engine for known in failed))
    others = [name for name in names if name not in suspects and name != FILE]
    outlier = suspects[0] if len(suspects) == 1 and others else ""
    found = _diagnosis(outlier, suspects, others, failed[0], rows, "reference" if outlier else "")
    return replace(found, fault="integration" if outlier else "")


def _ordered(names: Sequence[str], some: Iterable[str]) -> list[str]:
    """Return some of the names in the order of all `names`, each once."""
    wanted = set(some)
    return [name for name in names if name in wanted]
