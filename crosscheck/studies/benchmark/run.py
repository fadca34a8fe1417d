"""`crosscheck bench`: measure, write the files, and report."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

from crosscheck.errors import CrosscheckError
from crosscheck.files import check_no_source, check_writable, write_files
from crosscheck.report.output import check_own
from crosscheck.report.render import as_json
from crosscheck.report.table import Report
from crosscheck.studies.benchmark.batch import batch_data, batch_report, benchmark_batch
from crosscheck.studies.benchmark.report import data, picture, report
from crosscheck.studies.benchmark.rhs import rhs_data, rhs_report, time_right_hand_sides
from crosscheck.studies.benchmark.scaling import (
    check_sizable,
    measure_sizes,
    scaling_data,
    scaling_report,
)
from crosscheck.studies.benchmark.timing import Progress
from crosscheck.studies.benchmark.work_precision import benchmark
from newton_euler.model.scene import Scene

SMALLEST_ERROR = 1e-13
"""m and rad, that settings are looked for to reach."""


class Model(NamedTuple):
    """The name or file that a scene is loaded from, and its options as they were set."""

    source: str
    options: Mapping[str, str]


Written = tuple[Report, list[Path]]
"""The report of a benchmark and the files that hold it."""


def bench(loaded: Scene, model: Model, error: float, output: Path | None, progress: Progress) -> Written:
    """Benchmark whole runs of a scene, as loaded from its source.

    Raises:
        CrosscheckError: for an impossible error, a scene that cannot be run and files that cannot be
            written.
    """
    _check_error(error)
    paths = _paths(loaded, model, output, "bench.json", "work_precision.png")
    result = benchmark(loaded, *model, progress)
    progress("writing")
    return _write(paths, data(result), report(result, error), picture(result))


def bench_rhs(loaded: Scene, model: Model, output: Path | None, progress: Progress) -> Written:
    """Benchmark right-hand sides; errors as of `bench`."""
    paths = _paths(loaded, model, output, "rhs.json")
    timings = time_right_hand_sides(*model, progress)
    return _write(paths, rhs_data(*model, timings), rhs_report(timings))


def bench_batch(
    loaded: Scene, model: Model, runs: int, error: float, output: Path | None, progress: Progress
) -> Written:
    """Benchmark many runs; errors as of `bench`."""
    _check_error(error)
    paths = _paths(loaded, model, output, "batch.json")
    result = benchmark_batch(*model, runs, error, progress)
    return _write(paths, batch_data(result), batch_report(result))


def bench_scaling(loaded: Scene, model: Model, output: Path | None, progress: Progress) -> Written:
    """Benchmark right-hand sides over size; errors as of `bench`."""
    check_sizable(*model)
    paths = _paths(loaded, model, output, "scaling.json")
    result = measure_sizes(*model, progress)
    return _write(paths, scaling_data(result), scaling_report(result))


def _check_error(error: float) -> None:
    if not SMALLEST_ERROR <= error < math.inf:
        needed = f"{SMALLEST_ERROR:g} or more (m and rad), which is as exact as references are"
        raise CrosscheckError(f"--error is {error:g}; needed: {needed}")


def _paths(scene: Scene, model: Model, output: Path | None, *names: str) -> list[Path]:
    """Files to be written.

    Raises:
        CrosscheckError: for those that cannot be written, are the source, or are another model's, unless the
            folder was asked for.
    """
    folder = output or Path("output") / "bench" / scene.name
    if output is None:
        check_own(folder, [model.source], "benchmark")
    paths = [folder / name for name in names]
    check_no_source(paths, [model.source])
    check_writable(*paths)
    return paths


def _write(paths: list[Path], data: Mapping[str, object], found: Report, *others: bytes) -> Written:
    """Write data and report as JSON to the first path, other contents to the others."""
    beside = dict(zip(paths[1:], others, strict=True))
    digests = {path.name: hashlib.sha256(content).hexdigest() for path, content in beside.items()}
    write_files({paths[0]: as_json(data, found, digests), **beside})
    return found, paths
