"""The options of a scene: what each of them can be, read off the annotations of the scene's function.

`Literal["a", "b"]` is a choice of texts, `Annotated[int, range(1, 10)]` a whole number, `Annotated[float,
Between(0.0, 1.0, "m")]` a number, and `Annotated[str, Text("PATH")]` any text.
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


@dataclass(frozen=True)
class Option:
    """An option of a scene.

    Attributes:
        values: texts or numbers that it can be.
        default: the value unless another is given.
    """

    values: tuple[str, ...] | range | Between | Text
    default: str | int | float

    def __str__(self) -> str:
        values = self.values
        if isinstance(values, Between | Text):
            return str(values)
        return f"{values[0]}..{values[-1]}" if isinstance(values, range) else "|".join(values)

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
        name: Option(_values(hints[name]), parameter.default)
        for name, parameter in inspect.signature(scene).parameters.items()
    }


def _values(hint: Any) -> tuple[str, ...] | range | Between | Text:
    arguments = get_args(hint)
    return next((each for each in arguments if isinstance(each, range | Between | Text)), arguments)
