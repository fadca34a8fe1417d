"""Emission of programs as LLVM text.

In straight-line code a product that one sum alone uses is rounded with it, once, on processors that can. That
is decided here and not by LLVM, whose choice depends on the code around: results are the same in all lanes of
vector code as in scalar code. Large programs, rolled up or not, round each operation by itself.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from newton_euler.codegen.expression import Program, operands
from newton_euler.codegen.trigonometry import by_lane, constant, sincos, suffix, vector_type

_ARITHMETIC = {"add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv"}
_CALLS = {"sqrt": "llvm.sqrt", "minimum": "llvm.minnum"}
_BOTH = ("sin", "cos")


def with_callees(body: str, lanes: int = 1) -> str:
    """Return emitted functions with those that they call."""
    return f"declare double @atan2(double, double)\n{sincos(lanes) if '@sincos(' in body else ''}\n{body}"


class Instructions:
    """Instructions of one function, in order, on doubles or on vectors of them.

    Attributes:
        lines: their text.
    """

    def __init__(self, lanes: int = 1) -> None:
        self.lines: list[str] = []
        self._lanes = lanes
        self._type, self._suffix = vector_type("double", lanes), suffix(lanes)
        self._turned: set[str] = set()

    def operation(self, name: str, op: str, a: str, b: str | None) -> str:
        """Add an operation on operands a and b; its result is named `name`."""
        t = self._type
        if op in _ARITHMETIC:
            self.lines.append(f"  {name} = {_ARITHMETIC[op]} {t} {a}, {b}")
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

    def product_and_sum(self, name: str, op: str, factors: tuple[str, str], term: str, first: bool) -> str:
        """Add x y + z, x y - z or, if the product does not come first, z - x y, rounded once if possible."""
        t, (x, y) = self._type, factors
        if op == "sub":
            negated = term if first else x
            self.lines.append(f"  {name}.neg = fneg {t} {negated}")
            x, term = (x, f"{name}.neg") if first else (f"{name}.neg", term)
        self.lines.append(f"  {name} = call {t} @llvm.fmuladd.{self._suffix}({t} {x}, {t} {y}, {t} {term})")
        return name

    def load(self, name: str, pointer: str, place: int | str) -> str:
        """Add a load of pointer[place]."""
        self.lines.append(f"  {name}.at = getelementptr {self._type}, ptr {pointer}, i64 {place}")
        self.lines.append(f"  {name} = load {self._type}, ptr {name}.at, align 8")
        return name

    def load_shared(self, name: str, pointer: str, place: int) -> str:
        """Add a load of pointer[place], a double for all lanes."""
        one = name if self._lanes == 1 else f"{name}.one"
        self.lines.append(f"  {name}.at = getelementptr double, ptr {pointer}, i64 {place}")
        self.lines.append(f"  {one} = load double, ptr {name}.at")
        if self._lanes > 1:
            t, places = self._type, f"<{self._lanes} x i32> zeroinitializer"
            self.lines.append(f"  {name}.first = insertelement {t} poison, double {one}, i32 0")
            self.lines.append(f"  {name} = shufflevector {t} {name}.first, {t} poison, {places}")
        return name

    def store(self, name: str, value: str, pointer: str, place: int | str, mask: str = "") -> None:
        """Add pointer[place] = value, in the lanes of a mask if given; `name` is for the address.

        What was there is loaded as volatile, or LLVM makes masked stores, which AMD's processors without
        AVX-512 take a dozen cycles for.
        """
        t = self._type
        self.lines.append(f"  {name} = getelementptr {t}, ptr {pointer}, i64 {place}")
        if mask:
            lanes = vector_type("i1", self._lanes)
            self.lines.append(f"  {name}.before = load volatile {t}, ptr {name}, align 8")
            self.lines.append(f"  {name}.new = select {lanes} {mask}, {t} {value}, {t} {name}.before")
            value = f"{name}.new"
        self.lines.append(f"  store {t} {value}, ptr {name}, align 8")

    def mask(self, name: str, bits: str) -> str:
        """Add the mask of the lanes that are bits of an integer; empty for one lane, which is on."""
        if self._lanes == 1:
            return ""
        self.lines.append(f"  {name}.bits = trunc i64 {bits} to i{self._lanes}")
        self.lines.append(
            f"  {name} = bitcast i{self._lanes} {name}.bits to {vector_type('i1', self._lanes)}"
        )
        return name


Emitter = Callable[[Program, str, int], str]
"""Program, name of the function and lanes to LLVM text of `void name(double *x, double *y, int64_t on)`: y =
outputs at x, the values of all lanes side by side, in the lanes that are bits of `on`."""

ARGUMENTS = "ptr noalias nocapture readonly %x, ptr noalias nocapture %y, i64 %on"


_IN_LANES = """
entry:
  %bits = trunc i64 %on to i{lanes}
  %all = icmp eq i{lanes} %bits, -1
  %work = alloca [{outputs} x {t}]
  %to = select i1 %all, ptr %y, ptr %work
{lines}
  br i1 %all, label %done, label %some
some:
  %mask = bitcast i{lanes} %bits to <{lanes} x i1>
  br label %keep
keep:
  %k = phi i64 [ 0, %some ], [ %k.next, %keeping ]
  %k.more = icmp slt i64 %k, {outputs}
  br i1 %k.more, label %keeping, label %done
keeping:
  %k.from = getelementptr {t}, ptr %work, i64 %k
  %k.value = load {t}, ptr %k.from, align 8
  %k.to = getelementptr {t}, ptr %y, i64 %k
  %k.before = load volatile {t}, ptr %k.to, align 8
  %k.kept = select <{lanes} x i1> %mask, {t} %k.value, {t} %k.before
  store {t} %k.kept, ptr %k.to, align 8
  %k.next = add i64 %k, 1
  br label %keep
done:
  ret void
"""
"""Body of straight-line code in lanes. Results go to y if all lanes are on, and else to memory of their own,
from where those of the lanes that are on are copied: a mask at each result would take LLVM as long as all the
rest."""


def emit_straight(program: Program, name: str, lanes: int = 1, fuses: bool = True) -> str:
    """Emit the program as straight-line code, which rounds a product with its sum if it `fuses`; an
    `Emitter`."""
    out, fused = Instructions(lanes), _fused(program) if fuses else {}
    absorbed = set(fused.values())
    places: dict[int, list[int]] = {}
    for place, output in enumerate(program.outputs):
        places.setdefault(output, []).append(place)
    target = "%y" if lanes == 1 else "%to"
    values: list[str] = []
    for k, (op, a, b) in enumerate(program.nodes):
        if op == "const":
            values.append(constant(a, lanes))
        elif op == "input":
            values.append(out.load(f"%n{k}", "%x", a))
        elif k in absorbed:
            values.append("")
        elif k in fused:
            _, x, y = program.nodes[fused[k]]
            first = fused[k] == a
            values.append(
                out.product_and_sum(f"%n{k}", op, (values[x], values[y]), values[b if first else a], first)
            )
        else:
            values.append(out.operation(f"%n{k}", op, values[a], values[b] if b >= 0 else None))
        for place in places.get(k, ()):
            out.store(f"%y{place}", values[k], target, place)
    head = f"define void @{name}({ARGUMENTS})"
    if lanes == 1:
        return "\n".join([f"{head} {{", *out.lines, "  ret void\n}"])
    t, lines = vector_type("double", lanes), "\n".join(out.lines)
    body = _IN_LANES.format(t=t, lines=lines, lanes=lanes, outputs=len(program.outputs))
    return f'{head} "stackrealign" {{{body}}}'  # registers are saved within lines of the cache


def _fused(program: Program) -> dict[int, int]:
    """Find the product that each sum or difference is rounded with, its first operand or else its second."""
    uses = Counter(program.outputs)
    for node in program.nodes:
        uses.update(operands(node))
    products = {k for k, (op, _, _) in enumerate(program.nodes) if op == "mul" and uses[k] == 1}
    fused = {}
    for k, (op, a, b) in enumerate(program.nodes):
        if op in ("add", "sub") and (a in products or b in products):
            fused[k] = a if a in products else b
    return fused
