"""Cross-check some runs of a sweep, extreme and random ones, in all engines.

A sweep simulates one scene many times with varied parameters. newton_euler executes its runs and stores their
kept outputs: the numbers or arrays that the user asked for. A crosscheck repeats a run in the engines
that the user names, and compares their equations and motions as `crosscheck run` does. It also compares the
kept outputs of each engine's run with the stored ones.

A `Check` is one compared number with its tolerance. A `KeptNumber` is one element of a kept output, with
the output's name as `variable`. A `Reduction` computes a kept output from the time series of a run, for
example as its maximum.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import zip_longest
from typing import Any

import numpy as np

from crosscheck.compare.check import ERROR_PER_CHANGE, Check
from crosscheck.compare.crosscheck import Crosscheck, crosscheck
from crosscheck.compare.run_checks import MAX_REMAINING_ERROR
from crosscheck.engines.engine import MAX_RELATIVE_ERROR, Engine
from crosscheck.engines.newton_euler import EXACT_ATOL, EXACT_RTOL
from crosscheck.engines.registry import SOLVER
from crosscheck.support.errors import CrosscheckError
from crosscheck.support.time_limits import with_progress
from crosscheck.sweeps.expressions import Outputs
from crosscheck.sweeps.kept_numbers import KeptNumber
from crosscheck.sweeps.plan import SweepPlan, run_all
from crosscheck.sweeps.reductions import WHEN, Reduction
from crosscheck.sweeps.results import SweepResults
from newton_euler.equations.undetermined import undetermined_joints
from newton_euler.errors import NearlyRedundantWarning, NewtonEulerError
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.reading.import_report import ImportedElement, ImportReport
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array

RUNS_PER_CROSSCHECK = 1_000
"""Number of runs of a sweep for each run that is cross-checked by default; they take about as long."""

MIN_DEFAULT_COUNT, MAX_DEFAULT_COUNT = 2, 6
"""Smallest and largest default number of runs that are cross-checked."""

CHOSEN_AT_RANDOM = "at random"
"""Reason for checking a run that is not extreme."""

FINER_TOLERANCE_FACTOR = 0.01
"""Factor on the tolerances of a sweep for the repeated run that measures its error."""

SOFT_CONSTRAINTS, NOT_UNIQUE = "soft constraints", "not unique"
"""Reasons why joint reactions are not judged: the engine's constraints are soft, as MuJoCo's are; redundant
constraints leave the reactions undetermined. A check has the reason as its `detail`."""

KEPT_LEVEL = "kept"
"""Level (name of a group of checks) of the checks of kept outputs."""


@dataclass(frozen=True)
class CheckedRun:
    """Crosscheck of one run of a sweep.

    Attributes:
        run: index of the run in the sweep.
        why: reason why the run was chosen.
        complete: True if all engines completed the run, and each is compared with others by judged checks.
        agrees: True if the engines agree with each other, as in `crosscheck run`.
        verdict: verdict line of the crosscheck.
        kept: comparisons of kept outputs with the sweep: for each output and engine, the check closest to
            failing.
        moves: True if the mechanism moves.
        untested: True if the motion tests no element of the scene, for example because it is too small.
        engines: names of the engines.
        acting: elements of the model file that would have acted and were not simulated.
    """

    run: int
    why: str
    complete: bool
    agrees: bool
    verdict: str
    kept: tuple[Check, ...] = ()
    moves: bool = True
    untested: bool = False
    engines: tuple[str, ...] = ()
    acting: tuple[ImportedElement, ...] = ()

    @property
    def differs(self) -> bool:
        """True if engines differ from each other or from the sweep."""
        return not self.agrees or not all(each.agrees for each in self.kept)


def default_count(runs: int) -> int:
    """Return the default number of crosschecks for a sweep of a number of runs."""
    return int(np.clip(runs // RUNS_PER_CROSSCHECK, MIN_DEFAULT_COUNT, MAX_DEFAULT_COUNT))


def chosen(
    swept: SweepResults,
    kept_numbers: Sequence[KeptNumber],
    most_informative: Sequence[KeptNumber],
    count: int,
) -> dict[int, str]:
    """Choose runs to cross-check, extreme and random ones alternately.

    Args:
        swept: the sweep.
        kept_numbers: the kept numbers, all with the same analyzed runs.
        most_informative: the number of each kept output that varies most; its extreme runs are chosen.
        count: largest number of runs to choose.

    Returns:
        The reason for each choice, by index of the run.
    """
    analyzed = kept_numbers[0].runs
    completed = analyzed[~np.isin(analyzed, swept.failed_runs)]
    generator = np.random.default_rng([swept.plan.samples.seed, swept.plan.samples.runs])
    drawn = generator.choice(completed, min(count, len(completed)), replace=False)
    random = [(int(run), CHOSEN_AT_RANDOM) for run in drawn]
    extreme = [
        (scalar.extreme(largest), f"{'largest' if largest else 'smallest'} {scalar.label}")
        for scalar in most_informative
        for largest in (True, False)
    ]
    reasons: dict[int, str] = {}
    for pair in zip_longest(extreme, random):
        for run, why in filter(None, pair):
            if len(reasons) < count:
                reasons.setdefault(run, why)
    return reasons


def check_runs(
    swept: SweepResults,
    kept_numbers: Sequence[KeptNumber],
    runs: Mapping[int, str],
    engines: Sequence[Engine],
    progress: Callable[[str], None],
    mapping: ImportReport | None = None,
) -> list[CheckedRun]:
    """Cross-check runs, and compare their kept outputs.

    Args:
        swept: the sweep.
        kept_numbers: the kept numbers.
        runs: by index of a run, the reason why the run was chosen.
        engines: the engines.
        progress: called with the name of each stage.
        mapping: import report of a model file; None for other scenes.
    """
    # A run has other parameters than the file, so that it is not compared with the file's own model
    unverified = mapping.unverified() if mapping else None
    current = ""

    def start_run(message: str) -> None:
        """Remember the message of the run that is checked, and report it."""
        nonlocal current
        current = message
        progress(message)

    def report_stage(stage: str) -> None:
        """Report a stage of the run that is checked."""
        progress(f"{current}: {stage}")

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NearlyRedundantWarning)  # the sweep has issued the warning
        return [
            _check(swept, kept_numbers, run, why, engines, report_stage, unverified)
            for run, why in with_progress(list(runs.items()), start_run, "cross-check")
        ]


def _check(
    swept: SweepResults,
    kept_numbers: Sequence[KeptNumber],
    run: int,
    why: str,
    engines: Sequence[Engine],
    progress: Callable[[str], None],
    mapping: ImportReport | None,
) -> CheckedRun:
    """Cross-check one run; an error of an engine is part of the result. Arguments as of `check_runs`."""
    names = tuple(each.name for each in engines)
    try:
        scene = swept.plan.scene_of(run)
        result = crosscheck(scene, engines, progress, source="", options={}, mapping=mapping)
        kept = tuple(_check_kept(swept, kept_numbers, run, result, engines))
    except (CrosscheckError, NewtonEulerError) as error:
        return CheckedRun(run, why, complete=False, agrees=True, verdict=str(error), engines=names)
    complete = not (result.left_out or result.unfinished or result.uncompared)
    return CheckedRun(
        run,
        why,
        complete,
        agrees=not result.differs,
        verdict=result.verdict,
        kept=kept,
        moves=not result.nothing_moves,
        untested=result.untested,
        engines=names,
        acting=tuple(result.acting),
    )


def result_line(checked: Sequence[CheckedRun], extremes: Collection[int]) -> str:
    """Report the crosschecks in one line: the first failure, or the engines that agree.

    Args:
        checked: the crosschecks.
        extremes: indices of all extreme runs, including those that were not cross-checked.
    """
    # the number of cross-checked runs, as "4 runs (2 of 6 with extreme outputs, 2 at random)"
    count, random = len(checked), sum(each.why == CHOSEN_AT_RANDOM for each in checked)
    unchecked = len(set(extremes).difference(each.run for each in checked))
    of_extremes = (
        f"{count - random} of {count - random + unchecked} with extreme outputs"
        if unchecked
        else f"{count - random} with extreme outputs"
    )
    kinds = [of_extremes] * (count > random) + [f"{random} at random"] * (random > 0)
    of_runs = f"{count} run{'s'[: count - 1]} ({', '.join(kinds)})"
    # The first failure; runs that differ come before runs that did not complete
    for each in sorted(checked, key=lambda each: not each.differs):
        named = f"run {each.run} ({each.why})"
        if not (each.agrees and each.complete):
            return f"{named}: {each.verdict}; {of_runs} cross-checked"
        wrong = [check for check in each.kept if not check.agrees]
        if wrong:
            return f"{named}: {_difference(max(wrong, key=_tolerance_ratio))}; {of_runs} cross-checked"
    # No failure
    engines = checked[0].engines
    who = f"{engines[0]} passes" if len(engines) == 1 else f"{', '.join(engines)} agree in"
    found = f"{who} all checks of {of_runs}"
    return found if any(each.moves for each in checked) else f"{found}; nothing moves"


def output_lines(checked: Sequence[CheckedRun]) -> Iterator[str]:
    """Yield the check closest to failing among the outputs of cross-checked runs, and what is not judged."""
    kept = [check for each in checked for check in each.kept]
    if judged := [check for check in kept if check.judged]:
        nearest = max(judged, key=_tolerance_ratio)
        yield f"outputs in crosschecks, closest to failing: {_difference(nearest)}"
    soft = sorted({check.between[0] for check in kept if check.detail == SOFT_CONSTRAINTS})
    unconverged = sum(bool(check.unconverged) for check in kept)
    not_judged = [f"reactions of {name} (soft constraints)" for name in soft]
    not_judged += ["reactions that are not unique"] * any(check.detail == NOT_UNIQUE for check in kept)
    not_judged += (
        [f"{unconverged} outputs whose difference a finer run reduces too little"] if unconverged else []
    )
    if not_judged:
        yield f"outputs not judged: {', '.join(not_judged)}"


def _tolerance_ratio(check: Check) -> float:
    """Return value divided by tolerance of a check; infinity for NaN, so that NaN is the largest."""
    return float(np.nan_to_num(check.tolerance_ratio, nan=np.inf))


def _difference(check: Check) -> str:
    """Report the difference of a kept number between an engine and the sweep."""
    name, _, unit = check.quantity.rpartition(", ")
    quantity, unit = (name, f" {unit}") if name else (check.quantity, "")
    compared = f"{check.value:.1e} {'<' if check.agrees else '>'} {check.tolerance:.1e}{unit}"
    return f"{quantity}, {check.between[0]} in {check.where}: {compared}"


def _check_kept(
    swept: SweepResults,
    kept_numbers: Sequence[KeptNumber],
    run: int,
    result: Crosscheck,
    engines: Sequence[Engine],
) -> Iterator[Check]:
    """Compare the kept numbers of a run of the sweep with those of the engines' runs.

    For each kept output and engine the check closest to failing is yielded: one of the judged numbers, and
    one for each reason why numbers are not judged.

    The tolerance is the expected relative error of the engine plus that of newton_euler, times
    `KeptNumber.scale`. If the difference is larger, both runs are repeated at finer tolerances. The changes
    of both runs, times `ERROR_PER_CHANGE` (a bound on error over change), are added to the tolerance. A
    number is not judged in these cases: the tolerance exceeds the fraction `MAX_RELATIVE_ERROR` of the scale;
    the difference does not decrease in finer runs; the number is a reaction of soft or redundant constraints.

    Args:
        swept: the sweep.
        kept_numbers: the kept numbers.
        run: index of the run.
        result: crosscheck of the run, with the trajectories of all engines.
        engines: the engines.
    """
    plan, scene = swept.plan, result.scene
    reductions = {each.name: each for each in plan.kept}
    stored_outputs = {name: swept.read(name, run) for name in reductions}
    not_unique: set[str] = set()  # joints whose reactions redundant constraints leave undetermined
    if any(each.depends_on_reactions for each in plan.kept):
        _, joints = undetermined_joints(scene, initial_state(scene))  # _: number of redundant constraints
        not_unique.update(joints)

    @cache
    def repeated_sweep_run() -> tuple[dict[str, Array], dict[str, Array]]:
        """Return the kept outputs of the run repeated at the sweep's tolerance and at a finer one.

        The stored run is repeated, since an error in the store must not increase its own tolerance.
        """
        integrator_options = plan.control, finer_control(plan.control)
        coarse, fine = (
            run_all(replace(plan, control=each), plan.parameters(run, run + 1)) for each in integrator_options
        )
        return coarse.values, fine.values

    for engine in engines:
        trajectory = result.trajectories.get(engine.name)
        if trajectory is None or len(trajectory.time) < len(scene.times):
            continue  # the engine failed or stopped early
        outputs, kept = kept_of(plan, run, trajectory)
        finer_run = cache(partial(_finer_of, plan, run, engine, scene))
        checks: dict[str, list[Check]] = {}
        # Compare each kept number of the engine's run with that of the sweep's run
        for scalar in kept_numbers:
            reduction, stored = reductions[scalar.variable], stored_outputs[scalar.variable]
            of_sweep, scale = float(stored[scalar.index]), scalar.scale(stored)
            of_engine = float(kept[scalar.variable][scalar.index])
            why_not_judged = ""
            if scalar.depends_on_reactions:
                if engine.soft_constraints is not None:
                    why_not_judged = SOFT_CONSTRAINTS
                if not not_unique.isdisjoint(reduction.reaction_joints(scalar.index)):
                    why_not_judged = NOT_UNIQUE
            fixed = (engine.trajectory_error + SOLVER.trajectory_error) * scale
            is_same = np.array_equal(of_engine, of_sweep, equal_nan=True)
            difference = 0.0 if is_same else abs(of_engine - of_sweep)
            tolerance, unconverged = fixed, ""
            if difference > fixed and not why_not_judged:
                # Repeat both runs at finer tolerances, and add the changes of the number
                finer_outputs, finer_kept = finer_run()
                fine_of_engine = finer_kept[scalar.variable][scalar.index]
                repeated_of_sweep, fine_of_sweep = (  # [0]: both have a single run
                    each[scalar.variable][0][scalar.index] for each in repeated_sweep_run()
                )
                change = max(
                    abs(of_engine - fine_of_engine), _change(reduction, scalar, outputs, finer_outputs)
                )
                tolerance += ERROR_PER_CHANGE * float(change + abs(repeated_of_sweep - fine_of_sweep))
                # a converged difference decreases to at most this fraction of the difference or change
                largest = max(MAX_REMAINING_ERROR * max(difference, change), fixed)
                decreases = abs(fine_of_engine - fine_of_sweep) <= largest
                if tolerance > MAX_RELATIVE_ERROR * scale or (difference <= tolerance and not decreases):
                    unconverged = engine.name
            checks.setdefault(scalar.variable, []).append(
                Check(
                    KEPT_LEVEL,
                    scalar.heading,
                    (engine.name, "sweep"),
                    difference,
                    tolerance,
                    f"run {run}",
                    judged=not (why_not_judged or unconverged),
                    unconverged=unconverged,
                    detail=why_not_judged,
                )
            )
        # Yield the check closest to failing of each variable and reason
        for of_variable in checks.values():
            for kind in sorted({(not each.judged, each.detail) for each in of_variable}):
                alike = [each for each in of_variable if (not each.judged, each.detail) == kind]
                yield from sorted(alike, key=_tolerance_ratio)[-1:]


def finer_control(control: Mapping[str, Any]) -> dict[str, Any]:
    """Return integrator options with a hundredth of the tolerances, or half the step.

    Tolerances do not fall below `EXACT_RTOL` and `EXACT_ATOL`, where round-off dominates.
    """
    finer = dict(control)
    for name, least in (("rtol", EXACT_RTOL), ("atol", EXACT_ATOL)):
        if name in control:
            finer[name] = max(FINER_TOLERANCE_FACTOR * control[name], least)
    if control.get("step"):
        finer["step"] = 0.5 * control["step"]
    return finer


def _change(reduction: Reduction, scalar: KeptNumber, coarse: Outputs, fine: Outputs) -> float:
    """Return the largest change, in a finer run, of the time series from which a kept number is computed.

    The change of the number itself can be smaller than its error by chance. For times of events (`WHEN`) the
    result is 0, since their time series has another unit.
    """
    if reduction.kind == WHEN:
        return 0.0
    coarse_series, fine_series = (reduction.time_series_of(each, scalar.index) for each in (coarse, fine))
    return float(np.abs(coarse_series - fine_series).max())


KeptOutputs = tuple[Outputs, dict[str, Array]]
"""Outputs of a run, and its kept outputs by name."""


def _finer_of(plan: SweepPlan, run: int, engine: Engine, scene: Scene) -> KeptOutputs:
    """Repeat a run in an engine with finer steps or tolerances; return its outputs and kept outputs.

    `refined_in_full` also computes reactions and actuator forces, which `refined` may omit.
    """
    return kept_of(plan, run, (engine.refined_in_full or engine.refined)(scene))


def kept_of(plan: SweepPlan, run: int, trajectory: Trajectory) -> KeptOutputs:
    """Return the outputs of a run of any engine, and the kept outputs.

    Args:
        plan: plan of the sweep.
        run: index of the run.
        trajectory: motion of the run in the engine.
    """
    # the sweep measures joint coordinates from the initial pose of its scene, not from that of the run
    outputs = Outputs.of(plan.scene, replace(trajectory, mechanism=plan.mechanism_of(run)))
    return outputs, {each.name: each.of(outputs)[0] for each in plan.kept}  # [0]: a single run
