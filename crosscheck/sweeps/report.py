"""The report on a sweep: quantiles, what matters, crosschecks; its tables, pictures, recording and files."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from crosscheck.files import check_writable, write_files
from crosscheck.report.render import as_json, markdown
from crosscheck.report.table import Cell, Column, Lines, Part, Report, Rows, Table, figures, texts
from crosscheck.sweeps.analysis import LEVELS, Analysis, Effect, Scalar, analyzed, scalars, telling, thinned
from crosscheck.sweeps.checks import Checked
from crosscheck.sweeps.expressions import Outputs
from crosscheck.sweeps.pictures import MOST_POINTS, heading, pictures, share_of
from crosscheck.sweeps.plan import Plan, run_all
from crosscheck.sweeps.reductions import AT, OF_MAGNITUDES, Reduction, magnitude
from crosscheck.sweeps.results import Results
from crosscheck.sweeps.store import unit_of
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array
from newton_euler.simulate import simulate
from newton_euler.variation import own_values

if TYPE_CHECKING:
    from crosscheck.recording.sweep import Envelope

FILES = ("sweep.json", "sweep.rrd", "tornado.png", "histograms.png", "scatter.png")

MOST_ROWS, MOST_CHARTS, MOST_BARS = 6, 2, 4
"""Of tables that are printed, so that all fits 25 lines."""

BAR = 10
"""Characters of a bar of 100 %; Rerun's viewer has no blocks among its glyphs."""

LEAST_DIGITS, MOST_DIGITS = 4, 6
"""Of quantiles."""

LEAST_SHARE = 0.005
"""Of the variance; parameters with less are not printed."""

SAMPLE = 100
"""Runs that envelopes over time are made of."""

MOST_GHOSTS = 4
"""Extreme runs in a recording."""


@dataclass(frozen=True, eq=False)
class Findings:
    """The analysis of a sweep, and crosschecks of some of its runs.

    Attributes:
        swept: the sweep.
        scalars: all numbers that are kept of a run.
        nominal: their values in the nominal run, by label.
        effects: of parameters on the most telling number of each variable.
        checked: crosschecks of some runs.
    """

    swept: Results
    scalars: list[Scalar]
    nominal: dict[str, float]
    effects: list[tuple[Scalar, list[Effect]]]
    checked: list[Checked]

    @property
    def verdict(self) -> str:
        """One line: whether the engines agree on the runs that were checked, and how many came to an end."""
        runs, count = self.swept.plan.samples.runs, len(self.checked)
        stopped = len(self.swept.errors)
        ended = f"{runs - stopped:,} of {runs:,} runs came to their end"
        if not count:
            return f"{ended}; none was cross-checked"
        wrong = [each for each in self.checked if each.differs]
        missing = [each for each in self.checked if not each.complete]
        random = sum(each.why == "at random" for each in self.checked)
        kinds = f"{count} runs cross-checked, {random} at random and {count - random} extreme"
        if wrong:
            return (
                f"DISAGREE: run {wrong[0].run} ({wrong[0].why}): {wrong[0].verdict}; {len(wrong)} of {kinds}"
            )
        if missing:
            return f"UNFINISHED: run {missing[0].run} ({missing[0].why}): {missing[0].verdict}; {kinds}"
        worst = max(self.checked, key=lambda each: each.apart)
        near = f"kept numbers within {100.0 * worst.apart:.2g} % of their spread"
        return f"AGREE: all engines, {kinds}, {near}; {ended}"

    @property
    def judged(self) -> Cell:
        """The verdict in one word."""
        if not self.checked:
            return Cell("made")
        if any(each.differs for each in self.checked):
            return Cell("DISAGREE", "fails")
        whole = all(each.complete for each in self.checked)
        return Cell("AGREE", "holds") if whole else Cell("UNFINISHED", "doubtful")


def findings(swept: Results, checked: Sequence[Checked] = ()) -> Findings:
    """Analyze a sweep of which some runs have been crosschecked."""
    found, analysis = scalars(swept), Analysis(swept.plan.samples, analyzed(swept), swept.inputs)
    effects = [(scalar, analysis.effects(scalar)) for scalar in telling(found)]
    return Findings(swept, found, _nominal(swept.plan, found), effects, list(checked))


def _nominal(plan: Plan, found: Sequence[Scalar]) -> dict[str, float]:
    own = own_values(plan.scene, plan.samples.names)
    values = run_all(plan, {name: value.reshape(1) for name, value in own.items()}).values
    return {each.label: float(values[each.variable][0][each.place]) for each in found}


def report(found: Findings) -> Report:
    """Make the tables of a sweep, and their short forms for the terminal."""
    swept, samples = found.swept, found.swept.plan.samples
    title = f"{swept.scene.name}: {samples.runs:,} runs, {samples.sampling}, seed {samples.seed}"
    if swept.made:
        title += f"; {swept.made:,} made at {swept.made / swept.wall_time:,.0f} per s"
    errors = [f"run {run}: {reason}" for run, reason in swept.errors.items()]
    parts: list[Part] = [_quantiles(found, found.scalars, True), _effects(found.effects, None)]
    if found.checked:
        parts.extend(_checks(found.checked))
    parts.append(_varied(swept.plan))
    if errors:
        parts.append(Lines("runs that could not go on", errors[:MOST_ROWS] + _more(errors), folded=True))
    varying = [scalar for scalar in found.scalars if scalar.varies]
    first = [scalar for scalar, _ in found.effects]
    rows = sorted(
        (first + [each for each in varying if each not in first])[:MOST_ROWS], key=found.scalars.index
    )
    summary: list[Part] = [_quantiles(found, rows, False), _effects(found.effects[:MOST_CHARTS], MOST_BARS)]
    if (count := len(analyzed(swept))) < samples.runs:
        part = f"of {count:,} runs"
        parts = [replace(each, title=f"{each.title} {part}") for each in parts[:1]] + parts[1:]
        summary.append(Lines("", [f"quantiles and extremes are {part}"], brief=True))
    if errors:
        summary.append(Lines("", [f"{len(errors)} runs could not go on, {errors[0]}"], brief=True))
    return Report(title, found.verdict, found.judged, parts, swept.wall_time, summary)


def _more(errors: Sequence[str]) -> list[str]:
    return [f"and {len(errors) - MOST_ROWS} more"] if len(errors) > MOST_ROWS else []


def _quantiles(found: Findings, rows: Sequence[Scalar], full: bool) -> Table:
    names = ["least", "5 %", "median", "95 %", "most"]
    wanted = range(len(LEVELS)) if full else (1, 2, 3, 4)
    columns = [Column("of each run", brief=True), *figures("nominal", *(names[k] for k in wanted))]
    content: Rows = []
    for each in rows:
        values = [found.nominal[each.label], *(each.quantiles[k] for k in wanted)]
        content.append([heading(each), *(f"{value:.{_digits(each)}g}" for value in values)])
    return Table("quantiles" if full else "", columns, content)


def _digits(scalar: Scalar) -> int:
    """Return the digits that show how a number varies, if that are not too many."""
    low, high = scalar.quantiles[[0, -1]]
    if not scalar.varies:
        return LEAST_DIGITS
    hidden = int(np.ceil(np.log10(max(abs(low), abs(high)) / (high - low))))
    return max(LEAST_DIGITS, hidden + 2) if hidden + 2 <= MOST_DIGITS else LEAST_DIGITS


def _effects(effects: Sequence[tuple[Scalar, Sequence[Effect]]], most: int | None) -> Table:
    """Make the tornado chart: shares of parameters in the variance of numbers, the largest first."""
    rows: Rows = []
    for scalar, found in effects:
        of = scalar.label
        for effect in found[:most]:
            if most is None or of or effect.size > LEAST_SHARE:
                rank = "" if effect.rank is None else f"{effect.rank:+.2f}"
                bar = "=" * round(BAR * min(1.0, effect.share or 0.0))
                rows.append([of, effect.name, share_of(effect), rank, bar])
                of = ""
    columns = [
        Column("variance of", brief=most is not None),
        *texts("explained by"),
        *figures("share", "rank"),
    ]
    return Table("" if most else "what matters", [*columns, Column("")], rows)


def _checks(checked: Sequence[Checked]) -> list[Part]:
    """Make the table of runs that were cross-checked, and the verdicts of those that are not in order."""
    rows: Rows = []
    for each in checked:
        judged = Cell("differ", "fails") if each.differs else Cell("agree", "holds")
        if not each.complete:
            judged = Cell("not all", "doubtful")
        rows.append([str(each.run), each.why, judged, f"{100.0 * each.apart:.2g}", each.where])
    columns = [*figures("run"), *texts("chosen", "engines"), *figures("apart, % of spread"), *texts("at")]
    parts: list[Part] = [Table("runs that were cross-checked", columns, rows, folded=True)]
    wrong = [f"run {each.run}: {each.verdict}" for each in checked if each.differs or not each.complete]
    return [*parts, Lines("", wrong)] if wrong else parts


def _varied(plan: Plan) -> Table:
    own = own_values(plan.scene, plan.samples.names)
    rows: Rows = []
    for names, distribution in plan.samples.groups:
        nominal = ", ".join(f"{own[name]:.6g}" for name in names)
        rows.append([", ".join(names), unit_of(names[0]), nominal, str(distribution)])
    return Table("what varies", texts("parameter", "unit", "nominal", "distribution"), rows, folded=True)


def write(found: Findings, made: Report, folder: Path) -> list[Path]:
    """Write the findings beside the Zarr store: JSON, pictures and a recording, all of them or none.

    Raises:
        CrosscheckError: naming the path that cannot be written.
    """
    from crosscheck.recording.sweep import recorded

    paths = [folder / name for name in FILES]
    check_writable(*paths)
    runs = analyzed(found.swept)
    points = thinned(len(runs), MOST_POINTS)
    drawn = pictures(found.effects, points, found.swept.inputs(runs[points]), found.nominal)
    files = {folder / name: content for name, content in drawn.items()}
    files[folder / FILES[1]] = recorded(found.swept.scene, *to_record(found, made))
    whole = {folder / FILES[0]: as_json(_data(found), made, files), **files}
    write_files(whole, [path for path in paths if path not in whole])
    return list(whole)


def to_record(found: Findings, made: Report) -> tuple[dict[str, Trajectory], list[Envelope], str, str]:
    """Return the arguments of `crosscheck.recording.sweep.log_sweep` after the scene."""
    runs = _extremes(found)
    return runs, list(_envelopes(found, runs)), markdown(replace(made, parts=made.summary)), made.title


def _data(found: Findings) -> dict[str, object]:
    """Return all findings, for JSON."""
    plan = found.swept.plan
    return {
        "scene": plan.scene.name,
        "source": plan.scene.name,
        "vary": {", ".join(names): str(each) for names, each in plan.samples.groups},
        "sampling": plan.samples.sampling,
        "runs": plan.samples.runs,
        "seed": plan.samples.seed,
        "keep": list(plan.keep),
        "control": dict(plan.control),
        "errors": len(found.swept.errors),
        "quantiles": {
            each.label: {
                f"{level:g}": value for level, value in zip(LEVELS, each.quantiles.tolist(), strict=True)
            }
            for each in found.scalars
        },
        "effects": {scalar.label: [asdict(each) for each in effects] for scalar, effects in found.effects},
        "checked": [asdict(each) for each in found.checked],
    }


def _extremes(found: Findings) -> dict[str, Trajectory]:
    """Make the nominal run and the extreme ones again, with all outputs."""
    plan = found.swept.plan
    runs = {"nominal": simulate(plan.scene, **plan.control)}
    for scalar, _ in found.effects:
        for largest in (True, False):
            run = scalar.extreme(largest)
            if len(runs) <= MOST_GHOSTS and f"run {run}" not in runs:
                runs[f"run {run}"] = simulate(plan.scene_of(run), **plan.control)
    return runs


def _envelopes(found: Findings, runs: Mapping[str, Trajectory]) -> Iterator[Envelope]:
    """Yield the course of telling numbers over time, of a sample of runs and of some by name."""
    from crosscheck.recording.sweep import Envelope

    plan = found.swept.plan
    scene = replace(plan.lean, output_period=plan.scene.output_period)
    inputs = found.swept.inputs(thinned(plan.samples.runs, SAMPLE))
    batch = plan.batch(inputs, scene)
    kept = {each.name: each for each in plan.kept}
    for scalar, _ in found.effects:
        reduction = kept[scalar.variable]
        sample = _course(reduction, Outputs(plan.scene, scene.times, batch.stacked), scalar)
        lines = {
            name: _course(reduction, Outputs(plan.scene, run.time, _stacked(run)), scalar)[0]
            for name, run in runs.items()
        }
        yield Envelope(heading(scalar), scene.times, sample, lines)


def _stacked(run: Trajectory) -> Callable[[str], Array]:
    return lambda name: np.asarray(getattr(run, name))[None]


def _course(reduction: Reduction, outputs: Outputs, scalar: Scalar) -> Array:
    """Return a number (runs, n) over time whose reduction is kept."""
    value = reduction.expression.evaluate(outputs)
    if reduction.kind in OF_MAGNITUDES:
        value = magnitude(value)
    place: Any = scalar.place[1:] if reduction.kind == AT else scalar.place
    return np.asarray(value.array[(slice(None), slice(None), *place)])
