"""Topics of stress tests, such as stiff gains or singular configurations, and the function that runs them.

A case measures one value of one engine at one setting. A topic is a group of cases, with a letter, a title,
and a function that yields its cases. `crosscheck stress` calls `stress`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

from crosscheck.engines.engine import Engine
from crosscheck.studies.stress import (
    configurations,
    extremes,
    integration,
    noise,
    random_mechanisms,
    rotation,
)
from crosscheck.studies.stress.cases import Case, CaseResult, Progress, run_cases
from crosscheck.support.errors import CrosscheckError


class Topic(NamedTuple):
    """Title of a group of cases, and the function that yields those of engines: all if it gets True."""

    title: str
    cases: Callable[[bool, Sequence[Engine]], Iterator[Case]]


TOPICS = {
    "a": Topic("drift and energy over long runs", integration.long_run_cases),
    "b": Topic("largest stable step, loosest tolerance", integration.step_size_cases),
    "c": Topic("stiff gains", extremes.stiff_gain_cases),
    "d": Topic("mass ratios, inertias near the realizable limit", extremes.mass_ratio_cases),
    "e": Topic("start poses off the constraints", configurations.violated_start_cases),
    "f": Topic("singular configurations", configurations.singular_cases),
    "g": Topic("many turns and high speeds", rotation.cases),
    "h": Topic("random mechanisms", random_mechanisms.cases),
    "i": Topic("floating-point traps", extremes.floating_point_cases),
    "j": Topic("noise in overconstrained loops", noise.cases),
}
"""Topics by letter."""


def wanted_topics(letters: str) -> list[str]:
    """Return the letters of some topics, such as "ac", in the order of `TOPICS`; all topics if it is empty.

    Raises:
        CrosscheckError: for an unknown letter.
    """
    for letter in letters:
        if letter not in TOPICS:
            raise CrosscheckError(f"unknown topic {letter!r}; choose from: {', '.join(TOPICS)}")
    return [letter for letter in TOPICS if letter in (letters or TOPICS)]


def stress(
    letters: Sequence[str], full: bool, engines: Sequence[Engine], progress: Progress
) -> list[CaseResult]:
    """Run the cases of some topics.

    Args:
        letters: letters of the topics, see `wanted_topics`.
        full: True for all cases, False for the short form that continuous integration runs.
        engines: engines whose settings of stress tests can be loaded.
        progress: called with the number of finished cases.

    Returns:
        The result of each case.

    Raises:
        CrosscheckError: if the engines have no cases in these topics, or cannot express any of them.
    """
    cases = [case for letter in letters for case in cases_of(letter, full, engines)]
    results = run_cases(cases, progress)
    if not any(result.expressed for result in results):
        names = " and ".join(engine.name for engine in engines)
        reason = results[0].reason if results else "the Engine has no settings for it, see `stress_settings`"
        topics = f"topic{'s' * (len(letters) > 1)} {', '.join(letters)}"
        raise CrosscheckError(f"no case of {names} ran in {topics}: {reason}")
    return results


def cases_of(letter: str, full: bool, engines: Sequence[Engine]) -> list[Case]:
    """Return the cases of the topic with a letter; other arguments as of `stress`."""
    return [replace(case, topic=letter) for case in TOPICS[letter].cases(full, engines)]
