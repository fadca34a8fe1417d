"""Symbolic tracing: scalars that record the arithmetic done with them in an expression graph.

If the equations of motion are evaluated with `Expression` objects in place of floats, they leave a `Graph` of
all operations. The graph is simplified as it grows: operations on constants are evaluated, zeros and ones
vanish, and an operation that already exists is used again. `Graph.prune` keeps the operations that the
requested outputs need; the result is a `Program`, which `newton_euler.codegen.compile` turns into native
code. `differentiate` adds derivatives to a graph.

Simplification follows the rules of real arithmetic. It may change the last bit of a result, since c (d x)
becomes (c d) x for constants c and d. 0 x becomes 0, also where x would be infinite or NaN.
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
"""Operations whose two operands may be exchanged."""

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
"""Functions of one and of two numbers that evaluate each operation, by the name of the operation."""

LEAVES = frozenset({"const", "input"})
"""Names of nodes that are no operations."""

Node = tuple[str, Any, int]
"""One operation: its name and the indices of the nodes of its two operands, the second -1 if there is none.
Leaves are ("const", value, -1) and ("input", number of the input, -1). A graph has hundreds of thousands of
nodes, and plain tuples are faster to make than named ones."""


class Graph:
    """Expression graph: operations in an order in which they can be evaluated.

    A method named like an operation adds the operation on nodes a and b (given by their indices) and
    simplifies it. The result is a scalar: an `Expression`, or a float if it is constant.

    Attributes:
        nodes: every operation; operands come before the operations that use them.
        inputs: number of inputs.
    """

    def __init__(self) -> None:
        """Make an empty graph."""
        self.nodes: list[Node] = []
        self.inputs = 0
        self._index_of_node: dict[Node, int] = {}
        self._constants: dict[int, float] = {}  # index of a constant -> its value
        self._negated: dict[int, int] = {}  # index of -x -> index of x

    def variables(self, count: int) -> Array:
        """Add inputs, and return them as scalars (count,)."""
        first = self.inputs
        self.inputs += count
        return objects([self.record("input", first + k) for k in range(count)])

    def constant(self, value: float) -> int:
        """Return the index of the node of a constant."""
        index = self.record("const", float(value)).index
        self._constants[index] = float(value)
        return index

    def index(self, scalar: Expression | float) -> int:
        """Return the index of the node of a scalar; a float becomes a constant node of the graph."""
        return scalar.index if isinstance(scalar, Expression) else self.constant(scalar)

    def scalar(self, index: int) -> Any:
        """Return the scalar of the node at an index: a float for a constant, else an `Expression`."""
        value = self._constants.get(index)
        return Expression(self, index) if value is None else value

    def record(self, op: str, a: Any, b: int = -1) -> Expression:
        """Add an operation without simplification. If an equal one exists, return the existing one.

        Operands of commutative operations are sorted, so that a + b and b + a are equal.

        Args:
            op: name of the operation, or "const" or "input".
            a: index of the first operand; value of a constant or number of an input.
            b: index of the second operand, -1 if there is none.
        """
        if b < a and op in COMMUTATIVE:
            a, b = b, a
        node = (op, a, b)
        index = self._index_of_node.get(node)
        if index is None:
            index = self._index_of_node[node] = len(self.nodes)
            self.nodes.append(node)
        return Expression(self, index)

    def neg(self, a: int) -> Expression:
        """Return -a."""
        inner = self._negated.get(a)
        if inner is not None:  # --x = x
            return Expression(self, inner)
        negative = self.record("neg", a)
        self._negated[negative.index] = a
        return negative

    def sin(self, a: int) -> Expression:
        """Return sin a."""
        inner = self._negated.get(a)  # sin(-x) = -sin x
        return self.record("sin", a) if inner is None else self.neg(self.sin(inner).index)

    def cos(self, a: int) -> Expression:
        """Return cos a."""
        inner = self._negated.get(a)  # cos(-x) = cos x
        return self.record("cos", a if inner is None else inner)

    def add(self, a: int, b: int) -> Any:
        """Return a + b, with signs moved out of the operands: a + (-y) = a - y."""
        negated = self._negated
        if b in negated:
            return self.sub(a, negated[b])
        return self.sub(b, negated[a]) if a in negated else self.record("add", a, b)

    def sub(self, a: int, b: int) -> Any:
        """Return a - b, with signs moved out of the operands: a - (-y) = a + y, (-x) - b = -(x + b)."""
        if a == b:
            return 0.0
        negated = self._negated
        if b in negated:
            return self.add(a, negated[b])
        return -self.add(negated[a], b) if a in negated else self.record("sub", a, b)

    def mul(self, a: int, b: int) -> Any:
        """Return a b, with signs moved out of the operands: a (-y) = -(a y)."""
        negated = self._negated
        if b in negated:
            return -self.mul(a, negated[b])
        return -self.mul(negated[a], b) if a in negated else self.record("mul", a, b)

    def scale(self, factor: float, b: int) -> Any:
        """Return the product of a constant factor and the node at index b, with constants multiplied."""
        if factor == 0.0:
            return 0.0
        if factor == 1.0:
            return Expression(self, b)
        if factor == -1.0:
            return self.neg(b)
        inner = self._negated.get(b)
        if inner is not None:  # c (-x) = (-c) x
            return self.scale(-factor, inner)
        op, first, second = self.nodes[b]
        if op == "mul":  # c (d z) = (c d) z
            constant = self._constants.get(first)
            if constant is not None:
                return self.scale(factor * constant, second)
            constant = self._constants.get(second)
            if constant is not None:
                return self.scale(factor * constant, first)
        return self.record("mul", self.constant(factor), b)

    def ancestors(self, roots: Iterable[int]) -> list[int]:
        """Return the indices, ascending, of all nodes that are needed to evaluate the nodes `roots`."""
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
        """Return a program of only those operations that these outputs (scalars) need."""
        roots = [self.index(scalar) for scalar in outputs]
        needed = self.ancestors(roots)
        new_index = {index: k for k, index in enumerate(needed)}
        nodes: list[Node] = []
        for index in needed:
            op, a, b = self.nodes[index]
            if b >= 0:
                nodes.append((op, new_index[a], new_index[b]))
            else:
                nodes.append((op, a if op in LEAVES else new_index[a], b))
        return Program(tuple(nodes), self.inputs, tuple(new_index[root] for root in roots))


def operands(node: Node) -> tuple[int, ...]:
    """Return the indices of the operands of a node, none for a leaf."""
    op, a, b = node
    if b >= 0:
        return (a, b)
    return () if op in LEAVES else (a,)


class Program(NamedTuple):
    """A pruned graph, which computes outputs from inputs.

    Attributes:
        nodes: operations, constants and inputs; operands come before the operations that use them.
        inputs: number of inputs.
        outputs: index of the node of each output.
    """

    nodes: tuple[Node, ...]
    inputs: int
    outputs: tuple[int, ...]

    def counts(self) -> Counter[str]:
        """Count operations by name, without constants and inputs."""
        counts = Counter(map(itemgetter(0), self.nodes))
        return Counter({op: count for op, count in counts.items() if op not in LEAVES})

    @property
    def operation_count(self) -> int:
        """Number of floating-point operations without changes of sign, which cost almost no time."""
        return sum(count for op, count in self.counts().items() if op != "neg")

    def run(self, inputs: Sequence[float]) -> Array:
        """Evaluate the outputs (outputs,) in plain Python, as the reference for tests of native code."""
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
    """A scalar that stands for a node of a graph; arithmetic with it adds nodes.

    The class supports + - * /, and NumPy's sqrt, sin, cos and arctan2 on arrays of objects, which call the
    methods of these names. `newton_euler.scalars.minimum` calls the method `minimum`.

    Attributes:
        graph: graph that the node belongs to.
        index: index of the node.
    """

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
        return self.graph.scale(other, self.index) if isinstance(other, NUMBERS) else NotImplemented

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


def differentiate(graph: Graph, outputs: Sequence[Any], variables: Sequence[Expression]) -> Array:
    """Compute partial derivatives of outputs with respect to variables by forward differentiation.

    Args:
        graph: graph of the outputs; receives the operations of the derivatives.
        outputs: scalars to differentiate.
        variables: inputs of the graph.

    Returns:
        Derivatives (outputs, variables), scalars of the same graph.
    """
    roots = [graph.index(output) for output in outputs]
    needed = graph.ancestors(roots)
    jacobian = np.zeros((len(outputs), len(variables)), dtype=object)
    for column, variable in enumerate(variables):
        jacobian[:, column] = _directional(graph, roots, needed, {variable.index: 1.0})
    return jacobian


def differentiate_along(
    graph: Graph, outputs: Sequence[Any], variables: Sequence[Expression], directions: Sequence[Any]
) -> list[Any]:
    """Compute directional derivatives (outputs,) along `directions`, as scalars of the same graph.

    Args:
        graph: graph of the outputs; receives the operations of the derivatives.
        outputs: scalars to differentiate.
        variables: inputs of the graph.
        directions: derivative of each variable along the direction, a scalar of the same graph.
    """
    roots = [graph.index(output) for output in outputs]
    rates = {variable.index: rate for variable, rate in zip(variables, directions, strict=True)}
    return _directional(graph, roots, graph.ancestors(roots), rates)


def substitute(
    graph: Graph, scalars: Sequence[Any], variables: Sequence[Expression], values: Sequence[Any]
) -> list[Any]:
    """Return the scalars with variables replaced by values.

    The variables may be operands of + - * / and negation only.

    Args:
        graph: graph of the scalars; receives the new operations.
        scalars: scalars of the graph.
        variables: inputs of the graph.
        values: value of each variable, a scalar of the same graph.
    """
    roots = [graph.index(scalar) for scalar in scalars]
    # new scalar of each variable, and of each node that depends on a variable, by index
    replaced = {variable.index: value for variable, value in zip(variables, values, strict=True)}
    for index in graph.ancestors(roots):
        indices = operands(graph.nodes[index])
        if any(k in replaced for k in indices):
            op, arguments = graph.nodes[index][0], [replaced.get(k, graph.scalar(k)) for k in indices]
            replaced[index] = BINARY[op](*arguments) if op in BINARY else UNARY[op](*arguments)
    return [replaced.get(root, graph.scalar(root)) for root in roots]


def _directional(graph: Graph, roots: list[int], needed: list[int], rates: dict[int, Any]) -> list[Any]:
    """Return the derivatives of the nodes `roots` by forward differentiation.

    Args:
        roots: indices of nodes.
        needed: indices of all nodes that the roots depend on, ascending.
        rates: derivatives of the inputs by index; the derivatives of the needed nodes are added. Nodes
            without an entry have the derivative 0.
    """
    for index in needed:
        rate = _rate(graph, index, rates)
        if not isinstance(rate, float) or rate != 0.0:
            rates[index] = rate
    return [rates.get(root, 0.0) for root in roots]


def _rate(graph: Graph, index: int, rates: dict[int, Any]) -> Any:
    """Differentiate the node at an index by the chain rule, from the derivatives `rates` of its operands."""
    op, indices = graph.nodes[index][0], operands(graph.nodes[index])
    if not any(k in rates for k in indices):
        return 0.0
    # operands a and b, their derivatives da and db, and the result of the operation
    da = rates.get(indices[0], 0.0)
    a, result = graph.scalar(indices[0]), graph.scalar(index)
    if op == "neg":
        return -da
    if op == "sqrt":
        return 0.5 * da / result
    if op == "sin":
        return a.cos() * da
    if op == "cos":
        return -a.sin() * da
    b, db = graph.scalar(indices[1]), rates.get(indices[1], 0.0)
    if op == "add":
        return da + db
    if op == "sub":
        return da - db
    if op == "mul":
        return da * b + a * db
    if op == "div":
        return (da - result * db) / b
    if op == "arctan2":
        return (b * da - a * db) / (a * a + b * b)
    if op == "minimum":
        # 1 where a is smaller, 0 where b is; without a value where both are equal and the derivative jumps
        chosen = (b - result) / (b - a)
        return da * chosen + db * (1.0 - chosen)
    raise TypeError(f"{op} has no derivative")
