"""Comparison of what the importers of engines make of one model file.

In: the path of an MJCF or URDF file. Out: the reading of one importer, crosscheck's own if it reads the file,
and an `ImporterComparison` with it for each other importer. An importer leaves out what its documentation
excludes, such as actuators. This is told apart from faults.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

from crosscheck.compare.outcome import Outcome
from crosscheck.differences.difference import Difference, Quantity, Standing
from crosscheck.differences.motion import Likeness
from crosscheck.differences.result import FileComparison, compare_files
from crosscheck.engines.engine import ImporterLimit
from crosscheck.loading.importers import Failure, Reading, importers, read_by_all
from newton_euler.reading.robot import LoopKind, Robot

ROUND_OFF = 1e-6
"""Relative difference of numbers and accelerations, and gap of loops (m, rad), that count as rounding.
Vertices of meshes have single precision, 6e-8."""

DRIVES = "drive"
"""Kind of the elements that stand for actuators, see `Difference.element_kind`."""


GROUND = "ground"
"""Kind of the bodies that are fixed to the ground."""


@dataclass(frozen=True, eq=False)
class ImporterComparison:
    """Comparison of an importer's reading of a file with the reference reading.

    Attributes:
        reading: the importer's reading.
        comparison: of the reference reading, the first, with the importer's, the second; None if the importer
            fails. The first has no drives if the importer leaves out drives.
        limit: documented limit of the importer for files of this format; None without one.
        drives_left_out: number of drives that the importer leaves out by its documented limit.
    """

    reading: Reading
    comparison: FileComparison | None
    limit: ImporterLimit | None
    drives_left_out: int

    @property
    def differences(self) -> tuple[Difference, ...]:
        """True differences beside documented limits, the largest effect on motion first."""
        rows = self.comparison.differences if self.comparison else ()
        return tuple(row for row in rows if not self._is_limit(row))

    @property
    def left_out(self) -> tuple[Difference, ...]:
        """Elements that the importer leaves out by its documented limit, beside drives."""
        rows = self.comparison.rows if self.comparison else ()
        return tuple(row for row in rows if self._is_limit(row))

    @property
    def result(self) -> Outcome | Failure:
        """Failure of the importer, or the outcome of the comparison: limits without effect are `SAME`."""
        if self.comparison is None:
            assert self.reading.failure
            return self.reading.failure
        motion = self.comparison.motion
        is_rounding = (
            max([motion.change, *(gap.error for gap in motion.gaps)]) < ROUND_OFF
            and motion.freedoms[0] == motion.freedoms[1]
        )
        if not self.differences and motion.likeness is Likeness.DIFFERENT and is_rounding:
            return Outcome.SAME_TO_ROUNDING
        if not self.differences and self.left_out and motion.likeness is not Likeness.DIFFERENT:
            return Outcome.SAME
        if self.comparison.outcome is Outcome.UNFINISHED:
            # importers that take the same numbers from one file read the same robot
            is_rounded = self.comparison.of_standing(Standing.ROUNDING)
            return Outcome.SAME_TO_ROUNDING if is_rounded else Outcome.SAME
        return self.comparison.outcome

    def summary(self) -> dict[str, Any]:
        """All numbers, for JSON."""
        return {
            "importer": self.reading.importer,
            "result": self.result.value,
            "message": self.reading.message,
            "drives_left_out": self.drives_left_out,
            "left_out": [asdict(row) for row in self.left_out],
            **(self.comparison.numbers() if self.comparison else {}),
        }

    def _is_limit(self, row: Difference) -> bool:
        """Return whether a row is about something that the importer leaves out by its documentation."""
        kind = row.element_kind if row.quantity is Quantity.PRESENCE else row.quantity
        if kind == "body" and self.comparison and row.element in _on_ground(self.comparison.first.robot):
            kind = GROUND
        is_known = kind == "loop" and row.first == LoopKind.POINT
        is_lost = row.first is not None and row.second in (None, 0.0)
        return self.limit is not None and is_lost and kind in self.limit.kinds and not is_known


def _on_ground(robot: Robot) -> set[str]:
    """Return the names of the bodies that are fixed to the ground; parents come before their children."""
    fixed: set[str] = set()
    grounded = {-1}
    for number, body in enumerate(robot.bodies):
        if body.parent in grounded and not body.joints:
            grounded.add(number)
            fixed.add(body.name)
    return fixed


@dataclass(frozen=True, eq=False)
class ImportersComparison:
    """Comparison of the importers of all engines on one file.

    Attributes:
        source: path of the file.
        reference: reading with which the others are compared: crosscheck's, or that of the first other
            importer that reads the file; None if none does.
        others: comparison of each other importer.
    """

    source: str
    reference: Reading | None
    others: tuple[ImporterComparison, ...]

    @property
    def outcome(self) -> Outcome:
        """`SAME`, `SAME_TO_ROUNDING`, or `DIFFERENT`, also if an importer fails."""
        results = [each.result for each in self.others]
        if set(results) <= {Outcome.SAME, Outcome.SAME_TO_ROUNDING}:
            return Outcome.SAME if set(results) == {Outcome.SAME} else Outcome.SAME_TO_ROUNDING
        return Outcome.DIFFERENT

    def summary(self) -> dict[str, Any]:
        """All numbers, for JSON."""
        return {
            "source": self.source,
            "outcome": self.outcome.value,
            "reference": self.reference.importer if self.reference else None,
            "importers": [each.summary() for each in self.others],
        }


def compare_importers(source: str | os.PathLike[str], progress: Callable[[str], None]) -> ImportersComparison:
    """Read a file by all importers, and compare their readings with the reference reading.

    Args:
        source: path of an MJCF or URDF file.
        progress: shows a message to the user.

    Raises:
        CrosscheckError, SourceError: for something that is no readable file with the suffix of such a file.
    """
    progress("reading the file by all importers")
    readings = read_by_all(source)
    progress("comparing what they read")
    reference = next((reading for reading in readings if reading.file), None)
    others = [reading for reading in readings if reading is not reference]
    format = "URDF" if os.fspath(source).lower().endswith(".urdf") else "MJCF"
    compared = tuple(_compared(reference, other, _limit(other.importer, format)) for other in others)
    return ImportersComparison(os.fspath(source), reference, compared)


def _limit(importer: str, format: str) -> ImporterLimit | None:
    """Return the documented limit of an importer for files of a format; None without one."""
    engine = importers().get(importer)
    return engine.importer.limits.get(format) if engine and engine.importer else None


def _compared(reference: Reading | None, other: Reading, limit: ImporterLimit | None) -> ImporterComparison:
    """Compare an importer's reading with the reference reading."""
    if reference is None or reference.file is None or other.file is None:
        return ImporterComparison(other, None, None, 0)
    file, drives = reference.file, 0
    if limit and DRIVES in limit.kinds:
        # without its drives, so that their limits do not count as efforts of joints
        file, drives = replace(file, robot=replace(file.robot, drives=())), len(file.robot.drives)
    comparison = compare_files(file, other.file, {}, ROUND_OFF, lambda stage: None)
    return ImporterComparison(other, comparison, limit, drives)
