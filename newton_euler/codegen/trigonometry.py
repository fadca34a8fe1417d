"""Sine and cosine of one angle together, as LLVM text.

Mechanisms need both of every hinge angle; calling the C library for each would be a good part of a
right-hand side. The angle is reduced by multiples of pi/2 kept in three parts (Cody and Waite, Software
Manual for the Elementary Functions, 1980, chapter 8), and what is left goes into the polynomials of
FDLIBM (Sun Microsystems, 1993, k_sin.c and k_cos.c). At most 2 units in the last place off; angles
beyond `FAR` go to the C library.

Several angles at once, one in each lane of a vector register, take the same time as one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

REGISTER_DOUBLES = 4
"""Doubles in a vector register of most processors: states that a run evaluates together."""

FAR = 1e5
"""rad: up to here the number of quarter revolutions times a part of pi/2 is exact."""

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
    """Write a double in LLVM's hexadecimal form, exact."""
    return f"0x{int(np.float64(value).view(np.uint64)):016X}"


def vector_type(element: str, lanes: int) -> str:
    """Return the LLVM type of so many elements, or of one alone."""
    return element if lanes == 1 else f"<{lanes} x {element}>"


def constant(value: float, lanes: int) -> str:
    """Write a double as an operand, the same in all lanes."""
    return literal(value) if lanes == 1 else f"splat (double {literal(value)})"


def suffix(lanes: int) -> str:
    """Return the ending of names of LLVM's own functions."""
    return "f64" if lanes == 1 else f"v{lanes}f64"


def _whole(value: int, lanes: int) -> str:
    return str(value) if lanes == 1 else f"splat (i64 {value})"


def _sum(name: str, a: str, b: str, c: str, lanes: int) -> str:
    """Emit %name = a b + c, rounded once where the processor can."""
    t = vector_type("double", lanes)
    return f"  %{name} = call {t} @llvm.fmuladd.{suffix(lanes)}({t} {a}, {t} {b}, {t} {c})"


def _polynomial(name: str, coefficients: Sequence[float], lanes: int) -> str:
    """Emit Horner's rule in %z into %name0."""
    t = vector_type("double", lanes)
    last = constant(coefficients[-1], lanes)
    lines = [f"  %{name}{len(coefficients) - 1} = fadd {t} {last}, {constant(0.0, lanes)}"]
    for k in range(len(coefficients) - 2, -1, -1):
        lines.append(_sum(f"{name}{k}", f"%{name}{k + 1}", "%z", constant(coefficients[k], lanes), lanes))
    return "\n".join(lines)


def _reduction(lanes: int) -> str:
    """Emit %x - %n pi/2 into %r3, one part of pi/2 after the other."""
    return "\n".join(
        _sum(f"r{k + 1}", "%n", constant(-part, lanes), f"%r{k}" if k else "%x", lanes)
        for k, part in enumerate(HALF_PI)
    )


def by_lane(name: str, function: str, arguments: Sequence[str], lanes: int) -> str:
    """Emit %name = a scalar function of double arguments, called for each lane."""
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
    """Emit `{double, double} sincos(double)`, sine and then cosine, for so many lanes.

    Lanes that are far, and no others, have the results of the C library.
    """
    t, i, w, b = (vector_type(element, lanes) for element in ("double", "i32", "i64", "i1"))
    ending = suffix(lanes)
    # The emitted function: the library for far arguments; otherwise reduction to a quarter turn, polynomials
    # of sine # and cosine, and exchange and signs by the number of quarter turns.
    all_near = f"call i1 @llvm.vector.reduce.and.v{lanes}i1({b} %lanes.near)"
    return f"""
declare double @sin(double)
declare double @cos(double)

define private {{{t}, {t}}} @sincos({t} %x) noinline {{
entry:
  %size = call {t} @llvm.fabs.{ending}({t} %x)
  %lanes.near = fcmp olt {t} %size, {constant(FAR, lanes)}
  %near = {"and i1 %lanes.near, true" if lanes == 1 else all_near}
  br i1 %near, label %fast, label %library
library:
{by_lane("sin.far", "sin", ["%x"], lanes)}
{by_lane("cos.far", "cos", ["%x"], lanes)}
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
{_sum("s", "%cube", "%s0", "%r3", lanes)}
{_polynomial("c", COSINE, lanes)}
  %half = fmul {t} %z, {constant(0.5, lanes)}
  %w = fsub {t} {constant(1.0, lanes)}, %half
  %left = fsub {t} {constant(1.0, lanes)}, %w
  %lost = fsub {t} %left, %half
  %square = fmul {t} %z, %z
{_sum("c.rest", "%square", "%c0", "%lost", lanes)}
  %c = fadd {t} %w, %c.rest
  %k = fptosi {t} %n to {i}
  %quarter = sext {i} %k to {w}
  %odd = and {w} %quarter, {_whole(1, lanes)}
  %swap = sub {w} {_whole(0, lanes)}, %odd
  %s.bits = bitcast {t} %s to {w}
  %c.bits = bitcast {t} %c to {w}
  %differ = xor {w} %s.bits, %c.bits
  %swapped = and {w} %differ, %swap
  %sin.size = xor {w} %s.bits, %swapped
  %cos.size = xor {w} %c.bits, %swapped
  %sin.up = shl {w} %quarter, {_whole(62, lanes)}
  %sin.sign = and {w} %sin.up, {_whole(-(2**63), lanes)}
  %next = add {w} %quarter, {_whole(1, lanes)}
  %cos.up = shl {w} %next, {_whole(62, lanes)}
  %cos.sign = and {w} %cos.up, {_whole(-(2**63), lanes)}
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
