"""Words of the judgement of a file's own run: its error, the cause, and settings that reduce the error."""

from __future__ import annotations

import math
from collections.abc import Iterator

from crosscheck.own_run.allowed import length
from crosscheck.own_run.errors import Band, RunError
from crosscheck.own_run.judge import Judgement, MeasuredRemedy
from crosscheck.report.table import Lines

MAX_EVENTS = 2
"""Number of elements that one line names of those that act and are not in the reference."""

MIN_CAUSE = 0.01
"""Smallest cause that is listed, as a fraction of the largest one."""

SAME_RUN_TIME = 1.25
"""Ratio of run times up to which settings are as fast."""


def own_run_lines(judgement: Judgement) -> Lines:
    """Word a judgement, the result first."""
    return Lines("", list(_lines(judgement)), verdict=judgement.band.verdict)


def _lines(judgement: Judgement) -> Iterator[str]:
    yield f"your settings  {headline(judgement)}"
    yield f"  run     {judgement.settings} ({judgement.engine})"
    if judgement.stopped:
        yield f"  stopped {judgement.stopped}"
    error = judgement.error
    if error.position or error.rotation:
        yield f"  errors  {'; '.join(_errors(judgement))}"
    if judgement.events:
        first = judgement.events[0]
        others = f" and {len(judgement.events) - 1} more" if judgement.events[1:] else ""
        yield (
            f"  note    judged without {first.element}{others}: it acts from {first.time:.3g} s on and the "
            "reference does not simulate it"
        )
    if judgement.until is not None:
        yield (
            f"  note    compared until {judgement.until:.3g} s: from then on the motion multiplies any error "
            "by more than 1000, and no run with other steps can match"
        )
    by_position = error.is_of_position
    causes = [(each.name, each.error) for each in judgement.causes if each.error.part(by_position) > 0.0]
    if causes:
        least = MIN_CAUSE * causes[0][1].part(by_position)
        listed = [
            f"{name}: {size(each, by_position)}" for name, each in causes if each.part(by_position) >= least
        ]
        yield f"  cause   {'; '.join(listed)}"
    for k, remedy in enumerate(judgement.remedies):
        yield f"  {'fix' if k == 0 else '':<7} {_remedy(remedy, by_position)}"


def headline(judgement: Judgement) -> str:
    """Word the band and the error in a few words."""
    error = judgement.error
    if judgement.stopped:
        return "DIVERGED"
    word = {Band.ACCURATE: "ACCURATE TO", Band.USABLE: "OFF BY", Band.WRONG: "WRONG BY"}[judgement.band]
    return f"{word} {size(error, error.is_of_position)}, {percent(error.relative)} of the motion"


def size(error: RunError, by_position: bool) -> str:
    """Word the error of positions, or of rotations."""
    return length(error.position) if by_position else f"{math.degrees(error.rotation):.2g} deg"


def _errors(judgement: Judgement) -> Iterator[str]:
    """Word all errors of a run, with body and time."""
    error = judgement.error
    if error.position:
        body, time = error.position_at
        yield f"position {length(error.position)} at {body}, {time:.3g} s"
    if error.rotation:
        body, time = error.rotation_at
        yield f"rotation {math.degrees(error.rotation):.2g} deg at {body}, {time:.3g} s"
    if judgement.opening:
        yield f"loop opening {length(judgement.opening)}"
    yield f"energy {percent(error.energy)}"


def _remedy(remedy: MeasuredRemedy, by_position: bool) -> str:
    """Word settings, their error and their run time."""
    cost = "same run time"
    if remedy.run_time > SAME_RUN_TIME and remedy.evaluations > 1.0:
        cost = f"{remedy.run_time:.1f} times the run time"
    changes = " ".join(f'{name}="{value}"' for name, value in remedy.changes.items())
    return f"{changes}: {size(remedy.error, by_position)}, {cost}"


def percent(value: float) -> str:
    """Word a ratio in percent."""
    number = 100.0 * value
    if number >= 10.0:
        return f"{number:.0f} %"
    return f"{number:.2g} %" if number >= 1e-3 else f"{number:.0e} %"
