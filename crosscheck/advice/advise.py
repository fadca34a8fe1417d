"""All advice on one crosscheck."""

from __future__ import annotations

from crosscheck.advice.baumgarte import baumgarte_advice
from crosscheck.advice.cost import cost_advice
from crosscheck.advice.measured import Advice, Found
from crosscheck.advice.redundancy import redundancy_advice
from crosscheck.advice.soft import soft_advice

PIECES = (soft_advice, redundancy_advice, baumgarte_advice, cost_advice)


def advise(found: Found) -> tuple[Advice, ...]:
    """What to do about what was measured, in words; nothing where nothing is to be done."""
    return tuple(advice for piece in PIECES for advice in piece(found))
