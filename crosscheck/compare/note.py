"""Notes below the verdict of a crosscheck; each begins with words that `crosscheck explain` knows."""

from __future__ import annotations

from enum import StrEnum


class Note(StrEnum):
    """Beginning of a note, without further words such as names of elements."""

    STARTS_SINGULAR = "starts in a singular configuration"
    PASSES_SINGULAR = "passes a singular configuration"
    FINDING = "finding"
    START_MOVED = "the start is not the file's"
    ACTIVE = "active and not simulated"
    EXCITATION_ACTS = "the excitation may be the cause"
    NOT_EXAMINED = "not examined whether they act"
    NOTHING_MOVES = "nothing moves"
    NEARLY_REDUNDANT = "nearly redundant"
    NO_FREEDOM = "no degree of freedom"
    IMPOSSIBLE_INERTIA = "impossible inertia"
    BY_RUNS_ONLY = "compared by runs only"
    NOT_COMPARED = "not compared after"
    UNTESTED = "untested by the motion"
    UNTESTED_CODE = "untested as all engines call the same code"
    FILE = "the file"
    NOT_UNIQUE = "reactions not unique"
    STIFF = "stiff"
    START = "start"
    INACTIVE = "inactive in this run"
    ADVICE = "advice"
