"""Names with which lines of the terminal's output of `crosscheck run` begin, beside those of `Note`."""

from __future__ import annotations

from enum import StrEnum


class LineName(StrEnum):
    """First word or words of a line; `crosscheck explain` explains each."""

    YOUR_SETTINGS = "your settings"
    USUAL_SETTINGS = "usual settings"
    WITHOUT = "without"
    RUN = "run"
    MOTION = "motion"
    STOPPED = "stopped"
    ERRORS = "errors"
    MISTAKE = "mistake"
    ALLOWED = "allowed"
    NOTE = "note"
    CAUSE = "cause"
    MODE = "mode"
    FIX = "fix"
    WORST_OF = "worst of"
    EXCITED = "excited"
    STARTS_FROM = "starts from"
    WHY = "why"
    LOOK = "look"
    MORE = "more"

    def line(self, text: str) -> str:
        """Return an indented line of a judgement that begins with this name."""
        return f"  {self:<7} {text}"

    @staticmethod
    def continued(text: str) -> str:
        """Return a line that continues the one above it, with its text below that text."""
        return f"{'':<9} {text}"
