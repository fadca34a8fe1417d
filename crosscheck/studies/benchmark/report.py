"""The report of a benchmark: the cheapest settings for an error."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from typing import Any, NamedTuple

import numpy as np

from crosscheck.report.plots import STYLES, png
from crosscheck.report.table import Cell, Column, Lines, Report, Rows, Table, figures, texts
from crosscheck.studies.benchmark.ladders import ENGINES, JUDGED
from crosscheck.studies.benchmark.timing import machine_line
from crosscheck.studies.benchmark.work_precision import Benchmark, Measurement
from newton_euler.scalars import Array

DECADES = tuple(10.0**-power for power in range(3, 12))
"""Errors, m and rad, that the table has a row for."""

SMALLEST = 1e-16
"""Errors are drawn no smaller than this, m or rad: zero has no logarithm."""


class Row(NamedTuple):
    """The cheapest setting of each engine that reaches an error.

    Attributes:
        error: m and rad.
        cheapest: by engine; None where none reaches it.
        notes: where `newton_euler` is not the fastest or an engine falls short, and why.
    """

    error: float
    cheapest: dict[str, Measurement | None]
    notes: tuple[str, ...]

    def ratio(self, engine: str) -> float | None:
        """Compute an engine's time as a multiple of `newton_euler`'s."""
        own, other = self.cheapest[JUDGED], self.cheapest[engine]
        return None if own is None or other is None else other.median / own.median


def cheapest(
    measurements: Iterable[Measurement], engine: str, error: float, uncertainty: float = 0.0
) -> Measurement | None:
    """The fastest setting of an engine whose error is at most `error`, by its median.

    An error below the uncertainty of the reference counts as that uncertainty.
    """
    reaching = [m for m in measurements if m.engine == engine and max(m.error, uncertainty) <= error]
    return min(reaching, key=lambda m: m.median, default=None)


def frontier(measurements: Iterable[Measurement], engine: str) -> list[Measurement]:
    """The settings of an engine that none of its others beats in both time and error, fastest first."""
    best: list[Measurement] = []
    for m in sorted((m for m in measurements if m.engine == engine), key=lambda m: (m.median, m.error)):
        if not best or m.error < best[-1].error:
            best.append(m)
    return best


def row(measurements: Sequence[Measurement], error: float, uncertainty: float) -> Row:
    """Return the row of the time that each engine needs to reach an error."""
    found = {engine: cheapest(measurements, engine, error, uncertainty) for engine in ENGINES}
    if uncertainty > error:
        return Row(error, found, (f"not resolved: the reference is known to {uncertainty:.1e} only",))
    return Row(error, found, tuple(_notes(measurements, found)))


def _notes(measurements: Sequence[Measurement], found: dict[str, Measurement | None]) -> Iterator[str]:
    own = found[JUDGED]
    for engine, m in found.items():
        if m is None:
            yield _short(measurements, engine)
        elif own is not None and m.median < own.median:
            yield f"{engine} is faster than {JUDGED}: {_work(m)} against {_work(own)}"
        elif own is not None and m is not own and m.quartiles[0] <= own.quartiles[1]:
            yield f"{engine} and {JUDGED} are level within the spread of their times"


def _work(m: Measurement) -> str:
    return f"{m.evaluations} evaluations of {_time(m.median / max(m.evaluations, 1))}"


def _short(measurements: Sequence[Measurement], engine: str) -> str:
    """Why an engine does not reach an error."""
    own = [m for m in measurements if m.engine == engine]
    if not own:
        return f"{engine} cannot run the scene"
    best = min(own, key=lambda m: m.error)
    return f"{engine} does not reach it: at best {best.error:.1e} in {_time(best.median)} ({best.name})"


def rows(result: Benchmark) -> list[Row]:
    """One for each of the `DECADES`."""
    return [row(result.measured.measurements, error, result.reference.uncertainty) for error in DECADES]


def answer(result: Benchmark, error: float) -> str:
    """In plain words, what each engine needs to reach an error, and how many times longer that is."""
    found = row(result.measured.measurements, error, result.reference.uncertainty)
    text = [
        f"{result.scene.duration:g} s of {result.title} to an error of {error:g} (m, rad, every body, "
        "every output time):"
    ]
    for engine, m in found.cheapest.items():
        if m is not None:
            ratio = found.ratio(engine)
            times = "" if engine == JUDGED or ratio is None else f", {ratio:.3g} times as long as {JUDGED}"
            text.append(f"  {engine} takes {_time(m.median)} with {m.name} (error {m.error:.1e}){times}")
    text += [f"  {note}" for note in found.notes]
    return "\n".join(text)


def _time(seconds: float) -> str:
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds / 1e-9:.3g} ns"


def report(result: Benchmark, error: float) -> Report:
    """Settings by error and engine, the machine, and what each engine needs for an error."""
    said = Lines("", preamble(result))
    answered = Lines("", answer(result, error).splitlines())
    return Report(f"bench {result.title}", "", Cell(""), [said, *tables(result), answered])


def tables(result: Benchmark) -> Iterator[Table]:
    """The cheapest settings for each error, the best settings of each engine, loading, and failures."""
    heads = figures("error")
    for engine in ENGINES:
        heads += [Column(engine), *figures("ms"), *(figures("ratio") if engine != JUDGED else [])]
    yield Table(
        "cheapest setting for each error, m and rad",
        [*heads, Column("remarks")],
        [_cells(found) for found in rows(result)],
    )
    uncertainty = result.reference.uncertainty
    heads = [
        *texts("setting"),
        *figures("m", "rad", "ms", "quartiles, ms", "repeats", "first, ms", "evaluations"),
    ]
    for engine in ENGINES:
        cells: Rows = [
            [
                m.name,
                _error(m.error_position, uncertainty),
                _error(m.error_angle, uncertainty),
                f"{m.median * 1e3:.3g}",
                " to ".join(f"{q * 1e3:.3g}" for q in m.quartiles),
                str(len(m.times)),
                f"{m.first * 1e3:.3g}",
                str(m.evaluations),
            ]
            for m in frontier(result.measured.measurements, engine)
        ]
        yield Table(f"{engine}: settings that none of its others beats", heads, cells)
    yield Table(
        "loading, not counted above",
        [*texts("engine", "model"), *figures("s"), *texts("of which")],
        [[load.engine, load.model, f"{load.seconds:.3g}", load.remark] for load in result.measured.loadings],
    )
    failures = result.measured.failures
    if failures:
        yield Table(
            "what cannot run the scene",
            texts("engine", "method", "setting", "reason"),
            [[failure.engine, failure.method, failure.setting, failure.reason] for failure in failures],
        )


def _error(value: float, uncertainty: float) -> str:
    return f"{value:.1e}" if value > uncertainty else f"<= {uncertainty:.1e}"


def _cells(found: Row) -> list[str | Cell]:
    cells: list[str | Cell] = [f"{found.error:.0e}"]
    for engine, m in found.cheapest.items():
        cells += ["-", "-"] if m is None else [m.name, f"{m.median * 1e3:.3g}"]
        if engine != JUDGED:
            ratio = found.ratio(engine)
            cells.append("-" if ratio is None else f"{ratio:.3g}")
    return [*cells, "; ".join(found.notes)]


def preamble(result: Benchmark) -> list[str]:
    """Say what was run, on what, against what, and what the times are of."""
    reference = result.reference
    where = result.machine
    versions = ", ".join(f"{package} {version}" for package, version in where["versions"].items())
    lines = [
        f"{result.title}: {result.scene.duration:g} s, {len(result.scene.times)} outputs",
        f"{machine_line(where)}, {where['system']}, Python {where['python']}, {versions}",
        f"reference: {reference.name}, known to {reference.uncertainty:.1e} m and rad; it differs by",
    ]
    lines += [
        f"  {d.position:.1e} m, {d.angle:.1e} rad from {name}" for name, d in reference.differences.items()
    ]
    lines += [f"  (could not run {name}: {reason})" for name, reason in reference.missing.items()]
    lines.append(
        "times: one thread, medians of interleaved repeats, without loading and first run. All hold the "
        "poses of all bodies at all outputs as the engine has them: newton_euler centers of mass and "
        "quaternions, MuJoCo the positions and quaternions of its bodies, Pinocchio translations and "
        "rotation matrices of its joints. What turns those of MuJoCo and Pinocchio into the first for the "
        "comparison is not counted"
    )
    return lines


def data(result: Benchmark) -> dict[str, Any]:
    """Return every setting that ran and every one that did not, for JSON."""
    reference, measured = result.reference, result.measured
    return {
        "scene": result.scene.name,
        "source": result.source,
        "options": dict(result.options),
        "duration": result.scene.duration,
        "outputs": len(result.scene.times),
        "machine": result.machine,
        "reference": {
            "name": reference.name,
            "uncertainty": reference.uncertainty,
            "differences": {name: d._asdict() for name, d in reference.differences.items()},
            "missing": reference.missing,
        },
        "loadings": [asdict(load) for load in measured.loadings],
        "settings": [
            asdict(m) | {"median": m.median, "quartiles": m.quartiles} for m in measured.measurements
        ],
        "failures": [asdict(failure) for failure in measured.failures],
        "ladders_end_at": dict(measured.ended),
    }


def picture(result: Benchmark) -> bytes:
    """Draw run time (s) over error (m and rad), a line through the settings that none beats, as a PNG."""
    from matplotlib.figure import Figure

    drawn = Figure(figsize=(9.0, 5.0), layout="constrained")
    ax = drawn.add_subplot()
    for engine in ENGINES:
        color = STYLES[engine][0]
        points = [m for m in result.measured.measurements if m.engine == engine]
        if points:
            ax.plot(*_points(points).T, ".", color=color, markersize=4, alpha=0.3)
            ax.plot(*_points(frontier(points, engine)).T, marker=".", color=color, label=engine)
    ax.axvline(result.reference.uncertainty, color="0.5", linestyle=":", label="uncertainty of the reference")
    ax.set(
        xscale="log",
        yscale="log",
        title=f"{result.title}: {result.scene.duration:g} s, {len(result.scene.times)} outputs",
        xlabel="largest error of all bodies and output times, m and rad",
        ylabel="run time, s",
    )
    ax.invert_xaxis()
    ax.grid(which="major", alpha=0.3)
    ax.legend(fontsize="x-small")
    return png(drawn, dpi=110)


def _points(measurements: Sequence[Measurement]) -> Array:
    return np.array([(max(m.error, SMALLEST), m.median) for m in measurements])
