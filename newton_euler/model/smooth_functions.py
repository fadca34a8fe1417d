"""Smooth functions of time with exact derivatives: polynomials and sines.

They prescribe joint motions and serve as targets of control laws. The time and the numbers of a function may
be floats or generic scalars such as expressions of the code generator (`newton_euler.scalars`).

Parameter studies and fits change the numbers of a function by part. If the target of a control law is a
function, the parameter `target` is its part "": the numbers on which the value depends linearly. Its part
"phase" is the parameter `target.phase`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from newton_euler.errors import MechanismError, is_finite_number, items_of, quoted, set_numbers
from newton_euler.model.variable import Function
from newton_euler.scalars import Scalar, cos, sin

MAX_ANGLE = 1e15
"""Largest phase, rad, and largest angular frequency, rad/s. Neighboring doubles above it are more than 0.1
rad apart, so a sine of such an angle would be meaningless."""


@dataclass(frozen=True)
class Polynomial(Function):
    """The polynomial c_0 + c_1 t + c_2 t^2 + ... of the time t in s.

    Attributes:
        coefficients: c_0, c_1, ..., with c_k in m/s^k or rad/s^k.

    Raises:
        MechanismError: for coefficients that are not finite numbers.

    Examples:
        >>> Polynomial((0.1, 2.0)).value(3.0)
        6.1
    """

    coefficients: tuple[float, ...]

    parts: ClassVar = {"": ("coefficients",)}  # names of the fields of each part

    def __post_init__(self) -> None:
        # The coefficients k (k - 1) c_k of the acceleration must be finite, too; k^2 c_k bounds them
        given = items_of(self.coefficients) or ()
        if not given or not all(
            is_finite_number(c) and is_finite_number(k * k * c) for k, c in enumerate(given)
        ):
            needed = "one finite number or more, lowest power first"
            raise MechanismError("polynomial", f"coefficients is {quoted(self.coefficients)}", needed)
        object.__setattr__(self, "coefficients", tuple(float(c) for c in given))

    def value(self, time: Scalar) -> Scalar:
        return _evaluate(self.coefficients, self._since_start(time))

    def rate(self, time: Scalar) -> Scalar:
        return _evaluate(_derivative(self.coefficients), self._since_start(time))

    def acceleration(self, time: Scalar) -> Scalar:
        return _evaluate(_derivative(_derivative(self.coefficients)), self._since_start(time))

    def _since_start(self, time: Scalar) -> Scalar:
        """Return the variable t of the polynomial, s, at a time of the run, s; here both are equal."""
        return time


@dataclass(frozen=True)
class Piece(Polynomial):
    """One polynomial piece of a spline or step function, between two knots (times at which a derivative
    jumps).

    The numbers may be generic scalars, and are not checked.

    Attributes:
        start: time, s, at which the variable t of the polynomial is zero.
    """

    start: Scalar

    def __post_init__(self) -> None:
        """Keep the numbers unchecked and unconverted, unlike the base class."""

    def _since_start(self, time: Scalar) -> Scalar:
        return time - self.start


def _evaluate(coefficients: tuple[float, ...], time: Scalar) -> Scalar:
    """Evaluate a polynomial by Horner's rule; coefficients in ascending powers of the time, s."""
    total: Scalar = 0.0
    for c in reversed(coefficients):
        total = total * time + c
    return total


def _derivative(coefficients: tuple[float, ...]) -> tuple[float, ...]:
    """Return the coefficients of the derivative of a polynomial, both in ascending powers."""
    return tuple(k * c for k, c in enumerate(coefficients))[1:]


@dataclass(frozen=True)
class Sine(Function):
    """The sine offset + amplitude sin(angular_frequency t + phase) of the time t in s.

    Attributes:
        amplitude, offset: m or rad.
        angular_frequency: rad/s.
        phase: rad.

    Raises:
        MechanismError: for a value that is not a finite number or is above 1e15.

    Examples:
        >>> float(Sine(amplitude=0.5, angular_frequency=2.0).rate(0.0))
        1.0
    """

    amplitude: float
    angular_frequency: float
    phase: float = 0.0
    offset: float = 0.0

    # names of the fields of each part
    parts: ClassVar = {
        "": ("amplitude", "offset"),
        "angular_frequency": ("angular_frequency",),
        "phase": ("phase",),
    }

    def __post_init__(self) -> None:
        set_numbers(self, "sine", ("amplitude", "angular_frequency", "phase", "offset"))
        w = self.angular_frequency
        if not is_finite_number(self.amplitude * w * w) or abs(w) > MAX_ANGLE or abs(self.phase) > MAX_ANGLE:
            problem = (
                f"amplitude is {self.amplitude:g}, angular_frequency {w:g} rad/s, phase {self.phase:g} rad"
            )
            needed = f"an acceleration that a double holds, and phases of at most {MAX_ANGLE:g} rad"
            raise MechanismError("sine", problem, needed)

    def value(self, time: Scalar) -> Scalar:
        return self.offset + self.amplitude * sin(self.angular_frequency * time + self.phase)

    def rate(self, time: Scalar) -> Scalar:
        w = self.angular_frequency
        return self.amplitude * w * cos(w * time + self.phase)

    def acceleration(self, time: Scalar) -> Scalar:
        w = self.angular_frequency
        return -(self.amplitude * w * w) * sin(w * time + self.phase)
