"""Report of the benchmark of whole runs: the time that each engine needs to reach an error, m and rad.

The error of a run is the largest distance, m, or angle, rad, between the poses of the bodies in the run and
in a reference motion. The uncertainty of the reference is its largest difference from runs of other
equations of motion and tolerances. A setting is a method of an engine with its step or tolerance. The input
is a `Benchmark`, the measured times and errors of all settings; the output are tables, a plot and JSON.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from crosscheck.engines.palette import palette
from crosscheck.engines.registry import SOLVER
from crosscheck.report.chart import BarChart, Measure, log_chart
from crosscheck.report.plots import own_style, png
from crosscheck.report.table import Cell, Lines, Part, Rows, Table, number_columns, text_columns
from crosscheck.studies.benchmark.reference import Reference
from crosscheck.studies.benchmark.timing import rounded, time_text
from crosscheck.studies.benchmark.work_precision import Measurement, WorkPrecision
from newton_euler.model.scene import Scene
from newton_euler.scalars import Array

TABLE_ERRORS = tuple(10.0**-power for power in range(3, 12))
"""Errors, m and rad, of the rows of the table."""

SMALLEST_PLOTTED_ERROR = 1e-16
"""Smallest error, m or rad, in the plot, whose axis is logarithmic; smaller errors are drawn here."""

METHOD_NOTE = (
    "times: one thread, median of alternating repeats, spread of quartiles, without loading and first run; "
    "until the poses of all bodies at all outputs are known in the engine's own form"
)
"""Sentence of the report about the method of measurement. Poses in an engine's own form are for example the
rotation matrices of Pinocchio; their conversion to quaternions is not timed."""


@dataclass(frozen=True, eq=False)
class Benchmark:
    """Result of the benchmark of whole runs.

    Attributes:
        title: name of the scene, with its options.
        scene: the scene.
        reference: motion from which errors are measured.
        measured: time and error of all settings.
        engines: names of the engines.
    """

    title: str
    scene: Scene
    reference: Reference
    measured: WorkPrecision
    engines: Sequence[str]

    @property
    def run(self) -> str:
        """Title, duration and number of outputs of the scene."""
        return f"{self.title}: {self.scene.duration:g} s, {len(self.scene.times)} outputs"

    def fastest_setting(self, engine: str, error: float) -> Measurement | None:
        """Return the fastest setting of an engine whose error is at most `error`, m and rad.

        An error below the uncertainty of the reference counts as the uncertainty. None if no setting reaches
        the error.
        """
        unknown = self.reference.uncertainty
        reaching = [m for m in self._of(engine) if max(m.error, unknown) <= error]
        return min(reaching, key=lambda m: m.median, default=None)

    def pareto_optimal(self, engine: str) -> list[Measurement]:
        """Return the Pareto-optimal settings of an engine in time and error, the fastest first."""
        best: list[Measurement] = []
        for m in sorted(self._of(engine), key=lambda m: (m.median, m.error)):
            if not best or m.error < best[-1].error:
                best.append(m)
        return best

    def _of(self, engine: str) -> list[Measurement]:
        """Return the measurements of one engine."""
        return [m for m in self.measured.measurements if m.engine == engine]


def parts(result: Benchmark) -> Iterator[Part]:
    """Yield the parts of the report: times for each error, then settings and failures (shown by `-v`)."""
    reference = result.reference
    yield Lines(
        "",
        [
            result.run,
            f"reference: {reference.name}, known to {reference.uncertainty:.1e} m and rad",
            METHOD_NOTE,
        ],
    )
    yield _times(result)
    yield _settings(result)
    against = [
        f"{distance:.1e} m, {angle:.1e} rad from {name}"
        for name, (distance, angle) in reference.differences.items()
    ]
    missing = [f"could not run {name}: {reason}" for name, reason in reference.missing.items()]
    yield Lines("the reference differs by", [*against, *missing], folded=True)
    failures: Rows = [[x.engine, x.name, x.reason] for x in result.measured.failures]
    if failures:
        yield Table(
            "settings that cannot run the scene",
            text_columns("engine", "setting", "reason"),
            failures,
            folded=True,
        )


def verdict(result: Benchmark, error: float) -> str:
    """Report in one line the time that each engine needs to reach an error, m and rad."""
    if result.reference.uncertainty > error:
        return (
            f"error {error:g} is below the uncertainty of the reference, {result.reference.uncertainty:.1e}"
        )
    baseline, texts = result.fastest_setting(SOLVER.name, error), list[str]()
    for engine in result.engines:
        m = result.fastest_setting(engine, error)
        if m is None:
            ran = any(one.engine == engine for one in result.measured.measurements)
            texts.append(f"{engine} {'does not reach it' if ran else 'cannot run it, see -v'}")
            continue
        longer = ""
        if baseline is not None and m is not baseline:
            longer = f", {rounded(m.ratio(baseline))} times as long"
        texts.append(f"{engine} takes {time_text(m.median)}{longer}")
    return f"to an error of {error:g} (m, rad): {'; '.join(texts)}"


def charts(result: Benchmark, error: float) -> list[BarChart]:
    """Make the chart of the time that each engine needs to reach an error, m and rad."""
    fastest = [(engine, result.fastest_setting(engine, error)) for engine in result.engines]
    times = [Measure(name, 1e3 * m.median, time_text(m.median)) for name, m in fastest if m]
    return log_chart("Run times", f"Fastest run with an error of at most {error:g} m and rad", times, "ms")


def summary(result: Benchmark, error: float) -> Iterator[Part]:
    """Yield the short report: times of each engine for some errors, and its fastest setting for `error`."""
    errors = TABLE_ERRORS[::2]
    rows: Rows = []
    for engine in result.engines:
        fastest = [result.fastest_setting(engine, each) for each in errors]
        rows.append([engine, *("-" if m is None else rounded(1e3 * m.median) for m in fastest)])  # ms
    yield Table(
        "", [*text_columns("ms for an error of"), *number_columns(*(f"{each:.0e}" for each in errors))], rows
    )
    wanted = [m for engine in result.engines if (m := result.fastest_setting(engine, error))]
    yield Lines("", [f"{m.engine} for {error:g}: {m.name}" for m in wanted])


def _times(result: Benchmark) -> Table:
    """Tabulate the time of each engine's fastest setting for each error of `TABLE_ERRORS`.

    The column `ratio` is the time of an engine divided by newton_euler's time.
    """
    heads = number_columns("error")
    for engine in result.engines:
        heads += number_columns(engine, "spread", *(() if engine == SOLVER.name else ("ratio",)))
    rows: Rows = []
    for error in TABLE_ERRORS:
        baseline, row = result.fastest_setting(SOLVER.name, error), list[str | Cell]()
        for engine in result.engines:
            m = result.fastest_setting(engine, error)
            row += ["-", ""] if m is None else [rounded(1e3 * m.median), m.spread]
            if engine != SOLVER.name:
                row.append("" if m is None or baseline is None else rounded(m.ratio(baseline)))
        rows.append([f"{error:.0e}", *row])
    return Table("ms of the fastest setting for each error, m and rad", heads, rows)


def _settings(result: Benchmark) -> Table:
    """Tabulate the Pareto-optimal settings of each engine; errors below the uncertainty are shown as "<="."""
    unknown = result.reference.uncertainty
    rows: Rows = []
    for engine in result.engines:
        rows.append(engine)  # a text instead of cells is a heading
        for m in result.pareto_optimal(engine):
            errors = [e if e > unknown else unknown for e in (m.error_position, m.error_angle)]
            signs = ["" if e > unknown else "<= " for e in (m.error_position, m.error_angle)]
            rows.append(
                [
                    m.name,
                    *(f"{sign}{e:.1e}" for sign, e in zip(signs, errors, strict=True)),
                    f"{1e3 * m.median:.3g}",
                    m.spread,
                    str(len(m.times)),
                    f"{1e3 * m.first:.3g}",
                    str(m.evaluations),
                ]
            )
    names = ("position, m", "angle, rad", "time, ms", "spread", "repeats", "first, ms", "evaluations")
    title = "Pareto-optimal settings of each engine"
    return Table(title, [*text_columns("setting"), *number_columns(*names)], rows, folded=True)


def data(result: Benchmark) -> dict[str, Any]:
    """Return the reference, all measurements and all failures, for JSON."""
    reference, measured = result.reference, result.measured
    return {
        "scene": result.scene.name,
        "duration": result.scene.duration,
        "outputs": len(result.scene.times),
        "reference": {
            "name": reference.name,
            "uncertainty": reference.uncertainty,
            "differences": reference.differences,
            "missing": reference.missing,
        },
        **asdict(measured),
    }


@own_style()
def picture(result: Benchmark) -> bytes:
    """Plot run time (s) over error (m and rad), with a line through the Pareto-optimal settings, as PNG.

    `own_style` replaces the user's matplotlib style by the default style.
    """
    from matplotlib.figure import Figure

    drawn = Figure(figsize=(9.0, 5.0), layout="constrained")
    ax = drawn.add_subplot()
    for engine, color in palette(result.engines).items():
        points = [m for m in result.measured.measurements if m.engine == engine]
        if points:
            ax.plot(*_points(points).T, ".", color=color, markersize=4, alpha=0.3)
            ax.plot(*_points(result.pareto_optimal(engine)).T, marker=".", color=color, label=engine)
    ax.axvline(result.reference.uncertainty, color="0.5", linestyle=":", label="uncertainty of the reference")
    ax.set(
        xscale="log",
        yscale="log",
        title=result.run,
        xlabel="largest error of all bodies and output times, m and rad",
        ylabel="run time, s",
    )
    ax.invert_xaxis()
    ax.grid(which="major", alpha=0.3)
    ax.legend(fontsize="x-small")
    return png(drawn, dpi=110)


def _points(measurements: Sequence[Measurement]) -> Array:
    """Return errors, m and rad, and median times, s, as points (n, 2) of the plot."""
    return np.array([(max(m.error, SMALLEST_PLOTTED_ERROR), m.median) for m in measurements])
