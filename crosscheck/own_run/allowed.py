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

from crosscheck.own_run.errors import LoopError, RunError
from crosscheck.own_run.judge import Judgement
from crosscheck.support.errors import CrosscheckError
from crosscheck.support.name_lists import first_names
from crosscheck.support.units import ANGLES, LENGTHS, quantity_text, significant
from newton_euler.reading.file_run import Event

OWN_RUN = "your settings"
"""Name of the run with the settings of the model file, beside the names of logs."""

REDUCED_RUN = "your settings, without what acts"
"""Name of the same run of the file without elements that act and that the reference does not simulate."""

NUMBER_AND_UNIT = re.compile(r"\s*([-+0-9.eE]+)\s*([a-z%]*)\s*")
"""Pattern of a value such as "1e-3", "0.1%" or "1 mm"."""


class ErrorKind(StrEnum):
    """Error of a run that can be limited; the value is its name on the command line."""

    RELATIVE = "relative"
    """Larger one of the errors of positions and of orientations, each divided by the extent of the motion."""
    POSITION = "position"
    """Largest error of a center of mass, m."""
    ROTATION = "rotation"
    """Largest error of an orientation, rad."""
    OPENING = "opening"
    """Largest distance between the ends of a loop constraint, m."""
    LOOP_ANGLE = "loop_angle"
    """Largest violation of a loop constraint of angles, rad."""
    ENERGY = "energy"
    """Largest error of the total energy, divided by the reference's largest kinetic energy plus the range of
    its potential energy."""

    def measured_in(self, error: RunError, loop_error: LoopError) -> float:
        """Return this one of the errors of a run."""
        match self:
            case ErrorKind.RELATIVE:
                return error.relative
            case ErrorKind.POSITION:
                return error.largest_position
            case ErrorKind.ROTATION:
                return error.largest_rotation
            case ErrorKind.OPENING:
                return loop_error.opening
            case ErrorKind.LOOP_ANGLE:
                return loop_error.angle
            case ErrorKind.ENERGY:
                return error.energy
            case _:
                assert_never(self)

    def of(self, judgement: Judgement) -> float:
        """Return this error of a judged run, or of the run without what acts if that one is larger.

        The error of a run that diverged is infinite.
        """
        if judgement.stopped:
            return math.inf
        return max((self.measured_in(each.error, each.loop_error) for each in judgement.judged), default=0.0)


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
    def parse(cls, text: str, option: str = "--max-error") -> AllowedError:
        """Read an allowed error, such as "1e-3" or "0.1%" (relative), "position=1mm" or "rotation=0.1deg".

        Args:
            text: the text.
            option: name of the option or argument, for messages.

        Raises:
            CrosscheckError: for another name, unit or number; the message has the allowed ones.
        """
        name, equals, value = text.rpartition("=")
        if equals and name not in set(ErrorKind):
            raise CrosscheckError(
                f"{option} {text}: unknown error {name!r}; choose from {_listed(ErrorKind)}"
            )
        kind = ErrorKind(name) if equals else ErrorKind.RELATIVE
        units = UNITS[kind]
        found = NUMBER_AND_UNIT.fullmatch(value)
        try:
            number = float(found[1]) if found else math.nan
        except ValueError:
            number = math.nan
        if found is None or not math.isfinite(number):
            example = f"{option} 1e-3 or {option} position=1mm"
            raise CrosscheckError(f"{option} {text}: {value!r} is no number with a unit; such as {example}")
        if found[2] not in units:
            allowed = _listed(unit for unit in units if unit)
            needed = f"; for a length write {option} position={text}" if found[2] in LENGTHS else ""
            needed = f"; for an angle write {option} rotation={text}" if found[2] in ANGLES else needed
            raise CrosscheckError(
                f"{option} {text}: no unit {found[2]!r} of {kind}; choose from {allowed}"
                f"{'' if equals else needed}"
            )
        if number <= 0.0:
            raise CrosscheckError(f"{option} {text}: needed: a number above 0")
        return cls(kind, number * units[found[2]])

    @property
    def text(self) -> str:
        """The limit in words, such as "0.1 % of the motion" or "1 mm (position)"."""
        of_what = "of the motion" if self.kind is ErrorKind.RELATIVE else f"({self.kind})"
        return f"{in_unit(self.largest, self.kind)} {of_what}"

    def is_exceeded_by(self, judgement: Judgement) -> bool:
        """Return True if a judged run has a larger error, or diverged."""
        return not self.kind.of(judgement) <= self.largest


def _listed(names: Iterable[str]) -> str:
    """List names, separated by commas."""
    return ", ".join(names)


def without_loops(loops: LoopError) -> dict[ErrorKind, str]:
    """Map the errors of loops to why they cannot be limited, if a run has no such loop constraints."""
    found = {}
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
    if judgement.stopped:
        return f"{run} diverged: {judgement.stopped}"
    # the run of the file as it stands keeps some of these errors: those are of the run without what acts
    parts = [
        f"{each.kind} {', allowed '.join(_both(each, judgement))}{_reduction(each, judgement)}"
        for each in exceeded
    ]
    return f"errors of {run}: {'; '.join(parts)}"


def _reduction(allowed: AllowedError, judgement: Judgement) -> str:
    """Name the elements without which a run exceeds an error that the run as it stands does not exceed."""
    own = allowed.kind.measured_in(judgement.error, judgement.loop_error) if judgement.is_judged else 0.0
    return "" if own > allowed.largest else f" (without {elements_text(judgement.events)})"


def elements_text(events: Sequence[Event]) -> str:
    """Name the first one of some elements, and the number of the others."""
    return first_names([event.element for event in events], most=1)


def _both(allowed: AllowedError, judgement: Judgement) -> tuple[str, str]:
    """Format an error and the largest allowed one, with as many digits as show that they differ."""
    kind = allowed.kind
    values = kind.of(judgement), allowed.largest
    texts = ((in_unit(values[0], kind, digits), in_unit(values[1], kind, digits)) for digits in range(3, 18))
    return next(pair for pair in texts if pair[0] != pair[1])


def found_text(judgement: Judgement, kind: ErrorKind) -> str:
    """Format an error of a judged run, or why the run diverged."""
    if judgement.stopped:
        return f"diverged: {judgement.stopped}"
    return in_unit(kind.of(judgement), kind)


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
