"""Python interface of `crosscheck importers`: `crosscheck.importers(path)` returns an `Importers`."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

from crosscheck.compare.outcome import Outcome
from crosscheck.differences.importers import ImporterComparison, ImportersComparison, compare_importers
from crosscheck.report.importers import report
from crosscheck.report.shown import Shown
from crosscheck.report.table import Report
from newton_euler.arguments import checked


@dataclass(frozen=True, eq=False, repr=False)
class Importers(Shown):
    """Comparison of the importers of all engines on one model file.

    Attributes:
        comparison: the complete result, with the comparison of each importer in `comparison.others`.

    Examples:
        >>> found: Importers = importers("examples/lander_leg.xml")
        >>> found.same, found["MuJoCo"].result.value, found["Pinocchio"].result.value
        (False, 'SAME', 'DIFFERENT')
    """

    comparison: ImportersComparison

    def __getitem__(self, importer: str) -> ImporterComparison:
        """Return what the importer of an engine makes of the file.

        Args:
            importer: name of the engine in texts, such as "MuJoCo" or "Pinocchio".

        Raises:
            KeyError: for an engine without an importer, or one that is not installed.
        """
        return {each.reading.importer: each for each in self.comparison.others}[importer]

    @property
    def same(self) -> bool:
        """True if all importers read the same robot."""
        return self.comparison.outcome.passes()

    @property
    def outcome(self) -> Outcome:
        """`SAME`, `SAME_TO_ROUNDING`, or `DIFFERENT`, also if an importer fails."""
        return self.comparison.outcome

    @cached_property
    def report(self) -> Report:
        """Table of importers, and for each a table of differences."""
        return report(self.comparison)


@checked
def importers(
    source: str | os.PathLike[str], *, progress: Callable[[str], None] = lambda stage: None
) -> Importers:
    """Read a model file by the importers of all installed engines and of crosscheck, and compare the robots.

    Each importer runs in its own process: a refusal or a crash of one is part of the result.

    Args:
        source: path of an MJCF or URDF file.
        progress: function that is called with a message before each stage.

    Raises:
        CrosscheckError, NewtonEulerError: for something that is no readable model file.

    Examples:
        >>> importers("examples/linkage.xml")["MuJoCo"].differences
        ()
    """
    return Importers(compare_importers(source, progress))
