"""Report on a sweep: quantiles, effects of parameters, crosschecks; tables, plots, recording and files."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from crosscheck.compare.activity import MAX_NAMED, what_acted
from crosscheck.compare.outcome import Outcome
from crosscheck.report.render import as_json, markdown
from crosscheck.report.run import undetermined_lines
from crosscheck.report.table import (
    Cell,
    Column,
    Lines,
    Part,
    Report,
    Rows,
    Table,
    checked_cell,
    number_columns,
    text_columns,
)
from crosscheck.support.files import check_writable, write_files
from crosscheck.sweeps.analysis import (
    QUANTILE_LEVELS,
    Analysis,
    Effect,
    KeptNumber,
    analyzed,
    kept_numbers,
    most_informative,
    most_varying,
    sample_blocks,
    with_unit,
)
from crosscheck.sweeps.checks import CheckedRun, result_line
from crosscheck.sweeps.distributions import Distribution
from crosscheck.sweeps.expressions import Outputs
from crosscheck.sweeps.pictures import MAX_SCATTER_POINTS, pictures, rank_of, share_of
from crosscheck.sweeps.plan import SweepPlan, run_all
from crosscheck.sweeps.results import SweepResults
from newton_euler.equations.parameters import origins
from newton_euler.model.trajectory import Trajectory
from newton_euler.runs.initial_coordinates import initial_numbers
from newton_euler.runs.variation import own_values, units_of
from newton_euler.scalars import Array

if TYPE_CHECKING:
    from crosscheck.sweeps.recording import Envelope

SWEEP_FILES = ("sweep.json", "sweep.rrd", "tornado.png", "histograms.png", "scatter.png")
"""Names of the files that `write` can write: all findings, the Rerun recording, and plots."""

MAX_PRINTED_ROWS, MAX_PRINTED_CHARTS, MAX_PRINTED_BARS, MAX_PRINTED_REASONS = 6, 2, 4, 3
"""Largest numbers of rows, charts, bars and reasons in the terminal; the whole report is 25 lines long."""

BAR_WIDTH = 10
"""Characters of a bar of 100 %, made of "=", since Rerun's viewer has no block characters."""

MIN_QUANTILE_DIGITS, MAX_QUANTILE_DIGITS = 4, 11
"""Significant digits of quantiles; numbers that vary little need many digits."""

WIDE_TABLE_DIGITS, MAX_WIDE_TABLE_ROWS = 6, 3
"""Digits beyond which a table is wider than the terminal (each row takes two lines), and its number of
rows."""

NUMBER_PATTERN = re.compile(r"-?\d+(\.\d+)?(e[-+]?\d+)?(?![\w.])")
"""Numbers in the reason of a failed run; reasons that differ in numbers only are counted together."""

FAR_NOMINAL_DEVIATIONS = 3.0
"""Standard deviations from the mean beyond which a nominal value is reported as far from its distribution."""

ENVELOPE_RUNS = 100
"""Number of runs in the envelopes over time."""

MAX_RECORDED_EXTREMES = 4
"""Largest number of extreme runs in a recording."""


@dataclass(frozen=True, eq=False)
class Findings:
    """Analysis of a sweep, and crosschecks of some of its runs.

    Attributes:
        swept: the runs of the sweep.
        scalars: the kept numbers of a run.
        nominal: their values in the nominal run, by label.
        effects: effects of parameters on the number of each variable that varies most.
        checked: crosschecks of some runs.
        too_few: reason why there are no Sobol indices; empty if there are.
        options: options of the scene or model file.
        start: lines about the excitation of a model file, and about a moved start.
    """

    swept: SweepResults
    scalars: list[KeptNumber]
    nominal: dict[str, float]
    effects: list[tuple[KeptNumber, list[Effect]]]
    checked: list[CheckedRun]
    too_few: str
    options: Mapping[str, str]
    start: tuple[str, ...]

    @property
    def verdict(self) -> str:
        """One line: whether the engines agree on the checked runs, and how many runs completed."""
        runs, stopped = self.swept.plan.samples.runs, len(self.swept.stopped)
        ended = f"{runs - stopped:,} of {runs:,} run{'s' * (runs != 1)} completed"
        found = f"{ended}; none was cross-checked"
        if self.checked:
            extremes = {scalar.extreme(largest) for scalar, _ in self.effects for largest in (True, False)}
            found = f"{result_line(self.checked, extremes)}; {ended}"
        found = "; ".join(filter(None, [self._reduced, found]))
        return f"{self.outcome}: {found}" if self.outcome else found

    @property
    def outcome(self) -> Outcome | None:
        """Outcome of the crosschecks; None if all runs completed and no run was cross-checked."""
        if any(each.differs for each in self.checked):
            return Outcome.DISAGREE
        if len(self.swept.stopped) or not all(each.complete for each in self.checked):
            return Outcome.UNFINISHED
        if not self.checked:
            return None
        if all(each.engines == ("newton_euler",) for each in self.checked):
            return Outcome.ONE_ENGINE_ALONE  # newton_euler also executed the sweep
        if any(each.acting for each in self.checked):
            return Outcome.AGREE_ON_A_REDUCED_MODEL
        if any(each.untested for each in self.checked):
            return Outcome.AGREE_AT_RANDOM_STATES_ONLY
        return Outcome.AGREE

    @property
    def _reduced(self) -> str:
        """Name the elements that would have acted in checked runs and were not simulated."""
        names = list(dict.fromkeys(what_acted(entry) for each in self.checked for entry in each.acting))
        if not names:
            return ""
        more = f" and {len(names) - MAX_NAMED} more" if len(names) > MAX_NAMED else ""
        runs = sum(bool(each.acting) for each in self.checked)
        return f"not simulated: {', '.join(names[:MAX_NAMED])}{more}, in {runs} of {len(self.checked)} runs"

    @cached_property
    def notes(self) -> list[str]:
        """Lines on how a file is excited, and on kept reactions that redundant constraints leave open."""
        reacts = any(each.reacts for each in self.scalars)
        return [*self.start, *(undetermined_lines(self.swept.plan.scene) if reacts else ())]

    @property
    def judged(self) -> Cell:
        """The outcome as a table cell."""
        return Cell(self.outcome.value, self.outcome.judged) if self.outcome else Cell("made", "")


def findings(
    swept: SweepResults, checked: Sequence[CheckedRun], options: Mapping[str, str], start: tuple[str, ...]
) -> Findings:
    """Analyze a sweep; arguments as the attributes of `Findings`."""
    found, analysis = kept_numbers(swept), Analysis(swept.plan.samples, analyzed(swept), swept.inputs)
    effects = [(scalar, analysis.effects(scalar)) for scalar in most_informative(found)]
    nominal = _nominal(swept.plan, found)
    without = [scalar.label for scalar, each in effects if each and each[0].share is None]
    lost = f"no shares of variance of {', '.join(without)}: too many runs without it" if without else ""
    too_few = analysis.too_few or lost
    return Findings(swept, found, nominal, effects, list(checked), too_few, options, start)


def _nominal(plan: SweepPlan, found: Sequence[KeptNumber]) -> dict[str, float]:
    """Execute the run with nominal parameters; return its kept numbers by label."""
    own = own_values(plan.scene, plan.samples.names)
    values = run_all(plan, {name: value.reshape(1) for name, value in own.items()}).values
    return {each.label: float(values[each.variable][0][each.place]) for each in found}


def report(found: Findings) -> Report:
    """Make the report: all tables, and their short form for the terminal."""
    # Title: runs, sampling, and how many runs were executed now
    swept, samples = found.swept, found.swept.plan.samples
    of_runs = "1 run" if samples.runs == 1 else f"{samples.runs:,} runs"
    title = f"{swept.plan.scene.name}: {of_runs}, {samples.sampling}, seed {samples.seed}"
    if swept.made:
        title += f"; {swept.made:,} made at {swept.made / swept.wall_time:,.0f} per s"
    if swept.made < samples.runs:
        title += f"; {samples.runs - swept.made:,} were stored"
    # Notes: damaged files, and what part of the runs and numbers is analyzed
    of_runs, notes, failed = "", [*swept.repaired[:MAX_PRINTED_REASONS]], _failures(found)
    if (more := len(swept.repaired) - MAX_PRINTED_REASONS) > 0:
        notes.append(f"{more} more files were damaged and their runs repeated; -v prints all")
    if (count := len(analyzed(swept))) < samples.runs:
        of_runs = f"of {count:,} runs from all parts of the sweep"
        notes.append(f"quantiles and extremes are {of_runs}")
    for each in swept.plan.kept:
        size = int(np.prod(swept.dataset[each.name].shape[1:]))
        if (count := sum(scalar.variable == each.name for scalar in found.scalars)) < size:
            notes.append(f"{each.name}: {count} of its {size:,} numbers of a run are analyzed, evenly spread")
    # All tables
    parts: list[Part] = [_quantiles(found, found.scalars, f"quantiles {of_runs}".rstrip())]
    parts += [_effects(*each, None) for each in found.effects if each[1]]
    parts += [Lines("", [found.too_few])] if found.too_few else []
    parts += _checks(found.checked) if found.checked else []
    parts.append(_varied(swept.plan))
    far, gaps = _far_nominals(swept.plan), _missing_numbers(found)
    parts += [Lines("", list(lines)) for lines in (swept.repaired, found.notes, far, gaps) if lines]
    if failed:
        parts.append(Lines("failed runs", failed))
    # Summary for the terminal: the numbers that vary most, in the order of `--keep`
    varying = [scalar for scalar in found.scalars if scalar.varies]
    if not varying:
        varying = found.scalars
        if len(swept.stopped) < samples.runs:
            notes.append("the varied parameters have no effect on the kept outputs")
    first = most_varying(varying)[:MAX_PRINTED_ROWS]
    if any(_digits(each) > WIDE_TABLE_DIGITS for each in first):
        first = first[:MAX_WIDE_TABLE_ROWS]
    rows = sorted(first, key=found.scalars.index)
    summary: list[Part] = [_quantiles(found, rows, "")]
    summary += [_effects(*each, MAX_PRINTED_BARS) for each in found.effects[:MAX_PRINTED_CHARTS] if each[1]]
    notes += [
        *found.notes,
        *far[:MAX_PRINTED_REASONS],
        *gaps[:MAX_PRINTED_REASONS],
        *filter(None, [found.too_few]),
        *_not_shown(found, rows),
        *failed[:MAX_PRINTED_REASONS],
    ]
    if len(failed) > MAX_PRINTED_REASONS:
        notes.append(f"{len(failed) - MAX_PRINTED_REASONS} more reasons of failed runs; -v prints all")
    summary.append(Lines("", notes))
    return Report(title, found.verdict, found.judged, parts, swept.wall_time, summary)


def _not_shown(found: Findings, rows: Sequence[KeptNumber]) -> list[str]:
    """List the numbers and charts that the terminal does not show."""
    counts = {
        "numbers that do not vary": sum(not each.varies and each not in rows for each in found.scalars),
        "numbers that vary less": sum(each.varies and each not in rows for each in found.scalars),
        "charts of effects": len(found.effects) - MAX_PRINTED_CHARTS,
    }
    said = [f"{what}: {count}" for what, count in counts.items() if count > 0]
    return [f"not shown, -v prints all: {'; '.join(said)}"] if said else []


def _failures(found: Findings) -> list[str]:
    """Report each reason of failed runs: number of runs, the first reason in full, and a hint."""
    counts, firsts = Counter[str](), dict[str, tuple[int, str]]()
    for run, reason in found.swept.reasons():
        kind = NUMBER_PATTERN.sub("#", reason)
        counts[kind] += 1
        firsts.setdefault(kind, (run, reason))
    lines = []
    for kind, count in counts.most_common():
        run, reason = firsts[kind]
        which = f"run {run}" if count == 1 else f"{count} runs failed, such as run {run}"
        lines.append(f"{which}: {reason}{_hint(found.swept.plan, reason)}")
    return lines


def _hint(plan: SweepPlan, reason: str) -> str:
    """Suggest a truncated distribution if a normal one gave an invalid value."""
    for (name, *_), each in plan.samples.groups:
        if isinstance(each, Distribution) and each.kind == "normal" and f"{name!r}" in reason:
            mean, deviation = each.numbers
            return f"; {name}=truncated_normal({mean:g}, {deviation:g}, LOW, HIGH) stays within bounds"
    return ""


def _quantiles(found: Findings, rows: Sequence[KeptNumber], title: str) -> Table:
    """Tabulate nominal values and quantiles of kept numbers; without a title in the short form."""
    wanted = slice(None if title else 1, None)
    columns = [Column("of each run"), *number_columns("nominal", *list(QUANTILE_LEVELS)[wanted])]
    content: Rows = []
    for variable, members in groupby(rows, key=lambda each: each.variable):
        of_variable = list(members)
        if len(of_variable) > 1:
            content.append([with_unit(variable, of_variable[0].unit)])
        for each in of_variable:
            name = each.heading if len(of_variable) == 1 else f"  {' '.join(each.names)}"
            values = [found.nominal[each.label], *each.quantiles[wanted]]
            content.append([name, *(_number(value, _digits(each)) for value in values)])
    return Table(title, columns, content)


def _number(value: float, digits: int) -> str:
    """Format a number; a dash for NaN, for example if an event does not occur."""
    return f"{value:.{digits}g}" if np.isfinite(value) else "-"


def _digits(scalar: KeptNumber) -> int:
    """Return the number of digits in which the quantiles of a number differ."""
    if not scalar.varies:
        return MIN_QUANTILE_DIGITS
    hidden = int(np.ceil(np.log10(np.max(np.abs(scalar.quantiles)) / scalar.deviation)))
    return int(np.clip(hidden + 2, MIN_QUANTILE_DIGITS, MAX_QUANTILE_DIGITS))


def _effects(scalar: KeptNumber, found: Sequence[Effect], most: int | None) -> Table:
    """Tabulate the effects of parameters on a number, the largest first, with bars."""
    rows: Rows = []
    for effect in found[:most]:
        bar = "=" * round(BAR_WIDTH * min(1.0, effect.size))
        shares = [] if effect.share is None else [share_of(effect)]
        rows.append([effect.name, *shares, rank_of(effect), bar])
    if len(found) > len(rows):
        rows.append([f"{len(found) - len(rows)} smaller effects: -v"])
    heads = ["share of variance"] if found and found[0].share is not None else []
    columns = [Column(f"{scalar.label} by"), *number_columns(*heads, "rank"), Column("")]
    return Table("" if most else f"effects on {scalar.label}", columns, rows)


def _checks(checked: Sequence[CheckedRun]) -> list[Part]:
    """Make the tables of cross-checked runs, and list the verdicts of runs that failed or differ."""
    rows: Rows = []
    kept: Rows = []
    for each in checked:
        verdict = Cell("differ", "fails") if each.differs else Cell("agree", "holds")
        rows.append([str(each.run), each.why, verdict if each.complete else Cell("not all", "doubtful")])
        kept.append(f"run {each.run}")
        for check in each.kept:
            reason = "not converged" if check.unconverged else "not judged"
            difference = checked_cell(check.value, check.tolerance, check.agrees)
            if not check.judged:
                difference = Cell(f"{check.value:.1e}, {check.detail or reason}")
            kept.append([check.quantity, check.between[0], difference])
    columns = [*number_columns("run"), *text_columns("chosen", "engines")]
    columns_of_kept = [*text_columns("kept number", "engine"), *number_columns("difference")]
    parts: list[Part] = [Table("runs that were cross-checked", columns, rows, folded=True)]
    parts.append(Table("kept outputs of these runs, closest to failing", columns_of_kept, kept, folded=True))
    wrong = [f"run {each.run}: {each.verdict}" for each in checked if not (each.agrees and each.complete)]
    return [*parts, Lines("", wrong)] if wrong else parts


def _varied(plan: SweepPlan) -> Table:
    """Tabulate the varied parameters: unit, nominal value and distribution."""
    own = own_values(plan.scene, plan.samples.names)
    units = units_of(plan.scene, plan.samples.names)
    rows: Rows = []
    for names, distribution in plan.samples.groups:
        nominal = ", ".join(f"{own[name] + 0.0:.6g}" for name in names)
        rows.append([", ".join(names), units[names[0]], nominal, str(distribution)])
    return Table(
        "varied parameters", text_columns("parameter", "unit", "nominal", "distribution"), rows, folded=True
    )


def _far_nominals(plan: SweepPlan) -> list[str]:
    """Report nominal values that are far from their distribution, for example because of a wrong unit."""
    own = own_values(plan.scene, plan.samples.names)
    initial, lines = initial_numbers(plan.scene, plan.samples.names), []
    starting = origins(plan.scene, [name for name in plan.samples.names if name not in initial])
    for names, given in plan.samples.groups:
        of_each = (given,) if isinstance(given, Distribution) else given.distributions
        for name, each in zip(names, of_each, strict=True):
            away = each.deviations_of(float(own[name]))
            if away > FAR_NOMINAL_DEVIATIONS:
                value = f"{own[name] + 0.0:.4g}"
                if name in starting:
                    value += f", an offset from {starting[name] + 0.0:.4g}"
                lines.append(f"nominal {name}, {value}, is {away:.2g} deviations from the mean of {each}")
    return lines


def _missing_numbers(found: Findings) -> list[str]:
    """Report numbers that are NaN in some runs, and incomplete base samples of Saltelli's design."""
    lines, block = [], found.swept.plan.samples.block
    for scalar in found.scalars:
        known = np.isfinite(scalar.values)
        ended = ~np.isin(scalar.runs, found.swept.stopped)
        if ended.any() and not known.any():
            lines.append(f"{scalar.label}: a number in no run")
        elif np.any(ended & ~known):
            lines.append(
                f"{scalar.label}: a number in {known.sum():,} of {ended.sum():,} runs, which tables are of"
            )
    for scalar, effects in found.effects if block > 1 else ():
        whole = np.asarray(np.isfinite(scalar.values).reshape(-1, block).all(axis=1))
        if effects and effects[0].total is not None and not whole.all():
            of_all = f"{whole.sum():,} of {len(whole):,} base samples"
            lines.append(
                f"what matters for {scalar.label} is of {of_all}: without the others shares are distorted"
            )
    return lines


def write(found: Findings, made: Report, folder: Path) -> list[Path]:
    """Write the findings next to the Zarr store: JSON, plots and a recording, all files or none.

    Raises:
        CrosscheckError: naming the path that cannot be written.
    """
    from crosscheck.recording.log import recorded
    from crosscheck.sweeps.recording import log_sweep

    paths = [folder / name for name in SWEEP_FILES]
    check_writable(*paths)
    runs = analyzed(found.swept)
    points = sample_blocks(len(runs), MAX_SCATTER_POINTS)
    inputs, plan = found.swept.inputs(runs[points]), found.swept.plan
    units = units_of(plan.scene, plan.samples.names)
    drawn = pictures(found.effects, points, inputs, units, found.nominal)
    files = {folder / name: content for name, content in drawn.items()}
    to_show = to_record(found, made)
    if to_show[1]:
        files[folder / SWEEP_FILES[1]] = recorded(log_sweep, *to_show)
    whole = {folder / SWEEP_FILES[0]: as_json(_data(found), made, files), **files}
    write_files(whole, [path for path in paths if path not in whole])
    return list(whole)


def to_record(found: Findings, made: Report) -> tuple[Any, ...]:
    """Return the arguments of `crosscheck.sweeps.recording.log_sweep`."""
    text = markdown(replace(made, parts=made.summary))
    return found.swept.plan.scene, *_repeated_runs(found), text, made.title


def _data(found: Findings) -> dict[str, object]:
    """Return all findings, for JSON."""
    plan = found.swept.plan
    return {
        "scene": plan.scene.name,
        "source": plan.scene.name,
        "options": dict(found.options),
        "vary": {", ".join(names): str(each) for names, each in plan.samples.groups},
        "sampling": plan.samples.sampling,
        "runs": plan.samples.runs,
        "seed": plan.samples.seed,
        "keep": list(plan.keep),
        "control": dict(plan.control),
        "errors": len(found.swept.stopped),
        "known": {each.label: int(np.isfinite(each.values).sum()) for each in found.scalars},
        "quantiles": {
            each.label: dict(
                zip(map("{:g}".format, QUANTILE_LEVELS.values()), each.quantiles.tolist(), strict=True)
            )
            for each in found.scalars
        },
        "effects": {scalar.label: [asdict(each) for each in effects] for scalar, effects in found.effects},
        "checked": [asdict(each) for each in found.checked],
        "notes": found.notes,
    }


def _repeated_runs(found: Findings) -> tuple[dict[str, Trajectory], list[Envelope]]:
    """Repeat the nominal run, the extreme runs and a sample of runs, with all output times.

    Returns:
        The nominal run and the extreme runs by name, except failed ones; and the time series of the numbers
        that vary most, over all repeated runs.
    """
    from crosscheck.sweeps.recording import Envelope

    plan = found.swept.plan
    extremes = list(
        dict.fromkeys(scalar.extreme(largest) for scalar, _ in found.effects for largest in (True, False))
    )[:MAX_RECORDED_EXTREMES]
    named = ["nominal", *(f"run {run}" for run in extremes)]
    own = own_values(plan.scene, plan.samples.names)
    inputs = found.swept.inputs(np.array([*extremes, *sample_blocks(plan.samples.runs, ENVELOPE_RUNS)]))
    values = {name: np.append(own[name], of_runs) for name, of_runs in inputs.items()}
    scene = replace(plan.lean, output_period=plan.scene.output_period)
    kept = {each.name: each for each in plan.kept}
    runs: dict[str, Trajectory] = {}
    parts: list[list[Array]] = []
    size = max(len(named), plan.runs_per_batch(scene))
    for first in range(0, len(next(iter(values.values()))), size):
        part = {name: of_runs[first : first + size] for name, of_runs in values.items()}
        batch = plan.batch(part, scene, threads=None)
        if not first:
            runs = {name: batch[k] for k, name in enumerate(named) if k not in batch.errors}
        outputs = Outputs.of_batch(plan.scene, batch)
        # copies, since a view would keep the whole batch in memory
        parts.append([kept[each.variable].line(outputs, each.place).copy() for each, _ in found.effects])
    envelopes = []
    for k, (scalar, _) in enumerate(found.effects):
        courses = np.concatenate([part[k] for part in parts])
        lines = {name: course for name, course in zip(named, courses, strict=False) if name in runs}
        envelopes.append(Envelope(scalar.heading, scene.times, courses[len(named) :], lines))
    return runs, envelopes
