"""Programs as LLVM text.

Products may be contracted with sums into one rounding (`contract`); nothing else is reordered.
"""

from __future__ import annotations

from collections.abc import Callable

from newton_euler.expression import Program
from newton_euler.trigonometry import SINCOS, literal

_ARITHMETIC = {"add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv"}
_CALLS = {"sqrt": "llvm.sqrt.f64", "minimum": "llvm.minnum.f64", "arctan2": "atan2"}
_BOTH = ("sin", "cos")

DECLARATIONS = f"""
declare double @llvm.sqrt.f64(double)
declare double @llvm.minnum.f64(double, double)
declare double @atan2(double, double)
{SINCOS}
"""
"""What emitted functions call."""


class Instructions:
    """Instructions of one function, in order.

    Attributes:
        lines: their text.
    """

    def __init__(self) -> None:
        self.lines: list[str] = []
        self._turned: set[str] = set()

    def operation(self, name: str, op: str, a: str, b: str | None) -> str:
        """Add an operation on operands a and b; its result is named `name`."""
        if op in _ARITHMETIC:
            self.lines.append(f"  {name} = {_ARITHMETIC[op]} contract double {a}, {b}")
        elif op == "neg":
            self.lines.append(f"  {name} = fneg double {a}")
        elif op in _BOTH:
            pair = f"%both.{a[1:]}"
            if a not in self._turned:  # sine and cosine come together
                self._turned.add(a)
                self.lines.append(f"  {pair} = call {{double, double}} @sincos(double {a})")
            self.lines.append(f"  {name} = extractvalue {{double, double}} {pair}, {_BOTH.index(op)}")
        else:
            second = "" if b is None else f", double {b}"
            self.lines.append(f"  {name} = call double @{_CALLS[op]}(double {a}{second})")
        return name

    def load(self, name: str, pointer: str, place: int | str) -> str:
        """Add a load of pointer[place]."""
        self.lines.append(f"  {name}.at = getelementptr double, ptr {pointer}, i64 {place}")
        self.lines.append(f"  {name} = load double, ptr {name}.at")
        return name

    def store(self, name: str, value: str, pointer: str, place: int | str) -> None:
        """Add pointer[place] = value; `name` is for the address."""
        self.lines.append(f"  {name} = getelementptr double, ptr {pointer}, i64 {place}")
        self.lines.append(f"  store double {value}, ptr {name}")


Emitter = Callable[[Program, str], str]
"""Program and name of the function to LLVM text of `void name(double *x, double *y)`: y = outputs at x."""


def emit_straight(program: Program, name: str) -> str:
    """The program as straight-line code."""
    out = Instructions()
    values: list[str] = []
    for k, (op, a, b) in enumerate(program.nodes):
        if op == "const":
            values.append(literal(a))
        elif op == "input":
            values.append(out.load(f"%n{k}", "%x", a))
        else:
            values.append(out.operation(f"%n{k}", op, values[a], values[b] if b >= 0 else None))
    for k, output in enumerate(program.outputs):
        out.store(f"%y{k}", values[output], "%y", k)
    head = f"define void @{name}(ptr noalias nocapture readonly %x, ptr noalias nocapture %y) {{"
    return "\n".join([head, *out.lines, "  ret void\n}"])
