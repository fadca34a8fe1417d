"""`crosscheck bench`: measure, write the files, and report."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

from crosscheck.library.options import titled
from crosscheck.report.output import usual_folder
from crosscheck.report.render import as_json
from crosscheck.report.table import Cell, Lines, Part, Report
from crosscheck.studies.benchmark import batch, report, rhs, sensitivities
from crosscheck.studies.benchmark.ladders import ENGINES, poses_only
from crosscheck.studies.benchmark.reference import reference
from crosscheck.studies.benchmark.timing import Progress, machine
from crosscheck.studies.benchmark.work_precision import measure
from crosscheck.support.errors import CrosscheckError
from crosscheck.support.files import check_no_source, check_writable, write_files
from newton_euler.model.scene import Scene

SMALLEST_ERROR = 1e-13
"""m and rad, that settings are looked for to reach."""


class Wanted(NamedTuple):
    """The scene of a benchmark and what is asked of it.

    Attributes:
        scene: loaded from its source, a name or a file, with options as they were set.
        error: m and rad, that settings are to reach.
        runs: of a batch.
    """

    scene: Scene
    source: str
    options: Mapping[str, str]
    error: float
    runs: int = 0

    @property
    def title(self) -> str:
        """The scene with its options."""
        return titled(self.scene.name, self.options)


class Found(NamedTuple):
    """Results: everything measured, for JSON, what is shown of it, a picture, the verdict and a summary."""

    data: Mapping[str, Any]
    parts: list[Part]
    picture: bytes | None = None
    verdict: str = ""
    summary: list[Part] | None = None
    """Of the parts; all of them if None."""


def bench(wanted: Wanted, kind: str, output: Path | None, progress: Progress) -> tuple[Report, list[Path]]:
    """Run a benchmark of a kind out of `KINDS`; return the report, and the files that hold it.

    Raises:
        CrosscheckError: for an impossible error, a scene that cannot be run, and files that cannot be
            written, are the source, or are another model's, unless the folder was asked for.
    """
    if not SMALLEST_ERROR <= wanted.error < math.inf:
        needed = f"{SMALLEST_ERROR:g} or more (m and rad), which is as exact as references are"
        raise CrosscheckError(f"--error is {wanted.error:g}; needed: {needed}")
    names, measured = KINDS[kind]
    folder = output or usual_folder(Path("output/bench"), wanted.source, "benchmark")
    paths = [folder / name for name in names]
    check_no_source(paths, [wanted.source])
    check_writable(*paths)
    where = machine()
    found = measured(wanted, progress)
    head = f"{where['processor']}, {where['cores']} cores, load {where['load']:g} by others"
    parts = [Lines("", [head]), *found.parts]
    summary = [*(found.parts if found.summary is None else found.summary), Lines("", [head])]
    whole = Report(f"bench {wanted.title}", found.verdict, Cell(""), parts, summary=summary)
    beside = {paths[1]: found.picture} if found.picture else {}
    data = {"source": wanted.source, "options": dict(wanted.options), "machine": where, **found.data}
    write_files({paths[0]: as_json(data, whole, beside), **beside})
    return whole, paths


def _whole_runs(wanted: Wanted, progress: Progress) -> Found:
    scene = poses_only(wanted.scene)
    motion = reference(scene, progress)
    measured = measure({name: engine(scene) for name, engine in ENGINES.items()}, motion.poses, progress)
    result = report.Benchmark(wanted.title, scene, motion, measured)
    return Found(
        report.data(result),
        list(report.parts(result)),
        report.picture(result),
        report.verdict(result, wanted.error),
        list(report.summary(result, wanted.error)),
    )


def _right_hand_sides(wanted: Wanted, progress: Progress) -> Found:
    timings = rhs.time_right_hand_sides(wanted.scene, progress)
    return Found({"right_hand_sides": [asdict(t) for t in timings]}, rhs.parts(timings))


def _batch(wanted: Wanted, progress: Progress) -> Found:
    result = batch.benchmark_batch(wanted.scene, wanted.runs, wanted.error, progress)
    return Found(asdict(result), batch.parts(result))


def _sensitivities(wanted: Wanted, progress: Progress) -> Found:
    costs = sensitivities.time_sensitivities(wanted.scene, progress)
    return Found({"sensitivities": [asdict(cost) for cost in costs]}, sensitivities.parts(costs))


KINDS: dict[str, tuple[tuple[str, ...], Callable[[Wanted, Progress], Found]]] = {
    "runs": (("bench.json", "work_precision.png"), _whole_runs),
    "rhs": (("rhs.json",), _right_hand_sides),
    "batch": (("batch.json",), _batch),
    "sensitivities": (("sensitivities.json",), _sensitivities),
}
"""Files that each benchmark writes, and what measures."""
