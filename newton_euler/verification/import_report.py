"""Import report: what became of the elements of a model file on their way into a scene."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from newton_euler.model.scene import Scene
from newton_euler.verification.activity import Course, Watch, judged
from newton_euler.verification.original import Original

Fate = Literal["exactly", "approximated", "inactive", "left out"]

FATES: tuple[Fate, ...] = ("exactly", "approximated", "inactive", "left out")
CONTACTS, LIMITS, FRICTION = "contacts", "limits", "dry friction"  # topics of files

CONTROL, FORCE, ROTOR = "control law", "force", "rotor"
"""What elements became that not every format has; all have dampers along hinges and slides."""

ACTING = (("equality", "equalities"), ("actuator", "actuators"), ("tendon", "tendons"))
"""First words of elements that act wherever a model is."""


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
        seen: what a run shows of it.
    """

    element: str
    fate: Fate
    how: str
    became: str = ""
    topic: str = ""
    inert: bool = False
    seen: str = ""

    @property
    def account(self) -> str:
        """The fate in words, then what a run shows."""
        return "; ".join(filter(None, [self.how, self.seen]))

    def __str__(self) -> str:
        return f"{self.element}: {self.fate}: {self.account}"


class ImportReport:
    """Fate of every element, filled while a file is read.

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

    def exactly(self, element: str, how: str, became: str = "", inert: bool = False) -> None:
        """`inert` is what moves nothing as the file has it, such as an idle motor."""
        self.entries.append(ImportedElement(element, "exactly", how, became, inert=inert))

    def approximated(self, element: str, how: str, watches: Sequence[Watch] = ()) -> None:
        """`watches` tell how far it is off in a run."""
        if watches:
            self.watches[len(self.entries)] = watches
        self.entries.append(ImportedElement(element, "approximated", how))

    def left_out(
        self, element: str, why: str, topic: str = "", inert: bool = False, watches: Sequence[Watch] = ()
    ) -> None:
        """`watches` tell of a limit and the like whether it is active; all of it has to be watched."""
        if watches and not inert:
            self.watches[len(self.entries)] = watches
        self.entries.append(ImportedElement(element, "left out", why, "", topic, inert))

    def after(self, course: Course) -> ImportReport:
        """The report with what a run shows of what was left out."""
        found = ImportReport()
        found.start, found.entries, found.watches = self.start, list(self.entries), self.watches
        found.originals = self.originals
        for number, watches in self.watches.items():
            seen, entry = judged(watches, course), self.entries[number]
            fate: Fate = entry.fate if entry.fate == "approximated" or seen.active else "inactive"
            found.entries[number] = replace(entry, fate=fate, seen=seen.words)
        return found

    def of(self, fate: Fate) -> list[ImportedElement]:
        """The entries of one fate."""
        return [entry for entry in self.entries if entry.fate == fate]

    def counts(self) -> str:
        """Count the elements approximated, inactive and left out that could move something, in words.

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


def unique_name(wanted: str, fallback: str, taken: Iterable[str]) -> str:
    """A name of letters, digits, `_`, `.` and `-` that is not taken, as near to the wanted one as can be."""
    name = "".join(c if c.isascii() and (c.isalnum() or c in "_.-") else "_" for c in wanted) or fallback
    known, candidate, number = set(taken), name, 2
    while candidate in known:
        candidate, number = f"{name}_{number}", number + 1
    return candidate
