"""Arrays of generic scalars: the few functions that floats and other scalars do not share.

The equations of this package are written over arrays whose elements are floats or any scalar
with the four operations. NumPy gives `+ - * @` for both (an array of anything but numbers has
dtype object); what differs is here. A scalar other than a number supplies methods `sin`, `cos`,
`sqrt` and `arctan2`, the names NumPy itself looks up on objects.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]  # an array of floats (dtype float64) or of generic scalars (dtype object)
Floats = NDArray[np.float64]  # an array of floats
Scalar = Any  # A float or a generic scalar

NUMBERS = (float, int)  # plain ones; `isinstance` takes a tuple in a third of the time of a union
LOWER = np.tri(3, dtype=bool)  # the lower triangle of a (3, 3) matrix, with its diagonal
TERMS, SQUARES = 14, 6  # of the exponential function: (20 / 2^6)^15 / 15! is 1e-20


class Stack:
    """Numbers (n,) of one quantity at n times, as one generic scalar; NumPy takes arrays of such apart."""

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


def _numbers(scalar: Any) -> Any:
    return scalar.numbers if isinstance(scalar, Stack) else scalar


def unstacked(scalars: Sequence[Any] | Array, count: int) -> Array:
    """Collect k scalars, stacks or numbers, as an array (count, k)."""
    found = np.empty((count, len(scalars)))
    for column, scalar in zip(found.T, scalars, strict=True):
        column[:] = _numbers(scalar)
    return found


def mapped(function: Callable[[Array], Array], array: Array) -> Array:
    """Apply a function of an array of numbers; to an array of stacks for each of their numbers in turn."""
    if array.dtype != object:
        return function(array)
    count = max(len(scalar.numbers) for scalar in array.flat if isinstance(scalar, Stack))
    rows = [function(row.reshape(array.shape)) for row in unstacked(array.ravel(), count)]
    return objects([Stack(column) for column in np.transpose(rows)])


def objects(scalars: Sequence[Any]) -> Array:
    """Make an object array of scalars, which NumPy must not look into."""
    array = np.empty(len(scalars), dtype=object)
    array[:] = scalars
    return array


def zeros(shape: int | tuple[int, ...], *like: Array) -> Array:
    """Make zeros of the given shape that can hold the scalars of all arrays in `like`."""
    generic = any(np.asarray(a).dtype == object for a in like)
    return np.zeros(shape, dtype=object if generic else float)


def sin(x: Scalar) -> Scalar:
    """Sine of an angle in radians."""
    return np.sin(x) if isinstance(x, float) else x.sin()


def cos(x: Scalar) -> Scalar:
    """Cosine of an angle in radians."""
    return np.cos(x) if isinstance(x, float) else x.cos()


def sqrt(x: Scalar) -> Scalar:
    """Square root."""
    return np.sqrt(x) if isinstance(x, float) else x.sqrt()


def exp(x: Scalar) -> Scalar:
    """Exponential function, for |x| up to 20; of generic scalars by Taylor's series, and squares."""
    if isinstance(x, float):
        return np.exp(x)
    x, found = x / 2.0**SQUARES, 1.0
    for k in range(TERMS, 0, -1):
        found = 1.0 + found * x / float(k)
    for _ in range(SQUARES):
        found = found * found
    return found


def arctan2(y: Scalar, x: Scalar) -> Scalar:
    """Angle of the point (x, y) in radians, in (-pi, pi]; a number y is not zero where x is none."""
    if not isinstance(y, float):
        return y.arctan2(x)
    if isinstance(x, float):
        return np.arctan2(y, x)
    right_angle = np.copysign(0.5 * np.pi, y)
    return right_angle - x.arctan2(abs(y)) if y > 0.0 else right_angle + x.arctan2(abs(y))


def minimum(x: Scalar, y: Scalar) -> Scalar:
    """The lesser of two scalars."""
    if isinstance(x, float) and isinstance(y, float):
        return min(x, y)
    return y.minimum(x) if isinstance(x, float) else x.minimum(y)


def cross(a: Array, b: Array) -> Array:
    """Cross product of two (3,) vectors; much quicker than `numpy.cross` on one pair."""
    return np.array(cross_of(a.tolist(), b.tolist()))


def cross_of(a: Sequence[Scalar], b: Sequence[Scalar]) -> list[Scalar]:
    """Cross product of three scalars each; Python's floats are quicker than elements of arrays."""
    (x, y, z), (u, v, w) = a, b
    return [y * w - z * v, z * u - x * w, x * v - y * u]


def tilde(a: Array) -> Array:
    """The (3, 3) skew-symmetric matrix with `tilde(a) @ b == cross(a, b)` for a (3,) vector."""
    x, y, z = a.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def symmetric(matrix: Array) -> Array:
    """Copy the lower triangle of a (3, 3) matrix that is symmetric but for round-off to the upper one."""
    return np.where(LOWER, matrix, matrix.T)
