"""Outcomes of a crosscheck: word, color and exit status of each, for the terminal, files and Python alike."""

from __future__ import annotations

from enum import IntEnum, StrEnum
from typing import assert_never

from crosscheck.report.table import Verdict


class ExitStatus(IntEnum):
    """Exit statuses of all commands."""

    AGREE = 0
    DISAGREE = 1
    BAD_INPUT = 2
    UNFINISHED = 3
    REDUCED = 4


class Outcome(StrEnum):
    """Outcome of a crosscheck; the value is the word that its verdict begins with.

    Examples:
        >>> check("pendulum").outcome is Outcome.AGREE
        True
        >>> Outcome.AGREE_ON_A_REDUCED_MODEL.exit_status(), Outcome.AGREE_ON_A_REDUCED_MODEL.passes(True)
        (<ExitStatus.REDUCED: 4>, True)
    """

    AGREE = "AGREE"
    """All checks passed, and everything in the file that acted was simulated."""
    AGREE_ON_A_REDUCED_MODEL = "AGREE ON A REDUCED MODEL"
    """All checks passed, but elements of the file acted that were not simulated as the file has them."""
    AGREE_AT_RANDOM_STATES_ONLY = "AGREE AT RANDOM STATES ONLY"
    """All checks passed, but the motion tests none of the elements."""
    AGREE_OF_SOME_ENGINES = "AGREE OF SOME ENGINES"
    """All checks passed, but an engine that was asked for cannot express the model."""
    DISAGREE = "DISAGREE"
    """A check failed."""
    UNFINISHED = "UNFINISHED"
    """An engine stopped, or a part of the comparison did."""
    ONE_ENGINE_ALONE = "ONE ENGINE ALONE"
    """Only one engine was asked for, and its own checks passed."""
    NOT_COMPARED = "NOT COMPARED"
    """Several engines were asked for, but only one can express the model."""
    SAME = "SAME"
    """Two models do not differ."""
    DIFFERENT = "DIFFERENT"
    """Two models differ."""
    QUIET = "QUIET"
    """All checks against the baselines pass."""
    QUIET_ON_A_REDUCED_MODEL = "QUIET ON A REDUCED MODEL"
    """The same, but elements of a file acted that were not simulated as the file has them."""
    MOVED = "MOVED"
    """A check against a baseline fails."""

    @property
    def judged(self) -> Verdict:
        """Color of the outcome in the terminal, in tables and on pages."""
        match self:
            case Outcome.AGREE | Outcome.SAME | Outcome.QUIET:
                return "holds"
            case (
                Outcome.AGREE_ON_A_REDUCED_MODEL
                | Outcome.AGREE_AT_RANDOM_STATES_ONLY
                | Outcome.AGREE_OF_SOME_ENGINES
                | Outcome.ONE_ENGINE_ALONE
                | Outcome.NOT_COMPARED
                | Outcome.QUIET_ON_A_REDUCED_MODEL
            ):
                return "doubtful"
            case Outcome.DISAGREE | Outcome.UNFINISHED | Outcome.DIFFERENT | Outcome.MOVED:
                return "fails"
            case _:
                assert_never(self)

    def exit_status(self, allow_reduced: bool = False) -> ExitStatus:
        """Return the exit status of a command with this outcome.

        Args:
            allow_reduced: whether agreement on a reduced model counts as agreement.
        """
        match self:
            case (
                Outcome.AGREE
                | Outcome.AGREE_AT_RANDOM_STATES_ONLY
                | Outcome.ONE_ENGINE_ALONE
                | Outcome.SAME
                | Outcome.QUIET
            ):
                return ExitStatus.AGREE
            case Outcome.AGREE_ON_A_REDUCED_MODEL | Outcome.QUIET_ON_A_REDUCED_MODEL:
                return ExitStatus.AGREE if allow_reduced else ExitStatus.REDUCED
            case Outcome.DISAGREE | Outcome.DIFFERENT | Outcome.MOVED:
                return ExitStatus.DISAGREE
            case Outcome.UNFINISHED | Outcome.AGREE_OF_SOME_ENGINES | Outcome.NOT_COMPARED:
                return ExitStatus.UNFINISHED
            case _:
                assert_never(self)

    def passes(self, allow_reduced: bool = False) -> bool:
        """Return whether tests and CI pass: the exit status is 0."""
        return self.exit_status(allow_reduced) is ExitStatus.AGREE
