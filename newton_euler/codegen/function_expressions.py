"""Translate Python expressions to LLVM text: conditions, numbers, elements of vectors, calls.

The expressions are parts of functions marked `native` (`newton_euler.codegen.native`). Code for several runs
processes one run in each *lane* (element) of the vector registers. A number that is the same in all lanes is
an LLVM scalar; other numbers are vectors with one element per lane. A condition that differs between lanes is
a *mask*, a vector of booleans. A lane is *on* if the present instructions apply to it.

`newton_euler.codegen.function_text` writes instructions, and `newton_euler.codegen.translate` adds
statements. Methods named `_of_...` translate one class of syntax nodes of the module `ast`.
"""

from __future__ import annotations

import ast
from collections.abc import Callable
from enum import EnumType, IntEnum
from typing import Any, NamedTuple

from newton_euler.codegen.function_text import (
    ALL,
    Found,
    FunctionText,
    Value,
    is_vector,
    is_whole,
    typed,
    varies,
)
from newton_euler.codegen.native import Kind, is_native, machine_type, signature_of
from newton_euler.codegen.trigonometry import intrinsic_suffix, literal, vector_type

# LLVM's names of comparisons, instructions and intrinsic functions by Python's syntax node or function. sdiv
# and srem round towards zero, unlike // and % of Python: native functions use them for numbers not below 0
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

FORMS = {"double": "v", "i64": "u", "ptr": "l", "shared": "s"}
"""Letter for the form of an argument by kind of its value. A function is translated once for each combination
of forms.

- v: double, or one double per lane;
- u: integer that is the same in all lanes; w: one integer per lane;
- l: `Vector`, with separate elements for each lane; s: `Shared` vector, the same for all lanes; capital
  letters if the vector begins at another index in each lane;
- r: record or callback.
"""


def form_of(value: Value) -> str:
    """Return the letter for the form of an argument, see `FORMS`."""
    if varies(value):
        return "w" if is_whole(value) else "v"
    form = FORMS.get(str(value.type), "r")
    return form.upper() if value.offset else form


def kind_in(kind: Kind, lanes: int) -> Kind:
    """Return the kind that code for so many lanes uses; for one lane a `Shared` vector is an ordinary one."""
    return "ptr" if kind == "shared" and lanes == 1 else kind


class Call(NamedTuple):
    """A native function with given forms of its arguments, which is translated to one LLVM function.

    Attributes:
        function: the Python function.
        forms: letters for the forms of its arguments, see `FORMS`.
    """

    function: Callable[..., Any]
    forms: str

    @property
    def name(self) -> str:
        """Name of the LLVM function."""
        return f"{self.function.__name__}.{self.forms}"


class Expressions(FunctionText):
    """LLVM text of a function, with methods that translate expressions.

    Attributes:
        tables: LLVM text of the tables (tuples of module level) that the function uses, by name.
        calls: calls of other native functions, which have to be translated too.
    """

    def __init__(self, function: Callable[..., Any], lanes: int, found: Found) -> None:
        """Begin the text of a function.

        Args:
            function: Python function to translate.
            lanes: number of runs at once.
            found: variables and loops known to differ between lanes; the translation adds others.
        """
        super().__init__(function, lanes, found)
        self.tables: dict[str, str] = {}
        self.calls: list[Call] = []
        self._fields: dict[tuple[str, str], Value] = {}  # by names of record and field
        self._field_loads: list[str] = []  # instructions that load fields of records on entry

    # Conditions

    def _condition(self, test: ast.expr) -> Value:
        """Translate a condition: to a boolean (i1), or to the mask of lanes where it holds.

        The second operand of `and` and `or` is evaluated only if it matters in some lane.
        """
        if isinstance(test, ast.BoolOp):
            condition = self._condition(test.values[0])
            for part in test.values[1:]:
                condition = self._joined(test.op, condition, part)
            return condition
        if isinstance(test, ast.UnaryOp) and isinstance(test.op, ast.Not):
            return self._opposite(self._condition(test.operand))
        if isinstance(test, ast.Compare) and len(test.ops) == 1:
            return self._compare(test)
        raise self._error(test, "tests anything but a comparison")

    def _joined(self, op: ast.boolop, first: Value, part: ast.expr) -> Value:
        """Translate `first and part` or `first or part`, where `first` is evaluated already."""
        is_or = isinstance(op, ast.Or)
        undecided = self._opposite(first) if is_or else first
        second = self._where(undecided, lambda: self._condition(part), is_or)
        if not varies(first):
            return second
        second = self._wide(second)
        joined = f"{'or' if is_or else 'and'} {first.type} {first.operand}, {second.operand}"
        return Value(first.type, self._new(joined))

    def _opposite(self, test: Value) -> Value:
        """Return the negation of a condition."""
        everywhere = ALL if varies(test) else "true"
        return Value(test.type, self._new(f"xor {test.type} {test.operand}, {everywhere}"))

    def _where(self, test: Value, make: Callable[[], Value], else_true: bool = False) -> Value:
        """Evaluate a value only in the lanes where a condition holds, and not at all if it holds in none.

        Args:
            test: the condition.
            make: emits the instructions of the value and returns it.
            else_true: the value is true in the other lanes if True, else zero.
        """
        more, after = self._labels("where", "after")
        # skip the evaluation if the condition holds in no lane
        on = chosen_lanes = ""
        if varies(test):
            on = self._on()
            chosen_lanes = self._and(on, test.operand)
        before = self._block_label
        self._branch(self._any(chosen_lanes) if on else test.operand, more, after)
        # evaluate with the chosen lanes on
        self._begin(more)
        if on:
            self._turn(chosen_lanes)
        value = make()
        if on:
            value = self._wide(value)
            self._turn(on)
        end = self._block_label
        self._jump(after)
        # the value, or the other one if the evaluation was skipped
        self._begin(after)
        other = "zeroinitializer"
        if else_true:
            other = ALL if varies(value) else "true"
        phi = f"phi {value.type} [ {other}, %{before} ], [ {value.operand}, %{end} ]"
        return Value(value.type, self._new(phi))

    def _compare(self, test: ast.Compare) -> Value:
        """Translate a comparison of two numbers."""
        a, b = self._pair(self._value(test.left), self._value(test.comparators[0]))
        word, kind = COMPARISONS[type(test.ops[0])], str(a.type)
        if is_whole(a):
            predicate = word if word in ("eq", "ne") else f"s{word}"  # s: signed
            made = f"icmp {predicate} {kind} {a.operand}, {b.operand}"
            return Value(kind.replace("i64", "i1"), self._new(made))
        predicate = "une" if word == "ne" else f"o{word}"  # with NaN, only != is true, as in Python
        made = f"fcmp {predicate} {kind} {a.operand}, {b.operand}"
        return Value(kind.replace("double", "i1"), self._new(made))

    # Numbers

    def _value(self, node: ast.expr) -> Value:
        """Translate an expression, by the method for its syntax node."""
        method = getattr(self, f"_of_{type(node).__name__.lower()}", None)
        if method is None:
            raise self._error(node, f"holds {type(node).__name__}")
        value: Value = method(node)
        return value

    def _of_constant(self, node: ast.Constant) -> Value:
        """Translate a number."""
        return self._number(node, node.value)

    def _number(self, node: ast.expr, value: object) -> Value:
        """Return a constant integer or float as a value; `node` is for the message of an error."""
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise self._error(node, f"holds {value!r}")
        return Value("double", literal(value)) if isinstance(value, float) else Value("i64", str(value))

    def _of_name(self, node: ast.Name) -> Value:
        """Translate the name of a variable, a record, a table or a constant of module level."""
        if node.id in self._variables:
            return self._load(node.id)
        if node.id in self._records:
            return self._records[node.id]
        value = self._global(node)
        if isinstance(value, tuple):
            numbers = ", ".join(f"double {literal(float(x))}" for x in value)
            self.tables[node.id] = f"@{node.id} = private constant [{len(value)} x double] [{numbers}]"
            return Value(kind_in("shared", self.lanes), f"@{node.id}")
        return self._number(node, value)

    def _global(self, node: ast.Name) -> Any:
        """Return the object of a name of module level."""
        try:
            return self.function.__globals__[node.id]
        except KeyError as error:
            raise self._error(node, f"uses {node.id!r} before it has a value") from error

    def _of_attribute(self, node: ast.Attribute) -> Value:
        """Translate a field of a record, loaded on entry of the function, or a member of an `IntEnum`."""
        if not isinstance(node.value, ast.Name):
            raise self._error(node, "holds an attribute of anything but a record or an IntEnum")
        if node.value.id not in self._records:
            return Value("i64", str(int(self._member(node.value, node))))
        record, name = self._records[node.value.id], node.attr
        assert not isinstance(record.type, str)
        if name not in record.type.kinds:
            raise self._error(node, f"uses {name!r}, which {record.type.__name__} has not")
        if (node.value.id, name) not in self._fields:
            # each field of a record takes 8 bytes, in the order of the class
            place, kind = list(record.type.kinds).index(name), record.type.kinds[name]
            operand, machine = f"%{node.value.id}.{name}", machine_type(kind)
            self._field_loads += [
                f"  {operand}.at = getelementptr i64, ptr {record.operand}, i64 {place}",
                f"  {operand} = load {machine}, ptr {operand}.at",
            ]
            self._fields[node.value.id, name] = Value(kind_in(kind, self.lanes), operand)
        return self._fields[node.value.id, name]

    def _member(self, owner: ast.Name, node: ast.Attribute) -> IntEnum:
        """Look up the member of an `IntEnum` of module level."""
        members = None if owner.id in self._variables else self._global(owner)
        if not isinstance(members, EnumType) or not issubclass(members, IntEnum):
            raise self._error(node, "holds an attribute of anything but a record or an IntEnum")
        if node.attr not in members.__members__:
            raise self._error(node, f"uses {node.attr!r}, which {members.__name__} has not")
        return members[node.attr]

    def _of_unaryop(self, node: ast.UnaryOp) -> Value:
        """Translate a negation."""
        value = self._value(node.operand)
        if not isinstance(node.op, ast.USub):
            raise self._error(node, f"holds {type(node.op).__name__}")
        if is_whole(value):
            return Value(value.type, self._new(f"sub {value.type} zeroinitializer, {value.operand}"))
        return Value(value.type, self._new(f"fneg {value.type} {value.operand}"))

    def _of_binop(self, node: ast.BinOp) -> Value:
        """Translate + - * / // % and **."""
        a, b = self._pair(self._value(node.left), self._value(node.right))
        op, t = type(node.op), a.type
        if is_whole(a) and op in INT_OPERATIONS:
            # names of variables begin with %; a variable may be 0 in lanes that are off
            if op in (ast.FloorDiv, ast.Mod) and "%" in b.operand:
                raise self._error(node, "divides whole numbers by what may be 0")
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
        """Translate the sum or difference of a product and a term in one expression to a fused multiply-add.

        The fused operation rounds once on processors that support it. LLVM does not choose which operations
        to fuse, because its choice would depend on the surrounding code.
        """
        # the factors of the product x or y, and the other term; signs of a difference
        (first, second), term = x.factors or y.factors or ("", ""), y.operand if x.factors else x.operand
        if op is ast.Sub and x.factors:
            term = self._new(f"fneg {x.type} {term}")
        elif op is ast.Sub:
            first = self._new(f"fneg {x.type} {first}")
        return self._intrinsic("llvm.fmuladd", [Value(x.type, each) for each in (first, second, term)])

    def _intrinsic(self, name: str, given: list[Value]) -> Value:
        """Call one of LLVM's intrinsic functions with doubles, all scalars or all vectors."""
        kind, lanes = given[0].type, self.lanes if varies(given[0]) else 1
        arguments = ", ".join(map(typed, given))
        return Value(kind, self._new(f"call {kind} @{name}.{intrinsic_suffix(lanes)}({arguments})"))

    def _of_ifexp(self, node: ast.IfExp) -> Value:
        """Translate `a if test else b`; each side is evaluated only in the lanes that need it."""
        test = self._condition(node.test)
        yes = self._where(test, lambda: self._value(node.body))
        no = self._where(self._opposite(test), lambda: self._value(node.orelse))
        if varies(test) or not is_vector(yes):
            yes, no = self._pair(self._alike(yes, test), self._alike(no, test))
        if yes.type != no.type or yes.type == "shared":
            raise self._error(node, f"chooses between {yes.type} and {no.type}")
        made = f"select {test.type} {test.operand}, {typed(yes)}, {typed(no)}"
        return Value(yes.type, self._new(made))

    # Vectors

    def _of_subscript(self, node: ast.Subscript) -> Value:
        """Translate an element `a[k]` or a tail `a[k:]` of a vector."""
        vector, index = self._place(node)
        if isinstance(node.slice, ast.Slice):
            if varies(index):
                return vector._replace(offset=self._sum(vector.offset, index.operand))
            return vector._replace(operand=self._address(vector, index))
        if self._is_scattered(vector, index):
            addresses, on = self._addresses(vector, index), self._on()
            given = f"{self._pointers} {addresses}, i32 8, {self._mask} {on}, {self._doubles} zeroinitializer"
            gather = f"call {self._doubles} {self._masked_intrinsic('gather')}({given})"
            return Value(self._doubles, self._new(gather))
        kind = self._element_type(vector)
        return Value(kind, self._new(f"load {kind}, ptr {self._address(vector, index)}, align 8"))

    def _assign_element(self, target: ast.Subscript, value: Value) -> None:
        """Translate the assignment of an element of a vector, in the lanes that are on."""
        vector, index = self._place(target)
        value = self._wide(self._float(value))
        if self._is_scattered(vector, index):
            addresses, on = self._addresses(vector, index), self._on()
            given = f"{typed(value)}, {self._pointers} {addresses}, i32 8, {self._mask} {on}"
            self._emit(f"call void {self._masked_intrinsic('scatter')}({given})")
        elif vector.type == "shared":
            raise self._error(target, "writes one element of a shared vector from several lanes")
        else:
            # volatile keeps LLVM from a masked store, which is slower
            self._blend(value, self._address(vector, index), " volatile")

    def _place(self, node: ast.Subscript) -> tuple[Value, Value]:
        """Return the vector of `a[k]` or `a[k:]`, and the index k."""
        place = node.slice
        if isinstance(place, ast.Slice):
            if place.upper is not None or place.step is not None or place.lower is None:
                raise self._error(node, "holds a slice other than a[k:]")
            place = place.lower
        vector, index = self._value(node.value), self._value(place)
        if not is_vector(vector) or not is_whole(index):
            raise self._error(node, f"indexes {vector.type} with {index.type}")
        return vector, index

    def _is_scattered(self, vector: Value, index: Value) -> bool:
        """Return True if an element is at another index of the whole vector in each lane."""
        return bool(vector.offset) or varies(index)

    def _element_type(self, vector: Value) -> str:
        """Return the LLVM type of an element: a double if lanes share it, else one double per lane."""
        return "double" if vector.type == "shared" else self._doubles

    def _address(self, vector: Value, index: Value) -> str:
        """Return the address of an element with the same index in all lanes."""
        kind = self._element_type(vector)
        return self._new(f"getelementptr {kind}, ptr {vector.operand}, i64 {index.operand}")

    def _addresses(self, vector: Value, index: Value) -> str:
        """Return the vector of addresses of an element whose index differs between lanes."""
        place = self._sum(vector.offset, self._wide(index).operand)
        if vector.type == "ptr":  # element i of a lane is at index `lanes` i + lane
            numbers = ", ".join(f"i64 {lane}" for lane in range(self.lanes))
            place = self._new(f"mul {self._wholes} {place}, splat (i64 {self.lanes})")
            place = self._new(f"add {self._wholes} {place}, <{numbers}>")
        return self._new(f"getelementptr double, ptr {vector.operand}, {self._wholes} {place}")

    def _sum(self, offset: str, index: str) -> str:
        """Return the sum of an index and the offset of a vector, which is empty if there is none."""
        return self._new(f"add {self._wholes} {offset}, {index}") if offset else index

    @property
    def _pointers(self) -> str:
        """LLVM type of one address per lane."""
        return vector_type("ptr", self.lanes)

    def _masked_intrinsic(self, operation: str) -> str:
        """Return the name of LLVM's intrinsic function for a masked "gather" or "scatter" of doubles."""
        return f"@llvm.masked.{operation}.{intrinsic_suffix(self.lanes)}.v{self.lanes}p0"

    # Calls

    def _of_call(self, node: ast.Call) -> Value:
        """Translate a call of a callback, a conversion, an intrinsic function or a native function."""
        if not isinstance(node.func, ast.Name | ast.Attribute) or node.keywords:
            raise self._error(node, "calls anything but a function by its name")
        arguments = [self._value(argument) for argument in node.args]
        if isinstance(node.func, ast.Attribute) or node.func.id in self._variables:
            callback, (x, y) = self._value(node.func), arguments
            if x.offset or y.offset:
                raise self._error(node, "calls a callback with vectors that begin elsewhere in each lane")
            lanes_on = self._bits()  # an integer, bit i for lane i
            self._emit(f"call void {callback.operand}({typed(x)}, {typed(y)}, i64 {lanes_on})")
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

    def _call(self, node: ast.Call, function: Callable[..., Any], arguments: list[Value]) -> Value:
        """Translate the call of a native function, and add the call to `calls`.

        Args:
            node: syntax node of the call, for messages.
            function: the Python function that is called.
            arguments: its arguments.
        """
        signature, forms = signature_of(function), ""
        given = [f"{self._mask} {self._on()}"] if self.lanes > 1 else []
        for argument, kind in zip(arguments, signature.arguments.values(), strict=True):
            value = self._wide(self._float(argument)) if kind == "double" else argument
            # whether the value fits the annotation, by kind; records and callbacks need the same kind
            fits = {"double": True, "i64": is_whole(value), "ptr": is_vector(value)}
            if not fits.get(str(kind_in(kind, 1)), value.type == kind):
                raise self._error(node, f"passes {value.type} for {kind}")
            forms += form_of(value)
            given.append(typed(value))
            if value.offset:
                given.append(f"{self._wholes} {value.offset}")
        call = Call(function, forms)
        self.calls.append(call)
        result = signature.result
        if result == "void":
            self._emit(f"call void @{call.name}({', '.join(given)})")
            return Value("void", "")
        result = self._type_in_lanes(result)
        return Value(result, self._new(f"call {result} @{call.name}({', '.join(given)})"))
