"""Write an LLVM function that computes the sine and the cosine of an angle together, and helpers for LLVM
text.

The equations of motion need both for every hinge angle, and calls of the C library would take a large part of
their time. The angle is reduced by multiples of pi/2, which is stored as a sum of three parts (W. J. Cody,
W. Waite, Software Manual for the Elementary Functions, 1980, chapter 8). The polynomials of FDLIBM are
evaluated at the reduced angle (Sun Microsystems, 1993, k_sin.c and k_cos.c). The error is at most 2 units in
the last place. Angles beyond `MAX_REDUCED_ANGLE` go to the C library.

The function can take several angles, one in each *lane* (element) of a vector register, in the same time.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

REGISTER_DOUBLES = 4
"""Number of doubles in a vector register of most processors (256 bits)."""

MAX_REDUCED_ANGLE = 1e5
"""Largest angle, rad, for which the number of quarter turns times each of the first two parts of pi/2
(`HALF_PI`) is exact."""

TWO_OVER_PI = 6.36619772367581382433e-01
"""2 / pi, the number of quarter turns in a radian."""

HALF_PI = (1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624879595063154e-21)
"""pi/2 as the sum of three numbers; the first two have 33 significant bits."""

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
"""Coefficients of FDLIBM's polynomials in ascending powers of the squared angle: those of the sine from x^3
on, those of the cosine from x^4 on."""


def literal(value: float) -> str:
    """Return the exact LLVM text of a double, in hexadecimal form."""
    return f"0x{int(np.float64(value).view(np.uint64)):016X}"


def vector_type(element: str, lanes: int) -> str:
    """Return the LLVM type of a vector with one element per lane; for one lane, the type of the element."""
    return element if lanes == 1 else f"<{lanes} x {element}>"


def constant(value: float, lanes: int) -> str:
    """Return the LLVM text of an operand that is the same double in all lanes."""
    return literal(value) if lanes == 1 else f"splat (double {literal(value)})"


def intrinsic_suffix(lanes: int) -> str:
    """Return the suffix of names of LLVM's intrinsic functions for doubles in so many lanes."""
    return "f64" if lanes == 1 else f"v{lanes}f64"


def _integer(value: int, lanes: int) -> str:
    """Return the LLVM text of an operand that is the same integer in all lanes."""
    return str(value) if lanes == 1 else f"splat (i64 {value})"


def _multiply_add(name: str, a: str, b: str, c: str, lanes: int) -> str:
    """Return the instruction %name = a b + c, rounded once if the processor supports that."""
    t = vector_type("double", lanes)
    return f"  %{name} = call {t} @llvm.fmuladd.{intrinsic_suffix(lanes)}({t} {a}, {t} {b}, {t} {c})"


def _polynomial(name: str, coefficients: Sequence[float], lanes: int) -> str:
    """Return instructions that evaluate a polynomial at %z by Horner's rule; the result is %name0."""
    t = vector_type("double", lanes)
    last = constant(coefficients[-1], lanes)  # plus 0, since no LLVM instruction only names a constant
    lines = [f"  %{name}{len(coefficients) - 1} = fadd {t} {last}, {constant(0.0, lanes)}"]
    for k in range(len(coefficients) - 2, -1, -1):
        lines.append(
            _multiply_add(f"{name}{k}", f"%{name}{k + 1}", "%z", constant(coefficients[k], lanes), lanes)
        )
    return "\n".join(lines)


def _reduction(lanes: int) -> str:
    """Return instructions for %r3 = %x - %n pi/2, which subtract one part of pi/2 after the other."""
    return "\n".join(
        _multiply_add(f"r{k + 1}", "%n", constant(-part, lanes), f"%r{k}" if k else "%x", lanes)
        for k, part in enumerate(HALF_PI)
    )


def call_per_lane(name: str, function: str, arguments: Sequence[str], lanes: int) -> str:
    """Return instructions that call a scalar function of doubles once for each lane; the result is %name."""
    if lanes == 1:
        return f"  %{name} = call double @{function}({', '.join(f'double {a}' for a in arguments)})"
    t = vector_type("double", lanes)
    lines, before = [], "poison"
    for k in range(lanes):
        for i, argument in enumerate(arguments):
            lines.append(f"  %{name}.{k}.{i} = extractelement {t} {argument}, i32 {k}")
        given = ", ".join(f"double %{name}.{k}.{i}" for i in range(len(arguments)))
        lines.append(f"  %{name}.{k} = call double @{function}({given})")
        target = f"%{name}" if k == lanes - 1 else f"%{name}.to{k}"
        lines.append(f"  {target} = insertelement {t} {before}, double %{name}.{k}, i32 {k}")
        before = target
    return "\n".join(lines)


def sincos(lanes: int) -> str:
    """Return the LLVM text of the function `{double, double} sincos(double)`: sine, then cosine, of each
    lane.

    Lanes with angles beyond `MAX_REDUCED_ANGLE`, and no others, have the results of the C library.
    """
    t, i, w, b = (vector_type(element, lanes) for element in ("double", "i32", "i64", "i1"))
    ending = intrinsic_suffix(lanes)
    # The function calls the C library if an angle is large. It reduces the angle %x to %r3 within an eighth
    # of a turn and evaluates both polynomials. The cosine is %w + %c.rest: %w is 1 - %z/2, and %lost its
    # rounding error. After an odd number %k of quarter turns the function exchanges sine and cosine. Shifts
    # by 62 bits move bit 1 of %k (sine) or of %k + 1 (cosine) to the place of the sign.
    all_near = f"call i1 @llvm.vector.reduce.and.v{lanes}i1({b} %lanes.near)"
    return f"""
declare double @sin(double)
declare double @cos(double)

define private {{{t}, {t}}} @sincos({t} %x) noinline {{
entry:
  %size = call {t} @llvm.fabs.{ending}({t} %x)
  %lanes.near = fcmp olt {t} %size, {constant(MAX_REDUCED_ANGLE, lanes)}
  %near = {"and i1 %lanes.near, true" if lanes == 1 else all_near}
  br i1 %near, label %fast, label %library
library:
{call_per_lane("sin.far", "sin", ["%x"], lanes)}
{call_per_lane("cos.far", "cos", ["%x"], lanes)}
  br label %fast
fast:
  %sin.library = phi {t} [ {constant(0.0, lanes)}, %entry ], [ %sin.far, %library ]
  %cos.library = phi {t} [ {constant(0.0, lanes)}, %entry ], [ %cos.far, %library ]
  %turns = fmul {t} %x, {constant(TWO_OVER_PI, lanes)}
  %n = call {t} @llvm.rint.{ending}({t} %turns)
{_reduction(lanes)}
  %z = fmul {t} %r3, %r3
{_polynomial("s", SINE, lanes)}
  %cube = fmul {t} %z, %r3
{_multiply_add("s", "%cube", "%s0", "%r3", lanes)}
{_polynomial("c", COSINE, lanes)}
  %half = fmul {t} %z, {constant(0.5, lanes)}
  %w = fsub {t} {constant(1.0, lanes)}, %half
  %left = fsub {t} {constant(1.0, lanes)}, %w
  %lost = fsub {t} %left, %half
  %square = fmul {t} %z, %z
{_multiply_add("c.rest", "%square", "%c0", "%lost", lanes)}
  %c = fadd {t} %w, %c.rest
  %k = fptosi {t} %n to {i}
  %quarter = sext {i} %k to {w}
  %odd = and {w} %quarter, {_integer(1, lanes)}
  %swap = sub {w} {_integer(0, lanes)}, %odd
  %s.bits = bitcast {t} %s to {w}
  %c.bits = bitcast {t} %c to {w}
  %differ = xor {w} %s.bits, %c.bits
  %swapped = and {w} %differ, %swap
  %sin.size = xor {w} %s.bits, %swapped
  %cos.size = xor {w} %c.bits, %swapped
  %sin.up = shl {w} %quarter, {_integer(62, lanes)}
  %sin.sign = and {w} %sin.up, {_integer(-(2**63), lanes)}
  %next = add {w} %quarter, {_integer(1, lanes)}
  %cos.up = shl {w} %next, {_integer(62, lanes)}
  %cos.sign = and {w} %cos.up, {_integer(-(2**63), lanes)}
  %sin.bits = xor {w} %sin.size, %sin.sign
  %cos.bits = xor {w} %cos.size, %cos.sign
  %sin.near = bitcast {w} %sin.bits to {t}
  %cos.near = bitcast {w} %cos.bits to {t}
  %sin.x = select {b} %lanes.near, {t} %sin.near, {t} %sin.library
  %cos.x = select {b} %lanes.near, {t} %cos.near, {t} %cos.library
  %one = insertvalue {{{t}, {t}}} poison, {t} %sin.x, 0
  %both = insertvalue {{{t}, {t}}} %one, {t} %cos.x, 1
  ret {{{t}, {t}}} %both
}}
"""
