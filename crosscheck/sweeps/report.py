"""Report on a sweep: tables, plots, a recording, and files of its findings.

A sweep simulates a scene many times with varied parameters and keeps some numbers of each run. The findings
are the quantiles of these numbers, the effects of the parameters on them, and crosschecks: repetitions of
some runs in all engines. `findings` analyzes a sweep, `report` makes the tables, and `write` the files.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

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
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.runs.initial_coordinates import initial_numbers
from newton_euler.runs.variation import own_values, units_of
from newton_euler.scalars import Array

if TYPE_CHECKING:
    from crosscheck.sweeps.recording import Envelope

FINDINGS_FILE = "sweep.json"
"""Name of the file with all findings."""

RECORDING_FILE = "sweep.rrd"
"""Name of the file with the Rerun recording."""

SWEEP_FILES = (FINDINGS_FILE, RECORDING_FILE, "tornado.png", "histograms.png", "scatter.png")
"""Names of the files that `write` can write: all findings, the recording, and plots."""

MAX_PRINTED_ROWS = 6
"""Largest number of kept numbers in the terminal. With the next three limits, the printed report has about 25
lines."""

MAX_PRINTED_CHARTS = 2
"""Largest number of charts of effects in the terminal."""

MAX_PRINTED_BARS = 4
"""Largest number of parameters in a chart in the terminal."""

MAX_PRINTED_REASONS = 3
"""Largest number of lines of each kind of note in the terminal, for example of reasons of failed runs."""

BAR_WIDTH = 10
"""Characters of a bar for an effect of 100 %, made of "=", since Rerun's viewer has no block characters."""

MIN_QUANTILE_DIGITS, MAX_QUANTILE_DIGITS = 4, 11
"""Smallest and largest number of significant digits of quantiles; numbers that vary little need many."""

WIDE_TABLE_DIGITS = 6
"""Number of digits of quantiles above which a table is wider than the terminal: each row takes two lines."""

MAX_WIDE_TABLE_ROWS = 3
"""Largest number of rows of such a wide table in the terminal."""

NUMBER_PATTERN = re.compile(r"-?\d+(\.\d+)?(e[-+]?\d+)?(?![\w.])")
"""Numbers in the reason of a failed run; reasons that differ in numbers only are counted together."""

FAR_NOMINAL_DEVIATIONS = 3.0
"""Distance of a nominal value from the mean of its distribution, in standard deviations, above which the
distance is reported."""

ENVELOPE_RUNS = 100
"""Number of runs in the envelopes over time."""

MAX_RECORDED_EXTREMES = 4
"""Largest number of extreme runs in a recording."""


@dataclass(frozen=True, eq=False)
class Findings:
    """Analysis of a sweep, and crosschecks of some of its runs.

    Attributes:
        swept: the runs of the sweep.
        scalars: the kept numbers: each element of each kept output, with its values in all runs.
        nominal: values of the kept numbers in the nominal run (with the scene's own parameters), by label.
        effects: for each kept output, the number that varies most, and the effects of the parameters on it.
        checked: crosschecks of some runs.
        too_few: reason why there are no Sobol indices; empty if there are.
        options: options of the scene or model file.
        start: lines about the excitation of a model file (its joints get velocities, its actuators inputs),
            and about initial poses that were changed to close loops.
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
        runs, failed = self.swept.plan.samples.runs, len(self.swept.failed_runs)
        completed = f"{runs - failed:,} of {runs:,} run{'s' * (runs != 1)} completed"
        text = f"{completed}; none was cross-checked"
        if self.checked:
            extremes = {scalar.extreme(largest) for scalar, _ in self.effects for largest in (True, False)}
            text = f"{result_line(self.checked, extremes)}; {completed}"
        text = "; ".join(filter(None, [self._not_simulated, text]))
        return f"{self.outcome}: {text}" if self.outcome else text

    @property
    def outcome(self) -> Outcome | None:
        """Outcome of the crosschecks; None if all runs completed and no run was cross-checked."""
        if any(each.differs for each in self.checked):
            return Outcome.DISAGREE
        if len(self.swept.failed_runs) or not all(each.complete for each in self.checked):
            return Outcome.UNFINISHED
        if not self.checked:
            return None
        if all(each.engines == ("newton_euler",) for each in self.checked):
            return Outcome.ONE_ENGINE_ALONE  # newton_euler also executed the sweep
        if any(each.acting for each in self.checked):  # elements that were not simulated would have acted
            return Outcome.AGREE_ON_A_REDUCED_MODEL
        if any(each.untested for each in self.checked):  # the motion tests no element
            return Outcome.AGREE_AT_RANDOM_STATES_ONLY
        return Outcome.AGREE

    @property
    def _not_simulated(self) -> str:
        """Name the elements of the model file that are not simulated but would have acted in checked runs."""
        names = list(dict.fromkeys(what_acted(entry) for each in self.checked for entry in each.acting))
        if not names:
            return ""
        more = f" and {len(names) - MAX_NAMED} more" if len(names) > MAX_NAMED else ""
        runs = sum(bool(each.acting) for each in self.checked)
        return f"not simulated: {', '.join(names[:MAX_NAMED])}{more}, in {runs} of {len(self.checked)} runs"

    @cached_property
    def notes(self) -> list[str]:
        """Lines of `start`, and, if a kept number depends on reactions, lines on joint reactions that are not
        unique because of redundant constraints."""
        depends_on_reactions = any(each.depends_on_reactions for each in self.scalars)
        return [*self.start, *(undetermined_lines(self.swept.plan.scene) if depends_on_reactions else ())]

    @property
    def judged(self) -> Cell:
        """Table cell of the outcome, with the kind of the outcome, which selects its color."""
        # without an outcome, the sweep was executed ("made") but not cross-checked
        return Cell(self.outcome.value, self.outcome.judged) if self.outcome else Cell("made", "")


def findings(
    swept: SweepResults, checked: Sequence[CheckedRun], options: Mapping[str, str], start: tuple[str, ...]
) -> Findings:
    """Analyze a sweep; the arguments are attributes of `Findings`."""
    scalars, analysis = kept_numbers(swept), Analysis(swept.plan.samples, analyzed(swept), swept.inputs)
    effects = [(scalar, analysis.effects(scalar)) for scalar in most_informative(scalars)]
    # numbers that are NaN in so many runs that there are no Sobol indices
    without_shares = [scalar.label for scalar, found in effects if found and found[0].share is None]
    too_few = analysis.too_few
    if without_shares and not too_few:
        too_few = f"no shares of variance of {', '.join(without_shares)}: too many runs without it"
    return Findings(
        swept=swept,
        scalars=scalars,
        nominal=_nominal(swept.plan, scalars),
        effects=effects,
        checked=list(checked),
        too_few=too_few,
        options=options,
        start=start,
    )


def _nominal(plan: SweepPlan, scalars: Sequence[KeptNumber]) -> dict[str, float]:
    """Execute the run with nominal parameters; return its kept numbers by label."""
    parameters = own_values(plan.scene, plan.samples.names)
    values = run_all(plan, {name: value.reshape(1) for name, value in parameters.items()}).values
    return {each.label: float(values[each.variable][0][each.index]) for each in scalars}


def report(found: Findings) -> Report:
    """Make the report of the findings: all tables, and a summary for the terminal."""
    # Title: runs, sampling, and how many runs were executed now
    swept, samples = found.swept, found.swept.plan.samples
    runs_text = "1 run" if samples.runs == 1 else f"{samples.runs:,} runs"
    title = f"{swept.plan.scene.name}: {runs_text}, {samples.sampling}, seed {samples.seed}"
    if swept.executed:
        title += f"; {swept.executed:,} made at {swept.executed / swept.wall_time:,.0f} per s"
    if swept.executed < samples.runs:
        title += f"; {samples.runs - swept.executed:,} were stored"
    # Notes of the summary: damaged files, and which part of the runs and numbers is analyzed
    notes = [*swept.repaired[:MAX_PRINTED_REASONS]]
    if (more := len(swept.repaired) - MAX_PRINTED_REASONS) > 0:
        notes.append(f"{more} more files were damaged and their runs repeated; -v prints all")
    part_of_runs = ""
    if (count := len(analyzed(swept))) < samples.runs:
        part_of_runs = f"of {count:,} runs from all parts of the sweep"
        notes.append(f"quantiles and extremes are {part_of_runs}")
    for each in swept.plan.kept:
        size = int(np.prod(swept.dataset[each.name].shape[1:]))
        if (count := sum(scalar.variable == each.name for scalar in found.scalars)) < size:
            notes.append(f"{each.name}: {count} of its {size:,} numbers of a run are analyzed, evenly spread")
    # All tables
    parts: list[Part] = [_quantiles(found, found.scalars, f"quantiles {part_of_runs}".rstrip())]
    parts += [_effects(scalar, effects, None) for scalar, effects in found.effects if effects]
    parts += [Lines("", [found.too_few])] if found.too_few else []
    parts += _checks(found.checked) if found.checked else []
    parts.append(_varied(swept.plan))
    far_nominals, missing_numbers = _far_nominals(swept.plan), _missing_numbers(found)
    failures = _failures(found)
    lists_of_notes = (swept.repaired, found.notes, far_nominals, missing_numbers)
    parts += [Lines("", list(lines)) for lines in lists_of_notes if lines]
    if failures:
        parts.append(Lines("failed runs", failures))
    # Summary for the terminal: the numbers that vary most, in the order of the kept outputs
    varying = [scalar for scalar in found.scalars if scalar.varies]
    if not varying:
        varying = found.scalars
        if len(swept.failed_runs) < samples.runs:
            notes.append("the varied parameters have no effect on the kept outputs")
    printed = most_varying(varying)[:MAX_PRINTED_ROWS]
    if any(_digits(each) > WIDE_TABLE_DIGITS for each in printed):
        printed = printed[:MAX_WIDE_TABLE_ROWS]
    printed.sort(key=found.scalars.index)
    summary: list[Part] = [_quantiles(found, printed, "")]
    summary += [
        _effects(scalar, effects, MAX_PRINTED_BARS)
        for scalar, effects in found.effects[:MAX_PRINTED_CHARTS]
        if effects
    ]
    notes += [
        *found.notes,
        *far_nominals[:MAX_PRINTED_REASONS],
        *missing_numbers[:MAX_PRINTED_REASONS],
        *filter(None, [found.too_few]),
        *_not_shown(found, printed),
        *failures[:MAX_PRINTED_REASONS],
    ]
    if len(failures) > MAX_PRINTED_REASONS:
        notes.append(f"{len(failures) - MAX_PRINTED_REASONS} more reasons of failed runs; -v prints all")
    summary.append(Lines("", notes))
    return Report(title, found.verdict, found.judged, parts, swept.wall_time, summary)


def _not_shown(found: Findings, printed: Sequence[KeptNumber]) -> list[str]:
    """Count the numbers and charts that the terminal does not show; one line, or none.

    Args:
        found: the findings.
        printed: the kept numbers that the terminal shows.
    """
    counts = {
        "numbers that do not vary": sum(not each.varies and each not in printed for each in found.scalars),
        "numbers that vary less": sum(each.varies and each not in printed for each in found.scalars),
        "charts of effects": len(found.effects) - MAX_PRINTED_CHARTS,
    }
    texts = [f"{what}: {count}" for what, count in counts.items() if count > 0]
    return [f"not shown, -v prints all: {'; '.join(texts)}"] if texts else []


def _failures(found: Findings) -> list[str]:
    """Report failed runs: for each kind of reason the number of runs, the first reason and a hint."""
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
    """Suggest a truncated distribution if the reason quotes a parameter with a normal distribution; or ""."""
    for (name, *_), each in plan.samples.groups:  # a `Distribution` has one parameter
        if isinstance(each, Distribution) and each.kind == "normal" and f"{name!r}" in reason:
            mean, deviation = each.numbers
            return f"; {name}=truncated_normal({mean:g}, {deviation:g}, LOW, HIGH) stays within bounds"
    return ""


def _quantiles(found: Findings, scalars: Sequence[KeptNumber], title: str) -> Table:
    """Tabulate nominal values and quantiles of kept numbers.

    Args:
        found: the findings, which contain the nominal values.
        scalars: the kept numbers of the table.
        title: title of the table; empty for the short form in the terminal, without the smallest value.
    """
    shown = slice(None if title else 1, None)  # of `QUANTILE_LEVELS`, whose first one is the smallest value
    columns = [Column("of each run"), *number_columns("nominal", *list(QUANTILE_LEVELS)[shown])]
    rows: Rows = []
    for variable, members in groupby(scalars, key=lambda each: each.variable):
        of_variable = list(members)
        if len(of_variable) > 1:
            rows.append([with_unit(variable, of_variable[0].unit)])
        for each in of_variable:
            name = each.heading if len(of_variable) == 1 else f"  {' '.join(each.index_labels)}"
            values = [found.nominal[each.label], *each.quantiles[shown]]
            rows.append([name, *(_number(value, _digits(each)) for value in values)])
    return Table(title, columns, rows)


def _number(value: float, digits: int) -> str:
    """Format a number; a dash for NaN, for example if an event does not occur."""
    return f"{value:.{digits}g}" if np.isfinite(value) else "-"


def _digits(scalar: KeptNumber) -> int:
    """Return the number of significant digits that shows how much the quantiles of a number differ."""
    if not scalar.varies:
        return MIN_QUANTILE_DIGITS
    equal_digits = int(np.ceil(np.log10(np.max(np.abs(scalar.quantiles)) / scalar.deviation)))
    return int(np.clip(equal_digits + 2, MIN_QUANTILE_DIGITS, MAX_QUANTILE_DIGITS))


def _effects(scalar: KeptNumber, found: Sequence[Effect], most: int | None) -> Table:
    """Tabulate the effects of parameters on a number: share of variance, rank correlation, and a bar.

    Args:
        scalar: the kept number.
        found: effects of the parameters on it, the largest first.
        most: largest number of effects in the short form for the terminal; None for all effects.
    """
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
    """Make the tables of cross-checked runs.

    The first table has one row per run. The second one lists, for each run, the differences between the kept
    outputs of the engines and those of the sweep. Verdicts of runs that failed or differ follow. Pages show
    the two tables on demand (`folded`), and the terminal does not show them.
    """
    rows: Rows = []
    kept: Rows = []
    for each in checked:
        verdict = Cell("differ", "fails") if each.differs else Cell("agree", "holds")
        rows.append([str(each.run), each.why, verdict if each.complete else Cell("not all", "doubtful")])
        kept.append(f"run {each.run}")  # a text is the heading of the rows after it
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
    nominal_values = own_values(plan.scene, plan.samples.names)
    units = units_of(plan.scene, plan.samples.names)
    rows: Rows = []
    for names, distribution in plan.samples.groups:
        nominal = ", ".join(f"{nominal_values[name] + 0.0:.6g}" for name in names)  # + 0.0 avoids "-0"
        rows.append([", ".join(names), units[names[0]], nominal, str(distribution)])
    return Table(
        "varied parameters", text_columns("parameter", "unit", "nominal", "distribution"), rows, folded=True
    )


def _far_nominals(plan: SweepPlan) -> list[str]:
    """Report nominal values that are far from their distribution, for example because of a wrong unit."""
    nominal_values = own_values(plan.scene, plan.samples.names)
    initial, lines = initial_numbers(plan.scene, plan.samples.names), []
    # Some parameters are displacements of points: values are offsets, m, from these positions
    starting_points = origins(plan.scene, [name for name in plan.samples.names if name not in initial])
    for names, given in plan.samples.groups:
        of_each = (given,) if isinstance(given, Distribution) else given.distributions
        for name, each in zip(names, of_each, strict=True):
            deviations = each.deviations_of(float(nominal_values[name]))
            if deviations > FAR_NOMINAL_DEVIATIONS:
                value = f"{nominal_values[name] + 0.0:.4g}"
                if name in starting_points:
                    value += f", an offset from {starting_points[name] + 0.0:.4g}"
                lines.append(
                    f"nominal {name}, {value}, is {deviations:.2g} deviations from the mean of {each}"
                )
    return lines


def _missing_numbers(found: Findings) -> list[str]:
    """Report numbers that are NaN in some completed runs, for example times of events that did not occur.

    Also report base samples (blocks of runs for Sobol indices) of Saltelli's design with such a run.
    """
    lines, block = [], found.swept.plan.samples.block
    for scalar in found.scalars:
        known = np.isfinite(scalar.values)
        completed = ~np.isin(scalar.runs, found.swept.failed_runs)
        if completed.any() and not known.any():
            lines.append(f"{scalar.label}: a number in no run")
        elif np.any(completed & ~known):
            lines.append(
                f"{scalar.label}: a number in {known.sum():,} of {completed.sum():,} runs, "
                "which tables are of"
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

    Args:
        found: the findings.
        made: their report, which the JSON file contains.
        folder: folder of the files. Files of an earlier sweep that are not written again are removed.

    Returns:
        Paths of the written files.

    Raises:
        CrosscheckError: naming the path that cannot be written.
    """
    from crosscheck.recording.stream import recorded
    from crosscheck.sweeps.recording import log_sweep

    paths = [folder / name for name in SWEEP_FILES]
    check_writable(*paths)
    runs = analyzed(found.swept)
    points = sample_blocks(len(runs), MAX_SCATTER_POINTS)
    inputs, plan = found.swept.inputs(runs[points]), found.swept.plan
    units = units_of(plan.scene, plan.samples.names)
    drawn = pictures(found.effects, points, inputs, units, found.nominal)
    files = {folder / name: content for name, content in drawn.items()}
    to_log = to_record(found, made)
    if to_log.runs:
        files[folder / RECORDING_FILE] = recorded(log_sweep, *to_log)
    whole = {folder / FINDINGS_FILE: as_json(_data(found), made, files), **files}
    write_files(whole, [path for path in paths if path not in whole])
    return list(whole)


class RecordingContent(NamedTuple):
    """Arguments of `crosscheck.sweeps.recording.log_sweep` after the recording.

    Attributes:
        scene: scene with nominal values.
        runs: the nominal run and the extreme runs by name, except failed ones.
        envelopes: for each kept output, the time series of the number that varies most, over many runs.
        text: summary of the report, Markdown.
        title: title of the report.
    """

    scene: Scene
    runs: dict[str, Trajectory]
    envelopes: list[Envelope]
    text: str
    title: str


def to_record(found: Findings, made: Report) -> RecordingContent:
    """Return what `crosscheck.sweeps.recording.log_sweep` logs of the findings and their report."""
    runs, envelopes = _repeated_runs(found)
    text = markdown(replace(made, parts=made.summary))
    return RecordingContent(found.swept.plan.scene, runs, envelopes, text, made.title)


def _data(found: Findings) -> dict[str, object]:
    """Return all findings, for JSON."""
    plan = found.swept.plan
    return {
        "scene": plan.scene.name,
        "source": plan.scene.name,  # the model, by the key that all result files have
        "options": dict(found.options),
        "vary": {", ".join(names): str(each) for names, each in plan.samples.groups},
        "sampling": plan.samples.sampling,
        "runs": plan.samples.runs,
        "seed": plan.samples.seed,
        "keep": list(plan.keep),
        "control": dict(plan.control),
        "errors": len(found.swept.failed_runs),
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
        The attributes `runs` and `envelopes` of `RecordingContent`.
    """
    from crosscheck.sweeps.recording import Envelope

    # Parameters of all repeated runs: first the nominal run and the extreme runs, which have names
    plan = found.swept.plan
    extremes = list(
        dict.fromkeys(scalar.extreme(largest) for scalar, _ in found.effects for largest in (True, False))
    )[:MAX_RECORDED_EXTREMES]
    names = ["nominal", *(f"run {run}" for run in extremes)]
    nominal_values = own_values(plan.scene, plan.samples.names)
    inputs = found.swept.inputs(np.array([*extremes, *sample_blocks(plan.samples.runs, ENVELOPE_RUNS)]))
    values = {name: np.append(nominal_values[name], of_runs) for name, of_runs in inputs.items()}
    # Simulate as many runs at a time as fit into memory; the first batch contains all runs with names.
    # The pruned scene saves only the outputs, such as velocities, that the kept numbers need
    scene = replace(plan.pruned_scene, output_period=plan.scene.output_period)
    kept = {each.name: each for each in plan.kept}
    runs: dict[str, Trajectory] = {}
    parts: list[list[Array]] = []  # time series (runs of the batch, n) by batch and kept number
    size = max(len(names), plan.runs_per_batch(scene))
    for first in range(0, len(next(iter(values.values()))), size):
        part = {name: of_runs[first : first + size] for name, of_runs in values.items()}
        batch = plan.batch(part, scene, threads=None)
        if not first:
            runs = {name: batch[k] for k, name in enumerate(names) if k not in batch.errors}
        outputs = Outputs.of_batch(plan.scene, batch)
        # copies, since a view would keep the whole batch in memory
        parts.append(
            [kept[each.variable].time_series_of(outputs, each.index).copy() for each, _ in found.effects]
        )
    # Time series of the sample and of the runs with names
    envelopes = []
    for k, (scalar, _) in enumerate(found.effects):
        time_series = np.concatenate([part[k] for part in parts])
        lines = {name: line for name, line in zip(names, time_series, strict=False) if name in runs}
        envelopes.append(Envelope(scalar.heading, scene.times, time_series[len(names) :], lines))
    return runs, envelopes
