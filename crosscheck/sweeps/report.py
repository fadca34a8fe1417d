"""Report on a sweep: tables of its findings, and a summary for the terminal.

A sweep simulates a scene many times with varied parameters and keeps some numbers of each run. The findings
are the quantiles of these numbers, the effects of the parameters on them, and crosschecks: repetitions of
some runs in all engines.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from itertools import groupby

import numpy as np

from crosscheck.report.chart import BarChart, Measure, linear_chart
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
from crosscheck.sweeps.analysis import Effect
from crosscheck.sweeps.checks import CheckedRun
from crosscheck.sweeps.distributions import Distribution
from crosscheck.sweeps.findings import Findings
from crosscheck.sweeps.kept_numbers import QUANTILE_LEVELS, KeptNumber, analyzed, most_varying, with_unit
from crosscheck.sweeps.pictures import rank_of, share_of
from crosscheck.sweeps.plan import SweepPlan
from newton_euler.equations.parameters import origins
from newton_euler.runs.initial_coordinates import initial_numbers
from newton_euler.runs.variation import own_values, units_of

MAX_PRINTED_ROWS = 12
"""Largest number of kept numbers in the terminal: those of all joints of a small mechanism. With the next
three limits, the printed report has about 30 lines."""

MAX_PRINTED_CHARTS = 2
"""Largest number of charts of effects in the terminal."""

MAX_PRINTED_BARS = 4
"""Largest number of parameters in a chart in the terminal."""

MAX_PRINTED_REASONS = 3
"""Largest number of lines of each kind of note in the terminal, for example of reasons of failed runs."""

MIN_WHOLE_RATE = 10.0
"""Smallest number of runs per second that is printed without decimals."""

BAR_WIDTH = 10
"""Characters of a bar for an effect of 100 %, made of "=", since Rerun's viewer has no block characters."""

MIN_QUANTILE_DIGITS, MAX_QUANTILE_DIGITS = 4, 11
"""Smallest and largest number of significant digits of quantiles; numbers that vary little need many."""

NUMBER_PATTERN = re.compile(r"-?\d+(\.\d+)?(e[-+]?\d+)?(?![\w.])")
"""Numbers in the reason of a failed run; reasons that differ in numbers only are counted together."""

FAR_NOMINAL_DEVIATIONS = 3.0
"""Distance of a nominal value from the mean of its distribution, in standard deviations, above which the
distance is reported."""


def report(found: Findings) -> Report:
    """Make the report of the findings: all tables, and a summary for the terminal."""
    # Title: runs, sampling, and how many runs were executed now
    swept, samples = found.swept, found.swept.plan.samples
    runs_text = "1 run" if samples.runs == 1 else f"{samples.runs:,} runs"
    title = f"{swept.plan.scene.name}: {runs_text}, {samples.sampling}, seed {samples.seed}"
    if swept.executed:
        rate = swept.executed / swept.wall_time
        title += f"; {swept.executed:,} simulated, {rate:,.{0 if rate >= MIN_WHOLE_RATE else 2}f} runs/s"
    if swept.executed < samples.runs:
        title += f"; {samples.runs - swept.executed:,} from earlier commands"
    # Notes of the summary: damaged files, and which part of the runs and numbers is analyzed
    notes = [*swept.repaired[:MAX_PRINTED_REASONS]]
    if (more := len(swept.repaired) - MAX_PRINTED_REASONS) > 0:
        notes.append(f"{more} more files were damaged, and their runs repeated; -v prints all")
    part_of_runs = ""
    if (count := len(analyzed(swept))) < samples.runs:
        part_of_runs = f"of {count:,} runs from all parts of the sweep"
        notes.append(f"quantiles and extremes are those {part_of_runs}")
    for each in swept.plan.kept:
        size = int(np.prod(swept.dataset[each.name].shape[1:]))
        if (count := sum(scalar.variable == each.name for scalar in found.scalars)) < size:
            notes.append(f"{each.name}: {count} of its {size:,} components are analyzed, evenly spread")
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
    return Report(
        title,
        found.verdict,
        found.judged,
        parts,
        swept.wall_time,
        summary,
        charts=_charts(found),
        captions={
            "tornado.png": "Effect of each parameter on the outputs that vary most",
            "histograms.png": "Distribution of the outputs over all runs",
            "scatter.png": "Outputs over the parameters with the largest effects",
        },
        next_steps=_next_steps(found),
    )


def _charts(found: Findings) -> list[BarChart]:
    """Make the chart of the effects of the parameters on the first analyzed number."""
    for scalar, effects in found.effects:
        if effects:
            measures = [Measure(each.name, each.size, f"{100.0 * each.size:.0f} %") for each in effects]
            caption = "Effect of each parameter: share of variance, or magnitude of the rank correlation"
            return linear_chart(f"Effects on {scalar.label}", caption, measures, end=1.0)
    return []


def _next_steps(found: Findings) -> list[str]:
    """List what the reader can do with the sweep."""
    steps = []
    if any(each.differs for each in found.checked):
        steps.append(
            "Find the cause of the disagreement first: `crosscheck run` with the parameters of that run."
        )
    if len(found.swept.failed_runs):
        steps.append("Change the distributions so that all runs complete; the details have the reasons.")
    first = next(((scalar, effects[0]) for scalar, effects in found.effects if effects), None)
    if first:
        scalar, effect = first
        steps.append(f"To reduce the spread of {scalar.label}, begin with {effect.name}.")
    if found.too_few:
        steps.append("For more certain effects, repeat the command with a larger `--runs`.")
    return steps or ["Vary other parameters: these have no effect on the kept outputs."]


def _not_shown(found: Findings, printed: Sequence[KeptNumber]) -> list[str]:
    """Count the numbers and charts that the terminal does not show; one line, or none.

    Args:
        found: the findings.
        printed: the kept numbers that the terminal shows.
    """
    counts = {
        "outputs that do not vary": sum(not each.varies and each not in printed for each in found.scalars),
        "outputs that vary less": sum(each.varies and each not in printed for each in found.scalars),
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
    columns = [Column("output"), *number_columns("nominal", *list(QUANTILE_LEVELS)[shown])]
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
    columns = [Column(f"effects on {scalar.label}"), *number_columns(*heads, "rank correlation"), Column("")]
    return Table("" if most else scalar.label, columns, rows)


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
    columns_of_kept = [*text_columns("output", "engine"), *number_columns("difference")]
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
            lines.append(f"{scalar.label}: has no value in any run")
        elif np.any(completed & ~known):
            lines.append(
                f"{scalar.label}: has a value in {known.sum():,} of {completed.sum():,} runs; tables are of "
                "these runs"
            )
    for scalar, effects in found.effects if block > 1 else ():
        whole = np.asarray(np.isfinite(scalar.values).reshape(-1, block).all(axis=1))
        if effects and effects[0].total is not None and not whole.all():
            of_all = f"{whole.sum():,} of {len(whole):,} base samples"
            lines.append(
                f"effects on {scalar.label} are those of {of_all}: without the others they are distorted"
            )
    return lines
