"""What engines are put through until something breaks: the form of a case, and how cases are run.

A case measures one number of one engine at one setting and holds it against a bound. Where the bound
comes from is part of the case. Cases run in processes of their own, each with a time limit.
"""

from __future__ import annotations

import math
import multiprocessing
import signal
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import Literal

from crosscheck.errors import CrosscheckError
from crosscheck.workers import end_with_parent, tidied_up
from newton_euler.errors import NewtonEulerError

TOPICS = {
    "a": "drift and energy over long runs",
    "b": "largest stable step, loosest tolerance",
    "c": "Baumgarte's gain against step size",
    "d": "MuJoCo's softness against step size",
    "e": "stiff gains",
    "f": "mass ratios, inertias near the realisable limit",
    "g": "start poses off the constraints",
    "h": "singular configurations",
    "i": "many turns and high speeds",
    "j": "random mechanisms",
    "k": "floating-point traps",
    "l": "noise in overconstrained loops",
}
"""What is tried, by letter."""

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


class _Worker:
    """A process that runs cases, one at a time, and can be ended whatever it is doing."""

    def __init__(self) -> None:
        # a fresh process: a fork would share the threads that libraries have started
        context = multiprocessing.get_context("spawn")
        self.connection, other = context.Pipe()
        self.process = context.Process(target=_serve, args=(other,), daemon=True)
        self.process.start()
        other.close()
        self.topic = ""
        """Of its last case: references and native code of that topic are at hand."""

    def begin(self, number: int, case: Case) -> None:
        self.number, self.case, self.topic, self.started = number, case, case.topic, time.monotonic()
        self.connection.send(case)

    def finished(self) -> Row:
        """The row of its case; the process has ended if that has taken it along."""
        try:
            row: Row = self.connection.recv()
        except EOFError:
            self.end()
            reason = f"the process ended, {self.process.exitcode}"
            if self.process.exitcode == -signal.SIGPROF:
                reason = f"not done after {self.case.limit:g} s of processor time"
            return row_of(self.case, "fails", reason, time.monotonic() - self.started)
        return row

    def end(self) -> None:
        self.process.kill()
        self.process.join()
        self.connection.close()


def _serve(connection: Connection) -> None:
    """Run cases until there are no more."""
    end_with_parent()
    while True:
        try:
            case: Case = connection.recv()
        except EOFError:
            return
        signal.setitimer(signal.ITIMER_PROF, case.limit)  # whose signal ends a process, native code or not
        row = judge(case)
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        connection.send(row)


@tidied_up()
def run_cases(cases: Sequence[Case], progress: Progress) -> list[Row]:
    """Rows of all cases in their order, by `PROCESSES` processes, each at a topic of its own while it can be.

    Of a topic, and of topics, those that may take longest are first. A case that is not done within its limit
    is a failure, and its process is ended.
    """
    rows: dict[int, Row] = {}
    waiting = list(range(len(cases)))
    busy: list[_Worker] = []
    idle = [_Worker() for _ in range(min(PROCESSES, len(cases)))]
    try:
        while waiting or busy:
            while waiting and idle:
                worker, taken = idle.pop(), {other.topic for other in busy}
                k = min(waiting, key=lambda k: _order(cases[k], worker.topic, taken))
                waiting.remove(k)
                worker.begin(k, cases[k])
                busy.append(worker)
            ready = wait([worker.connection for worker in busy])
            for worker in [worker for worker in busy if worker.connection in ready]:
                rows[worker.number] = worker.finished()
                busy.remove(worker)
                idle.append(worker if worker.process.is_alive() else _Worker())
                last = f"({worker.case.topic}) {worker.case.name}"
                progress(f"{len(rows)} of {len(cases)} cases, last {last}")
    finally:
        for worker in busy + idle:
            worker.end()
    return [rows[k] for k in range(len(cases))]


def _order(case: Case, own: str, taken: set[str]) -> tuple[bool, bool, float]:
    """What a process whose last topic was `own` sorts cases by, where others are at the topics `taken`."""
    return case.topic != own, case.topic in taken, -case.limit


def stress(letters: str, full: bool, progress: Progress) -> list[Row]:
    """Rows of all cases of some topics.

    Args:
        letters: out of `TOPICS`, all if empty.
        full: in a quarter of an hour, or what of it takes two minutes.
        progress: told what is going on.

    Raises:
        CrosscheckError: for an unknown letter.
    """
    for letter in letters:
        if letter not in TOPICS:
            raise CrosscheckError(f"unknown topic {letter!r}; choose from: {', '.join(TOPICS)}")
    wanted = [letter for letter in TOPICS if letter in (letters or TOPICS)]
    rows = run_cases([case for letter in wanted for case in cases_of(letter, full)], progress)
    if "j" in wanted:
        from crosscheck.studies.random.mechanisms import stress_random

        rows += stress_random(1000 if full else 40, 0, progress)
    return sorted(rows, key=lambda row: row.topic)


def cases_of(letter: str, full: bool) -> list[Case]:
    """The cases of one topic; those of random mechanisms are rows of their own making."""
    from crosscheck.studies.stress import (
        baumgarte,
        long_runs,
        masses,
        noise,
        rotation,
        singular,
        soft,
        starts,
        steps,
        stiff,
        traps,
    )

    makers: dict[str, Callable[[bool], list[Case]]] = {
        "a": long_runs.cases,
        "b": steps.cases,
        "c": baumgarte.cases,
        "d": soft.cases,
        "e": stiff.cases,
        "f": masses.cases,
        "g": starts.cases,
        "h": singular.cases,
        "i": rotation.cases,
        "k": traps.cases,
        "l": noise.cases,
    }
    return makers[letter](full) if letter in makers else []
