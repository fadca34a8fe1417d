"""Import report: what became of the elements of a model file on their way into a scene."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from typing import Literal

from newton_euler.equations.loop_closure import MovedStart
from newton_euler.model.scene import Scene
from newton_euler.reading.activity import Bounds, Course, Watch, judged
from newton_euler.reading.reference import ReferenceModel

Fate = Literal["exactly", "inactive", "left out"]

FATES: tuple[Fate, ...] = ("exactly", "inactive", "left out")
CONTACTS, LIMITS, VELOCITY_LIMITS, FRICTION = "contacts", "limits", "limit of velocity", "dry friction"
"""Topics of files."""

CONTROL_RANGE = "control range"
"""Name of the range that the control of an actuator is clipped to."""

CONTROL, FORCE, ROTOR = "control law", "force", "rotor"
"""What elements became that not every format has; all have dampers along hinges and slides."""

ACTING = (("equality", "equalities"), ("actuator", "actuators"), ("tendon", "tendons"))
"""First words of elements that act wherever a model is."""


@dataclass(frozen=True)
class ImportedElement:
    """One element of a model file.

    Attributes:
        element: its kind and name, such as "equality 'close'".
        fate: carried over exactly, or left out; inactive if it is left out and a run has shown that it did
            nothing there.
        how: what it became, or why it was left out.
        became: `CONTROL`, `FORCE`, `ROTOR`, or "" for anything else.
        topic: which of the things that a file can say of the element it is about, "" for all that it says.
        inert: whether nothing would move otherwise with the element as the file has it.
        seen: what a run shows of it.
        is_off: True if the file itself switches the element off, so that nobody simulates it.
        is_understood: False for an element that no rule of the reader knows.
        numbers: values in the file that are not simulated, by what they are, such as "limits"; SI units.
        since: s, the first time of a run at which the element acts; None if it does not, and before a run.
        examined: False if neither the file nor a run shows whether the element acts.
    """

    element: str
    fate: Fate
    how: str
    became: str = ""
    topic: str = ""
    inert: bool = False
    seen: str = ""
    since: float | None = None
    examined: bool = True
    is_off: bool = False
    is_understood: bool = True
    numbers: tuple[tuple[str, tuple[float, ...]], ...] = ()

    @property
    def is_unsimulated(self) -> bool:
        """True if the element acted, or can act, and is not simulated as the file has it.

        Elements that move nothing, that the file switches off, or that a run has shown to be inactive do not
        count.
        """
        return self.fate == "left out" and not self.inert

    @property
    def account(self) -> str:
        """The fate in words, then what a run shows."""
        return "; ".join(filter(None, [self.how, self.seen]))

    def __str__(self) -> str:
        return f"{self.element}: {self.fate}: {self.account}"


@dataclass(frozen=True)
class Finding:
    """A likely mistake in a model file, which every engine simulates as it stands.

    Attributes:
        name: the kind of the mistake, a word or two joined by hyphens.
        element: the element at fault, such as "body 'hip'".
        what: the number that is wrong and what it is compared with.
        consequence: what the mistake does to the motion.
        remedy: what to do about it.
    """

    name: str
    element: str
    what: str
    consequence: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.name}: {self.element}: {self.what}; {self.consequence}; {self.remedy}"


@dataclass(frozen=True)
class ChangedVelocities:
    """The change of a file's start velocities that makes them fit the constraints.

    Attributes:
        start: keyframe, or other name of the start in the file.
        linear, angular: largest changes of a body's velocities, m/s and rad/s.
        share: largest change, divided by the largest velocity of that kind in the file.
    """

    start: str
    linear: float
    angular: float
    share: float


class ImportReport:
    """Fate of every element, filled while a file is read.

    Attributes:
        entries: in the order in which they were added.
        findings: likely mistakes in the file.
        start: lines about the pose and the velocities that the scene starts from.
        references: what the scene, and others that are read from the file to verify the reading, are verified
            against, see `newton_euler.reading.verify`; the scene's first.
        watches: what tells of entries, by their numbers, whether they are active in a run.
        unsettled: numbers of entries whose run had outputs too far apart to tell whether they act.
        settings: how the file itself would be simulated: integrator, time step and softness, in words; empty
            if the file does not say.
        moved: what closing the loops changed of the file's start; None if there is nothing to close.
        changed_velocities: how far the start's velocities are from the file's; None if the file has none.
    """

    def __init__(self) -> None:
        self.entries: list[ImportedElement] = []
        self.findings: list[Finding] = []
        self.start: list[str] = []
        self.references: list[tuple[ReferenceModel, Scene]] = []
        self.watches: dict[int, Sequence[Watch]] = {}
        self.unsettled: frozenset[int] = frozenset()
        self.settings = ""
        self.moved: MovedStart | None = None
        self.changed_velocities: ChangedVelocities | None = None

    def exactly(
        self,
        element: str,
        how: str,
        became: str = "",
        inert: bool = False,
        numbers: Mapping[str, Sequence[float]] | None = None,
    ) -> None:
        """Report an element that is in the scene.

        Args:
            element, how, became, numbers: see `ImportedElement`.
            inert: True if the element moves nothing as the file has it, such as an idle motor.
        """
        given = tuple((what, tuple(map(float, values))) for what, values in (numbers or {}).items())
        self.entries.append(ImportedElement(element, "exactly", how, became, inert=inert, numbers=given))

    def left_out(
        self,
        element: str,
        why: str,
        topic: str = "",
        inert: bool = False,
        watches: Sequence[Watch] = (),
        examined: bool = True,
        off: bool = False,
        numbers: Sequence[float] = (),
    ) -> None:
        """Report an element that is not in the scene.

        Args:
            element, why, topic, inert, examined: see `ImportedElement`.
            watches: tell whether a limit and the like is active in a run; together they have to watch all of
                the element. An element without watches acts from the start on.
            off: True if the file itself switches the element off.
            numbers: values that the file has of the topic; SI units.
        """
        inert = inert or off
        if watches and not inert:
            self.watches[len(self.entries)] = watches
        entry = ImportedElement(element, "left out", why, "", topic, inert, examined=examined, is_off=off)
        if numbers:
            entry = replace(entry, numbers=((topic, tuple(map(float, numbers))),))
        self.entries.append(entry)

    def not_understood(self, element: str, why: str) -> None:
        """Report an element that no rule knows: it may act, so it counts as one that is not simulated."""
        self.entries.append(ImportedElement(element, "left out", why, is_understood=False))

    @property
    def bounds(self) -> list[Bounds]:
        """The limits of joint coordinates and forces among what tells whether entries are active."""
        return [each for watches in self.watches.values() for each in watches if isinstance(each, Bounds)]

    def unsimulated(self) -> list[ImportedElement]:
        """Return the entries of elements that acted, or can act, and are not simulated as they are."""
        return [entry for entry in self.entries if entry.is_unsimulated]

    def after(self, course: Course) -> ImportReport:
        """Return the report with what a run shows of elements that are left out.

        After a report that is partly unsettled only the unsettled entries are judged again.
        """
        found = copy(self)
        found.entries, unsettled = list(self.entries), set[int]()
        for number, entry in enumerate(self.entries):
            if self.unsettled and number not in self.unsettled:
                continue
            if number in self.watches:
                seen = judged(self.watches[number], course)
                if not seen.settled:
                    unsettled.add(number)
                fate: Fate = "left out" if seen.active else "inactive"
                found.entries[number] = replace(entry, fate=fate, seen=seen.words, since=seen.since)
            elif entry.is_unsimulated and entry.examined:
                found.entries[number] = replace(entry, since=0.0)
        found.unsettled = frozenset(unsettled)
        return found

    def unwatched(self) -> ImportReport:
        """Return the report if no run shows anything: whatever can act counts as acting from the start on."""
        found = copy(self)
        found.entries = [
            replace(entry, since=0.0, seen="not watched in a run")
            if entry.is_unsimulated and entry.examined
            else entry
            for entry in self.entries
        ]
        return found

    def unverified(self) -> ImportReport:
        """Return the report for a scene with other parameter values, which the file cannot verify."""
        found = copy(self)
        found.references = []
        return found

    @property
    def acting(self) -> list[ImportedElement]:
        """Elements that act in the run and are not simulated as the file has them, the first to act first."""
        acting = ((entry.since, entry) for entry in self.entries if entry.since is not None)
        return [entry for _, entry in sorted(acting, key=lambda pair: pair[0])]

    def of(self, fate: Fate) -> list[ImportedElement]:
        """The entries of one fate."""
        return [entry for entry in self.entries if entry.fate == fate]

    def counts(self) -> str:
        """Count the elements inactive and left out that could move something, in words.

        Each element counts once, as the worst that became of it; "" if there are none. Those of `ACTING` that
        are left out are named: without them a model moves otherwise from the start. So is the number of
        elements that no rule understands, and of those that the file itself switches off.
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
        unknown = len({entry.element for entry in self.entries if not entry.is_understood})
        named += [f"{unknown} not understood"] if unknown else []
        counted = ", ".join(found) + (f" ({', '.join(named)})" if named else "")
        off = {entry.element for entry in self.entries if entry.is_off}
        idle = f"{len(off)} switched off by the file itself" if off else ""
        return ", ".join(filter(None, [counted, idle]))


def left_out(report: ImportReport) -> dict[str, set[str]]:
    """Topics of what is not in the scene of each element; what moves nothing as the file has it stays on."""
    found: dict[str, set[str]] = {}
    for entry in report.entries:
        if entry.fate != "exactly" and not entry.inert:
            found.setdefault(entry.element, set()).add(entry.topic)
    return found


def unique_name(wanted: str, fallback: str, taken: Iterable[str]) -> str:
    """A name of letters, digits, `_`, `.` and `-` that is not taken, as near to the wanted one as can be."""
    name = "".join(c if c.isascii() and (c.isalnum() or c in "_.-") else "_" for c in wanted) or fallback
    known, candidate, number = set(taken), name, 2
    while candidate in known:
        candidate, number = f"{name}_{number}", number + 1
    return candidate
