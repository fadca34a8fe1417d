"""Write programs (pruned expression graphs) as straight-line LLVM code, for one or several inputs.

A *lane* is an element of a vector register; code in lanes processes several inputs at once, one in each lane.
If one sum alone uses a product, both are computed by a fused multiply-add, which rounds once. This module
makes this choice and not LLVM, because LLVM's choice depends on the surrounding code. So results are the same
bit by bit in all lanes and in scalar code. Large programs round each operation separately (`emit_straight`
with `fuses=False`).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

from newton_euler.codegen.expression import Program, operands
from newton_euler.codegen.trigonometry import call_per_lane, constant, intrinsic_suffix, sincos, vector_type

# LLVM's instructions and intrinsic functions by name of the operation in an expression graph
_ARITHMETIC = {"add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv"}
_CALLS = {"sqrt": "llvm.sqrt", "minimum": "llvm.minnum"}
_SINCOS_RESULTS = ("sin", "cos")  # in the order in which @sincos returns them


def with_callees(body: str, lanes: int = 1) -> str:
    """Return LLVM text of functions, completed by the functions that they call."""
    return f"declare double @atan2(double, double)\n{sincos(lanes) if '@sincos(' in body else ''}\n{body}"


class Instructions:
    """LLVM instructions of one function, in order, on doubles or on vectors of doubles.

    Each method appends the text of its instructions to `lines` and returns the name of its result.

    Attributes:
        lines: text of the instructions.
    """

    def __init__(self, lanes: int = 1) -> None:
        """Begin without instructions; `lanes` is the number of inputs that are processed at once."""
        self.lines: list[str] = []
        self._lanes = lanes
        self._type, self._suffix = vector_type("double", lanes), intrinsic_suffix(lanes)
        self._angles: set[str] = set()  # operands whose sine and cosine are computed already

    def operation(self, name: str, op: str, a: str, b: str | None) -> str:
        """Append an operation.

        Args:
            name: name of the result.
            op: name of the operation in an expression graph.
            a, b: operands; b is None if there is no second one.
        """
        t = self._type  # names of operands begin with %, which name[1:] and a[1:] remove
        if op in _ARITHMETIC:
            self.lines.append(f"  {name} = {_ARITHMETIC[op]} {t} {a}, {b}")
        elif op == "neg":
            self.lines.append(f"  {name} = fneg {t} {a}")
        elif op in _SINCOS_RESULTS:
            pair = f"%both.{a[1:]}"
            if a not in self._angles:  # one call computes sine and cosine
                self._angles.add(a)
                self.lines.append(f"  {pair} = call {{{t}, {t}}} @sincos({t} {a})")
            self.lines.append(f"  {name} = extractvalue {{{t}, {t}}} {pair}, {_SINCOS_RESULTS.index(op)}")
        elif op == "arctan2":
            assert b is not None
            self.lines.append(call_per_lane(name[1:], "atan2", [a, b], self._lanes))
        else:
            second = "" if b is None else f", {t} {b}"
            self.lines.append(f"  {name} = call {t} @{_CALLS[op]}.{self._suffix}({t} {a}{second})")
        return name

    def product_and_sum(self, name: str, op: str, factors: tuple[str, str], term: str, first: bool) -> str:
        """Append a sum or difference of a product and a term, rounded once if the processor supports that.

        Args:
            name: name of the result.
            op: "add" or "sub".
            factors: operands x and y of the product.
            term: operand z.
            first: True for x y + z or x y - z, False for z - x y.
        """
        t, (x, y) = self._type, factors
        if op == "sub":
            negated = term if first else x
            self.lines.append(f"  {name}.neg = fneg {t} {negated}")
            x, term = (x, f"{name}.neg") if first else (f"{name}.neg", term)
        self.lines.append(f"  {name} = call {t} @llvm.fmuladd.{self._suffix}({t} {x}, {t} {y}, {t} {term})")
        return name

    def load(self, name: str, pointer: str, place: int | str) -> str:
        """Append a load of the value pointer[place], one double per lane."""
        self.lines.append(f"  {name}.at = getelementptr {self._type}, ptr {pointer}, i64 {place}")
        self.lines.append(f"  {name} = load {self._type}, ptr {name}.at, align 8")
        return name

    def load_shared(self, name: str, pointer: str, place: int) -> str:
        """Append a load of the double pointer[place], which is the same for all lanes."""
        one = name if self._lanes == 1 else f"{name}.one"
        self.lines.append(f"  {name}.at = getelementptr double, ptr {pointer}, i64 {place}")
        self.lines.append(f"  {one} = load double, ptr {name}.at")
        if self._lanes > 1:
            t, places = self._type, f"<{self._lanes} x i32> zeroinitializer"
            self.lines.append(f"  {name}.first = insertelement {t} poison, double {one}, i32 0")
            self.lines.append(f"  {name} = shufflevector {t} {name}.first, {t} poison, {places}")
        return name

    def store(self, name: str, value: str, pointer: str, place: int | str, mask: str = "") -> None:
        """Append the assignment pointer[place] = value, in the lanes of a mask if one is given.

        With a mask, the old value is loaded and blended with the new one. The load is volatile, because LLVM
        would otherwise use masked stores, which take a dozen cycles on AMD's processors without AVX-512.

        Args:
            name: name for the address.
            value: operand to store.
            pointer, place: address of an array, and index of the element.
            mask: name of the mask, empty for all lanes.
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
        """Append the conversion of an integer to a mask of lanes: bit i is lane i. Return "" for one lane."""
        if self._lanes == 1:
            return ""
        self.lines.append(f"  {name}.bits = trunc i64 {bits} to i{self._lanes}")
        self.lines.append(
            f"  {name} = bitcast i{self._lanes} {name}.bits to {vector_type('i1', self._lanes)}"
        )
        return name


Emitter = Callable[[Program, str, int], str]
"""Type of functions that write a program as LLVM text. Arguments: the program, the name of the function and
the number of lanes. The text defines `void name(double *x, double *y, int64_t on)`, which writes the outputs
at x to y in each lane i for which bit i of `on` is 1. Code of one lane ignores `on`. The
values that an input or output has in all lanes are contiguous."""

ARGUMENTS = "ptr noalias nocapture readonly %x, ptr noalias nocapture %y, i64 %on"
"""LLVM text of the arguments of such a function."""

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
"""Body of straight-line code in lanes. If all lanes are active, results go to y. Otherwise they go to
temporary memory, and a loop copies the results of the active lanes to y. A mask at each result would double
the compile time."""


def emit_straight(program: Program, name: str, lanes: int = 1, fuses: bool = True) -> str:
    """Write a program as straight-line code; an `Emitter`.

    Args:
        program: program to write.
        name: name of the LLVM function.
        lanes: number of inputs that a call takes at once.
        fuses: True to compute a product and the only sum that uses it by one fused multiply-add.
    """
    out, fused = Instructions(lanes), _fused_products(program) if fuses else {}
    absorbed = set(fused.values())  # products that have no separate instruction
    places: dict[int, list[int]] = {}  # places in y of the outputs of each node
    for place, output in enumerate(program.outputs):
        places.setdefault(output, []).append(place)
    # one instruction for each node; `values` are the LLVM operands of all nodes. In a node (op, a, b), a and
    # b are the indices of the operands, and b is -1 if there is only one. In a "const", a is the value; in an
    # "input", a is the index in x.
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
            _, x, y = program.nodes[fused[k]]  # the factors of the product
            first = fused[k] == a
            factors, term = (values[x], values[y]), values[b if first else a]
            values.append(out.product_and_sum(f"%n{k}", op, factors, term, first))
        else:
            values.append(out.operation(f"%n{k}", op, values[a], values[b] if b >= 0 else None))
        for place in places.get(k, ()):
            out.store(f"%y{place}", values[k], target, place)
    # the function around the instructions
    head = f"define void @{name}({ARGUMENTS})"
    if lanes == 1:
        return "\n".join([f"{head} {{", *out.lines, "  ret void\n}"])
    t, lines = vector_type("double", lanes), "\n".join(out.lines)
    body = _IN_LANES.format(t=t, lines=lines, lanes=lanes, outputs=len(program.outputs))
    return f'{head} "stackrealign" {{{body}}}'  # aligned so that saved registers do not cross cache lines


def _fused_products(program: Program) -> dict[int, int]:
    """Return the node of the product to fuse with a sum or difference, by the node of the sum.

    A product is fused if only this sum uses it. If both operands are such products, the first one is fused.
    """
    uses = Counter(program.outputs)
    for node in program.nodes:
        uses.update(operands(node))
    products = {k for k, (op, _, _) in enumerate(program.nodes) if op == "mul" and uses[k] == 1}
    fused = {}
    for k, (op, a, b) in enumerate(program.nodes):
        if op in ("add", "sub") and (a in products or b in products):
            fused[k] = a if a in products else b
    return fused
