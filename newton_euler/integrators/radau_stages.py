"""Stages, error estimate and interpolation of a step of Radau IIA of order 5, and its working memory.

Source: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, second edition, Springer 1996,
section IV.8. `newton_euler.integrators.radau` makes steps and runs of these parts, and explains a state, its
rates, and a state with time and parameters.

Functions marked `native` are compiled to machine code by `newton_euler.codegen`; they also run as plain
Python.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np

from newton_euler.codegen.native import Callback, Record, Vector, native
from newton_euler.integrators.lu import factor_complex, factor_real, solve_complex, solve_real
from newton_euler.integrators.singular import evaluate
from newton_euler.integrators.status import Status
from newton_euler.integrators.stepper import (
    EPS,
    HUGE,
    Equations,
)
from newton_euler.scalars import Array

SQRT_6 = sqrt(6.0)

NODES = ((4.0 - SQRT_6) / 10.0, (4.0 + SQRT_6) / 10.0, 1.0)
"""Nodes c: the time of each stage as a fraction of the step (section IV.5)."""

ERROR_WEIGHTS = ((-13.0 - 7.0 * SQRT_6) / 3.0, (-13.0 + 7.0 * SQRT_6) / 3.0, -1.0 / 3.0)
"""Weights e_i of the stages z_i in the error estimate of order 3 (section IV.8)."""


def _collocation() -> tuple[Array, Array]:
    """Compute the coefficient matrix A of the collocation method, and the matrix of its dense output.

    Both matrices are (3, 3). The second one turns values of a polynomial p with p(0) = 0 at `NODES` into the
    coefficients of theta, theta^2 and theta^3.
    """
    # values and derivatives of theta, theta^2 and theta^3 at the nodes
    powers = np.array([[c ** (k + 1) for k in range(3)] for c in NODES])
    derivatives = np.array([[(k + 1) * c**k for k in range(3)] for c in NODES])
    # A turns derivatives at the nodes into values there
    coefficients = np.linalg.inv(powers)
    return np.linalg.inv(derivatives @ coefficients), coefficients


def _transformation() -> tuple[float, complex, Array]:
    """Compute the real eigenvalue of A^-1, one of the complex pair, and the transformation T (3, 3).

    The columns of T are v, Re w and Im w, with the real eigenvector v and the complex eigenvector w.
    """
    values, vectors = np.linalg.eig(np.linalg.inv(_collocation()[0]))
    real = int(np.argmin(np.abs(values.imag)))
    pair = int(np.argmax(values.imag))
    w = vectors[:, pair]
    t = np.column_stack([vectors[:, real].real, w.real, w.imag])
    return float(values[real].real), complex(values[pair]), t


_REAL, _COMPLEX, _T = _transformation()
GAMMA, ALPHA, BETA = _REAL, _COMPLEX.real, _COMPLEX.imag
"""Eigenvalues gamma and alpha +- i beta of A^-1 (section IV.8)."""

TO_STAGES = tuple(float(x) for x in _T.ravel())
FROM_STAGES = tuple(float(x) for x in np.linalg.inv(_T).ravel())
"""The transformation T and its inverse, row by row: stages Z = T W, with the transformed stages W."""

DENSE = tuple(float(x) for x in _collocation()[1].ravel())
"""Matrix of the dense output, row by row. Applied to the stages, it gives the coefficients of theta, theta^2
and theta^3, where theta is the time as a fraction of the step."""

_THETAS = np.linspace(0.0, 1.0, 1001)  # times within a step, as fractions
INTERPOLATION_ERROR = float(np.max(np.abs(_THETAS * np.prod([_THETAS - c for c in NODES], axis=0))))
"""Largest error of the collocation polynomial within a step of size h, in units of h^4 / 24 times the fourth
derivative of the state.

It is the maximum of |theta (theta - c_1) (theta - c_2) (theta - c_3)|: the polynomial is exact at the start
and at the nodes."""

MAX_NEWTON_STEPS = 6
"""Largest number of Newton steps for the stages of a step."""

ROUND_OFF_CORRECTION = 1e-2
"""Norm of a Newton correction, in units of the tolerance, below which it may be round-off. Such a correction
need not converge any further: stiff forces magnify round-off, and shorter steps do not reduce it."""

MIN_STEP_FACTOR, MAX_STEP_FACTOR = 0.2, 10.0
"""Smallest and largest ratio of a step size to the one before it."""


@dataclass(frozen=True, eq=False)
class Radau(Record):
    """Options of Radau and its working memory for one run.

    Attributes:
        rtol, atol: relative and absolute tolerance of the error of a step, for each component.
        max_steps: largest number of steps of a run.
        jacobian: function that writes the Jacobian (n, n) of the rates by the state, row by row.
        now: state with time and parameters at the start of the step.
        at: state with time and parameters at a stage of the step.
        projected: state with time and parameters at the end of the step, after projection onto the
            constraints.
        before: (n,) state at the start of the step before.
        slope: (n + 1,) rates at `now`, then the pivot ratio.
        z: (3, n) stages, as differences from the state at the start of the step.
        w: (3, n) transformed stages W = T^-1 Z.
        f: (3, n + 1) rates and pivot ratio of each stage.
        change: (3 n + 1,) Newton correction of w, then the rate of convergence.
        terms: (3, n) coefficients of the collocation polynomial.
        matrix: (n, n) Jacobian J, row by row.
        real: (n, n) LU factors of gamma/h I - J, column by column.
        re, im: (n, n) real and imaginary parts of the LU factors of (alpha + i beta)/h I - J, column by
            column.
        pivots: (2, n) row exchanges of both factorizations.
    """

    rtol: float
    atol: float
    max_steps: int
    jacobian: Callback
    now: Vector
    at: Vector
    projected: Vector
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
def factor_matrices(n: int, m: int, h: float, method: Radau) -> int:
    """Factor the matrices of the real and the complex linear system; return 1 if one is singular, else 0.

    Args:
        n: length of the state.
        m: size of the leading block of zeros of the Jacobian.
        h: size of the step, s.
    """
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
    """Return the root mean square of x (n,) in units of the tolerance at the state `now`."""
    total = 0.0
    if n == 0:
        return total
    for i in range(n):
        relative = x[i] / (atol + rtol * abs(now[i]))
        total += relative * relative
    return sqrt(total / n)


@native
def solve_stages(system: Equations, method: Radau, m: int, h: float) -> int:
    """Solve for the stages z by simplified Newton iterations; return their count, or -1 for failure.

    Titles in quotation marks in comments are those of subsections of IV.8 of the book.

    Args:
        method: record with factored matrices and a first guess of the stages z, which are overwritten.
        m: size of the leading block of zeros of the Jacobian.
        h: size of the step, s.
    """
    n = system.n
    now = method.now
    at = method.at
    z = method.z
    w = method.w
    f = method.f
    change = method.change
    # largest error of the stages that ends the iteration, in units of the tolerance of a step, as in the
    # authors' code and in SciPy
    tolerance = max(10.0 * EPS / method.rtol, min(0.03, sqrt(method.rtol)))
    # transform the stages: W = T^-1 Z ("The linear system")
    for s in range(3):
        for i in range(n):
            w[n * s + i] = (
                FROM_STAGES[3 * s] * z[i]
                + FROM_STAGES[3 * s + 1] * z[n + i]
                + FROM_STAGES[3 * s + 2] * z[2 * n + i]
            )
    previous_size = -1.0
    rate = -1.0
    for k in range(MAX_NEWTON_STEPS):
        # evaluate the rates of the stages
        for s in range(3):
            for i in range(n):
                at[i] = now[i] + z[n * s + i]
            at[n] = now[n] + NODES[s] * h
            if evaluate(system, at, f[(n + 1) * s :]) != Status.DONE:
                return -1
        # right-hand sides of the real and the complex system, and their solutions
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
        # norm of the correction, rate of convergence, and failure if the remaining iterations cannot reach
        # the tolerance ("Stopping criterion")
        size = 0.0
        for s in range(3):
            part = scaled_norm(n, change[n * s :], now, method.rtol, method.atol)
            size += part * part
        size = sqrt(size / 3.0)
        if not size < HUGE:
            return -1
        if previous_size >= 0.0:
            rate = size / previous_size
            steps_left = MAX_NEWTON_STEPS - 1 - k
            if size >= ROUND_OFF_CORRECTION and (
                rate >= 1.0 or rate**steps_left / (1.0 - rate) * size > tolerance
            ):
                return -1
        # correct W, and transform back: Z = T W
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
        # success: the estimated error is below the tolerance, or the correction is round-off
        if size == 0.0 or (rate >= 0.0 and rate < 1.0 and rate / (1.0 - rate) * size < tolerance):
            return k + 1
        if rate >= 1.0:
            return k + 1
        previous_size = size
    return MAX_NEWTON_STEPS if previous_size < ROUND_OFF_CORRECTION else -1


@native
def interpolate_radau(count: int, n: int, theta: float, now: Vector, terms: Vector, y: Vector) -> None:
    """Evaluate the collocation polynomial, within a step or beyond its end as a prediction.

    Args:
        count: number of elements to evaluate, the first ones of the state.
        n: length of the state.
        theta: time as a fraction of the step; more than 1 beyond its end.
        now: (n,) state at the start of the step.
        terms: (3, n) coefficients of the polynomial.
        y: (count,) result, written.
    """
    for i in range(count):
        y[i] = now[i] + theta * (terms[i] + theta * (terms[n + i] + theta * terms[2 * n + i]))


@native
def prepare_dense(n: int, z: Vector, terms: Vector) -> None:
    """Compute the coefficients `terms` (3, n) of the collocation polynomial from the stages z (3, n)."""
    for k in range(3):
        for i in range(n):
            terms[n * k + i] = (
                DENSE[3 * k] * z[i] + DENSE[3 * k + 1] * z[n + i] + DENSE[3 * k + 2] * z[2 * n + i]
            )


@native
def error_of_step(n: int, m: int, h: float, method: Radau, slope: Vector) -> float:
    """Estimate the error of a step by a formula of order 3, in units of the tolerance (section IV.8).

    The first n elements of `method.change` receive the error of each element of the state. The first n
    elements of `method.at` receive the magnitudes of the state that the relative tolerance refers to.

    Args:
        n: length of the state.
        m: size of the leading block of zeros of the Jacobian.
        h: size of the step, s.
        slope: (n,) rates at the start of the step.
    """
    z = method.z
    at = method.at
    change = method.change
    for i in range(n):
        change[i] = (
            slope[i]
            + (ERROR_WEIGHTS[0] * z[i] + ERROR_WEIGHTS[1] * z[n + i] + ERROR_WEIGHTS[2] * z[2 * n + i]) / h
        )
    solve_real(n, m, method.real, method.pivots, change)
    for i in range(n):
        at[i] = max(abs(method.now[i]), abs(method.now[i] + z[2 * n + i]))
    return scaled_norm(n, change, at, method.rtol, method.atol)


@native
def error_within(n: int, h: float, before_h: float, method: Radau) -> float:
    """Estimate the error of interpolated outputs between the nodes of a step, in units of the tolerance.

    Stiff components are accurate at the nodes even in long steps, so the error estimate of the step does not
    include the error between the nodes. The fourth derivative is estimated from the cubic coefficients of the
    collocation polynomials of this step and of the step before. `method.terms` must still hold the polynomial
    of the step before, and `error_of_step` must have written `method.at`.

    Args:
        n: length of the state.
        h, before_h: sizes of this step and of the step before, s.
    """
    z = method.z
    total = 0.0
    for i in range(n):
        cubic = DENSE[6] * z[i] + DENSE[7] * z[n + i] + DENSE[8] * z[2 * n + i]
        fourth = 12.0 * (cubic / h**3.0 - method.terms[2 * n + i] / before_h**3.0) / (h + before_h)
        relative = INTERPOLATION_ERROR * h**4.0 * fourth / 24.0 / (method.atol + method.rtol * method.at[i])
        total += relative * relative
    return sqrt(total / n)


@native
def first_step(n: int, method: Radau) -> float:
    """Choose the size, s, of a step at the state `now` with the rates `slope` (volume I, section II.4)."""
    d0 = scaled_norm(n, method.now, method.now, method.rtol, method.atol)
    d1 = scaled_norm(n, method.slope, method.now, method.rtol, method.atol)
    return 1e-6 if d0 < 1e-5 or d1 < 1e-5 else 0.01 * d0 / d1
