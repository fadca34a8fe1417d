"""Text of a function in LLVM's language while it is written: values, variables, instructions and labels."""

from __future__ import annotations

import ast
from collections.abc import Callable
from typing import Any, NamedTuple

from newton_euler.codegen.native import Kind, NativeError, machine_type


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
    """Return True for an integer, or several."""
    return "i64" in str(value.type)


class FunctionText:
    """Instructions of a function. Variables live in memory; LLVM moves them to registers.

    Attributes:
        function: in Python, for messages.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        self.function = function
        self._lines: list[str] = []
        self._slots: list[str] = []
        self._records: dict[str, Value] = {}
        self._variables: dict[str, Value] = {}
        self._count = 0
        self._open = True

    def _store(self, name: str, value: Value, node: ast.expr | None = None) -> None:
        known = self._variables.get(name)
        if name in self._records:
            raise self._error(node, f"assigns to {name!r}, which is a record")
        if known is None:
            known = self._variables[name] = Value(value.type, f"%{name}.slot")
            self._slots.append(f"  {known.operand} = alloca {machine_type(value.type)}")
        if known.type == "double":
            value = self._float(value)
        if known.type != value.type:
            raise self._error(node, f"assigns {value.type} to {name!r}, which is {known.type}")
        self._emit(f"store {machine_type(value.type)} {value.operand}, ptr {known.operand}")

    def _load(self, name: str) -> Value:
        slot = self._variables[name]
        return Value(slot.type, self._new(f"load {machine_type(slot.type)}, ptr {slot.operand}"))

    def _new(self, instruction: str) -> str:
        self._count += 1
        self._emit(f"%t{self._count} = {instruction}")
        return f"%t{self._count}"

    def _emit(self, instruction: str) -> None:
        self._lines.append(f"  {instruction}")

    def _labels(self, *names: str) -> list[str]:
        self._count += 1
        return [f"{name}{self._count}" for name in names]

    def _begin(self, label: str) -> None:
        self._lines.append(f"{label}:")
        self._open = True

    def _jump(self, label: str) -> bool:
        """Jump unless the block has ended already; True if it jumps."""
        jumped = self._open
        if jumped:
            self._emit(f"br label %{label}")
        self._open = False
        return jumped

    def _float(self, value: Value) -> Value:
        if is_whole(value):
            kind = str(value.type).replace("i64", "double")
            return Value(kind, self._new(f"sitofp {value.type} {value.operand} to {kind}"))
        if "double" not in str(value.type):
            raise NativeError(f"{self.function.__name__}: {value.type} where a number is needed")
        return value

    def _error(self, node: ast.AST | None, problem: str) -> NativeError:
        line = getattr(node, "lineno", 0)
        return NativeError(f"{self.function.__name__}, line {line}: {problem}, which native code cannot")
