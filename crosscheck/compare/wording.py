"""Verdicts of crosschecks in words: agreement, or the outlier with the first failing check.

In: the result of a comparison of engines on one scene. Out: one line of text, which begins with the outcome,
such as AGREE or DISAGREE.
"""

from __future__ import annotations

from dataclasses import replace

from crosscheck.compare.activity import reduced_model_text
from crosscheck.compare.check import not_judged
from crosscheck.compare.outcome import Outcome
from crosscheck.compare.participation import missing_levels
from crosscheck.compare.result import EngineComparison
from crosscheck.engines.engine_runs import stops_text
from crosscheck.own_run.allowed import exceeded_text


def verdict_of(result: EngineComparison) -> str:
    """Format the verdict in one line: agreement, or the outlier with the first failing check; then the
    engines and parts of the comparison that are missing."""
    if result.outcome is Outcome.INACCURATE:
        # a run exceeds errors that the user allows: append the verdict without it
        verdict_of_engines = verdict_of(replace(result, allowed_errors=()))
        texts = [
            exceeded_text(name, result.limited_runs[name], exceeded)
            for name, exceeded in result.exceeded.items()
        ]
        return f"{Outcome.INACCURATE}: {'; '.join(texts)}; {verdict_of_engines}"
    word, text = _judgment(result)
    if result.uncompared and not (result.differs or result.unfinished):
        text += f"; no judged check compares {' or '.join(result.uncompared)} with another engine"
    for name, reason in result.left_out.items():
        text += f"; {name} left out: {reason}"
    if result.left_out:
        names = ",".join(engine.name for engine in result.engines)
        text += f"; to do without, name the others (--engines {names})"
    if result.unfinished:
        stopped = {stop.what for stop in result.unfinished}
        completed = [name for name in result.trajectories if name not in stopped]
        others = ""
        # a diagnosis, which follows if engines differ, names the compared engines
        if 0 < len(completed) < len(result.engines) and not result.diagnosis:
            others = f"; {' and '.join(completed)} ran to the end"
        missing = missing_levels(result.checks)
        levels = f"; no checks of {', '.join(missing)}" if missing else ""
        return f"{result.outcome}: {stops_text(result.unfinished)}{others}; as far as compared {text}{levels}"
    return f"{word}: {text}"


def _judgment(result: EngineComparison) -> tuple[str, str]:
    """Format outcome and text of the verdict, without left-out engines and stopped parts.

    The outcome is not used if parts stopped: it is UNFINISHED then.
    """
    names = ", ".join(engine.name for engine in result.engines)
    # A single engine, or several that are not compared with each other
    if result.left_out and result.single_engine:
        text = f"nothing could be compared on {result.title}, ran {names} alone; its own checks"
        return result.outcome, f"{text} {_own_checks(result)}"
    if result.outcome is Outcome.NOT_COMPARED:
        text = f"nothing could be compared on {result.title}, ran {names}; their own checks"
        return result.outcome, f"{text} {_own_checks(result)}"
    if result.single_engine:
        text = f"ran {names} on {result.title}: nothing to compare it with; its own checks"
        text += f" {_own_checks(result)}"
        return result.outcome, "; ".join(filter(None, [text, _reduced_model_text(result)]))
    # Engines that differ
    if result.diagnosis:
        first, *others = result.diagnosis
        parts = [f"{first.who}; {first.place}", first.fault_text]
        parts += [f"then {other.who}, {other.place}" for other in others]
        # not if the import of the model file is wrong
        if _reduced_model_text(result) and not result.misread:
            parts.append(_reduced_model_text(result))
        text = "; ".join(filter(None, parts))
        return f"{Outcome.DISAGREE}{_engine_count(result)}", f"{text} ({_failed_checks(result)})"
    # Engines that agree
    if not result.unfinished:
        names = ", ".join(name for name in result.participation if name not in result.uncompared)
    count = f"{len(result.judged)} checks{_partial_participation(result)}"
    agree = f"{names} agree on {result.title} in all {count}{_qualifications(result)}"
    if _reduced_model_text(result):
        agree = f"{_reduced_model_text(result)}; {agree}"
    if result.outcome is Outcome.AGREE_OF_SOME_ENGINES:
        return f"AGREE{_engine_count(result)}", agree
    return result.outcome, agree


def _partial_participation(result: EngineComparison) -> str:
    """Format how many checks compare an engine with others, for each engine that has no part in some levels.

    Such an engine has no equations of motion, or stopped before its first output.
    """
    partial = {name: part for name, part in result.participation.items() if part.no_part_in}
    parts = [
        f"{part.with_engines} compare {name} with another engine "
        f"({name} has no part in {', '.join(part.no_part_in)})"
        for name, part in partial.items()
    ]
    return f", of which {' and '.join(parts)}" if parts else ""


def _own_checks(result: EngineComparison) -> str:
    """Format whether the checks of a single engine pass, such as its energy balance at the level "energy"."""
    failed = next((check for check in result.checks if not check.agrees), None)
    if failed is None:
        return f"hold, all {len(result.judged)}{_qualifications(result)}"
    return (
        f"fail at level '{failed.level}': {failed.quantity}: {failed.value:.3g} > "
        f"{failed.tolerance:.3g}, worst at {failed.where} ({_failed_checks(result)})"
    )


def _qualifications(result: EngineComparison) -> str:
    """Format qualifications of an agreement: reference values, checks that are not judged, coverage (the
    elements that the motion tests), and elements of the file that are not simulated."""
    text = f", and the reference in all {len(result.reference_checks)}" if result.reference_checks else ""
    text += not_judged(result.checks)
    text += "; nothing moves" if result.nothing_moves else ""
    if result.coverage:
        text += f"; {result.coverage}"
    elif len(result.engines) > 1:
        text += "; what the motion covers is not known"
    # The import report (`mapping`) of a model file compares the scene with models that the file's own engine
    # compiles. A model is informative if motions at some state are accurate enough to show import mistakes
    compiled_models = result.mapping.references if result.mapping else []
    if compiled_models and not any(model.is_informative for model, _ in compiled_models):
        text += "; motions are not verified against the file: too inaccurate at every tested state"
    # limits, contacts and actuators can act, cameras cannot. Counted are elements that can act and are not
    # simulated, such as "2 elements are inactive, 1 left out"
    if result.mapping and (counts := result.mapping.counts()):
        text += f"; of the file, {counts}"
    return text


def _failed_checks(result: EngineComparison) -> str:
    """Format the number of failing checks, or of failing reference values if all checks pass."""
    failed = sum(not check.agrees for check in result.checks)
    if failed:
        return f"{failed} of {len(result.judged)} checks fail"
    failed_references = sum(not check.agrees for check in result.reference_checks)
    return f"{failed_references} of {len(result.reference_checks)} reference values fail"


def _engine_count(result: EngineComparison) -> str:
    """Format the number of compared engines; empty if no engine is left out or not compared."""
    count = len(result.engines) - len(result.uncompared)
    requested = len(result.engines) + len(result.left_out)
    return f" ({count} of {requested} engines)" if result.left_out or result.uncompared else ""


def _reduced_model_text(result: EngineComparison) -> str:
    """Format the elements that act and are not simulated, with the time of the first; empty if none act."""
    if result.acting:  # in the compared motion
        return reduced_model_text(result.acting)
    if not result.is_reduced:
        return ""
    # in a log whose errors are limited
    name, first = next((name, run.events[0]) for name, run in result.limited_runs.items() if run.events)
    return f"the log {name} is judged without {first.element}, active from {first.time:.4g} s on"
