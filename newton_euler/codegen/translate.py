"""Translation of native functions to LLVM text; what native code cannot do is refused with its line."""

from __future__ import annotations

import ast
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

from newton_euler.codegen.function_text import FunctionText, Value, is_whole
from newton_euler.codegen.native import Kind, is_native, machine_type, signature_of
from newton_euler.codegen.trigonometry import literal

COMPARISONS = {ast.Lt: "lt", ast.LtE: "le", ast.Gt: "gt", ast.GtE: "ge", ast.Eq: "eq", ast.NotEq: "ne"}
FLOAT_OPERATIONS = {ast.Add: "fadd", ast.Sub: "fsub", ast.Mult: "fmul", ast.Div: "fdiv"}
INT_OPERATIONS = {
    ast.Add: "add",
    ast.Sub: "sub",
    ast.Mult: "mul",
    ast.FloorDiv: "sdiv",
    ast.Mod: "srem",
}
INTRINSICS = {
    "abs": "llvm.fabs",
    "sqrt": "llvm.sqrt",
    "min": "llvm.minnum",
    "max": "llvm.maxnum",
}


class Translator(FunctionText):
    """Translation of one function.

    Attributes:
        tables: LLVM text of the tables that it uses, by name.
        callees: native functions that it calls.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        self.signature = signature_of(function)
        self.tables: dict[str, str] = {}
        self.callees: list[Callable[..., Any]] = []
        self._fields: dict[tuple[str, str], Value] = {}
        self._entry: list[str] = []
        self._loops: list[tuple[str, str]] = []

    def translate(self, linkage: str = "") -> str:
        """Translate the whole function."""
        definition = definition_of(self.function)
        arguments = []
        for name, kind in self.signature.arguments.items():
            arguments.append(f"{machine_type(kind)} %{name}.in")
            if isinstance(kind, str):
                self._store(name, Value(_scalar(kind), f"%{name}.in"))
            else:
                self._records[name] = Value(kind, f"%{name}.in")
        self._block(definition.body)
        if self._open:
            if self.signature.result != "void":
                raise self._error(definition, "ends without a return")
            self._emit("ret void")
        result, name = machine_type(self.signature.result), self.function.__name__
        head = f"define {linkage}{result} @{name}({', '.join(arguments)}) {{"
        return "\n".join([head, "entry:", *self._slots, *self._entry, *self._lines, "}"])

    # Statements

    def _block(self, statements: list[ast.stmt]) -> None:
        for statement in statements:
            if not self._open:
                raise self._error(statement, "is never reached")
            method = getattr(self, f"_on_{type(statement).__name__.lower()}", None)
            if method is None:
                raise self._error(statement, f"holds {type(statement).__name__}")
            method(statement)

    def _on_expr(self, statement: ast.Expr) -> None:
        if not isinstance(statement.value, ast.Constant):  # a docstring
            self._value(statement.value)

    def _on_assign(self, statement: ast.Assign) -> None:
        if len(statement.targets) != 1:
            raise self._error(statement, "assigns to several targets")
        self._assign(statement.targets[0], self._value(statement.value))

    def _on_augassign(self, statement: ast.AugAssign) -> None:
        target = statement.target
        before = ast.copy_location(ast.BinOp(_loaded(target), statement.op, statement.value), statement)
        self._assign(target, self._value(before))

    def _assign(self, target: ast.expr, value: Value) -> None:
        if isinstance(target, ast.Name):
            self._store(target.id, value, target)
        elif isinstance(target, ast.Subscript):
            self._emit(f"store double {self._float(value).operand}, ptr {self._element(target)}")
        else:
            raise self._error(target, f"assigns to {type(target).__name__}")

    def _on_if(self, statement: ast.If) -> None:
        yes, no, after = self._labels("if", "else", "endif")
        self._branch(statement.test, yes, no)
        self._sides(statement, yes, no, after)

    def _sides(self, statement: ast.If, yes: str, no: str, after: str) -> None:
        """Emit both sides of an `if` at their labels, and go on behind them if either ends."""
        self._begin(yes)
        self._block(statement.body)
        reached = self._jump(after)
        self._begin(no)
        self._block(statement.orelse)
        reached = self._jump(after) or reached
        if reached:
            self._begin(after)

    def _on_while(self, statement: ast.While) -> None:
        test, body, after = self._labels("while", "do", "done")
        self._jump(test)
        self._begin(test)
        self._branch(statement.test, body, after)
        self._begin(body)
        self._loops.append((test, after))
        self._block(statement.body)
        self._loops.pop()
        self._jump(test)
        self._begin(after)

    def _on_for(self, statement: ast.For) -> None:
        name, start, stop = self._range(statement)
        self._store(name, start)
        test, body, step, after = self._labels("for", "do", "next", "done")
        self._jump(test)
        self._begin(test)
        more = self._new(f"icmp slt i64 {self._load(name).operand}, {stop.operand}")
        self._emit(f"br i1 {more}, label %{body}, label %{after}")
        self._begin(body)
        self._loops.append((step, after))
        self._block(statement.body)
        self._loops.pop()
        self._jump(step)
        self._begin(step)
        self._store(name, Value("i64", self._new(f"add i64 {self._load(name).operand}, 1")))
        self._jump(test)
        self._begin(after)

    def _range(self, statement: ast.For) -> tuple[str, Value, Value]:
        """Return the variable of a loop and its bounds."""
        call = statement.iter
        if not (
            isinstance(statement.target, ast.Name)
            and isinstance(call, ast.Call)
            and isinstance(call.func, ast.Name)
            and call.func.id == "range"
            and len(call.args) <= 2
        ):
            raise self._error(statement, "loops over anything but range(stop) or range(start, stop)")
        bounds = [self._value(argument) for argument in call.args]
        return statement.target.id, bounds[0] if len(bounds) == 2 else Value("i64", "0"), bounds[-1]

    def _on_break(self, statement: ast.Break) -> None:
        self._jump(self._loops[-1][1])

    def _on_continue(self, statement: ast.Continue) -> None:
        self._jump(self._loops[-1][0])

    def _on_return(self, statement: ast.Return) -> None:
        kind = self.signature.result
        if statement.value is None:
            self._emit("ret void")
        else:
            value = self._value(statement.value)
            value = self._float(value) if kind == "double" else value
            if value.type != kind:
                raise self._error(statement, f"returns {value.type}, not {kind}")
            self._emit(f"ret {kind} {value.operand}")
        self._open = False

    # Conditions

    def _branch(self, test: ast.expr, yes: str, no: str) -> None:
        """Jump to one of two labels; `and` and `or` look no further than they must."""
        if isinstance(test, ast.BoolOp):
            for part in test.values[:-1]:
                (further,) = self._labels("test")
                if isinstance(test.op, ast.And):
                    self._branch(part, further, no)
                else:
                    self._branch(part, yes, further)
                self._begin(further)
            self._branch(test.values[-1], yes, no)
        elif isinstance(test, ast.UnaryOp) and isinstance(test.op, ast.Not):
            self._branch(test.operand, no, yes)
        elif isinstance(test, ast.Compare) and len(test.ops) == 1:
            self._emit(f"br i1 {self._compare(test).operand}, label %{yes}, label %{no}")
            self._open = False
        else:
            raise self._error(test, "tests anything but a comparison")

    def _compare(self, test: ast.Compare) -> Value:
        a, b = self._pair(self._value(test.left), self._value(test.comparators[0]))
        word, kind = COMPARISONS[type(test.ops[0])], str(a.type)
        if is_whole(a):
            found = f"icmp {word if word in ('eq', 'ne') else f's{word}'} {kind} {a.operand}, {b.operand}"
            return Value(kind.replace("i64", "i1"), self._new(found))
        found = f"fcmp {'une' if word == 'ne' else f'o{word}'} {kind} {a.operand}, {b.operand}"
        return Value(kind.replace("double", "i1"), self._new(found))

    # Expressions

    def _value(self, node: ast.expr) -> Value:
        method = getattr(self, f"_of_{type(node).__name__.lower()}", None)
        if method is None:
            raise self._error(node, f"holds {type(node).__name__}")
        value: Value = method(node)
        return value

    def _of_constant(self, node: ast.Constant) -> Value:
        return self._number(node, node.value)

    def _number(self, node: ast.expr, value: object) -> Value:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self._error(node, f"holds {value!r}")
        return Value("double", literal(value)) if isinstance(value, float) else Value("i64", str(value))

    def _of_name(self, node: ast.Name) -> Value:
        if node.id in self._variables:
            return self._load(node.id)
        if node.id in self._records:
            return self._records[node.id]
        value = self._global(node)
        if isinstance(value, tuple):
            numbers = ", ".join(f"double {literal(float(x))}" for x in value)
            self.tables[node.id] = f"@{node.id} = private constant [{len(value)} x double] [{numbers}]"
            return Value("ptr", f"@{node.id}")
        return self._number(node, value)

    def _global(self, node: ast.Name) -> Any:
        try:
            return self.function.__globals__[node.id]
        except KeyError as error:
            raise self._error(node, f"uses {node.id!r} before it has a value") from error

    def _of_attribute(self, node: ast.Attribute) -> Value:
        """Read a field of a record, from where it was put on entry."""
        if not isinstance(node.value, ast.Name) or node.value.id not in self._records:
            raise self._error(node, "holds an attribute of anything but a record")
        record, name = self._records[node.value.id], node.attr
        assert not isinstance(record.type, str)
        if name not in record.type.kinds:
            raise self._error(node, f"uses {name!r}, which {record.type.__name__} has not")
        if (node.value.id, name) not in self._fields:
            place, kind = list(record.type.kinds).index(name), record.type.kinds[name]
            word, machine = f"%{node.value.id}.{name}", machine_type(kind)
            self._entry += [
                f"  {word}.at = getelementptr i64, ptr {record.operand}, i64 {place}",
                f"  {word} = load {machine}, ptr {word}.at",
            ]
            self._fields[node.value.id, name] = Value(self._of_field(kind), word)
        return self._fields[node.value.id, name]

    def _of_field(self, kind: Kind) -> Kind:
        """Return the type of a field of a kind."""
        return _scalar(kind)

    def _of_unaryop(self, node: ast.UnaryOp) -> Value:
        value = self._value(node.operand)
        if not isinstance(node.op, ast.USub):
            raise self._error(node, f"holds {type(node.op).__name__}")
        if is_whole(value):
            zero = self._alike(Value("i64", "0"), value)
            return Value(value.type, self._new(f"sub {value.type} {zero.operand}, {value.operand}"))
        return Value(value.type, self._new(f"fneg {value.type} {value.operand}"))

    def _of_binop(self, node: ast.BinOp) -> Value:
        a, b = self._pair(self._value(node.left), self._value(node.right))
        op, t = type(node.op), a.type
        if is_whole(a) and op in INT_OPERATIONS:
            return Value(t, self._new(f"{INT_OPERATIONS[op]} {t} {a.operand}, {b.operand}"))
        x, y = self._float(a), self._float(b)
        if op is ast.Pow:
            return self._intrinsic("llvm.pow", [x, y])
        if op not in FLOAT_OPERATIONS:
            raise self._error(node, f"holds {op.__name__}")
        if op in (ast.Add, ast.Sub) and (x.factors or y.factors):
            return self._product_and_sum(op, x, y)
        factors = (x.operand, y.operand) if op is ast.Mult else None
        made = self._new(f"{FLOAT_OPERATIONS[op]} {x.type} {x.operand}, {y.operand}")
        return Value(x.type, made, factors)

    def _product_and_sum(self, op: type[ast.operator], x: Value, y: Value) -> Value:
        """Add or subtract a product of the same expression, rounded once on processors that can.

        LLVM, left to contract, would do so wherever it finds both in one block.
        """
        (first, second), term = x.factors or y.factors or ("", ""), y.operand if x.factors else x.operand
        if op is ast.Sub and x.factors:
            term = self._new(f"fneg {x.type} {term}")
        elif op is ast.Sub:
            first = self._new(f"fneg {x.type} {first}")
        return self._intrinsic("llvm.fmuladd", [Value(x.type, each) for each in (first, second, term)])

    def _intrinsic(self, name: str, given: list[Value]) -> Value:
        """Call one of LLVM's functions of doubles, all of one type."""
        kind = given[0].type
        arguments = ", ".join(f"{kind} {value.operand}" for value in given)
        suffix = str(kind).strip("<>").replace("double", "f64").replace(" x ", "")
        vector = "" if suffix == "f64" else "v"
        return Value(kind, self._new(f"call {kind} @{name}.{vector}{suffix}({arguments})"))

    def _pair(self, a: Value, b: Value) -> tuple[Value, Value]:
        """Return two numbers of one type: doubles unless both are whole."""
        return (a, b) if is_whole(a) and is_whole(b) else (self._float(a), self._float(b))

    def _alike(self, value: Value, other: Value) -> Value:
        """Return a value in as many lanes as another one."""
        return value

    def _of_ifexp(self, node: ast.IfExp) -> Value:
        yes, no, after = self._labels("if", "else", "endif")
        name = f"choice{self._count}"
        self._branch(node.test, yes, no)
        for label, part in ((yes, node.body), (no, node.orelse)):
            self._begin(label)
            self._store(name, self._value(part), part)
            self._jump(after)
        self._begin(after)
        return self._load(name)

    def _of_subscript(self, node: ast.Subscript) -> Value:
        if isinstance(node.slice, ast.Slice):
            return Value("ptr", self._element(node))
        return Value("double", self._new(f"load double, ptr {self._element(node)}"))

    def _element(self, node: ast.Subscript) -> str:
        """Compute the address of a[k], which is also the vector a[k:]."""
        vector, index = self._value(node.value), self._value(self._first(node))
        if vector.type != "ptr" or index.type != "i64":
            raise self._error(node, f"indexes {vector.type} with {index.type}")
        return self._new(f"getelementptr double, ptr {vector.operand}, i64 {index.operand}")

    def _first(self, node: ast.Subscript) -> ast.expr:
        """Return the expression of k in a[k] and a[k:]."""
        place = node.slice
        if not isinstance(place, ast.Slice):
            return place
        if place.upper is not None or place.step is not None or place.lower is None:
            raise self._error(node, "holds a slice other than a[k:]")
        return place.lower

    def _of_call(self, node: ast.Call) -> Value:
        if not isinstance(node.func, ast.Name | ast.Attribute) or node.keywords:
            raise self._error(node, "calls anything but a function by its name")
        arguments = [self._value(argument) for argument in node.args]
        if isinstance(node.func, ast.Attribute) or node.func.id in self._variables:
            callback, (x, y) = self._value(node.func), arguments
            if x.offset or y.offset:
                raise self._error(node, "calls a callback with vectors that begin elsewhere in each lane")
            self._emit(f"call void {callback.operand}(ptr {x.operand}, ptr {y.operand}, i64 {self._bits()})")
            return Value("void", "")
        name = node.func.id
        if name == "float":
            return self._float(arguments[0])
        if name == "int":
            kind = str(arguments[0].type)
            whole = kind.replace("double", "i64")
            return Value(whole, self._new(f"fptosi {kind} {arguments[0].operand} to {whole}"))
        if name in INTRINSICS:
            given = [self._float(argument) for argument in arguments]
            return self._intrinsic(INTRINSICS[name], [*self._pair(*given)] if len(given) == 2 else given)
        function = self._global(node.func)
        if not is_native(function):
            raise self._error(node, f"calls {name}, which is not native")
        return self._call(node, function, arguments)

    def _bits(self) -> str:
        """Return the lanes that are on, as the bits of an integer: all, of one state or of several."""
        return "-1"

    def _call(self, node: ast.Call, function: Callable[..., Any], arguments: list[Value]) -> Value:
        self.callees.append(function)
        signature = signature_of(function)
        given = []
        for argument, kind in zip(arguments, signature.arguments.values(), strict=True):
            converted = self._float(argument) if kind == "double" else argument
            if converted.type != _scalar(kind):
                raise self._error(node, f"passes {converted.type} for {kind}")
            given.append(f"{machine_type(kind)} {converted.operand}")
        call = f"call {signature.result} @{function.__name__}({', '.join(given)})"
        if signature.result == "void":
            self._emit(call)
            return Value("void", "")
        return Value(signature.result, self._new(call))


def _scalar(kind: Kind) -> Kind:
    """Return the kind that scalar code takes for another: it makes no difference between vectors."""
    return "ptr" if kind == "shared" else kind


def definition_of(function: Callable[..., Any]) -> ast.FunctionDef:
    """Parse the definition of a function."""
    return _definitions(function.__code__.co_filename)[function.__name__]


@lru_cache
def _definitions(file: str) -> dict[str, ast.FunctionDef]:
    """Parse the functions that a file defines, by name."""
    body = ast.parse(Path(file).read_text(encoding="utf-8")).body
    return {node.name: node for node in body if isinstance(node, ast.FunctionDef)}


def _loaded(target: ast.expr) -> ast.expr:
    """Return the target of an assignment as an expression to read."""
    copy = ast.parse(ast.unparse(target), mode="eval").body
    return ast.copy_location(copy, target)
