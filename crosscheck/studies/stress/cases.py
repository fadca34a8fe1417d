"""Cases of a stress run: one figure of one engine at one setting, judged by a bound that says why.

Cases run in processes of their own, each with a time limit.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from crosscheck.studies.stress.runs import Setting
from crosscheck.support.processes import LostError, in_processes
from newton_euler.errors import NewtonEulerError
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory

PROCESSES = 2

Verdict = Literal["survives", "degrades", "fails", "refuses"]

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Bound:
    """A figure and the values that it is to have.

    Attributes:
        quantity, unit: of the figure.
        survives: the most it may be, or the least if `at_least`; NaN where there is no answer.
        degrades: beyond that the answer is no use any more, and the engine fails.
        reason: why just that.
        at_least: whether large figures are good ones.
    """

    quantity: str
    unit: str
    survives: float
    degrades: float
    reason: str
    at_least: bool = False

    @property
    def has_answer(self) -> bool:
        return not math.isnan(self.survives)

    def verdict(self, figure: float) -> Verdict:
        """Judge a figure; one that is not finite is a failure."""
        if not math.isfinite(figure):
            return "fails"
        sign = -1.0 if self.at_least else 1.0
        if sign * figure <= sign * self.survives:
            return "survives"
        return "degrades" if sign * figure <= sign * self.degrades else "fails"

    def __str__(self) -> str:
        return f"{'>=' if self.at_least else '<='} {self.survives:.0e}" if self.has_answer else "refusal"


# Bounds of several topics

ENERGY = Bound(
    "energy error", "rel", 1e-6, 1e-2, "no plot would show less; more than a hundredth is another motion"
)
ANGLE = Bound("angle error", "rad", 1e-6, 1e-2, "no plot would show less; half a degree can be seen")


def refusal(quantity: str, unit: str) -> Bound:
    """Return the bound of cases that have no answer: no figure is good enough."""
    reason = "what has no answer has to be refused, with the time or the element named"
    return Bound(quantity, unit, math.nan, math.nan, reason)


class Measured(NamedTuple):
    """A figure that a case found, and one line about it."""

    figure: float
    note: str = ""


@dataclass(frozen=True)
class Case:
    """One thing to try with one engine at one setting.

    Attributes:
        name: what is tried.
        setting: the engine and its options.
        bound: of the figure.
        measure: a function of the setting, to be sent to another process.
        names: for cases without an answer: texts that a refusal has to hold, to be of use.
        limit: s of processor time, after which its process is ended.
        topic: a letter out of `TOPICS`.
    """

    name: str
    setting: Setting
    bound: Bound
    measure: Callable[[Setting], Measured]
    names: tuple[str, ...] = ()
    limit: float = 30.0
    topic: str = ""


@dataclass(frozen=True)
class Row:
    """The result of a case.

    Attributes:
        verdict: `refuses` is right where there is no answer and a shortcoming where there is one.
        reason: of a refusal or a failure; else what there is to say about the figure.
        figure: what was measured; None if the engine refused or was given up.
        wall_time: s.
    """

    case: Case
    verdict: Verdict
    reason: str
    figure: float | None = None
    wall_time: float = 0.0

    @property
    def passes(self) -> bool:
        """True if this is what one would want of an engine."""
        return self.verdict == ("survives" if self.case.bound.has_answer else "refuses")

    @property
    def entry(self) -> dict[str, Any]:
        """All of it, for JSON."""
        case, bound = self.case, self.case.bound
        return {
            "topic": case.topic,
            "name": case.name,
            "engine": case.setting.engine,
            "setting": str(case.setting),
            "quantity": bound.quantity,
            "unit": bound.unit,
            "figure": self.figure,
            "bound": str(bound),
            "bound_reason": bound.reason,
            "verdict": self.verdict,
            "reason": self.reason,
            "passes": self.passes,
            "wall_time": self.wall_time,
        }


def of_run(
    scene: Scene, measure: Callable[[Scene, Trajectory], Measured | float], setting: Setting
) -> Measured:
    """Measure a run of a scene."""
    found = measure(scene, setting.simulate(scene))
    return found if isinstance(found, Measured) else Measured(found)


def judge(case: Case) -> Row:
    """Run a case; whatever goes wrong in it is a row like others."""
    start, figure = time.perf_counter(), None
    verdict: Verdict = "fails"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # figures that are not finite are failures anyway
            figure, reason = case.measure(case.setting)
        verdict = case.bound.verdict(figure)
        if not case.bound.has_answer:
            reason = f"runs on without a word, {reason}".rstrip(", ")
    except NewtonEulerError as error:
        reason, missing = str(error), [name for name in case.names if name not in str(error)]
        if missing:
            reason = f"refuses without naming {' and '.join(missing)}: {reason}"
        else:
            verdict = "refuses"
    except Exception as error:  # an error of no kind that engines are to raise
        reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
    return Row(case, verdict, reason, figure, time.perf_counter() - start)


def run_cases(cases: Sequence[Case], progress: Progress) -> list[Row]:
    """Run all cases, by `PROCESSES` processes, and return their rows in order.

    A case that is not done within its limit is a failure, and its process is ended. Those of a topic that
    may take longest are first.
    """
    order = sorted(range(len(cases)), key=lambda k: (cases[k].topic, -cases[k].limit))
    found = in_processes(
        judge,
        [cases[k] for k in order],
        PROCESSES,
        lambda count, case: progress(f"{count} of {len(cases)} cases, last ({case.topic}) {case.name}"),
        lambda case: case.limit,
    )
    rows = dict(zip(order, found, strict=True))
    lost = {k: Row(cases[k], "fails", str(row)) for k, row in rows.items() if isinstance(row, LostError)}
    return [(rows | lost)[k] for k in range(len(cases))]  # type: ignore[misc]
