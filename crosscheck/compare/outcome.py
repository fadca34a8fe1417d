"""Outcomes of commands, such as AGREE or DISAGREE, with the word, the color and the exit status of each.

A crosscheck simulates one model in several engines and compares them. A comparison of files compares two
models, and a regression test compares results with stored baselines. "Reduced model": some elements of the
model file, such as contacts, would have acted in the run but are not simulated. A report prints its result in
one line, the verdict, which begins with the outcome.
"""

from __future__ import annotations

from enum import IntEnum, StrEnum
from typing import Literal, assert_never

Verdict = Literal["", "holds", "improved", "doubtful", "fails"]
"""Judgment of an outcome or of a table cell in reports, which selects a color; "" for none. "improved" is a
cost or an error below the baseline."""


class ExitStatus(IntEnum):
    """Exit statuses of all commands."""

    AGREE = 0
    """All checks passed, or the command without checks succeeded."""
    DISAGREE = 1
    """A check failed."""
    BAD_INPUT = 2
    """The input or the options are invalid."""
    UNFINISHED = 3
    """Not all that was asked for was compared."""
    REDUCED = 4
    """All checks passed, but elements of the file acted that were not simulated."""
    INACCURATE = 5
    """All checks passed, but the error of a run with the time step and solver of the file exceeds a limit."""


class Outcome(StrEnum):
    """Outcome of a crosscheck; the value is the text with which the verdict begins.

    Examples:
        >>> from crosscheck import check
        >>> check("pendulum").outcome is Outcome.AGREE  # simulate a library scene in all engines
        True
        >>> Outcome.AGREE_ON_A_REDUCED_MODEL.exit_status(), Outcome.AGREE_ON_A_REDUCED_MODEL.passes(True)
        (<ExitStatus.REDUCED: 4>, True)
    """

    AGREE = "AGREE"
    """All checks passed, and everything in the file that acted was simulated."""
    AGREE_ON_A_REDUCED_MODEL = "AGREE ON A REDUCED MODEL"
    """All checks passed, but elements of the file acted that were not simulated as in the file."""
    AGREE_AT_RANDOM_STATES_ONLY = "AGREE AT RANDOM STATES ONLY"
    """All checks passed, but the compared motion tests nothing: a change of any one element (mass, joint,
    spring) by 10 % would not show. Equations were compared at random states."""
    AGREE_OF_SOME_ENGINES = "AGREE OF SOME ENGINES"
    """All checks passed, but a requested engine cannot represent the model, or is not compared."""
    DISAGREE = "DISAGREE"
    """A check failed."""
    INACCURATE = "INACCURATE"
    """All checks passed, but a run with the time step and solver of the file deviates from the reference
    solution by more than the user allows."""
    UNFINISHED = "UNFINISHED"
    """An engine or a part of the comparison stopped before its end."""
    ONE_ENGINE_ALONE = "ONE ENGINE ALONE"
    """Only one engine was requested, and the checks of its own run, such as energy balance, passed."""
    NOT_COMPARED = "NOT COMPARED"
    """Several engines were requested, but only one can represent the model, or no check compares them."""
    SAME = "SAME"
    """Two models do not differ."""
    SAME_TO_ROUNDING = "SAME TO ROUNDING"
    """Two models differ by no more than the digits of their files leave open."""
    DIFFERENT = "DIFFERENT"
    """Two models differ."""
    QUIET = "QUIET"
    """All checks against the baselines passed."""
    QUIET_ON_A_REDUCED_MODEL = "QUIET ON A REDUCED MODEL"
    """All checks against the baselines passed, but elements of the file acted that were not simulated."""
    QUIET_OF_SOME_ENGINES = "QUIET OF SOME ENGINES"
    """All checks against the baselines passed, but an engine of a baseline is not installed."""
    MOVED = "MOVED"
    """A check against a baseline failed."""

    @property
    def judged(self) -> Verdict:
        """Judgment of the outcome, which selects its color in the terminal, in tables and on pages."""
        match self:
            case Outcome.AGREE | Outcome.SAME | Outcome.SAME_TO_ROUNDING | Outcome.QUIET:
                return "holds"
            case (
                Outcome.AGREE_ON_A_REDUCED_MODEL
                | Outcome.AGREE_AT_RANDOM_STATES_ONLY
                | Outcome.AGREE_OF_SOME_ENGINES
                | Outcome.ONE_ENGINE_ALONE
                | Outcome.NOT_COMPARED
                | Outcome.QUIET_ON_A_REDUCED_MODEL
                | Outcome.QUIET_OF_SOME_ENGINES
            ):
                return "doubtful"
            case (
                Outcome.DISAGREE | Outcome.INACCURATE | Outcome.UNFINISHED | Outcome.DIFFERENT | Outcome.MOVED
            ):
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
                | Outcome.SAME_TO_ROUNDING
                | Outcome.QUIET
            ):
                return ExitStatus.AGREE
            case Outcome.AGREE_ON_A_REDUCED_MODEL | Outcome.QUIET_ON_A_REDUCED_MODEL:
                return ExitStatus.AGREE if allow_reduced else ExitStatus.REDUCED
            case Outcome.DISAGREE | Outcome.DIFFERENT | Outcome.MOVED:
                return ExitStatus.DISAGREE
            case Outcome.INACCURATE:
                return ExitStatus.INACCURATE
            case (
                Outcome.UNFINISHED
                | Outcome.AGREE_OF_SOME_ENGINES
                | Outcome.NOT_COMPARED
                | Outcome.QUIET_OF_SOME_ENGINES
            ):
                return ExitStatus.UNFINISHED
            case _:
                assert_never(self)

    def passes(self, allow_reduced: bool = False) -> bool:
        """Return True if the exit status is 0, so that tests and CI pass.

        Args:
            allow_reduced: whether agreement on a reduced model counts as agreement.
        """
        return self.exit_status(allow_reduced) is ExitStatus.AGREE
