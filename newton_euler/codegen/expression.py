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
from operator import itemgetter
from typing import Any, NamedTuple

import numpy as np

from newton_euler.scalars import NUMBERS, Array, objects

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
"""Meaning of each operation; node operands are indices of earlier nodes."""


LEAVES = frozenset({"const", "input"})
"""Nodes that are no operations."""

Node = tuple[str, Any, int]
"""One operation: its name and two operands, the second -1 if there is none, or ("const", value, -1) or
("input", number, -1). There are hundreds of thousands, and named tuples would take longer to make."""


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
        self._constants: dict[int, float] = {}
        self._negated: dict[int, int] = {}

    def variables(self, count: int) -> Array:
        """Add inputs (count,)."""
        first = self.inputs
        self.inputs += count
        return objects([self.record("input", first + k) for k in range(count)])

    def constant(self, value: float) -> int:
        """Return the node of a constant."""
        index = self.record("const", float(value)).index
        self._constants[index] = float(value)
        return index

    def index(self, scalar: Expression | float) -> int:
        """Return the node of a scalar, a float becoming a constant."""
        return scalar.index if isinstance(scalar, Expression) else self.constant(scalar)

    def scalar(self, index: int) -> Any:
        """Return the scalar at a node: a float if it is a constant."""
        value = self._constants.get(index)
        return Expression(self, index) if value is None else value

    def record(self, op: str, a: Any, b: int = -1) -> Expression:
        """Record an operation, found again if it was done before; operands of sums and products in one
        order."""
        if b < a and op in COMMUTATIVE:
            a, b = b, a
        node = (op, a, b)
        found = self._known.get(node)
        if found is None:
            found = self._known[node] = len(self.nodes)
            self.nodes.append(node)
        return Expression(self, found)

    def neg(self, a: int) -> Expression:
        inner = self._negated.get(a)
        if inner is not None:  # --x = x
            return Expression(self, inner)
        found = self.record("neg", a)
        self._negated[found.index] = a
        return found

    def sin(self, a: int) -> Expression:
        inner = self._negated.get(a)  # sin(-x) = -sin x
        return self.record("sin", a) if inner is None else self.neg(self.sin(inner).index)

    def cos(self, a: int) -> Expression:
        inner = self._negated.get(a)  # cos(-x) = cos x
        return self.record("cos", a if inner is None else inner)

    def add(self, a: int, b: int) -> Any:
        negated = self._negated
        if b in negated:
            return self.sub(a, negated[b])
        return self.sub(b, negated[a]) if a in negated else self.record("add", a, b)

    def sub(self, a: int, b: int) -> Any:
        if a == b:
            return 0.0
        negated = self._negated
        if b in negated:
            return self.add(a, negated[b])
        return -self.add(negated[a], b) if a in negated else self.record("sub", a, b)

    def mul(self, a: int, b: int) -> Any:
        negated = self._negated
        if b in negated:
            return -self.mul(a, negated[b])
        return -self.mul(negated[a], b) if a in negated else self.record("mul", a, b)

    def scale(self, x: float, b: int) -> Any:
        """Multiply a node by a constant, neither 0 nor 1."""
        if x == -1.0:
            return self.neg(b)
        minus = self._negated.get(b)
        if minus is not None:
            return self.scale(-x, minus)
        op, first, second = self.nodes[b]
        if op == "mul":  # c (d z) = (c d) z
            known = self._constants.get(first)
            if known is not None:
                return _scaled(self, x * known, second)
            known = self._constants.get(second)
            if known is not None:
                return _scaled(self, x * known, first)
        return self.record("mul", self.constant(x), b)

    def ancestors(self, roots: Iterable[int]) -> list[int]:
        """Find the nodes that these nodes need, themselves included, in order."""
        needed = bytearray(len(self.nodes))
        for root in roots:
            needed[root] = True
        for index in range(len(self.nodes) - 1, -1, -1):
            if needed[index]:
                op, a, b = self.nodes[index]
                if b >= 0:
                    needed[a] = needed[b] = True
                elif op not in LEAVES:
                    needed[a] = True
        return [index for index, is_needed in enumerate(needed) if is_needed]

    def prune(self, outputs: Iterable[Any]) -> Program:
        """Keep the operations that these outputs (scalars) need, and nothing else."""
        roots = [self.index(scalar) for scalar in outputs]
        kept = self.ancestors(roots)
        place = {index: k for k, index in enumerate(kept)}
        nodes: list[Node] = []
        for index in kept:
            op, a, b = self.nodes[index]
            if b >= 0:
                nodes.append((op, place[a], place[b]))
            else:
                nodes.append((op, a if op in LEAVES else place[a], b))
        return Program(tuple(nodes), self.inputs, tuple(place[root] for root in roots))


def operands(node: Node) -> tuple[int, ...]:
    """Return the indices of the nodes that a node uses."""
    op, a, b = node
    if b >= 0:
        return (a, b)
    return () if op in LEAVES else (a,)


class Program(NamedTuple):
    """A pruned graph: operations in order, and the nodes that are outputs."""

    nodes: tuple[Node, ...]
    inputs: int
    outputs: tuple[int, ...]

    def counts(self) -> Counter[str]:
        """Count operations by name, without constants and inputs."""
        counts = Counter(map(itemgetter(0), self.nodes))
        return Counter({op: count for op, count in counts.items() if op not in LEAVES})

    @property
    def operations(self) -> int:
        """Floating-point operations; changes of sign do not count, as machines fold them away."""
        return sum(count for op, count in self.counts().items() if op != "neg")

    def run(self, inputs: Sequence[float]) -> Array:
        """Evaluate the outputs (outputs,) by plain Python, the meaning that native code is tested against."""
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

    def __add__(self, other: Any) -> Any:
        if type(other) is Expression:
            return self.graph.add(self.index, other.index)
        if not isinstance(other, NUMBERS):
            return NotImplemented
        return self if other == 0.0 else self.graph.add(self.index, self.graph.constant(other))

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        if type(other) is Expression:
            return self.graph.sub(self.index, other.index)
        if not isinstance(other, NUMBERS):
            return NotImplemented
        return self if other == 0.0 else self.graph.sub(self.index, self.graph.constant(other))

    def __rsub__(self, other: Any) -> Any:
        if not isinstance(other, NUMBERS):
            return NotImplemented
        return -self if other == 0.0 else self.graph.sub(self.graph.constant(other), self.index)

    def __mul__(self, other: Any) -> Any:
        if type(other) is Expression:
            return self.graph.mul(self.index, other.index)
        return _scaled(self.graph, other, self.index) if isinstance(other, NUMBERS) else NotImplemented

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> Any:
        if type(other) is Expression:
            return self.graph.record("div", self.index, other.index)
        return self * (1.0 / other) if isinstance(other, NUMBERS) else NotImplemented

    def __rtruediv__(self, other: Any) -> Any:
        if not isinstance(other, NUMBERS):
            return NotImplemented
        return 0.0 if other == 0.0 else self.graph.record("div", self.graph.constant(other), self.index)

    def __neg__(self) -> Expression:
        return self.graph.neg(self.index)

    def __pos__(self) -> Expression:
        return self

    def sqrt(self) -> Expression:
        return self.graph.record("sqrt", self.index)

    def sin(self) -> Expression:
        return self.graph.sin(self.index)

    def cos(self) -> Expression:
        return self.graph.cos(self.index)

    def arctan2(self, other: Any) -> Expression:
        return self.graph.record("arctan2", self.index, self.graph.index(other))

    def minimum(self, other: Any) -> Expression:
        if isinstance(other, NUMBERS) and other == math.inf:
            return self
        other = self.graph.index(other)
        return self if other == self.index else self.graph.record("minimum", self.index, other)

    def __repr__(self) -> str:
        return f"Expression({self.graph.nodes[self.index]})"


def _scaled(graph: Graph, x: float, b: int) -> Expression | float:
    """Multiply a node by any constant."""
    if x == 0.0:
        return 0.0
    return Expression(graph, b) if x == 1.0 else graph.scale(x, b)


def differentiate(graph: Graph, outputs: Sequence[Any], variables: Sequence[Expression]) -> Array:
    """Differentiate, forward mode: partial derivatives (outputs, variables) as scalars of the same graph."""
    roots = [graph.index(output) for output in outputs]
    needed = graph.ancestors(roots)
    table = np.zeros((len(outputs), len(variables)), dtype=object)
    for column, variable in enumerate(variables):
        table[:, column] = _along(graph, roots, needed, {variable.index: 1.0})
    return table


def differentiate_along(
    graph: Graph, outputs: Sequence[Any], variables: Sequence[Expression], directions: Sequence[Any]
) -> list[Any]:
    """Differentiate outputs along a direction of the variables, itself scalars of the graph."""
    roots = [graph.index(output) for output in outputs]
    rates = {variable.index: rate for variable, rate in zip(variables, directions, strict=True)}
    return _along(graph, roots, graph.ancestors(roots), rates)


def substitute(
    graph: Graph, scalars: Sequence[Any], variables: Sequence[Expression], values: Sequence[Any]
) -> list[Any]:
    """Put values, themselves scalars of the graph, in place of variables that nothing but arithmetic uses."""
    roots = [graph.index(scalar) for scalar in scalars]
    put = {variable.index: value for variable, value in zip(variables, values, strict=True)}
    for index in graph.ancestors(roots):
        ends = operands(graph.nodes[index])
        if any(end in put for end in ends):
            op, scalars = graph.nodes[index][0], [put.get(end, graph.scalar(end)) for end in ends]
            put[index] = BINARY[op](*scalars) if op in BINARY else UNARY[op](*scalars)
    return [put.get(root, graph.scalar(root)) for root in roots]


def _along(graph: Graph, roots: list[int], needed: list[int], rates: dict[int, Any]) -> list[Any]:
    """Differentiate roots by the rates of inputs, which those of all `needed` nodes are added to."""
    for index in needed:
        rate = _rate(graph, index, rates)
        if not isinstance(rate, float) or rate != 0.0:
            rates[index] = rate
    return [rates.get(root, 0.0) for root in roots]


def _rate(graph: Graph, index: int, rates: dict[int, Any]) -> Any:
    """Differentiate a node by the chain rule, from the derivatives of its operands."""
    op, ends = graph.nodes[index][0], operands(graph.nodes[index])
    if not any(end in rates for end in ends):
        return 0.0
    da = rates.get(ends[0], 0.0)
    a, itself = graph.scalar(ends[0]), graph.scalar(index)
    if op == "neg":
        return -da
    if op == "sqrt":
        return 0.5 * da / itself
    if op == "sin":
        return a.cos() * da
    if op == "cos":
        return -a.sin() * da
    b, db = graph.scalar(ends[1]), rates.get(ends[1], 0.0)
    if op == "add":
        return da + db
    if op == "sub":
        return da - db
    if op == "mul":
        return da * b + a * db
    if op == "div":
        return (da - itself * db) / b
    if op == "arctan2":
        return (b * da - a * db) / (a * a + b * b)
    raise TypeError(f"{op} has no derivative")
