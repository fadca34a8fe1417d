"""All advice on one crosscheck."""

from __future__ import annotations

from crosscheck.advice.baumgarte import baumgarte_advice
from crosscheck.advice.cost import cost_advice
from crosscheck.advice.measured import Advice, Found
from crosscheck.advice.redundancy import redundancy_advice
from crosscheck.advice.scope import scope_advice
from crosscheck.advice.soft import soft_advice
from crosscheck.comparison.runs import rests

PIECES = (scope_advice, soft_advice, redundancy_advice, baumgarte_advice, cost_advice)

FROM_EQUATIONS = (redundancy_advice,)
"""Those that do not draw on runs."""


def advise(found: Found) -> tuple[Advice, ...]:
    """Give advice on what was measured, in words; none where nothing is to be done.

    Runs in which nothing moves are no ground for any: what they are off says nothing about a motion.
    """
    pieces = FROM_EQUATIONS if rests(found.scene, found.engines, found.runs) else PIECES
    return tuple(advice for piece in pieces for advice in piece(found))
