"""The options of a scene: what each of them can be, read off the annotations of the scene's function.

`Literal["a", "b"]` is a choice of texts, `Annotated[int, range(1, 10), "kg"]` a whole number and its unit,
`Annotated[float, Between(0.0, 1.0, "m")]` a number, and `Annotated[str, Text("PATH")]` any text. What has an
effect beside another option's value alone is annotated with that, as `Beside("wind", "gust")`.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple, get_args, get_type_hints

from newton_euler.errors import plain_number


def titled(name: str, options: Mapping[str, str]) -> str:
    """A scene's name, with the options that were set."""
    settings = ", ".join(f"{option}={value}" for option, value in options.items())
    return f"{name} ({settings})" if settings else name


class Between(NamedTuple):
    """Numbers from the least to the most, and their unit."""

    least: float
    most: float
    unit: str

    def __str__(self) -> str:
        return f"{self.least:g}..{self.most:g} {self.unit}"


class Text(NamedTuple):
    """Any text, and the word for it."""

    word: str

    def __str__(self) -> str:
        return self.word


class Beside(NamedTuple):
    """Another option, and the value that it has to have; any but its default if None."""

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
        values: texts or numbers that it can be.
        default: the value unless another is given.
        beside: what it has an effect beside alone; None for anything.
        unit: of whole numbers.
    """

    values: tuple[str, ...] | range | Between | Text
    default: str | int | float
    beside: Beside | None = None
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
        """The values that an error message asks for."""
        if isinstance(self.values, range):
            return f"choose a whole number from {self.values[0]} to {self.values[-1]}"
        if isinstance(self.values, Between):
            return f"choose a number from {self.values.least:g} to {self.values.most:g} {self.values.unit}"
        if isinstance(self.values, Text):
            return f"give a text, {self.values.word}"
        return f"choose from: {', '.join(self.values)}"

    def read(self, value: str | float) -> str | int | float | None:
        """Read a value, a number as such or in decimal digits; None for one that the option cannot be."""
        if isinstance(self.values, Text):
            return value if isinstance(value, str) else None
        if isinstance(self.values, Between):
            try:
                found = plain_number(str(value))
            except ValueError:
                return None
            return found if self.values.least <= found <= self.values.most else None
        if isinstance(self.values, range):
            number = int(value) if re.fullmatch(r"-?[0-9]{1,18}", str(value)) else None
            return number if number in self.values else None
        return str(value) if value in self.values else None


def options_of(scene: Callable[..., Any]) -> dict[str, Option]:
    """Return the options of a scene's function by name."""
    hints = get_type_hints(scene, include_extras=True)
    return {
        name: _option(hints[name], parameter.default)
        for name, parameter in inspect.signature(scene).parameters.items()
    }


def _option(hint: Any, default: str | float) -> Option:
    arguments = get_args(hint)
    numbers = next((each for each in arguments if isinstance(each, range | Between | Text)), None)
    beside = next((each for each in arguments if isinstance(each, Beside)), None)
    units = [each for each in arguments if isinstance(each, str)] if numbers else []
    return Option(numbers or arguments, default, beside, "".join(units))
