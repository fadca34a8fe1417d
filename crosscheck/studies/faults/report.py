"""The report of planted faults: shares, the faults that were missed and why."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

from crosscheck.report.table import Cell, Column, Lines, Part, Report, Rows, Table, entries, texts
from crosscheck.studies.faults.find import REFUSED, STATES, Found, Search, Sighting
from newton_euler.model.scene import Scene

SMALLEST = 1e-4
"""Relative size down to which all faults have to be found."""

BLAMED = 0.95
"""Share of these that has to be blamed on the right body, joint or term."""

PROOF = (
    "with and without the fault newton_euler has the same poses, velocities, energies, accelerations and "
    f"reactions at {STATES + 1} states, to round-off"
)

PACKAGES = ("numpy", "mujoco", "pin")


@dataclass(frozen=True)
class Count:
    """Numbers of faults: all, those found, and those blamed right."""

    of: int
    found: int
    blamed: int

    def __str__(self) -> str:
        return f"{self.found}, {self.blamed} of {self.of}" if self.of else ""

    @property
    def shares(self) -> str:
        """The same in per cent."""
        return f"{100 * self.found / self.of:.3g}%, {100 * self.blamed / self.of:.3g}%" if self.of else ""


def in_all(faults: Iterable[Found]) -> Count:
    """By levels 1 to 4."""
    counted = [found for found in faults if found.counts]
    seen = sum(found.seen is not None for found in counted)
    return Count(len(counted), seen, sum(found.blamed for found in counted))


def by_motion(faults: Iterable[Found]) -> Count:
    """By levels 2 to 4, of those that do something."""
    counted = [found for found in faults if found.observable]
    seen = sum(found.moves is not None for found in counted)
    return Count(len(counted), seen, sum(found.blamed_by_motion for found in counted))


TABLES: Mapping[str, Callable[[Iterable[Found]], Count]] = {
    "found, and blamed on the very body, joint or term": in_all,
    "by motion alone: found, and blamed there or at the bodies of the joint": by_motion,
}


def tables(scene: Scene, faults: Sequence[Found]) -> Iterator[Table]:
    """Faults found and blamed right, by all levels and by motion alone: a row per kind, a column per size."""
    sizes = list(dict.fromkeys(found.fault.size for found in faults))
    heads = [Column("no size" if size is None else f"{size:g}", numeric=True) for size in sizes]
    for title, count in TABLES.items():
        rows: Rows = []
        for kind in dict.fromkeys(found.fault.kind for found in faults):
            of_kind = [found for found in faults if found.fault.kind == kind]
            rows.append([kind, *(str(count(_of_size(of_kind, size))) for size in sizes)])
        rows.append(["all", *(count(_of_size(faults, size)).shares for size in sizes)])
        yield Table(f"{scene.name}: {title}", [Column(""), *heads], rows)


def report(scene: Scene, options: Mapping[str, str], search: Search, wall_time: float) -> Report:
    """Shares, the faults that were missed and why, settings, and all faults."""
    settings = {
        "scene": scene.name,
        "options": dict(options),
        "planted in": search.engines,
        "engines left out": search.left_out,
        "versions": {name: version(name) for name in PACKAGES},
    }
    every = Table(
        f"all {len(search.found)} faults",
        texts("fault", "engine", "observable", "found", "by motion alone"),
        [
            [
                found.fault.name,
                found.engine,
                "yes" if found.observable else "no",
                _judged(found.seen, found.blamed),
                _judged(found.moves, found.blamed_by_motion),
            ]
            for found in search.found
        ],
        folded=True,
    )
    told = [
        f"no fault planted in {engine}, which cannot express the scene: {why}"
        for engine, why in search.left_out.items()
    ]
    said = Lines("", [*told, *lines(search.found)])
    parts: list[Part] = [
        *tables(scene, search.found),
        said,
        entries("settings", settings, folded=True),
        every,
    ]
    word = Cell("FOUND", "holds") if holds(search.found) else Cell("MISSED", "fails")
    return Report("planted faults", verdict(scene, search.found), word, parts, wall_time)


def _judged(sighting: Sighting | None, right: bool) -> str | Cell:
    """The sighting of a fault; one that is blamed wrongly fails."""
    if sighting is None:
        return ""
    text = f"level {sighting.level!r}, {sighting.quantity}, at {sighting.where}"
    return Cell(text, "holds" if right else "doubtful")


def _of_size(faults: Iterable[Found], size: float | None) -> list[Found]:
    return [found for found in faults if found.fault.size == size]


def lines(faults: Sequence[Found]) -> Iterator[str]:
    """Lines on faults not found or blamed wrongly, and on those that cannot be observed."""
    for found in faults:
        if (found.counts and not found.blamed) or found.lost:
            yield _outcome(found, found.seen)
    blurred = {
        x.fault.alike: x for x in faults[::-1] if x.observable and not x.blamed_by_motion and not x.lost
    }
    for found in blurred.values():  # the largest of each, which is the first
        yield f"by motion alone, {_outcome(found, found.moves)}"
    hidden = [found for found in faults if not found.observable and found.lost is None]
    if hidden:
        names = dict.fromkeys(" ".join(filter(None, found.fault.alike)) for found in hidden)
        yield f"unobservable, {PROOF}: {'; '.join(names)}"


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


def holds(faults: Sequence[Found]) -> bool:
    """True if all faults down to `SMALLEST` are found, and `BLAMED` of them blamed right."""
    count = in_all(_large(faults))
    return count.found == count.of and count.blamed >= BLAMED * count.of


def _large(faults: Sequence[Found]) -> list[Found]:
    return [found for found in faults if found.fault.size is None or found.fault.size >= SMALLEST]


def verdict(scene: Scene, faults: Sequence[Found]) -> str:
    """One line."""
    count, motion = in_all(_large(faults)), by_motion(_large(faults))
    return (
        f"{scene.name}: faults down to {SMALLEST:g}: found, blamed right: {count} ({count.shares}); "
        f"by motion alone: {motion} ({motion.shares})"
    )


def data(scene: Scene, options: Mapping[str, str], search: Search) -> dict[str, Any]:
    """All faults with their outcomes, for JSON."""
    return {
        "scene": scene.name,
        "options": dict(options),
        "engines": search.engines,
        "left_out": search.left_out,
        "holds": holds(search.found),
        "faults": [_entry(found) for found in search.found],
    }


def _entry(found: Found) -> dict[str, Any]:
    fault = found.fault
    return {
        "kind": fault.kind,
        "element": fault.element,
        "detail": fault.detail,
        "size": fault.size,
        "engine": found.engine,
        "observable": found.observable,
        "seen": _sighting(found.seen),
        "blamed": found.blamed,
        "by_motion": _sighting(found.moves),
        "lost": _sighting(found.lost),
        "blamed_by_motion": found.blamed_by_motion,
    }


def _sighting(sighting: Sighting | None) -> dict[str, Any] | None:
    if sighting is None:
        return None
    refused = sighting.level == REFUSED
    return {
        "level": sighting.level,
        "quantity": sighting.quantity,
        "value": None if refused else sighting.value,
        "tolerance": None if refused else sighting.tolerance,
        "where": sighting.where,
        "odd": sighting.odd,
    }
