"""`crosscheck bench`: measure, write the files, and say what was found."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from pathlib import Path

from rich.console import Console
from rich.table import Table

from crosscheck.errors import CrosscheckError
from crosscheck.files import check_no_source, check_writable
from crosscheck.studies.benchmark.work_precision import Progress
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import atomic_file

WIDTH = 200
"""Columns that the tables need."""


SMALLEST_ERROR = 1e-13
"""m and rad, that settings are looked for to reach."""


def bench(
    scene: Scene,
    source: str,
    options: Mapping[str, str],
    error: float,
    repeats: int,
    output: Path | None,
    progress: Progress,
) -> tuple[list[str], list[Path]]:
    """Lines for the terminal and files of a benchmark of whole runs of a scene, as loaded from its source.

    Raises:
        CrosscheckError: for an impossible error, a scene that cannot be run and files that cannot be
            written.
    """
    from crosscheck.studies.benchmark.engines import benchmark
    from crosscheck.studies.benchmark.plot import FILES, write
    from crosscheck.studies.benchmark.report import answer, preamble, terminal_tables

    _check_error(error)
    folder = _folder(scene, source, output)
    _check_targets([folder / name for name in FILES], source)
    result = benchmark(scene, source, options, repeats, progress)
    progress("writing")
    written = write(result, folder, error)
    return [*preamble(result), "", *_lines(terminal_tables(result)), answer(result, error)], written


def bench_rhs(
    scene: Scene, source: str, options: Mapping[str, str], output: Path | None, progress: Progress
) -> tuple[list[str], list[Path]]:
    """Lines for the terminal and the file of a benchmark of right-hand sides; errors as of `bench`."""
    from crosscheck.studies.benchmark.rhs import rhs_json, rhs_table, rhs_words, time_right_hand_sides

    path = _folder(scene, source, output) / "rhs.json"
    _check_targets([path], source)
    timings = time_right_hand_sides(source, options, progress)
    _write(path, rhs_json(source, options, timings).encode())
    return [*_lines([rhs_table(timings)]), *rhs_words(timings)], [path]


def bench_batch(
    scene: Scene,
    source: str,
    options: Mapping[str, str],
    runs: int,
    error: float,
    output: Path | None,
    progress: Progress,
) -> tuple[list[str], list[Path]]:
    """Lines for the terminal and the file of a benchmark of many runs; errors as of `bench`."""
    from crosscheck.studies.benchmark.batch import batch_json, batch_table, batch_words, benchmark_batch

    _check_error(error)
    path = _folder(scene, source, output) / "batch.json"
    _check_targets([path], source)
    result = benchmark_batch(source, options, runs, error, progress)
    _write(path, batch_json(result).encode())
    return [*_lines([batch_table(result)]), *batch_words(result)], [path]


def bench_scaling(
    scene: Scene, source: str, options: Mapping[str, str], output: Path | None, progress: Progress
) -> tuple[list[str], list[Path]]:
    """Lines for the terminal and the files of right-hand sides over size; errors as of `bench`."""
    from crosscheck.studies.benchmark.scaling import (
        check_sizable,
        measure_sizes,
        scaling_json,
        scaling_picture,
        scaling_table,
        scaling_words,
    )

    check_sizable(source, options)
    folder = _folder(scene, source, output)
    files = {"scaling.json": scaling_json, "scaling.png": scaling_picture}
    _check_targets([folder / name for name in files], source)
    result = measure_sizes(source, options, progress)
    for name, content in files.items():
        _write(folder / name, content(result))
    return [*_lines([scaling_table(result)]), *scaling_words(result)], [folder / name for name in files]


def _check_error(error: float) -> None:
    if not SMALLEST_ERROR <= error < math.inf:
        needed = f"{SMALLEST_ERROR:g} or more (m and rad), which is as exact as references are"
        raise CrosscheckError(f"--error is {error:g}; needed: {needed}")


def _folder(scene: Scene, source: str, output: Path | None) -> Path:
    """Where files go; raises `CrosscheckError` if another model's are there, unless it was asked for."""
    if output is not None:
        return output
    from crosscheck.report.output import check_own

    folder = Path("output") / "bench" / scene.name
    check_own(folder, [source], "benchmark")
    return folder


def _check_targets(paths: list[Path], source: str) -> None:
    """Raise `CrosscheckError` for files that cannot be written or are the source."""
    check_no_source(paths, [source])
    check_writable(*paths)


def _write(path: Path, content: bytes) -> None:
    try:
        with atomic_file(path) as temporary:
            temporary.write_bytes(content)
    except OSError as failed:
        raise CrosscheckError(f"cannot write {path}: {failed.strerror}") from failed


def _lines(tables: Iterable[Table]) -> list[str]:
    console = Console(width=max(WIDTH, Console().width))
    with console.capture() as capture:
        for table in tables:
            console.print(table)
    return [line.rstrip() for line in capture.get().splitlines()]
