"""Bar charts of a crosscheck, and what its reader can do, for the page of `crosscheck report`.

A crosscheck simulates one model in several engines (simulators) and compares them. In: the result. Out:
charts of the checks and of the run times, and sentences on the next steps, the most urgent one first.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterator

from crosscheck.compare.check import LEVELS, REFERENCE
from crosscheck.compare.outcome import Outcome, Verdict
from crosscheck.compare.result import EngineComparison
from crosscheck.own_run.errors import Band
from crosscheck.report.chart import BarChart, Measure, linear_chart, log_chart
from crosscheck.report.explain import names_to_explain
from crosscheck.report.own_run import fix_texts, headline, without_text
from crosscheck.report.summary import judged_checks, nearest
from crosscheck.report.table import seconds
from crosscheck.support.name_lists import first_names

MIN_SHOWN_PERCENT = 0.1
"""Smallest value of a check that has a longer bar than others, percent of its tolerance."""

MAX_NAMED = 3
"""Largest number of elements that a sentence names."""


def charts(result: EngineComparison) -> list[BarChart]:
    """Make the chart of the checks closest to failing, and that of the engines' run times."""
    checks = judged_checks(result)
    measures = []
    for level in (*LEVELS, REFERENCE):
        at_level = [check for check in checks if check.level == level]
        if at_level:
            percent = 100.0 * max(check.tolerance_ratio for check in at_level)
            fails = any(not check.agrees for check in at_level)
            number, unit, *place = nearest(at_level).text.split()  # such as "12", "%", "rocker,", "0.5", "s"
            label = f"{level}: {' '.join(place)}" if fails else level
            verdict: Verdict = "fails" if fails else "holds"
            measures.append(
                Measure(label, max(percent, MIN_SHOWN_PERCENT), f"{number} {unit}", 100.0, verdict)
            )
    caption = "Check closest to failing at each level, in % of its tolerance; the mark is the tolerance"
    found = log_chart("Checks", caption, measures, "%")
    errors = result.run_errors
    times = [
        Measure(
            name,
            run.wall_time,
            seconds(run.wall_time) + (f", error {errors[name]:.0e}" if name in errors else ""),
        )
        for name, run in result.trajectories.items()
    ]
    caption = "Run time of each engine with the settings of this comparison, and its largest error, m or rad"
    return found + linear_chart("Run time", caption, times)


def next_steps(result: EngineComparison) -> list[str]:
    """List what the reader can do, the most urgent step first."""
    steps = [*_log_steps(result), *_steps_of_outcome(result)]
    steps += [*_settings_steps(result), *_coverage_steps(result)]
    steps += [f"Change the constraints, {advice}." for advice in result.advice]
    if commands := ", ".join(f"`crosscheck explain {name}`" for name in names_to_explain(result)):
        steps.append(f"To learn what the result means, run {commands}.")
    return steps


def _steps_of_outcome(result: EngineComparison) -> Iterator[str]:
    """Yield the steps that the outcome requires."""
    model = shlex.quote(result.source) if result.source else "MODEL"
    match result.outcome:
        case Outcome.AGREE:
            if result.mapping:
                command = f"crosscheck regress {model} --update REASON"
                yield f"To detect later changes, store the result as a baseline: `{command}`."
            elif result.source:
                yield f"To compare the speed of the engines at equal errors, run `crosscheck bench {model}`."
        case Outcome.DISAGREE:
            for each in result.diagnosis:
                who = f"{each.outlier}: " if each.outlier else ""
                fault = f"; {each.fault_text}" if each.fault_text else ""
                yield f"Correct first {who}{each.quantity}, worst at {each.where}{fault}."
            yield "The details list all failing checks; those of later levels are often consequences."
        case Outcome.UNFINISHED:
            for stop in result.unfinished[:MAX_NAMED]:
                yield f"Remove the cause that stopped {stop.what}: {stop.reason}."
            yield "Results before the stop are compared below. A shorter run is `--set duration=SECONDS`."
        case Outcome.INACCURATE:
            yield f"Choose more accurate settings: `crosscheck tune {model}` searches the cheapest ones."
        case Outcome.AGREE_ON_A_REDUCED_MODEL:
            names = first_names([entry.element for entry in result.acting], MAX_NAMED)
            yield (
                f"Do not use the result for motions in which these act: {names}. They are in the file, and "
                "crosscheck does not simulate them."
            )
            yield "Choose a start or inputs with which they do not act, or accept them: `--allow-reduced`."
        case Outcome.AGREE_AT_RANDOM_STATES_ONLY:
            yield (
                "Give the model a motion that tests its elements: another start, inputs, or for a model file "
                "`--set excitation=on`."
            )
        case Outcome.AGREE_OF_SOME_ENGINES | Outcome.NOT_COMPARED:
            for name, why in result.left_out.items():
                yield f"Leave out {name} with `--engines`, or change what {name} cannot represent: {why}."
        case Outcome.ONE_ENGINE_ALONE:
            yield "Name at least two engines with `--engines`; one engine alone is not compared with others."
        case _:
            raise ValueError(f"{result.outcome} is no outcome of a crosscheck")


def _log_steps(result: EngineComparison) -> Iterator[str]:
    """Yield steps on each log whose error is not small: a likely mistake, or what to look for."""
    for name, log in result.logs.items():
        if log.band not in (Band.OFF, Band.WRONG):
            continue
        yield f"Find the error of the log {name}: {headline(log)}."
        if log.mistakes:
            yield f"Its likely mistake: {log.mistakes[0].text}."
            continue
        if result.own_run and result.own_run.needs:
            needs = "; ".join(each.remedy for each in result.own_run.needs)
            yield f"If you wrote the loop of {name}, check that it has all parts of the file: {needs}."
        yield (
            f"Repeat the run of {name} with half the time step. If the error stays, a part of the model or "
            "an input differs, or a column has another meaning. If the error falls, keep reducing the step."
        )


def _settings_steps(result: EngineComparison) -> Iterator[str]:
    """Yield the first remedy for the error of the file's own settings."""
    own_run = result.own_run
    if own_run and own_run.are_assumed:
        if not result.logs and own_run.is_judged:
            yield (
                "The judged settings are those of usual examples, not yours. Give yours by "
                "`--set own_run=FILE`, or pass a run of your own by `--log`."
            )
    elif own_run and (fixes := fix_texts(own_run.analyzed)):
        reduced = "" if own_run.analyzed is own_run else f" ({without_text(own_run)})"
        yield f"To reduce the error of your settings{reduced}, change them: {fixes[0]}."


def _coverage_steps(result: EngineComparison) -> Iterator[str]:
    """Yield a step on elements that the motion does not test, unless it tests none."""
    untested = result.coverage.untested if result.coverage else ()
    names = [each.element for each in untested if not each.shared]
    if result.coverage and result.coverage.is_prescribed:
        yield "All poses are prescribed, and masses change only forces: see `crosscheck loads`."
    elif names and not result.untested:
        listed = first_names(names, MAX_NAMED)
        yield f"To test {listed}, choose a motion that depends on them; this one does not."
