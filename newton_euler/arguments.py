"""Check the arguments of public functions by their type hints, before any work begins.

A function with the decorator `checked` raises `ArgumentError` for an argument that its type hint excludes.
Keyword options that are declared by an unpacked `TypedDict` are checked as well. Missing, unknown and surplus
arguments raise `TypeError`, as for any Python function.

`_rule` converts a type hint to a `Rule`: a description of valid values for messages, and a function that
finds what is wrong with a value. The rules of a function are computed once, at its first call.
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
"""Names of the packages of this project."""

CREATED_BY = {
    "Poses": "solve_poses(scene, ...)",
    "State": "initial_state(scene)",
    "Trajectory": "simulate(scene)",
}
"""Calls that create objects of classes whose constructor users rarely call, by class name, for messages."""

UNCHECKED = "unchecked"
"""Mark in the hint of an argument that the function checks itself: `Annotated[Sequence[float],
UNCHECKED]`."""


@dataclass(frozen=True)
class Range:
    """Range of a number, for use in a type hint: `Annotated[int, Range(1, 4096)]`.

    Attributes:
        least, most: smallest and largest allowed value.
    """

    least: float = -np.inf
    most: float = np.inf

    def __str__(self) -> str:
        if np.isinf(self.most):
            return "" if np.isinf(self.least) else f", {self.least} or more"
        return f", {self.least} to {self.most}"


class Fault(NamedTuple):
    """The part of an argument that violates a rule.

    Attributes:
        value: the invalid part, or the whole argument.
        needed: description of valid values.
        place: index or key of the part in the argument, such as `[2]`; empty if the part is the whole
            argument or a key of a dictionary.
    """

    value: object
    needed: str
    place: str = ""


class Rule(NamedTuple):
    """The values that a type hint allows.

    Attributes:
        needed: description of a valid value, such as "a finite number".
        several: description of several valid values, such as "finite numbers".
        fault: function that returns the fault of a value, or None for a valid value.
        array_fault: function that does the same for an array (n,) of numbers at once; None unless the rule is
            for numbers.
    """

    needed: str
    several: str
    fault: Callable[[Any], Fault | None]
    array_fault: Callable[[Array], Fault | None] | None = None


class ArgumentRules(NamedTuple):
    """The rules of all arguments of a function."""

    positional: tuple[tuple[str, Rule | None], ...]
    """Name and rule of each argument that may be passed by position; None for an argument without a rule."""
    named: Mapping[str, Rule]
    """Rules of the arguments that may be passed by keyword, by name."""
    others: Rule | None
    """Rule of all other keyword arguments (`**kwargs`), if they have one."""


def checked(function: Callable[P, T]) -> Callable[P, T]:
    """Decorate a function so that it raises `ArgumentError` for arguments that its type hints exclude.

    Hints with names that a module imports only for type checkers are unknown when a program runs; such
    arguments are not checked.

    Examples:
        >>> @checked
        ... def half(number: float) -> float:
        ...     return number / 2
        >>> half("1")
        Traceback (most recent call last):
        newton_euler.errors.ArgumentError: __main__.half: number is '1'; needed: a finite number
    """

    @cache
    def argument_rules() -> ArgumentRules:
        return _rules(function)

    @wraps(function)
    def call(*args: P.args, **kwargs: P.kwargs) -> T:
        rules = argument_rules()
        for (name, rule), value in zip(rules.positional, args, strict=False):
            if rule is not None and (fault := rule.fault(value)) is not None:
                raise _error(function, name, value, fault)
        for name, value in kwargs.items():
            rule = rules.named.get(name, rules.others)
            if rule is not None and (fault := rule.fault(value)) is not None:
                raise _error(function, name, value, fault)
        return function(*args, **kwargs)

    return call


def caller_level() -> int:
    """Return the `stacklevel` with which `warnings.warn` names the user's line that called into these
    packages."""
    frame, level = sys._getframe(1), 1
    while frame.f_back is not None and frame.f_globals.get("__name__", "").partition(".")[0] in PACKAGES:
        frame, level = frame.f_back, level + 1
    return level


def _error(function: Callable[..., Any], name: str, value: object, fault: Fault) -> ArgumentError:
    """Return the error for an argument of a function; the message shows the part of the argument that is
    invalid."""
    verb = "is" if fault.place or fault.value is value else "holds"
    package = function.__module__.partition(".")[0]
    where = f"{package}.{function.__qualname__}"
    return ArgumentError(where, name, fault.value, fault.needed, verb=f"{fault.place} {verb}")


class _Names(dict[str, Any]):
    """Names of a module for the evaluation of type hints; unknown names become `Any`.

    Names that the module imports only for type checkers are unknown when a program runs.
    """

    def __missing__(self, name: str) -> Any:
        return getattr(builtins, name, Any)


def _rules(function: Callable[..., Any]) -> ArgumentRules:
    """Compute the rules of all arguments of a function from its signature and type hints."""
    plain = inspect.unwrap(function)
    hints = _hints(plain)
    positional: list[tuple[str, Rule | None]] = []
    named: dict[str, Rule] = {}
    others: Rule | None = None
    for name, parameter in inspect.signature(plain).parameters.items():
        hint = hints.get(name, Any)
        if get_origin(hint) is Unpack:  # **options: Unpack[SomeTypedDict]
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
    return ArgumentRules(tuple(positional), named, others)


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
    if origin is Annotated:  # arguments: the type, then `UNCHECKED` or a `Range`
        return SIMPLE[Any] if arguments[1] is UNCHECKED else _number(*arguments)
    if origin in (Union, UnionType):
        return _any_of([_rule(each) for each in arguments])
    if origin is Literal:  # the function itself refuses unknown words, with proposals
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
    if isinstance(hint, type):  # a class of this project, such as Scene
        name = hint.__name__
        article = "an" if name[0] in "AEIOU" else "a"
        created_by = f" ({CREATED_BY[name]})" if name in CREATED_BY else ""
        needed = f"{article} {name}{created_by}"
        return _simple(needed, f"{name} objects", lambda value: isinstance(value, hint))
    raise TypeError(f"no rule for the type hint {hint!r}")


def _simple(needed: str, several: str, accepts: Callable[[Any], bool]) -> Rule:
    """Return a rule for values that are valid or invalid as a whole.

    Args:
        needed, several: descriptions, see `Rule`; an empty `several` is replaced by `needed`.
        accepts: function that returns True for a valid value.
    """
    return Rule(needed, several or needed, lambda value: None if accepts(value) else Fault(value, needed))


SIMPLE: dict[Any, Rule] = {
    Any: _simple("anything", "", lambda value: True),
    ArrayLike: _simple("numbers", "", lambda value: True),
    NoneType: _simple("None", "", lambda value: value is None),
    str: _simple("text", "", lambda value: isinstance(value, str)),
    bool: _simple("True or False", "", lambda value: isinstance(value, bool | np.bool_)),
}
"""Rules of hints that have neither a range nor parts, by hint.

`ArrayLike` allows everything here, because functions convert and check such arguments themselves.
"""

ALLOWS_ANYTHING = (SIMPLE[Any], SIMPLE[ArrayLike])
"""Rules that allow every value."""


def _number(kind: type, span: Range) -> Rule:
    """Return the rule of an integer or a finite float within a range; `kind` is int or float."""
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
    """Return the rule of a union: a value is valid if it satisfies one of several rules.

    If no rule is satisfied, the fault is an invalid part of a container if one rule found such a part, else
    the value.
    """
    needed = " or ".join(dict.fromkeys(rule.needed for rule in rules))  # each description once
    several = " or ".join(dict.fromkeys(rule.several for rule in rules))

    def fault(value: Any) -> Fault | None:
        part: Fault | None = None
        for rule in rules:
            invalid = rule.fault(value)
            if invalid is None:
                return None
            if invalid.value is not value:  # the value is a container with an invalid part
                part = invalid
        return part or Fault(value, needed)

    return Rule(needed, several, fault)


def _tuple(rules: Sequence[Rule]) -> Rule:
    """Return the rule of a tuple of fixed length, with one rule for each item."""
    needed = f"({', '.join(rule.needed for rule in rules)})"

    def accepts(value: Any) -> bool:
        if not isinstance(value, tuple) or len(value) != len(rules):
            return False
        return all(rule.fault(each) is None for rule, each in zip(rules, value, strict=True))

    return _simple(needed, "", accepts)


def _list(item: Rule) -> Rule:
    """Return the rule of a list, a tuple or an array whose items satisfy a rule; text does not count as a
    list."""
    of = "" if item is SIMPLE[Any] else f" of {item.several}"
    needed = f"a list{of}"

    def fault(value: Any) -> Fault | None:
        if not is_series(value):
            return Fault(value, needed)
        if item in ALLOWS_ANYTHING:
            return None
        if item.array_fault and type(value) is np.ndarray and value.ndim == 1 and value.dtype.kind in "iuf":
            return item.array_fault(value)
        # a range may be very long; its items are all of one kind
        items = value[:1] if isinstance(value, range) else value
        faults = ((k, item.fault(each)) for k, each in enumerate(items))
        return next((part._replace(place=f"[{k}]{part.place}") for k, part in faults if part), None)

    return Rule(needed, f"lists{of}", fault)


def _iterable(item: Rule) -> Rule:
    """Return the rule of any iterable whose items satisfy a rule.

    Items of a generator are not checked, because a generator can be read only once.
    """
    several = _list(item)

    def fault(value: Any) -> Fault | None:
        if isinstance(value, str | bytes | Sequence | np.ndarray) or not isinstance(value, Iterable):
            return several.fault(value)
        return several.fault(tuple(value)) if isinstance(value, Collection) else None

    return several._replace(fault=fault)


def _dictionary(key: Rule, item: Rule) -> Rule:
    """Return the rule of a mapping whose keys and values satisfy one rule each."""
    values = "" if item is SIMPLE[Any] else f", values {item.several}"
    needed = f"a dictionary with keys {key.several}{values}"

    def fault(value: Any) -> Fault | None:
        if not isinstance(value, Mapping):
            return Fault(value, needed)
        for name, each in value.items():
            if invalid := key.fault(name):
                return invalid
            if invalid := item.fault(each):
                return invalid._replace(place=f"[{quoted(name)}]{invalid.place}")
        return None

    return Rule(needed, f"dictionaries with keys {key.several}{values}", fault)


def is_series(value: object) -> bool:
    """Return True for a list, a tuple, and an array of one dimension or more from NumPy, pandas or another
    package.

    Text is not a series.
    """
    if isinstance(value, Sequence):
        return not isinstance(value, str | bytes)
    dimensions = getattr(value, "ndim", 0)
    return isinstance(dimensions, int) and dimensions > 0 and not isinstance(value, type)


def _is_array(value: Any) -> bool:
    """Return True for a NumPy array of numbers or generic scalars with one dimension or more."""
    return isinstance(value, np.ndarray) and value.ndim > 0 and value.dtype.kind in "iufO"
