"""Large programs as loops: the same numbers as straight-line code, and repetition found."""

from __future__ import annotations

import numpy as np
import pytest

import newton_euler.codegen.compile
from newton_euler.codegen.compile import NativeFunction, Traced
from newton_euler.codegen.expression import Graph, Program, operands
from newton_euler.codegen.rolled import MIN_PIECE_OPERATIONS, cut, roll
from newton_euler.runs.assemble import initial_state


def windows(count: int, distinct: bool) -> Program:
    """A row of equal cells, each a hundred operations on its own inputs and on the cell before."""
    graph = Graph()
    x = graph.variables(3 * count)
    before = x[0]
    outputs = []
    for k in range(count):
        a, b, c = x[3 * k : 3 * k + 3]
        weight = 1.5 + k if distinct else 1.5
        for n in range(12):
            a, b, c = 0.3 * a * b + 0.1 * before, (b - 0.2 * c).sin() / weight, (c - a) / (2.5 + a * a + n)
        before = a + b.cos() * c
        outputs.extend([before, c])
    return graph.prune([*outputs, 7.0, x[1]])


@pytest.mark.parametrize("distinct", [False, True])
def test_rolled_code_computes_what_straight_line_code_does(distinct, monkeypatch):
    program = windows(40, distinct)
    x = np.random.default_rng(0).uniform(-1.0, 1.0, program.inputs)
    straight = NativeFunction(lambda: Traced(program))(x)
    monkeypatch.setattr(newton_euler.codegen.compile, "MIN_ROLLED_SIZE", 1)
    # the same operations in the same order; which products are fused with sums may differ
    assert NativeFunction(lambda: Traced(program))(x) == pytest.approx(straight, rel=1e-14, abs=1e-15)
    assert straight == pytest.approx(program.run(x), rel=1e-13, abs=1e-14)


@pytest.mark.parametrize("distinct", [False, True])
def test_repetition_is_found(distinct):
    few, many = (len(roll(windows(count, distinct))[0]) for count in (50, 200))
    assert many == few  # kinds of pieces do not grow with their number


def test_pieces_make_up_the_program():
    program = windows(20, distinct=True)
    pieces = cut(program)
    assert [k for piece in pieces for k in piece] == [k for k, n in enumerate(program.nodes) if operands(n)]
    assert all(len(piece) >= MIN_PIECE_OPERATIONS for piece in pieces[:-1])


@pytest.mark.slow
def test_a_large_scene_is_the_same_rolled_or_not(monkeypatch):
    from crosscheck.library import load
    from newton_euler import compile_scene

    scene = load("four_bar", N="6")
    straight = compile_scene(scene)
    monkeypatch.setattr(newton_euler.codegen.compile, "MIN_ROLLED_SIZE", 1)
    rolled = compile_scene(scene)
    x = straight.packed(*straight.system.coordinates(initial_state(scene)))
    for name, function in straight.functions.items():
        expected = function(x) if function.lanes == 1 else function(np.repeat(x[:, None], 4, axis=1))[:, 2]
        difference = rolled.functions[name](x) - expected
        assert np.abs(difference).max() <= 1e-13 * np.abs(expected).max(), name
