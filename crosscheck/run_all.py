"""The whole library of scenes through the engines, one line a scene."""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

from crosscheck.comparison.figure import Figure
from crosscheck.engines import choose
from crosscheck.errors import reason_of
from crosscheck.files import check_writable
from crosscheck.report.output import write
from crosscheck.report.run import FAILS, judged_word, report
from crosscheck.report.table import Cell, Column, Table, figures, judged, texts
from crosscheck.run import Crosscheck, Progress, crosscheck
from crosscheck.scenes import SCENES, load
from crosscheck.workers import LostError, in_processes


@dataclass(frozen=True)
class Worst:
    """The figure of some that comes nearest to what it may be, or is furthest above it."""

    value: float
    allowed: float

    @property
    def share(self) -> float:
        return self.value / self.allowed if self.allowed else float(self.value > 0.0)


@dataclass(frozen=True)
class Outcome:
    """Outcome of one scene.

    Attributes:
        scene: its name.
        wall_time: s, of everything.
        agrees: whether it ran and all its figures are within what is allowed.
        verdict: one line.
        engines: those that ran.
        left_out: those that cannot express the scene, and why.
        between: of the figures that compare engines.
        known: of the figures that are known from elsewhere; None if there are none.
        drift, energy: of the engines' own figures.
    """

    scene: str
    wall_time: float
    agrees: bool
    verdict: str
    engines: tuple[str, ...] = ()
    left_out: dict[str, str] = field(default_factory=dict)
    between: Worst | None = None
    known: Worst | None = None
    drift: Worst | None = None
    energy: Worst | None = None
    word: Cell = FAILS


def run_all(engines: Sequence[str], folder: Path, progress: Progress) -> list[Outcome]:
    """Crosscheck all scenes of the library at their default options, a process for each processor.

    Writes a folder for each scene below `folder`, as a single run does. A scene that cannot be run is
    an outcome that does not agree.

    Raises:
        CrosscheckError: for unknown engines, and for a folder that cannot be written.
    """
    choose(list(engines))
    check_writable(*(folder / name / "summary.json" for name in SCENES))
    found = in_processes(
        partial(outcome, engines=tuple(engines), folder=folder),
        list(SCENES),
        os.cpu_count() or 1,
        lambda count, name: progress(f"{count} of {len(SCENES)} scenes, last {name}"),
    )
    return [
        Outcome(name, 0.0, False, f"{name} did not run: {each}") if isinstance(each, LostError) else each
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
    except Exception as error:  # what goes wrong with one scene is a line, like the others' results
        return Outcome(name, time.perf_counter() - start, False, f"{name} did not run: {reason_of(error)}")
    return _outcome(name, result, time.perf_counter() - start)


def _outcome(name: str, result: Crosscheck, wall_time: float) -> Outcome:
    def of(*levels: str) -> list[Figure]:
        return [row for row in result.rows if len(row.between) == 1 and row.level in levels]

    pairs = [row for row in result.rows if len(row.between) > 1 and not row.informs]
    return Outcome(
        name,
        wall_time,
        result.agrees,
        result.verdict,
        tuple(result.runs),
        result.left_out,
        _worst(Worst(row.value, row.tolerance) for row in pairs),
        _worst(Worst(row.value, row.tolerance) for row in result.measured),
        _worst(Worst(row.value, row.tolerance) for row in of("drift")),
        _worst(Worst(row.value, row.tolerance) for row in of("energy")),
        judged_word(result),
    )


def _worst(found: Iterable[Worst]) -> Worst | None:
    return max(found, key=lambda worst: worst.share, default=None)


def outcomes_table(outcomes: Sequence[Outcome]) -> Table:
    """A row per scene; a figure beside what it may be is the worst of its kind."""
    heads = figures("between engines", "against reference", "drift, m or rad", "energy, rel", "time, s")
    return Table(
        "library of scenes",
        [*texts("scene", "engines"), *heads, Column("verdict")],
        [
            [
                found.scene,
                ", ".join(found.engines) if found.left_out else "all" if found.engines else "",
                *(_cell(worst) for worst in (found.between, found.known, found.drift, found.energy)),
                f"{found.wall_time:.1f}",
                found.word,
            ]
            for found in outcomes
        ],
    )


def _cell(worst: Worst | None) -> str | Cell:
    return "" if worst is None else judged(worst.value, worst.allowed, worst.value <= worst.allowed)


def outcome_lines(outcomes: Sequence[Outcome]) -> Iterator[str]:
    """Engines that were left out and scenes that fail, and why; the sum last."""
    for found in outcomes:
        for engine, reason in found.left_out.items():
            yield f"{found.scene}: {engine} left out: {reason}"
    failing = [found for found in outcomes if not found.agrees]
    for found in failing:
        yield found.verdict
    if failing:
        names = ", ".join(found.scene for found in failing)
        yield f"FAILS: {len(failing)} of {len(outcomes)} scenes: {names}"
    else:
        yield f"AGREE: all {len(outcomes)} scenes"
