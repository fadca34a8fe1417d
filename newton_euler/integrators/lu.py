"""LU factorization of dense real and complex matrices with partial pivoting, for the implicit integrator
Radau.

The matrices are lambda I - J. lambda is a real or complex number, and J is the Jacobian of the rates (time
derivatives) with respect to the state, which consists of coordinates, then velocities. The rate of a hinge's
angle or a slide's displacement is a velocity and depends on no coordinate; the rate of a ball joint's
quaternion depends on the quaternion. So J begins with an (m, m) block of zeros, which ends at the first
quaternion or later; `zero_block` finds m. The matrix begins with the (m, m) block lambda I. Its rows need no
pivoting and no elimination among themselves
(E. Hairer, G. Wanner, Solving Ordinary Differential Equations II, second edition, Springer 1996, section
IV.8).

Matrices are stored column by column: element (i, k) of an (n, n) matrix a is a[n k + i]. A complex matrix is
stored as two matrices, its real and its imaginary parts. Algorithms: G. H. Golub, C. F. Van Loan, Matrix
Computations, fourth edition, 2013, section 3.4.

Functions marked `native` are compiled to machine code by `newton_euler.codegen`; they also run as plain
Python.
"""

from __future__ import annotations

from newton_euler.codegen.native import Vector, native


@native
def zero_block(n: int, a: Vector) -> int:
    """Return the size m of the largest leading (m, m) block of zeros of a matrix a (n, n), the Jacobian J.

    The matrix may be stored by rows or by columns.
    """
    for m in range(n):
        for k in range(m + 1):
            if a[n * m + k] != 0.0 or a[n * k + m] != 0.0:
                return m
    return n


@native
def exchange(x: Vector, i: int, j: int) -> None:
    """Exchange two elements of a vector."""
    first = x[i]
    x[i] = x[j]
    x[j] = first


@native
def factor_real(n: int, m: int, a: Vector, pivots: Vector) -> int:
    """Replace a real matrix by its LU factors; return 1 if a pivot is zero or not a number, else 0.

    Args:
        n: number of rows and columns.
        m: size of the leading block lambda I.
        a: (n, n) matrix, column by column.
        pivots: (n,) written: in step k, row k was exchanged with row pivots[k]; doubles, as in each `Vector`.
    """
    for k in range(n):
        # pivot: the diagonal element in the block lambda I, else the largest element from row k on
        best = k
        if k >= m:
            for i in range(k + 1, n):
                if abs(a[n * k + i]) > abs(a[n * k + best]):
                    best = i
        pivots[k] = float(best)
        if not abs(a[n * k + best]) > 0.0:  # zero or not a number
            return 1
        if best != k:
            for j in range(n):
                exchange(a, n * j + k, n * j + best)
        # eliminate: column of L, then the remaining matrix; rows of the block lambda I need no elimination
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
    """Solve A y = x and write the solution y to x.

    Args:
        n, m: as in `factor_real`.
        a, pivots: factors of A by `factor_real`.
        x: (n,) right-hand side, overwritten.
    """
    # exchange rows, forward substitution with L, back substitution with U
    for k in range(m, n):
        exchange(x, k, int(pivots[k]))
    for k in range(n):
        factor = x[k]
        for i in range(m if k < m else k + 1, n):
            x[i] -= a[n * k + i] * factor
    for back in range(n):
        k = n - 1 - back
        x[k] = x[k] / a[n * k + k]
        factor = x[k]
        for i in range(k if k >= m else 0):
            x[i] -= a[n * k + i] * factor


@native
def factor_complex(n: int, m: int, a: Vector, b: Vector, pivots: Vector) -> int:
    """Replace the complex matrix a + ib by its LU factors; return 1 or 0 as `factor_real`.

    Args:
        n, m, pivots: as in `factor_real`.
        a, b: (n, n) real and imaginary parts, column by column.
    """
    for k in range(n):
        # pivot: as in `factor_real`, with the magnitude |re| + |im|
        best = k
        if k >= m:
            magnitude = 0.0
            for i in range(k, n):
                here = abs(a[n * k + i]) + abs(b[n * k + i])
                if here > magnitude:
                    magnitude = here
                    best = i
        pivots[k] = float(best)
        if not abs(a[n * k + best]) + abs(b[n * k + best]) > 0.0:  # zero or not a number
            return 1
        if best != k:
            for j in range(n):
                exchange(a, n * j + k, n * j + best)
                exchange(b, n * j + k, n * j + best)
        # inverse of the pivot, re + i im; then eliminate as in `factor_real`
        square = a[n * k + k] * a[n * k + k] + b[n * k + k] * b[n * k + k]
        re = a[n * k + k] / square
        im = -b[n * k + k] / square
        below = m if k < m else k + 1
        for i in range(below, n):
            factor = a[n * k + i]
            a[n * k + i] = factor * re - b[n * k + i] * im
            b[n * k + i] = factor * im + b[n * k + i] * re
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
    """Solve a complex linear system with the right-hand side x + iy, and write the solution to x and y.

    Args:
        n, m: as in `factor_real`.
        a, b, pivots: factors of the matrix by `factor_complex`.
        x, y: (n,) real and imaginary parts of the right-hand side, overwritten.
    """
    # exchange rows, forward substitution with L, back substitution with U
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
