"""Cases of a stress test: one value of one engine at one setting, judged by a bound with a reason.

Each case runs in a separate process with a time limit.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from crosscheck.studies.stress.runs import Setting
from crosscheck.support.processes import ProcessLostError, run_in_processes
from newton_euler.errors import NewtonEulerError
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory

PROCESSES = 2
"""Number of processes that run cases."""

Verdict = Literal["survives", "degrades", "fails", "refuses"]
"""Result of a case: value within its bound, within the wider bound, beyond both, or an error with a
reason."""

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Bound:
    """Bound on a measured value.

    Attributes:
        quantity, unit: quantity and unit of the value.
        survives: largest value of a passing case (smallest if `at_least`); NaN for cases without an answer,
            in which the engine should raise an error.
        degrades: wider bound; an engine beyond it fails, since its answer is useless.
        reason: reason for these numbers.
        at_least: True if large values are good.
    """

    quantity: str
    unit: str
    survives: float
    degrades: float
    reason: str
    at_least: bool = False

    @property
    def has_answer(self) -> bool:
        """False if the engine should raise an error."""
        return not math.isnan(self.survives)

    def verdict(self, value: float) -> Verdict:
        """Judge a value; a value that is not finite fails."""
        if not math.isfinite(value):
            return "fails"
        sign = -1.0 if self.at_least else 1.0
        if sign * value <= sign * self.survives:
            return "survives"
        return "degrades" if sign * value <= sign * self.degrades else "fails"

    def __str__(self) -> str:
        return f"{'>=' if self.at_least else '<='} {self.survives:.0e}" if self.has_answer else "refusal"


# Bounds of several topics

ENERGY_BOUND = Bound(
    "energy error", "rel", 1e-6, 1e-2, "1e-6 is invisible in a plot; beyond 1 % the motion is a different one"
)
ANGLE_BOUND = Bound("angle error", "rad", 1e-6, 1e-2, "1e-6 is invisible in a plot; half a degree is visible")


def refusal(quantity: str, unit: str) -> Bound:
    """Return the bound of cases without an answer: the engine must raise an error, no value passes."""
    reason = "a case without an answer must end with an error that names the time or the element"
    return Bound(quantity, unit, math.nan, math.nan, reason)


class Measurement(NamedTuple):
    """Value that a case measured.

    Attributes:
        value: the value, in the unit of the case's bound.
        note: one line about it, or empty.
    """

    value: float
    note: str = ""


@dataclass(frozen=True)
class Case:
    """One test of one engine at one setting.

    Attributes:
        name: description of the test.
        setting: the engine and its options.
        bound: bound on the measured value.
        measure: measures the value; it can be pickled, as it runs in another process.
        names: for cases without an answer, texts that the error must contain to be useful.
        limit: s, CPU time after which the process of the case is ended.
        topic: letter of the topic, see `TOPICS`.
    """

    name: str
    setting: Setting
    bound: Bound
    measure: Callable[[Setting], Measurement]
    names: tuple[str, ...] = ()
    limit: float = 30.0
    topic: str = ""


@dataclass(frozen=True)
class Row:
    """Result of a case.

    Attributes:
        case: the case.
        verdict: the verdict; `refuses` passes only if the case has no answer.
        reason: reason of an error or a failure, else the note on the value.
        value: the measured value; None if the engine raised an error or reached the time limit.
        wall_time: s.
    """

    case: Case
    verdict: Verdict
    reason: str
    value: float | None = None
    wall_time: float = 0.0

    @property
    def passes(self) -> bool:
        """True if the engine gives an accurate answer, or an error if there is no answer."""
        return self.verdict == ("survives" if self.case.bound.has_answer else "refuses")

    @property
    def entry(self) -> dict[str, Any]:
        """The case and its result, for JSON."""
        case, bound = self.case, self.case.bound
        return {
            "topic": case.topic,
            "name": case.name,
            "engine": case.setting.engine,
            "setting": str(case.setting),
            "quantity": bound.quantity,
            "unit": bound.unit,
            "value": self.value,
            "bound": str(bound),
            "bound_reason": bound.reason,
            "verdict": self.verdict,
            "reason": self.reason,
            "passes": self.passes,
            "wall_time": self.wall_time,
        }


def of_run(
    scene: Scene, measure: Callable[[Scene, Trajectory], Measurement | float], setting: Setting
) -> Measurement:
    """Simulate a scene at a setting and measure the run."""
    found = measure(scene, setting.simulate(scene))
    return found if isinstance(found, Measurement) else Measurement(found)


def judge(case: Case) -> Row:
    """Run a case; any exception becomes part of the result."""
    start, value = time.perf_counter(), None
    verdict: Verdict = "fails"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # values that are not finite fail anyway
            value, reason = case.measure(case.setting)
        verdict = case.bound.verdict(value)
        if not case.bound.has_answer:
            reason = f"completes without an error, {reason}".rstrip(", ")
    except NewtonEulerError as error:
        reason, missing = str(error), [name for name in case.names if name not in str(error)]
        if missing:
            reason = f"the error does not name {' and '.join(missing)}: {reason}"
        else:
            verdict = "refuses"
    except Exception as error:  # engines should raise NewtonEulerError only
        reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
    return Row(case, verdict, reason, value, time.perf_counter() - start)


def run_cases(cases: Sequence[Case], progress: Progress) -> list[Row]:
    """Run all cases in `PROCESSES` processes, and return their results in order.

    A case that reaches its time limit fails, and its process is ended. Within a topic, cases with long limits
    start first.
    """
    order = sorted(range(len(cases)), key=lambda k: (cases[k].topic, -cases[k].limit))
    found = run_in_processes(
        judge,
        [cases[k] for k in order],
        PROCESSES,
        lambda count, case: progress(f"{count} of {len(cases)} cases, last ({case.topic}) {case.name}"),
        lambda case: case.limit,
    )
    rows = dict(zip(order, found, strict=True))
    lost = {
        k: Row(cases[k], "fails", str(row)) for k, row in rows.items() if isinstance(row, ProcessLostError)
    }
    return [(rows | lost)[k] for k in range(len(cases))]  # type: ignore[misc]
