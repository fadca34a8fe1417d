"""Crosscheck all scenes of the library in parallel processes, for `crosscheck run --all`.

Each scene becomes one row of a table, with its verdict, run time and the check closest to failing.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from crosscheck.compare.crosscheck import Progress, crosscheck
from crosscheck.engines.registry import choose
from crosscheck.library import SCENES, load
from crosscheck.report.output import write
from crosscheck.report.run import outcome_cell, report
from crosscheck.report.summary import judged_checks, nearest
from crosscheck.report.table import Cell, Column, Table, number_columns, text_columns
from crosscheck.support.errors import reason_of
from crosscheck.support.files import check_writable
from crosscheck.support.processes import ProcessLostError, run_in_processes
from newton_euler.errors import MissingPackageError
from newton_euler.runs.batch import thread_count

LEFT_OUT = Cell("left out", verdict="doubtful")
"""Table cell, in the color of a doubtful verdict, of a scene whose optional packages are not installed."""

NOT_RUN = Cell("FAILS", verdict="fails")
"""Table cell, in the color of a failure, of a scene that did not run."""


@dataclass(frozen=True)
class SceneOutcome:
    """Outcome of one scene.

    Attributes:
        scene: name of the scene.
        wall_time: time of loading, runs, comparison and writing, s.
        agrees: whether the crosscheck passes.
        verdict: the verdict in one line, or the reason why there is none.
        nearest: the check closest to failing, in words.
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


def run_all(engines: Sequence[str], folder: Path, progress: Progress) -> list[SceneOutcome]:
    """Crosscheck all scenes of the library at their default options, in one process per processor.

    Args:
        engines: names of the engines.
        folder: parent of the result folders, one per scene, each with the files of a single run.
        progress: shows a message to the user.

    Returns:
        An outcome per scene. The outcome of a scene that cannot be run has `agrees` False.

    Raises:
        CrosscheckError: for unknown engines, and for a folder that cannot be written.
    """
    choose(list(engines))
    check_writable(*(folder / name / "summary.json" for name in SCENES))
    found = run_in_processes(
        partial(run_scene, engines=tuple(engines), folder=folder),
        list(SCENES),
        thread_count(),
        lambda count, name: progress(f"{count} of {len(SCENES)} scenes, last {name}"),
    )
    return [
        SceneOutcome(name, 0.0, False, f"did not run: {each}") if isinstance(each, ProcessLostError) else each
        for name, each in zip(SCENES, found, strict=True)
    ]


def run_scene(name: str, engines: Sequence[str], folder: Path) -> SceneOutcome:
    """Crosscheck one library scene at its default options, and write its results to `folder`/NAME."""
    start = time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # NumPy's; results are checked for finiteness where they are used
            result = crosscheck(
                load(name), choose(list(engines)), progress=lambda _: None, source=name, options={}
            )
            recording = folder / name / f"{name}.rrd"  # for the Rerun viewer
            write(result, report(result), folder / name, recording, name=name)
    except MissingPackageError as error:
        wall_time = time.perf_counter() - start
        return SceneOutcome(name, wall_time, False, str(error), word=LEFT_OUT, left_out=True)
    except Exception as error:  # an error in one scene is a row of the table, and does not end the others
        return SceneOutcome(name, time.perf_counter() - start, False, f"did not run: {reason_of(error)}")
    wall_time, closest = time.perf_counter() - start, nearest(judged_checks(result))
    passes = result.outcome.passes()
    return SceneOutcome(name, wall_time, passes, result.verdict, closest, outcome_cell(result))


def outcomes_table(outcomes: Sequence[SceneOutcome]) -> Table:
    """Make a table with a row per scene: verdict, time, and the check closest to failing."""
    heads = [*text_columns("scene", "verdict"), *number_columns("time, s")]
    return Table(
        "",
        # `below`: on narrow screens, HTML pages move this column below the others
        [*heads, Column("% of tolerance, where", below=True)],
        [[found.scene, found.word, f"{found.wall_time:.1f}", found.nearest] for found in outcomes],
    )


def outcome_lines(outcomes: Sequence[SceneOutcome]) -> Iterator[str]:
    """Yield a line with the reason for each scene that is left out or fails, then the overall verdict."""
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
