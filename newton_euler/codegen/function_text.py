"""Write the LLVM text of one function: instructions, labels, masks of lanes, and variables.

`newton_euler.codegen.function_expressions` adds expressions, and `newton_euler.codegen.translate` adds
statements of Python. Code for several runs processes one run in each *lane* (element) of the vector
registers. A number that is the same in all lanes is an LLVM scalar; other numbers are vectors with one
element per lane. A condition that differs between lanes is a *mask*, a vector of booleans. A lane is *on*
(active) if the present instructions apply to it. The variable %on holds the mask of active lanes. Code for
one run has no masks.
"""

from __future__ import annotations

import ast
from collections.abc import Callable
from typing import Any, NamedTuple

from newton_euler.codegen.native import Kind, NativeError, machine_type
from newton_euler.codegen.trigonometry import vector_type

ALL = "splat (i1 true)"
"""LLVM text of the mask with all lanes on."""


class Value(NamedTuple):
    """An LLVM operand with its type.

    Attributes:
        type: LLVM type of a number or a condition; kind of a vector, a callback or a record (a dataclass that
            is an argument).
        operand: LLVM text of the operand.
        factors: operands of the two factors if the value is a product of doubles; a sum with the product
            becomes a fused multiply-add.
        offset: operand of the index at which a vector begins in each lane, if it differs between lanes.
    """

    type: Kind
    operand: str
    factors: tuple[str, str] | None = None
    offset: str = ""


def is_whole(value: Value) -> bool:
    """Return True if the value is an integer, the same in all lanes or not."""
    return "i64" in str(value.type)


def is_vector(value: Value) -> bool:
    """Return True if the value is an array in memory: `Vector`, with elements of its own for each lane, or
    `Shared`, the same in all lanes."""
    return value.type in ("ptr", "shared")


def varies(value: Value) -> bool:
    """Return True if the value is a number or a condition that may differ between lanes."""
    return isinstance(value.type, str) and value.type.startswith("<")


class Found(NamedTuple):
    """Variables and loops of a function that differ between lanes.

    A translation adds the ones that it finds, and is repeated until nothing is added.

    Attributes:
        varying: names of variables that may differ between lanes.
        divergent: line numbers of loops in which some lanes may use break, continue or return before others.
    """

    varying: set[str]
    divergent: set[int]


class FunctionText:
    """LLVM text of a function while it is written. Variables are in memory; LLVM moves them to registers.

    Attributes:
        function: Python function that is translated, for messages.
        lanes: number of runs at once.
    """

    def __init__(self, function: Callable[..., Any], lanes: int, found: Found) -> None:
        """Begin the text of a function.

        Args:
            function: Python function that is translated.
            lanes: number of runs at once.
            found: variables and loops known to differ between lanes; the translation adds others.
        """
        self.function, self.lanes, self._found = function, lanes, found
        self._doubles, self._wholes, self._mask = map(self._type_in_lanes, ("double", "i64", "i1"))
        self._lines: list[str] = []
        self._slots: list[str] = []  # instructions that allocate variables
        self._records: dict[str, Value] = {}  # arguments that are records, by name
        self._variables: dict[str, Value] = {}  # address of a number, or the vector or callback, by name
        self._count = 0  # number of temporary names and labels so far
        self._divergence = 0  # depth of branches and loops in which lanes may be off
        self._reachable = True  # False after a jump, until the next label
        self._block_label = "entry"  # label of the present block

    def _new(self, instruction: str) -> str:
        """Append an instruction with a result, and return the name of the result."""
        self._count += 1
        self._emit(f"%t{self._count} = {instruction}")
        return f"%t{self._count}"

    def _emit(self, instruction: str) -> None:
        """Append an instruction without a result."""
        self._lines.append(f"  {instruction}")

    def _error(self, node: ast.AST | None, problem: str) -> NativeError:
        """Return an error that names the function, the line of a syntax node and the problem."""
        line = getattr(node, "lineno", 0)
        return NativeError(f"{self.function.__name__}, line {line}: {problem}, which native code cannot")

    # Labels

    def _labels(self, *names: str) -> list[str]:
        """Return a unique label for each name."""
        self._count += 1
        return [f"{name}{self._count}" for name in names]

    def _begin(self, label: str) -> None:
        """Begin a block of instructions at a label."""
        self._lines.append(f"{label}:")
        self._reachable, self._block_label = True, label

    def _jump(self, label: str) -> bool:
        """Jump to a label unless the block has ended already; return True if the jump was written."""
        was_reachable = self._reachable
        if was_reachable:
            self._emit(f"br label %{label}")
        self._reachable = False
        return was_reachable

    def _branch(self, test: str, yes: str, no: str) -> None:
        """Jump to the label `yes` if a condition holds, else to the label `no`."""
        self._emit(f"br i1 {test}, label %{yes}, label %{no}")
        self._reachable = False

    # Lanes

    def _on(self) -> str:
        """Read the mask of the lanes that are on."""
        return self._new(f"load {self._mask}, ptr %on")

    def _turn(self, mask: str) -> None:
        """Set the mask of the lanes that are on."""
        self._emit(f"store {self._mask} {mask}, ptr %on")

    def _any(self, mask: str) -> str:
        """Return the condition that some lane of a mask is on."""
        return self._new(f"call i1 @llvm.vector.reduce.or.v{self.lanes}i1({self._mask} {mask})")

    def _and(self, a: str, b: str) -> str:
        """Return the mask of lanes in both masks."""
        return self._new(f"and {self._mask} {a}, {b}")

    def _or(self, a: str, b: str) -> str:
        """Return the mask of lanes in at least one of two masks."""
        return self._new(f"or {self._mask} {a}, {b}")

    def _without(self, a: str, b: str) -> str:
        """Return the mask of lanes in mask a that are not in mask b."""
        return self._and(a, self._new(f"xor {self._mask} {b}, {ALL}"))

    def _mask_slot(self) -> str:
        """Allocate a variable for a mask, initially without lanes, and return its address."""
        self._count += 1
        self._slots.append(f"  %lanes{self._count} = alloca {self._mask}")
        self._emit(f"store {self._mask} zeroinitializer, ptr %lanes{self._count}")
        return f"%lanes{self._count}"

    def _bits(self) -> str:
        """Return an integer whose bit i is 1 if lane i is on; all bits are 1 in code for one run."""
        if self.lanes == 1:
            return "-1"
        bits = self._new(f"bitcast {self._mask} {self._on()} to i{self.lanes}")
        return self._new(f"zext i{self.lanes} {bits} to i64")

    def _type_in_lanes(self, kind: Kind) -> str:
        """Return the LLVM type of a number or a condition that may differ between lanes."""
        return vector_type(str(kind), self.lanes)

    def _wide(self, value: Value) -> Value:
        """Return a number or a condition as a vector with one element per lane."""
        if self.lanes == 1 or varies(value):
            return value
        kind = str(value.type)
        factors = value.factors and (self._splat(kind, value.factors[0]), self._splat(kind, value.factors[1]))
        return Value(self._type_in_lanes(kind), self._splat(kind, value.operand), factors)

    def _splat(self, kind: str, operand: str) -> str:
        """Return the vector that has a scalar operand of an LLVM type in all lanes."""
        if not operand.startswith("%"):
            return f"splat ({kind} {operand})"
        wide = self._type_in_lanes(kind)
        one = self._new(f"insertelement {wide} poison, {kind} {operand}, i32 0")
        return self._new(f"shufflevector {wide} {one}, {wide} poison, <{self.lanes} x i32> zeroinitializer")

    def _alike(self, value: Value, other: Value) -> Value:
        """Return a value as a vector if another value is one, so that both have the same type."""
        return self._wide(value) if varies(other) else value

    def _blend(self, value: Value, address: str, volatile: str = "") -> None:
        """Store a value in the lanes that are on; in other lanes memory stays as it is.

        Args:
            value: number to store.
            address: LLVM operand of the address.
            volatile: " volatile" to keep LLVM from replacing this code by a slower masked store, see
                `newton_euler.codegen.emit.Instructions.store`.
        """
        operand = value.operand
        if self.lanes > 1:
            before = self._new(f"load{volatile} {value.type}, ptr {address}, align 8")
            chosen = f"select {self._mask} {self._on()}, {value.type} {operand}, {value.type} {before}"
            operand = self._new(chosen)
        self._emit(f"store {value.type} {operand}, ptr {address}, align 8")

    # Numbers and variables

    def _float(self, value: Value) -> Value:
        """Return a number as a double."""
        if is_whole(value):
            kind = str(value.type).replace("i64", "double")
            return Value(kind, self._new(f"sitofp {value.type} {value.operand} to {kind}"))
        if "double" not in str(value.type):
            raise NativeError(f"{self.function.__name__}: {value.type} where a number is needed")
        return value

    def _pair(self, a: Value, b: Value) -> tuple[Value, Value]:
        """Return two numbers converted to one type: doubles, unless both are integers."""
        if not (is_whole(a) and is_whole(b)):
            a, b = self._float(a), self._float(b)
        return self._alike(a, b), self._alike(b, a)

    def _store(self, name: str, value: Value, node: ast.expr | None = None) -> None:
        """Assign a value to a variable. A variable that is a vector or a callback is assigned only once.

        Args:
            name: name of the variable.
            value: value to assign.
            node: syntax node of the variable, for messages.
        """
        known = self._variables.get(name)
        if name in self._records:
            raise self._error(node, f"assigns to {name!r}, which is a record")
        if is_vector(value) or value.type == "fn":
            if known is not None:
                raise self._error(node, f"gives {name!r} a second vector")
            self._variables[name] = value
            return
        if known is not None and "double" in str(known.type):
            value = self._float(value)
        if known is not None and (is_whole(known) != is_whole(value) or not self._in_slot(known)):
            raise self._error(node, f"assigns {value.type} to {name!r}, which is {known.type}")
        if self._divergence or varies(value):
            self._found.varying.add(name)
        if name in self._found.varying:
            value = self._wide(value)
        self._set(name, value, self._divergence > 0)

    def _set(self, name: str, value: Value, divergent: bool = False) -> None:
        """Store a number in the variable of this name and type, allocated when first used.

        Args:
            name: name of the variable.
            value: number to store.
            divergent: True to store only in the lanes that are on.
        """
        slot = f"%{name}.{str(value.type).strip('<>').replace(' ', '')}"
        line = f"  {slot} = alloca {value.type}"
        if line not in self._slots:
            self._slots.append(line)
        self._variables[name] = Value(value.type, slot)
        if divergent:
            self._blend(value, slot)
        else:
            self._emit(f"store {value.type} {value.operand}, ptr {slot}, align 8")

    def _load(self, name: str) -> Value:
        """Return the value of a variable."""
        known = self._variables[name]
        if not self._in_slot(known):
            return known
        return Value(known.type, self._new(f"load {known.type}, ptr {known.operand}, align 8"))

    def _in_slot(self, known: Value) -> bool:
        """Return True if a variable is a number, which is stored in memory."""
        return not is_vector(known) and known.type != "fn"


def typed(value: Value) -> str:
    """Return LLVM text of a value with its type, as an argument of a call."""
    return f"{machine_type(value.type)} {value.operand}"
