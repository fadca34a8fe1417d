"""Python interface of `crosscheck diff`: `crosscheck.diff(first, second)` returns a `Diff`."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from crosscheck.compare.outcome import Outcome
from crosscheck.differences.difference import Difference
from crosscheck.differences.motion import Motion
from crosscheck.differences.result import FileComparison, compare_models
from crosscheck.differences.run import Run
from crosscheck.report.diff import report
from crosscheck.report.shown import Shown
from crosscheck.report.table import Report
from newton_euler.arguments import checked
from newton_euler.errors import OptionError

if TYPE_CHECKING:
    from crosscheck.loading.load import Model


@dataclass(frozen=True, eq=False, repr=False)
class Diff(Shown):
    """Comparison of two model files.

    Attributes:
        comparison: the complete result.

    Examples:
        >>> found: Diff = diff("examples/linkage.xml", "examples/linkage.xml")
        >>> found.same, found.motion.change
        (True, 0.0)
    """

    comparison: FileComparison

    @property
    def same(self) -> bool:
        """True if no number or motion differs by more than the digits of the files leave open."""
        return self.comparison.outcome.passes()

    @property
    def outcome(self) -> Outcome:
        """`SAME`, `SAME_TO_ROUNDING`, `DIFFERENT`, or `UNFINISHED` if motions could not be compared."""
        return self.comparison.outcome

    @property
    def differences(self) -> tuple[Difference, ...]:
        """Differences beyond rounding, the largest effect on motion first."""
        return self.comparison.differences

    @property
    def motion(self) -> Motion:
        """Comparison of the motions: the largest difference of accelerations, with body and uncertainty."""
        return self.comparison.motion

    @property
    def run(self) -> Run | None:
        """Largest distance of a body in a run from the same start; None without common states."""
        return self.comparison.run

    @cached_property
    def report(self) -> Report:
        """Table of differences, and notes."""
        return report(self.comparison)


@checked
def diff(
    first: Model,
    second: Model,
    *,
    names: Mapping[str, str] | None = None,
    tolerance: float | None = None,
    geometry: bool = False,
    first_options: Mapping[str, str] | None = None,
    second_options: Mapping[str, str] | None = None,
    progress: Callable[[str], None] = lambda stage: None,
) -> Diff:
    """Compare two model files of one robot: what differs, and does it change the motion.

    A number is as exact as it is written: 0.12345678 means 0.123456775 to 0.123456785. Numbers with fewer
    than six digits count as if they had six: 0.25 means 0.2499995 to 0.2500005.

    Args:
        first, second: paths of MJCF, URDF or scene files, an `MjSpec` or `MjModel` of MuJoCo, a `Model` of
            Pinocchio, alone or paired with its constraints, or a `Scene`.
        names: names of bodies or joints of the first file, and of their partners in the second. Others are
            found by names and structure.
        tolerance: relative difference that counts as rounding, such as 1e-3, instead of the digits of the
            files.
        geometry: whether shapes of bodies are compared, too. No compared motion has contacts, so that shapes
            do not change it. Scenes and models of Pinocchio have no shapes to compare.
        first_options, second_options: options of each model, such as `loops`, the loop file of a URDF.
        progress: function that is called with a message before each stage.

    Raises:
        CrosscheckError, NewtonEulerError: for a model, a name or an option that cannot be used.

    Examples:
        >>> found = diff("examples/linkage.xml", "examples/linkage.xml")
        >>> found.same, len(found.differences)
        (True, 0)
    """
    if tolerance is not None and not 0.0 <= tolerance < 1.0:
        raise OptionError("tolerance", tolerance, "a number from 0 to below 1")
    options = first_options or {}, second_options or {}
    return Diff(compare_models((first, second), options, names or {}, tolerance, progress, geometry))
