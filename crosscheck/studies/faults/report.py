"""The report of planted faults: tables of shares, what was missed and why, JSON."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from rich.box import SIMPLE_HEAD
from rich.table import Table
from rich.text import Text

from crosscheck.errors import CrosscheckError
from crosscheck.report.output import tidied_up
from crosscheck.studies.faults.find import REFUSED, STATES, Found, Search, Sighting
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import atomic_file

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


class Counts(NamedTuple):
    """A table of texts: a line for each kind of fault and one for all, a column for each size."""

    title: str
    head: list[str]
    rows: list[list[str]]


def counts(scene: Scene, faults: Sequence[Found]) -> Iterator[Counts]:
    """Count faults found and blamed right, by all levels and by motion alone."""
    sizes = list(dict.fromkeys(found.fault.size for found in faults))
    head = ["", *("no size" if size is None else f"{size:g}" for size in sizes)]
    for title, count in TABLES.items():
        rows = []
        for kind in dict.fromkeys(found.fault.kind for found in faults):
            of_kind = [found for found in faults if found.fault.kind == kind]
            rows.append([kind, *(str(count(_of_size(of_kind, size))) for size in sizes)])
        rows.append(["all", *(count(_of_size(faults, size)).shares for size in sizes)])
        yield Counts(f"{scene.name}: {title}", head, rows)


def tables(scene: Scene, faults: Sequence[Found]) -> Iterator[Table]:
    """`counts` for the terminal."""
    for title, head, rows in counts(scene, faults):
        heading = Text(title, style="bold")
        table = Table(title=heading, title_justify="left", box=SIMPLE_HEAD, pad_edge=False)
        for column, name in enumerate(head):
            table.add_column(name, justify="right" if column else "left", no_wrap=True)
        for row in rows[:-1]:
            table.add_row(*row)
        table.add_section()
        table.add_row(*rows[-1])
        yield table


def _of_size(faults: Iterable[Found], size: float | None) -> list[Found]:
    return [found for found in faults if found.fault.size == size]


def lines(scene: Scene, faults: Sequence[Found]) -> Iterator[str]:
    """Lines on faults not found or blamed wrongly, with the reason, and on those that cannot be observed."""
    for found in faults:
        if (found.counts and not found.blamed) or found.lost:
            yield f"{_outcome(found, found.seen)}{_explanation(scene, found, found.seen)}"
    blurred = [x for x in faults if x.observable and not x.blamed_by_motion and x.lost is None]
    for found in _largest(blurred):
        yield f"by motion alone, {_outcome(found, found.moves)}{_explanation(scene, found, found.moves)}"
    hidden = [found for found in faults if not found.observable and found.lost is None]
    for seen, what in (
        (True, "only the model's numbers show"),
        (False, "the model's numbers do not show either"),
    ):
        names = list(_grouped(found for found in hidden if (found.seen is not None) == seen))
        if names:
            yield f"unobservable, {what}; {PROOF}:"
            yield from (f"  {name}" for name in names)


def _outcome(found: Found, sighting: Sighting | None) -> str:
    """The outcome of a fault that was not blamed right."""
    planted = f"{found.fault.name}, in {found.engine}"
    if sighting is None:
        return f"missed: {planted}"
    if sighting.level == REFUSED:
        return f"blamed wrongly: {planted}: refused: {sighting.quantity}"
    place = f"{sighting.odd or 'nobody'}, level {sighting.level!r}, {sighting.quantity}, at {sighting.where}"
    return f"blamed wrongly: {planted}: {place}"


def _explanation(scene: Scene, found: Found, sighting: Sighting | None) -> str:
    """Why a fault is blamed on something else, where that has a reason."""
    mechanism = scene.mechanism
    if found.lost is not None:
        lost = f"{found.lost.quantity} is off by {found.lost.value:.1e} at {found.lost.where}"
        return (
            f": {found.engine}'s own model does not hold it: made from the scene with the fault, its {lost}"
        )
    if sighting is None:
        return ": smaller than the tolerances"
    if not sighting.where:
        return "nothing: its loop cannot move at all, and all joints are closed where it stays"
    if found.fault.element not in mechanism.body_names or sighting.where not in mechanism.joint_names:
        return ""
    joint = mechanism.joints[mechanism.joint_index(sighting.where)]
    if found.fault.element not in (joint.first, joint.second):
        return ""
    if sighting.level == "kinematics":
        return f": the body's other joints let it move so, and {joint.name} elsewhere does the same"
    return f": {joint.name} alone carries what it does, as it would if its point were elsewhere"


def _largest(faults: Iterable[Found]) -> list[Found]:
    """The first of each kind, element and detail, which is the largest."""
    first: dict[tuple[str, str, str], Found] = {}
    for found in faults:
        first.setdefault(found.fault.alike, found)
    return list(first.values())


def _grouped(faults: Iterable[Found]) -> Iterator[str]:
    """Faults of an element together, whatever their size: "inertia entry of rod (xx, xy)"."""
    details: dict[tuple[str, str], dict[str, None]] = {}
    for found in faults:
        details.setdefault((found.fault.kind, found.fault.element), {})[found.fault.detail] = None
    for (kind, element), named in details.items():
        listed = ", ".join(filter(None, named))
        yield f"{kind} of {element}" + (f" ({listed})" if listed else "")


def holds(faults: Sequence[Found]) -> bool:
    """True if all faults down to `SMALLEST` are found, and `BLAMED` of them blamed right."""
    count = in_all(_judged(faults))
    return count.found == count.of and count.blamed >= BLAMED * count.of


def _judged(faults: Sequence[Found]) -> list[Found]:
    return [found for found in faults if found.fault.size is None or found.fault.size >= SMALLEST]


def verdict(scene: Scene, faults: Sequence[Found]) -> str:
    """One line."""
    count, motion = in_all(_judged(faults)), by_motion(_judged(faults))
    return (
        f"{scene.name}: faults down to {SMALLEST:g}: found, blamed right: {count} ({count.shares}); "
        f"by motion alone: {motion} ({motion.shares})"
    )


def as_json(scene: Scene, options: Mapping[str, str], search: Search, wall_time: float) -> str:
    """The content of the terminal, and all faults with their outcomes."""
    faults = search.found
    content = {
        "scene": scene.name,
        "options": dict(options),
        "engines": search.engines,
        "left_out": search.left_out,
        "verdict": verdict(scene, faults),
        "holds": holds(faults),
        "wall_time": wall_time,
        "versions": {name: version(name) for name in PACKAGES},
        "tables": [table._asdict() for table in counts(scene, faults)],
        "words": list(lines(scene, faults)),
        "faults": [_entry(found) for found in faults],
    }
    return json.dumps(content, indent=1, allow_nan=False) + "\n"


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


def write(path: Path, text: str) -> None:
    """Write the JSON, all of it or nothing.

    Raises:
        CrosscheckError: naming the path if it cannot be written.
    """
    try:
        with tidied_up(), atomic_file(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
    except OSError as error:
        raise CrosscheckError(f"cannot write {path}: {error.strerror}") from error
