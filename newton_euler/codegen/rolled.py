"""Loop rolling of large programs: code for each piece that repeats, and tables of its instances.

Straight-line code grows with the scene; what it computes repeats itself, once for every joint, body
and loop of a kind. The program is cut into pieces at places that depend on nothing but the operations
just before them, so that repetitions are cut alike wherever they stand. Pieces of the same structure
become one function; which values and constants each instance takes is data. Results are those of the
straight-line code: the same operations in the same order, each rounded by itself.

A value that other pieces use has a place in a table of values. Its first places are the inputs. Where
there is no memory for the table, all results are NaN, whose pivot ratio no caller takes for positive.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from newton_euler.codegen.emit import ARGUMENTS, Instructions
from newton_euler.codegen.expression import LEAVES, Program, operands
from newton_euler.codegen.trigonometry import constant, literal, vector_type
from newton_euler.scalars import Array

WINDOW = 8
"""Number of operations that decide on a cut of the program after them."""

SHORTEST = 128
"""Operations of a piece at least; calls, and values that other pieces use, take as long as an operation."""

REACH = 80
"""A cut has the least checksum of so many operations before and after it."""

BASE, PRIME = 131, 1_000_003
"""Base and modulus of the rolling checksums; their products fit into 64 bits."""

COMMON = 0.002
"""A constant with this share of all operands is part of the code; a rarer one is data."""

Operand = tuple[str, int | float]
"""("own", number in the piece), ("value", number of the argument), ("data", number), ("literal", x)."""

Step = tuple[str, tuple[Operand, ...]]


@dataclass
class Instance:
    """One occurrence of a piece.

    Attributes:
        nodes: those that it computes, in order.
        values: nodes of other pieces that it uses, in order of first use.
        data: its own constants.
    """

    nodes: list[int]
    values: list[int]
    data: list[float]


@dataclass
class Piece:
    """Repeated structure.

    Attributes:
        steps: operations on operands that are the same in all instances but for values and data.
        instances: its occurrences.
        kept: those of its steps that some other piece or an output uses, in order.
    """

    number: int
    steps: tuple[Step, ...]
    instances: list[Instance] = field(default_factory=list)
    kept: list[int] = field(default_factory=list)


def cut(program: Program) -> list[list[int]]:
    """Cut the operations of a program into pieces."""
    operations = [k for k, (op, _, _) in enumerate(program.nodes) if op not in LEAVES]
    if not operations:
        return []
    # a checksum of the operations around each place, independent of where the place is
    sums = _checksums([program.nodes[k][0] for k in operations])
    around = np.pad(sums, REACH, constant_values=PRIME)
    least = np.lib.stride_tricks.sliding_window_view(around, 2 * REACH + 1).min(axis=1)
    # cut after local minima of the checksum, unless the piece would be too short
    pieces: list[list[int]] = []
    start = 0
    for n in np.flatnonzero(sums == least).tolist():
        if n + 1 - start >= SHORTEST:
            pieces.append(operations[start : n + 1])
            start = n + 1
    return [*pieces, operations[start:]] if start < len(operations) else pieces


def _checksums(words: Sequence[str]) -> Array:
    """Compute numbers (n,) that depend on the letters of each word and the `WINDOW` - 1 before it.

    They are those letters as a number of base `BASE`, modulo `PRIME`; hash() differs from process to process.
    """
    kinds = sorted(set(words))
    number = {word: k for k, word in enumerate(kinds)}
    digits = [[*word.encode()] for word in kinds]
    values = [sum(d * BASE ** (len(each) - 1 - k) for k, d in enumerate(each)) % PRIME for each in digits]
    shifts = [BASE ** len(each) % PRIME for each in digits]
    places = np.array([number[word] for word in words])
    value, shift = np.array(values)[places], np.array(shifts)[places]
    total = np.zeros(len(words), dtype=np.int64)
    for back in range(min(WINDOW, len(words)) - 1, -1, -1):
        at = slice(0, len(words) - back)
        total[back:] = (total[back:] * shift[at] + value[at]) % PRIME
    return total


def roll(program: Program) -> tuple[list[Piece], list[tuple[Piece, Instance]]]:
    """Find the kinds of pieces of a program, and all instances in the order in which to run them."""
    common = _common_constants(program)
    pieces: dict[tuple[Step, ...], Piece] = {}
    order: list[tuple[Piece, Instance]] = []
    home: dict[int, tuple[Piece, int]] = {}
    used: set[int] = set(program.outputs)
    # pieces of equal structure share one entry
    for nodes in cut(program):
        steps, instance = _structure(program, nodes, common)
        piece = pieces.setdefault(steps, Piece(len(pieces), steps))
        piece.instances.append(instance)
        order.append((piece, instance))
        home.update({node: (piece, place) for place, node in enumerate(nodes)})
        used.update(instance.values)
    # each piece stores the values that other pieces or outputs use
    for node in sorted(used):
        if node in home:
            piece, place = home[node]
            if place not in piece.kept:
                piece.kept.append(place)
    for piece in pieces.values():
        piece.kept.sort()
    return list(pieces.values()), order


def _common_constants(program: Program) -> set[float]:
    used = Counter(a for op, a, _ in program.nodes if op not in LEAVES)
    used.update(b for _, _, b in program.nodes if b >= 0)
    counts: Counter[float] = Counter()
    for k, (op, value, _) in enumerate(program.nodes):
        if op == "const":
            counts[value] += used[k]
    least = COMMON * program.operation_count
    return {value for value, count in counts.items() if count >= least}


def _structure(program: Program, nodes: list[int], common: set[float]) -> tuple[tuple[Step, ...], Instance]:
    """Separate the structure that all instances of a piece share from the data of one."""
    instance = Instance(nodes, [], [])
    known: dict[int, Operand] = {node: ("own", place) for place, node in enumerate(nodes)}
    steps: list[Step] = []
    for k in nodes:
        ends: list[Operand] = []
        for end in operands(program.nodes[k]):
            operand = known.get(end)
            if operand is None:
                op, value, _ = program.nodes[end]
                if op != "const":
                    operand = known[end] = "value", len(instance.values)
                    instance.values.append(end)
                elif value in common:
                    operand = known[end] = "literal", value
                else:  # in each place by itself, as other instances may have two different ones
                    operand = "data", len(instance.data)
                    instance.data.append(value)
            ends.append(operand)
        steps.append((program.nodes[k][0], tuple(ends)))
    return tuple(steps), instance


def emit_rolled(program: Program, name: str, lanes: int = 1) -> str:
    """Emit the program as loops over its pieces; an `Emitter`."""
    pieces, order = roll(program)
    # lay out the table of values: inputs, stored values of all instances, constants among the outputs
    place = {k: int(a) for k, (op, a, _) in enumerate(program.nodes) if op == "input"}
    size = program.inputs
    starts = []
    for piece, instance in order:
        starts.append(size)
        for number, step in enumerate(piece.kept):
            place[instance.nodes[step]] = size + number
        size += len(piece.kept)
    fixed = [k for k in dict.fromkeys(program.outputs) if program.nodes[k][0] == "const"]
    for k in fixed:
        place[k] = size
        size += 1

    # tables of what each instance takes: places of values, and data
    values: list[int] = []
    data: list[float] = []
    value_starts, data_starts = [], []
    for piece, instance in order:
        value_starts.append(len(values))
        data_starts.append(len(data))
        if len(piece.instances) > 1:
            values.extend(place[k] for k in instance.values)
            data.extend(instance.data)
    used = sorted({int(a) for op, a, _ in program.nodes if op == "input"})
    tables = [
        _table("i32", f"{name}.values", values),
        _table("double", f"{name}.data", [literal(x) for x in data]),
        _table("i32", f"{name}.inputs", used),
        _table("i32", f"{name}.outputs", [place[k] for k in program.outputs]),
        _table("ptr", f"{name}.kinds", [f"@{name}.{piece.number}" for piece, _ in order]),
        _table("i32", f"{name}.value_starts", value_starts),
        _table("i32", f"{name}.data_starts", data_starts),
        _table("i32", f"{name}.starts", starts),
    ]
    # code: constants, one function for each piece, and the loop that calls the functions
    constants = Instructions(lanes)
    for k in fixed:
        constants.store(f"%c{k}", constant(program.nodes[k][1], lanes), "%v", place[k])
    bodies = [_emit_piece(piece, name, place, lanes) for piece in pieces]
    begun, given = Instructions(lanes), Instructions(lanes)
    given.store("%o.to", "%o.value", "%y", "%o", begun.mask("%mask", "%on"))
    loops = _LOOPS.format(
        name=name,
        arguments=ARGUMENTS,
        t=vector_type("double", lanes),
        nan=constant(math.nan, lanes),
        mask="\n".join(begun.lines),
        give="\n".join(given.lines),
        bytes=8 * lanes * size,
        constants="\n".join(constants.lines),
        inputs=len(used),
        instances=len(order),
        outputs=len(program.outputs),
    )
    return "\n".join([*tables, *bodies, loops])


def _table(kind: str, name: str, entries: Sequence[object]) -> str:
    """Emit a constant array."""
    content = ", ".join(f"{kind} {entry}" for entry in entries)
    return f"@{name} = private constant [{len(entries)} x {kind}] [{content}]"


def _emit_piece(piece: Piece, name: str, place: dict[int, int], lanes: int) -> str:
    """Emit a piece as `void(values, places of its arguments, data, start of its results)`.

    A piece with one instance has places and data in its code; `place` holds the places of nodes.
    """
    out = Instructions(lanes)
    known: dict[Operand, str] = {}
    first, *others = piece.instances

    def operand(key: Operand) -> str:
        kind, number = key
        if kind == "literal":
            return constant(number, lanes)
        if kind == "data" and not others:
            return constant(first.data[int(number)], lanes)
        if key not in known:
            if kind == "data":
                known[key] = out.load_shared(f"%d{number}", "%data", int(number))
            elif not others:
                known[key] = out.load(f"%v{number}", "%v", place[first.values[int(number)]])
            else:
                out.lines.append(f"  %p{number}.at = getelementptr i32, ptr %places, i64 {number}")
                out.lines.append(f"  %p{number} = load i32, ptr %p{number}.at")
                out.lines.append(f"  %q{number} = zext i32 %p{number} to i64")
                known[key] = out.load(f"%v{number}", "%v", f"%q{number}")
        return known[key]

    for number, (op, ends) in enumerate(piece.steps):
        given = [operand(end) for end in ends]
        known["own", number] = out.operation(f"%n{number}", op, given[0], given[1] if ends[1:] else None)
    for number, step in enumerate(piece.kept):
        out.store(f"%k{number}", known["own", step], "%results", number)
    head = (
        f"define private void @{name}.{piece.number}(ptr %v, ptr noalias readonly %places, "
        "ptr noalias readonly %data, ptr noalias writeonly %results) noinline {"
    )
    return "\n".join([head, *out.lines, "  ret void\n}"])


_LOOPS = """
declare ptr @malloc(i64)
declare void @free(ptr)

define void @{name}({arguments}) {{
entry:
{mask}
  %v = call ptr @malloc(i64 {bytes})
  %none = icmp eq ptr %v, null
  br i1 %none, label %fail, label %copy
fail:
  %f = phi i64 [ 0, %entry ], [ %f.next, %failing ]
  %f.more = icmp slt i64 %f, {outputs}
  br i1 %f.more, label %failing, label %failed
failing:
  %f.to = getelementptr {t}, ptr %y, i64 %f
  store {t} {nan}, ptr %f.to, align 8
  %f.next = add i64 %f, 1
  br label %fail
failed:
  ret void
copy:
  %i = phi i64 [ 0, %entry ], [ %i.next, %copying ]
  %i.more = icmp slt i64 %i, {inputs}
  br i1 %i.more, label %copying, label %copied
copying:
  %i.table = getelementptr i32, ptr @{name}.inputs, i64 %i
  %i.short = load i32, ptr %i.table
  %i.place = zext i32 %i.short to i64
  %i.from = getelementptr {t}, ptr %x, i64 %i.place
  %i.value = load {t}, ptr %i.from, align 8
  %i.to = getelementptr {t}, ptr %v, i64 %i.place
  store {t} %i.value, ptr %i.to, align 8
  %i.next = add i64 %i, 1
  br label %copy
copied:
{constants}
  br label %piece
piece:
  %k = phi i64 [ 0, %copied ], [ %k.next, %run ]
  %k.more = icmp slt i64 %k, {instances}
  br i1 %k.more, label %run, label %give
run:
  %kind.at = getelementptr ptr, ptr @{name}.kinds, i64 %k
  %kind = load ptr, ptr %kind.at
  %values.at = getelementptr i32, ptr @{name}.value_starts, i64 %k
  %values.start = load i32, ptr %values.at
  %places = getelementptr i32, ptr @{name}.values, i32 %values.start
  %data.at = getelementptr i32, ptr @{name}.data_starts, i64 %k
  %data.start = load i32, ptr %data.at
  %data = getelementptr double, ptr @{name}.data, i32 %data.start
  %start.at = getelementptr i32, ptr @{name}.starts, i64 %k
  %start = load i32, ptr %start.at
  %results = getelementptr {t}, ptr %v, i32 %start
  call void %kind(ptr %v, ptr %places, ptr %data, ptr %results)
  %k.next = add i64 %k, 1
  br label %piece
give:
  %o = phi i64 [ 0, %piece ], [ %o.next, %giving ]
  %o.more = icmp slt i64 %o, {outputs}
  br i1 %o.more, label %giving, label %done
giving:
  %o.table = getelementptr i32, ptr @{name}.outputs, i64 %o
  %o.short = load i32, ptr %o.table
  %o.place = zext i32 %o.short to i64
  %o.from = getelementptr {t}, ptr %v, i64 %o.place
  %o.value = load {t}, ptr %o.from, align 8
{give}
  %o.next = add i64 %o, 1
  br label %give
done:
  call void @free(ptr %v)
  ret void
}}
"""
