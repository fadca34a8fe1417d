"""Arguments of public functions: checked by their type hints, before any work begins.

A function with the decorator `checked` raises `ArgumentError` for an argument that its hint excludes. Options
of an unpacked `TypedDict` are checked, too. Missing, unknown and surplus arguments are a `TypeError`, as for
any function of Python.
"""

from __future__ import annotations

import builtins
import inspect
import os
import sys
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, wraps
from types import NoneType, UnionType
from typing import (
    Annotated,
    Any,
    Literal,
    NamedTuple,
    ParamSpec,
    TypeAlias,
    TypeVar,
    Union,
    Unpack,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np
from numpy.typing import ArrayLike

from newton_euler.errors import ArgumentError, is_finite_number, is_whole, quoted
from newton_euler.scalars import Array

P = ParamSpec("P")
T = TypeVar("T")

PACKAGES = frozenset({"newton_euler", "mjcf", "urdf", "crosscheck"})

MADE_BY = {
    "Poses": "solve_poses(scene, ...)",
    "State": "initial_state(scene)",
    "Trajectory": "simulate(scene)",
}
"""Calls that make objects of classes that users rarely construct themselves, for messages."""

UNCHECKED = "unchecked"
"""Marks hints of arguments that a function checks itself: `Annotated[Sequence[float], UNCHECKED]`."""


@dataclass(frozen=True)
class Range:
    """Declared range of a number: `Annotated[int, Range(1, 4096)]`.

    Attributes:
        least, most: the smallest and the largest value.
    """

    least: float = -np.inf
    most: float = np.inf

    def __str__(self) -> str:
        if np.isinf(self.most):
            return "" if np.isinf(self.least) else f", {self.least} or more"
        return f", {self.least} to {self.most}"


class Fault(NamedTuple):
    """The part of an argument that a rule excludes.

    Attributes:
        value: the part.
        needed: what the rule needs.
        place: index or key of the part, such as `[2]`; empty if it is the whole argument, or a key.
    """

    value: object
    needed: str
    place: str = ""


class Rule(NamedTuple):
    """The values that a type hint allows.

    Attributes:
        needed, several: description of a valid value, and of several of them.
        fault: returns None for a valid value.
        array_fault: the same for all numbers of an array (n,) at once; None for a rule of other things.
    """

    needed: str
    several: str
    fault: Callable[[Any], Fault | None]
    array_fault: Callable[[Array], Fault | None] | None = None


Rules: TypeAlias = tuple[tuple[tuple[str, Rule | None], ...], Mapping[str, Rule], Rule | None]


def checked(function: Callable[P, T]) -> Callable[P, T]:
    """Return a function that raises `ArgumentError` for arguments that its type hints exclude.

    Names that a module imports for type checkers only are not known when a program runs; arguments with such
    hints are left to the function.

    Examples:
        >>> @checked
        ... def half(number: float) -> float:
        ...     return number / 2
        >>> half("1")
        Traceback (most recent call last):
        newton_euler.errors.ArgumentError: __main__.half: number is '1'; needed: a finite number
    """

    @cache
    def rules() -> Rules:
        return _rules(function)

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        positional, named, others = rules()
        for (name, rule), value in zip(positional, args, strict=False):
            if rule is not None and (fault := rule.fault(value)) is not None:
                raise _error(function, name, value, fault)
        for name, value in kwargs.items():
            rule = named.get(name, others)
            if rule is not None and (fault := rule.fault(value)) is not None:
                raise _error(function, name, value, fault)
        return function(*args, **kwargs)

    return call


def caller_level() -> int:
    """Return the `stacklevel` of a warning that points to the line which called into these packages."""
    frame, level = sys._getframe(1), 1
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] in PACKAGES:
        frame, level = frame.f_back, level + 1
    return level


def _error(function: Callable[..., Any], name: str, value: object, fault: Fault) -> ArgumentError:
    """Return the error of an argument; if a part of it is at fault, with this part."""
    verb = "is" if fault.place or fault.value is value else "holds"
    package = function.__module__.partition(".")[0]
    where = f"{package}.{function.__qualname__}"
    return ArgumentError(where, name, fault.value, fault.needed, f"{fault.place} {verb}")


class _Names(dict[str, Any]):
    """Names of a module, `Any` for those that are imported for type checkers only."""

    def __missing__(self, name: str) -> Any:
        return getattr(builtins, name, Any)


def _rules(function: Callable[..., Any]) -> Rules:
    """Read the rules of the arguments: by position, by keyword, and of all other keywords."""
    plain = inspect.unwrap(function)
    hints = _hints(plain)
    positional: list[tuple[str, Rule | None]] = []
    named: dict[str, Rule] = {}
    others: Rule | None = None
    for name, parameter in inspect.signature(plain).parameters.items():
        hint = hints.get(name, Any)
        if get_origin(hint) is Unpack:
            named |= {each: _rule(kind) for each, kind in _hints(get_args(hint)[0]).items()}
            continue
        rule = None if hint is Any else _rule(hint)
        if parameter.kind is parameter.VAR_KEYWORD:
            others = rule
            continue
        if parameter.kind in (parameter.POSITIONAL_ONLY, parameter.POSITIONAL_OR_KEYWORD):
            positional.append((name, rule))
        if rule is not None and parameter.kind is not parameter.POSITIONAL_ONLY:
            named[name] = rule
    return tuple(positional), named, others


def _hints(thing: Any) -> dict[str, Any]:
    """Return the type hints of a function or of a `TypedDict`."""
    names = _Names(vars(sys.modules[thing.__module__]))
    return get_type_hints(thing, None, names, include_extras=True)


def _rule(hint: Any) -> Rule:
    """Return the rule of a type hint; raises `TypeError` for a kind of hint that has no rule yet."""
    origin, arguments = get_origin(hint), get_args(hint)
    if hint in SIMPLE:
        return SIMPLE[hint]
    if hint in (int, float):
        return _number(hint, Range())
    if origin is Annotated:
        return SIMPLE[Any] if arguments[1] is UNCHECKED else _number(*arguments)
    if origin in (Union, UnionType):
        return _any_of([_rule(each) for each in arguments])
    if origin is Literal:
        return _simple(" or ".join(map(repr, arguments)), "", lambda value: isinstance(value, str))
    if origin is tuple and arguments[-1] is not Ellipsis:
        return _tuple([_rule(kind) for kind in arguments])
    if origin in (Sequence, tuple):
        return _list(_rule(arguments[0]))
    if origin is Iterable:
        return _iterable(_rule(arguments[0]))
    if origin is Mapping:
        return _dictionary(_rule(arguments[0]), _rule(arguments[1]))
    if origin is Callable:
        return _simple("a function", "functions", callable)
    if origin is os.PathLike:
        return _simple("a path", "paths", lambda value: isinstance(value, os.PathLike))
    if origin is np.ndarray:
        return _simple("an array of numbers", "arrays of numbers", _is_array)
    if isinstance(hint, type):
        name = hint.__name__
        article = "an" if name[0] in "AEIOU" else "a"
        made = f" ({MADE_BY[name]})" if name in MADE_BY else ""
        return _simple(f"{article} {name}{made}", f"{name} objects", lambda value: isinstance(value, hint))
    raise TypeError(f"no rule for the type hint {hint!r}")


def _simple(needed: str, several: str, accepts: Callable[[Any], bool]) -> Rule:
    return Rule(needed, several or needed, lambda value: None if accepts(value) else Fault(value, needed))


SIMPLE: dict[Any, Rule] = {
    Any: _simple("anything", "", lambda value: True),
    ArrayLike: _simple("numbers", "", lambda value: True),
    NoneType: _simple("None", "", lambda value: value is None),
    str: _simple("text", "", lambda value: isinstance(value, str)),
    bool: _simple("True or False", "", lambda value: isinstance(value, bool | np.bool_)),
}
"""Rules of hints without a range or parts. Functions convert what is like an array themselves."""

ANYTHING = (SIMPLE[Any], SIMPLE[ArrayLike])


def _number(kind: type, span: Range) -> Rule:
    if kind is int:
        rule = _simple(
            f"a whole number{span}",
            f"whole numbers{span}",
            lambda value: is_whole(value) and span.least <= int(value) <= span.most,
        )
    else:
        rule = _simple(
            f"a finite number{span}",
            f"finite numbers{span}",
            lambda value: is_finite_number(value) and span.least <= value <= span.most,
        )

    def array_fault(numbers: Array) -> Fault | None:
        if kind is int and numbers.dtype.kind not in "iu":
            wrong = np.ones(len(numbers), dtype=bool)
        else:
            wrong = ~(np.isfinite(numbers) & (numbers >= span.least) & (numbers <= span.most))
        if not np.any(wrong):
            return None
        first = int(np.argmax(wrong))
        return Fault(numbers[first].item(), rule.needed, f"[{first}]")

    return rule._replace(array_fault=array_fault)


def _any_of(rules: Sequence[Rule]) -> Rule:
    """Return the rule of a union; a part of a container is at fault if the container itself is valid."""
    needed, several = (
        " or ".join(dict.fromkeys(words)) for words in zip(*(rule[:2] for rule in rules), strict=True)
    )

    def fault(value: Any) -> Fault | None:
        part: Fault | None = None
        for rule in rules:
            found = rule.fault(value)
            if found is None:
                return None
            if found.value is not value:
                part = found
        return part or Fault(value, needed)

    return Rule(needed, several, fault)


def _tuple(rules: Sequence[Rule]) -> Rule:
    """Return the rule of a tuple with one rule for each place."""
    needed = f"({', '.join(rule.needed for rule in rules)})"

    def accepts(value: Any) -> bool:
        if not isinstance(value, tuple) or len(value) != len(rules):
            return False
        return all(rule.fault(each) is None for rule, each in zip(rules, value, strict=True))

    return _simple(needed, "", accepts)


def _list(item: Rule) -> Rule:
    """Return the rule of a list, a tuple or an array of some things; text is none."""
    of = "" if item is SIMPLE[Any] else f" of {item.several}"
    needed = f"a list{of}"

    def fault(value: Any) -> Fault | None:
        if not is_series(value):
            return Fault(value, needed)
        if item in ANYTHING:
            return None
        if item.array_fault and type(value) is np.ndarray and value.ndim == 1 and value.dtype.kind in "iuf":
            return item.array_fault(value)
        items = value[:1] if isinstance(value, range) else value  # of any length; all are whole numbers
        found = ((k, item.fault(each)) for k, each in enumerate(items))
        return next((part._replace(place=f"[{k}]{part.place}") for k, part in found if part), None)

    return Rule(needed, f"lists{of}", fault)


def _iterable(item: Rule) -> Rule:
    """Return the rule of some things in any container, or from a generator, which is read only once."""
    several = _list(item)

    def fault(value: Any) -> Fault | None:
        if isinstance(value, str | bytes | Sequence | np.ndarray) or not isinstance(value, Iterable):
            return several.fault(value)
        return several.fault(tuple(value)) if isinstance(value, Collection) else None

    return several._replace(fault=fault)


def _dictionary(key: Rule, item: Rule) -> Rule:
    values = "" if item is SIMPLE[Any] else f", values {item.several}"
    needed = f"a dictionary with keys {key.several}{values}"

    def fault(value: Any) -> Fault | None:
        if not isinstance(value, Mapping):
            return Fault(value, needed)
        for name, each in value.items():
            if found := key.fault(name):
                return found
            if found := item.fault(each):
                return found._replace(place=f"[{quoted(name)}]{found.place}")
        return None

    return Rule(needed, f"dictionaries with keys {key.several}{values}", fault)


def is_series(value: object) -> bool:
    """Return True for a list, a tuple, and an array of one dimension or more, of NumPy, pandas or another
    package; text is none."""
    if isinstance(value, Sequence):
        return not isinstance(value, str | bytes)
    dimensions = getattr(value, "ndim", 0)
    return isinstance(dimensions, int) and dimensions > 0 and not isinstance(value, type)


def _is_array(value: Any) -> bool:
    return isinstance(value, np.ndarray) and value.ndim > 0 and value.dtype.kind in "iufO"
