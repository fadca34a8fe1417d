"""Verdicts of crosschecks in words: agreement, or the outlier with the first failing check."""

from __future__ import annotations

from dataclasses import replace

from crosscheck.compare.activity import reduction
from crosscheck.compare.check import not_judged
from crosscheck.compare.outcome import Outcome
from crosscheck.compare.result import ComparisonResult
from crosscheck.engines.engine_runs import stops_text
from crosscheck.own_run.allowed import exceeded_text


def verdict_of(result: ComparisonResult) -> str:
    """Verdict in one line: agreement, or the outlier with the first failing check; and failures."""
    if result.outcome is Outcome.INACCURATE and result.own_run:
        others = verdict_of(replace(result, allowed_errors=()))
        return f"{Outcome.INACCURATE}: {exceeded_text(result.own_run, result.exceeded)}; {others}"
    word, text = _judgment(result)
    for name, reason in result.left_out.items():
        text += f"; {name} left out: {reason}"
    if result.left_out:
        names = ",".join(engine.name for engine in result.engines)
        text += f"; to do without, name the others (--engines {names})"
    if result.unfinished:
        stopped = {stop.what for stop in result.unfinished}
        completed = [name for name in result.trajectories if name not in stopped]
        others = ""
        if 0 < len(completed) < len(result.engines) and not result.diagnosis:
            others = f"; {' and '.join(completed)} ran to the end"
        return f"{result.outcome}: {stops_text(result.unfinished)}{others}; as far as compared {text}"
    return f"{word}: {text}"


def _judgment(result: ComparisonResult) -> tuple[str, str]:
    """Outcome and text of the verdict, without left-out engines and stopped parts."""
    names = ", ".join(engine.name for engine in result.engines)
    # A single engine
    if result.left_out and result.single_engine:
        text = f"nothing could be compared on {result.title}, ran {names} alone; its own checks"
        return result.outcome, f"{text} {_own_checks(result)}"
    if result.single_engine:
        text = f"ran {names} on {result.title}: nothing to compare it with; its own checks"
        text += f" {_own_checks(result)}"
        return result.outcome, "; ".join(filter(None, [text, _reduction(result)]))
    # Engines that differ
    if result.diagnosis:
        first, *others = result.diagnosis
        parts = [f"{first.who}; {first.place}", first.fault_text]
        parts += [f"then {other.who}, {other.place}" for other in others]
        if _reduction(result) and not result.misread:
            parts.append(_reduction(result))
        text = "; ".join(filter(None, parts))
        return f"{Outcome.DISAGREE}{_engine_count(result)}", f"{text} ({_failed_checks(result)})"
    # Engines that agree
    agree = f"{names} agree on {result.title} in all {len(result.judged)} checks{_qualifications(result)}"
    if _reduction(result):
        agree = f"{_reduction(result)}; {agree}"
    some = result.outcome in (Outcome.AGREE_OF_SOME_ENGINES, Outcome.UNFINISHED)
    return f"AGREE{_engine_count(result)}" if some else result.outcome, agree


def _own_checks(result: ComparisonResult) -> str:
    """Text on the checks of a single engine."""
    failed = next((row for row in result.checks if not row.agrees), None)
    if failed is None:
        return f"hold, all {len(result.judged)}{_qualifications(result)}"
    return (
        f"fail at level '{failed.level}': {failed.quantity}: {failed.value:.3g} > "
        f"{failed.tolerance:.3g}, worst at {failed.where} ({_failed_checks(result)})"
    )


def _qualifications(result: ComparisonResult) -> str:
    """Qualifications of an agreement: reference values, checks that are not judged, coverage."""
    text = f", and the reference in all {len(result.measured)}" if result.measured else ""
    text += not_judged(result.checks)
    text += "; nothing moves" if result.nothing_moves else ""
    if result.coverage:
        text += f"; {result.coverage}"
    elif len(result.engines) > 1:
        text += "; what the motion covers is not known"
    references = result.mapping.references if result.mapping else []
    if references and not any(reference.is_informative for reference, _ in references):
        text += "; motions are not verified against the file: no state tells them"
    if result.mapping and (counts := result.mapping.counts()):
        text += f"; of what can act in the file {counts}"
    return text


def _failed_checks(result: ComparisonResult) -> str:
    """Number of failing checks, or else of failing reference values, as text."""
    failed = sum(not row.agrees for row in result.checks)
    if failed:
        return f"{failed} of {len(result.judged)} checks fail"
    failed_references = sum(not measured.agrees for measured in result.measured)
    return f"{failed_references} of {len(result.measured)} reference values fail"


def _engine_count(result: ComparisonResult) -> str:
    """Number of compared engines as text, if some engines are left out."""
    count = len(result.engines)
    return f" ({count} of {count + len(result.left_out)} engines)" if result.left_out else ""


def _reduction(result: ComparisonResult) -> str:
    """Text on the elements that act and are not simulated, with the time of the first; may be empty."""
    if result.acting:
        return reduction(result.acting)
    if result.is_reduced and result.own_run:
        first = result.own_run.events[0]
        return f"your settings are judged without {first.element}, which acts from {first.time:.4g} s on"
    return ""
