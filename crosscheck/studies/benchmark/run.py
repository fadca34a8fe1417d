"""`crosscheck bench`: run one of the four benchmarks, write its files, and make its report.

The benchmarks are whole runs, one right-hand side (evaluation of the equations of motion), batches of runs,
and parameter sensitivities (derivatives of runs with respect to parameters). A setting is a method of an
engine with its step or tolerance.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

from crosscheck.engines.benchmarks import Benchmarks, Models, poses_only
from crosscheck.engines.engine import Engine
from crosscheck.engines.registry import EngineError
from crosscheck.engines.usable import divide, require_scene
from crosscheck.library.options import titled
from crosscheck.report.chart import BarChart
from crosscheck.report.output import usual_folder
from crosscheck.report.render import as_json
from crosscheck.report.table import Cell, Lines, Part, Report
from crosscheck.studies.benchmark import batch, report, rhs, sensitivities
from crosscheck.studies.benchmark.reference import reference
from crosscheck.studies.benchmark.timing import Progress, machine
from crosscheck.studies.benchmark.work_precision import Failure, measure
from crosscheck.support.errors import CrosscheckError, reason_of
from crosscheck.support.files import check_no_source, check_writable, write_files
from newton_euler.model.scene import Scene

SMALLEST_ERROR = 1e-13
"""Smallest error, m and rad, that a user can ask for; references are not more accurate."""


class BenchmarkRequest(NamedTuple):
    """Arguments of a benchmark.

    Attributes:
        scene: the scene.
        source: name of the library scene, or path of the file, that the scene was loaded from.
        options: options of the scene that the user set.
        engines: the engines.
        error: error of poses, m and rad, that the compared settings reach.
        runs: number of runs of a batch; not used by the other benchmarks.
    """

    scene: Scene
    source: str
    options: Mapping[str, str]
    engines: Sequence[Engine]
    error: float
    runs: int = 0

    @property
    def title(self) -> str:
        """Name of the scene with its options."""
        return titled(self.scene.name, self.options)


class BenchmarkResult(NamedTuple):
    """Result of a benchmark.

    Attributes:
        data: all measurements, for the JSON file.
        parts: parts of the report.
        charts: bar charts of the measurements.
        step: what the reader can do with the result.
        picture: plot as the bytes of a PNG file, if the benchmark has one.
        verdict: the result in one line.
        summary: parts that the terminal shows without `-v`; all parts if None.
    """

    data: Mapping[str, Any]
    parts: list[Part]
    charts: list[BarChart]
    step: str
    picture: bytes | None = None
    verdict: str = ""
    summary: list[Part] | None = None


def bench(
    wanted: BenchmarkRequest, kind: str, output: Path | None, progress: Progress
) -> tuple[Report, list[Path]]:
    """Run a benchmark and write its files.

    Args:
        wanted: scene and arguments.
        kind: a key of `KINDS`.
        output: folder of the files; a folder named after the scene if None.
        progress: called with the name of each stage.

    Returns:
        The report, and the paths of the files.

    Raises:
        CrosscheckError: if the error is out of range, or the scene cannot be run. Also if a file cannot be
            written or is the source itself, or if the default folder has results of another model.
    """
    # Check the arguments and the files before the measurement
    if not SMALLEST_ERROR <= wanted.error < math.inf:
        needed = f"{SMALLEST_ERROR:g} or more (m and rad), the best accuracy of references"
        raise CrosscheckError(f"--error is {wanted.error:g}; needed: {needed}")
    files, measure_kind = KINDS[kind]
    folder = output or usual_folder(Path("output/bench"), wanted.source, results="benchmark")
    json_path = folder / files.json
    plot_path = folder / files.plot if files.plot else None
    paths = [path for path in (json_path, plot_path) if path]
    check_no_source(paths, [wanted.source])
    check_writable(*paths)
    wanted, left_out = _of_usable_engines(wanted)
    # Measure; the load of the machine by other programs is that before the measurement
    machine_data = machine(wanted.engines)
    found = measure_kind(wanted, progress)
    # Make the report and write the files
    processor, cores, load = (machine_data[name] for name in ("processor", "cores", "load"))
    head = f"{processor}, {cores} cores, load {load:g} by others"
    heading = Lines(title="", lines=[head])
    missing = [Lines("", [f"left out: {reason}" for reason in left_out.values()])] if left_out else []
    parts = [heading, *found.parts, *missing]
    summary = [*(found.parts if found.summary is None else found.summary), *missing, heading]
    no_judgment = Cell("")  # a benchmark has no result in one word, such as AGREE
    steps = [found.step]
    if left_out:
        steps.append(f"The engines {', '.join(left_out)} are not measured; the notes have the reasons.")
    whole = Report(
        f"bench {wanted.title}",
        found.verdict,
        no_judgment,
        parts,
        summary=summary,
        charts=found.charts,
        captions={"work_precision.png": "Run time against error of all settings; lower left is better"},
        next_steps=steps,
    )
    pictures = {plot_path: found.picture} if plot_path and found.picture else {}
    data = {
        "source": wanted.source,
        "options": dict(wanted.options),
        "machine": machine_data,
        "left_out": left_out,
    }
    data |= found.data
    # the JSON file has the SHA-256 of the plot
    write_files({json_path: as_json(data, whole, files=pictures), **pictures})
    return whole, paths


def _of_usable_engines(wanted: BenchmarkRequest) -> tuple[BenchmarkRequest, dict[str, str]]:
    """Return the request for the engines that can express the scene, and the reasons of the others."""

    def load(engine: Engine) -> None:
        require_scene(engine, wanted.scene)
        if engine.benchmarks() == Benchmarks():
            raise EngineError(f"{engine.name} has no benchmarks")

    usable, errors = divide(wanted.engines, load)
    return wanted._replace(engines=usable), {name: str(error) for name, error in errors.items()}


def _whole_runs(wanted: BenchmarkRequest, progress: Progress) -> BenchmarkResult:
    """Measure time and error of whole runs at all settings of all engines."""
    scene = poses_only(wanted.scene)
    motion = reference(scene, progress)
    # for each engine, the functions that load the scene, by variant of the engine's equations
    loaders, failures = dict[str, Models](), list[Failure]()
    for engine in wanted.engines:
        try:
            loaders[engine.name] = engine.benchmarks().models(scene)
        except Exception as error:  # the table reports any error of an engine
            failures.append(Failure(engine.name, "benchmarks", reason_of(error)))
    measured = measure(loaders, motion.poses, progress)
    measured.failures.extend(failures)
    names = [engine.name for engine in wanted.engines]
    result = report.Benchmark(wanted.title, scene, motion, measured, names)
    return BenchmarkResult(
        data=report.data(result),
        parts=list(report.parts(result)),
        charts=report.charts(result, wanted.error),
        step=(
            "Take the engine and the setting with the shortest run time at the error that you need "
            "(`--error`). The details list the settings."
        ),
        picture=report.picture(result),
        verdict=report.verdict(result, wanted.error),
        summary=list(report.summary(result, wanted.error)),
    )


def _right_hand_sides(wanted: BenchmarkRequest, progress: Progress) -> BenchmarkResult:
    """Time one evaluation of the equations of motion by each engine."""
    timings = rhs.time_right_hand_sides(wanted.scene, wanted.engines, progress)
    step = "For whole runs at equal errors, run the command without `--rhs`: one evaluation has no error."
    data = {"right_hand_sides": [asdict(t) for t in timings]}
    return BenchmarkResult(data, rhs.parts(timings), rhs.charts(timings), step, verdict=rhs.verdict(timings))


def _batch(wanted: BenchmarkRequest, progress: Progress) -> BenchmarkResult:
    """Measure the throughput of batches of runs from random states."""
    result = batch.benchmark_batch(wanted.scene, wanted.engines, wanted.runs, wanted.error, progress)
    step = "Take the engine with the highest throughput at the number of threads of your machine."
    return BenchmarkResult(
        asdict(result), batch.parts(result), batch.charts(result), step, verdict=batch.verdict(result)
    )


def _sensitivities(wanted: BenchmarkRequest, progress: Progress) -> BenchmarkResult:
    """Time runs of newton_euler with derivatives with respect to parameters."""
    costs = sensitivities.time_sensitivities(wanted.scene, progress)
    step = "Expect this cost for runs with derivatives, such as those of `crosscheck identify`."
    data = {"sensitivities": [asdict(cost) for cost in costs]}
    parts, charts = sensitivities.parts(costs), sensitivities.charts(costs)
    return BenchmarkResult(data, parts, charts, step, verdict=sensitivities.verdict(costs))


class FileNames(NamedTuple):
    """Names of the files of a benchmark: its measurements, and its plot (None if it has no plot)."""

    json: str
    plot: str | None = None


KINDS: dict[str, tuple[FileNames, Callable[[BenchmarkRequest, Progress], BenchmarkResult]]] = {
    "runs": (FileNames("bench.json", "work_precision.png"), _whole_runs),
    "rhs": (FileNames("rhs.json"), _right_hand_sides),
    "batch": (FileNames("batch.json"), _batch),
    "sensitivities": (FileNames("sensitivities.json"), _sensitivities),
}
"""Names of files, and function that measures, for each kind of benchmark."""
