"""Cases of a stress run: one number of one engine at one setting, judged by a bound.

Where the bound comes from is part of the case.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from newton_euler.errors import NewtonEulerError

PROCESSES = 2

Verdict = Literal["survives", "degrades", "fails", "refuses"]

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Bound:
    """What a figure has to be.

    Attributes:
        survives: the most it may be, or the least if `at_least`.
        degrades: beyond that the answer is no use any more, and the engine fails.
        reason: why just that.
        at_least: whether large figures are good ones.
    """

    survives: float
    degrades: float
    reason: str
    at_least: bool = False

    def verdict(self, figure: float) -> Verdict:
        """What a figure means; one that is not finite is a failure."""
        if not math.isfinite(figure):
            return "fails"
        sign = -1.0 if self.at_least else 1.0
        if sign * figure <= sign * self.survives:
            return "survives"
        return "degrades" if sign * figure <= sign * self.degrades else "fails"

    def __str__(self) -> str:
        return f"{'>=' if self.at_least else '<='} {self.survives:.0e}"


REFUSAL = Bound(0.0, 0.0, "what has no answer has to be refused, with the time or the element named")
"""Of cases that have no answer: no figure is good enough."""


@dataclass(frozen=True)
class Curve:
    """A line of a plot.

    Attributes:
        plot: title of the plot that it belongs to.
        x_label, y_label: of that plot's axes, with units; both logarithmic.
        label: of the line.
        x, y: positive numbers.
    """

    plot: str
    x_label: str
    y_label: str
    label: str
    x: tuple[float, ...]
    y: tuple[float, ...]


@dataclass(frozen=True)
class Measured:
    """What a case found: its figure, one line about it, and curves to plot."""

    figure: float
    note: str = ""
    curves: tuple[Curve, ...] = ()


@dataclass(frozen=True)
class Case:
    """One thing to try with one engine at one setting.

    Attributes:
        topic: a letter out of `TOPICS`.
        name: what is tried.
        engine: name of the engine.
        setting: formulation, integrator, stabilisation, tolerances.
        quantity, unit: what is measured.
        bound: what it has to be; `REFUSAL` if there is no answer.
        measure: a function of a module with its arguments, to be sent to another process.
        names: for cases without an answer: texts that a refusal has to hold, to be of use.
        limit: s of processor time, after which its process is ended.
    """

    topic: str
    name: str
    engine: str
    setting: str
    quantity: str
    unit: str
    bound: Bound
    measure: Callable[[], Measured]
    names: tuple[str, ...] = ()
    limit: float = 30.0

    @property
    def has_answer(self) -> bool:
        return self.bound != REFUSAL  # which comes from another process as a copy


@dataclass(frozen=True)
class Row:
    """What came of a case.

    Attributes:
        topic, name, engine, setting, quantity, unit: of the case.
        figure: what was measured; None if the engine refused or was given up.
        bound, bound_reason: what it had to be, and why.
        verdict: `refuses` is right where there is no answer and a shortcoming where there is one.
        reason: of a refusal or a failure; else what there is to say about the figure.
        passes: whether this is what one would want of an engine.
        wall_time: s.
        curves: to plot.
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
    curves: tuple[Curve, ...] = ()


def judge(case: Case) -> Row:
    """Run a case; whatever goes wrong in it is a row like others."""
    start = time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # figures that are not finite are failures anyway
            measured = case.measure()
    except NewtonEulerError as error:
        return _refused(case, str(error), time.perf_counter() - start)
    except Exception as error:  # an error of no kind that engines are to raise
        reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
        return row_of(case, "fails", reason, time.perf_counter() - start)
    wall_time = time.perf_counter() - start
    if not case.has_answer:
        reason = f"runs on without a word, {measured.note}".rstrip(", ")
        return row_of(case, "fails", reason, wall_time, measured)
    return row_of(case, case.bound.verdict(measured.figure), measured.note, wall_time, measured)


def _refused(case: Case, reason: str, wall_time: float) -> Row:
    missing = [name for name in case.names if name not in reason]
    if missing and not case.has_answer:
        return row_of(case, "fails", f"refuses without naming {' and '.join(missing)}: {reason}", wall_time)
    return row_of(case, "refuses", reason, wall_time)


def row_of(
    case: Case, verdict: Verdict, reason: str, wall_time: float, measured: Measured | None = None
) -> Row:
    """The row of a case."""
    return Row(
        case.topic,
        case.name,
        case.engine,
        case.setting,
        case.quantity,
        case.unit,
        measured.figure if measured else None,
        str(case.bound) if case.has_answer else "refusal",
        case.bound.reason,
        verdict,
        reason,
        verdict == ("survives" if case.has_answer else "refuses"),
        wall_time,
        measured.curves if measured else (),
    )
