"""Cases of a stress test, and their execution in separate processes with a time limit.

A case measures one value, such as the energy error of a run, of one engine at one setting. A bound judges the
value. Some cases have no answer, such as a run with an infinite force; there the engine must raise an error
that names the cause.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from crosscheck.engines.limits import CannotExpressError
from crosscheck.studies.stress.runs import Setting
from crosscheck.support.processes import ProcessLostError, run_in_processes
from newton_euler.errors import NewtonEulerError
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory

PROCESSES = 2
"""Number of processes that run cases at the same time."""

Verdict = Literal["survives", "degrades", "fails", "refuses", "not expressed"]
"""Result of a case: "survives" for a value within its bound, "degrades" within a wider bound, "fails" beyond
both, "refuses" for an error that names the cause, "not expressed" for a scene that the engine cannot express,
so that the case says nothing of it."""

Progress = Callable[[str], None]
"""Function that shows one line on the progress of the test."""


@dataclass(frozen=True)
class Bound:
    """Bound on a measured value.

    Attributes:
        quantity: name of the measured quantity.
        unit: unit of the quantity.
        survives: limit of values that pass: the largest such value, or the smallest one if `at_least`. It is
            NaN for cases without an answer, in which the engine should raise an error.
        degrades: limit of values that are inaccurate but still useful. Beyond this limit the engine fails.
        reason: reason for the two limits.
        at_least: True if large values are good, False if small values are good.
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
        """Return the verdict on a value; a value that is not finite fails."""
        if not math.isfinite(value):
            return "fails"
        sign = -1.0 if self.at_least else 1.0
        if sign * value <= sign * self.survives:
            return "survives"
        return "degrades" if sign * value <= sign * self.degrades else "fails"

    def __str__(self) -> str:
        return f"{'>=' if self.at_least else '<='} {self.survives:.0e}" if self.has_answer else "refusal"


# Bounds that several topics use

ENERGY_BOUND = Bound(
    "energy error",
    "relative",
    1e-6,
    1e-2,
    "1e-6 is invisible in a plot; beyond 1 % the motion is a different one",
)
"""Bound on the energy balance error, relative to the energy scale of the run."""

ANGLE_BOUND = Bound("angle error", "rad", 1e-6, 1e-2, "1e-6 is invisible in a plot; half a degree is visible")
"""Bound on the error of an angle of a body."""


def refusal(quantity: str, unit: str) -> Bound:
    """Return the bound of cases without an answer: no value passes, the engine must raise an error.

    `quantity` and `unit` describe the value that is reported if the engine raises no error.
    """
    reason = "a case without an answer must end with an error that names the time or the element"
    return Bound(quantity, unit, math.nan, math.nan, reason)


class Measurement(NamedTuple):
    """Value that a case measured.

    Attributes:
        value: the value, in the unit of the case's bound.
        note: one line about the value, such as the number of steps, or empty.
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
        measure: function that measures the value at a setting. It is pickled, as it runs in another process.
        required_texts: for cases without an answer, texts that the error must contain, such as a joint name.
        time_limit: CPU time, s, after which the process of the case is ended.
        topic: letter of the topic, a key of `crosscheck.studies.stress.topics.TOPICS`, set before the run.
    """

    name: str
    setting: Setting
    bound: Bound
    measure: Callable[[Setting], Measurement]
    required_texts: tuple[str, ...] = ()
    time_limit: float = 30.0
    topic: str = ""


@dataclass(frozen=True)
class CaseResult:
    """Result of a case.

    Attributes:
        case: the case.
        verdict: the verdict; "refuses" passes only if the case has no answer.
        reason: message of the error if there was one, else the note on the value.
        value: the measured value; None if the engine raised an error or reached the time limit.
        wall_time: duration of the case, s.
    """

    case: Case
    verdict: Verdict
    reason: str
    value: float | None = None
    wall_time: float = 0.0

    @property
    def expressed(self) -> bool:
        """False if the engine cannot express the scene of the case."""
        return self.verdict != "not expressed"

    @property
    def passes(self) -> bool:
        """True if the engine gives an accurate answer, or raises an error in a case without an answer."""
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
            "passes": self.passes if self.expressed else None,
            "wall_time": self.wall_time,
        }


def simulate_and_measure(
    scene: Scene, measure: Callable[[Scene, Trajectory], Measurement | float], setting: Setting
) -> Measurement:
    """Simulate a scene at a setting and measure the run.

    Args:
        scene: the scene.
        measure: function of the scene and the run that returns the value, with or without a note.
        setting: engine and options.
    """
    found = measure(scene, setting.simulate(scene))
    return found if isinstance(found, Measurement) else Measurement(found)


def run_case(case: Case) -> CaseResult:
    """Run a case and judge the value; any exception becomes part of the result."""
    start, value = time.perf_counter(), None
    verdict: Verdict = "fails"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # values that are not finite fail anyway
            value, reason = case.measure(case.setting)
        verdict = case.bound.verdict(value)
        if not case.bound.has_answer:
            reason = f"completes without an error, {reason}".rstrip(", ")
    except CannotExpressError as error:
        verdict, reason = "not expressed", str(error)
    except NewtonEulerError as error:
        reason = str(error)
        missing = [text for text in case.required_texts if text not in reason]
        if missing:
            reason = f"the error does not name {' and '.join(missing)}: {reason}"
        else:
            verdict = "refuses"
    except Exception as error:  # engines should raise NewtonEulerError only
        reason = f"{type(error).__name__}: {' '.join(str(error).split())}"
    return CaseResult(case, verdict, reason, value, time.perf_counter() - start)


def run_cases(cases: Sequence[Case], progress: Progress) -> list[CaseResult]:
    """Run all cases in `PROCESSES` processes, and return their results in order.

    A case that reaches its time limit fails, and its process is ended. Within a topic, cases with long limits
    start first.
    """
    order = sorted(range(len(cases)), key=lambda k: (cases[k].topic, -cases[k].time_limit))
    found = run_in_processes(
        run_case,
        [cases[k] for k in order],
        PROCESSES,
        done=lambda count, case: progress(f"{count} of {len(cases)} cases, last ({case.topic}) {case.name}"),
        limit=lambda case: case.time_limit,
    )
    results: dict[int, CaseResult] = {}
    for k, result in zip(order, found, strict=True):
        if isinstance(result, ProcessLostError):  # the process ended early or reached the time limit
            results[k] = CaseResult(cases[k], "fails", str(result))
        else:
            results[k] = result
    return [results[k] for k in range(len(cases))]
