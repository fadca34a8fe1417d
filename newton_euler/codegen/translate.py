"""Translate native functions (see `newton_euler.codegen.native`) to LLVM text, for one run or for several at
once.

Several runs are processed in the *lanes* (elements) of vector registers. The Python function is the program
of each lane (single program, multiple data). Numbers that are the same in all lanes are scalars; other
numbers are vectors. A condition that differs between lanes is a *mask*, a vector of booleans. A lane is *on*
if the present instructions apply to it. Control flow that differs between lanes is translated as follows:

- `if` executes both sides, each in the lanes that need it, and skips a side that no lane needs;
- loops run until the last lane leaves;
- `break`, `continue` and `return` turn lanes off until the end of the loop, of the iteration or of the
  function, unless all lanes leave together;
- assignments change only the lanes that are on.

A `Vector` holds the elements of all lanes: element i of lane l is at index `lanes` i + l. Tables and `Shared`
vectors have each element once, and each lane may use another index. A lane computes the same as code for one
run, bit by bit. Python that cannot be translated raises `NativeError` with its line.

`text` is the entry point. Methods named `_on_...` translate one class of statements of the module `ast`.
"""

from __future__ import annotations

import ast
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from newton_euler.codegen.function_expressions import Call, Expressions, form_of, kind_in
from newton_euler.codegen.function_text import ALL, Found, Value, varies
from newton_euler.codegen.native import NativeError, machine_type, signature_of
from newton_euler.codegen.trigonometry import vector_type


class Loop(NamedTuple):
    """A loop that is being translated.

    Attributes:
        line: line number of the loop.
        divergence: depth, within the loop, of branches and loops in which lanes may be off.
        following: label at the end of an iteration.
        done: label behind the loop.
        left: variable with the mask of lanes that have left the loop; empty if all lanes leave together.
        waiting: variable with the mask of lanes that wait for the next iteration after `continue`; empty if
            all lanes leave together.
    """

    line: int
    divergence: int
    following: str
    done: str
    left: str
    waiting: str


class Translator(Expressions):
    """Translation of one function for given forms of its arguments.

    The form of an argument says whether it is a number, vector or record, and whether it differs between
    lanes (`newton_euler.codegen.function_expressions.FORMS`).

    Attributes:
        signature: kinds of the arguments and of the result of the function.
    """

    def __init__(self, call: Call, lanes: int, found: Found) -> None:
        """Prepare the translation.

        Args:
            call: the function, and the forms of its arguments.
            lanes: number of runs at once.
            found: variables and loops known to differ between lanes; the translation adds others.
        """
        super().__init__(call.function, lanes, found)
        self.signature = signature_of(call.function)
        self._translated_call = call
        self._exits: list[str] = []  # innermost last: label to jump to if no lane is on
        self._loops: list[Loop] = []  # innermost last
        self._turned_off = 0  # number of statements so far that turned lanes off
        self._returned = 0  # number of those that are `return`

    def translated(self) -> str:
        """Return the LLVM text of the function."""
        # arguments: store numbers in variables, register the records
        definition, arguments = definition_of(self.function), []
        if self.lanes > 1:  # the first argument is the mask of the lanes that are on
            arguments.append(f"{self._mask} %on.in")
            self._slots.append(f"  %on = alloca {self._mask}")
            self._turn("%on.in")
        # LLVM type or kind of an argument by the letter of its form: v double, w integer of each lane, u
        # integer of all lanes, l vector, s `Shared` vector; capital if each lane begins at another index
        types = {"v": self._doubles, "w": self._wholes, "u": "i64", "l": "ptr", "s": "shared"}
        for (name, kind), form in zip(
            self.signature.arguments.items(), self._translated_call.forms, strict=True
        ):
            offset = f"%{name}.offset" if form.isupper() else ""
            value = Value(types.get(form.lower(), kind), f"%{name}.in", offset=offset)
            arguments.append(f"{machine_type(value.type)} %{name}.in")
            if offset:
                arguments.append(f"{self._wholes} {offset}")
            if isinstance(kind, str):
                self._store(name, value)
            else:
                self._records[name] = value
        # body, with one exit at its end
        result = self.signature.result
        if result != "void":
            result = self._type_in_lanes(result)
            self._slots.append(f"  %result = alloca {result}")
        (end,) = self._labels("end")
        self._exits.append(end)
        self._block(definition.body)
        if self._reachable and result != "void" and not self._turned_off:
            raise self._error(definition, "ends without a return")
        self._jump(end)
        self._begin(end)
        returned = "" if result == "void" else self._new(f"load {result}, ptr %result")
        self._emit(f"ret {result} {returned}")
        head = f"define internal {result} @{self._translated_call.name}({', '.join(arguments)}) {{"
        # on entry, allocate the variables and load the fields of records
        return "\n".join([head, "entry:", *self._slots, *self._field_loads, *self._lines, "}"])

    def _block(self, statements: list[ast.stmt]) -> None:
        """Translate statements, each by the method for its syntax node."""
        for statement in statements:
            if not self._reachable:
                raise self._error(statement, "is never reached")
            method = getattr(self, f"_on_{type(statement).__name__.lower()}", None)
            if method is None:
                raise self._error(statement, f"holds {type(statement).__name__}")
            method(statement)

    def _on_expr(self, statement: ast.Expr) -> None:
        """Translate a call without a result; skip a docstring."""
        if not isinstance(statement.value, ast.Constant):  # a docstring
            self._value(statement.value)

    def _on_assign(self, statement: ast.Assign) -> None:
        """Translate `a = b`."""
        if len(statement.targets) != 1:
            raise self._error(statement, "assigns to several targets")
        self._assign(statement.targets[0], self._value(statement.value))

    def _on_augassign(self, statement: ast.AugAssign) -> None:
        """Translate `a += b` and the like as `a = a + b`."""
        target = statement.target
        before = ast.copy_location(ast.BinOp(_loaded(target), statement.op, statement.value), statement)
        self._assign(target, self._value(before))

    def _assign(self, target: ast.expr, value: Value) -> None:
        """Assign a value to a variable or to an element of a vector."""
        if isinstance(target, ast.Name):
            self._store(target.id, value, target)
        elif isinstance(target, ast.Subscript):
            self._assign_element(target, value)
        else:
            raise self._error(target, f"assigns to {type(target).__name__}")

    # Lanes that are turned off

    def _leave(self) -> None:
        """Turn off all lanes that are on, and jump to the next place where other lanes may be on."""
        self._turn("zeroinitializer")
        self._jump(self._exits[-1])
        self._turned_off += 1

    def _continue_if_any(self) -> None:
        """Execute the following instructions only if some lane is on."""
        (further,) = self._labels("further")
        self._branch(self._any(self._on()), further, self._exits[-1])
        self._begin(further)

    def _add(self, slot: str, mask: str) -> None:
        """Add the lanes of a mask to the mask in a variable."""
        before = self._new(f"load {self._mask}, ptr {slot}")
        self._emit(f"store {self._mask} {self._or(before, mask)}, ptr {slot}")

    # Branches

    def _on_if(self, statement: ast.If) -> None:
        """Translate `if`; its condition may hold in some lanes only."""
        test, before = self._condition(statement.test), self._turned_off
        if varies(test):
            self._varying_if(test, statement)
        else:
            self._uniform_if(test, statement)
        if self._reachable and self._turned_off > before:
            self._continue_if_any()

    def _uniform_if(self, test: Value, statement: ast.If) -> None:
        """Translate `if` with a condition that is the same in all lanes: a branch."""
        yes, no, after = self._labels("if", "else", "endif")
        self._branch(test.operand, yes, no)
        reached = False
        for label, body in ((yes, statement.body), (no, statement.orelse)):
            self._begin(label)
            self._block(body)
            reached = self._jump(after) or reached
        if reached:
            self._begin(after)

    def _varying_if(self, test: Value, statement: ast.If) -> None:
        """Translate `if` with a condition that differs between lanes: both sides, each in some lanes."""
        yes, between, no, after = self._labels("if", "between", "else", "endif")
        on = self._on()
        yes_lanes, no_lanes = self._and(on, test.operand), self._without(on, test.operand)
        self._divergence += 1
        self._some_lanes(yes_lanes, yes, between, statement.body)
        yes_lanes = self._on()  # those that are still on behind the body
        if statement.orelse:
            self._some_lanes(no_lanes, no, after, statement.orelse)
            no_lanes = self._on()
        self._turn(self._or(yes_lanes, no_lanes))
        self._divergence -= 1

    def _some_lanes(self, mask: str, label: str, after: str, body: list[ast.stmt]) -> None:
        """Translate statements that only the lanes of a mask execute; skip them if the mask is empty.

        Args:
            mask: the lanes.
            label: label for the statements.
            after: label behind them.
            body: the statements.
        """
        self._turn(mask)
        self._branch(self._any(mask), label, after)
        self._begin(label)
        self._exits.append(after)
        self._block(body)
        self._exits.pop()
        self._jump(after)
        self._begin(after)

    # Loops

    def _on_while(self, statement: ast.While) -> None:
        """Translate a `while` loop."""
        self._loop(statement, lambda: self._condition(statement.test), lambda: None)

    def _on_for(self, statement: ast.For) -> None:
        """Translate `for k in range(...)`."""
        name, start, stop = self._range(statement)
        if varies(start) or varies(stop):
            self._found.varying.add(name)
            start = self._wide(start)
        self._set(name, start)
        counter = self._variables[name]

        def test() -> Value:
            """Emit the condition that another iteration follows."""
            number, last = self._pair(self._load(name), stop)
            more = self._new(f"icmp slt {number.type} {number.operand}, {last.operand}")
            return Value(str(number.type).replace("i64", "i1"), more)

        def step() -> None:
            """Emit the increment of the loop variable."""
            one = self._alike(Value("i64", "1"), counter)
            number = self._new(f"add {counter.type} {self._load(name).operand}, {one.operand}")
            self._set(name, Value(counter.type, number))

        self._loop(statement, test, step)
        if statement.lineno in self._found.divergent and not varies(counter):
            del self._variables[name]  # undefined behind the loop, because lanes left with different values

    def _range(self, statement: ast.For) -> tuple[str, Value, Value]:
        """Return the variable of a `for` loop and its first and last bound."""
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

    def _loop(
        self, statement: ast.For | ast.While, test: Callable[[], Value], step: Callable[[], None]
    ) -> None:
        """Translate a loop. Lanes that leave before others are off until the loop ends.

        Args:
            statement: the loop.
            test: emits the condition that another iteration follows, and returns it.
            step: emits the instructions between two iterations.
        """
        begin, body, following, done = self._labels("test", "do", "next", "done")
        # in a divergent loop some lanes may leave before others
        divergent = statement.lineno in self._found.divergent
        left, waiting = (self._mask_slot() if divergent else "" for _ in range(2))
        before, returned = self._turned_off, self._returned
        self._divergence += divergent
        loop = Loop(statement.lineno, self._divergence, following, done, left, waiting)
        self._loops.append(loop)
        # condition and body of an iteration
        self._jump(begin)
        self._begin(begin)
        self._leave_unless(test(), body)
        self._begin(body)
        self._exits.append(following)
        self._block(statement.body)
        self._exits.pop()
        self._jump(following)
        self._begin(following)
        # lanes that wait after `continue` are on again; next iteration, if there are lanes for it
        if waiting:
            again = self._new(f"load {self._mask}, ptr {waiting}")
            self._turn(self._or(self._on(), again))
            self._emit(f"store {self._mask} zeroinitializer, ptr {waiting}")
        step()
        if self._turned_off > before:
            self._branch(self._any(self._on()), begin, done)
        else:
            self._jump(begin)
        # behind the loop, lanes that have left it are on again, except those that have returned
        self._begin(done)
        if left:
            self._turn(self._or(self._on(), self._new(f"load {self._mask}, ptr {left}")))
        self._divergence -= divergent
        self._loops.pop()
        if self._returned > returned:
            self._continue_if_any()
        else:
            self._turned_off = before

    def _leave_unless(self, test: Value, body: str) -> None:
        """Begin an iteration in the lanes where a condition holds; the other lanes leave the loop.

        Args:
            test: the condition.
            body: label of the body of the loop.
        """
        loop, more = self._loops[-1], test.operand
        if varies(test):
            self._found.divergent.add(loop.line)
            on = self._on()
            self._add(loop.left, self._without(on, test.operand))
            further = self._and(on, test.operand)
            self._turn(further)
            more = self._any(further)
        self._branch(more, body, loop.done)

    def _on_break(self, statement: ast.Break) -> None:
        """Translate `break`."""
        loop = self._loops[-1]
        self._leave_iteration(loop, loop.done, loop.left)

    def _on_continue(self, statement: ast.Continue) -> None:
        """Translate `continue`."""
        loop = self._loops[-1]
        self._leave_iteration(loop, loop.following, loop.waiting)

    def _leave_iteration(self, loop: Loop, label: str, slot: str) -> None:
        """Leave an iteration of a loop in the lanes that are on.

        Args:
            loop: the loop.
            label: label to jump to if all lanes in the loop leave together.
            slot: variable to which the lanes are added otherwise, before they are turned off.
        """
        if not slot and self._divergence == loop.divergence:
            self._jump(label)
            return
        self._found.divergent.add(loop.line)
        self._add(slot, self._on())
        self._leave()

    def _on_return(self, statement: ast.Return) -> None:
        """Translate `return`: store the result in the lanes that are on, and turn them off."""
        kind = self.signature.result
        if statement.value is not None:
            value = self._value(statement.value)
            value = self._wide(self._float(value) if kind == "double" else value)
            if value.type != self._type_in_lanes(kind):
                raise self._error(statement, f"returns {value.type}, not {kind}")
            self._blend(value, "%result")
        if self._divergence:
            self._returned += 1
            self._leave()
        else:
            self._jump(self._exits[0])


def text(functions: list[Callable[..., Any]], lanes: int = 1) -> str:
    """Translate native functions, and all native functions that they call, to LLVM text.

    Args:
        functions: functions marked `native`, which can be called from other languages by their names.
        lanes: number of runs at once.

    Raises:
        NativeError: if a function contains Python that cannot be translated.
    """
    # entry functions, and calls of functions that are not translated yet
    entries, waiting = map(list, zip(*(_entry(function, lanes) for function in functions), strict=True))
    # LLVM text of functions and tables by name, and the Python function that a name belongs to
    written: dict[str, str] = {}
    tables: dict[str, str] = {}
    owners: dict[str, Callable[..., Any]] = {}
    while waiting:
        call = waiting.pop()
        if owners.setdefault(call.function.__name__, call.function) is not call.function:
            raise NativeError(f"two functions are called {call.function.__name__}")
        if call.name not in written:
            written[call.name], translator = _translation(call, lanes)
            for name, table in translator.tables.items():
                if tables.setdefault(name, table) != table:
                    raise NativeError(f"two tables are called {name}")
            waiting += translator.calls
    return "\n".join([*tables.values(), *written.values(), *entries])


def _entry(function: Callable[..., Any], lanes: int) -> tuple[str, Call]:
    """Return the LLVM text of an entry function for other languages, and the call that it contains.

    The entry function calls the translated function with all lanes on. For several lanes, its arguments are
    vectors, records, callbacks and integers, and it has no result.
    """
    arguments, result = signature_of(function)
    call = Call(function, "".join(form_of(Value(kind_in(kind, lanes), "")) for kind in arguments.values()))
    given = [f"{machine_type(kind)} %{name}" for name, kind in arguments.items()]
    passed = [f"{vector_type('i1', lanes)} {ALL}", *given] if lanes > 1 else given
    assigned, returned = ("", "") if result == "void" else ("%returned = ", "%returned")
    lines = [
        f"define {result} @{function.__name__}({', '.join(given)}) {{",
        f"  {assigned}call {result} @{call.name}({', '.join(passed)})",
        f"  ret {result} {returned}",
        "}",
    ]
    return "\n".join(lines), call


def _translation(call: Call, lanes: int) -> tuple[str, Translator]:
    """Return the LLVM text of a function, and its translator.

    The function is translated again until no more variables and loops are found that differ between lanes.
    Earlier texts are discarded; they may be invalid, because a loop found in them has no variables for masks.
    """
    found = Found(set(), set())
    while True:
        known = len(found.varying) + len(found.divergent)
        translator = Translator(call, lanes, found)
        written = translator.translated()
        if len(found.varying) + len(found.divergent) == known:
            return written, translator


def definition_of(function: Callable[..., Any]) -> ast.FunctionDef:
    """Return the syntax tree of the definition of a function."""
    return _definitions(function.__code__.co_filename)[function.__name__]


@lru_cache
def _definitions(file: str) -> dict[str, ast.FunctionDef]:
    """Return the syntax trees of the functions that a file defines, by name."""
    body = ast.parse(Path(file).read_text(encoding="utf-8")).body
    return {node.name: node for node in body if isinstance(node, ast.FunctionDef)}


def _loaded(target: ast.expr) -> ast.expr:
    """Return the target of an assignment as an expression that reads it, as `a += b` needs."""
    copy = ast.parse(ast.unparse(target), mode="eval").body
    return ast.copy_location(copy, target)
