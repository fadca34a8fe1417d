"""Faults planted in a reading of a model file, between the reading and its verification, one at a time.

The scene is that with all controls at random, in which every actuator acts. A fault that the verification
does not see has to change nothing: then poses, velocities, energies and accelerations of the scene's own
equations are the same with it.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from crosscheck.comparison.levels import compare_pair
from crosscheck.comparison.samples import Samples
from crosscheck.studies.faults.catalog import Fault
from crosscheck.studies.faults.find import MOTION, samples_of
from crosscheck.studies.faults.misreadings import EVERYTHING, misreadings
from newton_euler.equations.relative import Relative
from newton_euler.errors import NewtonEulerError
from newton_euler.verification.import_report import ImportReport
from newton_euler.verification.verify import verify


@dataclass(frozen=True)
class Outcome:
    """The outcome of a fault.

    Attributes:
        fault: what was planted.
        figure: the first quantity that fails; "refused" where no scene has the fault; "" if none does.
        where: what is blamed.
        named: whether that is the element at fault, or a body that the joint at fault connects.
        moves: whether the fault changes any motion; True where it is seen.
    """

    fault: Fault
    figure: str
    where: str
    named: bool
    moves: bool

    @property
    def missed(self) -> bool:
        """True if it changes what moves, and is not seen."""
        return self.moves and not self.figure


def find_in_reading(
    report: ImportReport, progress: Callable[[str], None], faults: Sequence[Fault] | None = None
) -> list[Outcome]:
    """Plant faults, all that there are if None are given, one at a time, and verify the scene with each."""
    original, scene = report.originals[-1]
    own: list[Samples] = []
    outcomes = []
    faults = list(misreadings(scene)) if faults is None else faults
    for number, fault in enumerate(faults):
        progress(f"{number} of {len(faults)} faults: {fault.name}")
        try:
            planted = fault.plant(scene)
            failing = next((f for f in verify(original, Relative(planted)) if not f.agrees), None)
        except NewtonEulerError as error:
            outcomes.append(Outcome(fault, "refused", str(error), fault.element in str(error), True))
            continue
        if failing is None:
            own = own or [samples_of(scene)]
            wrong = [Samples(Relative(planted), own[0].states)]
            rows = compare_pair(("right", "wrong"), own, wrong, MOTION)
            moves = any(not (row.agrees or row.quantity.startswith("reaction")) for row in rows)
            outcomes.append(Outcome(fault, "", "", False, moves))
            continue
        named = any(_is_named(element, failing.where, report) for element in fault.right | fault.near)
        outcomes.append(Outcome(fault, failing.quantity, failing.where, named, True))
    return outcomes


def _is_named(element: str, where: str, report: ImportReport) -> bool:
    """True if the blamed element is this one, or one of the file's that became it."""
    if element in (where, EVERYTHING) or repr(element) in where:
        return True
    told = where.split(":")[0]
    return any(entry.element == told and repr(element) in entry.how for entry in report.entries)


def reading_lines(path: str, found: Sequence[Outcome]) -> Iterator[str]:
    """Lines on faults: counts by the figure that shows them, those missed, those that change nothing."""
    for figure, count in Counter(outcome.figure for outcome in found if outcome.figure).most_common():
        yield f"{count} seen by {figure}"
    for outcome in found:
        if outcome.missed:
            yield f"missed: {outcome.fault.name}"
        elif outcome.figure and not outcome.named:
            yield f"blamed elsewhere: {outcome.fault.name}: {outcome.figure} at {outcome.where}"
    idle = Counter((outcome.fault.kind, outcome.fault.detail) for outcome in found if not outcome.moves)
    for (kind, detail), count in idle.items():
        yield f"{count} without any effect on motion: {kind} {detail}"
    moving = [outcome for outcome in found if outcome.moves]
    seen = [outcome for outcome in moving if outcome.figure]
    named = sum(outcome.named for outcome in seen)
    word = "FOUND" if len(seen) == len(moving) else "MISSED"
    yield (
        f"{word}: of {len(moving)} faults in the reading of {path} that change its motion {len(seen)} are "
        f"seen, {named} with their element named"
    )
