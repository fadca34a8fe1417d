"""One right-hand side of each engine over the size of a scene: how time and memory grow."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

from crosscheck.errors import CrosscheckError
from crosscheck.report.table import Cell, Column, Lines, Report, Rows, Table, texts
from crosscheck.scenes import SCENES
from crosscheck.scenes.options import options_of
from crosscheck.studies.benchmark.ladders import JUDGED
from crosscheck.studies.benchmark.rhs import WAYS, Timing, Way, fastest_other, time_right_hand_sides
from crosscheck.studies.benchmark.timing import Progress, machine, machine_line

SIZES = (1, 10, 100, 1000)
"""What the scene's option `OPTION` is set to in turn."""

OPTION = "N"

LIMIT = 180.0
"""s that loading a right-hand side may take in a fresh process. What fails is not tried at larger sizes."""


@dataclass(frozen=True)
class Scaling:
    """Timings of a scene at each size; `options` are the scene's others."""

    source: str
    options: Mapping[str, str]
    machine: dict[str, Any]
    timings: Mapping[int, tuple[Timing, ...]]

    def of(self, way: Way) -> dict[int, Timing]:
        """The timings of one way at the sizes at which it ran."""
        return {
            size: t
            for size, timings in self.timings.items()
            for t in timings
            if (t.engine, t.way) == way and t.times
        }

    def growth(self, way: Way) -> Iterator[tuple[int, int, float]]:
        """Exponent p of time ~ N^p between each size and the next."""
        for (small, first), (large, second) in pairwise(self.of(way).items()):
            yield small, large, math.log(second.median / first.median) / math.log(large / small)


def check_sizable(source: str, options: Mapping[str, str]) -> None:
    """Raise `CrosscheckError` for a scene without the option, or with it set already."""
    if source not in SCENES or OPTION not in options_of(SCENES[source]):
        sizable = [name for name, scene in SCENES.items() if OPTION in options_of(scene)]
        raise CrosscheckError(f"scene {source!r} has no option {OPTION}; choose from: {', '.join(sizable)}")
    if OPTION in options:
        raise CrosscheckError(f"--scaling sets {OPTION} itself")


def measure_sizes(source: str, options: Mapping[str, str], progress: Progress) -> Scaling:
    """Time every right-hand side at each of `SIZES`; `progress` is told each stage.

    Raises:
        CrosscheckError: for a scene that cannot be benchmarked.
    """
    where = machine()
    ways = list(WAYS)
    timings = {}
    for size in SIZES:
        found = time_right_hand_sides(
            source,
            {**options, OPTION: str(size)},
            lambda message, size=size: progress(f"{OPTION} = {size}: {message}"),  # type: ignore[misc]
            ways,
            LIMIT,
        )
        timings[size] = tuple(found)
        ways = [(t.engine, t.way) for t in found if not t.reason]
    return Scaling(source, options, where, timings)


# Report


def scaling_report(result: Scaling) -> Report:
    """Time, growth and peak memory by size, for each way to call an engine."""
    rows: Rows = []
    for way in WAYS:
        ran = result.of(way)
        if ran:
            times = (f"{ran[size].median * 1e6:.4g}" if size in ran else "-" for size in result.timings)
            memory = (f"{ran[size].memory / 1e6:.0f}" if size in ran else "-" for size in result.timings)
            growth = ", ".join(f"{power:.2f}" for _, _, power in result.growth(way))
            rows.append([*way, *times, growth, *memory])
    heads = [Column(f"us, {OPTION} = {size}", numeric=True) for size in result.timings]
    heads += [Column("growth", numeric=True)]
    heads += [Column(f"MB, {OPTION} = {size}", numeric=True) for size in result.timings]
    table = Table("", [*texts("engine", "right-hand side"), *heads], rows)
    return Report("right-hand sides over size", "", Cell(""), [table, Lines("", _words(result))])


def _words(result: Scaling) -> list[str]:
    """Word the growth of newton_euler's time, its ratio to the fastest other's, and what could not run."""
    lines = [
        f"{machine_line(result.machine)}; growth: exponents "
        f"between sizes; MB: peak of a fresh process, loading in at most {LIMIT:g} s"
    ]
    for way in WAYS:
        if way[0] == JUDGED:
            parts = [f"{p:.2f} from {a} to {b}" for a, b, p in result.growth(way)]
            lines.append(f"{JUDGED} ({way[1]}) grows with exponents {', '.join(parts) or '-'}")
    for size, timings in result.timings.items():
        best = fastest_other(timings)
        for t in timings:
            if t.reason:
                lines.append(f"{OPTION} = {size}: {t.engine} ({t.way}) cannot run: {t.reason}")
            elif t.engine == JUDGED and best is not None:
                ratio = t.median / best.median
                lines.append(
                    f"{OPTION} = {size}: {t.engine} ({t.way}) takes {ratio:.3g} times as long as "
                    f"{best.engine} ({best.way})"
                )
    return lines


def scaling_data(result: Scaling) -> dict[str, Any]:
    """Everything measured, for JSON."""
    return {
        "source": result.source,
        "options": dict(result.options),
        "machine": result.machine,
        "sizes": {size: [asdict(t) for t in timings] for size, timings in result.timings.items()},
        "growth": {", ".join(way): list(result.growth(way)) for way in WAYS},
    }
