"""`crosscheck bench`: measure, write the files, and report."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from crosscheck.errors import CrosscheckError
from crosscheck.files import check_no_source, check_writable, write_files
from crosscheck.report.output import check_own
from crosscheck.report.render import as_json
from crosscheck.report.table import Cell, Lines, Part, Report
from crosscheck.scenes.options import titled
from crosscheck.studies.benchmark import batch, report, rhs
from crosscheck.studies.benchmark.ladders import ENGINES, poses_only
from crosscheck.studies.benchmark.reference import reference
from crosscheck.studies.benchmark.timing import Progress, machine
from crosscheck.studies.benchmark.work_precision import measure
from newton_euler.model.scene import Scene

SMALLEST_ERROR = 1e-13
"""m and rad, that settings are looked for to reach."""


class Model(NamedTuple):
    """A scene, the name or file that it is loaded from, and its options as they were set."""

    scene: Scene
    source: str
    options: Mapping[str, str]


class Found(NamedTuple):
    """Results: everything measured, for JSON, what is shown of it, and a picture."""

    data: Mapping[str, Any]
    parts: list[Part]
    picture: bytes | None = None


class Kind(NamedTuple):
    """A kind of benchmark: the files that it writes, and what measures."""

    files: tuple[str, ...]
    measure: Callable[[Model, Progress], Found]


def work_precision(error: float) -> Kind:
    """Whole runs of every engine and setting; the report names the cheapest settings for an error.

    Raises:
        CrosscheckError: for an impossible error.
    """
    _check_error(error)
    return Kind(("bench.json", "work_precision.png"), partial(_whole_runs, error))


def right_hand_sides() -> Kind:
    """One right-hand side of each engine."""
    return Kind(("rhs.json",), _right_hand_sides)


def sizes(source: str, options: Mapping[str, str]) -> Kind:
    """The same over the size of a scene.

    Raises:
        CrosscheckError: for a scene without an option of its size, or with it set.
    """
    rhs.check_sizable(source, options)
    return Kind(("scaling.json",), _sizes)


def many_runs(runs: int, error: float) -> Kind:
    """Many runs from random states, by settings that reach an error; errors as of `work_precision`."""
    _check_error(error)
    return Kind(("batch.json",), partial(_many_runs, runs, error))


def bench(model: Model, kind: Kind, output: Path | None, progress: Progress) -> tuple[Report, list[Path]]:
    """Run a benchmark of a scene; the report, and the files that hold it.

    Raises:
        CrosscheckError: for a scene that cannot be run, and files that cannot be written, are the source,
            or are another model's, unless the folder was asked for.
    """
    folder = output or Path("output") / "bench" / model.scene.name
    if output is None:
        check_own(folder, [model.source], "benchmark")
    paths = [folder / name for name in kind.files]
    check_no_source(paths, [model.source])
    check_writable(*paths)
    where = machine()
    found = kind.measure(model, progress)
    head = f"{where['processor']}, {where['cores']} cores, load {where['load']:g} by others"
    title = f"bench {titled(model.scene.name, model.options)}"
    whole = Report(title, "", Cell(""), [Lines("", [head]), *found.parts])
    beside = {paths[1]: found.picture} if found.picture else {}
    digests = {path.name: hashlib.sha256(content).hexdigest() for path, content in beside.items()}
    data = {"source": model.source, "options": dict(model.options), "machine": where, **found.data}
    write_files({paths[0]: as_json(data, whole, digests), **beside})
    return whole, paths


def _check_error(error: float) -> None:
    if not SMALLEST_ERROR <= error < math.inf:
        needed = f"{SMALLEST_ERROR:g} or more (m and rad), which is as exact as references are"
        raise CrosscheckError(f"--error is {error:g}; needed: {needed}")


def _whole_runs(error: float, model: Model, progress: Progress) -> Found:
    scene = poses_only(model.scene)
    motion = reference(scene, progress)
    measured = measure({name: engine(scene) for name, engine in ENGINES.items()}, motion.poses, progress)
    result = report.Benchmark(titled(scene.name, model.options), scene, motion, measured)
    return Found(report.data(result), list(report.parts(result, error)), report.picture(result))


def _right_hand_sides(model: Model, progress: Progress) -> Found:
    timings = rhs.time_right_hand_sides(model.scene, progress)
    return Found({"right_hand_sides": [asdict(t) for t in timings]}, rhs.parts(timings))


def _sizes(model: Model, progress: Progress) -> Found:
    found = rhs.time_sizes(model.source, model.options, progress)
    timings = {size: [asdict(t) for t in timings] for size, timings in found.items()}
    exponents = {way: rhs.growth(found, way) for way in rhs.WAYS}
    return Found({"sizes": timings, "growth": exponents}, rhs.size_parts(found))


def _many_runs(runs: int, error: float, model: Model, progress: Progress) -> Found:
    result = batch.benchmark_batch(model.scene, runs, error, progress)
    return Found(asdict(result), batch.parts(result))
