"""Verification of a scene against the file that it was read from, as an independent reader holds that.

`verify` compares figure by figure, at the start and at closed states around it and far from it, all of them
moving, with springs displaced and actuators on:

1. mass properties of each body; the start, where the file's own loops close next to what it states, and how
   fast;
2. the mass matrix with loops open, bodies placed at random;
3. joints, gears and motions of the scene where the file's own equalities are closed, how fast they open where
   the file lets bodies move, and how far what the scene leaves free opens the file's equalities;
4. forces of gravity, springs, dampers and actuators apart, and armatures, as independent velocities see
   them, and forces that runs are watched for, with their limits; a difference is blamed on the element of
   the file whose own force, alone, is most like it;
5. what a system makes of the scene: poses, energies, and accelerations.

Figures are relative to what the mechanism does at all of the states together, row by row, before anything
cancels: never to what may be round-off. Tolerances are round-off of a hundred operations in a row, magnified
by the condition of the constraints. Those of motions allow for loops that do not close, too: offsets that
loops have at the start are no part of that, for scenes and files keep them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from newton_euler.equations.relative import Relative
from newton_euler.equations.system import System
from newton_euler.errors import NewtonEulerError, VerificationError, listed
from newton_euler.reading.dynamics import system_figures
from newton_euler.reading.figure import Figure, worst
from newton_euler.reading.forces import force_figures
from newton_euler.reading.import_report import ImportReport
from newton_euler.reading.model import (
    PLACES,
    body_figures,
    joint_figures,
    start_figures,
    starts_not_compared,
)
from newton_euler.reading.placed import Placed
from newton_euler.reading.reference import LOOSEST, ReferenceModel

NOT_IN_MOTION = "but for motions, which no state tells to better than {:.0e},"
"""Words where loops are next to singular or in doubt at all states; forces are compared at round-off."""

PARTS: tuple[Callable[[Placed], Iterator[Figure]], ...] = (
    body_figures,
    start_figures,
    joint_figures,
    force_figures,
    system_figures,
)


def verify(reference: ReferenceModel, system: System) -> Iterator[Figure]:
    """Compare equations of motion of a scene with the file's own.

    The first figure that does not agree tells the most: what is after it may follow from it. Nothing is
    compared after bodies that are not the file's, or that do not start where it has them.

    Raises:
        NewtonEulerError: for numbers that are not finite, and a scene that the system cannot evaluate.
    """
    unknown = sorted(set(system.mechanism.body_names[1:]) ^ set(reference.names))
    missing = [*unknown, *reference.unaccounted]
    yield Figure("elements unaccounted for", len(missing), 0.5, ", ".join(missing[:5]))
    if unknown:
        return
    try:
        with np.errstate(all="ignore"):  # what overflows is not finite, and said
            placed = Placed(reference, system)
        for part in PARTS:
            with np.errstate(all="ignore"):
                found = list(part(placed))
            yield from found
            if any(each.quantity == PLACES and not each.agrees for each in found):
                return
    except np.linalg.LinAlgError as error:
        raise NewtonEulerError(f"the scene cannot be compared with what the file says: {error}") from error


def check(report: ImportReport) -> str:
    """Verify what was read from a file, by the joint-coordinate form of its equations.

    Returns:
        A line for the report.

    Raises:
        VerificationError: naming the quantity, and the element or body, of the first figure that fails.
    """
    found = []
    for reference, scene in report.references:
        for figure in verify(reference, Relative(scene)):
            if not figure.agrees:
                raise VerificationError(*figure)
            found.append(figure)
    nearest = worst(found)
    references = [reference for reference, _ in report.references]
    samples = [sample for reference in references for sample in reference.samples]
    informative = [sample for sample in samples if sample.tells]
    moving = "moving " if any(np.any(sample.v) for sample in samples) else ""
    loosest = max((sample.tolerance_of_motion for sample in informative or samples), default=LOOSEST)
    share = nearest.value / nearest.tolerance
    at = f"{len(informative)} {moving}state{'s' * (len(informative) != 1)}"
    to = f"to {loosest:.0e} at {at}" if informative else NOT_IN_MOTION.format(loosest)
    said = (
        f"verified against the file's own model {to} in {len(found)} figures, the largest "
        f"of them {share:.0e} of its tolerance: {nearest.quantity}"
    )
    limits = []
    if blind := len(samples) - len(informative):
        limits.append(
            f"at {blind} more, next to singular configurations or with noise in loops, little shows"
        )
    if not moving:
        limits.append("nothing can move")
    elif any(len(reference.samples) == 1 for reference in references):
        limits.append("loops close nowhere but at the start")
    unknown = dict.fromkeys(name for reference in references for name in starts_not_compared(reference))
    if unknown:
        limits.append(f"the start of {listed(unknown)} is not compared, as its loops do not close")
    return "; ".join([said, *limits])
