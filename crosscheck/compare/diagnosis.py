"""Diagnosis of a comparison: which engine is the outlier, at which level, and whether its model is wrong.

`crosscheck.compare.outlier.diagnose` returns a `Diagnosis` for each level (group of checks) at which engines
differ; its properties are the sentences of reports. Participants are the engines, the formulations of
newton_euler if these differ from each other, and the model file at the level `READING`. A formulation is a
form of the equations of motion: in joint coordinates ("relative") or in Cartesian ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from crosscheck.compare.check import FILE, READING, REFERENCE
from crosscheck.engines.registry import SOLVER
from newton_euler.compiled.formulations import FORMULATIONS

SOLVER_NAME = SOLVER.name
"""The only engine that has several formulations."""

FORMULATION_NAMES = tuple(FORMULATIONS)
"""Names of the formulations of `SOLVER_NAME`. Its runs use the first one."""

NEARER_RATIO = 10.0
"""Ratio of the distances of two participants from a third one, beyond which the farther one is the
outlier."""

FAULTS = {
    "model": "{0} model is wrong",
    "integration": "{0} integration is at fault",
    "model or integration": "{0} model or integration is at fault: its equations were not compared",
    "reactions": "{0} reactions are wrong, although its motion agrees",
    "reading": "the reading of the file is wrong",
    "softness": "{0} constraints are too soft: {1}",
    "resolution": "{0} step is too large for this model, or its soft constraints resist each other: "
    "--engines leaves it out",
    "redundancy": "what each makes of nearly redundant constraints is the difference: {1}",
}
"""Sentence for each likely cause. {0} stands for the possessive of the outlier, such as "mujoco's", {1} for
the evidence."""


@dataclass(frozen=True)
class Diagnosis:
    """Diagnosis of the differences at one level.

    Attributes:
        outlier: name of the participant that is likely wrong; empty if the checks do not determine it.
        differing: all participants that differ at the level.
        agree: participants other than the outlier that agree with each other.
        within: largest difference between the participants in `agree`, m, rad or relative: over all levels if
            they agree in all checks, otherwise at this level. None if there are fewer than two.
        everywhere: True if the participants in `agree` agree in all checks.
        level, quantity, value, tolerance, where, detail: attributes of the first failing check.
        decided_by: what determines the outlier. "others": all others agree with each other. "nearness": of
            two differing participants, the other one is nearer to a third. "reference": reference values.
            "own": several participants fail checks of a single participant, so there is no outlier. Any other
            text is the quantity of the failing check of the outlier alone.
        fault: likely cause: "model", "integration", "model or integration", "reactions", "reading",
            "softness", "resolution" or "redundancy"; empty if the cause is not determined.
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
        """Attributes for JSON, and `engine`: the outlier or, if that is a formulation, its engine."""
        engine = self.outlier
        if engine == FILE:
            engine = ""
        elif engine in FORMULATION_NAMES:
            engine = SOLVER_NAME
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
    return f"{SOLVER_NAME}'s {participant} formulation" if participant in FORMULATION_NAMES else participant


def _listed(participants: Sequence[str]) -> str:
    """Return the names of participants for sentences, as "a, b and c"."""
    names = [_named(name) for name in participants]
    return " and ".join(filter(None, [", ".join(names[:-1]), *names[-1:]]))
