"""Largest errors that a user allows for the run of a model file, and their text form such as "position=1mm".

A `Judgement` has the errors of this run against the reference, an accurate solution of the same model.
`crosscheck run --max-error` and `Verdict.assert_accurate` compare these errors with the allowed ones.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import assert_never

from crosscheck.own_run.judge import Judgement
from crosscheck.support.errors import CrosscheckError
from crosscheck.support.units import ANGLES, LENGTHS, quantity_text, significant

OWN_RUN = "your settings"
"""Name of the run with the settings of the model file, beside the names of logs."""

NUMBER_AND_UNIT = re.compile(r"\s*([-+0-9.eE]+)\s*([a-z%]*)\s*")
"""Pattern of a value such as "1e-3", "0.1%" or "1 mm"."""


class ErrorKind(StrEnum):
    """Error of a run that can be limited; the value is its name on the command line."""

    RELATIVE = "relative"
    """Larger one of the errors of positions and of orientations, each divided by the extent of the motion."""
    POSITION = "position"
    """Largest error of a center of mass, m, in the judged comparison and in the other one if there is one."""
    ROTATION = "rotation"
    """Largest error of an orientation, rad, likewise."""
    OPENING = "opening"
    """Largest distance between the ends of a loop constraint, m, likewise."""
    LOOP_ANGLE = "loop_angle"
    """Largest violation of a loop constraint of angles, rad, likewise."""
    ENERGY = "energy"
    """Largest error of the total energy, divided by the reference's largest kinetic energy plus the range of
    its potential energy."""

    def of(self, judgement: Judgement) -> float:
        """Return this error of a judged run; infinite for a run that diverged, if only as it stands."""
        if _divergence(judgement):
            return math.inf
        match self:
            case ErrorKind.RELATIVE:
                return judgement.error.relative
            case ErrorKind.POSITION:
                return max(each.error.largest_position for each in judgement.measured)
            case ErrorKind.ROTATION:
                return max(each.error.largest_rotation for each in judgement.measured)
            case ErrorKind.OPENING:
                return max(each.loop_error.opening for each in judgement.measured)
            case ErrorKind.LOOP_ANGLE:
                return max(each.loop_error.angle for each in judgement.measured)
            case ErrorKind.ENERGY:
                return judgement.error.energy
            case _:
                assert_never(self)


RATIOS = {"": 1.0, "%": 0.01}

LENGTH_UNITS = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "nm": 1e-9, "pm": 1e-12}
"""Units of printed lengths, m, the largest first."""

UNITS = {
    ErrorKind.RELATIVE: RATIOS,
    ErrorKind.POSITION: {"": 1.0, **LENGTHS},
    ErrorKind.ROTATION: {"": 1.0, **ANGLES},
    ErrorKind.OPENING: {"": 1.0, **LENGTHS},
    ErrorKind.LOOP_ANGLE: {"": 1.0, **ANGLES},
    ErrorKind.ENERGY: RATIOS,
}
"""Factors to SI units by the name of the unit, for each kind of error; no name means SI units."""


@dataclass(frozen=True)
class AllowedError:
    """Largest error that a run may have.

    Attributes:
        kind: kind of the error.
        largest: largest value, m, rad, or a ratio.
    """

    kind: ErrorKind
    largest: float

    def __post_init__(self) -> None:
        """Raise `CrosscheckError` for a value that is no positive number."""
        if not 0.0 < self.largest < math.inf:
            raise CrosscheckError(f"largest {self.kind} error: {self.largest:g} is not positive and finite")

    @classmethod
    def parse(cls, text: str) -> AllowedError:
        """Read an allowed error, such as "1e-3" or "0.1%" (relative), "position=1mm" or "rotation=0.1deg".

        Raises:
            CrosscheckError: for another name, unit or number; the message has the allowed ones.
        """
        name, equals, value = text.rpartition("=")
        if equals and name not in set(ErrorKind):
            raise CrosscheckError(
                f"--max-error {text}: unknown error {name!r}; choose from {_listed(ErrorKind)}"
            )
        kind = ErrorKind(name) if equals else ErrorKind.RELATIVE
        units = UNITS[kind]
        found = NUMBER_AND_UNIT.fullmatch(value)
        try:
            number = float(found[1]) if found else math.nan
        except ValueError:
            number = math.nan
        if found is None or not math.isfinite(number):
            example = "--max-error 1e-3 or --max-error position=1mm"
            raise CrosscheckError(
                f"--max-error {text}: {value!r} is no number with a unit; such as {example}"
            )
        if found[2] not in units:
            allowed = _listed(unit for unit in units if unit)
            raise CrosscheckError(
                f"--max-error {text}: no unit {found[2]!r} of {kind}; choose from {allowed}"
            )
        if number <= 0.0:
            raise CrosscheckError(f"--max-error {text}: needed: a number above 0")
        return cls(kind, number * units[found[2]])

    def is_exceeded_by(self, judgement: Judgement) -> bool:
        """Return True if a judged run has a larger error, or diverged."""
        return not self.kind.of(judgement) <= self.largest


def _listed(names: Iterable[str]) -> str:
    """List names, separated by commas."""
    return ", ".join(names)


def without_loops(judgement: Judgement) -> dict[ErrorKind, str]:
    """Map the errors of loops to why they cannot be limited, if the run has no such loop constraints."""
    found, loops = {}, judgement.loop_error
    has_loops = bool(loops.opening_at[0] or loops.angle_at[0])
    for kind, (name, _), measure in (
        (ErrorKind.OPENING, loops.opening_at, "lengths"),
        (ErrorKind.LOOP_ANGLE, loops.angle_at, "angles"),
    ):
        if not name:
            lacks = f"no loops with constraints of {measure}" if has_loops else "no loops"
            needed = f"needed: a model with loop constraints of {measure}"
            found[kind] = f"{lacks}, so that a limit of {kind} limits nothing; {needed}"
    return found


def exceeded_text(name: str, judgement: Judgement, exceeded: Sequence[AllowedError]) -> str:
    """Format the errors that exceed what the user allows, or why the run has no error.

    Args:
        name: `OWN_RUN`, or the name of a log.
        judgement: judgement of the run.
        exceeded: the largest errors that the user allows.
    """
    run = "the run with your settings" if name == OWN_RUN else f"the log {name}"
    if reason := _divergence(judgement):
        return f"{run} diverged: {reason}"
    parts = [f"{each.kind} {', allowed '.join(_both(each, judgement))}" for each in exceeded]
    return f"errors of {run}: {'; '.join(parts)}"


def _both(allowed: AllowedError, judgement: Judgement) -> tuple[str, str]:
    """Format an error and the largest allowed one, with as many digits as show that they differ."""
    kind = allowed.kind
    values = kind.of(judgement), allowed.largest
    texts = ((in_unit(values[0], kind, digits), in_unit(values[1], kind, digits)) for digits in range(3, 18))
    return next(pair for pair in texts if pair[0] != pair[1])


def found_text(judgement: Judgement, kind: ErrorKind) -> str:
    """Format an error of a judged run, or why the run diverged."""
    if reason := _divergence(judgement):
        return f"diverged: {reason}"
    return in_unit(kind.of(judgement), kind)


def _divergence(judgement: Judgement) -> str:
    """Return why a run diverged, if only with contacts, limits and friction; "" for a complete run."""
    return judgement.stopped or judgement.stopped_as_it_stands


def in_unit(value: float, kind: ErrorKind, digits: int = 3) -> str:
    """Word an error of a kind with its unit and three digits."""
    match kind:
        case ErrorKind.RELATIVE | ErrorKind.ENERGY:
            return f"{significant(100.0 * value, digits)} %"
        case ErrorKind.POSITION | ErrorKind.OPENING:
            return length(value, digits)
        case ErrorKind.ROTATION | ErrorKind.LOOP_ANGLE:
            return f"{significant(math.degrees(value), digits)} deg"
        case _:
            assert_never(kind)


def length(value: float, digits: int = 3) -> str:
    """Format a length in m, mm, um, nm or pm with three digits."""
    if value < LENGTH_UNITS["pm"]:
        return "below 1 pm" if value else "0 m"
    return quantity_text(value, LENGTH_UNITS, digits)
