"""Functions of time that are smooth at all times, with their exact derivatives, over generic scalars."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from newton_euler.errors import MechanismError, is_finite_number, items_of, quoted, set_numbers
from newton_euler.model.variable import Function
from newton_euler.scalars import Scalar, cos, sin

HIGHEST = 1e15  # rad/s, or rad: a double holds no part of a turn beyond


@dataclass(frozen=True)
class Polynomial(Function):
    """c_0 + c_1 t + c_2 t^2 + ...

    Attributes:
        coefficients: c_k in m/s^k or rad/s^k.

    Raises:
        MechanismError: for coefficients that are no finite numbers.

    Examples:
        >>> Polynomial((0.1, 2.0)).value(3.0)
        6.1
    """

    coefficients: tuple[float, ...]

    parts: ClassVar = {"": ("coefficients",)}

    def __post_init__(self) -> None:
        given = items_of(self.coefficients) or ()
        if not given or not all(
            is_finite_number(c) and is_finite_number(k * k * c) for k, c in enumerate(given)
        ):
            needed = "one finite number or more, lowest power first"
            raise MechanismError("polynomial", f"coefficients is {quoted(self.coefficients)}", needed)
        object.__setattr__(self, "coefficients", tuple(float(c) for c in given))

    def value(self, time: Scalar) -> Scalar:
        return _horner(self.coefficients, self._since(time))

    def rate(self, time: Scalar) -> Scalar:
        return _horner(_derived(self.coefficients), self._since(time))

    def acceleration(self, time: Scalar) -> Scalar:
        return _horner(_derived(_derived(self.coefficients)), self._since(time))

    def _since(self, time: Scalar) -> Scalar:
        """Compute t, s, at a time in s."""
        return time


@dataclass(frozen=True)
class Piece(Polynomial):
    """A polynomial with t counted from a start in s: what a function with knots is between two of them.

    Its numbers may be scalars of any kind, and are not checked.
    """

    start: Scalar

    def __post_init__(self) -> None:
        """Take the numbers as they are."""

    def _since(self, time: Scalar) -> Scalar:
        return time - self.start


def _horner(coefficients: tuple[float, ...], time: Scalar) -> Scalar:
    total: Scalar = 0.0
    for c in reversed(coefficients):
        total = total * time + c
    return total


def _derived(coefficients: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(k * c for k, c in enumerate(coefficients))[1:]


@dataclass(frozen=True)
class Sine(Function):
    """offset + amplitude sin(angular_frequency t + phase).

    Attributes:
        amplitude, offset: m or rad.
        angular_frequency: rad/s.
        phase: rad.

    Raises:
        MechanismError: for a value that is no finite number.

    Examples:
        >>> float(Sine(amplitude=0.5, angular_frequency=2.0).rate(0.0))
        1.0
    """

    amplitude: float
    angular_frequency: float
    phase: float = 0.0
    offset: float = 0.0

    parts: ClassVar = {
        "": ("amplitude", "offset"),
        "angular_frequency": ("angular_frequency",),
        "phase": ("phase",),
    }

    def __post_init__(self) -> None:
        set_numbers(self, "sine", ("amplitude", "angular_frequency", "phase", "offset"))
        w = self.angular_frequency
        if not is_finite_number(self.amplitude * w * w) or abs(w) > HIGHEST or abs(self.phase) > HIGHEST:
            problem = (
                f"amplitude is {self.amplitude:g}, angular_frequency {w:g} rad/s, phase {self.phase:g} rad"
            )
            needed = f"an acceleration that a double holds, and phases of at most {HIGHEST:g} rad"
            raise MechanismError("sine", problem, needed)

    def value(self, time: Scalar) -> Scalar:
        return self.offset + self.amplitude * sin(self.angular_frequency * time + self.phase)

    def rate(self, time: Scalar) -> Scalar:
        w = self.angular_frequency
        return self.amplitude * w * cos(w * time + self.phase)

    def acceleration(self, time: Scalar) -> Scalar:
        w = self.angular_frequency
        return -(self.amplitude * w * w) * sin(w * time + self.phase)
