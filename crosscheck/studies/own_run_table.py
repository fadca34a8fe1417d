"""Table of the runs of public model files with their own settings; `crosscheck.studies.models` writes it.

In: the summary that `crosscheck run` writes. Its entry `own_run` judges the file's own run, in MuJoCo with
the settings of the file, by the error against a reference solution of newton_euler. Out: rows of a Markdown
table: error, causes, and remedies (changed settings and their errors). A script repeats the judged run and
each remedy with MuJoCo alone, and the row has these errors, too.
"""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from crosscheck.own_run.allowed import length
from crosscheck.own_run.errors import Band, LoopError, RunError
from crosscheck.own_run.remedies import MeasuredRemedy
from crosscheck.report.own_run import FAST_MODE, MIN_CAUSE, angle, cost_text, percent, size, sizes
from crosscheck.report.render import markdown_table
from crosscheck.report.table import Rows, Table, text_columns
from crosscheck.support.name_lists import first_names
from crosscheck.support.units import SECONDS_AND_MS, quantity_text

MAX_REPEAT_TIME = 600.0
"""Largest wall time of the script, s."""

REPEAT_TOL, REPEAT_TOL_OF_MOTION = 0.05, 1e-4
"""Largest difference of an error that the script finds from the reported error: as a fraction of the error,
plus a fraction of the motion."""

DIVERGED = "DIVERGED"
"""Word for a run that MuJoCo stops."""

WORDS = (Band.ACCURATE, Band.OFF, Band.WRONG, DIVERGED)
"""Words for runs, in the order of the counts in the table."""

MIN_OPENING, MIN_LOOP_ANGLE = 1e-6, math.radians(1e-3)
"""Smallest violations of loop constraints, m and rad, that a row has."""

MAX_CAUSES = 2
"""Number of causes in a row."""


class OwnRunResult(BaseModel):
    """Judgement of a file's own run, in the words of the table.

    Attributes:
        word: one of `WORDS`.
        settings: settings of the file.
        error: largest errors of positions and orientations, and their part of the motion.
        without: what acts in the file and was switched off, and when the comparison ends if not with the run.
        cause: the largest causes and their errors.
        remedies: changes of the file with their errors and run times.
        repeated: errors of the run of the file and of the remedies that MuJoCo alone finds; "" if the script
            ended early, or the summary has no start of the run.
        repeats: whether these errors are those of the judgement.
    """

    word: str
    settings: str
    error: str
    without: str
    cause: str
    remedies: list[str]
    repeated: str
    repeats: bool


def own_run_result(path: Path, summary: Path, script: Path) -> OwnRunResult | None:
    """Format the judgement of a file's own run, and repeat the run with MuJoCo alone.

    Args:
        path: the model file.
        summary: file summary.json of `crosscheck run`.
        script: script that repeats the run and its remedies with MuJoCo alone, `engine_alone.py`.

    Returns:
        The row; None if the run was not judged.
    """
    own_run: dict[str, Any] | None = json.loads(summary.read_text(encoding="utf-8"))["own_run"]
    if own_run is None:
        return None
    without = _without(own_run)
    if own_run["band"] == Band.NOT_JUDGED and own_run["without"] is not None:
        own_run = own_run["without"]  # the run without what acts too early for a judgement of the file
    if own_run["band"] == Band.NOT_JUDGED:
        return None
    stopped = own_run["stopped"]
    error = RunError(**own_run["error"])
    remedies = [MeasuredRemedy(**each | {"error": RunError(**each["error"])}) for each in own_run["remedies"]]
    errors = [error, *(remedy.error for remedy in remedies)]
    # all errors are given like that of the judged run, by positions or by rotations; if this run stopped,
    # like that of the last remedy
    by_position = errors[-1].stated_by_position if own_run["stopped"] else error.stated_by_position
    repeated = _repeat(path, summary, script) if own_run["run_inputs"].get("qpos") is not None else []
    loops = LoopError(**own_run["loop_error"])
    opening = f"; loops open by {length(loops.opening)}" if loops.opening >= MIN_OPENING else ""
    opening += f"; loops turn by {angle(loops.angle)}" if loops.angle >= MIN_LOOP_ANGLE else ""
    return OwnRunResult(
        word=DIVERGED if stopped else Band(own_run["band"]),
        settings=own_run["settings"],
        error=stopped or f"{sizes(error)}, {percent(error.relative)}{opening}",
        without=without,
        cause=_cause(own_run, by_position),
        remedies=[f"{each.text}: {size(each.error, by_position)}, {cost_text(each)}" for each in remedies],
        repeated="; ".join("diverges" if each is None else _size(each, by_position) for each in repeated),
        repeats=len(repeated) == len(errors)
        and all(
            found is None if reported is error and own_run["stopped"] else _is_same(found, reported)
            for found, reported in zip(repeated, errors, strict=True)
        ),
    )


def _repeat(path: Path, summary: Path, script: Path) -> list[dict[str, float] | None]:
    """Return the errors of the file's run and of its remedies with MuJoCo alone.

    The error of a run that diverges is None. If the script fails, the list is shorter.
    """
    command = [sys.executable, "-P", *(str(each.resolve()) for each in (script, path, summary))]
    try:
        done = subprocess.run(
            command, cwd=summary.parent, capture_output=True, text=True, timeout=MAX_REPEAT_TIME, check=False
        )
    except subprocess.TimeoutExpired:
        return []
    return [json.loads(line) for line in done.stdout.splitlines() if line.startswith(("{", "null"))]


def _is_same(found: Mapping[str, float] | None, reported: RunError) -> bool:
    """Return whether the script finds the largest errors of all bodies, see `REPEAT_TOL`."""
    if found is None:
        return False
    allowed = REPEAT_TOL + REPEAT_TOL_OF_MOTION / max(reported.relative, 1e-300)
    by_position = reported.stated_by_position
    wanted = reported.largest_position if by_position else reported.largest_rotation
    return abs(found["position" if by_position else "rotation"] - wanted) <= allowed * wanted


def _size(found: Mapping[str, float], by_position: bool) -> str:
    """Format an error that the script finds."""
    return length(found["position"]) if by_position else angle(found["rotation"])


def _without(own_run: Mapping[str, Any]) -> str:
    """Format elements that the reference leaves out, and the chaotic time that the comparison leaves out."""
    words = []
    if events := own_run["events"]:
        elements = first_names([event["element"] for event in events], most=1)
        words.append(f"{elements}, from {events[0]['time']:.3g} s on")
    if own_run["until"]:
        words.append("judged until then")
    ends = [each["until"] for each in own_run["scale"]["mechanisms"] if each["until"] is not None]
    if ends:
        words.append(f"chaotic from {min(ends):.3g} s on")
    return "; ".join(words)


def _cause(own_run: Mapping[str, Any], by_position: bool) -> str:
    """Format the largest causes, and the mode that is too fast for the step."""
    # "brings_back": True if the stopped run completes without the error of this property of the settings
    causes = [(each["name"], RunError(**each["error"]), each["brings_back"]) for each in own_run["causes"]]
    if own_run["stopped"]:
        words = [name for name, _, brings_back in causes if brings_back]
    else:
        largest = causes[0][1].relative_by(by_position) if causes else 0.0
        listed = [each for each in causes if each[1].relative_by(by_position) > MIN_CAUSE * largest]
        words = [f"{name} {size(error, by_position)}" for name, error, _ in listed]
    words = words[:MAX_CAUSES]
    # the mode of the linearized model that limits the time step, with its rate, 1/s
    mode = own_run["stability"]
    if mode and mode["elements"] and mode["timestep"] * mode["rate"] >= FAST_MODE:
        constant = quantity_text(1.0 / mode["rate"], SECONDS_AND_MS, digits=2)
        words.append(f"{mode['elements'][0]['name']} makes a mode of {constant}")
    return "; ".join(words)


def own_run_table(rows: Sequence[tuple[str, str, OwnRunResult | str]]) -> Iterator[str]:
    """Yield the lines of Markdown: counts of bands, tables of judged models, and the other models.

    Args:
        rows: heading of the repository, model, and its judgement or the reason why there is none.
    """
    judged = [(heading, model, each) for heading, model, each in rows if isinstance(each, OwnRunResult)]
    counts = Counter(each.word for _, _, each in judged)
    listed = ", ".join(f"{counts[word]} {word}" for word in WORDS if counts[word])
    repeats = sum(each.repeats for _, _, each in judged)
    yield f"{len(judged)} models are judged: {listed}."
    yield f"The engine alone repeats the errors of {repeats} of them."
    yield ""
    # errors, causes and remedies; then what was switched off, and the errors that the engine alone finds
    errors: Rows = []
    others: Rows = []
    for heading, model, each in judged:
        if heading not in errors:
            errors.append(heading)
            others.append(heading)
        remedies = "; or ".join(each.remedies) or (
            "none needed" if each.word == Band.ACCURATE else "none found"
        )
        errors.append([model, each.word, each.error, each.settings, each.cause, remedies])
        same = each.repeated if each.repeats else f"{each.repeated or 'ended early'} (differs)"
        others.append([model, each.without, same])
    heads = text_columns("model", "accuracy", "error", "settings of the file", "cause", "remedy")
    yield from markdown_table(Table("", heads, errors))
    yield "\nTable: errors of runs with the settings of the files, their causes and remedies.\n"
    heads = text_columns("model", "switched off in the run", "error by the engine alone")
    yield from markdown_table(Table("", heads, others))
    yield "\nTable: elements that the judged runs leave out, and errors found without crosscheck."
    not_judged: Rows = [
        [f"{heading}: {model}", each] for heading, model, each in rows if isinstance(each, str)
    ]
    if not_judged:
        yield ""
        yield from markdown_table(Table("", text_columns("model", "reason"), not_judged))
        yield "\nTable: models that are not judged."
