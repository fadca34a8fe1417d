"""Import report: how each element of a model file was imported, and likely mistakes in the file.

A reader (of MJCF or URDF files) adds an entry for each element while it turns the file into a `Scene`. The
*fate* of an element is "exactly" (imported without change), "inactive" (not simulated, but a run has shown
that the element would not have acted), "approximated" (simulated by a similar force) or "left out" (not
simulated). Tests that judge this in a run are called *watches*, see `newton_euler.reading.activity`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Any, Literal

from newton_euler.equations.loop_closure import MovedStart
from newton_euler.model.scene import Scene
from newton_euler.reading.activity import Bounds, SampledMotion, Watch, judge_all
from newton_euler.reading.file_names import FileNames
from newton_euler.reading.file_run import FileSimulation
from newton_euler.reading.reference import ReferenceModel

Fate = Literal["exactly", "inactive", "approximated", "left out"]

FATES: tuple[Fate, ...] = ("exactly", "inactive", "approximated", "left out")
"""All fates, from the best to the worst."""

CONTACTS, LIMITS, VELOCITY_LIMITS, FRICTION = "contacts", "limits", "limit of velocity", "dry friction"
"""Topics (`ImportedElement.topic`) of elements that scenes do not simulate."""

ACTUATOR_LIMIT, JOINT_LIMIT, TENDON_LIMIT = FORCE_LIMITS = (
    "limit of the force",
    "limit of actuator forces",
    "limit of its tendon",
)
"""Topics of limits of actuator forces: of an actuator, a joint, and an actuator's tendon."""

CONTROL, FORCE, ROTOR = "control law", "force", "rotor"
"""Values of `ImportedElement.became`: kinds of scene elements that some file formats cannot represent."""

ALWAYS_ACTING = (("equality", "equalities"), ("actuator", "actuators"), ("tendon", "tendons"))
"""Kinds of elements in files, singular and plural, that act in every configuration of a model."""


@dataclass(frozen=True)
class ImportedElement:
    """One element of a model file.

    Attributes:
        element: kind and name, such as "equality 'close'".
        fate: "exactly" if imported exactly; "approximated" if a similar force is simulated; "left out" if not
            simulated; "inactive" if not simulated and a run has shown that the element would not have acted.
        how: the element's counterpart in the scene, or the reason why the element is left out.
        became: kind of the counterpart in the scene: "control law", "force", "rotor", or "" for others.
        topic: the property of the element that the entry is about, such as "limits"; "" for all properties.
        moves_nothing: True if the element, as it is in the file, cannot move anything, such as a camera.
        seen: observation in a run, such as "passed from 0.3 s on"; "" before a run.
        is_off: True if the file itself switches the element off.
        is_understood: False for an element that no rule of the reader knows.
        is_soft_in_file: True for a constraint that is rigid in the scene, and soft in the file's own engine.
        since: s, the first time of a run at which the element acts; None if inactive, and before a run.
        examined: False if neither the file nor a run shows whether the element acts.
    """

    element: str
    fate: Fate
    how: str
    became: str = ""
    topic: str = ""
    moves_nothing: bool = False
    seen: str = ""
    since: float | None = None
    examined: bool = True
    is_off: bool = False
    is_understood: bool = True
    is_soft_in_file: bool = False

    @property
    def is_unsimulated(self) -> bool:
        """True if the element acted or can act, and is not simulated.

        Elements that move nothing, that the file switches off, or that a run has shown to be inactive do not
        count.
        """
        return self.fate == "left out" and not self.moves_nothing

    @property
    def account(self) -> str:
        """The reason for the fate, and the observation in a run."""
        return "; ".join(filter(None, [self.how, self.seen]))

    def __str__(self) -> str:
        return f"{self.element}: {self.fate}: {self.account}"


class Mistake(StrEnum):
    """Kind of a likely mistake in a model file."""

    IMPOSSIBLE_INERTIA = "impossible-inertia"
    INERTIA_TOO_LARGE = "inertia-too-large"
    INERTIA_TOO_SMALL = "inertia-too-small"
    CENTER_OUTSIDE = "center-outside"
    MASS_TOO_LARGE = "mass-too-large"
    MASS_TOO_SMALL = "mass-too-small"
    TWINS_DIFFER = "twins-differ"
    MESH_INERTIA = "mesh-inertia"
    SHORT_KEYFRAME = "short-keyframe"
    PARSER_MESSAGE = "parser-message"
    UNREAD_LOOPS = "unread-loops"


@dataclass(frozen=True)
class Finding:
    """Likely mistake in a model file. Readers do not correct it: every engine simulates the file as it is.

    Attributes:
        name: kind of the mistake.
        element: element at fault, such as "body 'hip'".
        what: the wrong number and the number that it is compared with.
        consequence: effect of the mistake on the motion.
        remedy: next step for the author of the file.
    """

    name: Mistake
    element: str
    what: str
    consequence: str
    remedy: str

    def __str__(self) -> str:
        return f"{self.name}: {self.element}: {self.what}; {self.consequence}; {self.remedy}"


@dataclass(frozen=True)
class ChangedVelocities:
    """Change of a file's start velocities that was needed to satisfy the constraints.

    Attributes:
        start: name of the start in the file, such as a keyframe of MJCF.
        linear: largest change of a body's linear velocity, m/s.
        angular: largest change of a body's angular velocity, rad/s.
        share: largest change, divided by the largest velocity of the same kind in the file.
    """

    start: str
    linear: float
    angular: float
    share: float


EXCITED = "excited: "
"""Beginning of the line of `ImportReport.start` on inputs and velocities that the file does not have."""


class ImportReport:
    """Report on the import of a file: one entry for each element, or for each unsimulated property of one.

    Attributes:
        entries: entries in the order of reading.
        findings: likely mistakes in the file.
        start: lines about the initial pose and velocities of the scene.
        moved: change of the initial pose that was needed to close loops; None if the file has no loops.
        changed_velocities: change of the start velocities; None if the file has no velocities.
        simulation: simulation of the file in its own engine, with its own or usual settings; None before the
            reader has one.
        names: joints, body frames and actuators of the file, by their names in the file.
        references: for comparisons: pairs of a reference model and the scene to verify against the model. The
            first pair has the scene that the reader returns; other scenes are read only for verification.
        watches: for comparisons: tests that find out whether the element of an entry acts in a run, by index
            of the entry.
        approximated_limits: for comparisons: limits of joint coordinates that the scene has as stops.
            Excitation respects them like the limits that are not simulated.
        unsettled: for comparisons: indices of the entries that only a run with more outputs can judge.
    """

    def __init__(self) -> None:
        self.entries: list[ImportedElement] = []
        self.findings: list[Finding] = []
        self.start: list[str] = []
        self.references: list[tuple[ReferenceModel, Scene]] = []
        self.watches: dict[int, Sequence[Watch]] = {}
        self.approximated_limits: list[Bounds] = []
        self.unsettled: frozenset[int] = frozenset()
        self.simulation: FileSimulation[Any] | None = None
        self.moved: MovedStart | None = None
        self.changed_velocities: ChangedVelocities | None = None
        self.names = FileNames()

    @property
    def excitation(self) -> str:
        """The line of `start` on inputs and velocities that the file does not have; "" without excitation."""
        return next((line for line in self.start if line.startswith(EXCITED)), "")

    def imported(
        self,
        element: str,
        how: str,
        became: str = "",
        moves_nothing: bool = False,
        is_soft_in_file: bool = False,
    ) -> None:
        """Add an element that is imported exactly.

        Args:
            element, how, became, is_soft_in_file: see `ImportedElement`.
            moves_nothing: True if the element moves nothing as the file has it, such as an idle motor.
        """
        entry = ImportedElement(
            element, "exactly", how, became, moves_nothing=moves_nothing, is_soft_in_file=is_soft_in_file
        )
        self.entries.append(entry)

    def approximated(self, element: str, how: str, topic: str, limits: Sequence[Bounds] = ()) -> None:
        """Add one topic of an element, such as its dry friction, that a similar force approximates.

        Args:
            element, how, topic: see `ImportedElement`.
            limits: limits of joint coordinates that stops approximate.
        """
        self.entries.append(ImportedElement(element, "approximated", how, topic=topic))
        self.approximated_limits.extend(limits)

    def left_out(
        self,
        element: str,
        why: str,
        topic: str = "",
        moves_nothing: bool = False,
        watches: Sequence[Watch] = (),
        examined: bool = True,
        switched_off: bool = False,
    ) -> None:
        """Add an element, or one topic of an element, that is not simulated.

        Args:
            element, topic, examined: see `ImportedElement`.
            why: reason why the element is not simulated.
            moves_nothing: True if the element moves nothing as the file has it, such as a camera.
            watches: tests whether the element acts in a run. Together they cover the whole element. An
                element without watches counts as acting from the start on.
            switched_off: True if the file itself switches the element off.
        """
        moves_nothing = moves_nothing or switched_off
        if watches and not moves_nothing:
            self.watches[len(self.entries)] = watches
        entry = ImportedElement(
            element,
            "left out",
            why,
            topic=topic,
            moves_nothing=moves_nothing,
            examined=examined,
            is_off=switched_off,
        )
        self.entries.append(entry)

    def not_understood(self, element: str, why: str) -> None:
        """Add an element that no rule of the reader knows; the element counts as not simulated."""
        self.entries.append(ImportedElement(element, "left out", why, is_understood=False))

    @property
    def bounds(self) -> list[Bounds]:
        """All limits of joint coordinates and forces for which a run is tested, or which are stops."""
        tested = [each for watches in self.watches.values() for each in watches if isinstance(each, Bounds)]
        return tested + self.approximated_limits

    @property
    def approximated_topics(self) -> frozenset[tuple[str, str]]:
        """Element and topic of each entry that is approximated."""
        return frozenset((entry.element, entry.topic) for entry in self.of("approximated"))

    def unsimulated(self) -> list[ImportedElement]:
        """Return the entries of elements that acted or can act, and are not simulated."""
        return [entry for entry in self.entries if entry.is_unsimulated]

    def after(self, motion: SampledMotion) -> ImportReport:
        """Return the report with the fates that the motion of a run shows for elements not simulated.

        If some entries of this report are unsettled (an earlier run could not judge them), only these entries
        are judged; other entries stay unchanged.
        """
        found = copy(self)
        found.entries, unsettled = list(self.entries), set[int]()
        for number, entry in enumerate(self.entries):
            if self.unsettled and number not in self.unsettled:
                continue
            if number in self.watches:
                seen = judge_all(self.watches[number], motion)
                if not seen.settled:
                    unsettled.add(number)
                fate: Fate = "left out" if seen.active else "inactive"
                found.entries[number] = replace(entry, fate=fate, seen=seen.words, since=seen.since)
            elif entry.is_unsimulated and entry.examined:  # no watch: it counts as acting from the start
                found.entries[number] = replace(entry, since=0.0)
        found.unsettled = frozenset(unsettled)
        return found

    def unwatched(self) -> ImportReport:
        """Return the report without a run: all elements that can act count as acting from the start."""
        found = copy(self)
        found.entries = [
            replace(entry, since=0.0, seen="not watched in a run")
            if entry.is_unsimulated and entry.examined
            else entry
            for entry in self.entries
        ]
        return found

    def unverified(self) -> ImportReport:
        """Return the report of a scene with other parameter values: without reference models and file run."""
        found = copy(self)
        found.references = []
        found.simulation = None
        return found

    @property
    def acting(self) -> list[ImportedElement]:
        """Elements that act in the run and are not simulated, sorted by the time at which they first act."""
        acting = ((entry.since, entry) for entry in self.entries if entry.since is not None)
        return [entry for _, entry in sorted(acting, key=lambda pair: pair[0])]

    def of(self, fate: Fate) -> list[ImportedElement]:
        """Return the entries with one fate."""
        return [entry for entry in self.entries if entry.fate == fate]

    def _with_topics(self, element: str, fate: Fate) -> str:
        """Return an element and its topics that have a fate and can act, such as "joint 'a': limits"."""
        entries = [entry for entry in self.of(fate) if entry.element == element and not entry.moves_nothing]
        topics = dict.fromkeys(entry.topic for entry in entries if entry.topic)
        return ": ".join(filter(None, [element, ", ".join(topics)]))

    def counts(self) -> str:
        """Describe how many elements are approximated, inactive, left out, or switched off.

        Elements that move nothing are not counted. Each element counts once, with its worst fate. The kinds
        of `ALWAYS_ACTING` are counted separately, because a model without them moves differently from the
        start. The text is "" if there is nothing to count.
        """
        # The worst fate of each element: "left out" replaces "approximated", which replaces "inactive"
        worst: dict[str, Fate] = {}
        for fate in FATES[1:]:
            worst.update((entry.element, fate) for entry in self.of(fate) if not entry.moves_nothing)
        found: list[str] = []
        for fate, count in sorted(Counter(worst.values()).items(), key=lambda item: FATES.index(item[0])):
            subject = "element is" if count == 1 else "elements are"  # only in the first part of the text
            elements = [element for element, of_element in worst.items() if of_element == fate]
            named = f" ({self._with_topics(elements[0], fate)})" if count == 1 else ""
            found.append(f"{count} {'' if found else subject + ' '}{fate}{named}")
        # Equalities, actuators and tendons left out as a whole, and elements that no rule knows
        whole = {
            entry.element for entry in self.of("left out") if not entry.moves_nothing and not entry.topic
        }
        acting = Counter(element.split()[0] for element in whole)
        kinds = [
            f"{acting[one]} {one if acting[one] == 1 else many}" for one, many in ALWAYS_ACTING if acting[one]
        ]
        unknown = len({entry.element for entry in self.entries if not entry.is_understood})
        kinds += [f"{unknown} not understood"] if unknown else []
        counted = ", ".join(found) + (f" ({', '.join(kinds)})" if kinds else "")
        off = {entry.element for entry in self.entries if entry.is_off}
        idle = f"{len(off)} switched off by the file itself" if off else ""
        return ", ".join(filter(None, [counted, idle]))


def topics_not_simulated(report: ImportReport) -> dict[str, set[str]]:
    """Return the topics that are left out or inactive, by element; elements that move nothing are absent."""
    found: dict[str, set[str]] = {}
    for entry in report.entries:
        if entry.fate not in ("exactly", "approximated") and not entry.moves_nothing:
            found.setdefault(entry.element, set()).add(entry.topic)
    return found


def unique_name(wanted: str, fallback: str, taken: Iterable[str]) -> str:
    """Make a name that is not taken, of letters, digits, `_`, `.` and `-`.

    Args:
        wanted: name in the file; other characters are replaced by `_`.
        fallback: name to use if the wanted name is empty.
        taken: names that are in use; a number is appended to a name among them.
    """
    name = "".join(c if c.isascii() and (c.isalnum() or c in "_.-") else "_" for c in wanted) or fallback
    known, candidate, number = set(taken), name, 2
    while candidate in known:
        candidate, number = f"{name}_{number}", number + 1
    return candidate
