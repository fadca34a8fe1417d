"""Translation of native functions for several runs side by side, one in each lane of a vector register.

The same Python as `newton_euler.codegen.translate` takes, read as a program for each lane (single program,
multiple data). Numbers that are the same in all lanes stay scalars; others are vectors, and so are conditions
on them, whose lanes are a mask:

- `if` runs both sides, each in the lanes that want it, and none that no lane wants;
- loops run until no lane is left in them;
- `break`, `continue` and `return` turn lanes off until the end of the loop, of the round or of the function;
- stores change the lanes that are on.

A `Vector` holds the elements of all lanes side by side: element i of lane l at `LANES` i + l. Tables and
`Shared` vectors have each element once; lanes may read and write them at places of their own. A lane computes
what scalar code does, to the last bit.
"""

from __future__ import annotations

import ast
from collections.abc import Callable
from typing import Any, NamedTuple

from newton_euler.codegen.compile import lane_count
from newton_euler.codegen.function_text import Value, is_whole
from newton_euler.codegen.native import Kind, NativeError, machine_type, signature_of
from newton_euler.codegen.translate import Translator, definition_of
from newton_euler.codegen.trigonometry import vector_type

LANES = lane_count()

DOUBLES, WHOLES, MASK, POINTERS = (vector_type(each, LANES) for each in ("double", "i64", "i1", "ptr"))

ALL = "splat (i1 true)"

LANE_NUMBERS = "<" + ", ".join(f"i64 {lane}" for lane in range(LANES)) + ">"

DECLARATIONS = "\n".join(
    f"declare {DOUBLES} @{name}.v{LANES}f64({', '.join([DOUBLES] * count)})"
    for name, count in (
        ("llvm.fabs", 1),
        ("llvm.sqrt", 1),
        ("llvm.minnum", 2),
        ("llvm.maxnum", 2),
        ("llvm.pow", 2),
        ("llvm.fmuladd", 3),
    )
) + (
    f"\ndeclare i1 @llvm.vector.reduce.or.v{LANES}i1({MASK})"
    f"\ndeclare {DOUBLES} @llvm.masked.gather.v{LANES}f64.v{LANES}p0({POINTERS}, i32, {MASK}, {DOUBLES})"
    f"\ndeclare void @llvm.masked.scatter.v{LANES}f64.v{LANES}p0({DOUBLES}, {POINTERS}, i32, {MASK})"
)

FORMS: dict[Kind, str] = {DOUBLES: "v", WHOLES: "w", "i64": "u", "ptr": "l", "shared": "s"}
"""Forms of arguments, by type: doubles, whole numbers that vary or are the same in all lanes, vectors by
lanes or shared, as capital letters if they begin elsewhere in each lane. Others, r, are addresses of records
and callbacks."""

TYPES = {form: kind for kind, form in FORMS.items()}

ENTRY_FORMS: dict[Kind, str] = {"i64": "u", "ptr": "l", "shared": "s"}


ZEROS: dict[Kind, str] = {"double": "0.0", "i64": "0", "i1": "false", "ptr": "null"}
"""Operands, by type; of vectors all are zero."""


class Call(NamedTuple):
    """A native function and the forms of its arguments."""

    function: Callable[..., Any]
    forms: str

    @property
    def name(self) -> str:
        return f"{self.function.__name__}.{self.forms}"


class Found(NamedTuple):
    """Findings of a translation so far, which the next one begins with.

    Attributes:
        varying: names of variables that differ between lanes.
        divergent: lines of loops that some lanes may leave or cut short before others.
    """

    varying: set[str]
    divergent: set[int]


class Loop(NamedTuple):
    """Slots of the lanes that have left a loop, and of those that wait for its next round; the line."""

    left: str
    waiting: str
    line: int


class LaneTranslator(Translator):
    """Translation of one function for all lanes, given the forms of its arguments."""

    def __init__(self, call: Call, found: Found) -> None:
        super().__init__(call.function)
        self._call_made, self._found = call, found
        self.calls: list[Call] = []
        self._exits: list[str] = []
        self._lane_loops: list[Loop] = []
        self._divergence = self._turned_off = self._returned = 0
        self._at = "entry"
        self._before = len(found.varying) + len(found.divergent)

    def translated(self) -> tuple[str, bool]:
        """Translate the function: its text, and True if that says all that was found."""
        definition = definition_of(self.function)
        arguments = [f"{MASK} %on.in"]
        self._slots.append(f"  %on = alloca {MASK}")
        self._emit(f"store {MASK} %on.in, ptr %on")
        for (name, kind), form in zip(self.signature.arguments.items(), self._call_made.forms, strict=True):
            if form == "r":
                arguments.append(f"ptr %{name}.in")
                (self._records if not isinstance(kind, str) else self._variables)[name] = Value(
                    kind, f"%{name}.in"
                )
            elif form in "uvw":
                arguments.append(f"{TYPES[form]} %{name}.in")
                self._store(name, Value(TYPES[form], f"%{name}.in"))
            else:
                arguments.append(f"ptr %{name}.in")
                offset = f"%{name}.offset" if form.isupper() else ""
                if offset:
                    arguments.append(f"{WHOLES} {offset}")
                self._variables[name] = Value(TYPES[form.lower()], f"%{name}.in", offset=offset)
        result = self.signature.result
        if result != "void":
            self._slots.append(f"  %result = alloca {_wide(result)}")
        (end,) = self._labels("end")
        self._exits.append(end)
        self._block(definition.body)
        self._jump(end)
        self._begin(end)
        if result == "void":
            self._emit("ret void")
        else:
            self._emit(f"ret {_wide(result)} {self._new(f'load {_wide(result)}, ptr %result')}")
        kind = "void" if result == "void" else _wide(result)
        head = f"define internal {kind} @{self._call_made.name}({', '.join(arguments)}) {{"
        text = "\n".join([head, "entry:", *self._slots, *self._entry, *self._lines, "}"])
        return text, len(self._found.varying) + len(self._found.divergent) == self._before

    # Masks

    def _on(self) -> str:
        return self._new(f"load {MASK}, ptr %on")

    def _any(self, mask: str) -> str:
        return self._new(f"call i1 @llvm.vector.reduce.or.v{LANES}i1({MASK} {mask})")

    def _and(self, a: str, b: str) -> str:
        return self._new(f"and {MASK} {a}, {b}")

    def _or(self, a: str, b: str) -> str:
        return self._new(f"or {MASK} {a}, {b}")

    def _without(self, a: str, b: str) -> str:
        return self._and(a, self._new(f"xor {MASK} {b}, {ALL}"))

    def _turn(self, mask: str) -> None:
        """Set the lanes that are on."""
        self._emit(f"store {MASK} {mask}, ptr %on")

    def _mask_slot(self) -> str:
        """Make a slot for a mask, with no lanes."""
        self._count += 1
        self._slots.append(f"  %lanes{self._count} = alloca {MASK}")
        self._emit(f"store {MASK} zeroinitializer, ptr %lanes{self._count}")
        return f"%lanes{self._count}"

    def _bits(self) -> str:
        bits = self._new(f"bitcast {MASK} {self._on()} to i{LANES}")
        return self._new(f"zext i{LANES} {bits} to i64")

    def _leave(self) -> None:
        """Turn all lanes off, and go where they may be on again."""
        self._turn("zeroinitializer")
        self._jump(self._exits[-1])
        self._turned_off += 1

    def _go_on_if_any(self) -> None:
        """Go on if some lane is on."""
        (further,) = self._labels("further")
        self._emit(f"br i1 {self._any(self._on())}, label %{further}, label %{self._exits[-1]}")
        self._begin(further)

    # Statements

    def _on_if(self, statement: ast.If) -> None:
        test, before = self._condition(statement.test), self._turned_off
        if test.type == "i1":
            self._uniform_if(test, statement)
        else:
            self._varying_if(test, statement)
        if self._open and self._turned_off > before:
            self._go_on_if_any()

    def _uniform_if(self, test: Value, statement: ast.If) -> None:
        yes, no, after = self._labels("if", "else", "endif")
        self._emit(f"br i1 {test.operand}, label %{yes}, label %{no}")
        self._sides(statement, yes, no, after)

    def _varying_if(self, test: Value, statement: ast.If) -> None:
        yes, between, no, after = self._labels("if", "between", "else", "endif")
        on = self._on()
        chosen, others = self._and(on, test.operand), self._without(on, test.operand)
        self._divergence += 1
        self._some_lanes(chosen, yes, between, statement.body)
        left = self._on()
        if statement.orelse:
            self._some_lanes(others, no, after, statement.orelse)
            others = self._on()
        self._turn(self._or(left, others))
        self._divergence -= 1

    def _some_lanes(self, mask: str, label: str, after: str, body: list[ast.stmt]) -> None:
        """Run statements in these lanes, unless there are none; those still on at their end stay on."""
        self._turn(mask)
        self._emit(f"br i1 {self._any(mask)}, label %{label}, label %{after}")
        self._begin(label)
        self._exits.append(after)
        self._block(body)
        self._exits.pop()
        self._jump(after)
        self._begin(after)

    def _on_while(self, statement: ast.While) -> None:
        def test(body: str, done: str) -> None:
            self._leave_unless(self._condition(statement.test), body, done)

        self._loop(statement, test, lambda: None)

    def _on_for(self, statement: ast.For) -> None:
        name, start, stop = self._range(statement)
        uniform = start.type == stop.type == "i64"
        if not uniform:
            self._found.varying.add(name)
        self._set(name, start if uniform else self._wide(start))
        counter = self._variables[name]

        def test(body: str, done: str) -> None:
            number, last = self._pair(self._load(name), stop)
            more = self._new(f"icmp slt {number.type} {number.operand}, {last.operand}")
            self._leave_unless(Value("i1" if uniform else MASK, more), body, done)

        def step() -> None:
            one = self._alike(Value("i64", "1"), counter)
            number = self._new(f"add {counter.type} {self._load(name).operand}, {one.operand}")
            self._emit(f"store {counter.type} {number}, ptr {counter.operand}")

        self._loop(statement, test, step)
        if statement.lineno in self._found.divergent and uniform:
            del self._variables[name]  # in each lane it would be another

    def _leave_unless(self, test: Value, body: str, done: str) -> None:
        """Begin a round in the lanes where the test holds; in the others the loop is over."""
        if test.type == "i1":
            self._emit(f"br i1 {test.operand}, label %{body}, label %{done}")
            return
        loop = self._lane_loops[-1]
        on = self._on()
        self._add(loop.left, self._without(on, test.operand))
        further = self._and(on, test.operand)
        self._turn(further)
        self._emit(f"br i1 {self._any(further)}, label %{body}, label %{done}")
        self._found.divergent.add(loop.line)

    def _add(self, slot: str, mask: str) -> None:
        before = self._new(f"load {MASK}, ptr {slot}")
        self._emit(f"store {MASK} {self._or(before, mask)}, ptr {slot}")

    def _loop(
        self, statement: ast.For | ast.While, test: Callable[[str, str], None], step: Callable[[], None]
    ) -> None:
        """Emit a loop; lanes that have left it wait at its end."""
        begin, body, following, done = self._labels("test", "do", "next", "done")
        loop = Loop(self._mask_slot(), self._mask_slot(), statement.lineno)
        self._lane_loops.append(loop)
        divergent, before, returned = (
            statement.lineno in self._found.divergent,
            self._turned_off,
            self._returned,
        )
        self._divergence += divergent
        self._jump(begin)
        self._begin(begin)
        test(body, done)
        self._begin(body)
        self._exits.append(following)
        self._block(statement.body)
        self._exits.pop()
        self._jump(following)
        self._begin(following)
        if self._turned_off > before:
            waiting = self._new(f"load {MASK}, ptr {loop.waiting}")
            self._turn(self._or(self._on(), waiting))
            self._emit(f"store {MASK} zeroinitializer, ptr {loop.waiting}")
        step()
        if self._turned_off > before:
            self._emit(f"br i1 {self._any(self._on())}, label %{begin}, label %{done}")
        else:
            self._emit(f"br label %{begin}")
        self._begin(done)
        self._turn(self._or(self._on(), self._new(f"load {MASK}, ptr {loop.left}")))
        self._divergence -= divergent
        self._lane_loops.pop()
        if self._returned > returned:
            self._go_on_if_any()
        else:
            self._turned_off = before

    def _on_break(self, statement: ast.Break) -> None:
        self._leave_round(self._lane_loops[-1].left)

    def _on_continue(self, statement: ast.Continue) -> None:
        self._leave_round(self._lane_loops[-1].waiting)

    def _leave_round(self, slot: str) -> None:
        self._add(slot, self._on())
        if self._divergence:
            self._found.divergent.add(self._lane_loops[-1].line)
        self._leave()

    def _on_return(self, statement: ast.Return) -> None:
        kind = self.signature.result
        if statement.value is not None:
            value = self._value(statement.value)
            value = self._wide(self._float(value) if kind == "double" else value)
            if value.type != _wide(kind):
                raise self._error(statement, f"returns {value.type}, not {_wide(kind)}")
            self._blend(value, "%result")
        self._returned += 1
        self._leave()

    # Conditions and expressions

    def _condition(self, test: ast.expr) -> Value:
        """Evaluate a condition: i1, or the mask of the lanes where it holds.

        `and` and `or` look no further than some lane must.
        """
        if isinstance(test, ast.BoolOp):
            found = self._condition(test.values[0])
            for part in test.values[1:]:
                found = self._joined(test.op, found, part)
            return found
        if isinstance(test, ast.UnaryOp) and isinstance(test.op, ast.Not):
            return self._opposite(self._condition(test.operand))
        if isinstance(test, ast.Compare) and len(test.ops) == 1:
            return self._compare(test)
        raise self._error(test, "tests anything but a comparison")

    def _joined(self, op: ast.boolop, found: Value, part: ast.expr) -> Value:
        open_ = found if isinstance(op, ast.And) else self._opposite(found)
        more = self._where(open_, lambda: self._condition(part))
        a, b = self._alike(found, more), self._alike(more, found)
        word = "and" if isinstance(op, ast.And) else "or"
        return Value(a.type, self._new(f"{word} {a.type} {a.operand}, {b.operand}"))

    def _opposite(self, test: Value) -> Value:
        return Value(
            test.type,
            self._new(f"xor {test.type} {test.operand}, {self._alike(Value('i1', 'true'), test).operand}"),
        )

    def _where(self, test: Value, make: Callable[[], Value]) -> Value:
        """Evaluate something where a test holds, if it does in any lane; zero elsewhere."""
        more, after = self._labels("where", "after")
        on, before = "", self._at
        if test.type == "i1":
            self._emit(f"br i1 {test.operand}, label %{more}, label %{after}")
            self._begin(more)
        else:
            on = self._on()
            chosen = self._and(on, test.operand)
            some = self._any(chosen)
            self._emit(f"br i1 {some}, label %{more}, label %{after}")
            self._begin(more)
            self._turn(chosen)
        value = make()
        if on:
            value = self._wide(value)
            self._turn(on)
        end = self._at
        self._jump(after)
        self._begin(after)
        zero = ZEROS.get(value.type, "zeroinitializer")
        made = f"phi {value.type} [ {zero}, %{before} ], [ {value.operand}, %{end} ]"
        return Value(value.type, self._new(made))

    def _of_ifexp(self, node: ast.IfExp) -> Value:
        test = self._condition(node.test)
        yes = self._where(test, lambda: self._value(node.body))
        no = self._where(self._opposite(test), lambda: self._value(node.orelse))
        if yes.type != "ptr" or no.type != "ptr" or test.type != "i1":
            yes, no = self._pair(yes, no)
        if test.type != "i1":
            yes, no = self._wide(yes), self._wide(no)
        made = f"select {test.type} {test.operand}, {yes.type} {yes.operand}, {no.type} {no.operand}"
        return Value(yes.type, self._new(made))

    def _pair(self, a: Value, b: Value) -> tuple[Value, Value]:
        a, b = super()._pair(a, b)
        return self._alike(a, b), self._alike(b, a)

    def _alike(self, value: Value, other: Value) -> Value:
        return self._wide(value) if str(other.type).startswith("<") else value

    def _wide(self, value: Value) -> Value:
        """Return a number in all lanes."""
        if str(value.type).startswith("<"):
            return value
        factors = value.factors and tuple(self._splat(str(value.type), each) for each in value.factors)
        return Value(_wide(value.type), self._splat(str(value.type), value.operand), factors)  # type: ignore

    def _splat(self, kind: str, operand: str) -> str:
        if not operand.startswith("%"):
            return f"splat ({kind} {operand})"
        wide = _wide(kind)
        one = self._new(f"insertelement {wide} poison, {kind} {operand}, i32 0")
        return self._new(f"shufflevector {wide} {one}, {wide} poison, <{LANES} x i32> zeroinitializer")

    def _of_binop(self, node: ast.BinOp) -> Value:
        if isinstance(node.op, ast.FloorDiv | ast.Mod):
            divisor = self._value(node.right)
            if divisor.type != "i64" or divisor.operand.startswith("%"):  # 0 in a lane that is off, perhaps
                raise self._error(node, "divides whole numbers by what may be 0")
        return super()._of_binop(node)

    # Vectors and variables

    def _of_field(self, kind: Kind) -> Kind:
        return kind

    def _of_name(self, node: ast.Name) -> Value:
        value = super()._of_name(node)
        return value._replace(type="shared") if value.operand == f"@{node.id}" else value

    def _of_subscript(self, node: ast.Subscript) -> Value:
        vector, index = self._place(node)
        if isinstance(node.slice, ast.Slice):
            return self._tail(vector, index)
        if not vector.offset and index.type == "i64":
            if vector.type == "shared":
                return Value("double", self._new(f"load double, ptr {self._address(vector, index)}"))
            made = f"load {DOUBLES}, ptr {self._address(vector, index)}, align 8"
            return Value(DOUBLES, self._new(made))
        at, on = self._addresses(vector, index), self._on()
        gather = f"@llvm.masked.gather.v{LANES}f64.v{LANES}p0"
        given = f"{POINTERS} {at}, i32 8, {MASK} {on}, {DOUBLES} zeroinitializer"
        return Value(DOUBLES, self._new(f"call {DOUBLES} {gather}({given})"))

    def _place(self, node: ast.Subscript) -> tuple[Value, Value]:
        """Return the vector and the number of an element, or of the first of a tail."""
        vector, place = self._value(node.value), self._first(node)
        index = self._value(place)
        if vector.type not in ("ptr", "shared") or not is_whole(index):
            raise self._error(node, f"indexes {vector.type} with {index.type}")
        return vector, index

    def _tail(self, vector: Value, index: Value) -> Value:
        if index.type == "i64":
            return vector._replace(operand=self._address(vector, index))
        return vector._replace(offset=self._sum(vector.offset, index.operand))

    def _address(self, vector: Value, index: Value) -> str:
        kind = "double" if vector.type == "shared" else DOUBLES
        return self._new(f"getelementptr {kind}, ptr {vector.operand}, i64 {index.operand}")

    def _addresses(self, vector: Value, index: Value) -> str:
        """Return the addresses of an element of each lane."""
        place = self._sum(vector.offset, self._wide(index).operand)
        if vector.type == "ptr":
            place = self._new(f"mul {WHOLES} {place}, splat (i64 {LANES})")
            place = self._new(f"add {WHOLES} {place}, {LANE_NUMBERS}")
        return self._new(f"getelementptr double, ptr {vector.operand}, {WHOLES} {place}")

    def _sum(self, offset: str, index: str) -> str:
        return self._new(f"add {WHOLES} {offset}, {index}") if offset else index

    def _assign(self, target: ast.expr, value: Value) -> None:
        if not isinstance(target, ast.Subscript):
            super()._assign(target, value)
            return
        vector, index = self._place(target)
        value = self._wide(self._float(value))
        if vector.offset or index.type != "i64":
            at, on = self._addresses(vector, index), self._on()
            scatter = f"@llvm.masked.scatter.v{LANES}f64.v{LANES}p0"
            self._emit(f"call void {scatter}({DOUBLES} {value.operand}, {POINTERS} {at}, i32 8, {MASK} {on})")
        elif vector.type == "shared":
            raise self._error(target, "writes one element of a shared vector from several lanes")
        else:
            self._blend(value, self._address(vector, index))

    def _blend(self, value: Value, address: str) -> None:
        """Store a value in the lanes that are on; volatile as in `newton_euler.codegen.emit`."""
        before = self._new(f"load volatile {value.type}, ptr {address}, align 8")
        chosen = f"select {MASK} {self._on()}, {value.type} {value.operand}, {value.type} {before}"
        self._emit(f"store {value.type} {self._new(chosen)}, ptr {address}, align 8")

    def _store(self, name: str, value: Value, node: ast.expr | None = None) -> None:
        if name in self._records:
            raise self._error(node, f"assigns to {name!r}, which is a record")
        known = self._variables.get(name)
        if value.type in ("ptr", "shared", "fn"):
            if known is not None:
                raise self._error(node, f"gives {name!r} a second vector")
            self._variables[name] = value
            return
        if known is not None and "double" in str(known.type):
            value = self._float(value)
        if known is not None and is_whole(known) != is_whole(value):
            raise self._error(node, f"assigns {value.type} to {name!r}, which is {known.type}")
        if self._divergence or str(value.type).startswith("<"):
            self._found.varying.add(name)
        if name in self._found.varying:
            value = self._wide(value)
        self._set(name, value, divergent=self._divergence > 0)

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
        if known.type in ("ptr", "shared", "fn"):
            return known
        return Value(known.type, self._new(f"load {known.type}, ptr {known.operand}, align 8"))

    # Calls

    def _call(self, node: ast.Call, function: Callable[..., Any], arguments: list[Value]) -> Value:
        signature, forms = signature_of(function), ""
        given = [f"{MASK} {self._on()}"]
        for argument, kind in zip(arguments, signature.arguments.values(), strict=True):
            value = self._wide(self._float(argument)) if kind == "double" else argument
            form = FORMS.get(value.type, "r")
            forms += form.upper() if value.offset else form
            given.append(f"{machine_type(value.type)} {value.operand}")
            if value.offset:
                given.append(f"{WHOLES} {value.offset}")
        call = Call(function, forms)
        self.calls.append(call)
        result = "void" if signature.result == "void" else _wide(signature.result)
        made = f"call {result} @{call.name}({', '.join(given)})"
        if result == "void":
            self._emit(made)
            return Value("void", "")
        return Value(result, self._new(made))

    def _begin(self, label: str) -> None:
        super()._begin(label)
        self._at = label


def _wide(kind: Kind) -> str:
    """Return the type of a number in all lanes."""
    return vector_type(str(kind), LANES)


def translate(call: Call) -> tuple[str, LaneTranslator]:
    """Translate a function for all lanes, again and again until what varies is known."""
    found = Found(set(), set())
    while True:
        translator = LaneTranslator(call, found)
        text, settled = translator.translated()
        if settled:
            return text, translator


def entry(function: Callable[..., Any]) -> tuple[str, Call]:
    """Return LLVM text of a method for other languages, which begins with all lanes on, and the call in it.

    It has vectors, records, callbacks and whole numbers as arguments, and no result.
    """
    arguments = signature_of(function).arguments
    call = Call(function, "".join(ENTRY_FORMS.get(kind, "r") for kind in arguments.values()))
    given = ", ".join(f"{machine_type(kind)} %{name}" for name, kind in arguments.items())
    text = f"call void @{call.name}({MASK} {ALL}, {given})"
    return f"define void @{function.__name__}({given}) {{\n  {text}\n  ret void\n}}", call


def text_of(functions: list[Callable[..., Any]]) -> str:
    """Translate these native functions and all they call for all lanes."""
    done: dict[str, str] = {}
    entries, waiting = map(list, zip(*map(entry, functions), strict=True))
    tables: dict[str, str] = {}
    owners: dict[str, Callable[..., Any]] = {}
    while waiting:
        call = waiting.pop()
        if owners.setdefault(call.function.__name__, call.function) is not call.function:
            raise NativeError(f"two functions are called {call.function.__name__}")
        if call.name not in done:
            done[call.name], translator = translate(call)
            for name, table in translator.tables.items():
                if tables.setdefault(name, table) != table:
                    raise NativeError(f"two tables are called {name}")
            waiting += translator.calls
    return "\n".join([DECLARATIONS, *tables.values(), *done.values(), *entries])
