"""Verify an imported scene against the same file as an independent parser compiles it.

`verify` compares the scene with a `ReferenceModel` at the start, and at moving states with closed loops near
the start and far from it. Springs are deflected and actuators act. The checks are, in this order:

1. mass properties of each body, and the mass matrix with open loops, at random configurations;
2. the start: loop closure, pose and velocities nearest to the file's;
3. joints, gears and motions: the scene's joints at motions of the file, and the file's constraints at motions
   that the scene leaves free;
4. gravity, springs, dampers, actuators and armatures separately, in independent velocities, and forces with
   limits. A difference is attributed to the element of the file whose force alone explains it best;
5. the equations of motion: poses, energies and accelerations.

A difference of two sums is divided by the largest sum of the magnitudes of the terms at any state. Tolerances
are round-off (`READING_ROUND_OFF`, 1e-12) times the condition number of the constraints. Tolerances of
motions include the remaining loop-closure error. They do not include the offset by which rounded digits in
the file leave a loop open at the start, because scene and reference model keep this offset.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from newton_euler.equations.relative import Relative
from newton_euler.equations.system import System
from newton_euler.errors import NewtonEulerError, VerificationError, listed
from newton_euler.reading.checks import ReadingCheck, closest_to_failing
from newton_euler.reading.dynamics import system_checks
from newton_euler.reading.forces import force_checks
from newton_euler.reading.import_report import ImportReport
from newton_euler.reading.model import (
    CENTER_CHECK,
    body_checks,
    joint_checks,
    start_checks,
    starts_not_compared,
)
from newton_euler.reading.placement import ScenePlacement
from newton_euler.reading.reference import MAX_USEFUL_TOLERANCE, ReferenceModel

CHECK_GROUPS: tuple[Callable[[ScenePlacement], Iterator[ReadingCheck]], ...] = (
    body_checks,
    start_checks,
    joint_checks,
    force_checks,
    system_checks,
)
"""Functions that yield the checks, in the order of the list above."""


def verify(reference: ReferenceModel, system: System) -> Iterator[ReadingCheck]:
    """Compare equations of motion of a scene with the reference model of its file.

    The first check that fails is the most informative: later failures may follow from the first one. The
    comparison ends early if scene and file have different bodies, or bodies with other initial positions.

    Args:
        reference: model of the file.
        system: equations of motion of the scene.

    Yields:
        The checks in the order of the module's list.

    Raises:
        NewtonEulerError: for numbers that are not finite, and a scene that the system cannot evaluate.
    """
    # Bodies that only the scene or only the file has, and elements that neither scene nor report mentions
    unmatched = sorted(set(system.mechanism.body_names[1:]) ^ set(reference.names))
    missing = [*unmatched, *reference.unaccounted]
    # A tolerance of 0.5 allows no missing element
    yield ReadingCheck("elements unaccounted for", len(missing), 0.5, ", ".join(missing[:5]))
    if unmatched:
        return
    try:
        with np.errstate(all="ignore"):  # a check reports numbers that overflow
            placed = ScenePlacement(reference, system)  # the scene's bodies at the poses of the reference
        for check_group in CHECK_GROUPS:
            with np.errstate(all="ignore"):
                found = list(check_group(placed))
            yield from found
            if any(each.quantity == CENTER_CHECK and not each.agrees for each in found):
                return
    except np.linalg.LinAlgError as error:
        raise NewtonEulerError(f"the scene cannot be compared with its file: {error}") from error


def verify_report(report: ImportReport) -> str:
    """Verify all scenes of an import report, with equations of motion in joint coordinates.

    Returns:
        A line for the report: number of checks, precision, and what could not be compared.

    Raises:
        VerificationError: for the first check that fails, with quantity and element.
    """
    found = []
    for reference, scene in report.references:
        for check in verify(reference, Relative(scene)):
            if not check.agrees:
                raise VerificationError(check.quantity, check.value, check.tolerance, check.where)
            found.append(check)
    # Precision: the largest tolerance of motions at the informative states, whose tolerances are small enough
    # to show mistakes
    nearest = closest_to_failing(found)
    references = [reference for reference, _ in report.references]
    samples = [sample for reference in references for sample in reference.samples]
    informative = [sample for sample in samples if sample.is_informative]
    moving = "moving " if any(np.any(sample.v) for sample in samples) else ""
    loosest = max(
        (sample.tolerance_of_motion for sample in informative or samples), default=MAX_USEFUL_TOLERANCE
    )
    percentage = 100.0 * (nearest.value / nearest.tolerance)
    states = f"{len(informative)} {moving}state{'s' * (len(informative) != 1)}"
    precision = (
        f"to {loosest:.0e} at {states}"
        if informative
        else f"except for motions, known at no state to better than {loosest:.0e},"
    )
    summary = (
        f"verified against the file's own model {precision} in {len(found)} checks, the closest to "
        f"failing at {percentage:.2g} % of its tolerance: {nearest.quantity}"
    )
    # Limits of the verification
    limits = []
    if uninformative := len(samples) - len(informative):
        limits.append(
            f"{uninformative} more states are next to singular configurations or have rounded loops, "
            "and test little"
        )
    if not moving:
        limits.append("nothing can move")
    elif any(len(reference.samples) == 1 for reference in references):
        limits.append("loops close at the start alone")
    open_joints = dict.fromkeys(name for reference in references for name in starts_not_compared(reference))
    if open_joints:
        limits.append(f"the start of {listed(open_joints)} is not compared, because its loops do not close")
    return "; ".join([summary, *limits])
