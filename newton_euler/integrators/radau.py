"""Radau IIA of order 5: implicit Runge-Kutta integrator for stiff equations of motion.

Source: E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, second edition, Springer 1996,
section IV.8. A step has three stages. Newton's iteration solves for all stages together, a linear system of 3
n unknowns. A transformation by the eigenvectors of A^-1, the inverse of the method's coefficient matrix,
splits it into one real and one complex system of n unknowns. The Jacobian of the rates by the state is exact,
from automatic differentiation, unless Python evaluates the equations; then finite differences are accurate
enough. `integrate_radau` makes all runs of a `Table`.

A state consists of the coordinates q and the velocities v; its rates are the time derivatives. A *state with
time and parameters* is one vector of length `system.inputs`: the state, the time, flags of constraint rows (1
for a redundant row that is left out) and of branches of forces, and parameters of the scene. During a run,
rows that are left out may be exchanged for rows in use (`newton_euler.integrators.row_exchange`), and forces
may change to another branch (`newton_euler.integrators.switches`). Each evaluation of the rates also
gives the *pivot ratio*: the distance to a singular configuration, where constraints become dependent; 1 far
away, 0 in it.

Functions marked `native` are compiled to machine code by `newton_euler.codegen`; they also run as plain
Python.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np

from newton_euler.codegen.native import Callback, Record, Vector, native
from newton_euler.integrators.lu import factor_complex, factor_real, solve_complex, solve_real, zero_block
from newton_euler.integrators.projection import (
    begin_adaptive,
    change_by_projection,
    is_error_of_step,
    project_end,
    project_rows,
)
from newton_euler.integrators.row_exchange import exchange_rows
from newton_euler.integrators.singular import UNSAFE_PIVOT_RATIO, UNSAFE_STEP_FACTOR, evaluate
from newton_euler.integrators.status import Status
from newton_euler.integrators.stepper import (
    EPS,
    HUGE,
    SHORT_STEP_FRACTION,
    Count,
    Equations,
    Table,
    before_step,
    copy_flags,
    finish_run,
    normalize_quaternions,
    start_run,
)
from newton_euler.integrators.switches import (
    MAX_ROOT_STEPS,
    NO_SWITCH,
    SAMPLES,
    SHORTEST_STEP_ULPS,
    Search,
    Switches,
    begin_search,
    change_branch,
    excess,
    first_positive_sample,
    locate_maximum,
    may_switch,
    narrow_search,
    next_fraction,
    take_sample,
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

SWITCH_TOLERANCE = 1e-7
"""Part of a step that may lie beyond a switch of a force. The branch of the step is smooth there, too, and
the error of the velocities is proportional to the square of this part."""

MAX_SWITCH_PLACEMENTS = 8
"""Largest number of times that a step is shortened to end at a switch of a force."""

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


@native
def excess_within(system: Equations, method: Radau, h: float, fraction: float) -> float:
    """Return the excess (`newton_euler.integrators.switches`) at a fraction of a step of size h, s."""
    n = system.n
    interpolate_radau(n, n, fraction, method.now, method.terms, method.at)
    method.at[n] = method.now[n] + fraction * h
    return excess(system.switches, method.at, method.now)


@native
def locate_switch(system: Equations, switches: Switches, method: Radau, h: float) -> float:
    """Return the fraction of a step at which a branch of a force is first left, or `NO_SWITCH`.

    Args:
        method: record whose `terms` are those of the step.
        h: size of the step, s.
    """
    if switches.count == 0:
        return NO_SWITCH
    # sample the step: the first fraction known to be beyond a switch, and its excess
    n = system.n
    at = method.at
    low = 0.0
    high = NO_SWITCH
    high_value = 0.0
    for number in range(SAMPLES + 1):
        interpolate_radau(n, n, float(number) / SAMPLES, method.now, method.terms, at)
        at[n] = method.now[n] + float(number) / SAMPLES * h
        take_sample(switches, number, at, method.now)
    high = first_positive_sample(switches)
    if high <= 1.0:
        low = high - 1.0 / SAMPLES
        high_value = excess_within(system, method, h, high)
    for i in range(switches.count):
        for number in range(1, SAMPLES):
            fraction = locate_maximum(switches, i, number)
            if fraction < high:
                value = excess_within(system, method, h, fraction)
                if value > 0.0:
                    high = fraction
                    high_value = value
                    low = 0.0
    if high > 1.0:
        return NO_SWITCH
    begin_search(switches, low, high, high_value)
    located = 0
    tries = 0
    while located == 0 and tries < MAX_ROOT_STEPS:
        fraction = next_fraction(switches)
        located = narrow_search(switches, fraction, excess_within(system, method, h, fraction))
        tries += 1
    return switches.search[Search.HIGH] if may_switch(switches) == 1 else NO_SWITCH


@native
def run_radau(system: Equations, table: Table, states: Vector, method: Radau) -> Status:
    """Integrate one run, and write its states at all output times; return a status.

    The steps follow Hairer, Wanner, section IV.8, with projection onto the constraints after each step.
    Titles in comments are those of subsections of IV.8.

    Args:
        states: (count, n) states of the run at the output times, written.
        method: record whose state `now` is the start of the run.
    """
    n = system.n
    now = method.now
    at = method.at
    slope = method.slope
    z = method.z
    f = method.f
    change = method.change
    terms = method.terms
    times = table.times
    counts = system.counts
    rtol = method.rtol
    atol = method.atol
    projected = method.projected
    unprojected = method.w  # scratch: the transformed stages are not used between two steps
    # start: project the state, evaluate its rates, choose the first step (volume I, section II.4)
    for i in range(system.inputs):
        at[i] = now[i]
        projected[i] = now[i]
    status = begin_adaptive(system, table, states, now, slope)
    if status != Status.DONE:
        return status
    copy_flags(system, now, at)
    copy_flags(system, now, projected)
    stop = times[table.count - 1]
    h = min(first_step(n, method), stop - now[n])
    method.jacobian(now, method.matrix)
    next_row = 1  # index of the next output time
    is_jacobian_current = 1  # 1 if the Jacobian is that of the present state
    is_factored = 0  # 1 if the LU factors are those of the present Jacobian and step size
    before_h = 0.0  # size of the step before, s; 0 if there is none
    before_error = 0.0  # error of the step before, in units of the tolerance
    # changes of states by projection, in units of the tolerance; a change that a shorter try does not reduce
    # is round-off, and is accepted
    change_before = HUGE  # change for which the last try of this step was rejected, if any
    change_noise = 0.0  # change in the step before if it was 1 or more, so round-off; else 0
    rejected = 0  # 1 if the last try of this step was rejected for its error
    m = 0  # size of the leading block of zeros of the Jacobian: rates of q that are elements of v
    placements = 0  # number of times that this step was shortened to end at a switch of a force
    for i in range(3 * n):
        z[i] = 0.0
    while next_row < table.count:
        # clip the last step to the end of the run
        status = before_step(system, table, method.max_steps, h, now)
        if status != Status.DONE:
            return status
        if now[n] + h > stop or stop - now[n] - h < 1e-3 * h:
            h = stop - now[n]
            is_factored = 0
        # factor the matrices of the linear systems, gamma/h - J and (alpha + i beta)/h - J
        if is_factored == 0:
            m = zero_block(n, method.matrix)
            if factor_matrices(n, m, h, method) == 1:
                counts[Count.REJECTED] += 1.0
                h = 0.5 * h
                continue
            is_factored = 1
        # predict the stages by the collocation polynomial of the step before ("Starting values")
        if before_h > 0.0:
            for s in range(3):
                interpolate_radau(n, n, 1.0 + NODES[s] * h / before_h, method.before, terms, at)
                for i in range(n):
                    z[n * s + i] = at[i] - now[i]
        else:
            for i in range(3 * n):
                z[i] = 0.0
        # solve for the stages by simplified Newton iterations
        newton_steps = solve_stages(system, method, m, h)
        pivot_ratio = min(min(f[n], f[2 * n + 1]), f[3 * n + 2])
        # reject a step with unsafe accelerations (measure 3 of `newton_euler.integrators.singular`)
        if newton_steps >= 0 and pivot_ratio < UNSAFE_PIVOT_RATIO and slope[n] >= UNSAFE_PIVOT_RATIO:
            counts[Count.REJECTED] += 1.0
            h = UNSAFE_STEP_FACTOR * h
            is_factored = 0
            continue
        # if Newton's iteration fails, try a new Jacobian, then half the step
        if newton_steps < 0:
            counts[Count.REJECTED] += 1.0
            if is_jacobian_current == 0:
                method.jacobian(now, method.matrix)
                is_jacobian_current = 1
            else:
                h = 0.5 * h
            is_factored = 0
            continue
        # error estimate of order 3; in the first step and after a rejection, a second estimate from a
        # corrected start, because stiff components exaggerate the first one ("Step size selection")
        convergence = change[3 * n]
        error = error_of_step(n, m, h, method, slope)
        if error > 1.0 and (rejected == 1 or counts[Count.STEPS] == 0.0):
            for i in range(n):
                at[i] = now[i] + change[i]
            at[n] = now[n]
            if evaluate(system, at, f) == Status.DONE:
                error = error_of_step(n, m, h, method, f)
        # outputs within the step need the error of the interpolation, too
        if before_h > 0.0 and times[next_row] < now[n] + h and error <= 1.0 and n > 0:
            error = max(error, error_within(n, h, before_h, method))
        # factor for the next step: by the error, and by the predictive controller of Gustafsson
        safety = 0.9 * (2.0 * MAX_NEWTON_STEPS + 1.0) / (2.0 * MAX_NEWTON_STEPS + newton_steps)
        factor = MAX_STEP_FACTOR
        if error > 0.0:
            factor = error**-0.25
            if before_h > 0.0 and before_error > 0.0 and error <= 1.0:
                factor = min(factor, factor * h / before_h * (before_error / error) ** 0.25)
        # reject the step for its error
        if not error <= 1.0:
            counts[Count.REJECTED] += 1.0
            h = h * max(MIN_STEP_FACTOR, safety * factor) if error < HUGE else MIN_STEP_FACTOR * h
            is_factored = 0
            rejected = 1
            continue
        # project the end; its change by projection is the part of the error that violates the constraints.
        # The argument 0 chooses the sparse form of projection, not the dense one for singular configurations
        for i in range(n):
            f[i] = now[i] + z[2 * n + i]
        f[n] = now[n] + h
        status = project_end(system, 0, f, projected, unprojected)
        projection_change = 0.0
        if status == Status.DONE and system.projecting == 1:
            projection_change = change_by_projection(system, unprojected, projected, rtol, atol)
        if status != Status.DONE or is_error_of_step(projection_change, change_before, change_noise) == 1:
            counts[Count.REJECTED] += 1.0
            if status != Status.DONE and h < SHORT_STEP_FRACTION * (stop - times[0]):
                return status
            h = h * (
                max(MIN_STEP_FACTOR, safety * projection_change**-0.25)
                if status == Status.DONE
                else MIN_STEP_FACTOR
            )
            change_before = projection_change if status == Status.DONE else HUGE
            is_factored = 0
            rejected = 1
            continue
        # repeat a step in which a branch of a force is left, so that the step ends there: its end is more
        # accurate than the interpolation within
        prepare_dense(n, z, terms)
        fraction = locate_switch(system, system.switches, method, h)
        if fraction < 1.0 - SWITCH_TOLERANCE and placements < MAX_SWITCH_PLACEMENTS:
            counts[Count.REJECTED] += 1.0
            placements += 1
            is_factored = 0
            before_h = 0.0  # `terms` are no longer those of the step before
            if fraction * h > SHORTEST_STEP_ULPS * EPS * max(abs(now[n]), h):
                h = fraction * h
                continue
            # the switch is at the start of the step
            change_branch(system.switches, now)
            copy_flags(system, now, at)
            copy_flags(system, now, projected)
            status = evaluate(system, now, slope)
            if status != Status.DONE:
                return status
            method.jacobian(now, method.matrix)
            is_jacobian_current = 1
            h = min(first_step(n, method), h)
            continue
        placements = 0
        # accept the step, and interpolate and project (again in the sparse form, 0) the outputs within it
        change_before = HUGE
        change_noise = projection_change if projection_change >= 1.0 else 0.0
        counts[Count.STEPS] += 1.0
        rejected = 0
        factor = min(MAX_STEP_FACTOR, max(MIN_STEP_FACTOR, safety * factor))
        first_row = next_row
        while next_row < table.count and times[next_row] <= now[n] + h:
            state = states[n * next_row :]
            interpolate_radau(table.output_state_size, n, (times[next_row] - now[n]) / h, now, terms, state)
            normalize_quaternions(system, state, state)
            next_row += 1
        status = project_rows(system, table, states, first_row, next_row, 0, at)
        if status != Status.DONE:
            return status
        # move to the end of the step; if an angle is reduced by a revolution, its start is reduced, too,
        # because the prediction of the next step continues the polynomial
        for i in range(n):
            revolution = unprojected[i] - (now[i] + z[2 * n + i])
            method.before[i] = now[i] + revolution
            now[i] = projected[i]
        now[n] = now[n] + h
        # exchange constraint rows, and evaluate the rates
        changed = exchange_rows(system.exchange, now)
        if fraction <= 1.0:
            change_branch(system.switches, now)
            changed = 1
        if status == Status.DONE:
            status = evaluate(system, now, slope)
        if status != Status.DONE:
            return status
        # keep the Jacobian while Newton's iteration converges fast, and keep step size and factors if the
        # next step would be at most 20 % longer ("Step size selection")
        before_h = h
        before_error = max(error, 1e-2)  # the lower limit is that of the authors' code
        is_jacobian_current = 0
        if changed == 1:
            copy_flags(system, now, at)
            copy_flags(system, now, projected)
        if changed == 1 or (newton_steps > 2 and convergence > 1e-3):
            method.jacobian(now, method.matrix)
            is_jacobian_current = 1
            is_factored = 0
        if is_jacobian_current == 1 or factor > 1.2 or factor < 1.0:
            h = h * factor
            is_factored = 0
        # restart behind a switch
        if fraction <= 1.0:
            h = min(first_step(n, method), h)
            before_h = 0.0
            before_error = 0.0
    return Status.DONE


@native
def integrate_radau(system: Equations, table: Table, method: Radau) -> None:
    """Integrate all runs of the table, one after the other."""
    run = int(table.first[0])
    while run < table.runs:
        start_run(system, table, run, method.now)
        status = run_radau(system, table, table.states[system.n * table.count * run :], method)
        run = finish_run(system, table, run, status, method.now)
