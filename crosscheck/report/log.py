"""Words of the judgement of a log: its error against the reference, and what limits the comparison."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from crosscheck.own_run.allowed import length
from crosscheck.own_run.log import LogJudgement
from crosscheck.own_run.log_mistake import mistake_line
from crosscheck.report.own_run import error_texts, headline, size
from crosscheck.report.table import Lines

MAX_NAMES = 4
"""Largest number of names of columns or bodies in one line."""

MIN_MOVED = 1e-5
"""Smallest distance of the first row from the start of the reference that is reported, sizes or rad. Files
with six digits are closer."""

POINTS = {"center": "centers of mass", "frame": "origins of body frames"}
"""Points of bodies that positions are of."""


def log_lines(judgement: LogJudgement) -> Lines:
    """Word the judgement of a log, the result first."""
    return Lines("", list(_lines(judgement)), verdict=judgement.band.verdict)


def _lines(judgement: LogJudgement) -> Iterator[str]:
    error, times = judgement.error, judgement.run.time
    yield f"{judgement.name}  {headline(judgement)}"
    compared = f"{len(judgement.compared)} bodies" if len(judgement.compared) > 1 else judgement.compared[0]
    words = [f"{judgement.engine}: {judgement.rows} rows, {times[-1]:.4g} s, {compared}"]
    if judgement.points:
        words.append(f"positions of {POINTS[judgement.points]}")
    if judgement.has_inputs:
        words.append("inputs of the log")
    yield f"  run     {'; '.join(words)}"
    yield from (f"  mistake {mistake_line(mistake)}" for mistake in judgement.mistakes)
    if error.position or error.rotation:
        yield f"  errors  {'; '.join(error_texts(judgement, judgement.has_energy))}"
    yield from (f"  note    {note}" for note in _notes(judgement))


def _notes(judgement: LogJudgement) -> Iterator[str]:
    """Word what limits the comparison."""
    if judgement.events:
        first = judgement.events[0]
        end = "compared until then" if first.time > 0.0 else "the error may be due to it"
        yield f"{first.element} acts from {first.time:.3g} s on and the reference does not simulate it: {end}"
    if judgement.until is not None:
        yield (
            f"compared until {judgement.until:.3g} s: from then on the motion multiplies any error by more "
            "than 1000"
        )
    start = judgement.start
    if start and judgement.scene:
        gap = start.moved / judgement.scene.mechanism.size
        if max(gap, start.turned) > MIN_MOVED:
            yield (
                f"the reference starts {length(start.moved)} and {math.degrees(start.turned):.2g} deg from "
                f"the first row, most at {start.moved_at}: the loops of the row are open, or its coordinates "
                "have another zero"
            )
    if (other := judgement.start_error) is not None:
        by_position = judgement.error.is_of_position
        yield (
            "no columns of velocities: those of the start are fitted to the first rows, which are known to "
            f"about {size(other, by_position)}"
        )
    if judgement.missing:
        yield f"not compared: {_some(judgement.missing)}"
    if judgement.dropped:
        yield f"{judgement.dropped} rows without some of the numbers were left out"
    if judgement.unused:
        yield f"columns of no quantity: {_some(judgement.unused)}"


def _some(names: Sequence[str]) -> str:
    """List the first names, and the number of others."""
    more = f" and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else ""
    return ", ".join(names[:MAX_NAMES]) + more
