"""Text of a function in LLVM's language while it is written: instructions, labels, lanes and variables.

A number that is the same in all lanes is a scalar, any other a vector with an element per lane. So are
conditions, whose vectors are masks. Code for one run has one lane, which is always on, and neither.
"""

from __future__ import annotations

import ast
from collections.abc import Callable
from typing import Any, NamedTuple

from newton_euler.codegen.native import Kind, NativeError, machine_type
from newton_euler.codegen.trigonometry import vector_type

ALL = "splat (i1 true)"
"""Mask of all lanes."""


class Value(NamedTuple):
    """An LLVM operand with its type.

    Attributes:
        factors: of a product of doubles.
        offset: of a vector that begins elsewhere in each lane, in elements.
    """

    type: Kind
    operand: str
    factors: tuple[str, str] | None = None
    offset: str = ""


def is_whole(value: Value) -> bool:
    """Return True for an integer, or one per lane."""
    return "i64" in str(value.type)


def is_vector(value: Value) -> bool:
    """Return True for a vector in memory."""
    return value.type in ("ptr", "shared")


def varies(value: Value) -> bool:
    """Return True for a number or a condition that has an element per lane."""
    return isinstance(value.type, str) and value.type.startswith("<")


class Found(NamedTuple):
    """Findings of a translation so far, which the next one begins with.

    Attributes:
        varying: names of variables that differ between lanes.
        divergent: lines of loops that some lanes may leave or cut short before others.
    """

    varying: set[str]
    divergent: set[int]


class FunctionText:
    """Instructions of a function. Variables live in memory; LLVM moves them to registers.

    Attributes:
        function: in Python, for messages.
        lanes: runs side by side.
    """

    def __init__(self, function: Callable[..., Any], lanes: int, found: Found) -> None:
        self.function, self.lanes, self._found = function, lanes, found
        self._doubles, self._wholes, self._mask = map(self._type_in_lanes, ("double", "i64", "i1"))
        self._lines: list[str] = []
        self._slots: list[str] = []
        self._records: dict[str, Value] = {}
        self._variables: dict[str, Value] = {}
        self._count = self._divergence = 0
        self._open = True
        self._at = "entry"

    def _new(self, instruction: str) -> str:
        self._count += 1
        self._emit(f"%t{self._count} = {instruction}")
        return f"%t{self._count}"

    def _emit(self, instruction: str) -> None:
        self._lines.append(f"  {instruction}")

    def _error(self, node: ast.AST | None, problem: str) -> NativeError:
        line = getattr(node, "lineno", 0)
        return NativeError(f"{self.function.__name__}, line {line}: {problem}, which native code cannot")

    # Labels

    def _labels(self, *names: str) -> list[str]:
        self._count += 1
        return [f"{name}{self._count}" for name in names]

    def _begin(self, label: str) -> None:
        self._lines.append(f"{label}:")
        self._open, self._at = True, label

    def _jump(self, label: str) -> bool:
        """Jump unless the block has ended already; True if it jumps."""
        jumped = self._open
        if jumped:
            self._emit(f"br label %{label}")
        self._open = False
        return jumped

    def _branch(self, test: str, yes: str, no: str) -> None:
        """Jump to one of two labels."""
        self._emit(f"br i1 {test}, label %{yes}, label %{no}")
        self._open = False

    # Lanes

    def _on(self) -> str:
        """Read the mask of the lanes that are on."""
        return self._new(f"load {self._mask}, ptr %on")

    def _turn(self, mask: str) -> None:
        """Set the lanes that are on."""
        self._emit(f"store {self._mask} {mask}, ptr %on")

    def _any(self, mask: str) -> str:
        return self._new(f"call i1 @llvm.vector.reduce.or.v{self.lanes}i1({self._mask} {mask})")

    def _and(self, a: str, b: str) -> str:
        return self._new(f"and {self._mask} {a}, {b}")

    def _or(self, a: str, b: str) -> str:
        return self._new(f"or {self._mask} {a}, {b}")

    def _without(self, a: str, b: str) -> str:
        return self._and(a, self._new(f"xor {self._mask} {b}, {ALL}"))

    def _mask_slot(self) -> str:
        """Make a slot for a mask, with no lanes."""
        self._count += 1
        self._slots.append(f"  %lanes{self._count} = alloca {self._mask}")
        self._emit(f"store {self._mask} zeroinitializer, ptr %lanes{self._count}")
        return f"%lanes{self._count}"

    def _bits(self) -> str:
        """Return the lanes that are on, as the bits of an integer: all, of one state or of several."""
        if self.lanes == 1:
            return "-1"
        bits = self._new(f"bitcast {self._mask} {self._on()} to i{self.lanes}")
        return self._new(f"zext i{self.lanes} {bits} to i64")

    def _type_in_lanes(self, kind: Kind) -> str:
        """Return the type of a number or a condition in all lanes."""
        return vector_type(str(kind), self.lanes)

    def _wide(self, value: Value) -> Value:
        """Return a number or a condition in all lanes."""
        if self.lanes == 1 or varies(value):
            return value
        kind = str(value.type)
        factors = value.factors and (self._splat(kind, value.factors[0]), self._splat(kind, value.factors[1]))
        return Value(self._type_in_lanes(kind), self._splat(kind, value.operand), factors)

    def _splat(self, kind: str, operand: str) -> str:
        if not operand.startswith("%"):
            return f"splat ({kind} {operand})"
        wide = self._type_in_lanes(kind)
        one = self._new(f"insertelement {wide} poison, {kind} {operand}, i32 0")
        return self._new(f"shufflevector {wide} {one}, {wide} poison, <{self.lanes} x i32> zeroinitializer")

    def _alike(self, value: Value, other: Value) -> Value:
        """Return a value in all lanes if another one is."""
        return self._wide(value) if varies(other) else value

    def _blend(self, value: Value, address: str, volatile: str = "") -> None:
        """Store a value in the lanes that are on; " volatile" as in `newton_euler.codegen.emit`."""
        operand = value.operand
        if self.lanes > 1:
            before = self._new(f"load{volatile} {value.type}, ptr {address}, align 8")
            chosen = f"select {self._mask} {self._on()}, {value.type} {operand}, {value.type} {before}"
            operand = self._new(chosen)
        self._emit(f"store {value.type} {operand}, ptr {address}, align 8")

    # Numbers and variables

    def _float(self, value: Value) -> Value:
        if is_whole(value):
            kind = str(value.type).replace("i64", "double")
            return Value(kind, self._new(f"sitofp {value.type} {value.operand} to {kind}"))
        if "double" not in str(value.type):
            raise NativeError(f"{self.function.__name__}: {value.type} where a number is needed")
        return value

    def _pair(self, a: Value, b: Value) -> tuple[Value, Value]:
        """Return two numbers of one type: doubles unless both are whole."""
        if not (is_whole(a) and is_whole(b)):
            a, b = self._float(a), self._float(b)
        return self._alike(a, b), self._alike(b, a)

    def _store(self, name: str, value: Value, node: ast.expr | None = None) -> None:
        """Give a variable a value; one of a vector is its only one."""
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
        """Store a number in a slot for its type, in the lanes that are on if others may need theirs."""
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
        known = self._variables[name]
        if not self._in_slot(known):
            return known
        return Value(known.type, self._new(f"load {known.type}, ptr {known.operand}, align 8"))

    def _in_slot(self, known: Value) -> bool:
        """Return True for a variable that is a number."""
        return not is_vector(known) and known.type != "fn"


def typed(value: Value) -> str:
    """Return a value with its type, as calls have it."""
    return f"{machine_type(value.type)} {value.operand}"
