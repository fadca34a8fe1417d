"""Topics of stress tests, and the function that runs their cases."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

from crosscheck.studies.stress import (
    configurations,
    extremes,
    integration,
    noise,
    random_mechanisms,
    rotation,
)
from crosscheck.studies.stress.cases import Case, Progress, Row, run_cases
from crosscheck.support.errors import CrosscheckError

TOPICS: dict[str, tuple[str, Callable[[bool], Iterator[Case]]]] = {
    "a": ("drift and energy over long runs", integration.long_runs),
    "b": ("largest stable step, loosest tolerance", integration.largest_steps),
    "e": ("stiff gains", extremes.stiff_gains),
    "f": ("mass ratios, inertias near the realisable limit", extremes.masses),
    "g": ("start poses off the constraints", configurations.starts),
    "h": ("singular configurations", configurations.singular),
    "i": ("many turns and high speeds", rotation.cases),
    "j": ("random mechanisms", random_mechanisms.cases),
    "k": ("floating-point traps", extremes.traps),
    "l": ("noise in overconstrained loops", noise.cases),
}
"""Title of each topic, and a function of `full` that yields its cases, by the topic's letter."""


def stress(letters: str, full: bool, progress: Progress) -> list[Row]:
    """Run the cases of some topics.

    Args:
        letters: letters of topics; all topics if empty.
        full: True for all cases, False for the short form.
        progress: called with the number of finished cases.

    Returns:
        The result of each case.

    Raises:
        CrosscheckError: for an unknown letter.
    """
    for letter in letters:
        if letter not in TOPICS:
            raise CrosscheckError(f"unknown topic {letter!r}; choose from: {', '.join(TOPICS)}")
    wanted = [letter for letter in TOPICS if letter in (letters or TOPICS)]
    return run_cases([case for letter in wanted for case in cases_of(letter, full)], progress)


def cases_of(letter: str, full: bool) -> list[Case]:
    """Return the cases of one topic."""
    return [replace(case, topic=letter) for case in TOPICS[letter][1](full)]
