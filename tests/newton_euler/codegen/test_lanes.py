"""Native functions side by side: each lane computes what scalar code does, to the last bit."""

from __future__ import annotations

import gc
from dataclasses import dataclass
from math import sqrt
from weakref import ref

import numpy as np
import pytest
from test_expression import everything, traced

from newton_euler.codegen.compile import NativeFunction, Traced, lane_count
from newton_euler.codegen.emit import emit_straight
from newton_euler.codegen.native import Callback, NativeError, Record, Shared, Vector, native
from newton_euler.codegen.native_functions import NativeFunctions
from newton_euler.codegen.rolled import emit_rolled
from newton_euler.codegen.translate import text

LANES = lane_count()

TABLE = (0.5, -2.0, 3.0, 0.0)

SIZE = 6


@dataclass(frozen=True, eq=False)
class Row(Record):
    """Numbers, vectors by lanes and shared, and a program y = f(x)."""

    n: int
    slope: float
    y: Vector
    shared: Shared
    f: Callback


@native
def both_sides(row: Row, x: Vector) -> None:
    y = row.y
    y[0] = 1.0
    if x[0] > 0.0:
        y[0] = x[1] * x[2] + y[1]
        if x[1] > 0.0 and not x[2] > 0.5:
            y[1] = -x[0]
        elif x[2] > 0.0 or x[3] > 0.0:
            y[2] = 7.0
    else:
        y[0] -= x[3] * x[0]
        y[3] = 2.0 if x[1] > 0.0 else x[2]


@native
def by_value(row: Row, x: Vector) -> None:
    """Variables that vary from where they are first given a value, and later ones."""
    kind = 0
    total = 1.5
    if x[0] > 0.0:
        kind = 1
        total += x[1]
    n = row.n
    if n > 2:
        total = total * row.slope + x[2] * x[3]
    row.y[0] = total
    row.y[1] = float(kind + n)
    row.y[2] = x[kind]
    row.y[kind + 3] = TABLE[kind] + TABLE[n - 2]


@native
def rounds(row: Row, x: Vector) -> None:
    """Loops that lanes leave at different times, in each way."""
    k = 0
    while k < row.n and x[k] < 1.0:
        row.y[0] += x[k]
        k += 1
    row.y[1] = float(k)
    count = int(abs(x[0]) * 10.0)
    for i in range(1, count):
        if i == 7:
            break
        if x[1] > 0.0:
            continue
        row.y[2] += 1.0 / i
    for i in range(row.n):
        before = row.y[i]
        for j in range(i, row.n):
            if x[j] > 0.3:
                row.y[i] += x[j]
                if x[i] > 0.0:
                    break
                continue
            row.y[i] -= 0.5 * x[j]
        row.y[i] += before
    while row.n < 100:
        k += 1
        if x[2] * k > 1.0 or k > 20:
            break
    row.y[3] = float(k)


@native
def early(row: Row, x: Vector, i: int) -> int:
    for k in range(row.n):
        if x[k] > 1.0:
            row.y[k] = 5.0
            return k + i
        row.y[k] += 1.0
    if row.n > 100:
        return -1
    while x[i] < 10.0:
        x[i] += 1.0 + x[0] * x[0]
        if x[i] > 8.0:
            return 100
    return 200


@native
def tail(x: Vector, y: Vector) -> float:
    x[0] += 1.0
    if y[0] < 0.0:
        return sqrt(-y[0])
    return max(min(y[1], 2.0), x[0])


@native
def calls(row: Row, x: Vector) -> None:
    """Calls by some lanes, with places of their own in vectors."""
    which = early(row, x, 1)
    which = early(row, x, which) if which < 2 else which
    if x[0] > 0.0:
        row.y[4] = tail(x[1:], row.y)
        which = 1
    else:
        which = 2 if x[1] > 0.0 else 0
    row.y[5] = tail(x[which:], row.y[which + 1 :]) ** 0.3
    here = row.shared[SIZE * which :]
    row.y[0] += here[1] + here[which] + row.shared[2]


@native
def programs(row: Row, x: Vector) -> None:
    if x[0] > 0.0:
        row.f(x, row.y)
    else:
        row.f(x[1:], row.y[2:])


def scalar_and_lanes(function, seed: int, f=None) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Vectors x and y after a function, of each lane alone and of all."""
    rng = np.random.default_rng(seed)
    x, y = 1.2 * rng.standard_normal((2, SIZE, LANES))
    shared = rng.standard_normal(4 * SIZE)
    alone = []
    for lane in range(LANES):
        own = [np.ascontiguousarray(each[:, lane]) for each in (x, y)]
        row = Row(4, 0.7, own[1], shared, f and NativeFunction(lambda: Traced(f)))
        NativeFunctions([function])(function, row, own[0])
        alone.append(own)
    row = Row(4, 0.7, y, shared, f and NativeFunction(lambda: Traced(f, many=True, lanes=LANES)))
    NativeFunctions([function], in_lanes=True)(function, row, x)
    return [np.stack(each, axis=1) for each in zip(*alone, strict=True)], [x, y]


def test_bound_functions_keep_their_code():
    """Of a thread that compiled what another one keeps it is all that is left."""
    x, row = np.ones(SIZE), Row(4, 0.7, np.zeros(SIZE), np.zeros(4 * SIZE), None)
    functions = NativeFunctions([both_sides])
    bound, known = functions.bind(both_sides, row, x), ref(functions)
    del functions
    gc.collect()
    assert known() is not None
    bound()
    assert row.y[0] == 1.0  # 1 * 1 + 0


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("function", [both_sides, by_value, rounds, calls])
def test_lanes_are_what_each_is_alone(function, seed):
    for alone, together in zip(*scalar_and_lanes(function, seed), strict=True):
        assert np.array_equal(alone, together, equal_nan=True)


@pytest.mark.parametrize("seed", range(5))
def test_programs_change_the_lanes_that_call_them(seed):
    program = traced(lambda *x: everything(*x[:3])[:2], 3)
    for alone, together in zip(*scalar_and_lanes(programs, seed, program), strict=True):
        assert np.array_equal(alone, together, equal_nan=True)


@pytest.mark.parametrize("emit", [emit_straight, emit_rolled])
def test_programs_are_the_same_in_lanes(emit, monkeypatch):
    """Written out and rolled, with angles that polynomials do not reach in one lane."""
    monkeypatch.setattr("newton_euler.codegen.compile.MIN_ROLLED_SIZE", 1 if emit is emit_rolled else 10**9)
    program = traced(everything, 3)
    single = NativeFunction(lambda: Traced(program))
    many = NativeFunction(lambda: Traced(program, many=True, lanes=LANES))
    given = np.random.default_rng(0).standard_normal((3, LANES))
    given[1, 2] *= 1e7
    alone = np.stack([single(np.ascontiguousarray(lane)) for lane in given.T], axis=1)
    assert many.lanes == LANES > single.lanes
    assert np.array_equal(many(given), alone)


@native
def writes_one_place(shared: Shared, x: Vector) -> None:
    shared[0] = x[0]


@native
def loses_its_count(x: Vector) -> None:
    for k in range(3):
        if x[k] > 0.0:
            break
    x[0] = float(k)


@native
def has_two_vectors(x: Vector, y: Vector) -> None:
    here = x[1:]
    here = y[1:]
    here[0] = 1.0


@native
def divides(x: Vector) -> None:
    x[0] = float(int(x[0]) // int(x[1]))


@pytest.mark.parametrize("function", [writes_one_place, loses_its_count, has_two_vectors, divides])
def test_what_lanes_cannot_do_is_refused(function):
    with pytest.raises(NativeError, match=function.__name__):
        text([function], LANES)
