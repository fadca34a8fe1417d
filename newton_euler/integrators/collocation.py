"""The collocation method Radau IIA of order 5: nodes, eigenvalues, stages by Newton's iteration, polynomial.

E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, second edition, Springer 1996, section
IV.8. The three stages are one linear system of 3 n unknowns in Newton's iteration; the eigenvectors of
A^-1 make it one real system and one complex one of n unknowns each. Written for native code, see
`newton_euler.codegen.native`; it runs as plain Python as well.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np

from newton_euler.codegen.native import Callback, Record, Vector, native
from newton_euler.integrators.linear import factor_complex, factor_real, solve_complex, solve_real
from newton_euler.integrators.march import DONE, HUGE, SPACING, Equations, evaluate
from newton_euler.scalars import Array

SIXTH = sqrt(6.0)
NODES = ((4.0 - SIXTH) / 10.0, (4.0 + SIXTH) / 10.0, 1.0)
"""c: where in the step the stages are (section IV.5)."""

ERROR = ((-13.0 - 7.0 * SIXTH) / 3.0, (-13.0 + 7.0 * SIXTH) / 3.0, -1.0 / 3.0)
"""Weights of the stages in the error estimate of order 3 (section IV.8)."""


def _collocation() -> tuple[Array, Array]:
    """A of the collocation method at NODES, and the powers' coefficients from values at NODES."""
    powers = np.array([[c ** (k + 1) for k in range(3)] for c in NODES])  # of polynomials with p(0) = 0
    rates = np.array([[(k + 1) * c**k for k in range(3)] for c in NODES])
    coefficients = np.linalg.inv(powers)
    return np.linalg.inv(rates @ coefficients), coefficients


def _transformation() -> tuple[float, complex, Array]:
    """The real and one complex eigenvalue of A^-1, and T = [v, Re w, Im w] of their eigenvectors."""
    values, vectors = np.linalg.eig(np.linalg.inv(_collocation()[0]))
    real = int(np.argmin(np.abs(values.imag)))
    pair = int(np.argmax(values.imag))
    w = vectors[:, pair]
    t = np.column_stack([vectors[:, real].real, w.real, w.imag])
    return float(values[real].real), complex(values[pair]), t


_REAL, _COMPLEX, _T = _transformation()
GAMMA, ALPHA, BETA = _REAL, _COMPLEX.real, _COMPLEX.imag
"""Eigenvalues gamma and alpha +- i beta of A^-1."""

TO_STAGES = tuple(float(x) for x in _T.ravel())
FROM_STAGES = tuple(float(x) for x in np.linalg.inv(_T).ravel())
"""T and its inverse, row by row: stages Z = T W."""

DENSE = tuple(float(x) for x in _collocation()[1].ravel())
"""Coefficients of theta, theta^2, theta^3 from the stages, row by row."""

_SHARES = np.linspace(0.0, 1.0, 1001)
WITHIN = float(np.max(np.abs(_SHARES * np.prod([_SHARES - c for c in NODES], axis=0))))
"""Largest error of the collocation polynomial within a step, in units of h^4 y''''/24."""

NEWTON_STEPS = 6

SETTLED = 1e-2
"""Share of the tolerance below which a correction that does not shrink any more is round-off, which stiff
forces magnify: shorter steps would not have less of it."""


@dataclass(frozen=True, eq=False)
class Radau(Record):
    """The method and its state.

    Attributes:
        rtol, atol, most: tolerances and the largest number of steps.
        jacobian: derivative (n, n) of the rates by a state.
        now, at: states with time and parameters: where a step begins, of a stage.
        before: (n,) where the step before began.
        slope: (n + 2) derivative at `now`, and its health.
        z, w: (3, n) stages, and their transforms.
        f: (3, n + 1) derivatives of the stages.
        change: (3 n + 2) of the transforms; change[3 n] is the rate of convergence.
        terms: (3, n) of the collocation polynomial.
        matrix: (n, n) Jacobian.
        real, re, im: (n, n) factors of gamma/h - J and (alpha + i beta)/h - J.
        pivots: (2, n).
    """

    rtol: float
    atol: float
    most: int
    jacobian: Callback
    now: Vector
    at: Vector
    before: Vector
    slope: Vector
    z: Vector
    w: Vector
    f: Vector
    change: Vector
    terms: Vector
    matrix: Vector
    real: Vector
    re: Vector
    im: Vector
    pivots: Vector


@native
def prepare(n: int, m: int, h: float, method: Radau) -> int:
    """Factor the matrices of a step of size h; 1 if one is singular, else 0. J begins with m zero rows."""
    real = method.real
    re = method.re
    im = method.im
    for i in range(n):
        for j in range(n):
            real[n * j + i] = -method.matrix[n * i + j]
            re[n * j + i] = -method.matrix[n * i + j]
            im[n * j + i] = 0.0
    for i in range(n):
        real[(n + 1) * i] += GAMMA / h
        re[(n + 1) * i] += ALPHA / h
        im[(n + 1) * i] += BETA / h
    if factor_real(n, m, real, method.pivots) == 1:
        return 1
    return factor_complex(n, m, re, im, method.pivots[n:])


@native
def scaled_norm(n: int, x: Vector, now: Vector, rtol: float, atol: float) -> float:
    """Root mean square of x in units of the tolerance."""
    total = 0.0
    if n == 0:
        return total
    for i in range(n):
        share = x[i] / (atol + rtol * abs(now[i]))
        total += share * share
    return sqrt(total / n)


@native
def iterate(system: Equations, method: Radau, m: int, h: float) -> int:
    """Newton's iteration for the stages z; the number of steps it took, negative if it failed."""
    n = system.n
    now = method.now
    at = method.at
    z = method.z
    w = method.w
    f = method.f
    change = method.change
    tolerance = max(10.0 * SPACING / method.rtol, min(0.03, sqrt(method.rtol)))
    for s in range(3):
        for i in range(n):
            w[n * s + i] = (
                FROM_STAGES[3 * s] * z[i]
                + FROM_STAGES[3 * s + 1] * z[n + i]
                + FROM_STAGES[3 * s + 2] * z[2 * n + i]
            )
    before = -1.0
    rate = -1.0
    for k in range(NEWTON_STEPS):
        for s in range(3):
            for i in range(n):
                at[i] = now[i] + z[n * s + i]
            at[n] = now[n] + NODES[s] * h
            if evaluate(system, at, f[(n + 1) * s :]) != DONE:
                return -1
        for i in range(n):
            f0 = f[i]
            f1 = f[n + 1 + i]
            f2 = f[2 * (n + 1) + i]
            w1 = w[n + i]
            w2 = w[2 * n + i]
            change[i] = FROM_STAGES[0] * f0 + FROM_STAGES[1] * f1 + FROM_STAGES[2] * f2 - GAMMA / h * w[i]
            # the pair's block of A^-1 is ((alpha, beta), (-beta, alpha)), so u = w1 - i w2 is one system
            change[n + i] = (
                FROM_STAGES[3] * f0 + FROM_STAGES[4] * f1 + FROM_STAGES[5] * f2 - (ALPHA * w1 + BETA * w2) / h
            )
            change[2 * n + i] = -(
                FROM_STAGES[6] * f0 + FROM_STAGES[7] * f1 + FROM_STAGES[8] * f2 - (ALPHA * w2 - BETA * w1) / h
            )
        solve_real(n, m, method.real, method.pivots, change)
        solve_complex(n, m, method.re, method.im, method.pivots[n:], change[n:], change[2 * n :])
        size = 0.0
        for s in range(3):
            part = scaled_norm(n, change[n * s :], now, method.rtol, method.atol)
            size += part * part
        size = sqrt(size / 3.0)
        if not size < HUGE:
            return -1
        if before >= 0.0:
            rate = size / before
            left = NEWTON_STEPS - 1 - k
            if size >= SETTLED and (rate >= 1.0 or rate**left / (1.0 - rate) * size > tolerance):
                return -1
        for i in range(n):
            w[i] += change[i]
            w[n + i] += change[n + i]
            w[2 * n + i] -= change[2 * n + i]
        for s in range(3):
            for i in range(n):
                z[n * s + i] = (
                    TO_STAGES[3 * s] * w[i]
                    + TO_STAGES[3 * s + 1] * w[n + i]
                    + TO_STAGES[3 * s + 2] * w[2 * n + i]
                )
        change[3 * n] = max(rate, 0.0)
        if size == 0.0 or (rate >= 0.0 and rate < 1.0 and rate / (1.0 - rate) * size < tolerance):
            return k + 1
        if rate >= 1.0:
            return k + 1
        before = size
    return NEWTON_STEPS if before < SETTLED else -1


@native
def position_in(count: int, n: int, theta: float, now: Vector, terms: Vector, y: Vector) -> None:
    """The first `count` of the n elements of the state at a share of the step, by the collocation polynomial.

    Beyond the step it predicts.
    """
    for i in range(count):
        y[i] = now[i] + theta * (terms[i] + theta * (terms[n + i] + theta * terms[2 * n + i]))


@native
def prepare_dense(n: int, z: Vector, terms: Vector) -> None:
    """Coefficients (3, n) of the collocation polynomial from the stages."""
    for k in range(3):
        for i in range(n):
            terms[n * k + i] = (
                DENSE[3 * k] * z[i] + DENSE[3 * k + 1] * z[n + i] + DENSE[3 * k + 2] * z[2 * n + i]
            )


@native
def error_within(n: int, h: float, before_h: float, method: Radau) -> float:
    """The error of the collocation polynomial between the nodes, in units of the tolerance.

    Stiff components meet the nodes however long the step is, and the error estimate of the step says
    nothing of the rest. The fourth derivative is taken from the cubic terms of this polynomial and of
    the one before, whose coefficients `terms` (3, n) are; `at` is what the tolerance is relative to.
    """
    z = method.z
    total = 0.0
    for i in range(n):
        cubic = DENSE[6] * z[i] + DENSE[7] * z[n + i] + DENSE[8] * z[2 * n + i]
        fourth = 12.0 * (cubic / h**3.0 - method.terms[2 * n + i] / before_h**3.0) / (h + before_h)
        share = WITHIN * h**4.0 * fourth / 24.0 / (method.atol + method.rtol * method.at[i])
        total += share * share
    return sqrt(total / n)
