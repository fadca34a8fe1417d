"""Sine and cosine of one angle together, as LLVM text.

Mechanisms need both of every hinge angle; calling the C library for each would be a good part of a
right-hand side. The angle is reduced by multiples of pi/2 kept in three parts (Cody and Waite, Software
Manual for the Elementary Functions, 1980, chapter 8), and what is left goes into the polynomials of
FDLIBM (Sun Microsystems, 1993, k_sin.c and k_cos.c). At most 2 units in the last place off; angles
beyond `FAR` go to the C library.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

FAR = 1e5
"""rad: up to here the number of quarter turns times a part of pi/2 is exact."""

TWO_OVER_PI = 6.36619772367581382433e-01
HALF_PI = (1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21)
"""pi/2 as a sum; the first two parts have 33 bits."""

SINE = (
    -1.66666666666666324348e-01,
    8.33333333332248946124e-03,
    -1.98412698298579493134e-04,
    2.75573137070700676789e-06,
    -2.50507602534068634195e-08,
    1.58969099521155010221e-10,
)
COSINE = (
    4.16666666666666019037e-02,
    -1.38888888888741095749e-03,
    2.48015872894767294178e-05,
    -2.75573143513906633035e-07,
    2.08757232129817482790e-09,
    -1.13596475577881948265e-11,
)
"""Coefficients in rising powers of the squared angle, from x^3 and x^4 on."""


def literal(value: float) -> str:
    """A double in LLVM's hexadecimal form, exact."""
    return f"0x{int(np.float64(value).view(np.uint64)):016X}"


def _polynomial(name: str, coefficients: Sequence[float]) -> str:
    """Horner's rule in %z into %name0."""
    lines = [f"  %{name}{len(coefficients) - 1} = fadd double {literal(coefficients[-1])}, 0.0"]
    for k in range(len(coefficients) - 2, -1, -1):
        lines.append(f"  %{name}m{k} = fmul contract double %{name}{k + 1}, %z")
        lines.append(f"  %{name}{k} = fadd contract double %{name}m{k}, {literal(coefficients[k])}")
    return "\n".join(lines)


def _reduction() -> str:
    """%x - %n pi/2 into %r3, one part of pi/2 after the other."""
    return "\n".join(
        f"  %w{k} = fmul contract double %n, {literal(part)}\n"
        f"  %r{k + 1} = fsub contract double %{'x' if k == 0 else f'r{k}'}, %w{k}"
        for k, part in enumerate(HALF_PI)
    )


SINCOS = f"""
declare double @sin(double)
declare double @cos(double)
declare double @llvm.fabs.f64(double)
declare double @llvm.rint.f64(double)

define private {{double, double}} @sincos(double %x) noinline {{
  %size = call double @llvm.fabs.f64(double %x)
  %near = fcmp olt double %size, {literal(FAR)}
  br i1 %near, label %fast, label %library
library:
  %sin.far = call double @sin(double %x)
  %cos.far = call double @cos(double %x)
  br label %end
fast:
  %turns = fmul double %x, {literal(TWO_OVER_PI)}
  %n = call double @llvm.rint.f64(double %turns)
{_reduction()}
  %z = fmul double %r3, %r3
{_polynomial("s", SINE)}
  %cube = fmul double %z, %r3
  %s.rest = fmul contract double %cube, %s0
  %s = fadd contract double %r3, %s.rest
{_polynomial("c", COSINE)}
  %half = fmul double %z, 0.5
  %w = fsub double 1.0, %half
  %left = fsub double 1.0, %w
  %lost = fsub double %left, %half
  %square = fmul double %z, %z
  %c.high = fmul contract double %square, %c0
  %c.rest = fadd contract double %lost, %c.high
  %c = fadd double %w, %c.rest
  %k = fptosi double %n to i64
  %odd.bit = and i64 %k, 1
  %odd = icmp ne i64 %odd.bit, 0
  %sin.size = select i1 %odd, double %c, double %s
  %cos.size = select i1 %odd, double %s, double %c
  %sin.bit = and i64 %k, 2
  %sin.down = icmp ne i64 %sin.bit, 0
  %next = add i64 %k, 1
  %cos.bit = and i64 %next, 2
  %cos.down = icmp ne i64 %cos.bit, 0
  %sin.neg = fneg double %sin.size
  %cos.neg = fneg double %cos.size
  %sin.near = select i1 %sin.down, double %sin.neg, double %sin.size
  %cos.near = select i1 %cos.down, double %cos.neg, double %cos.size
  br label %end
end:
  %sin.x = phi double [ %sin.far, %library ], [ %sin.near, %fast ]
  %cos.x = phi double [ %cos.far, %library ], [ %cos.near, %fast ]
  %one = insertvalue {{double, double}} poison, double %sin.x, 0
  %both = insertvalue {{double, double}} %one, double %cos.x, 1
  ret {{double, double}} %both
}}
"""
"""LLVM text of `{{double, double}} sincos(double)`: sine, then cosine."""
