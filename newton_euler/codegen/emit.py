"""Emission of programs as LLVM text.

Products may be contracted with sums into one rounding where that is asked for; nothing else is reordered.
"""

from __future__ import annotations

from collections.abc import Callable

from newton_euler.codegen.expression import Program
from newton_euler.codegen.trigonometry import by_lane, constant, sincos, vector_type

LANES = 4
"""Doubles in a vector register of today's processors."""

_ARITHMETIC = {"add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv"}
_CALLS = {"sqrt": "llvm.sqrt", "minimum": "llvm.minnum"}
_BOTH = ("sin", "cos")


def declarations(lanes: int = 1) -> str:
    """Declare the functions that emitted ones call."""
    t, suffix = vector_type("double", lanes), "f64" if lanes == 1 else f"v{lanes}f64"
    return f"""
declare {t} @llvm.sqrt.{suffix}({t})
declare {t} @llvm.minnum.{suffix}({t}, {t})
declare double @atan2(double, double)
{sincos(lanes)}
"""


class Instructions:
    """Instructions of one function, in order, on doubles or on vectors of them.

    Attributes:
        lines: their text.
    """

    def __init__(self, lanes: int = 1, flags: str = "") -> None:
        """`flags` are those of LLVM's floating-point arithmetic."""
        self.lines: list[str] = []
        self._lanes, self._flags = lanes, flags
        self._type, self._suffix = vector_type("double", lanes), "f64" if lanes == 1 else f"v{lanes}f64"
        self._turned: set[str] = set()

    def operation(self, name: str, op: str, a: str, b: str | None) -> str:
        """Add an operation on operands a and b; its result is named `name`."""
        t = self._type
        if op in _ARITHMETIC:
            self.lines.append(f"  {name} = {_ARITHMETIC[op]} {self._flags}{t} {a}, {b}")
        elif op == "neg":
            self.lines.append(f"  {name} = fneg {t} {a}")
        elif op in _BOTH:
            pair = f"%both.{a[1:]}"
            if a not in self._turned:  # sine and cosine come together
                self._turned.add(a)
                self.lines.append(f"  {pair} = call {{{t}, {t}}} @sincos({t} {a})")
            self.lines.append(f"  {name} = extractvalue {{{t}, {t}}} {pair}, {_BOTH.index(op)}")
        elif op == "arctan2":
            assert b is not None
            self.lines.append(by_lane(name[1:], "atan2", [a, b], self._lanes))
        else:
            second = "" if b is None else f", {t} {b}"
            self.lines.append(f"  {name} = call {t} @{_CALLS[op]}.{self._suffix}({t} {a}{second})")
        return name

    def load(self, name: str, pointer: str, place: int | str) -> str:
        """Add a load of pointer[place]."""
        self.lines.append(f"  {name}.at = getelementptr {self._type}, ptr {pointer}, i64 {place}")
        self.lines.append(f"  {name} = load {self._type}, ptr {name}.at, align 8")
        return name

    def store(self, name: str, value: str, pointer: str, place: int | str) -> None:
        """Add pointer[place] = value; `name` is for the address."""
        self.lines.append(f"  {name} = getelementptr {self._type}, ptr {pointer}, i64 {place}")
        self.lines.append(f"  store {self._type} {value}, ptr {name}, align 8")


Emitter = Callable[[Program, str], str]
"""Program and name of the function to LLVM text of `void name(double *x, double *y)`: y = outputs at x."""


def emit_straight(program: Program, name: str, lanes: int = 1) -> str:
    """Emit the program as straight-line code; x and y hold the values of all lanes side by side."""
    out = Instructions(lanes, "contract ")
    values: list[str] = []
    for k, (op, a, b) in enumerate(program.nodes):
        if op == "const":
            values.append(constant(a, lanes))
        elif op == "input":
            values.append(out.load(f"%n{k}", "%x", a))
        else:
            values.append(out.operation(f"%n{k}", op, values[a], values[b] if b >= 0 else None))
    for k, output in enumerate(program.outputs):
        out.store(f"%y{k}", values[output], "%y", k)
    head = f"define void @{name}(ptr noalias nocapture readonly %x, ptr noalias nocapture %y) {{"
    return "\n".join([head, *out.lines, "  ret void\n}"])
