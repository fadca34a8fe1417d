"""Error and warning classes, and functions that check values and raise these errors.

All errors are subclasses of `NewtonEulerError`. The message of an error is one line: the element, what is
wrong, and what is needed. The values of the message are also attributes of the error.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Sequence
from difflib import get_close_matches
from itertools import accumulate
from math import ceil, log10
from numbers import Integral, Real
from typing import Any, TypeGuard, TypeVar

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")

DISTRIBUTION = "crosscheck-dynamics"
"""Name of this project's distribution for pip; another project has the name `crosscheck` on PyPI."""

MIN_NAME_SIMILARITY = 0.8
"""Similarity (`difflib`, 0 to 1) from which a valid name is proposed for an unknown name: one wrong letter of
six."""

LONGEST_MESSAGE = 600
"""Largest number of characters of a message, because names and values from users may have any length."""

LONGEST_LIST = 250
"""Largest number of characters of a list of names in a message."""

MAX_PROPOSED_NAMES = 3
"""Number of similar names that a message proposes instead of an unknown name."""

DECIMAL = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?")
"""Pattern of a decimal number as people write it, such as -1.5e3."""


def one_line(text: str) -> str:
    """Convert text to one line of printable characters; other characters are replaced by their escape codes.

    If the text is longer than `LONGEST_MESSAGE`, its middle is omitted, because the end states the reason of
    an error.
    """
    line = " ".join(text.split())
    if not line.isprintable():
        line = "".join(each if each.isprintable() else ascii(each)[1:-1] for each in line)
    half = LONGEST_MESSAGE // 2
    return line if len(line) <= LONGEST_MESSAGE else f"{line[: half - 5]} ... {line[-half:]}"


class NewtonEulerError(Exception):
    """Base class of every error that `newton_euler` raises on purpose; the message is one line.

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
        package: import name of the package.
        extra: name of the extra of this distribution (group of optional packages) that installs it.
    """

    def __init__(self, package: str, extra: str) -> None:
        self.package, self.extra = package, extra
        super().__init__(
            f"{package} is not installed; install it by: python -m pip install '{DISTRIBUTION}[{extra}]'"
        )

    def __reduce__(self) -> tuple[type[MissingPackageError], tuple[str, str]]:
        """Return how to construct the error again when it is unpickled in another process."""
        return type(self), (self.package, self.extra)


class UnusablePackageError(NewtonEulerError):
    """An installed package that cannot be used: of another version than needed, or broken.

    Attributes:
        package: name of the package, or of what it provides.
        problem: what is wrong with the installed package.
        needed: packages and versions that can be used, as pip takes them, such as "numpy>=2.0".
    """

    def __init__(self, package: str, problem: str, needed: str) -> None:
        self.package, self.problem, self.needed = package, problem, needed
        super().__init__(
            f"{package} {problem}; needed: {needed}, as by: python -m pip install --upgrade '{needed}'"
        )

    def __reduce__(self) -> tuple[type[UnusablePackageError], tuple[str, str, str]]:
        """Return how to construct the error again when it is unpickled in another process."""
        return type(self), (self.package, self.problem, self.needed)


class MechanismError(NewtonEulerError):
    """An invalid value in a mechanism or scene (a mechanism with its forces, initial state and duration).

    Attributes:
        element: name of the element, such as "joint 'hinge'".
        problem: what is wrong, with the value.
        needed: description of valid values.
    """

    def __init__(self, element: str, problem: str, needed: str) -> None:
        self.element = element
        self.problem = problem
        self.needed = needed
        super().__init__(f"{element}: {problem}; needed: {needed}")


class NoEquilibriumError(MechanismError):
    """A mechanism that never comes to rest, on the assembly branch that its search for a pose follows.

    Attributes:
        coordinate: name of the joint coordinate that still accelerates the most.

    The other parameter is the name of the scene.
    """

    def __init__(self, scene: str, coordinate: object) -> None:
        self.coordinate = coordinate
        super().__init__(
            f"scene {scene!r}",
            f"has no equilibrium on the branch of its start: coordinate {coordinate!r} still accelerates",
            "a spring or a control law that holds it",
        )


def is_finite_number(value: object) -> bool:
    """Return True for a finite real number of Python or NumPy in the range of floats; False for booleans."""
    try:
        return _is_real(value) and bool(np.isfinite(float(value)))
    except OverflowError:
        return False


def _is_real(value: object) -> TypeGuard[Real]:
    """Return True for a real number; False for booleans and NumPy time spans, which are subclasses of
    integers."""
    return isinstance(value, Real) and not isinstance(value, bool | np.timedelta64)


def real_array(value: object) -> NDArray[Any]:
    """Convert real numbers of Python or NumPy to a new array of floats.

    Raises:
        TypeError, ValueError, OverflowError: for other values, such as text, booleans and times, for masked
            numbers, rows of different lengths, and numbers beyond the range of floats.
    """
    try:
        if _masks(value):
            raise ValueError("has masked numbers")
        array = np.asarray(value)
    except (MemoryError, RecursionError) as error:
        raise ValueError("has lists that are too deep, or too many numbers") from error
    holds_numbers = array.dtype.kind == "O" and all(map(_is_real, array.flat))
    if array.dtype.kind not in "iuf" and not holds_numbers:
        raise ValueError("has something else than real numbers")
    return array.astype(float)


def _masks(value: object) -> bool:
    """Return True if a value is, or as a list contains, a NumPy masked array with a masked number."""
    if isinstance(value, np.ma.MaskedArray):
        return bool(np.ma.is_masked(value))
    return isinstance(value, list | tuple) and any(map(_masks, value))


def quoted(value: object, length: int = 100) -> str:
    """Return the `repr` of a value for a message, cut to a number of characters; never raises an error."""
    try:
        return f"{value!r:.{length}}"
    except ValueError:  # Python refuses to format integers of thousands of digits
        return f"{type(value).__name__} with too many digits"
    except Exception:  # lists that are nested too deeply, and any error of a user's class
        return f"{type(value).__name__} that cannot be shown"


def plain_number(text: str) -> float:
    """Convert a decimal number in text to a finite float.

    Raises:
        ValueError: for other text, also if `float` accepts it, such as "1_0", "nan" and digits of other
            scripts.
    """
    if not DECIMAL.fullmatch(text):
        raise ValueError(f"{text!r:.100} is no number")
    if not np.isfinite(number := float(text)):
        raise ValueError(f"{text!r:.100} is too large")
    return number


def is_count(value: object) -> bool:
    """Return True for an integer of Python or NumPy that is 1 or more; False for booleans."""
    return is_whole(value) and int(value) >= 1


def is_whole(value: object) -> TypeGuard[Integral]:
    """Return True for an integer of Python or NumPy; False for booleans."""
    return isinstance(value, Integral) and _is_real(value)


def check_key(where: str, joint: object, coordinate: object) -> None:
    """Raise `MechanismError` unless a joint coordinate consists of text (name of a joint) and an integer
    (index).

    Args:
        where: name of the element that refers to the coordinate, for the message.
        joint, coordinate: the two values.
    """
    if not isinstance(joint, str):
        raise MechanismError(where, f"joint is {quoted(joint)}", "a name")
    if not is_whole(coordinate):
        raise MechanismError(where, f"coordinate is {quoted(coordinate)}", "an index from 0")


def check_texts(where: str, thing: object, *fields: str) -> None:
    """Raise `MechanismError` unless the given attributes of an object, which are names of elements, are text.

    Args:
        where: name of the object, for the message.
        thing: the object.
        fields: names of the attributes.
    """
    for field in fields:
        value = getattr(thing, field)
        if not isinstance(value, str):
            raise MechanismError(where, f"{field} is {quoted(value)}", "a name")


def check_flag(where: str, thing: object, field: str) -> None:
    """Raise `MechanismError` unless an attribute of an object is a boolean; arguments as of `check_texts`."""
    if not isinstance(value := getattr(thing, field), bool):
        raise MechanismError(where, f"{field} is {quoted(value)}", "True or False")


def finite_array(element: str, name: str, value: object, shape: tuple[int, ...]) -> NDArray[Any]:
    """Convert a value to a read-only array of finite floats.

    Args:
        element: name of the element, for the message.
        name: name of the attribute, for the message.
        value: the value.
        shape: required shape of the array; () for a number.

    Raises:
        MechanismError: for numbers that are not finite, another shape, and anything but numbers.
    """
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


def set_finite_arrays(thing: object, element: str, **shapes: tuple[int, ...]) -> None:
    """Convert attributes of a frozen object to read-only arrays of finite floats, or to finite floats for the
    shape ().

    Args:
        thing: the object.
        element: name of the object, for the message.
        shapes: required shape by the name of the attribute.

    Raises:
        MechanismError: as `finite_array`.
    """
    for name, shape in shapes.items():
        value = finite_array(element, name, getattr(thing, name), shape)
        object.__setattr__(thing, name, value if shape else float(value))


def set_numbers(thing: object, element: str, names: Iterable[str], least: float = -np.inf) -> None:
    """Convert attributes of a frozen object to floats.

    Args:
        thing: the object.
        element: name of the object, for the message.
        names: names of the attributes.
        least: smallest allowed value.

    Raises:
        MechanismError: for a value that is not a finite number, or is too small.
    """
    for name in names:
        value: Any = getattr(thing, name)
        if not is_finite_number(value) or value < least:
            needed = "a finite number" if np.isinf(least) else f"a finite number, {least:g} or more"
            raise MechanismError(element, f"{name} is {quoted(value)}", needed)
        object.__setattr__(thing, name, float(value))


def items_of(given: object) -> tuple[Any, ...] | None:
    """Return the items of a container as a tuple; None for text, for a value that is no container, and for a
    container that does not fit into memory."""
    if not isinstance(given, Iterable) or isinstance(given, str | bytes):
        return None
    if isinstance(given, np.ndarray) and given.ndim == 0:
        return None
    try:
        return tuple(given)
    except MemoryError:
        return None


def elements_of(where: str, field: str, given: Iterable[T], *kinds: type[T]) -> tuple[T, ...]:
    """Return the items of a container as a tuple, after a check of their classes.

    Args:
        where: name of the owner of the elements, for the message.
        field: name of the attribute that holds the elements, for the message.
        given: the container.
        kinds: allowed classes of the elements.

    Raises:
        MechanismError: for a value that is not a container, and an element of another class.
    """
    needed = f"a tuple of {' or '.join(kind.__name__ for kind in kinds)}"
    elements = items_of(given)
    if elements is None:
        raise MechanismError(where, f"{field} is {quoted(given, 200)}", needed)
    for element in elements:
        if not isinstance(element, kinds):
            raise MechanismError(where, f"{field} holds {quoted(element, 200)}", needed)
    return elements


def choices(name: object, valid: Iterable[str]) -> str:
    """Return text for a message about an unknown name: the most similar valid name, if any, and all valid
    names."""
    names = list(valid)
    similar = get_close_matches(quoted(name).strip("'"), names, 1, MIN_NAME_SIMILARITY)
    return "".join(f"did you mean {each!r}? " for each in similar) + f"choose from: {listed(names)}"


def listed(names: Iterable[object]) -> str:
    """Join names by commas; of a long list the first names and the number of the other names.

    Examples:
        >>> listed(["crank", "coupler"])
        'crank, coupler'
        >>> listed(f"link_{k}" for k in range(100))[-30:]
        'link_29, link_30 and 69 others'
    """
    texts = list(map(str, names))
    lengths = accumulate(len(text) + 2 for text in texts)
    count = max(1, sum(length <= LONGEST_LIST for length in lengths))
    others = len(texts) - count
    return ", ".join(texts[:count]) + (f" and {others} other{'s' * (others > 1)}" if others > 0 else "")


def nearest(name: object, valid: Iterable[str]) -> tuple[str, ...]:
    """Return the valid names that are most similar to an unknown name, if there are too many valid names to
    list."""
    return tuple(get_close_matches(quoted(name).strip("'"), list(valid), MAX_PROPOSED_NAMES, 0.0))


class UnknownNameError(NewtonEulerError):
    """A name that is not among the valid names.

    Attributes:
        what: kind of thing that the name should name, such as "joint".
        name: the unknown name.
        valid: all valid names, or, if the argument `proposed` is True, a few similar ones.
    """

    def __init__(self, what: str, name: object, valid: tuple[str, ...], proposed: bool = False) -> None:
        self.what = what
        self.name = name
        self.valid = valid
        advice = f"did you mean {', '.join(map(repr, valid))}?" if proposed else choices(name, valid)
        super().__init__(f"unknown {what} {quoted(name)}; {advice}")


def check_choice(what: str, name: object, valid: Collection[str]) -> None:
    """Raise `UnknownNameError` for a value that is not among the valid names; `what` is the kind of named
    thing."""
    if not isinstance(name, str) or name not in valid:
        raise UnknownNameError(what, name, tuple(valid))


def check_choices(what: str, names: Iterable[str], valid: Collection[str]) -> None:
    """Raise `UnknownNameError` for the first of several names that is not valid, see `check_choice`."""
    for name in names:
        check_choice(what, name, valid)


class OptionError(NewtonEulerError):
    """An option of a solver or command with an invalid value.

    Attributes:
        option: name of the option.
        value: the invalid value.
        needed: description of valid values.
    """

    def __init__(self, option: str, value: object, needed: str) -> None:
        self.option = option
        self.value = value
        self.needed = needed
        # the message shortens long values in the middle, so that the end of a path remains
        super().__init__(f"{option} is {quoted(value, 1000)}; needed: {needed}")


class ArgumentError(OptionError):
    """An argument of a public function with a value that its type hint excludes.

    Attributes:
        function: name of the function.
        option: name of the argument.
        value: the argument, or the invalid part of it.
        needed: description of valid values.

    The parameter `verb` is the text between the name of the argument and the value in the message: " is", or
    a place and a verb, such as "[2] is".

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
    """Positions or velocities that cannot be corrected to satisfy the joint constraints.

    Attributes:
        joint: name of the joint with the largest constraint violation.
        violation: constraint violation of this joint after the correction, m or rad.
        tolerance: largest allowed violation, m or rad.
    """

    def __init__(self, joint: str, violation: float, tolerance: float) -> None:
        self.joint = joint
        self.violation = violation
        self.tolerance = tolerance
        super().__init__(
            f"joint {joint!r} stays open by {violation:.3g} (m or rad) after assembly; "
            f"needed: at most {tolerance:.3g}"
        )


class NearlyRedundantWarning(UserWarning):
    """Constraints that would be redundant without noise in the numbers of the mechanism, such as rounded
    coordinates of joint points.

    Examples:
        >>> import warnings
        >>> warnings.simplefilter("error", NearlyRedundantWarning)  # to stop at such scenes
    """


class RoundOffWarning(UserWarning):
    """An integration tolerance that is below the round-off of the equations of motion.

    Attributes:
        excess: largest error estimate of a step that is due to round-off, in units of the tolerance.
        rtol: proposed relative tolerance, which round-off allows: a power of 10.

    The other parameters are the names of the scene and of its formulation, and the tolerances of the run. A
    formulation is a choice of coordinates: joint coordinates ("relative") or poses of bodies ("cartesian").

    Examples:
        >>> import warnings
        >>> warnings.simplefilter("error", RoundOffWarning)  # to stop at such runs
    """

    def __init__(self, scene: str, formulation: str, rtol: float, atol: float, excess: float) -> None:
        self.excess = excess
        self.rtol = 10.0 ** ceil(log10(0.1 * excess * rtol))  # error estimates are then at most 10 tolerances
        other = "relative" if formulation == "cartesian" else "cartesian"
        super().__init__(
            f"scene {scene!r}: rtol {rtol:.3g} is below the round-off of the equations: error estimates of "
            f"steps are up to {excess:.2g} times the tolerance, which shorter steps would not change; "
            f"use rtol={self.rtol:.0e}, atol={self.rtol * atol / rtol:.0e}, or formulation={other!r}"
        )


class BranchWarning(UserWarning):
    """An equilibrium on another assembly branch than the start.

    Attributes:
        coordinates: names of the joint coordinates that do not determine the pose at the singular
            configuration between the branches.

    The other parameter is the name of the scene.

    Examples:
        >>> import warnings
        >>> warnings.simplefilter("error", BranchWarning)  # to stop at such equilibria
    """

    def __init__(self, scene: str, coordinates: Sequence[object]) -> None:
        self.coordinates = tuple(coordinates)
        super().__init__(
            f"scene {scene!r}: the equilibrium lies beyond a singular configuration of "
            f"{listed(map(repr, coordinates))}, on another assembly branch than the start"
        )


class IdentificationWarning(UserWarning):
    """Problems of the identification of parameters from measured motion: motion that the scene cannot follow,
    parameters that are not identifiable, and fits that end before they converge.

    Examples:
        >>> import warnings
        >>> warnings.simplefilter("error", IdentificationWarning)  # to refuse such fits
    """


class SingularityError(NewtonEulerError):
    """Equations of motion that have no unique solution at a state.

    Attributes:
        joint: name of the joint whose equations are dependent; None if the cause is no joint, as in a state
            that is not finite.
        reason: why the solution is not unique.
    """

    def __init__(self, joint: str | None, reason: str) -> None:
        self.joint = joint
        self.reason = reason
        at_joint = "" if joint is None else f" at joint {joint!r}"
        super().__init__(f"equations of motion are singular{at_joint}: {reason}")


class SensitivityError(NewtonEulerError):
    """A run whose derivatives with respect to parameters do not exist or are not implemented.

    Attributes:
        reason: why there are no derivatives.
    """

    def __init__(self, reason: str) -> None:
        self.reason = reason
        super().__init__(f"no sensitivities: {reason}")


class VerificationError(NewtonEulerError):
    """An imported scene that does not match its model file.

    Attributes:
        quantity: name of the first check that fails.
        value: value of the check.
        tolerance: largest allowed value.
        where: element of the file where the check fails.
    """

    def __init__(self, quantity: str, value: float, tolerance: float, where: str) -> None:
        self.quantity = quantity
        self.value = value
        self.tolerance = tolerance
        self.where = where
        super().__init__(
            f"{where}: the scene is not what the file says: {quantity}: {value:.3g} > {tolerance:.3g}"
        )
