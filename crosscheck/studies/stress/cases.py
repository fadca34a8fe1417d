"""Cases of a stress run: one figure of one engine at one setting, judged by a bound that says why."""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from crosscheck.studies.stress.runs import Setting
from newton_euler.errors import NewtonEulerError

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


@dataclass(frozen=True)
class Measured:
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
        topic, name, engine, setting, quantity, unit: of the case.
        figure: what was measured; None if the engine refused or was given up.
        bound, bound_reason: what it had to be, and why.
        verdict: `refuses` is right where there is no answer and a shortcoming where there is one.
        reason: of a refusal or a failure; else what there is to say about the figure.
        passes: whether this is what one would want of an engine.
        wall_time: s.
    """

    topic: str
    name: str
    engine: str
    setting: str
    quantity: str
    unit: str
    figure: float | None
    bound: str
    bound_reason: str
    verdict: Verdict
    reason: str
    passes: bool
    wall_time: float


def judge(case: Case) -> Row:
    """Run a case; whatever goes wrong in it is a row like others."""
    start, measured = time.perf_counter(), None
    verdict: Verdict = "fails"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # figures that are not finite are failures anyway
            measured = case.measure(case.setting)
        verdict, reason = case.bound.verdict(measured.figure), measured.note
        if not case.bound.has_answer:
            reason = f"runs on without a word, {measured.note}".rstrip(", ")
    except NewtonEulerError as error:
        reason, missing = str(error), [name for name in case.names if name not in str(error)]
        if missing:
            reason = f"refuses without naming {' and '.join(missing)}: {reason}"
        else:
            verdict = "refuses"
    except Exception as error:  # an error of no kind that engines are to raise
        reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
    return row_of(case, verdict, reason, measured, time.perf_counter() - start)


def row_of(
    case: Case, verdict: Verdict, reason: str, measured: Measured | None = None, wall_time: float = 0.0
) -> Row:
    """Return the row of a case."""
    return Row(
        topic=case.topic,
        name=case.name,
        engine=case.setting.engine,
        setting=str(case.setting),
        quantity=case.bound.quantity,
        unit=case.bound.unit,
        figure=measured.figure if measured else None,
        bound=str(case.bound),
        bound_reason=case.bound.reason,
        verdict=verdict,
        reason=reason,
        passes=verdict == ("survives" if case.bound.has_answer else "refuses"),
        wall_time=wall_time,
    )
