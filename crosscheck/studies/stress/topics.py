"""The topics of a stress run. Cases run in processes of their own, each with a time limit."""

from __future__ import annotations

import multiprocessing
import signal
import time
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection, wait

from crosscheck.errors import CrosscheckError
from crosscheck.studies.random.mechanisms import stress_random
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
from crosscheck.studies.stress.cases import PROCESSES, Case, Progress, Row, judge, row_of
from crosscheck.workers import end_with_parent, tidied_up

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

MAKERS: dict[str, Callable[[bool], list[Case]]] = {
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
"""What makes the cases of a topic, by letter."""


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
        rows += stress_random(1000 if full else 40, 0, progress)
    return sorted(rows, key=lambda row: row.topic)


def cases_of(letter: str, full: bool) -> list[Case]:
    """The cases of one topic; those of random mechanisms are rows of their own making."""
    return MAKERS[letter](full) if letter in MAKERS else []
