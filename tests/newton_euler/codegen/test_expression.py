"""Traced scalars: what folds, what is shared, what is dropped, and derivatives."""

from __future__ import annotations

import math

import numpy as np
import pytest
from finite_difference import jacobian

from newton_euler.codegen.expression import Expression, Graph, differentiate, substitute
from newton_euler.scalars import arctan2, cos, minimum, sin, sqrt


def traced(function, count):
    """A function of `count` scalars as a program."""
    graph = Graph()
    return graph.prune(function(*graph.variables(count)))


@pytest.mark.parametrize(
    ("function", "operations"),
    [
        (lambda x, y: [0.0 * x + y], 0),
        (lambda x, y: [1.0 * x, x / 1.0, x + 0.0, x - 0.0, 0.0 - (0.0 - x)], 0),
        (lambda x, y: [x - x, 0.0 / y], 0),
        (lambda x, y: [x * y, y * x], 1),  # one order of operands
        (lambda x, y: [x - y, -(y - x) + 0.0], 2),
        (lambda x, y: [2.0 * (3.0 * x)], 1),
        (lambda x, y: [(-x) * (-y)], 1),
        (lambda x, y: [sin(-x), sin(x), cos(x), cos(-x)], 2),
        (lambda x, y: [x / 4.0, 0.25 * x], 1),
        (lambda x, y: [minimum(math.inf, x)], 0),
    ],
)
def test_operations_that_need_not_be_done(function, operations):
    program = traced(function, 2)
    assert program.operation_count == operations
    values = [0.7, -1.3]
    assert program.run(values) == pytest.approx([float(v) for v in function(*map(np.float64, values))])


def test_constants_fold_to_floats():
    graph = Graph()
    x = graph.variables(1)[0]
    assert x * 0.0 == 0.0
    assert isinstance(x - x, float)
    assert isinstance(2.0 * x, Expression)


def test_what_no_output_reaches_is_dropped():
    graph = Graph()
    x, y = graph.variables(2)
    wanted, _ = sin(x) * y, sqrt(x * x + y * y) / cos(y)
    program = graph.prune([wanted])
    assert program.counts() == {"sin": 1, "mul": 1}
    assert len(program.nodes) == 4


def everything(x, y, z):
    a = sin(x * y) + cos(z) / (2.0 + x * x)
    b = sqrt(1.0 + y * y) - arctan2(x, 2.0 + z)
    return [a * b, -a + 3.0 * z, minimum(a, b + 10.0), 1.0 / (b + 5.0)]


def test_arrays_of_traced_scalars_are_arrays():
    graph = Graph()
    m = graph.variables(9).reshape(3, 3)
    constant = np.arange(9.0).reshape(3, 3)
    program = graph.prune((m @ constant - constant @ m).ravel())
    values = np.linspace(-1.0, 2.0, 9)
    expected = values.reshape(3, 3) @ constant - constant @ values.reshape(3, 3)
    assert program.run(values) == pytest.approx(expected.ravel(), rel=1e-14)


def test_derivatives_by_finite_differences():
    graph = Graph()
    variables = graph.variables(3)
    at = np.array([0.4, -0.8, 1.1])

    def without_minimum(x, y, z):
        values = everything(x, y, z)
        return [values[0], values[1], values[3]]

    table = differentiate(graph, without_minimum(*variables), list(variables))
    analytic = graph.prune(table.ravel()).run(at).reshape(3, 3)
    plain = traced(without_minimum, 3)
    # see finite_difference.jacobian
    assert np.allclose(analytic, jacobian(lambda x: plain.run(at + x), 3), atol=1e-11)


def test_scalars_are_put_in_place_of_variables():
    graph = Graph()
    x, y, held = graph.variables(3)
    found = substitute(graph, [x * held - y / held, x + y, -held, 3.0], [held], [x * y])
    assert graph.prune(found).run([2.0, 5.0, 0.0]) == pytest.approx([19.5, 7.0, -10.0, 3.0], rel=1e-15)


def test_programs_mean_what_floats_do():
    rng = np.random.default_rng(0)
    program = traced(everything, 3)
    for _ in range(20):
        values = rng.standard_normal(3)
        expected = [float(v) for v in everything(*map(np.float64, values))]
        assert program.run(values) == pytest.approx(expected, rel=1e-14, abs=1e-15)


def test_constants_of_a_product_meet_whatever_came_first():
    graph = Graph()
    x, y = graph.variables(2)
    early = 3.0 * x  # 3.0 is a node before x y is
    program = graph.prune([early, 2.0 * (3.0 * (x * y)), 2.0 * (y * 5.0)])
    assert program.run([0.5, 7.0]) == pytest.approx([1.5, 21.0, 70.0], rel=1e-15)
    assert program.operation_count == 4
