"""The report of planted faults: shares, the faults that were missed and why."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any, NamedTuple

from crosscheck.report.table import Cell, Lines, Part, Report, Rows, Table, figures, texts
from crosscheck.studies.faults.find import READING, REFUSED, STATES, Found, Search, Sighting

BLAMED = 0.95
"""Share of the faults that have to be found that has to be blamed on the right body, joint or term."""

PROOF = (
    "with and without the fault newton_euler has the same poses, velocities, energies, accelerations and "
    f"reactions at {STATES + 1} states, to round-off"
)


class Count(NamedTuple):
    """Numbers of faults: all, those found, and those blamed right."""

    of: int
    found: int
    blamed: int

    def __str__(self) -> str:
        if not self.of:
            return "none"
        shares = f"{100 * self.found / self.of:.3g}%, {100 * self.blamed / self.of:.3g}%"
        return f"{self.found}, {self.blamed} of {self.of} ({shares})"


def in_all(faults: Iterable[Found]) -> Count:
    """By the levels of equations, or by the verification."""
    counted = [found for found in faults if found.counts]
    seen = sum(found.seen is not None for found in counted)
    return Count(len(counted), seen, sum(found.blamed for found in counted))


def by_motion(faults: Iterable[Found]) -> Count:
    """By those after the model, of faults that do something."""
    counted = [found for found in faults if found.observable]
    seen = sum(found.moves is not None for found in counted)
    return Count(len(counted), seen, sum(found.blamed_by_motion for found in counted))


def report(title: str, search: Search, wall_time: float) -> Report:
    """Shares, the faults that were missed and why, and on demand all faults."""
    unable = [
        f"no fault planted in {engine}, which cannot express the scene: {why}"
        for engine, why in search.left_out.items()
    ]
    rows: Rows = [
        [
            found.fault.name,
            found.engine,
            "yes" if found.observable else "no",
            _judged(found.seen, found.blamed),
            _judged(found.moves, found.blamed_by_motion),
        ]
        for found in search.found
    ]
    heads = texts("fault", "engine", "observable", "found", "by motion alone")
    parts: list[Part] = [
        table(search),
        Lines("", [*unable, *lines(search)]),
        Table(f"all {len(rows)} faults", heads, rows, folded=True),
    ]
    word = Cell("FOUND", "holds") if holds(search) else Cell("MISSED", "fails")
    planted = f"{len(search.found)} faults planted in {', '.join(search.engines)}, in {wall_time:.0f} s"
    few: list[Part] = [table(search, every=False), Lines("", [*unable, *lines(search, every=False)])]
    return Report(planted, verdict(title, search), word, parts, wall_time, few)


def table(search: Search, every: bool = True) -> Table:
    """Faults found and blamed right: a row per kind and per size.

    Args:
        every: whether kinds have rows of which all are found and blamed right.
    """
    sizes = dict.fromkeys(found.fault.size for found in search.found)
    kinds = dict.fromkeys(found.fault.kind for found in search.found)
    groups = {kind: [found for found in search.found if found.fault.kind == kind] for kind in kinds}
    by_size = {
        "without a size" if size is None else f"by {size:g}": [
            found for found in search.found if found.fault.size == size
        ]
        for size in sizes
    }
    if not every:
        groups = {kind: faults for kind, faults in groups.items() if list(_misses(faults, search))}
    rows: Rows = []
    for group in (groups, by_size):
        rows += [_row(name, faults, search) for name, faults in group.items()]
    names = ["faults", "found", "blamed right"]
    if search.engines != (READING,):
        names += ["moving", "by motion", "blamed"]
    head = "kind, and size" if groups else "size"
    return Table("", [*texts(head), *figures(*names)], rows)


def _row(name: str, faults: Sequence[Found], search: Search) -> list[str | Cell]:
    counts = [in_all(faults)] if search.engines == (READING,) else [in_all(faults), by_motion(faults)]
    return [name, *(str(number) for count in counts for number in count)]


def _judged(sighting: Sighting | None, right: bool) -> str | Cell:
    """The sighting of a fault; one that is blamed wrongly is doubtful."""
    if sighting is None:
        return ""
    text = f"level {sighting.level!r}, {sighting.quantity}, at {sighting.where}"
    return Cell(text, "holds" if right else "doubtful")


def lines(search: Search, every: bool = True) -> Iterator[str]:
    """Lines on faults not found or blamed wrongly, and on those that cannot be observed, all or how many."""
    yield from _misses(search.found, search)
    hidden = [found for found in search.found if not found.observable and found.lost is None]
    names = dict.fromkeys(" ".join(filter(None, found.fault.alike)) for found in hidden)
    if names and every:
        yield f"unobservable, {PROOF}: {'; '.join(names)}"
    elif names:
        yield f"unobservable as they change nothing: {len(hidden)} faults"


def _misses(faults: Sequence[Found], search: Search) -> Iterator[str]:
    """Lines on faults not found or blamed wrongly."""
    for found in faults:
        if (found.counts and not found.blamed) or found.lost:
            yield _outcome(found, found.seen)
    if search.engines != (READING,):
        blurred = {
            x.fault.alike: x for x in faults[::-1] if x.observable and not x.blamed_by_motion and not x.lost
        }
        for found in blurred.values():  # the largest of each, which is the first
            yield f"by motion alone, {_outcome(found, found.moves)}"


def _outcome(found: Found, sighting: Sighting | None) -> str:
    """The outcome of a fault that was not blamed right."""
    planted = f"{found.fault.name}, in {found.engine}"
    if found.lost is not None:
        lost = f"its {found.lost.quantity} is off by {found.lost.value:.1e} at {found.lost.where}"
        return f"missed: {planted}: {found.engine}'s own model does not hold it: made with the fault, {lost}"
    if sighting is None:
        return f"missed: {planted}: smaller than the tolerances"
    if sighting.level == REFUSED:
        return f"blamed wrongly: {planted}: refused: {sighting.quantity}"
    place = f"{sighting.odd or 'nobody'}, level {sighting.level!r}, {sighting.quantity}, at {sighting.where}"
    return f"blamed wrongly: {planted}: {place}"


def holds(search: Search) -> bool:
    """True if all faults down to the smallest size are found, and `BLAMED` of them blamed right."""
    count = in_all(_large(search))
    return count.found == count.of and count.blamed >= BLAMED * count.of


def _large(search: Search) -> list[Found]:
    sizes = [(found, found.fault.size) for found in search.found]
    return [found for found, size in sizes if size is None or size >= search.smallest]


def verdict(title: str, search: Search) -> str:
    """One line."""
    large = _large(search)
    if search.engines == (READING,):
        return f"{title}: faults in the reading that change a motion: found, blamed right: {in_all(large)}"
    return (
        f"{title}: faults down to {search.smallest:g}: found, blamed right: {in_all(large)}; "
        f"by motion alone: {by_motion(large)}"
    )


def data(title: str, options: Mapping[str, str], search: Search) -> dict[str, Any]:
    """All faults with their outcomes, for JSON."""
    return {
        "scene": title,
        "options": dict(options),
        "engines": search.engines,
        "left_out": search.left_out,
        "holds": holds(search),
        "faults": [_entry(found) for found in search.found],
    }


def _entry(found: Found) -> dict[str, Any]:
    fault = found.fault
    sightings = {"seen": found.seen, "by_motion": found.moves, "lost": found.lost}
    return {
        "kind": fault.kind,
        "element": fault.element,
        "detail": fault.detail,
        "size": fault.size,
        "engine": found.engine,
        "observable": found.observable,
        "blamed": found.blamed,
        "blamed_by_motion": found.blamed_by_motion,
        **{name: sighting and asdict(sighting) for name, sighting in sightings.items()},
    }
