"""Traced scalars: arithmetic that records itself.

The equations of this package, run over `Expression` instead of float, leave a `Graph` of what they
computed. Constants fold while it grows, zeros and ones vanish, and an operation that was done before
is found again instead of repeated. What no requested output reaches is dropped by `Graph.prune`.

Folding follows real arithmetic, not floating-point arithmetic to the last bit: x * 0 is 0, and
constants that multiply one after the other are multiplied together first.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from newton_euler.scalars import Array

COMMUTATIVE = frozenset({"add", "mul", "minimum"})

UNARY: dict[str, Callable[[float], float]] = {
    "neg": lambda a: -a,
    "sqrt": math.sqrt,
    "sin": math.sin,
    "cos": math.cos,
}
BINARY: dict[str, Callable[[float, float], float]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "arctan2": math.atan2,
    "minimum": min,
}
"""What each operation means; node operands are indices of earlier nodes."""


class Node(NamedTuple):
    """One operation: its name and operands, or ("const", value) or ("input", number)."""

    op: str
    a: Any
    b: int = -1


class Graph:
    """Operations in the order in which they can be done.

    Attributes:
        nodes: every operation; operands come before what uses them.
        inputs: number of inputs.
    """

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self.inputs = 0
        self._known: dict[Node, int] = {}

    def variables(self, count: int) -> Array:
        """(count,) new inputs."""
        first = self.inputs
        self.inputs += count
        return _objects([Expression(self, self._add(Node("input", first + k))) for k in range(count)])

    def constant(self, value: float) -> Expression:
        return Expression(self, self._add(Node("const", float(value))))

    def index(self, scalar: Expression | float) -> int:
        """The node of a scalar, a float becoming a constant."""
        return scalar.index if isinstance(scalar, Expression) else self.constant(scalar).index

    def _add(self, node: Node) -> int:
        found = self._known.get(node)
        if found is None:
            found = self._known[node] = len(self.nodes)
            self.nodes.append(node)
        return found

    def value(self, index: int) -> float | None:
        """The value of a constant node, else None."""
        node = self.nodes[index]
        return node.a if node.op == "const" else None

    def unary(self, op: str, a: int) -> Expression | float:
        value = self.value(a)
        if value is not None:
            return UNARY[op](value)
        node = self.nodes[a]
        if node.op == "neg" and op != "sqrt":
            inner = Expression(self, node.a)  # --x = x, cos(-x) = cos x, sin(-x) = -sin x
            if op == "neg":
                return inner
            return inner.cos() if op == "cos" else -inner.sin()
        return Expression(self, self._add(Node(op, a)))

    def binary(self, op: str, a: int, b: int) -> Expression | float:
        x, y = self.value(a), self.value(b)
        if x is not None and y is not None:
            return BINARY[op](x, y)
        return _SIMPLER[op](self, a, b, x, y) if op in _SIMPLER else self.record(op, a, b)

    def record(self, op: str, a: int, b: int) -> Expression:
        """An operation as it is, operands of commutative ones in one order."""
        if op in COMMUTATIVE and b < a:
            a, b = b, a
        return Expression(self, self._add(Node(op, a, b)))

    def negated(self, index: int) -> int | None:
        """x for a node -x, else None."""
        node = self.nodes[index]
        return node.a if node.op == "neg" else None

    def prune(self, outputs: Iterable[Any]) -> Program:
        """The operations that these outputs (scalars) need, and nothing else."""
        roots = [self.index(scalar) for scalar in outputs]
        needed = set(roots)
        for index in range(len(self.nodes) - 1, -1, -1):
            if index in needed:
                needed.update(operands(self.nodes[index]))
        kept = sorted(needed)
        place = {index: k for k, index in enumerate(kept)}
        nodes = []
        for index in kept:
            op, a, b = self.nodes[index]
            if op in BINARY:
                nodes.append(Node(op, place[a], place[b]))
            else:
                nodes.append(Node(op, place[a] if op in UNARY else a))
        return Program(tuple(nodes), self.inputs, tuple(place[root] for root in roots))


def operands(node: Node) -> tuple[int, ...]:
    """Indices of the nodes that a node uses."""
    if node.op in BINARY:
        return (node.a, node.b)
    return (node.a,) if node.op in UNARY else ()


class Program(NamedTuple):
    """A pruned graph: what to compute, in order, and which nodes are the outputs."""

    nodes: tuple[Node, ...]
    inputs: int
    outputs: tuple[int, ...]

    def counts(self) -> Counter[str]:
        """Operations by name, without constants and inputs."""
        return Counter(node.op for node in self.nodes if operands(node))

    @property
    def operations(self) -> int:
        """Floating-point operations; changes of sign do not count, as machines fold them away."""
        return sum(count for op, count in self.counts().items() if op != "neg")

    def run(self, inputs: Sequence[float]) -> Array:
        """(outputs,) by plain Python, the meaning that native code is tested against."""
        values: list[float] = []
        for op, a, b in self.nodes:
            if op in BINARY:
                values.append(BINARY[op](values[a], values[b]))
            elif op in UNARY:
                values.append(UNARY[op](values[a]))
            else:
                values.append(a if op == "const" else float(inputs[a]))
        return np.array([values[k] for k in self.outputs])


class Expression:
    """A scalar that is a node of a graph."""

    __slots__ = ("graph", "index")

    def __init__(self, graph: Graph, index: int) -> None:
        self.graph = graph
        self.index = index

    def _with(self, op: str, other: Any, swap: bool = False) -> Any:
        if not isinstance(other, Expression | float | int):
            return NotImplemented
        a, b = self.index, self.graph.index(other)
        return self.graph.binary(op, b, a) if swap else self.graph.binary(op, a, b)

    def __add__(self, other: Any) -> Any:
        return self._with("add", other)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        return self._with("sub", other)

    def __rsub__(self, other: Any) -> Any:
        return self._with("sub", other, swap=True)

    def __mul__(self, other: Any) -> Any:
        return self._with("mul", other)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Any:
        return self._with("div", other)

    def __rtruediv__(self, other: Any) -> Any:
        return self._with("div", other, swap=True)

    def __neg__(self) -> Any:
        return self.graph.unary("neg", self.index)

    def __pos__(self) -> Expression:
        return self

    def sqrt(self) -> Any:
        return self.graph.unary("sqrt", self.index)

    def sin(self) -> Any:
        return self.graph.unary("sin", self.index)

    def cos(self) -> Any:
        return self.graph.unary("cos", self.index)

    def arctan2(self, other: Any) -> Any:
        return self._with("arctan2", other)

    def minimum(self, other: Any) -> Any:
        return self._with("minimum", other)

    def __repr__(self) -> str:
        return f"Expression({self.graph.nodes[self.index]})"


# Simplifications; x and y are the operands' values where they are constants.


def _add(graph: Graph, a: int, b: int, x: float | None, y: float | None) -> Expression:
    if x == 0.0:
        return Expression(graph, b)
    if y == 0.0:
        return Expression(graph, a)
    minus = graph.negated(b)
    if minus is not None:
        return graph.binary("sub", a, minus)  # type: ignore[return-value]
    minus = graph.negated(a)
    if minus is not None:
        return graph.binary("sub", b, minus)  # type: ignore[return-value]
    return graph.record("add", a, b)


def _sub(graph: Graph, a: int, b: int, x: float | None, y: float | None) -> Expression | float:
    if a == b:
        return 0.0
    if y == 0.0:
        return Expression(graph, a)
    if x == 0.0:
        return graph.unary("neg", b)
    minus = graph.negated(b)
    if minus is not None:
        return graph.binary("add", a, minus)
    minus = graph.negated(a)
    if minus is not None:
        return -graph.binary("add", minus, b)
    return graph.record("sub", a, b)


def _mul(graph: Graph, a: int, b: int, x: float | None, y: float | None) -> Expression | float:
    if y is not None:
        a, b, x, y = b, a, y, x
    if x == 0.0:
        return 0.0
    if x == 1.0:
        return Expression(graph, b)
    if x == -1.0:
        return graph.unary("neg", b)
    minus = graph.negated(b)
    if minus is not None:
        if x is not None:
            return graph.binary("mul", graph.constant(-x).index, minus)
        return -graph.binary("mul", a, minus)
    minus = graph.negated(a)
    if minus is not None:
        return -graph.binary("mul", minus, b)
    if x is not None and graph.nodes[b].op == "mul":  # c (d z) = (c d) z
        for factor, rest in (operands(graph.nodes[b]), operands(graph.nodes[b])[::-1]):
            known = graph.value(factor)
            if known is not None:
                return graph.binary("mul", graph.constant(x * known).index, rest)
    return graph.record("mul", a, b)


def _minimum(graph: Graph, a: int, b: int, x: float | None, y: float | None) -> Expression:
    if x == math.inf or a == b:
        return Expression(graph, b)
    return Expression(graph, a) if y == math.inf else graph.record("minimum", a, b)


def _div(graph: Graph, a: int, b: int, x: float | None, y: float | None) -> Expression | float:
    if x == 0.0:
        return 0.0
    if y is not None:
        return graph.binary("mul", a, graph.constant(1.0 / y).index)
    return graph.record("div", a, b)


_SIMPLER = {"minimum": _minimum, "add": _add, "sub": _sub, "mul": _mul, "div": _div}


def _objects(scalars: Sequence[Any]) -> Array:
    """An object array of scalars, which NumPy must not look into."""
    array = np.empty(len(scalars), dtype=object)
    array[:] = scalars
    return array


def differentiate(graph: Graph, outputs: Sequence[Any], variables: Sequence[Expression]) -> Array:
    """(outputs, variables) partial derivatives, forward mode, as scalars of the same graph."""
    columns = []
    for variable in variables:
        rates: dict[int, Any] = {variable.index: 1.0}
        for index in range(variable.index + 1, max((graph.index(o) for o in outputs), default=0) + 1):
            rate = _rate(graph, index, rates)
            if not isinstance(rate, float) or rate != 0.0:
                rates[index] = rate
        columns.append([rates.get(graph.index(output), 0.0) for output in outputs])
    table = np.empty((len(outputs), len(columns)), dtype=object)
    for k, column in enumerate(columns):
        table[:, k] = column
    return table


def _rate(graph: Graph, index: int, rates: dict[int, Any]) -> Any:
    """Derivative of a node by the chain rule, from those of its operands."""
    node = graph.nodes[index]
    ends = operands(node)
    if not any(end in rates for end in ends):
        return 0.0
    da = rates.get(ends[0], 0.0)
    a, itself = Expression(graph, ends[0]), Expression(graph, index)
    if node.op == "neg":
        return -da
    if node.op == "sqrt":
        return 0.5 * da / itself
    if node.op == "sin":
        return a.cos() * da
    if node.op == "cos":
        return -a.sin() * da
    b, db = Expression(graph, ends[1]), rates.get(ends[1], 0.0)
    if node.op == "add":
        return da + db
    if node.op == "sub":
        return da - db
    if node.op == "mul":
        return da * b + a * db
    if node.op == "div":
        return (da - itself * db) / b
    return (b * da - a * db) / (a * a + b * b)  # arctan2
