"""Arithmetic on arrays of generic scalars, so that the same equations work for floats and for other kinds of
numbers.

The equations of this package accept arrays whose elements are floats, or objects with the operations + - * /.
Such generic scalars are the symbols of the code generator (`newton_euler.codegen`) and `Stack`s (many numbers
that are computed at once). NumPy provides + - * @ for all of them: an array of objects has the dtype object.
This module provides the functions that NumPy does not provide for both kinds (`sin`, `sqrt`, `cross`, ...). A
generic scalar has methods `sin`, `cos`, `sqrt` and `arctan2`, as NumPy expects of objects.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]
"""An array of floats (dtype float64) or of generic scalars (dtype object)."""

Floats = NDArray[np.float64]
"""An array of floats."""

Scalar = Any
"""A float or a generic scalar."""

NUMBERS = (float, int)
"""Types of plain numbers for calls of `isinstance`, which are three times as fast with a tuple as with a
union of types."""

_LOWER_TRIANGLE = np.tri(3, dtype=bool)
"""(3, 3) mask of the lower triangle of a matrix, with the diagonal."""


class Stack:
    """Numbers (n,) of one quantity, such as its values at n times, as one generic scalar.

    Operations act on all n numbers at once. For an operation with an array, the operators return
    NotImplemented, so that NumPy applies the operation to each element of the array.

    Attributes:
        numbers: (n,) floats.
    """

    __slots__ = ("numbers",)

    def __init__(self, numbers: Any) -> None:
        self.numbers = np.asarray(numbers, dtype=float)

    def __add__(self, other: Any) -> Any:
        return NotImplemented if isinstance(other, np.ndarray) else Stack(self.numbers + _numbers(other))

    def __sub__(self, other: Any) -> Any:
        return NotImplemented if isinstance(other, np.ndarray) else Stack(self.numbers - _numbers(other))

    def __rsub__(self, other: Any) -> Any:
        return NotImplemented if isinstance(other, np.ndarray) else Stack(other - self.numbers)

    def __mul__(self, other: Any) -> Any:
        return NotImplemented if isinstance(other, np.ndarray) else Stack(self.numbers * _numbers(other))

    def __truediv__(self, other: Any) -> Any:
        return NotImplemented if isinstance(other, np.ndarray) else Stack(self.numbers / _numbers(other))

    def __rtruediv__(self, other: Any) -> Any:
        return NotImplemented if isinstance(other, np.ndarray) else Stack(other / self.numbers)

    __radd__, __rmul__ = __add__, __mul__

    def __neg__(self) -> Stack:
        return Stack(-self.numbers)

    def sin(self) -> Stack:
        return Stack(np.sin(self.numbers))

    def cos(self) -> Stack:
        return Stack(np.cos(self.numbers))

    def sqrt(self) -> Stack:
        return Stack(np.sqrt(self.numbers))

    def arctan2(self, x: Any) -> Stack:
        return Stack(np.arctan2(self.numbers, _numbers(x)))

    def minimum(self, other: Any) -> Stack:
        return Stack(np.minimum(self.numbers, _numbers(other)))


def _numbers(scalar: Any) -> Any:
    """Return the array of a `Stack`, or a plain number unchanged."""
    return scalar.numbers if isinstance(scalar, Stack) else scalar


def unstacked(scalars: Sequence[Any] | Array, count: int) -> Array:
    """Convert k scalars (`Stack`s of `count` numbers, or plain numbers) to an array of floats (count, k)."""
    floats = np.empty((count, len(scalars)))
    for column, scalar in zip(floats.T, scalars, strict=True):
        column[:] = _numbers(scalar)
    return floats


def mapped(function: Callable[..., Array], *arrays: Array) -> Array:
    """Apply a function for float arrays to arrays of floats, or of `Stack`s.

    Args:
        function: converts arrays of floats with the shapes of `arrays` to an array of floats (m,).
        arrays: floats or `Stack`s of n numbers.

    Returns:
        The result (m,). For `Stack`s the function is called n times, and the result has `Stack`s of n
        numbers.
    """
    if all(array.dtype != object for array in arrays):
        return function(*arrays)
    stacks = (each for array in arrays for each in array.flat if isinstance(each, Stack))
    count = max(len(stack.numbers) for stack in stacks)
    rows = [unstacked(array.ravel(), count).reshape(count, *array.shape) for array in arrays]
    return stacked_rows([function(*row) for row in zip(*rows, strict=True)])


def stacked_rows(rows: Sequence[Array] | Array) -> Array:
    """Combine n arrays of floats (m,) to one array (m,) of `Stack`s of n numbers."""
    return objects([Stack(column) for column in np.ascontiguousarray(np.transpose(rows))])


def objects(scalars: Sequence[Any]) -> Array:
    """Return an object array (k,) of k scalars; `numpy.array` would convert some kinds of scalars to
    numbers."""
    array = np.empty(len(scalars), dtype=object)
    array[:] = scalars
    return array


def zeros(shape: int | tuple[int, ...], *like: Array) -> Array:
    """Return zeros of a shape, with a dtype that can hold the scalars of all arrays in `like`."""
    generic = any(np.asarray(a).dtype == object for a in like)
    return np.zeros(shape, dtype=object if generic else float)


def sin(x: Scalar) -> Scalar:
    """Return the sine of an angle in radians."""
    return np.sin(x) if isinstance(x, float) else x.sin()


def cos(x: Scalar) -> Scalar:
    """Return the cosine of an angle in radians."""
    return np.cos(x) if isinstance(x, float) else x.cos()


def sqrt(x: Scalar) -> Scalar:
    """Return the square root."""
    return np.sqrt(x) if isinstance(x, float) else x.sqrt()


def exp(x: Scalar) -> Scalar:
    """Return the exponential function of x, for |x| up to 40.

    For generic scalars, exp(x) = exp(x / 2^6)^(2^6), and exp(x / 2^6) is computed by its Taylor series.
    """
    if isinstance(x, float):
        return np.exp(x)
    squarings, terms = 6, 14  # the first omitted term of the series is (40 / 2^6)^15 / 15! = 7e-16
    x, power = x / 2.0**squarings, 1.0
    for k in range(terms, 0, -1):
        power = 1.0 + power * x / float(k)
    for _ in range(squarings):
        power = power * power
    return power


def arctan2(y: Scalar, x: Scalar) -> Scalar:
    """Return the angle of the point (x, y), rad, in (-pi, pi]. If y is a float and x is not, y must not be
    zero."""
    if not isinstance(y, float):
        return y.arctan2(x)
    if isinstance(x, float):
        return np.arctan2(y, x)
    # Only x has a method `arctan2`: arctan2(y, x) = pi / 2 - arctan2(x, y) for y > 0, and the negative of the
    # value for -y if y < 0
    right_angle = np.copysign(0.5 * np.pi, y)
    return right_angle - x.arctan2(abs(y)) if y > 0.0 else right_angle + x.arctan2(abs(y))


def minimum(x: Scalar, y: Scalar) -> Scalar:
    """Return the smaller of two scalars: floats, or generic scalars with a method `minimum`."""
    if isinstance(x, float) and isinstance(y, float):
        return min(x, y)
    return y.minimum(x) if isinstance(x, float) else x.minimum(y)


def positive_part(x: Scalar) -> Scalar:
    """Return x if it is positive, else 0; for floats, or generic scalars with a method `minimum`."""
    return x - minimum(x, 0.0)


def cross(a: Array, b: Array) -> Array:
    """Return the cross product of two vectors (3,); much faster than `numpy.cross` for one pair."""
    return np.array(cross_of(a.tolist(), b.tolist()))


def cross_of(a: Sequence[Scalar], b: Sequence[Scalar]) -> list[Scalar]:
    """Return the cross product of two sequences of three scalars; faster with lists of floats than with
    arrays."""
    (x, y, z), (u, v, w) = a, b
    return [y * w - z * v, z * u - x * w, x * v - y * u]


def tilde(a: Array) -> Array:
    """Return the skew-symmetric matrix (3, 3) of a vector a (3,): `tilde(a) @ b == cross(a, b)` for any b
    (3,)."""
    x, y, z = a.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def symmetric(matrix: Array) -> Array:
    """Return a matrix (3, 3) with its upper triangle replaced by the lower one, to remove round-off
    asymmetry."""
    return np.where(_LOWER_TRIANGLE, matrix, matrix.T)
