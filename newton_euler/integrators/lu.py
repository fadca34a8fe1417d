"""LU factors of dense matrices with partial pivoting, real and complex, for Newton's iterations of implicit
steppers.

Matrices are shifted Jacobians, lambda - J. Rates of hinges and slides are velocities alone, so J begins with
a block of zeros, as far as the first Euler parameters, and the matrix with a diagonal block of `m` rows:
eliminated as it stands, it leaves the rest to be pivoted and solved (E. Hairer, G. Wanner, Solving Ordinary
Differential Equations II, second edition, Springer 1996, section IV.8).

Written for native code, see `newton_euler.codegen.native`; it runs as plain Python as well. Matrices are
stored column by column; a complex one as its real and its imaginary parts in two matrices (Golub and Van
Loan, Matrix Computations, fourth edition, 2013, section 3.4).
"""

from __future__ import annotations

from newton_euler.codegen.native import Vector, native


@native
def zero_block(n: int, a: Vector) -> int:
    """Count the rows of the block of zeros with which a (n, n), by rows or by columns, begins."""
    for m in range(n):
        for k in range(m + 1):
            if a[n * m + k] != 0.0 or a[n * k + m] != 0.0:
                return m
    return n


@native
def exchange(x: Vector, i: int, j: int) -> None:
    """Exchange two elements of a vector."""
    kept = x[i]
    x[i] = x[j]
    x[j] = kept


@native
def factor_real(n: int, m: int, a: Vector, pivots: Vector) -> int:
    """Factor a (n, n), which begins with a diagonal block of m rows, in place; 1 if it is singular, else 0.

    Rows from m on are exchanged as `pivots` (n,) says.
    """
    for k in range(n):
        best = k
        if k >= m:
            for i in range(k + 1, n):
                if abs(a[n * k + i]) > abs(a[n * k + best]):
                    best = i
        pivots[k] = float(best)
        if not abs(a[n * k + best]) > 0.0:
            return 1
        if best != k:
            for j in range(n):
                exchange(a, n * j + k, n * j + best)
        inverse = 1.0 / a[n * k + k]
        below = m if k < m else k + 1
        for i in range(below, n):
            a[n * k + i] *= inverse
        for j in range(below, n):
            above = a[n * j + k]
            if above != 0.0:
                for i in range(below, n):
                    a[n * j + i] -= a[n * k + i] * above
    return 0


@native
def solve_real(n: int, m: int, a: Vector, pivots: Vector, x: Vector) -> None:
    """Solve A x = x (n,) in place by the factors of `factor_real`."""
    for k in range(m, n):
        exchange(x, k, int(pivots[k]))
    for k in range(n):
        share = x[k]
        for i in range(m if k < m else k + 1, n):
            x[i] -= a[n * k + i] * share
    for back in range(n):
        k = n - 1 - back
        x[k] = x[k] / a[n * k + k]
        share = x[k]
        for i in range(k if k >= m else 0):
            x[i] -= a[n * k + i] * share


@native
def factor_complex(n: int, m: int, a: Vector, b: Vector, pivots: Vector) -> int:
    """Factor a + ib (n, n) as `factor_real` does; 1 if it is singular, else 0."""
    for k in range(n):
        best = k
        if k >= m:
            size = 0.0
            for i in range(k, n):
                here = abs(a[n * k + i]) + abs(b[n * k + i])
                if here > size:
                    size = here
                    best = i
        pivots[k] = float(best)
        if not abs(a[n * k + best]) + abs(b[n * k + best]) > 0.0:
            return 1
        if best != k:
            for j in range(n):
                exchange(a, n * j + k, n * j + best)
                exchange(b, n * j + k, n * j + best)
        square = a[n * k + k] * a[n * k + k] + b[n * k + k] * b[n * k + k]
        re = a[n * k + k] / square
        im = -b[n * k + k] / square
        below = m if k < m else k + 1
        for i in range(below, n):
            share = a[n * k + i]
            a[n * k + i] = share * re - b[n * k + i] * im
            b[n * k + i] = share * im + b[n * k + i] * re
        for j in range(below, n):
            above_re = a[n * j + k]
            above_im = b[n * j + k]
            if above_re != 0.0 or above_im != 0.0:
                for i in range(below, n):
                    a[n * j + i] -= a[n * k + i] * above_re - b[n * k + i] * above_im
                    b[n * j + i] -= a[n * k + i] * above_im + b[n * k + i] * above_re
    return 0


@native
def solve_complex(n: int, m: int, a: Vector, b: Vector, pivots: Vector, x: Vector, y: Vector) -> None:
    """Solve (A + iB) (x + iy) = x + iy (n,) in place by the factors of `factor_complex`."""
    for k in range(m, n):
        exchange(x, k, int(pivots[k]))
        exchange(y, k, int(pivots[k]))
    for k in range(n):
        re = x[k]
        im = y[k]
        for i in range(m if k < m else k + 1, n):
            x[i] -= a[n * k + i] * re - b[n * k + i] * im
            y[i] -= a[n * k + i] * im + b[n * k + i] * re
    for back in range(n):
        k = n - 1 - back
        square = a[n * k + k] * a[n * k + k] + b[n * k + k] * b[n * k + k]
        re = (x[k] * a[n * k + k] + y[k] * b[n * k + k]) / square
        im = (y[k] * a[n * k + k] - x[k] * b[n * k + k]) / square
        x[k] = re
        y[k] = im
        for i in range(k if k >= m else 0):
            x[i] -= a[n * k + i] * re - b[n * k + i] * im
            y[i] -= a[n * k + i] * im + b[n * k + i] * re
