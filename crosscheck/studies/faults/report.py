"""Report of fault injection: detection and location rates, and the missed faults with their reasons.

A fault is a single error that is injected into the model of an engine, or into a scene that was read from a
model file. In the second case, `READING` stands in place of the engine's name. The size of a fault is a
relative error, a shift divided by the mechanism's size, or a change of direction in rad.

A fault is detected if a check of crosscheck fails. Levels are groups of checks: one level compares the
model's numbers, such as masses; the others compare its motion. "By motion alone" leaves out the first level.
A fault is located if the diagnosis names the outlier, the engine with the fault, and the body, joint or term
at fault. A fault is observable if it changes the motion, and detectable if it is observable or detected.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any, NamedTuple

from crosscheck.compare.outcome import Verdict
from crosscheck.engines.registry import SOLVER
from crosscheck.report.chart import BarChart, Measure, linear_chart
from crosscheck.report.table import Cell, Lines, Part, Report, Rows, Table, number_columns, text_columns
from crosscheck.studies.faults.find import (
    RANDOM_STATES,
    READING,
    REFUSED,
    Detection,
    FaultResult,
    FaultSearch,
)

REQUIRED_LOCATION_RATE = 0.95
"""Smallest fraction of the required faults (see `_required`) that must be located."""

UNOBSERVABLE_MEANS = (
    f"with and without the fault {SOLVER.name} has the same poses, velocities, energies, accelerations and "
    f"reactions at {RANDOM_STATES + 1} states, to round-off"
)
"""Explanation of "not observable" in the report."""


class Count(NamedTuple):
    """Numbers of faults.

    Attributes:
        total: number of detectable faults, or of observable faults if motion alone is compared.
        detected: number of these faults that were detected.
        located: number of these faults that were located correctly.
    """

    total: int
    detected: int
    located: int

    def __str__(self) -> str:
        if not self.total:
            return "no faults"
        detected = f"{self.detected} detected ({100 * self.detected / self.total:.3g} %)"
        return f"{detected}, {self.located} located ({100 * self.located / self.total:.3g} %)"


def count_detected(faults: Iterable[FaultResult]) -> Count:
    """Count the detectable faults, and those that any check detects and locates."""
    counted = [found for found in faults if found.is_detectable]
    seen = sum(found.detection is not None for found in counted)
    return Count(len(counted), seen, sum(found.located for found in counted))


def count_detected_by_motion(faults: Iterable[FaultResult]) -> Count:
    """Count the observable faults, and those that comparisons of the motion alone detect and locate."""
    counted = [found for found in faults if found.observable]
    seen = sum(found.detection_by_motion is not None for found in counted)
    return Count(len(counted), seen, sum(found.located_by_motion for found in counted))


def report(title: str, search: FaultSearch, wall_time: float) -> Report:
    """Make the report: detection and location rates, missed faults with reasons, and a table of all faults.

    Args:
        title: name of the scene or model file.
        search: results of the search.
        wall_time: duration of the search, s.
    """
    left_out = [f"no fault injected into {engine}: {why}" for engine, why in search.left_out.items()]
    rows: Rows = [
        [
            found.fault.name,
            found.engine,
            "yes" if found.observable else "no",
            _judged(found.detection, found.located),
            _judged(found.detection_by_motion, found.located_by_motion),
        ]
        for found in search.found
    ]
    heads = text_columns("fault", "engine", "observable", "found", "by motion alone")
    parts: list[Part] = [
        table(search),
        Lines("", [*left_out, *finding_lines(search)]),
        Table(f"all {len(rows)} faults", heads, rows, folded=True),
    ]
    judged = Cell("FOUND", "holds") if detects_enough(search) else Cell("MISSED", "fails")
    title_line = f"{len(search.found)} faults injected into {', '.join(search.engines)}, in {wall_time:.0f} s"
    summary: list[Part] = [
        table(search, every=False),
        Lines("", [*left_out, *finding_lines(search, every=False)]),
    ]
    return Report(
        title_line,
        verdict(title, search),
        judged,
        parts,
        wall_time,
        summary,
        charts=_chart(search),
        next_steps=_next_steps(search),
    )


def _chart(search: FaultSearch) -> list[BarChart]:
    """Make the chart of the located faults of each kind."""
    measures = []
    for kind in dict.fromkeys(found.fault.kind for found in search.found):
        count = count_detected(found for found in search.found if found.fault.kind == kind)
        if count.total:
            share = 100.0 * count.located / count.total
            verdict: Verdict = "holds" if count.located == count.total else "doubtful"
            measures.append(Measure(kind, share, f"{count.located} of {count.total}", verdict=verdict))
    caption = "Detectable faults of each kind that are located correctly; the axis ends at all of them"
    return linear_chart("Located faults", caption, measures, end=100.0)


def _next_steps(search: FaultSearch) -> list[str]:
    """List what the reader can do about faults that are not located."""
    count = count_detected(search.found)
    if count.located == count.total:
        return ["Rely on a run of this model to find a single fault of these kinds and sizes."]
    return ["Give the model a motion that shows the missed faults; the details list the reasons."]


def table(search: FaultSearch, every: bool = True) -> Table:
    """Tabulate detected and located faults, with a row for each kind and each size.

    Args:
        search: results of the search.
        every: False to omit kinds whose faults were all detected and located correctly.
    """
    sizes = dict.fromkeys(found.fault.size for found in search.found)
    kinds = dict.fromkeys(found.fault.kind for found in search.found)
    by_kind = {kind: [found for found in search.found if found.fault.kind == kind] for kind in kinds}
    by_size = {
        "without a size" if size is None else f"by {size:g}": [
            found for found in search.found if found.fault.size == size
        ]
        for size in sizes
    }
    if not every:
        by_kind = {kind: faults for kind, faults in by_kind.items() if list(_misses(faults, search))}
    rows: Rows = []
    for groups in (by_kind, by_size):
        rows += [_row(name, faults, search) for name, faults in groups.items()]
    names = ["faults", "detected", "located"]
    if search.engines != (READING,):
        # observable faults; of these, faults that were detected and located by motion alone
        names += ["that move", "detected by motion", "located by motion"]
    head = "kind, and size" if by_kind else "size"
    return Table("", [*text_columns(head), *number_columns(*names)], rows)


def _row(name: str, faults: Sequence[FaultResult], search: FaultSearch) -> list[str | Cell]:
    """Format a row of `table`: the numbers of faults of a kind or size."""
    counts = [count_detected(faults)]
    if search.engines != (READING,):
        counts.append(count_detected_by_motion(faults))
    return [name, *(str(number) for count in counts for number in count)]


def _judged(detection: Detection | None, located: bool) -> str | Cell:
    """Format the detection of a fault, empty if there is none; a wrong location is shown as doubtful."""
    if detection is None:
        return ""
    text = f"level {detection.level!r}, {detection.quantity}, at {detection.where}"
    return Cell(text, "holds" if located else "doubtful")


def finding_lines(search: FaultSearch, every: bool = True) -> Iterator[str]:
    """Yield one line for each missed or wrongly located fault, and one line on unobservable faults.

    Args:
        search: results of the search.
        every: True to name all unobservable faults, False to count them.
    """
    yield from _misses(search.found, search)
    hidden = [found for found in search.found if not found.observable and found.model_difference is None]
    names = dict.fromkeys(" ".join(filter(None, found.fault.identity)) for found in hidden)
    if names and every:
        yield f"not observable, {UNOBSERVABLE_MEANS}: {'; '.join(names)}"
    elif names:
        yield f"not observable: {len(hidden)} faults that do not change the motion"


def _misses(faults: Sequence[FaultResult], search: FaultSearch) -> Iterator[str]:
    """Yield one line for each missed or wrongly located fault; and for faults that differ in size only, one
    line for the largest that the motion alone does not locate."""
    for found in faults:
        if (found.is_detectable and not found.located) or found.model_difference:
            yield _outcome(found, found.detection)
    if search.engines != (READING,):
        # the largest fault comes first in `faults`, and so is the last that enters the dictionary
        not_located_by_motion = {
            found.fault.identity: found
            for found in faults[::-1]
            if found.observable and not found.located_by_motion and not found.model_difference
        }
        for found in not_located_by_motion.values():
            yield f"by motion alone, {_outcome(found, found.detection_by_motion)}"


def _outcome(found: FaultResult, detection: Detection | None) -> str:
    """Format the result for a fault that was missed or located wrongly.

    Args:
        found: result for the fault.
        detection: detection by all levels, or by motion alone; None if the fault was missed.
    """
    fault = f"{found.fault.name}, in {found.engine}"
    if found.model_difference is not None:
        difference = found.model_difference
        text = f"error of {difference.quantity} {difference.value:.1e} at {difference.where}"
        return f"missed: {fault}: {found.engine}'s own model does not contain the fault: {text}"
    if detection is None:
        return f"missed: {fault}: smaller than the tolerances"
    if detection.level == REFUSED:  # an engine raised an error, whose text is in `quantity`
        return f"located wrongly: {fault}: refused: {detection.quantity}"
    outlier = detection.outlier or "no outlier"
    place = f"{outlier}, level {detection.level!r}, {detection.quantity}, at {detection.where}"
    return f"located wrongly: {fault}: attributed to {place}"


def detects_enough(search: FaultSearch) -> bool:
    """Return True if all required faults are detected, and enough of them located correctly."""
    count = count_detected(_required(search))
    return count.detected == count.total and count.located >= REQUIRED_LOCATION_RATE * count.total


def _required(search: FaultSearch) -> list[FaultResult]:
    """Return the faults that must be detected: those without a size, and those that are large enough."""
    return [
        found for found in search.found if found.fault.size is None or found.fault.size >= search.smallest
    ]


def verdict(title: str, search: FaultSearch) -> str:
    """Report the numbers of detected and located faults in one line."""
    required = _required(search)
    if search.engines == (READING,):
        count = count_detected(required)
        return f"{title}: of {count.total} faults in the import that change a motion: {count}"
    count, by_motion = count_detected(required), count_detected_by_motion(required)
    return (
        f"{title}: of {count.total} faults of {search.smallest:g} or more: {count}; "
        f"by motion alone, of {by_motion.total}: {by_motion}"
    )


def data(title: str, options: Mapping[str, str], search: FaultSearch) -> dict[str, Any]:
    """Return all faults with their results, for JSON."""
    return {
        "scene": title,
        "options": dict(options),
        "engines": search.engines,
        "left_out": search.left_out,
        "holds": detects_enough(search),
        "faults": [_entry(found) for found in search.found],
    }


def _entry(found: FaultResult) -> dict[str, Any]:
    """Return a fault with its result, for JSON."""
    fault = found.fault
    detections = {
        "seen": found.detection,
        "by_motion": found.detection_by_motion,
        "lost": found.model_difference,
    }
    return {
        "kind": fault.kind,
        "element": fault.element,
        "detail": fault.detail,
        "size": fault.size,
        "engine": found.engine,
        "observable": found.observable,
        "located": found.located,
        "located_by_motion": found.located_by_motion,
        **{name: detection and asdict(detection) for name, detection in detections.items()},
    }
