"""Write large programs as loops over repeated pieces (loop rolling), to keep code and compile time small.

A program is a pruned expression graph, a list of nodes (op, a, b): the name of an operation and the indices
of the nodes of its operands, b = -1 if there is only one. Leaves have no operands: a constant has its value
as a, an input its index.

The same sequences of operations repeat for every joint, body and loop of a kind. `cut` divides the program
into pieces. Whether it cuts at a place depends only on the operations around that place, so repeated
sequences are cut alike (content-defined chunking). Pieces of equal structure become one LLVM function. Tables
hold the values and constants that each instance of a piece takes. The operations and their order are the same
as in straight-line code, so that results are equal bit by bit if the straight-line code fuses no
multiplications and additions.

Values that a piece uses from other pieces are in one array, which begins with the inputs. If there is no
memory for this array, all results are NaN, which callers treat as a failure.
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

CHECKSUM_LENGTH = 8
"""Number of consecutive operations that a checksum covers."""

MIN_PIECE_OPERATIONS = 128
"""Smallest number of operations of a piece. Shorter pieces would spend much of the time on calls and on
storing values for other pieces."""

CUT_NEIGHBORHOOD = 80
"""A cut is at an operation whose checksum is the smallest among this number of operations before and
after."""

CHECKSUM_BASE, CHECKSUM_MODULUS = 131, 1_000_003
"""Base and modulus of the checksums (Rabin-Karp rolling hash); their products fit into 64 bits."""

MIN_COMMON_FRACTION = 0.002
"""Uses of a constant, divided by the number of all operations, from which on the constant is part of the
code. A rarer constant is in the table of an instance."""

Operand = tuple[str, int | float]
"""Operand of an operation in a piece: ("own", number of an operation of the piece), ("value", number of a
value from another piece), ("data", number of a constant of the instance) or ("literal", common constant)."""

Step = tuple[str, tuple[Operand, ...]]
"""Operation of a piece: its name and its operands."""


@dataclass
class Instance:
    """One occurrence of a piece in the program.

    Attributes:
        nodes: indices of the nodes that the instance computes, in order.
        values: indices of nodes of other pieces that the instance uses, in order of first use.
        data: rare constants that the instance uses, in order of use.
    """

    nodes: list[int]
    values: list[int]
    data: list[float]


@dataclass
class Piece:
    """A sequence of operations that occurs once or several times in the program.

    Attributes:
        number: number of the piece, part of the name of its LLVM function.
        steps: operations, equal in all instances; values and data differ.
        instances: occurrences of the piece.
        kept: numbers of the steps, ascending, whose results the array of values stores, because another piece
            or an output uses the result of some instance.
    """

    number: int
    steps: tuple[Step, ...]
    instances: list[Instance] = field(default_factory=list)
    kept: list[int] = field(default_factory=list)


def cut(program: Program) -> list[list[int]]:
    """Divide the operations of a program into pieces; return the indices of the nodes of each piece."""
    operations = [k for k, (op, _, _) in enumerate(program.nodes) if op not in LEAVES]
    if not operations:
        return []
    # a checksum of the operations around each place, independent of where the place is
    sums = _checksums([program.nodes[k][0] for k in operations])
    around = np.pad(sums, CUT_NEIGHBORHOOD, constant_values=CHECKSUM_MODULUS)
    least = np.lib.stride_tricks.sliding_window_view(around, 2 * CUT_NEIGHBORHOOD + 1).min(axis=1)
    # cut after local minima of the checksum, unless the piece would be too short
    pieces: list[list[int]] = []
    start = 0
    for n in np.flatnonzero(sums == least).tolist():
        if n + 1 - start >= MIN_PIECE_OPERATIONS:
            pieces.append(operations[start : n + 1])
            start = n + 1
    return [*pieces, operations[start:]] if start < len(operations) else pieces


def _checksums(words: Sequence[str]) -> Array:
    """Compute a checksum (n,) of each word together with the `CHECKSUM_LENGTH` - 1 words before it.

    The checksum is the number with the letters of these words as digits in base `CHECKSUM_BASE`, modulo
    `CHECKSUM_MODULUS`. Python's hash() would differ between processes.
    """
    # for each different word: its value as a number, and the factor by which it shifts the words before it
    different = sorted(set(words))
    place_of = {word: k for k, word in enumerate(different)}
    digits = [[*word.encode()] for word in different]
    numbers = [sum(d * CHECKSUM_BASE ** (len(each) - 1 - k) for k, d in enumerate(each)) for each in digits]
    values = [number % CHECKSUM_MODULUS for number in numbers]
    shifts = [CHECKSUM_BASE ** len(each) % CHECKSUM_MODULUS for each in digits]
    places = np.array([place_of[word] for word in words])
    value, shift = np.array(values)[places], np.array(shifts)[places]
    # append the words of the window one after the other, for all places at once
    checksum = np.zeros(len(words), dtype=np.int64)
    for back in range(min(CHECKSUM_LENGTH, len(words)) - 1, -1, -1):
        before = slice(0, len(words) - back)  # the words `back` places before each place
        checksum[back:] = (checksum[back:] * shift[before] + value[before]) % CHECKSUM_MODULUS
    return checksum


def roll(program: Program) -> tuple[list[Piece], list[tuple[Piece, Instance]]]:
    """Divide a program into pieces.

    Returns:
        The different pieces; all instances in order of execution, each with its piece.
    """
    common = _common_constants(program)
    pieces: dict[tuple[Step, ...], Piece] = {}
    order: list[tuple[Piece, Instance]] = []
    step_of_node: dict[int, tuple[Piece, int]] = {}  # piece that computes a node, and number of its step
    used: set[int] = set(program.outputs)  # nodes that other pieces or outputs use
    # pieces of equal structure share one entry
    for nodes in cut(program):
        steps, instance = _structure(program, nodes, common)
        piece = pieces.setdefault(steps, Piece(len(pieces), steps))
        piece.instances.append(instance)
        order.append((piece, instance))
        step_of_node.update({node: (piece, number) for number, node in enumerate(nodes)})
        used.update(instance.values)
    # each piece stores the values that other pieces or outputs use
    for node in sorted(used):
        if node in step_of_node:
            piece, number = step_of_node[node]
            if number not in piece.kept:
                piece.kept.append(number)
    for piece in pieces.values():
        piece.kept.sort()
    return list(pieces.values()), order


def _common_constants(program: Program) -> set[float]:
    """Return the constants that are used often (`MIN_COMMON_FRACTION`) and become part of the code."""
    uses_of_node = Counter(a for op, a, _ in program.nodes if op not in LEAVES)
    uses_of_node.update(b for _, _, b in program.nodes if b >= 0)
    uses_of_value: Counter[float] = Counter()
    for k, (op, value, _) in enumerate(program.nodes):
        if op == "const":
            uses_of_value[value] += uses_of_node[k]
    min_uses = MIN_COMMON_FRACTION * program.operation_count
    return {value for value, uses in uses_of_value.items() if uses >= min_uses}


def _structure(program: Program, nodes: list[int], common: set[float]) -> tuple[tuple[Step, ...], Instance]:
    """Separate some operations into structure, which other instances may share, and data of this instance.

    Args:
        program: program of the operations.
        nodes: indices of the operations.
        common: constants that belong to the structure.
    """
    instance = Instance(nodes, values=[], data=[])
    known: dict[int, Operand] = {node: ("own", number) for number, node in enumerate(nodes)}  # by node
    steps: list[Step] = []
    for node in nodes:
        step_operands: list[Operand] = []
        for operand_node in operands(program.nodes[node]):
            operand = known.get(operand_node)
            if operand is None:
                op, value, _ = program.nodes[operand_node]
                if op != "const":
                    operand = known[operand_node] = "value", len(instance.values)
                    instance.values.append(operand_node)
                elif value in common:
                    operand = known[operand_node] = "literal", value
                else:  # one entry for each use: another instance may have two different constants
                    operand = "data", len(instance.data)
                    instance.data.append(value)
            step_operands.append(operand)
        steps.append((program.nodes[node][0], tuple(step_operands)))
    return tuple(steps), instance


def emit_rolled(program: Program, name: str, lanes: int = 1) -> str:
    """Write a program as a loop over its pieces.

    The result is the LLVM text of a function void name(double *x, double *y, int64_t on), which writes the
    outputs at the inputs x to y (`newton_euler.codegen.emit.Emitter`).

    Args:
        program: program to write.
        name: name of the LLVM function.
        lanes: number of inputs that a call takes at once, as vectors. The function writes the outputs of lane
            i if bit i of `on` is 1; code of one lane ignores `on`.
    """
    pieces, order = roll(program)
    # lay out the array of values: inputs, stored results of all instances, constants among the outputs
    place = {k: int(a) for k, (op, a, _) in enumerate(program.nodes) if op == "input"}  # by node
    size = program.inputs
    starts = []  # index of the first stored result of each instance
    for piece, instance in order:
        starts.append(size)
        for number, step in enumerate(piece.kept):
            place[instance.nodes[step]] = size + number
        size += len(piece.kept)
    constant_outputs = [k for k in dict.fromkeys(program.outputs) if program.nodes[k][0] == "const"]
    for k in constant_outputs:
        place[k] = size
        size += 1

    # tables of what each instance takes: indices of values, and rare constants
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
    for k in constant_outputs:
        constants.store(f"%c{k}", constant(program.nodes[k][1], lanes), "%v", place[k])
    bodies = [_emit_piece(piece, name, place, lanes) for piece in pieces]
    mask_lines, store_lines = Instructions(lanes), Instructions(lanes)
    store_lines.store("%o.to", "%o.value", "%y", "%o", mask_lines.mask("%mask", "%on"))
    loops = _LOOPS.format(
        name=name,
        arguments=ARGUMENTS,
        t=vector_type("double", lanes),
        nan=constant(math.nan, lanes),
        mask="\n".join(mask_lines.lines),
        give="\n".join(store_lines.lines),
        bytes=8 * lanes * size,
        constants="\n".join(constants.lines),
        inputs=len(used),
        instances=len(order),
        outputs=len(program.outputs),
    )
    return "\n".join([*tables, *bodies, loops])


def _table(kind: str, name: str, entries: Sequence[object]) -> str:
    """Return the LLVM text of a constant array, whose elements have the LLVM type `kind`."""
    content = ", ".join(f"{kind} {entry}" for entry in entries)
    return f"@{name} = private constant [{len(entries)} x {kind}] [{content}]"


def _emit_piece(piece: Piece, name: str, place: dict[int, int], lanes: int) -> str:
    """Write a piece as an LLVM function of four pointers.

    The pointers are the array of values, indices of the piece's arguments in this array, data, and results.
    If the piece has only one instance, its indices and data are in the code.

    Args:
        piece: piece to write.
        name: name of the LLVM function of the program.
        place: index of each node in the array of values.
        lanes: number of inputs that a call takes at once.
    """
    out = Instructions(lanes)
    known: dict[Operand, str] = {}  # LLVM operand of each operand that is loaded or computed
    first, *others = piece.instances

    def operand(key: Operand) -> str:
        """Return the LLVM operand of an operand, and load it if it is used for the first time."""
        kind, number = key
        if kind == "literal":
            return constant(number, lanes)
        if kind == "data" and not others:
            return constant(first.data[int(number)], lanes)
        if key not in known:
            if kind == "data":
                # the same in all lanes
                known[key] = out.load_shared(f"%d{number}", "%data", int(number))
            elif not others:
                known[key] = out.load(f"%v{number}", "%v", place[first.values[int(number)]])
            else:
                out.lines.append(f"  %p{number}.at = getelementptr i32, ptr %places, i64 {number}")
                out.lines.append(f"  %p{number} = load i32, ptr %p{number}.at")
                out.lines.append(f"  %q{number} = zext i32 %p{number} to i64")
                known[key] = out.load(f"%v{number}", "%v", f"%q{number}")
        return known[key]

    for number, (op, step_operands) in enumerate(piece.steps):
        given = [operand(key) for key in step_operands]
        second = given[1] if len(given) > 1 else None
        known["own", number] = out.operation(f"%n{number}", op, given[0], second)
    for number, step in enumerate(piece.kept):
        out.store(f"%k{number}", known["own", step], "%results", number)
    head = (
        f"define private void @{name}.{piece.number}(ptr %v, ptr noalias readonly %places, "
        "ptr noalias readonly %data, ptr noalias writeonly %results) noinline {"
    )
    return "\n".join([head, *out.lines, "  ret void\n}"])


# The function of the program: allocate the array of values; fill all results with NaN if that fails. Copy the
# inputs and the constants, call the function of each instance, and copy the outputs to y.
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
