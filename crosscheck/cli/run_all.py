"""The whole library of scenes through the engines, one line a scene."""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from crosscheck.compare.crosscheck import Crosscheck, Progress, crosscheck
from crosscheck.engines.engine import choose
from crosscheck.library import SCENES, load
from crosscheck.report.output import write
from crosscheck.report.run import judged_word, report
from crosscheck.report.summary import judged_figures, nearest
from crosscheck.report.table import Cell, Column, Table, figures, texts
from crosscheck.support.errors import reason_of
from crosscheck.support.files import check_writable
from crosscheck.support.processes import ProcessLostError, run_in_processes
from newton_euler.errors import MissingPackageError
from newton_euler.runs.batch import thread_count

LEFT_OUT = Cell("left out", "doubtful")
"""The word of a scene whose optional packages are not installed."""

NOT_RUN = Cell("FAILS", "fails")
"""The word on a scene that did not run."""


@dataclass(frozen=True)
class Outcome:
    """Outcome of one scene.

    Attributes:
        scene: its name.
        wall_time: s, of everything.
        agrees: whether it ran and all its figures are within what is allowed.
        verdict: one line.
        nearest: the figure that is nearest its tolerance or exceeds it most, in words.
        word: the verdict in one word.
        left_out: whether an optional package that the scene needs is not installed.
    """

    scene: str
    wall_time: float
    agrees: bool
    verdict: str
    nearest: Cell | str = ""
    word: Cell = NOT_RUN
    left_out: bool = False


def run_all(engines: Sequence[str], folder: Path, progress: Progress) -> list[Outcome]:
    """Crosscheck all scenes of the library at their default options, a process for each processor.

    Writes a folder for each scene below `folder`, as a single run does. A scene that cannot be run is
    an outcome that does not agree.

    Raises:
        CrosscheckError: for unknown engines, and for a folder that cannot be written.
    """
    choose(list(engines))
    check_writable(*(folder / name / "summary.json" for name in SCENES))
    found = run_in_processes(
        partial(outcome, engines=tuple(engines), folder=folder),
        list(SCENES),
        thread_count(),
        lambda count, name: progress(f"{count} of {len(SCENES)} scenes, last {name}"),
    )
    return [
        Outcome(name, 0.0, False, f"did not run: {each}") if isinstance(each, ProcessLostError) else each
        for name, each in zip(SCENES, found, strict=True)
    ]


def outcome(name: str, engines: Sequence[str], folder: Path) -> Outcome:
    """Crosscheck one scene at its default options; write to its folder below `folder` as a run does."""
    start = time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # results are checked where they are used
            result = crosscheck(load(name), choose(list(engines)), lambda _: None, name, {})
            write(result, report(result), folder / name, folder / name / f"{name}.rrd", name)
    except MissingPackageError as error:
        wall_time = time.perf_counter() - start
        return Outcome(name, wall_time, False, str(error), word=LEFT_OUT, left_out=True)
    except Exception as error:  # what goes wrong with one scene is a line, like the others' results
        return Outcome(name, time.perf_counter() - start, False, f"did not run: {reason_of(error)}")
    return _outcome(name, result, time.perf_counter() - start)


def _outcome(name: str, result: Crosscheck, wall_time: float) -> Outcome:
    figure = nearest(judged_figures(result))
    return Outcome(name, wall_time, result.outcome.passes(), result.verdict, figure, judged_word(result))


def outcomes_table(outcomes: Sequence[Outcome]) -> Table:
    """A row per scene, with the figure that is nearest its tolerance."""
    heads = [*texts("scene", "verdict"), *figures("time, s")]
    return Table(
        "",
        [*heads, Column("% of tolerance, where", below=True)],
        [[found.scene, found.word, f"{found.wall_time:.1f}", found.nearest] for found in outcomes],
    )


def outcome_lines(outcomes: Sequence[Outcome]) -> Iterator[str]:
    """Name the scenes that fail or are left out, and why; the sum last."""
    left_out = [found for found in outcomes if found.left_out]
    failing = [found for found in outcomes if not (found.agrees or found.left_out)]
    for found in left_out:
        yield f"{found.scene}: left out: {found.verdict}"
    for found in failing:
        yield f"{found.scene}: {found.verdict}"
    without = f"; left out: {', '.join(found.scene for found in left_out)}" if left_out else ""
    count = len(outcomes) - len(left_out)
    if failing:
        names = ", ".join(found.scene for found in failing)
        yield f"FAILS: {len(failing)} of {count} scenes: {names}{without}"
    else:
        yield f"AGREE: all {count} scenes{without}"
