"""The topics of a stress run. Cases run in processes of their own, each with a time limit."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from crosscheck.errors import CrosscheckError
from crosscheck.studies.stress import configurations, extremes, integration, noise, rotation
from crosscheck.studies.stress.cases import PROCESSES, Case, Progress, Row, judge, row_of
from crosscheck.studies.stress.random_mechanisms import stress_random
from crosscheck.workers import LostError, in_processes

TOPICS: dict[str, tuple[str, Callable[[bool], Iterator[Case]]]] = {
    "a": ("drift and energy over long runs", integration.long_runs),
    "b": ("largest stable step, loosest tolerance", integration.largest_steps),
    "e": ("stiff gains", extremes.stiff_gains),
    "f": ("mass ratios, inertias near the realisable limit", extremes.masses),
    "g": ("start poses off the constraints", configurations.starts),
    "h": ("singular configurations", configurations.singular),
    "i": ("many turns and high speeds", rotation.cases),
    "j": ("random mechanisms", lambda full: iter(())),
    "k": ("floating-point traps", extremes.traps),
    "l": ("noise in overconstrained loops", noise.cases),
}
"""Titles by letter, and the cases of each, in full or not; random mechanisms make rows of their own."""


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
    rows = dict[int, Row]()
    for k, row in zip(order, found, strict=True):
        rows[k] = row_of(cases[k], "fails", str(row)) if isinstance(row, LostError) else row
    return [rows[k] for k in range(len(cases))]


def stress(letters: str, full: bool, progress: Progress) -> list[Row]:
    """Return the rows of all cases of some topics.

    Args:
        letters: out of `TOPICS`, all if empty.
        full: all cases, or the short form of them.
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
    """Return the cases of one topic."""
    return [replace(case, topic=letter) for case in TOPICS[letter][1](full)]
