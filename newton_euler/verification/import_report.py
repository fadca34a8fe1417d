"""Import report: what became of the elements of a model file on their way into a scene."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.verification.activity import Course, Watch, judged
from newton_euler.verification.original import Original

Fate = Literal["exactly", "approximated", "inactive", "left out"]

FATES: tuple[Fate, ...] = ("exactly", "approximated", "inactive", "left out")

CONTACTS, LIMITS, FRICTION = "contacts", "limits", "dry friction"
"""Topics of what files of several formats hold."""

RANGE = "range from the start"
"""Of limits: how far (m or rad) a joint coordinate may go down and up from where it starts, (2,)."""

CONTROL, FORCE, ROTOR = "control law", "force", "rotor"
"""What elements became that not every format has; all have dampers along hinges and slides."""

ACTING = (("equality", "equalities"), ("actuator", "actuators"), ("tendon", "tendons"))
"""First words of elements that act wherever a model is."""

CLOSE, TINY = 1e-9, 1e-12
"""Relative to the largest number of a value, and SI: round-off of a file's digits, degrees and frames."""

Value = tuple[float | str, ...]


def value(of: Any) -> Value:
    """The numbers of an array in one row, or a text; infinities as texts, which JSON has none of."""
    if isinstance(of, str):
        return (of,)
    numbers = (float(x) for x in np.ravel(of))
    return tuple(x if math.isfinite(x) else str(x) for x in numbers)


@dataclass(frozen=True)
class Part:
    """What a file says of something that a scene does not hold as it is.

    Attributes:
        element: its kind and name, such as "geom 'floor'".
        values: by the names that the file's format has for them, poses in the world at the start; SI.
        joints: the scene's joint coordinates that it acts on; of a ball or a free joint the first.
        bodies: the scene's bodies that it acts on or is a part of.
    """

    element: str
    values: dict[str, Value]
    joints: tuple[Key, ...] = ()
    bodies: tuple[str, ...] = ()


@dataclass(frozen=True)
class ImportedElement:
    """One element of a model file.

    Attributes:
        element: its kind and name, such as "equality 'close'".
        fate: carried over exactly, approximated, or left out; inactive if it is left out and a run has shown
            that it did nothing there.
        how: what it became, how it was approximated, or why it was left out.
        became: `CONTROL`, `FORCE`, `ROTOR`, or "" for anything else.
        topic: which of the things that a file can say of the element it is about, "" for all that it says.
        inert: whether nothing would move otherwise with the element as the file has it.
        parts: what the file says, of what was not carried over exactly or moves nothing.
    """

    element: str
    fate: Fate
    how: str
    became: str = ""
    topic: str = ""
    inert: bool = False
    parts: tuple[Part, ...] = ()

    def __str__(self) -> str:
        return f"{self.element}: {self.fate}: {self.how}"


class ImportReport:
    """What became of every element, filled while a file is read.

    Attributes:
        entries: in the order in which they were added.
        start: lines about the pose and the velocities that the scene starts from.
        originals: what the scene, and others that are read from the file to verify the reading, are verified
            against, see `newton_euler.verification.verify`; the scene's first.
        watches: what tells of entries, by their numbers, whether they are active in a run.
    """

    def __init__(self) -> None:
        self.entries: list[ImportedElement] = []
        self.start: list[str] = []
        self.originals: list[tuple[Original, Scene]] = []
        self.watches: dict[int, Sequence[Watch]] = {}

    def exactly(self, element: str, how: str, became: str = "", unseen: Part | None = None) -> None:
        """`unseen` is what the file says that moves nothing as it is, such as the gear of an idle motor."""
        parts, inert = () if unseen is None else (unseen,), unseen is not None
        self.entries.append(ImportedElement(element, "exactly", how, became, inert=inert, parts=parts))

    def approximated(self, element: str, how: str, *parts: Part, became: str = "", topic: str = "") -> None:
        self.entries.append(ImportedElement(element, "approximated", how, became, topic, parts=parts))

    def left_out(
        self,
        element: str,
        why: str,
        *parts: Part,
        topic: str = "",
        inert: bool = False,
        watches: Sequence[Watch] = (),
    ) -> None:
        """`watches` tell of a limit and the like whether it is active; all of it has to be watched."""
        if watches and not inert:
            self.watches[len(self.entries)] = watches
        self.entries.append(ImportedElement(element, "left out", why, "", topic, inert, parts))

    def after(self, course: Course) -> ImportReport:
        """The report with what a run shows of what was left out."""
        found = ImportReport()
        found.start, found.entries, found.watches = self.start, list(self.entries), self.watches
        found.originals = self.originals
        for number, watches in self.watches.items():
            seen, entry = judged(watches, course), self.entries[number]
            fate: Fate = "left out" if seen.active else "inactive"
            found.entries[number] = replace(entry, fate=fate, how=f"{entry.how}; {seen.words}")
        return found

    def of(self, fate: Fate) -> list[ImportedElement]:
        """The entries of one fate."""
        return [entry for entry in self.entries if entry.fate == fate]

    def counts(self) -> str:
        """How many elements were approximated, inactive and left out that could move something, in words.

        Each element counts once, as the worst that became of it; "" if there are none. Those of `ACTING` that
        are left out are named: without them a model moves otherwise from the start.
        """
        worst: dict[str, Fate] = {}
        for fate in FATES[1:]:
            worst.update((entry.element, fate) for entry in self.of(fate) if not entry.inert)
        found: list[str] = []
        for fate, count in sorted(Counter(worst.values()).items(), key=lambda item: FATES.index(item[0])):
            what = "element is" if count == 1 else "elements are"
            found.append(f"{count} {'' if found else what + ' '}{fate}")
        whole = {entry.element for entry in self.of("left out") if not entry.inert and not entry.topic}
        acting = Counter(element.split()[0] for element in whole)
        named = [f"{acting[one]} {one if acting[one] == 1 else many}" for one, many in ACTING if acting[one]]
        return ", ".join(found) + (f" ({', '.join(named)})" if named else "")


def left_out(report: ImportReport) -> dict[str, set[str]]:
    """Topics of what is not in the scene of each element; what moves nothing as the file has it stays on."""
    found: dict[str, set[str]] = {}
    for entry in report.entries:
        if entry.fate not in ("exactly", "approximated") and not entry.inert:
            found.setdefault(entry.element, set()).add(entry.topic)
    return found


def approximated(report: ImportReport) -> set[str]:
    """Elements that a report says were approximated."""
    return {entry.element for entry in report.of("approximated")}


def differing(one: dict[str, Value], two: dict[str, Value], close: float = CLOSE) -> Iterator[str]:
    """Names of values that are not the same to `close` of each, or that only one of two has."""
    for name in {**one, **two}:
        if name not in one or name not in two or not _close(one[name], two[name], close):
            yield name


def room(one: Value, two: Value, close: float = CLOSE) -> float:
    """By how much two numbers of these values may differ and be the same."""
    return TINY + close * max((abs(x) for x in (*one, *two) if isinstance(x, float)), default=0.0)


def _close(one: Value, two: Value, close: float) -> bool:
    if one == two:
        return True
    if len(one) != len(two):
        return False
    allowed = room(one, two, close)
    return all(
        abs(x - y) <= allowed if isinstance(x, float) and isinstance(y, float) else x == y
        for x, y in zip(one, two, strict=True)
    )


def unique_name(wanted: str, fallback: str, taken: Iterable[str]) -> str:
    """A name of letters, digits, `_`, `.` and `-` that is not taken, as near to the wanted one as can be."""
    name = "".join(c if c.isascii() and (c.isalnum() or c in "_.-") else "_" for c in wanted) or fallback
    known, candidate, number = set(taken), name, 2
    while candidate in known:
        candidate, number = f"{name}_{number}", number + 1
    return candidate
