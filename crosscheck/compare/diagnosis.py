"""Diagnosis of a comparison: the outlier at the first level with a difference.

Participants are the engines, the formulations of newton_euler if these differ from each other, and the model
file at the level `READING`. If a participant differs from all others, and those agree with each other, the
participant is the outlier. Otherwise, as with two engines, checks of a single engine and reference values
decide.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from crosscheck.compare.check import CONSTRAINT_VIOLATION, FILE, LEVELS, OF_RUNS, READING, REFERENCE, Check
from crosscheck.compare.reference_values import ReferenceCheck
from newton_euler.compiled.formulations import FORMULATIONS
from newton_euler.equations.redundancy import NearlyRedundant

SYSTEMS = tuple(FORMULATIONS)
"""Formulations of `OWNER`; its runs are those of the first."""

ORDER = (*LEVELS, REFERENCE)

OWNER = "newton_euler"
"""The engine of `SYSTEMS`."""

MOMENTUM = "momentum balance, rel"
"""The check of one engine that is about its model, though its level is one of runs."""

NEARER_RATIO = 10.0
"""Ratio of the distances of two participants from a third one, beyond which the farther one is the
outlier."""

MIN_SOFT_SINGULAR_VALUE = 1e-7
"""Smallest singular value s of a nearly redundant constraint that affects a run with soft constraints.
MuJoCo's constraints, with a compliance of 1e-4 within 2e-3 s, exert s^2 / (1e-4 (2e-3 s)^2): 1 % of inertia
within 20 s."""

FAULTS = {
    "model": "{} model is wrong",
    "integration": "{} integration is at fault",
    "reading": "the reading of the file is wrong",
    "softness": "{} constraints are too soft: {}",
    "resolution": "{} step is too large for this model, or its soft constraints resist each other",
    "redundancy": "what each makes of nearly redundant constraints is the difference: {1}",
}
"""Blame in words, with the possessive of who is blamed and the evidence."""


@dataclass(frozen=True)
class Diagnosis:
    """Diagnosis of the differences at one level.

    Attributes:
        outlier: the outlier; empty if the checks do not determine it.
        differing: all participants that differ at the level.
        agree: participants that agree with each other, without the outlier.
        within: largest judged difference of those, m, rad or relative: over all levels if they agree in all
            checks, otherwise at this level. None if there are fewer than two.
        everywhere: True if those agree in all checks.
        level, quantity, value, tolerance, where, detail: attributes of the first failing check.
        decided_by: what determines the outlier: "others", "nearness", "reference", the quantity of its own
            failing check, or "own" for several own checks.
        fault: a key of `FAULTS`; empty if the cause is not determined.
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
        """Attributes for JSON, with the engine of a formulation that is the outlier."""
        engine = OWNER if self.outlier in SYSTEMS else "" if self.outlier == FILE else self.outlier
        return {"engine": engine, **asdict(self)}

    @property
    def who(self) -> str:
        """Who differs, and how well the others agree."""
        others = _listed(self.agree)
        agreement = ""
        if self.within is not None:
            scope = "all checks" if self.everywhere else f"level '{self.level}'"
            agreement = f"{others} agree to {self.within:.0e} ({scope})"
        if not self.outlier:
            return self._unsettled
        name = _named(self.outlier)
        if self.decided_by == "reference":
            agreement = f"{others} agree{'s' if len(self.agree) == 1 else ''} with the reference"
        elif self.decided_by == "nearness":
            agreement = f"{others} are {NEARER_RATIO:g} times nearer to each other"
        elif self.decided_by != "others":
            agreement = "; ".join(filter(None, [f"its own {self.decided_by} fails", agreement]))
        return f"{name} differs; {agreement}" if agreement else f"{name} differs"

    @property
    def _unsettled(self) -> str:
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
        """The first check that fails."""
        figure = f"{self.quantity}: {self.value:.3g} > {self.tolerance:.3g}"
        if self.level == REFERENCE:
            return f"against the reference: {figure}, {self.where}"
        detail = f": {self.detail}" if self.detail else ""
        return f"at level '{self.level}': {figure}, worst at {self.where}{detail}"

    @property
    def fault_text(self) -> str:
        """The blame in words; empty if nothing settles it."""
        return FAULTS[self.fault].format(f"{_named(self.outlier)}'s", self.evidence) if self.fault else ""


def _named(participant: str) -> str:
    if participant == FILE:
        return "the file"
    return f"{OWNER}'s {participant} formulation" if participant in SYSTEMS else participant


def _listed(participants: Sequence[str]) -> str:
    names = [_named(name) for name in participants]
    return " and ".join(filter(None, [", ".join(names[:-1]), *names[-1:]]))


def diagnose(
    engines: Sequence[str],
    rows: Iterable[Check],
    measured: Sequence[ReferenceCheck] = (),
    soft: Collection[str] = (),
    nearly: Sequence[NearlyRedundant] = (),
) -> tuple[Diagnosis, ...]:
    """The first level at which any participant parts, then that of the rest without the odd one, and so on.

    Args:
        engines: their names, in the order of the comparison.
        rows: all checks.
        measured: checks that are known from elsewhere.
        soft: engines whose constraints give way, and so take nearly redundant ones as they are.
        nearly: nearly redundant constraints of the scene.
    """
    shown = "; ".join(str(each) for each in nearly if each.singular_value > MIN_SOFT_SINGULAR_VALUE)
    judged = [row for row in rows if row.judged]
    names = [*engines, *([FILE] if any(FILE in row.between for row in judged) else [])]
    wrong = {known.engine for known in measured if not known.agrees}
    found = []
    while (one := _first(names, judged, wrong)) is not None:
        # models agree where runs are the first to part
        if one.level in OF_RUNS and one.quantity != MOMENTUM:
            opened = [
                row
                for row in judged
                if row.between == (one.outlier,) and row.quantity == CONSTRAINT_VIOLATION
            ]
            if shown and _blames(one, soft):
                one = replace(one, fault="redundancy", evidence=shown)
            elif one.outlier in soft and not all(row.agrees for row in opened):
                one = replace(one, fault="softness", evidence=_opening(opened[0]))
            elif one.outlier in soft and one.detail:  # the change of its own run when refined
                one = replace(one, fault="resolution")
        found.append(one)
        if not one.outlier:
            break
        names, judged = _without(one.outlier, names, judged)
    if not found and wrong:
        found.append(_against_reference(names, judged, measured))
    return tuple(found)


def _opening(row: Check) -> str:
    """Word by how much joints come open in a run."""
    joint, _, time = row.where.partition(" at ")
    return f"constraint violation of {joint} is {row.value:.1e} (m or rad) at {time}"


def _blames(found: Diagnosis, engines: Collection[str]) -> bool:
    """True if one of these engines is the odd one, or one of those that part."""
    return bool(({found.outlier} if found.outlier else set(found.differing)) & set(engines))


def _without(outlier: str, names: Sequence[str], rows: Iterable[Check]) -> tuple[list[str], list[Check]]:
    """Participants and figures without one; without a formulation the other stands for `OWNER`.

    Momentum is balanced with forces of `OWNER`, so that without it nothing is known of the others' balances.
    """
    if outlier in SYSTEMS:
        kept = [row for row in rows if outlier not in row.between and _holds_of_systems(row)]
        return list(names), [_renamed(row, dict.fromkeys(SYSTEMS, OWNER)) for row in kept]
    gone = {outlier, *(SYSTEMS if outlier == OWNER else ())}
    if outlier == OWNER:
        rows = [row for row in rows if row.quantity != MOMENTUM]
    return [name for name in names if name != outlier], [row for row in rows if not gone & set(row.between)]


def _by_system(names: Sequence[str], rows: Iterable[Check]) -> tuple[list[str], list[Check]]:
    """Participants and figures where the formulations stand for `OWNER`."""
    systems = [n for name in names for n in (SYSTEMS if name == OWNER else (name,))]
    return systems, [_renamed(row, {OWNER: SYSTEMS[0]}) for row in rows if _holds_of_systems(row)]


def _holds_of_systems(row: Check) -> bool:
    """True unless a check is one of the worse of the formulations under the name of `OWNER`."""
    return OWNER not in row.between or row.level in (READING, *OF_RUNS)


def _renamed(row: Check, others: Mapping[str, str]) -> Check:
    return replace(row, between=tuple(others.get(name, name) for name in row.between))


def _first(names: Sequence[str], rows: Sequence[Check], wrong: Collection[str]) -> Diagnosis | None:
    """Who differs at the first level at which any of the participants does."""
    known = {*names, *(SYSTEMS if OWNER in names else ())}
    rows = [row for row in rows if set(row.between) <= known]
    failed = [row for row in rows if not row.agrees]
    if not failed:
        return None
    if (of_file := _of_reading(names, rows)) is not None:
        return of_file
    between = [row for row in failed if FILE not in row.between] or failed
    level = min((row.level for row in between), key=ORDER.index)
    if any(row.level == level and set(row.between) == set(SYSTEMS) for row in between):
        names, rows = _by_system(names, rows)
        wrong = {SYSTEMS[0] if name == OWNER else name for name in wrong}
    rows = [row for row in rows if set(row.between) <= set(names)]
    at_level = [row for row in rows if row.level == level and not row.agrees and FILE not in row.between]
    parted = [row for row in at_level if len(row.between) == 2]
    if parted:
        return _of_pairs(names, rows, parted, wrong)
    at_fault = _ordered(names, (row.between[0] for row in at_level))
    others = [name for name in names if name not in at_fault]
    outlier = at_fault[0] if len(at_fault) == 1 and others else ""
    return _diagnosis(
        outlier, at_fault, others, at_level[0], rows, at_level[0].quantity if outlier else "own"
    )


def _of_reading(names: Sequence[str], rows: Sequence[Check]) -> Diagnosis | None:
    """Blame the reading of the file, or an engine that alone differs from the file.

    None if the engines have to be told apart first. The reading is to blame if all engines' models agree
    with each other and none with the file.
    """
    with_file = [row for row in rows if FILE in row.between]
    failed = [row for row in with_file if not row.agrees]
    if not failed:
        return None
    compared = _ordered(names, (name for row in with_file for name in row.between if name != FILE))
    parted = _ordered(names, (name for row in failed for name in row.between if name != FILE))
    if len(parted) == 1 and len(compared) > 1:
        others = [name for name in compared if name not in parted]
        # with its values, which is more than the reader of the file knows
        of_models = [row for row in rows if row.level not in OF_RUNS]
        own = [row for row in of_models if row.detail and not row.agrees and parted[0] in row.between]
        return _diagnosis(parted[0], [*parted, FILE], [*others, FILE], [*own, *failed][0], rows, "others")
    among = [row for row in rows if set(row.between) <= set(compared) and row.level not in OF_RUNS]
    if not all(row.agrees for row in among):
        return None
    outlier = FILE if parted == compared and len(compared) > 1 else ""
    others = [name for name in compared if outlier or name not in parted]
    return _diagnosis(outlier, [*parted, FILE], others, failed[0], rows, "others")


def _of_pairs(
    names: Sequence[str], rows: Sequence[Check], parted: Sequence[Check], wrong: Collection[str]
) -> Diagnosis:
    """Who differs at a level at which pairs part."""
    level = parted[0].level
    pairs = {frozenset(row.between) for row in rows if row.level == level and len(row.between) == 2}
    bad = {frozenset(row.between) for row in parted}
    present = _ordered(names, (name for pair in pairs for name in pair))
    alone = [name for name in present if all(pair in bad for pair in pairs if name in pair)]
    rest = [name for name in present if name not in alone]
    if alone and len(rest) > 1 and not any(pair <= set(rest) for pair in bad):
        if set(SYSTEMS) <= set(alone):  # neither is right
            return replace(
                _outlier_diagnosis(SYSTEMS[0], present, rest, rows, parted, "others"), outlier=OWNER
            )
        return _outlier_diagnosis(alone[0], present, rest, rows, parted, "others")
    at_fault = _ordered(names, (name for pair in bad for name in pair))
    between = [name for name in present if name not in at_fault]
    if len(at_fault) == 2 and between:
        for outlier, other in (at_fault, at_fault[::-1]):
            if all(_is_nearer(other, outlier, third, parted[0], rows) for third in between):
                return _outlier_diagnosis(outlier, at_fault, [other, *between], rows, parted, "nearness")
    settled = _settled(at_fault, rows, level, wrong)
    if settled is not None:
        outlier, by = settled
        others = [name for name in present if name != outlier]
        return _outlier_diagnosis(outlier, at_fault, others, rows, parted, by)
    return _diagnosis("", at_fault, between, parted[0], rows)


def _outlier_diagnosis(
    outlier: str,
    differing: Sequence[str],
    others: Sequence[str],
    rows: Sequence[Check],
    parted: Sequence[Check],
    by: str,
) -> Diagnosis:
    row = next(row for row in parted if outlier in row.between)
    return _diagnosis(outlier, differing, others, row, rows, by)


def _is_nearer(near: str, far: str, third: str, row: Check, rows: Sequence[Check]) -> bool:
    """True if one of two that part is much nearer to a third than the other, in the check they part in."""
    values = {
        frozenset(other.between): other.value
        for other in rows
        if (other.level, other.quantity) == (row.level, row.quantity)
    }
    one, two = (values.get(frozenset((name, third))) for name in (near, far))
    return one is not None and two is not None and NEARER_RATIO * one <= two


def _settled(
    names: Sequence[str], rows: Sequence[Check], level: str, wrong: Collection[str]
) -> tuple[str, str] | None:
    """The one of some that part that alone fails by itself, and the check that does.

    Runs are no evidence about models: an exact model may be integrated with a large error.
    """
    failed = {
        row.between[0]: row.quantity
        for row in reversed(rows)
        if len(row.between) == 1
        and not row.agrees
        and row.between[0] in names
        and (row.quantity == MOMENTUM) == (level not in OF_RUNS)
    }
    if len(failed) == 1:
        return next(iter(failed.items()))
    off = [name for name in names if name in wrong]
    return (off[0], "reference") if len(off) == 1 else None


def _diagnosis(
    outlier: str,
    differing: Sequence[str],
    agree: Sequence[str],
    row: Check,
    rows: Sequence[Check],
    by: str = "",
) -> Diagnosis:
    """Make the diagnosis, with the agreement of the participants other than the outlier."""
    among = [other for other in rows if set(other.between) <= set(agree)]
    pairs = [other for other in among if len(other.between) == 2]
    # engines are compared with each other beside a file that they are read from
    at_level = [other for other in pairs if other.level == row.level or FILE in differing]
    held = all(other.agrees for other in at_level)
    everywhere = held and all(other.agrees for other in among)
    values = [other.value for other in (pairs if everywhere else at_level)]
    within = max(values, default=None) if held else None
    fault = ""
    if outlier == FILE:
        fault = "reading"
    elif outlier:
        fault = "integration" if row.level in OF_RUNS and row.quantity != MOMENTUM else "model"
    return Diagnosis(
        outlier,
        tuple(differing),
        tuple(agree) if held or not outlier else (),
        within,
        everywhere,
        row.level,
        row.quantity,
        row.value,
        row.tolerance,
        row.where,
        by,
        fault,
        detail=row.detail,
    )


def _against_reference(
    names: Sequence[str], rows: Sequence[Check], measured: Sequence[ReferenceCheck]
) -> Diagnosis:
    """Make the diagnosis of engines that agree with each other, but not with reference values."""
    failed = [known for known in measured if not known.agrees]
    at_fault = _ordered(names, (known.engine for known in failed))
    others = [name for name in names if name not in at_fault and name != FILE]
    outlier = at_fault[0] if len(at_fault) == 1 and others else ""
    found = _diagnosis(outlier, at_fault, others, failed[0], rows, "reference" if outlier else "")
    return replace(found, fault="integration" if outlier else "")


def _ordered(names: Sequence[str], some: Iterable[str]) -> list[str]:
    """Some of the names, in their order."""
    wanted = set(some)
    return [name for name in names if name in wanted]
