"""The options of a scene: what each of them can be, read off the annotations of the scene's function.

`Literal["a", "b"]` is a choice of texts, `Annotated[int, Range(1, 9)]` a whole number.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, get_args, get_origin, get_type_hints


def titled(name: str, options: Mapping[str, str]) -> str:
    """A scene's name, with the options that were set."""
    settings = ", ".join(f"{option}={value}" for option, value in options.items())
    return f"{name} ({settings})" if settings else name


@dataclass(frozen=True)
class Choice:
    """One of some texts."""

    texts: tuple[str, ...]

    def __str__(self) -> str:
        return "|".join(self.texts)

    @property
    def wanted(self) -> str:
        """The values that an error message asks for."""
        return f"choose from: {', '.join(self.texts)}"

    def read(self, value: str | int) -> str | None:
        """The value itself, or None if it is not one of the texts."""
        return str(value) if value in self.texts else None


@dataclass(frozen=True)
class Range:
    """A whole number, both ends included."""

    first: int
    last: int

    def __str__(self) -> str:
        return f"{self.first}..{self.last}"

    @property
    def wanted(self) -> str:
        """The values that an error message asks for."""
        return f"choose a whole number from {self.first} to {self.last}"

    def read(self, value: str | int) -> int | None:
        """The number, given as such or in decimal digits; None if it is none or out of range."""
        if not re.fullmatch(r"-?[0-9]{1,18}", str(value)):
            return None
        number = int(value)
        return number if self.first <= number <= self.last else None


@dataclass(frozen=True)
class Option:
    """One option of a scene: the values it can take and the one it has unless told otherwise."""

    values: Choice | Range
    default: str | int


def options_of(scene: Callable[..., Any]) -> dict[str, Option]:
    """The options of a scene's function by name."""
    hints = get_type_hints(scene, include_extras=True)
    return {
        name: Option(_values(hints[name]), parameter.default)
        for name, parameter in inspect.signature(scene).parameters.items()
    }


def _values(hint: Any) -> Choice | Range:
    arguments = get_args(hint)
    if get_origin(hint) is Annotated:
        (found,) = (argument for argument in arguments[1:] if isinstance(argument, Range))
        return found
    return Choice(arguments)
