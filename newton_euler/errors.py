"""Errors, one class per kind, all under `NewtonEulerError`.

Every error keeps the raw values it was raised with as attributes and reads as one line.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable
from difflib import get_close_matches
from itertools import accumulate
from math import ceil, log10
from numbers import Integral, Real
from typing import Any, TypeGuard, TypeVar

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")

DISTRIBUTION = "crosscheck-dynamics"
"""The name under which pip knows this project; another project has the name `crosscheck` on PyPI."""

NEAR = 0.8
"""Similarity of two names, of which one may be meant by the other: a letter exchanged or left out of six."""

LONGEST_MESSAGE = 600
"""Characters of a message. Names and values that others give have any length."""

LONGEST_LIST = 250
"""Characters of the names that a message lists."""

PROPOSED = 3  # names that are proposed instead of an unknown one, as difflib has it
DECIMAL = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")  # a number as people write it


def one_line(text: str) -> str:
    """Return a text as one line of printable characters, others as their codes.

    A text of more than `LONGEST_MESSAGE` characters keeps its beginning and its end, which states the reason.
    """
    line = " ".join(text.split())
    if not line.isprintable():
        line = "".join(each if each.isprintable() else ascii(each)[1:-1] for each in line)
    half = LONGEST_MESSAGE // 2
    return line if len(line) <= LONGEST_MESSAGE else f"{line[: half - 5]} ... {line[-half:]}"


class NewtonEulerError(Exception):
    """Base of every error that `newton_euler` raises on purpose; reads as one line.

    Examples:
        >>> try:
        ...     Polynomial(())
        ... except NewtonEulerError as error:
        ...     print(error)
        polynomial: coefficients is (); needed: one finite number or more, lowest power first
    """

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


class MissingPackageError(NewtonEulerError):
    """An optional package is not installed.

    Attributes:
        package: its import name.
        extra: the extra of this distribution that installs it.
    """

    def __init__(self, package: str, extra: str) -> None:
        self.package, self.extra = package, extra
        super().__init__(
            f"{package} is not installed; install it by: python -m pip install '{DISTRIBUTION}[{extra}]'"
        )

    def __reduce__(self) -> tuple[type[MissingPackageError], tuple[str, str]]:
        return type(self), (self.package, self.extra)


class MechanismError(NewtonEulerError):
    """A mechanism or scene that cannot be: names the element, its value and what would be right."""

    def __init__(self, element: str, problem: str, needed: str) -> None:
        self.element = element
        self.problem = problem
        self.needed = needed
        super().__init__(f"{element}: {problem}; needed: {needed}")


def is_finite_number(value: object) -> bool:
    """True if a value is a real number of Python or NumPy that a float can hold; truth values are none."""
    try:
        return _is_real(value) and bool(np.isfinite(float(value)))
    except OverflowError:
        return False


def _is_real(value: object) -> TypeGuard[Real]:
    """True if a value is a real number; time spans of NumPy are integers by their class, and none."""
    return isinstance(value, Real) and not isinstance(value, bool | np.timedelta64)


def real_array(value: object) -> NDArray[Any]:
    """Convert real numbers of Python or NumPy to a new array of floats.

    Raises:
        TypeError, ValueError, OverflowError: for all else that NumPy converts, text, truth values and times
            among it, for numbers that are masked, rows of different lengths, and numbers beyond floats.
    """
    try:
        if _masks(value):
            raise ValueError("has masked numbers")
        array = np.asarray(value)
    except (MemoryError, RecursionError) as error:
        raise ValueError("has lists that are too deep, or too many numbers") from error
    of_objects = array.dtype.kind == "O" and all(map(_is_real, array.flat))
    if array.dtype.kind not in "iuf" and not of_objects:
        raise ValueError("has something else than real numbers")
    return array.astype(float)


def _masks(value: object) -> bool:
    """True if a value, or one of those in it, is a masked array with something that is masked."""
    if isinstance(value, np.ma.MaskedArray):
        return bool(np.ma.is_masked(value))
    return isinstance(value, list | tuple) and any(map(_masks, value))


def quoted(value: object, length: int = 100) -> str:
    """Return a value as Python shows it, or its beginning, for messages."""
    try:
        return f"{value!r:.{length}}"
    except ValueError:  # Python shows no whole numbers of thousands of digits
        return f"{type(value).__name__} with too many digits"
    except Exception:  # lists that are too deep, and whatever the classes of others raise
        return f"{type(value).__name__} that cannot be shown"


def plain_number(text: str) -> float:
    """Return a finite number from its decimal digits; raises `ValueError` for all else that `float` reads.

    Such as 1_0, digits of other alphabets and nan.
    """
    if not DECIMAL.fullmatch(text):
        raise ValueError(f"{text!r:.100} is no number")
    if not np.isfinite(number := float(text)):
        raise ValueError(f"{text!r:.100} is too large")
    return number


def is_count(value: object) -> bool:
    """True if a value is a whole number of Python or NumPy, 1 or more; truth values are none."""
    return is_whole(value) and int(value) >= 1


def is_whole(value: object) -> TypeGuard[Integral]:
    """True if a value is a whole number of Python or NumPy; truth values are none."""
    return isinstance(value, Integral) and _is_real(value)


def check_key(where: str, joint: object, coordinate: object) -> None:
    """Raise `MechanismError` for what is no name of a joint, and no whole number."""
    if not isinstance(joint, str):
        raise MechanismError(where, f"joint is {quoted(joint)}", "a name")
    if not is_whole(coordinate):
        raise MechanismError(where, f"coordinate is {quoted(coordinate)}", "an index from 0")


def check_texts(where: str, thing: object, *fields: str) -> None:
    """Raise `MechanismError` unless these attributes, names of elements, are text."""
    for field in fields:
        value = getattr(thing, field)
        if not isinstance(value, str):
            raise MechanismError(where, f"{field} is {quoted(value)}", "a name")


def check_flag(where: str, thing: object, field: str) -> None:
    """Raise `MechanismError` unless this attribute is a truth value."""
    if not isinstance(value := getattr(thing, field), bool):
        raise MechanismError(where, f"{field} is {quoted(value)}", "True or False")


def finite_array(element: str, name: str, value: object, shape: tuple[int, ...]) -> NDArray[Any]:
    """Convert a value to a read-only array of finite numbers; raises `MechanismError`."""
    try:
        array = real_array(value)
    except (TypeError, ValueError, OverflowError):
        array = np.full(1, np.nan)
    if array.shape != shape or not np.all(np.isfinite(array)):
        words = {(): "a finite number", (3,): "three finite numbers"}
        needed = words.get(shape, f"{int(np.prod(shape))} finite numbers, shape {shape}")
        raise MechanismError(element, f"{name} is {quoted(value, 200)}", needed)
    array.flags.writeable = False
    return array


def set_arrays(thing: object, element: str, **shapes: tuple[int, ...]) -> None:
    """Replace attributes by read-only arrays of these shapes, or floats for (); raises `MechanismError`."""
    for name, shape in shapes.items():
        value = finite_array(element, name, getattr(thing, name), shape)
        object.__setattr__(thing, name, value if shape else float(value))


def set_numbers(thing: object, element: str, names: Iterable[str], least: float = -np.inf) -> None:
    """Replace attributes by floats of at least `least`; raises `MechanismError`."""
    for name in names:
        value: Any = getattr(thing, name)
        if not is_finite_number(value) or value < least:
            needed = "a finite number" if np.isinf(least) else f"a finite number, {least:g} or more"
            raise MechanismError(element, f"{name} is {quoted(value)}", needed)
        object.__setattr__(thing, name, float(value))


def items_of(given: object) -> tuple[Any, ...] | None:
    """Return the items of a container; None for what is none, and for more items than memory holds."""
    if not isinstance(given, Iterable) or isinstance(given, str | bytes):
        return None
    if isinstance(given, np.ndarray) and given.ndim == 0:
        return None
    try:
        return tuple(given)
    except MemoryError:
        return None


def elements_of(where: str, field: str, given: Iterable[T], *kinds: type[T]) -> tuple[T, ...]:
    """Return elements of some kinds as a tuple; raises `MechanismError` for anything else."""
    needed = f"a tuple of {' or '.join(kind.__name__ for kind in kinds)}"
    elements = items_of(given)
    if elements is None:
        raise MechanismError(where, f"{field} is {quoted(given, 200)}", needed)
    for element in elements:
        if not isinstance(element, kinds):
            raise MechanismError(where, f"{field} holds {quoted(element, 200)}", needed)
    return elements


def choices(name: object, valid: Iterable[str]) -> str:
    """Word the valid names for somebody who gave another one, beginning with the nearest if one is near."""
    names = list(valid)
    near = get_close_matches(quoted(name).strip("'"), names, 1, NEAR)
    return "".join(f"did you mean {each!r}? " for each in near) + f"choose from: {listed(names)}"


def listed(names: Iterable[object]) -> str:
    """Return names with commas between them, of a long list the first ones and the number of the others.

    Examples:
        >>> listed(["crank", "coupler"])
        'crank, coupler'
        >>> listed(f"link_{k}" for k in range(100))[-30:]
        'link_29, link_30 and 69 others'
    """
    texts = list(map(str, names))
    lengths = accumulate(len(text) + 2 for text in texts)
    count = max(1, sum(length <= LONGEST_LIST for length in lengths))
    more = len(texts) - count
    return ", ".join(texts[:count]) + (f" and {more} other{'s' * (more > 1)}" if more > 0 else "")


def nearest(name: object, valid: Iterable[str]) -> tuple[str, ...]:
    """Return the valid names that are nearest to another one, where all of them are too many to list."""
    return tuple(get_close_matches(quoted(name).strip("'"), list(valid), PROPOSED, 0.0))


class UnknownNameError(NewtonEulerError):
    """A name that is not among the valid ones.

    Attributes:
        what: kind of what is named.
        name: that is unknown.
        valid: all names that are known, or, if `proposed`, some of them that may be meant.
    """

    def __init__(self, what: str, name: object, valid: tuple[str, ...], proposed: bool = False) -> None:
        self.what = what
        self.name = name
        self.valid = valid
        said = f"did you mean {', '.join(map(repr, valid))}?" if proposed else choices(name, valid)
        super().__init__(f"unknown {what} {quoted(name)}; {said}")


def check_choice(what: str, name: object, valid: Collection[str]) -> None:
    """Raise `UnknownNameError` for anything that is not among the valid names."""
    if not isinstance(name, str) or name not in valid:
        raise UnknownNameError(what, name, tuple(valid))


def check_choices(what: str, names: Iterable[str], valid: Collection[str]) -> None:
    """Raise `UnknownNameError` for the first name that is not among the valid ones."""
    for name in names:
        check_choice(what, name, valid)


class OptionError(NewtonEulerError):
    """An option of a solver with a value that it cannot take."""

    def __init__(self, option: str, value: object, needed: str) -> None:
        self.option = option
        self.value = value
        self.needed = needed
        super().__init__(f"{option} is {quoted(value, 1000)}; needed: {needed}")


class ArgumentError(OptionError):
    """An argument of a public function that is of another type than its hint, or out of its range.

    Attributes:
        function: name of the function.
        option: name of the argument.
        value: the argument, or the part of it that is at fault.
        needed: description of the valid values.

    Examples:
        >>> try:
        ...     linearize(load("pendulum"), time=np.inf)
        ... except ArgumentError as error:
        ...     print(error)
        newton_euler.linearize: time is inf; needed: a finite number
    """

    def __init__(self, function: str, argument: str, value: object, needed: str, verb: str = " is") -> None:
        self.function = function
        self.option = argument
        self.value = value
        self.needed = needed
        NewtonEulerError.__init__(self, f"{function}: {argument}{verb} {quoted(value)}; needed: {needed}")


class AssemblyError(NewtonEulerError):
    """Positions or velocities that cannot be made to meet the constraints."""

    def __init__(self, joint: str, violation: float, tolerance: float) -> None:
        self.joint = joint
        self.violation = violation
        self.tolerance = tolerance
        super().__init__(
            f"joint {joint!r} stays open by {violation:.3g} (m or rad) after assembly; "
            f"needed: at most {tolerance:.3g}"
        )


class NearlyRedundantWarning(UserWarning):
    """Constraints that noise in the numbers of a mechanism keeps from being redundant.

    Examples:
        >>> import warnings
        >>> warnings.simplefilter("error", NearlyRedundantWarning)  # to stop at such scenes
    """


class RoundOffWarning(UserWarning):
    """A tolerance that is smaller than the round-off of the equations of motion.

    Attributes:
        excess: the largest error estimate of a step that round-off explains, in units of the tolerance.
        rtol: a tolerance that the equations can meet.

    Examples:
        >>> import warnings
        >>> warnings.simplefilter("error", RoundOffWarning)  # to stop at such runs
    """

    def __init__(self, scene: str, formulation: str, rtol: float, atol: float, excess: float) -> None:
        self.excess = excess
        self.rtol = 10.0 ** ceil(log10(0.1 * excess * rtol))
        other = "relative" if formulation == "cartesian" else "cartesian"
        super().__init__(
            f"scene {scene!r}: rtol {rtol:.3g} is below the round-off of the equations: error estimates of "
            f"steps are up to {excess:.2g} times the tolerance, which shorter steps would not change; "
            f"use rtol={self.rtol:.0e}, atol={self.rtol * atol / rtol:.0e}, or formulation={other!r}"
        )


class IdentificationWarning(UserWarning):
    """Scenes that cannot move as measured, parameters that are not determined, and fits that ended early.

    Examples:
        >>> import warnings
        >>> warnings.simplefilter("error", IdentificationWarning)  # to refuse such fits
    """


class SingularityError(NewtonEulerError):
    """Equations of motion without a unique solution, and the joint they fail at."""

    def __init__(self, joint: str, reason: str) -> None:
        self.joint = joint
        self.reason = reason
        super().__init__(f"equations of motion are singular at joint {joint!r}: {reason}")


class SensitivityError(NewtonEulerError):
    """A run that has no derivatives, or whose derivatives are not known."""

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(f"no sensitivities: {reason}")


class VerificationError(NewtonEulerError):
    """A scene that is not what the file says: the first figure that differs, and where."""

    def __init__(self, quantity: str, value: float, tolerance: float, where: str) -> None:
        self.quantity = quantity
        self.value = value
        self.tolerance = tolerance
        self.where = where
        super().__init__(
            f"{where}: the scene is not what the file says: {quantity}: {value:.3g} > {tolerance:.3g}"
        )
