"""Findings of a sweep: its analysis, crosschecks of some of its runs, and the verdict.

A sweep simulates a scene many times with varied parameters and keeps some numbers of each run. The findings
are the quantiles of these numbers, the effects of the parameters on them, and crosschecks: repetitions of
some runs in all engines.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from crosscheck.compare.activity import MAX_NAMED, what_acted
from crosscheck.compare.outcome import Outcome
from crosscheck.engines.registry import SOLVER
from crosscheck.report.run import undetermined_lines
from crosscheck.report.table import Cell
from crosscheck.support.name_lists import first_names
from crosscheck.sweeps.analysis import Analysis, Effect
from crosscheck.sweeps.checks import CheckedRun, output_lines, result_line
from crosscheck.sweeps.kept_numbers import KeptNumber, analyzed, kept_numbers, most_informative
from crosscheck.sweeps.plan import SweepPlan, run_all
from crosscheck.sweeps.results import SweepResults
from newton_euler.runs.variation import own_values


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
        """One line: how many runs completed, and whether the engines agree on the checked runs."""
        runs, failed = self.swept.plan.samples.runs, len(self.swept.failed_runs)
        completed = f"{runs - failed:,} of {runs:,} run{'s' * (runs != 1)} completed"
        text = f"{completed}; none was cross-checked"
        if self.checked:
            extremes = {scalar.extreme(largest) for scalar, _ in self.effects for largest in (True, False)}
            of_checks = result_line(self.checked, extremes)
            # a failure of a crosscheck comes first
            failed_checks = any(each.differs or not each.complete for each in self.checked)
            text = f"{of_checks}; {completed}" if failed_checks else f"{completed}; {of_checks}"
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
        if all(each.engines == (SOLVER.name,) for each in self.checked):
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
        runs = sum(bool(each.acting) for each in self.checked)
        return f"not simulated: {first_names(names, MAX_NAMED)}, in {runs} of {len(self.checked)} runs"

    @cached_property
    def notes(self) -> list[str]:
        """Lines of `start`, on outputs in crosschecks, and, if a kept number depends on reactions, on joint
        reactions that are not unique because of redundant constraints."""
        depends_on_reactions = any(each.depends_on_reactions for each in self.scalars)
        not_unique = undetermined_lines(self.swept.plan.scene) if depends_on_reactions else ()
        return [*self.start, *output_lines(self.checked), *not_unique]

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
        too_few = f"no Sobol indices of {', '.join(without_shares)}: too many runs without it"
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
