"""The report on a sweep: quantiles, what matters, crosschecks; its tables, pictures, recording and files."""

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

from crosscheck.compare.activity import MOST_ACTING, what_acted
from crosscheck.report.outcome import Outcome
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
    figures,
    judged,
    texts,
)
from crosscheck.support.files import check_writable, write_files
from crosscheck.sweeps.analysis import (
    LEVELS,
    Analysis,
    Effect,
    Scalar,
    analyzed,
    most_varying,
    scalars,
    telling,
    thinned,
    with_unit,
)
from crosscheck.sweeps.checks import Checked, worded
from crosscheck.sweeps.distributions import Distribution
from crosscheck.sweeps.expressions import Outputs
from crosscheck.sweeps.pictures import MOST_POINTS, pictures, rank_of, share_of
from crosscheck.sweeps.plan import Plan, run_all
from crosscheck.sweeps.results import Results
from newton_euler.equations.parameters import origins
from newton_euler.model.trajectory import Trajectory
from newton_euler.runs.initial_coordinates import initial_numbers
from newton_euler.runs.variation import own_values, units_of
from newton_euler.scalars import Array

if TYPE_CHECKING:
    from crosscheck.recording.sweep import Envelope

FILES = ("sweep.json", "sweep.rrd", "tornado.png", "histograms.png", "scatter.png")

MOST_ROWS, MOST_CHARTS, MOST_BARS, MOST_REASONS = 6, 2, 4, 3
"""Of tables that are printed, so that all fits 25 lines."""

BAR = 10
"""Characters of a bar of 100 %; Rerun's viewer has no blocks among its glyphs."""

LEAST_DIGITS, MOST_DIGITS = 4, 11
"""Of quantiles; the most show a number that barely varies."""

WIDE, MOST_WIDE_ROWS = 6, 3
"""Digits beyond which a table is wider than a terminal and has each row twice, and its rows then."""

NUMBER = re.compile(r"-?\d+(\.\d+)?(e[-+]?\d+)?(?![\w.])")
"""In the reason of a run; reasons that differ in numbers alone are one."""

FAR = 3.0
"""Deviations from its mean at which the scene's own value is hardly one of a distribution."""

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
        too_few: why there are no shares of variance; empty if there are.
        options: of the scene or the file.
        start: lines about how a file is excited, and how far the start is from the file's.
    """

    swept: Results
    scalars: list[Scalar]
    nominal: dict[str, float]
    effects: list[tuple[Scalar, list[Effect]]]
    checked: list[Checked]
    too_few: str
    options: Mapping[str, str]
    start: tuple[str, ...]

    @property
    def verdict(self) -> str:
        """One line: whether the engines agree on the runs that were checked, and how many came to an end."""
        runs, stopped = self.swept.plan.samples.runs, len(self.swept.stopped)
        of_runs = "1 run came to its" if runs == 1 else f"{runs:,} runs came to their"
        ended = f"{runs - stopped:,} of {of_runs} end"
        found = f"{ended}; none was cross-checked"
        if self.checked:
            extremes = {scalar.extreme(largest) for scalar, _ in self.effects for largest in (True, False)}
            found = f"{worded(self.checked, extremes)}; {ended}"
        found = "; ".join(filter(None, [self._reduced, found]))
        return f"{self.outcome}: {found}" if self.outcome else found

    @property
    def outcome(self) -> Outcome | None:
        """The outcome of the crosschecks; None if all runs came to their end and none was cross-checked."""
        if any(each.differs for each in self.checked):
            return Outcome.DISAGREE
        if len(self.swept.stopped) or not all(each.complete for each in self.checked):
            return Outcome.UNFINISHED
        if not self.checked:
            return None
        if all(each.engines == ("newton_euler",) for each in self.checked):
            return Outcome.ONE_ENGINE_ALONE  # which made the sweep, too
        if any(each.acting for each in self.checked):
            return Outcome.AGREE_ON_A_REDUCED_MODEL
        if any(each.untested for each in self.checked):
            return Outcome.AGREE_AT_RANDOM_STATES_ONLY
        return Outcome.AGREE

    @property
    def _reduced(self) -> str:
        """Word the elements that acted in runs that were checked and were not simulated."""
        names = list(dict.fromkeys(what_acted(entry) for each in self.checked for entry in each.acting))
        if not names:
            return ""
        more = f" and {len(names) - MOST_ACTING} more" if len(names) > MOST_ACTING else ""
        runs = sum(bool(each.acting) for each in self.checked)
        return f"not simulated: {', '.join(names[:MOST_ACTING])}{more}, in {runs} of {len(self.checked)} runs"

    @cached_property
    def notes(self) -> list[str]:
        """Lines on how a file is excited, and on kept reactions that redundant constraints leave open."""
        reacts = any(each.reacts for each in self.scalars)
        return [*self.start, *(undetermined_lines(self.swept.plan.scene) if reacts else ())]

    @property
    def judged(self) -> Cell:
        """The outcome with its color."""
        return Cell(self.outcome.value, self.outcome.judged) if self.outcome else Cell("made", "")


def findings(
    swept: Results, checked: Sequence[Checked], options: Mapping[str, str], start: tuple[str, ...]
) -> Findings:
    """Analyze a sweep of which some runs have been crosschecked."""
    found, analysis = scalars(swept), Analysis(swept.plan.samples, analyzed(swept), swept.inputs)
    effects = [(scalar, analysis.effects(scalar)) for scalar in telling(found)]
    nominal = _nominal(swept.plan, found)
    without = [scalar.label for scalar, each in effects if each and each[0].share is None]
    lost = f"no shares of variance of {', '.join(without)}: too many runs without it" if without else ""
    too_few = analysis.too_few or lost
    return Findings(swept, found, nominal, effects, list(checked), too_few, options, start)


def _nominal(plan: Plan, found: Sequence[Scalar]) -> dict[str, float]:
    own = own_values(plan.scene, plan.samples.names)
    values = run_all(plan, {name: value.reshape(1) for name, value in own.items()}).values
    return {each.label: float(values[each.variable][0][each.place]) for each in found}


def report(found: Findings) -> Report:
    """Make the tables of a sweep, and their short forms for the terminal."""
    swept, samples = found.swept, found.swept.plan.samples
    of_runs = "1 run" if samples.runs == 1 else f"{samples.runs:,} runs"
    title = f"{swept.plan.scene.name}: {of_runs}, {samples.sampling}, seed {samples.seed}"
    if swept.made:
        title += f"; {swept.made:,} made at {swept.made / swept.wall_time:,.0f} per s"
    if swept.made < samples.runs:
        title += f"; {samples.runs - swept.made:,} were there"
    of_runs, notes, failed = "", [*swept.repaired[:MOST_REASONS]], _failures(found)
    if (more := len(swept.repaired) - MOST_REASONS) > 0:
        notes.append(f"{more} more files were damaged and their runs made again; -v prints all")
    if (count := len(analyzed(swept))) < samples.runs:
        of_runs = f"of {count:,} runs from all parts of the sweep"
        notes.append(f"quantiles and extremes are {of_runs}")
    for each in swept.plan.kept:
        size = int(np.prod(swept.dataset[each.name].shape[1:]))
        if (count := sum(scalar.variable == each.name for scalar in found.scalars)) < size:
            notes.append(f"{each.name}: {count} of its {size:,} numbers of a run are analyzed, evenly spread")
    parts: list[Part] = [_quantiles(found, found.scalars, f"quantiles {of_runs}".rstrip())]
    parts += [_effects(*each, None) for each in found.effects if each[1]]
    parts += [Lines("", [found.too_few])] if found.too_few else []
    parts += _checks(found.checked) if found.checked else []
    parts.append(_varied(swept.plan))
    far, gaps = _far(swept.plan), _gaps(found)
    parts += [Lines("", list(lines)) for lines in (swept.repaired, found.notes, far, gaps) if lines]
    if failed:
        parts.append(Lines("runs that could not go on", failed))
    varying = [scalar for scalar in found.scalars if scalar.varies]
    if not varying:
        varying = found.scalars
        if len(swept.stopped) < samples.runs:
            notes.append("what varies has no effect on what is kept")
    first = most_varying(varying)[:MOST_ROWS]
    if any(_digits(each) > WIDE for each in first):
        first = first[:MOST_WIDE_ROWS]
    rows = sorted(first, key=found.scalars.index)
    summary: list[Part] = [_quantiles(found, rows, "")]
    summary += [_effects(*each, MOST_BARS) for each in found.effects[:MOST_CHARTS] if each[1]]
    notes += [
        *found.notes,
        *far[:MOST_REASONS],
        *gaps[:MOST_REASONS],
        *filter(None, [found.too_few]),
        *_not_shown(found, rows),
        *failed[:MOST_REASONS],
    ]
    if len(failed) > MOST_REASONS:
        notes.append(f"{len(failed) - MOST_REASONS} more reasons why runs could not go on; -v prints all")
    summary.append(Lines("", notes))
    return Report(title, found.verdict, found.judged, parts, swept.wall_time, summary)


def _not_shown(found: Findings, rows: Sequence[Scalar]) -> list[str]:
    """Word what the terminal leaves out, and where it is."""
    counts = {
        "numbers that do not vary": sum(not each.varies and each not in rows for each in found.scalars),
        "numbers that vary less": sum(each.varies and each not in rows for each in found.scalars),
        "charts of what matters": len(found.effects) - MOST_CHARTS,
    }
    said = [f"{what}: {count}" for what, count in counts.items() if count > 0]
    return [f"not shown, -v prints all: {'; '.join(said)}"] if said else []


def _failures(found: Findings) -> list[str]:
    """Word each reason why runs could not go on: how many, the first in full, and what may help."""
    counts, firsts = Counter[str](), dict[str, tuple[int, str]]()
    for run, reason in found.swept.reasons():
        kind = NUMBER.sub("#", reason)
        counts[kind] += 1
        firsts.setdefault(kind, (run, reason))
    lines = []
    for kind, count in counts.most_common():
        run, reason = firsts[kind]
        which = f"run {run}" if count == 1 else f"{count} runs could not go on, as run {run}"
        lines.append(f"{which}: {reason}{_hint(found.swept.plan, reason)}")
    return lines


def _hint(plan: Plan, reason: str) -> str:
    """Name the distribution that keeps a normal number from values that make no sense."""
    for (name, *_), each in plan.samples.groups:
        if isinstance(each, Distribution) and each.kind == "normal" and f"{name!r}" in reason:
            mean, deviation = each.numbers
            return f"; {name}=truncated_normal({mean:g}, {deviation:g}, LOW, HIGH) stays within bounds"
    return ""


def _quantiles(found: Findings, rows: Sequence[Scalar], title: str) -> Table:
    wanted = slice(None if title else 1, None)
    columns = [Column("of each run"), *figures("nominal", *list(LEVELS)[wanted])]
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
    """Word a number of a run; a dash where there is none, as of an event that does not happen."""
    return f"{value:.{digits}g}" if np.isfinite(value) else "-"


def _digits(scalar: Scalar) -> int:
    """Return the digits in which the quantiles of a number differ."""
    if not scalar.varies:
        return LEAST_DIGITS
    hidden = int(np.ceil(np.log10(np.max(np.abs(scalar.quantiles)) / scalar.deviation)))
    return int(np.clip(hidden + 2, LEAST_DIGITS, MOST_DIGITS))


def _effects(scalar: Scalar, found: Sequence[Effect], most: int | None) -> Table:
    """Make the tornado chart: what matters for a number, the largest first."""
    rows: Rows = []
    for effect in found[:most]:
        bar = "=" * round(BAR * min(1.0, effect.size))
        shares = [] if effect.share is None else [share_of(effect)]
        rows.append([effect.name, *shares, rank_of(effect), bar])
    if len(found) > len(rows):
        rows.append([f"{len(found) - len(rows)} more with less: -v"])
    heads = ["share of variance"] if found and found[0].share is not None else []
    columns = [Column(f"{scalar.label} by"), *figures(*heads, "rank"), Column("")]
    return Table("" if most else f"what matters for {scalar.label}", columns, rows)


def _checks(checked: Sequence[Checked]) -> list[Part]:
    """Make the tables of runs that were cross-checked, and the verdicts of those that are not in order."""
    rows: Rows = []
    kept: Rows = []
    for each in checked:
        verdict = Cell("differ", "fails") if each.differs else Cell("agree", "holds")
        rows.append([str(each.run), each.why, verdict if each.complete else Cell("not all", "doubtful")])
        kept.append(f"run {each.run}")
        for figure in each.kept:
            unsettled = "finer runs differ by more" if figure.unsettled else "not judged"
            apart = judged(figure.value, figure.tolerance, figure.agrees)
            if figure.informs:
                apart = Cell(f"{figure.value:.1e}, {figure.detail or unsettled}")
            kept.append([figure.quantity, figure.between[0], apart])
    columns = [*figures("run"), *texts("chosen", "engines")]
    beside = [*texts("kept number", "engine"), *figures("difference")]
    parts: list[Part] = [Table("runs that were cross-checked", columns, rows, folded=True)]
    parts.append(Table("kept numbers of these, each variable's nearest its limit", beside, kept, folded=True))
    wrong = [f"run {each.run}: {each.verdict}" for each in checked if not (each.agrees and each.complete)]
    return [*parts, Lines("", wrong)] if wrong else parts


def _varied(plan: Plan) -> Table:
    own = own_values(plan.scene, plan.samples.names)
    units = units_of(plan.scene, plan.samples.names)
    rows: Rows = []
    for names, distribution in plan.samples.groups:
        nominal = ", ".join(f"{own[name] + 0.0:.6g}" for name in names)
        rows.append([", ".join(names), units[names[0]], nominal, str(distribution)])
    return Table("what varies", texts("parameter", "unit", "nominal", "distribution"), rows, folded=True)


def _far(plan: Plan) -> list[str]:
    """Word which values of the scene lie far from what is drawn for them: of a slip of units, perhaps."""
    own = own_values(plan.scene, plan.samples.names)
    initial, lines = initial_numbers(plan.scene, plan.samples.names), []
    starting = origins(plan.scene, [name for name in plan.samples.names if name not in initial])
    for names, given in plan.samples.groups:
        of_each = (given,) if isinstance(given, Distribution) else given.distributions
        for name, each in zip(names, of_each, strict=True):
            away = each.deviations_of(float(own[name]))
            if away > FAR:
                value = f"{own[name] + 0.0:.4g}"
                if name in starting:
                    value += f", an offset from {starting[name] + 0.0:.4g}"
                lines.append(f"nominal {name}, {value}, is {away:.2g} deviations from the mean of {each}")
    return lines


def _gaps(found: Findings) -> list[str]:
    """Word of how many runs numbers are known, and of how many base samples of Saltelli's plan."""
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
    """Write the findings beside the Zarr store: JSON, pictures and a recording, all of them or none.

    Raises:
        CrosscheckError: naming the path that cannot be written.
    """
    from crosscheck.recording.log import recorded
    from crosscheck.recording.sweep import log_sweep

    paths = [folder / name for name in FILES]
    check_writable(*paths)
    runs = analyzed(found.swept)
    points = thinned(len(runs), MOST_POINTS)
    inputs, plan = found.swept.inputs(runs[points]), found.swept.plan
    units = units_of(plan.scene, plan.samples.names)
    drawn = pictures(found.effects, points, inputs, units, found.nominal)
    files = {folder / name: content for name, content in drawn.items()}
    to_show = to_record(found, made)
    if to_show[1]:
        files[folder / FILES[1]] = recorded(log_sweep, *to_show)
    whole = {folder / FILES[0]: as_json(_data(found), made, files), **files}
    write_files(whole, [path for path in paths if path not in whole])
    return list(whole)


def to_record(found: Findings, made: Report) -> tuple[Any, ...]:
    """Return the arguments of `crosscheck.recording.sweep.log_sweep`."""
    text = markdown(replace(made, parts=made.summary))
    return found.swept.plan.scene, *_made_again(found), text, made.title


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
            each.label: dict(zip(map("{:g}".format, LEVELS.values()), each.quantiles.tolist(), strict=True))
            for each in found.scalars
        },
        "effects": {scalar.label: [asdict(each) for each in effects] for scalar, effects in found.effects},
        "checked": [asdict(each) for each in found.checked],
        "notes": found.notes,
    }


def _made_again(found: Findings) -> tuple[dict[str, Trajectory], list[Envelope]]:
    """Make the nominal run, extreme ones and a sample again, as the sweep made them, at all output times.

    Returns:
        The nominal run and the extreme ones by name, without any that cannot go on; and the course of telling
        numbers over time of all that were made.
    """
    from crosscheck.recording.sweep import Envelope

    plan = found.swept.plan
    extremes = list(
        dict.fromkeys(scalar.extreme(largest) for scalar, _ in found.effects for largest in (True, False))
    )[:MOST_GHOSTS]
    named = ["nominal", *(f"run {run}" for run in extremes)]
    own = own_values(plan.scene, plan.samples.names)
    inputs = found.swept.inputs(np.array([*extremes, *thinned(plan.samples.runs, SAMPLE)]))
    values = {name: np.append(own[name], of_runs) for name, of_runs in inputs.items()}
    scene = replace(plan.lean, output_period=plan.scene.output_period)
    kept = {each.name: each for each in plan.kept}
    runs: dict[str, Trajectory] = {}
    parts: list[list[Array]] = []
    size = max(len(named), plan.together(scene))
    for first in range(0, len(next(iter(values.values()))), size):
        part = {name: of_runs[first : first + size] for name, of_runs in values.items()}
        batch = plan.batch(part, scene, threads=None)
        if not first:
            runs = {name: batch[k] for k, name in enumerate(named) if k not in batch.errors}
        outputs = Outputs.of_batch(plan.scene, batch)
        # copies, for views of a batch would hold all of it
        parts.append([kept[each.variable].line(outputs, each.place).copy() for each, _ in found.effects])
    envelopes = []
    for k, (scalar, _) in enumerate(found.effects):
        courses = np.concatenate([part[k] for part in parts])
        lines = {name: course for name, course in zip(named, courses, strict=False) if name in runs}
        envelopes.append(Envelope(scalar.heading, scene.times, courses[len(named) :], lines))
    return runs, envelopes
