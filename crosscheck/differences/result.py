"""Result of a comparison of two model files: what differs, and whether the robots move alike."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from crosscheck.compare.outcome import Outcome
from crosscheck.differences.alignment import Alignment, align
from crosscheck.differences.causes import LACKING
from crosscheck.differences.common_states import ROUND_OFF, CommonStates, common_states
from crosscheck.differences.difference import Difference, Quantity, Standing
from crosscheck.differences.effects import effects
from crosscheck.differences.evidence import with_evidence
from crosscheck.differences.frames import common_frames
from crosscheck.differences.geometry import geometry_rows
from crosscheck.differences.loop_cuts import with_same_cuts
from crosscheck.differences.motion import Likeness, Motion, compare_motions
from crosscheck.differences.rows import differences
from crosscheck.differences.run import Run, run_both
from crosscheck.differences.shapes import shapes
from crosscheck.differences.unnamed import with_names
from crosscheck.loading.robots import describe_model, describe_shapes
from newton_euler.reading.file_shapes import FileShapes
from newton_euler.reading.robot import Robot, RobotFile

if TYPE_CHECKING:
    from crosscheck.loading.load import Model

RANK = {standing: place for place, standing in enumerate(Standing)}
"""Order of rows: true differences first."""


@dataclass(frozen=True, eq=False)
class FileComparison:
    """Comparison of two model files.

    Attributes:
        first, second: the files.
        alignment: pairs of their bodies and joints.
        rows: what differs: true differences, the largest effect on motion first and those of shapes last,
            then rounding, then conventions.
        motion: whether the robots move alike.
        states: common states of both robots; None for robots without joints in common.
        tolerance: relative difference that counts as rounding; None for the digits of the files.
    """

    first: RobotFile
    second: RobotFile
    alignment: Alignment
    rows: tuple[Difference, ...]
    motion: Motion
    states: CommonStates | None
    tolerance: float | None = None

    def of_standing(self, standing: Standing) -> tuple[Difference, ...]:
        """Return the rows that are true differences, rounding, or conventions."""
        return tuple(row for row in self.rows if row.standing is standing)

    @property
    def differences(self) -> tuple[Difference, ...]:
        """True differences, the largest effect on motion first."""
        return self.of_standing(Standing.DIFFERENT)

    @property
    def outcome(self) -> Outcome:
        """`SAME`, `SAME_TO_ROUNDING` if only the digits of the files differ, or `DIFFERENT`.

        `UNFINISHED` if the numbers are the same, but the motions could not be compared.
        """
        # with a tolerance, other motion may be the effect of numbers that differ by less
        is_allowed = self.tolerance is not None and self.of_standing(Standing.ROUNDING)
        moves_differently = self.motion.likeness is Likeness.DIFFERENT and not is_allowed
        if moves_differently or self.differences:
            return Outcome.DIFFERENT
        if self.motion.likeness is Likeness.UNDECIDED and self._can_move and not self._is_one_text:
            return Outcome.UNFINISHED
        is_rounded = self.motion.likeness is Likeness.ROUNDING or self.of_standing(Standing.ROUNDING)
        return Outcome.SAME_TO_ROUNDING if is_rounded else Outcome.SAME

    @property
    def unmodeled(self) -> tuple[str, ...]:
        """Elements of either file whose forces are in no motion that was compared."""
        return tuple(dict.fromkeys((*self.first.robot.unmodeled, *self.second.robot.unmodeled)))

    @property
    def prescribed(self) -> tuple[str, ...]:
        """Joint coordinates whose motion either file prescribes; they move freely in compared motions."""
        return tuple(dict.fromkeys((*self.first.robot.prescribed, *self.second.robot.prescribed)))

    @property
    def _can_move(self) -> bool:
        """True if one of the robots has joints."""
        return any(body.joints for file in (self.first, self.second) for body in file.robot.bodies)

    @cached_property
    def _is_one_text(self) -> bool:
        """True if both files have the same content, so that the robots move alike."""
        paths = [Path(file.source) for file in (self.first, self.second) if file.source]
        return len(paths) == 2 and paths[0].read_bytes() == paths[1].read_bytes()

    @cached_property
    def run(self) -> Run | None:
        """Distance of the bodies in a run from the same start.

        None for robots without common states, and for robots with prescribed motions, which the run would
        leave out. The robots run at the first use, since a comparison of importers shows no run.
        """
        return None if self.prescribed else run_both(self.states, self.motion)

    def with_geometry(self, shapes: tuple[FileShapes, FileShapes]) -> FileComparison:
        """Return the comparison with the rows of the shapes of both files after its own."""
        common = common_frames(self.first, self.second, self.alignment, self.tolerance)
        rows = sorted((*self.rows, *geometry_rows(common, shapes)), key=lambda row: RANK[row.standing])
        first, second = (
            replace(file, notes=(*file.notes, *each.notes))
            for file, each in zip((self.first, self.second), shapes, strict=True)
        )
        return replace(self, first=first, second=second, rows=tuple(rows))

    def summary(self) -> dict[str, Any]:
        """All numbers, for JSON."""
        files = [
            {"source": each.source, "format": each.format, "notes": list(each.notes)}
            for each in (self.first, self.second)
        ]
        return {
            "outcome": self.outcome.value,
            "models": files,
            **self.numbers(),
            "shapes": asdict(
                shapes((self.first, self.second), self.alignment, self.states, self.differences)
            ),
            "run": asdict(self.run) if self.run else None,
        }

    def numbers(self) -> dict[str, Any]:
        """Rows, motion, and pairs of other names, for JSON."""
        return {
            "differences": [asdict(row) | {"standing": row.standing.value} for row in self.rows],
            "motion": asdict(self.motion),
            "unmodeled": list(self.unmodeled),
            "renamed": [list(names) for names in self.alignment.renamed],
        }


def compare_models(
    models: tuple[Model, Model],
    options: tuple[Mapping[str, str], Mapping[str, str]],
    names: Mapping[str, str],
    tolerance: float | None,
    progress: Callable[[str], None],
    geometry: bool = False,
) -> FileComparison:
    """Read two models of any kind, and compare them.

    Args:
        models: the models, see `crosscheck.loading.robots.describe_model`.
        options: options of each model.
        names, tolerance, progress: see `compare_files`.
        geometry: whether the shapes of bodies are compared, too.

    Raises:
        CrosscheckError, NewtonEulerError: for a model, a name or an option that cannot be used.
    """
    progress("reading the files")
    first, second = (describe_model(*each) for each in zip(models, options, strict=True))
    found = compare_files(first, second, names, tolerance, progress)
    if not geometry:
        return found
    progress("comparing shapes")
    one, two = (describe_shapes(*each) for each in zip(models, options, strict=True))
    return found.with_geometry((one, two))


def compare_files(
    first: RobotFile,
    second: RobotFile,
    names: Mapping[str, str],
    tolerance: float | None,
    progress: Callable[[str], None],
) -> FileComparison:
    """Compare two model files.

    Args:
        first, second: the files.
        names: names of bodies or joints of the first file, and of their partners in the second.
        tolerance: relative difference that counts as rounding, instead of the digits of the files; None for
            the digits.
        progress: shows a message to the user.

    Raises:
        CrosscheckError: for a name that a file does not have.
    """
    progress("pairing bodies and joints")
    alignment = align(first.robot, second.robot, names)
    if cuts := with_same_cuts(first, second, alignment):
        first, second = cuts.first, cuts.second
        alignment = align(first.robot, second.robot, names)
    first, second = with_names(first), with_names(second)
    progress("comparing numbers")
    rows = differences(first, second, alignment, tolerance)
    if cuts:
        rows = [*cuts.judged(rows, alignment), cuts.row()]
    progress("comparing motions")
    states = common_states(first, second, alignment)
    motion = compare_motions(states)
    formats = first.format, second.format
    found = effects(states, rows)
    rows = [replace(row, effect=effect) for row, effect in zip(rows, found, strict=True)]
    if motion.likeness in (Likeness.EQUAL, Likeness.ROUNDING):
        # a loop of one file and couplings of the other that allow the same motion
        rows = [replace(row, convention=row.convention or _is_constraint(row)) for row in rows]
        regrouped = _regrouped(first.robot, second.robot, alignment)
        rows = [_without_effect(row, regrouped) for row in rows]
    rows = [replace(row, convention=row.convention or _is_unsaid(row, formats)) for row in rows]
    rows = with_evidence(rows, (first, second), alignment)
    # rows without a known effect, such as limits, after those with one
    rows.sort(key=lambda row: (RANK[row.standing], 1.0 if row.effect is None else -row.effect))
    return FileComparison(first, second, alignment, tuple(rows), motion, states, tolerance)


def _is_constraint(row: Difference) -> bool:
    """Return whether a row is about a loop or coupling of one file only, or a loop of another kind."""
    return row.quantity in (Quantity.PRESENCE, Quantity.KIND) and row.element_kind in ("loop", "coupling")


def _regrouped(first: Robot, second: Robot, alignment: Alignment) -> set[tuple[str, ...]]:
    """Return the names of groups of joints of the first robot that allow the same motions as in the second.

    They do if the motions are equal, and no joint has what is in no compared motion: limits, dry friction.
    """
    found = set()
    for group in alignment.groups:
        joints = [first.joint(key) for key in group.first] + [second.joint(key) for key in group.second]
        if not any(joint.friction or np.isfinite([*joint.limits, *joint.effort]).any() for joint in joints):
            found.add(tuple(first.joint(key).name for key in group.first))
    return found


def _without_effect(row: Difference, regrouped: set[tuple[str, ...]]) -> Difference:
    """Return a row of robots of equal motions as a convention if it changes nothing at all.

    Args:
        row: the row.
        regrouped: names of groups of joints that allow the same motions in both files.
    """
    if row.quantity is Quantity.KIND and row.element_kind == "joint" and row.elements in regrouped:
        return replace(row, convention=True, effect=0.0, cause=row.cause or "the same motions are free")
    is_light = row.size <= ROUND_OFF and row.effect is not None and row.effect <= ROUND_OFF
    if row.quantity is Quantity.PRESENCE and row.element_kind == "body" and is_light:
        return replace(row, convention=True, cause=row.cause or "too light to change the motion")
    return row


def _is_unsaid(row: Difference, formats: tuple[str, str]) -> bool:
    """Return whether a row is about a number that one of the formats cannot state, without effect on motion.

    A URDF has no drives, for instance, and an MJCF no limits of speed.
    """
    lacking = formats[0] if row.first in (None, 0.0) else formats[1]
    is_drive = row.quantity is not Quantity.PRESENCE or row.element_kind == "drive"
    return row.quantity in LACKING.get(lacking, ()) and is_drive and not row.effect
