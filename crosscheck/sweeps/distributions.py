"""Distributions of the numbers that a sweep varies, and their text form on the command line."""

from __future__ import annotations

import ast
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri

from crosscheck.errors import CrosscheckError
from newton_euler.errors import choices, is_finite_number, plain_number
from newton_euler.scalars import Array

LONGEST = 10_000
"""Characters of a distribution's text."""

ROUND_OFF = 1e-12
"""Size of the smallest eigenvalue, negative by rounding, of a correlation that is singular."""


def _number(where: str, name: str, value: object, positive: bool = False) -> float:
    if not is_finite_number(value) or (positive and float(value) <= 0.0):  # type: ignore[arg-type]
        needed = "a positive number" if positive else "a finite number"
        raise CrosscheckError(f"{where}: {name} is {value!r:.100}; needed: {needed}")
    return float(value)  # type: ignore[arg-type]


def _arguments(*numbers: float) -> str:
    return ", ".join(f"{number:.17g}" for number in numbers)


class Distribution(ABC):
    """The distribution of one number."""

    @abstractmethod
    def quantile(self, u: Array) -> Array:
        """Return the values (n,) below which shares u (n,) between 0 and 1 of all values lie."""

    def of_normal(self, z: Array) -> Array:
        """Return the values (n,) that are as likely as the standard normal z (n,)."""
        return self.quantile(ndtr(z))


@dataclass(frozen=True)
class Values(Distribution):
    """Numbers, equally likely; a full grid takes each of them."""

    numbers: tuple[float, ...]

    def __init__(self, numbers: Iterable[float]) -> None:
        given = tuple(numbers)
        if not given:
            raise CrosscheckError("values() is an empty distribution; needed: one number or more")
        checked = tuple(_number(f"values, number {k + 1}", "it", each) for k, each in enumerate(given))
        object.__setattr__(self, "numbers", checked)

    @classmethod
    def spaced(cls, low: float, high: float, count: float) -> Values:
        """Return `count` numbers from low to high, evenly spaced."""
        _ordered("grid", low, high)
        if not is_finite_number(count) or count != int(count) or not 2 <= count <= LONGEST:
            raise CrosscheckError(f"grid: count is {count!r:.100}; needed: a whole number, 2 to {LONGEST}")
        return cls(np.linspace(low, high, int(count)).tolist())

    def quantile(self, u: Array) -> Array:
        numbers = np.array(self.numbers)
        return numbers[np.minimum((u * len(numbers)).astype(int), len(numbers) - 1)]

    def __str__(self) -> str:
        return f"values({_arguments(*self.numbers)})"


@dataclass(frozen=True)
class Uniform(Distribution):
    """Numbers between two bounds, equally likely."""

    low: float
    high: float

    def __post_init__(self) -> None:
        _ordered("uniform", self.low, self.high)

    def quantile(self, u: Array) -> Array:
        return self.low + (self.high - self.low) * u

    def __str__(self) -> str:
        return f"uniform({_arguments(self.low, self.high)})"


@dataclass(frozen=True)
class Normal(Distribution):
    """Gauss's distribution."""

    mean: float
    deviation: float

    def __post_init__(self) -> None:
        _number("normal", "mean", self.mean)
        _number("normal", "deviation", self.deviation, positive=True)

    def quantile(self, u: Array) -> Array:
        return self.of_normal(ndtri(u))

    def of_normal(self, z: Array) -> Array:
        return self.mean + self.deviation * z

    def __str__(self) -> str:
        return f"normal({_arguments(self.mean, self.deviation)})"


@dataclass(frozen=True)
class TruncatedNormal(Distribution):
    """Gauss's distribution without what lies outside two bounds; mean and deviation are those before."""

    mean: float
    deviation: float
    low: float
    high: float

    def __post_init__(self) -> None:
        where = "truncated_normal"
        _number(where, "mean", self.mean)
        _number(where, "deviation", self.deviation, positive=True)
        _ordered(where, self.low, self.high)
        if not np.diff(ndtr(self._bounds))[0] > 0.0:
            bounds = f"[{self.low:g}, {self.high:g}]"
            raise CrosscheckError(f"{where} is an empty distribution: next to nothing lies in {bounds}")

    @property
    def _bounds(self) -> Array:
        """(2,) the bounds in deviations from the mean, mirrored to where tails are small numbers."""
        bounds = (np.array([self.low, self.high]) - self.mean) / self.deviation
        return -bounds[::-1] if bounds[0] > 0.0 else bounds

    def quantile(self, u: Array) -> Array:
        mirrored = self.low > self.mean
        low, high = ndtr(self._bounds)
        z = ndtri(low + (high - low) * (1.0 - u if mirrored else u))
        return np.clip(self.mean + self.deviation * (-z if mirrored else z), self.low, self.high)

    def __str__(self) -> str:
        return f"truncated_normal({_arguments(self.mean, self.deviation, self.low, self.high)})"


def _ordered(where: str, low: object, high: object) -> None:
    if not _number(where, "low", low) < _number(where, "high", high):
        raise CrosscheckError(f"{where}({low:.9g}, {high:.9g}) is an empty distribution; needed: low < high")


@dataclass(frozen=True, eq=False)
class Correlated:
    """Several numbers together: their distributions, and how these are correlated.

    Attributes:
        distributions: of each number, n.
        correlation: (n, n) of the normal numbers that each is made of (a Gaussian copula): the correlation
            itself where the distributions are normal.
    """

    distributions: tuple[Distribution, ...]
    correlation: Array

    def __init__(self, distributions: Sequence[Distribution], correlation: object) -> None:
        count = len(distributions)
        matrix = _matrix("correlated", "correlation", correlation, count)
        if not np.array_equal(np.diag(matrix), np.ones(count)):
            raise CrosscheckError("correlated: the diagonal of correlation is not all 1")
        object.__setattr__(self, "distributions", tuple(distributions))
        object.__setattr__(self, "correlation", matrix)

    @classmethod
    def normal(cls, means: Sequence[float], covariance: object) -> Correlated:
        """Return normal numbers of some means (n,) and covariance (n, n)."""
        matrix = _matrix("normal", "covariance", covariance, len(means))
        deviations = np.sqrt(np.diag(matrix))
        normals = [Normal(m, float(d)) for m, d in zip(means, deviations, strict=True)]
        correlation = matrix / np.outer(deviations, deviations)
        np.fill_diagonal(correlation, 1.0)
        return cls(normals, correlation)

    def quantile(self, u: Array) -> Array:
        """Return the values (k, n) of independent shares u (k, n) between 0 and 1."""
        root, z = _cholesky(self.correlation), ndtri(u)
        # not a product of matrices, whose sums have an order that depends on their size
        mixed = [sum(root[i, j] * z[:, j] for j in range(i + 1)) for i in range(len(root))]
        columns = [each.of_normal(z) for each, z in zip(self.distributions, mixed, strict=True)]
        return np.stack(columns, axis=1)

    def __str__(self) -> str:
        rows = ", ".join(f"[{_arguments(*row)}]" for row in self.correlation)
        return f"correlated({', '.join(map(str, self.distributions))}, [{rows}])"


def _matrix(where: str, name: str, given: object, count: int) -> Array:
    """Return a matrix (count, count); raises `CrosscheckError` unless it is symmetric and not negative."""
    try:
        matrix = np.array(given, dtype=float)
    except (TypeError, ValueError):
        matrix = np.full(1, np.nan)
    if matrix.shape != (count, count) or not np.all(np.isfinite(matrix)):
        raise CrosscheckError(f"{where}: {name} is no matrix of {count} rows of {count} finite numbers")
    scale = np.sqrt(np.abs(np.diag(matrix)))
    if not np.all(np.diag(matrix) > 0.0) or not np.array_equal(matrix, matrix.T):
        raise CrosscheckError(f"{where}: {name} is not symmetric with a positive diagonal")
    if np.linalg.eigvalsh(matrix / np.outer(scale, scale))[0] < -ROUND_OFF:
        raise CrosscheckError(
            f"{where}: {name} has a negative eigenvalue; no numbers vary together like that"
        )
    return matrix


def _cholesky(matrix: Array) -> Array:
    """Return L (n, n), lower triangular, of a matrix L L^T that may be singular.

    LAPACK's last digits, and those of every run, would be the processor's.
    """
    count = len(matrix)
    root = np.zeros((count, count))
    for j in range(count):
        pivot = matrix[j, j] - sum(root[j, k] ** 2 for k in range(j))
        if pivot <= ROUND_OFF:
            continue
        root[j, j] = np.sqrt(pivot)
        for i in range(j + 1, count):
            root[i, j] = (matrix[i, j] - sum(root[i, k] * root[j, k] for k in range(j))) / root[j, j]
    return root


KINDS: dict[str, tuple[Callable[..., Distribution], int | None]] = {
    "values": (lambda *numbers: Values(numbers), None),
    "grid": (Values.spaced, 3),
    "uniform": (Uniform, 2),
    "normal": (Normal, 2),
    "truncated_normal": (TruncatedNormal, 4),
}
"""Distributions of one number by name, with how many arguments each takes."""

FORMS = "values(A, B, ...), grid(LOW, HIGH, COUNT), uniform(LOW, HIGH), normal(MEAN, DEVIATION), \
truncated_normal(MEAN, DEVIATION, LOW, HIGH)"

Vary = Mapping[str | tuple[str, ...], "Distribution | Correlated | str | Iterable[float]"]
"""Distributions, or texts of them or numbers, by the parameter that varies, or by several together."""


def parse_vary(given: Iterable[str]) -> dict[str | tuple[str, ...], Distribution | Correlated]:
    """Parse texts such as `panel_7.mass=normal(14, 0.5)`, or `A,B=correlated(...)` of several parameters.

    Raises:
        CrosscheckError: naming the text at fault.
    """
    found: dict[str | tuple[str, ...], Distribution | Correlated] = {}
    for text in given:
        name, equals, distribution = text.partition("=")
        names = tuple(part.strip() for part in name.split(","))
        if not (equals and distribution.strip() and all(names)):
            raise CrosscheckError(f"--vary {text!r:.200} is not of the form NAME=DISTRIBUTION: {FORMS}")
        key = names if len(names) > 1 else names[0]
        if key in found:
            raise CrosscheckError(f"--vary {name} is given twice")
        found[key] = parse(distribution.strip())
    return found


def parse(text: str) -> Distribution | Correlated:
    """Parse the text of a distribution: one of `KINDS`, or of several numbers together.

    These are `normal([MEANS], [[COVARIANCE]])` and `correlated(DISTRIBUTION, ..., [[CORRELATION]])`.

    Raises:
        CrosscheckError: quoting the text.
    """
    try:
        if len(text) > LONGEST:
            raise ValueError(f"is longer than {LONGEST} characters")
        found = _read(ast.parse(text, mode="eval").body, text)
    except SyntaxError:
        raise CrosscheckError(f"{text!r:.100} is no distribution; choose from: {FORMS}") from None
    except (ValueError, RecursionError, MemoryError) as error:
        raise CrosscheckError(f"{text!r:.100} is no distribution: {error}"[:400]) from None
    if not isinstance(found, Distribution | Correlated):
        raise CrosscheckError(f"{text!r:.100} is no distribution; choose from: {FORMS}")
    return found


def _read(node: ast.expr, text: str) -> object:
    """Evaluate numbers, lists and distributions; raises `ValueError` for all else."""
    if isinstance(node, ast.List):
        return [_read(each, text) for each in node.elts]
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        return _made(node.func.id, [_read(each, text) for each in node.args])
    source = ast.get_source_segment(text, node) or ""
    return plain_number(source.replace(" ", ""))


def _made(kind: str, arguments: list[object]) -> Distribution | Correlated:
    if kind == "correlated":
        *distributions, matrix = arguments or [None]
        if not distributions or not all(isinstance(each, Distribution) for each in distributions):
            raise ValueError(
                "correlated(DISTRIBUTION, DISTRIBUTION, ..., [[CORRELATION]]) takes other things"
            )
        return Correlated(distributions, matrix)  # type: ignore[arg-type]
    if kind == "normal" and len(arguments) == 2 and isinstance(arguments[0], list):
        return Correlated.normal(arguments[0], arguments[1])
    if kind not in KINDS:
        raise ValueError(f"unknown kind {kind!r:.50}; {choices(kind, (*KINDS, 'correlated'))}")
    make, count = KINDS[kind]
    if count not in (None, len(arguments)):
        raise ValueError(f"{kind} takes {count} numbers, not {len(arguments)}")
    if not all(isinstance(each, float) for each in arguments):
        raise ValueError(f"{kind} takes numbers")
    return make(*arguments)
