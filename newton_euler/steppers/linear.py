"""Dense LU with partial pivoting, real and complex, for Newton's iterations of implicit steppers.

Written for native code, see `newton_euler.native`; it runs as plain Python as well. Matrices are stored
row by row; a complex one as its real and its imaginary parts in two matrices (Golub and Van Loan, Matrix
Computations, fourth edition, 2013, section 3.4).
"""

from __future__ import annotations

from newton_euler.native import Vector, native


@native
def factor_real(n: int, a: Vector, pivots: Vector) -> int:
    """LU of a (n, n) in place, rows exchanged as `pivots` (n,) says; 1 if it is singular, else 0."""
    for k in range(n):
        best = k
        for i in range(k + 1, n):
            if abs(a[n * i + k]) > abs(a[n * best + k]):
                best = i
        pivots[k] = float(best)
        if not abs(a[n * best + k]) > 0.0:
            return 1
        if best != k:
            for j in range(n):
                kept = a[n * k + j]
                a[n * k + j] = a[n * best + j]
                a[n * best + j] = kept
        inverse = 1.0 / a[n * k + k]
        for i in range(k + 1, n):
            if a[n * i + k] != 0.0:
                share = a[n * i + k] * inverse
                a[n * i + k] = share
                for j in range(k + 1, n):
                    a[n * i + j] -= share * a[n * k + j]
    return 0


@native
def solve_real(n: int, a: Vector, pivots: Vector, x: Vector) -> None:
    """x (n,) = A^-1 x by the factors of `factor_real`."""
    for k in range(n):
        place = int(pivots[k])
        kept = x[k]
        x[k] = x[place]
        x[place] = kept
    for i in range(n):
        total = x[i]
        for j in range(i):
            total -= a[n * i + j] * x[j]
        x[i] = total
    for back in range(n):
        i = n - 1 - back
        total = x[i]
        for j in range(i + 1, n):
            total -= a[n * i + j] * x[j]
        x[i] = total / a[n * i + i]


@native
def factor_complex(n: int, a: Vector, b: Vector, pivots: Vector) -> int:
    """LU of a + ib (n, n) in place; 1 if it is singular, else 0."""
    for k in range(n):
        best = k
        size = 0.0
        for i in range(k, n):
            here = abs(a[n * i + k]) + abs(b[n * i + k])
            if here > size:
                size = here
                best = i
        pivots[k] = float(best)
        if not size > 0.0:
            return 1
        if best != k:
            for j in range(n):
                kept = a[n * k + j]
                a[n * k + j] = a[n * best + j]
                a[n * best + j] = kept
                kept = b[n * k + j]
                b[n * k + j] = b[n * best + j]
                b[n * best + j] = kept
        square = a[n * k + k] * a[n * k + k] + b[n * k + k] * b[n * k + k]
        re = a[n * k + k] / square
        im = -b[n * k + k] / square
        for i in range(k + 1, n):
            if a[n * i + k] != 0.0 or b[n * i + k] != 0.0:
                share_re = a[n * i + k] * re - b[n * i + k] * im
                share_im = a[n * i + k] * im + b[n * i + k] * re
                a[n * i + k] = share_re
                b[n * i + k] = share_im
                for j in range(k + 1, n):
                    a[n * i + j] -= share_re * a[n * k + j] - share_im * b[n * k + j]
                    b[n * i + j] -= share_re * b[n * k + j] + share_im * a[n * k + j]
    return 0


@native
def solve_complex(n: int, a: Vector, b: Vector, pivots: Vector, x: Vector, y: Vector) -> None:
    """x + iy (n,) = (A + iB)^-1 (x + iy) by the factors of `factor_complex`."""
    for k in range(n):
        place = int(pivots[k])
        kept = x[k]
        x[k] = x[place]
        x[place] = kept
        kept = y[k]
        y[k] = y[place]
        y[place] = kept
    for i in range(n):
        re = x[i]
        im = y[i]
        for j in range(i):
            re -= a[n * i + j] * x[j] - b[n * i + j] * y[j]
            im -= a[n * i + j] * y[j] + b[n * i + j] * x[j]
        x[i] = re
        y[i] = im
    for back in range(n):
        i = n - 1 - back
        re = x[i]
        im = y[i]
        for j in range(i + 1, n):
            re -= a[n * i + j] * x[j] - b[n * i + j] * y[j]
            im -= a[n * i + j] * y[j] + b[n * i + j] * x[j]
        square = a[n * i + i] * a[n * i + i] + b[n * i + i] * b[n * i + i]
        x[i] = (re * a[n * i + i] + im * b[n * i + i]) / square
        y[i] = (im * a[n * i + i] - re * b[n * i + i]) / square
