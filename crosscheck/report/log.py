"""Text of the judgement of a log: its error against the reference, and what limits the comparison.

A log is a table of positions and velocities over time that another simulator recorded for a model. The
reference is a run of the same model in newton_euler (this project's solver), from the start of the log.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from crosscheck.own_run.allowed import AllowedError, length
from crosscheck.own_run.errors import Band
from crosscheck.own_run.judge import is_plural
from crosscheck.report.line_name import LineName
from crosscheck.report.own_run import (
    allowed_lines,
    angle,
    chaos_text,
    error_texts,
    headline,
    percent,
    size,
)
from crosscheck.report.table import Lines
from crosscheck.support.name_lists import first_names

if TYPE_CHECKING:  # most comparisons have no logs
    from crosscheck.logs.judge import LogJudgement

MAX_NAMES = 4
"""Largest number of names of columns or bodies in one line."""

MIN_MOVED = 1e-5
"""Smallest distance of the first row from the start of the reference that is reported, sizes of the mechanism
or rad. In files with six digits the distance is smaller."""

INPUTS_FACTOR = 0.5
"""Inputs at other times are reported if they reduce the error of a log to this part, or change the reference
by this part of the error."""

POINTS = {"center": "centers of mass", "frame": "origins of body frames"}
"""Text for each point of a body whose positions a log may have."""


def log_lines(judgement: LogJudgement, allowed: Sequence[AllowedError] = ()) -> Lines:
    """Format the judgement of a log, the result first, in the color of its accuracy.

    Args:
        judgement: the judgement.
        allowed: largest errors that the user allows.
    """
    return Lines("", list(_lines(judgement, allowed)), verdict=judgement.band.verdict)


def _lines(judgement: LogJudgement, allowed: Sequence[AllowedError]) -> Iterator[str]:
    """Yield the lines of a judgement: a headline, then indented lines that begin with a keyword."""
    error, times = judgement.error, judgement.run.time
    reason = f": {judgement.stopped}" if judgement.stopped else ""
    yield f"{judgement.name}  {headline(judgement)}{reason}"
    bodies = judgement.compared  # names of the compared bodies
    compared = f"{len(bodies)} bodies" if len(bodies) > 1 else bodies[0]
    rows = f"{judgement.rows} {'rows' if judgement.rows > 1 else 'row'}"
    if judgement.stride > 1:
        rows += f" (1 of {judgement.stride} is compared)"
    texts = [f"{judgement.engine}: {rows}, {times[-1]:.4g} s, {compared}"]
    if judgement.points:
        texts.append(f"positions of {POINTS[judgement.points]}")
    if judgement.has_inputs:
        texts.append("inputs of the log")
    yield LineName.RUN.line("; ".join(texts))
    # mistakes in reading the log: other units, orders or times with which the error is much smaller
    yield from (LineName.MISTAKE.line(mistake.text) for mistake in judgement.mistakes)
    if error.position or error.rotation:
        yield LineName.ERRORS.line("; ".join(error_texts(error, judgement.loop_error, judgement.has_energy)))
    yield from allowed_lines(judgement, allowed)
    yield from (LineName.NOTE.line(note) for note in _notes(judgement))


def _notes(judgement: LogJudgement) -> Iterator[str]:
    """Yield sentences on what limits the comparison."""
    if judgement.events:  # elements of the model that act and are not simulated, in the order of time
        first = judgement.events[0]
        end = "compared until then" if first.time > 0.0 else "the error may be due to that"
        acts, it = ("act", "them") if is_plural(first) else ("acts", "it")
        since = f"{acts} from {first.time:.3g} s on"
        yield f"{first.element} {since} and the reference does not simulate {it}: {end}"
    if chaos := chaos_text(judgement.scale):
        yield chaos
    if judgement.reference_stop and judgement.solution:
        end = f"{judgement.solution.time[-1]:.3g} s"
        yield f"the reference stops after {end}: {judgement.reference_stop}; compared until then"
    start = judgement.start
    if start and judgement.scene:
        gap = start.moved / judgement.scene.mechanism.size
        if max(gap, start.turned) > MIN_MOVED:
            yield (
                f"the reference starts {length(start.moved)} and {angle(start.turned)} from "
                f"the first row, most at {start.moved_at}: the loops of the row are open, its coordinates "
                "have another zero, or columns have the name of another body"
            )
    if (start_error := judgement.start_error) is not None:
        # as a length, or as an angle if the error is mainly one of rotations
        by_position = judgement.error.stated_by_position
        yield (
            "no columns of velocities: those of the start are fitted to the first rows, which are known to "
            f"about {size(start_error, by_position)}"
        )
    elif start and start.differences and not start.is_fitted:
        yield "no columns of velocities: the reference starts with those of the model"
    if (other := judgement.other_inputs) is not None:
        error = judgement.error.relative
        if other.error.relative <= INPUTS_FACTOR * error:
            yield f"with {other.option}, the error is {percent(other.error.relative)} of the motion"
        elif other.thinned.relative >= INPUTS_FACTOR * error:
            change = f"{percent(other.thinned.relative)} of the motion"
            advice = "log them at each step of the simulation, beginning with the first"
            yield f"inputs of every second row only change the reference by {change}: {advice}"
    if (lack := judgement.lack) is not None:
        names = first_names(lack.elements, MAX_NAMES)
        after, before = percent(lack.after.relative), percent(lack.before.relative)
        yield (
            f"the log's simulation may lack {names}: against a reference without, the error is {after} of "
            f"the motion instead of {before}"
        )
    is_passive = judgement.scene and not (judgement.scene.control or judgement.held_inputs)
    # motors may hold bodies as if they had no weight
    is_unexplained = lack is None or lack.is_gravity
    if is_passive and not judgement.has_inputs and judgement.band is Band.WRONG and is_unexplained:
        advice = "log columns such as JOINT.effort if motors drove the run"
        yield f"neither the model nor the log has forces of motors: the reference moves freely; {advice}"
    if judgement.held_inputs:
        yield f"no input in the log, held at the start: {first_names(judgement.held_inputs, MAX_NAMES)}"
    if judgement.missing:
        yield f"not compared: {first_names(judgement.missing, MAX_NAMES)}"
    if judgement.dropped:
        rows = "row" if judgement.dropped == 1 else "rows"
        were = "was" if judgement.dropped == 1 else "were"
        yield f"{judgement.dropped} {rows} without some of the numbers {were} left out"
    if judgement.unused:
        names = first_names([name or "one without a name" for name in judgement.unused], MAX_NAMES)
        yield f"columns not read, as the model has no joint, body or quantity of that name: {names}"
