"""Options of library scenes: names, allowed values, defaults and units, from the scene functions'
annotations.

A scene is a mechanism with its forces, initial state and outputs. Each argument of a function that makes a
scene is an option. Its annotation lists the allowed values:

- `Literal["a", "b"]`: one of several texts;
- `Annotated[int, range(1, 10), "kg"]`: a whole number, with its unit;
- `Annotated[float, Between(0.0, 1.0, "m")]`: a number in an interval;
- `Annotated[str, Text("PATH")]`: any text.

An option that has an effect only with a certain value of another option has an `OnlyWith` in its annotation,
such as `OnlyWith("wind", "gust")`.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, get_args, get_type_hints

from newton_euler.errors import plain_number


def titled(name: str, options: Mapping[str, str]) -> str:
    """Format a scene's name with the options that were set, as "four_bar (N=3)"."""
    settings = ", ".join(f"{option}={value}" for option, value in options.items())
    return f"{name} ({settings})" if settings else name


class Between(NamedTuple):
    """Allowed values of an option: numbers from `least` to `most`, in a unit."""

    least: float
    most: float
    unit: str

    def __str__(self) -> str:
        return f"{self.least:g}..{self.most:g} {self.unit}"


class Text(NamedTuple):
    """Allowed values of an option: any text; `word` describes it in listings and messages, such as "CSV"."""

    word: str

    def __str__(self) -> str:
        return self.word


class OnlyWith(NamedTuple):
    """Condition under which an option has an effect, printed after "only with".

    Attributes:
        option: name of another option.
        value: value that the other option must have; "" if it must not be given, None if it must differ from
            its default.
    """

    option: str
    value: str | None = None

    def __str__(self) -> str:
        if self.value is None:
            return f"another {self.option}"
        return f"{self.option}={self.value}" if self.value else f"no {self.option}"


@dataclass(frozen=True)
class Option:
    """An option of a scene.

    Attributes:
        values: allowed texts or numbers.
        default: value if the user gives none.
        only_with: condition under which the option has an effect; None if it always has.
        unit: unit of whole numbers; empty if there is none.
    """

    values: tuple[str, ...] | range | Between | Text
    default: str | int | float
    only_with: OnlyWith | None = None
    unit: str = ""

    def __str__(self) -> str:
        values = self.values
        if isinstance(values, Between | Text):
            return str(values)
        if isinstance(values, range):
            return f"{values[0]}..{values[-1]} {self.unit}".strip()
        return "|".join(values)

    @property
    def wanted(self) -> str:
        """The request for an allowed value that ends an error message."""
        if isinstance(self.values, range):
            return f"choose a whole number from {self.values[0]} to {self.values[-1]}"
        if isinstance(self.values, Between):
            return f"choose a number from {self.values.least:g} to {self.values.most:g} {self.values.unit}"
        if isinstance(self.values, Text):
            return f"give a text, {self.values.word}"
        return f"choose from: {', '.join(self.values)}"

    def read(self, value: str | float) -> str | int | float | None:
        """Convert a value to the type of the option, numbers also from decimal text; None if the value is not
        allowed."""
        if isinstance(self.values, Text):
            return value if isinstance(value, str) else None
        if isinstance(self.values, Between):
            try:
                found = plain_number(str(value))
            except ValueError:
                return None
            return found if self.values.least <= found <= self.values.most else None
        if isinstance(self.values, range):
            # no option allows numbers of more than 18 digits
            number = int(value) if re.fullmatch(r"-?[0-9]{1,18}", str(value)) else None
            return number if number in self.values else None
        return str(value) if value in self.values else None


def options_of(scene: Callable[..., Any]) -> dict[str, Option]:
    """Return the options of a scene function by name, in the order of its arguments."""
    hints = get_type_hints(scene, include_extras=True)
    return {
        name: _option(hints[name], parameter.default)
        for name, parameter in inspect.signature(scene).parameters.items()
    }


def _option(hint: Any, default: str | float) -> Option:
    """Make an option from the annotation and the default of an argument.

    The annotation is a `Literal` of the allowed texts, or `Annotated` with a range of numbers or a `Text`
    and, in any order, an `OnlyWith` and a unit.
    """
    arguments = get_args(hint)
    values = next((each for each in arguments if isinstance(each, range | Between | Text)), None)
    only_with = next((each for each in arguments if isinstance(each, OnlyWith)), None)
    units = [each for each in arguments if isinstance(each, str)] if values else []
    return Option(values or arguments, default, only_with, unit="".join(units))
