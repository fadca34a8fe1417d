"""Probability distributions of varied parameters, and their text form on the command line.

A sweep draws the parameters of each of its runs from such distributions. An example is `normal(14, 0.5)`, a
normal distribution with mean 14 and standard deviation 0.5. `Distribution` is that of one parameter,
`Correlated` the joint distribution of several parameters.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

from crosscheck.support.errors import CrosscheckError
from newton_euler.errors import choices, is_finite_number, plain_number, quoted, real_array
from newton_euler.scalars import Array

MAX_TEXT_LENGTH = 10_000
"""Largest number of characters in the text of a distribution."""

MAX_GRID_COUNT = 10_000
"""Largest number of values of a grid."""

CORRELATION_ROUND_OFF = 1e-12
"""Round-off in correlation matrices: eigenvalues, pivots and asymmetries up to it count as zero."""

KINDS = {
    "values": ("A", "B", "..."),
    "grid": ("LOW", "HIGH", "COUNT"),
    "uniform": ("LOW", "HIGH"),
    "normal": ("MEAN", "DEVIATION"),
    "truncated_normal": ("MEAN", "DEVIATION", "LOW", "HIGH"),
}
"""Kinds of distributions, with the names of their numbers in order.

`values` are equally likely values, as many as are given. `grid` has evenly spaced, equally likely values. A
`truncated_normal` distribution is limited to an interval.
"""

FORMS = "; ".join(f"{name}({', '.join(numbers)})" for name, numbers in KINDS.items())
FORMS += (
    "; NAME,NAME=normal([MEANS], [[COVARIANCE]]); NAME,NAME=correlated(DISTRIBUTION, ..., [[CORRELATION]])"
)
"""Text forms of all distributions, for error messages."""


@dataclass(frozen=True)
class Distribution:
    """Distribution of one parameter.

    Attributes:
        kind: one of `KINDS`.
        numbers: numbers that define the distribution, in the order of `KINDS`.

    Raises:
        CrosscheckError: for invalid numbers.
    """

    kind: str
    numbers: tuple[float, ...]

    def __post_init__(self) -> None:
        # check that there is a finite number for each name of the kind, and that deviations are positive
        names = KINDS[self.kind]
        if self.kind == "values":
            names = tuple(f"number {k + 1}" for k in range(len(self.numbers)))
        if len(self.numbers) != len(names):
            needed = f"{len(names)} numbers, {', '.join(names)}"
            raise CrosscheckError(f"{self.kind} takes {needed}, not {len(self.numbers)}")
        given = dict(zip(names, self.numbers, strict=True))
        for name, value in given.items():
            positive = name == "DEVIATION"
            if not is_finite_number(value) or (positive and value <= 0.0):
                needed = f"a {'positive' if positive else 'finite'} number"
                raise CrosscheckError(f"{self.kind}: {name} is {quoted(value)}; needed: {needed}")
        object.__setattr__(self, "numbers", tuple(map(float, self.numbers)))
        # The count of a grid, and the interval. Distributions without these numbers get valid ones
        count = given.get("COUNT", 2.0)
        if not (count % 1.0 == 0.0 and 2 <= count <= MAX_GRID_COUNT):
            raise CrosscheckError(f"grid: COUNT is {count:g}; needed: a whole number, 2 to {MAX_GRID_COUNT}")
        low, high = given.get("LOW", 0.0), given.get("HIGH", 1.0)
        if not self.numbers or not low < high:
            needed = "LOW < HIGH" if self.numbers else "one number or more"
            raise CrosscheckError(f"{self} is an empty distribution; needed: {needed}")
        if not high - low < np.inf:
            raise CrosscheckError(f"{self} is not a distribution: HIGH - LOW is too large")
        # SciPy's statistics take a second to import: use them only for the kind that needs this check
        if self.kind == "truncated_normal" and not np.isfinite(self.quantile(np.array([0.5]))[0]):
            raise CrosscheckError(f"{self} is an empty distribution: the probability between its bounds is 0")

    @property
    def levels(self) -> tuple[float, ...]:
        """Equally likely values of a discrete distribution; empty for a continuous one."""
        if self.kind == "grid":
            low, high, count = self.numbers
            return tuple(np.linspace(low, high, int(count)).tolist())
        return self.numbers if self.kind == "values" else ()

    def quantile(self, u: Array) -> Array:
        """Return the quantiles (n,) of probabilities u (n,) between 0 and 1."""
        if levels := self.levels:
            return np.array(levels)[np.minimum((u * len(levels)).astype(int), len(levels) - 1)]
        values = _continuous(self).ppf(u)
        low, high = self.numbers[2:] if self.kind == "truncated_normal" else (-np.inf, np.inf)
        return np.clip(values, low, high)

    def deviations_of(self, value: float) -> float:
        """Return the distance of a number from the mean, in standard deviations; 0 for a single value."""
        distribution = np.array(self.levels) if self.levels else _continuous(self)
        deviation = float(distribution.std())
        return abs(value - float(distribution.mean())) / deviation if deviation else 0.0

    def of_normal(self, z: Array) -> Array:
        """Transform standard normal values z (n,) to values (n,) of this distribution with the same
        probabilities."""
        if self.kind == "normal":
            return self.numbers[0] + self.numbers[1] * z
        return self.quantile(ndtr(z))

    def __str__(self) -> str:
        return f"{self.kind}({_texts(self.numbers)})"


@lru_cache(maxsize=1000)
def _continuous(distribution: Distribution) -> Any:
    """Return SciPy's object of a continuous distribution.

    It is cached here rather than in the `Distribution`, which is pickled for other processes.
    """
    from scipy import stats

    if distribution.kind == "uniform":
        low, high = distribution.numbers
        return stats.uniform(low, high - low)
    mean, deviation, *bounds = distribution.numbers
    if distribution.kind == "normal":
        return stats.norm(mean, deviation)
    low, high = ((bound - mean) / deviation for bound in bounds)
    return stats.truncnorm(low, high, mean, deviation)


def _texts(numbers: Iterable[float]) -> str:
    """Format numbers with the fewest digits that are read back exactly."""
    return ", ".join(repr(float(number)).removesuffix(".0") for number in numbers)


@dataclass(frozen=True, eq=False)
class Correlated:
    """Joint distribution of n correlated parameters, a Gaussian copula.

    The copula draws correlated standard normal values, and transforms each value to the distribution of its
    parameter.

    Attributes:
        distributions: distribution of each of the n parameters.
        correlation: (n, n) correlation matrix of the standard normal values. For normal distributions it is
            the correlation matrix of the parameters.

    Raises:
        CrosscheckError: for a matrix that is not a correlation matrix.
    """

    distributions: tuple[Distribution, ...]
    correlation: Array

    def __init__(self, distributions: Sequence[Distribution], correlation: object) -> None:
        matrix = _matrix("correlated: correlation", correlation, len(distributions))
        if not np.array_equal(np.diag(matrix), np.ones(len(matrix))):
            raise CrosscheckError("correlated: the diagonal of correlation is not all 1")
        object.__setattr__(self, "distributions", tuple(distributions))
        object.__setattr__(self, "correlation", matrix)

    @classmethod
    def normal(cls, means: Sequence[float], covariance: object) -> Correlated:
        """Return the multivariate normal distribution with means (n,) and covariance (n, n)."""
        matrix = _matrix("normal: covariance", covariance, len(means))
        deviations = np.sqrt(np.diag(matrix))
        normals = [Distribution("normal", pair) for pair in zip(means, deviations.tolist(), strict=True)]
        correlation = matrix / np.outer(deviations, deviations)
        np.fill_diagonal(correlation, 1.0)
        return cls(normals, correlation)

    def quantile(self, u: Array) -> Array:
        """Return the values (k, n) for independent probabilities u (k, n) between 0 and 1."""
        factor, z = _cholesky(self.correlation), ndtri(u)
        # L z by explicit sums: the order of summation of a matrix product depends on the number of runs
        correlated = [sum(factor[i, j] * z[:, j] for j in range(i + 1)) for i in range(len(factor))]
        columns = [each.of_normal(z) for each, z in zip(self.distributions, correlated, strict=True)]
        return np.stack(columns, axis=1)

    def __str__(self) -> str:
        rows = ", ".join(f"[{_texts(row)}]" for row in self.correlation)
        return f"correlated({', '.join(map(str, self.distributions))}, [{rows}])"


def _matrix(what: str, given: object, count: int) -> Array:
    """Convert input to a covariance or correlation matrix (count, count).

    Args:
        what: name of the matrix in error messages.
        given: rows of numbers.
        count: number of rows.

    Raises:
        CrosscheckError: unless the matrix is symmetric and positive semidefinite with a positive diagonal.
    """
    try:
        matrix = real_array(given)
    except (TypeError, ValueError, OverflowError):
        matrix = np.full(1, np.nan)
    if matrix.shape != (count, count) or not np.all(np.isfinite(matrix)):
        raise CrosscheckError(f"{what} is no matrix of {count} rows of {count} finite numbers")
    if not np.all(np.diag(matrix) > 0.0):
        raise CrosscheckError(f"{what} has a diagonal that is not positive")
    scale = np.sqrt(np.outer(np.diag(matrix), np.diag(matrix)))
    if np.any(np.abs(matrix - matrix.T) > CORRELATION_ROUND_OFF * scale):
        raise CrosscheckError(f"{what} is not symmetric")
    matrix = 0.5 * (matrix + matrix.T)
    if np.linalg.eigvalsh(matrix / scale)[0] < -CORRELATION_ROUND_OFF:
        raise CrosscheckError(f"{what} has a negative eigenvalue; needed: a positive semidefinite matrix")
    return matrix


def _cholesky(matrix: Array) -> Array:
    """Return the Cholesky factor L (n, n), lower triangular, of a correlation matrix C = L L^T.

    The matrix may be singular: a column of L with a pivot of zero stays zero. LAPACK is not used, since the
    last digits of its results, and thus those of every run, depend on the processor.
    """
    count = len(matrix)
    factor = np.zeros((count, count))
    for j in range(count):
        pivot = matrix[j, j] - sum(factor[j, k] ** 2 for k in range(j))
        if pivot <= CORRELATION_ROUND_OFF:
            continue
        factor[j, j] = np.sqrt(pivot)
        for i in range(j + 1, count):
            factor[i, j] = (matrix[i, j] - sum(factor[i, k] * factor[j, k] for k in range(j))) / factor[j, j]
    return factor


Vary = Mapping[str | tuple[str, ...], Distribution | Correlated | str | Iterable[float]]
"""Distributions by name of the varied parameter, or by names of several correlated parameters.

A distribution may be given as an object, as text, or as a list of equally likely numbers."""


def parse_vary(given: Iterable[str]) -> dict[str | tuple[str, ...], Distribution | Correlated]:
    """Parse texts such as `panel_7.mass=normal(14, 0.5)`, or `A,B=correlated(...)` of several parameters.

    Returns:
        Distributions by name of the parameter, or by names of several correlated parameters.

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
        try:
            found[key] = parse(distribution.strip())
        except CrosscheckError as error:
            raise CrosscheckError(f"--vary {text!r:.200}: {error}") from None
    return found


def parse(text: str) -> Distribution | Correlated:
    """Parse the text of a distribution: one of `KINDS`, or a joint distribution of several parameters.

    Joint distributions are `normal([MEANS], [[COVARIANCE]])` and
    `correlated(DISTRIBUTION, ..., [[CORRELATION]])`.

    Raises:
        CrosscheckError: for text that is not a distribution, with the reason.
    """
    found: object = None
    try:
        if len(text) > MAX_TEXT_LENGTH:
            raise ValueError(f"is longer than {MAX_TEXT_LENGTH} characters")
        found = _read(ast.parse(text, mode="eval").body, text)
    except SyntaxError as error:
        raise CrosscheckError(wrong_syntax(error, text)) from None
    except (ValueError, RecursionError, MemoryError) as error:
        raise CrosscheckError(f"it is no distribution: {error}"[:400]) from None
    if isinstance(found, float):
        raise CrosscheckError(f"a number is no distribution; one value for all runs is values({text})")
    if not isinstance(found, Distribution | Correlated):
        raise CrosscheckError(f"it is no distribution; choose from: {FORMS}")
    return found


def wrong_syntax(error: SyntaxError, text: str) -> str:
    """Describe the syntax error of a text, for example an unclosed bracket."""
    if ";" in text:
        return "there is a semicolon, where commas are needed"
    return f"{error.msg} at character {min(error.offset or 1, len(text))} of {text[:100]!r}"


def _read(node: ast.expr, text: str) -> object:
    """Evaluate a syntax tree of numbers, lists and distributions; raises `ValueError` for other syntax.

    Args:
        node: the syntax tree.
        text: text from which the tree was parsed.
    """
    if isinstance(node, ast.List):
        return [_read(each, text) for each in node.elts]
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
        return _make_distribution(node.func.id, [_read(each, text) for each in node.args])
    source = ast.get_source_segment(text, node) or ""
    return plain_number(source.replace(" ", ""))


def _make_distribution(kind: str, arguments: list[object]) -> Distribution | Correlated:
    """Make a distribution; raises `ValueError` or `CrosscheckError` for invalid arguments.

    Args:
        kind: one of `KINDS`, or "correlated".
        arguments: evaluated arguments in the text: numbers, lists and distributions.
    """
    if kind == "correlated":
        distributions = [each for each in arguments[:-1] if isinstance(each, Distribution)]
        if not distributions or len(distributions) < len(arguments) - 1:
            raise ValueError("correlated takes DISTRIBUTION, DISTRIBUTION, ..., [[CORRELATION]]")
        return Correlated(distributions, arguments[-1])
    if kind == "normal" and len(arguments) == 2 and isinstance(arguments[0], list):
        return Correlated.normal(arguments[0], arguments[1])
    if kind not in KINDS:
        raise ValueError(f"unknown kind {kind!r:.50}; {choices(kind, (*KINDS, 'correlated'))}")
    return Distribution(kind, tuple(arguments))  # type: ignore[arg-type]
