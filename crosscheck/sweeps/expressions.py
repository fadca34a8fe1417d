"""Expressions over the outputs of many runs, such as `norm(panel_7.position - slider_2.position)`.

A quantity is an array of a trajectory, `reaction_force`, that of one body, joint or actuator,
`panel_7.quaternion`, or a component of it, `panel_7.position.z`. Quantities are combined by + - * / **,
numbers, vectors `[x, y, z]` and `FUNCTIONS`. An expression is parsed once and evaluated by NumPy for all
times of many runs: next to the runs that takes little, and the compiled code of a scene is the same whatever
is kept of it.
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from crosscheck.errors import CrosscheckError
from crosscheck.sweeps.distributions import wrong_syntax
from newton_euler.assemble import initial_state
from newton_euler.errors import UnknownNameError, choices, plain_number
from newton_euler.model.euler_parameters import continuous
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import coordinate_name
from newton_euler.model.trajectory import QUANTITIES, SHAPES
from newton_euler.scalars import Array

LONGEST = 2_000
"""Characters of an expression."""

DIMENSION = {"b": "body", "j": "joint", "a": "actuator", "3": "axis", "4": "component"}
"""Names of dimensions, by their letters in `SHAPES`."""

DIMENSIONS = {name: tuple(DIMENSION[letter] for letter in SHAPES[name][1:]) for name in QUANTITIES}
"""Of quantities, after runs and times."""

COMPONENTS = {"axis": tuple("xyz"), "component": tuple("wxyz")}


@dataclass(frozen=True, eq=False)
class Value:
    """Numbers of runs at times.

    Attributes:
        array: (runs, times, *dimensions), either of the first two 1 where it is the same for all.
        dimensions: names of the others.
        unit: empty where it is not known.
    """

    array: Array
    dimensions: tuple[str, ...] = ()
    unit: str = ""


@dataclass(frozen=True, eq=False)
class Outputs:
    """The outputs of runs of a scene.

    Attributes:
        scene: their scene.
        times: (n,) s.
        stacked: an array (runs, n, ...) by the name of a quantity.
    """

    scene: Scene
    times: Array
    stacked: Callable[[str], Array]

    @cached_property
    def labels(self) -> dict[str, tuple[str, ...]]:
        """Names along each dimension."""
        return labels(self.scene)

    def quantity(self, name: str, element: str, signed: bool) -> Value:
        """Return a quantity, of one element or, if that is empty, of all.

        Args:
            signed: whether signs of quaternions matter, which follow one another then.
        """
        dimensions = DIMENSIONS[name]
        array = self.stacked(name)
        place: slice | int = slice(None)
        if element:
            place = self.labels[dimensions[0]].index(element)
            array, dimensions = array[:, :, place], dimensions[1:]
        if name == "quaternion" and signed:
            start = initial_state(self.scene).quaternion[place]
            first = np.broadcast_to(start, (len(array), *start.shape))
            array = np.swapaxes(continuous(np.swapaxes(array, 0, 1), first), 0, 1)
        return Value(array, dimensions, self._unit(name, element))

    def _unit(self, name: str, element: str) -> str:
        if name != "actuator_force":
            return QUANTITIES[name].unit
        laws = zip(self.labels["actuator"], self.scene.control, strict=True)
        mechanism = self.scene.mechanism
        units = {
            "N" if mechanism.is_slide(*law.key) else "N m" for label, law in laws if element in ("", label)
        }
        return units.pop() if len(units) == 1 else ""


def labels(scene: Scene) -> dict[str, tuple[str, ...]]:
    """Return the names along each dimension of a scene's quantities."""
    mechanism = scene.mechanism
    actuators = (coordinate_name(mechanism.joint(law.joint), law.coordinate) for law in scene.control)
    return {
        "body": tuple(mechanism.body_names),
        "joint": tuple(mechanism.joint_names),
        "actuator": tuple(actuators),
        **COMPONENTS,
    }


class Expression:
    """An expression over the quantities of a scene.

    Attributes:
        text: as it was given.
        quantities: names of those that it takes.
        signed: True if signs of quaternions matter to it, which are known from one time to the next alone.
        plain: True if it is no more than a quantity.
        example: its value of zeros, for dimensions and unit.
    """

    def __init__(self, text: str, scene: Scene) -> None:
        """Parse and check an expression.

        Raises:
            CrosscheckError: saying what is wrong with it.
        """
        self.text, self.quantities, self.signed = text.strip(), set[str](), False
        self._labels, self._works = labels(scene), bool(scene.control or scene.forces or scene.motions)
        try:
            if len(text) > LONGEST:
                raise ValueError(f"the expression is longer than {LONGEST} characters")
            self._root = self._look_up(self.text) or self._node(ast.parse(self.text, mode="eval").body)
            self.example = self.evaluate(_nothing(scene))
        except SyntaxError as error:
            raise CrosscheckError(wrong_syntax(error, self.text)) from None
        except UnknownNameError as error:
            raise CrosscheckError(str(error)) from None
        except (ValueError, RecursionError, MemoryError) as error:
            raise CrosscheckError(f"{error}"[:400]) from None

    def evaluate(self, outputs: Outputs) -> Value:
        """Return the values at all times of all runs; not a number where there is none."""
        with np.errstate(all="ignore"):
            return self._root(outputs)

    def _look_up(self, text: str) -> Callable[[Outputs], Value] | None:
        """Return what looks up a quantity that is the whole text, whatever characters its element has."""
        found = None
        with suppress(ValueError, UnknownNameError):
            found = self._quantity(text, signed=True)
        self.plain = found is not None
        return found

    def _node(self, node: ast.expr) -> Callable[[Outputs], Value]:
        """Return what evaluates a part of the expression; raises `ValueError` for what is none."""
        if isinstance(node, ast.BinOp) and type(node.op) in OPERATORS:
            left, right, apply = self._node(node.left), self._node(node.right), OPERATORS[type(node.op)]
            return lambda outputs: apply(left(outputs), right(outputs))
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            inner = self._node(node.operand)
            return lambda outputs: _mapped(np.negative, inner(outputs))
        if isinstance(node, ast.List):
            vector = np.array([self._number(each) for each in node.elts])
            if vector.shape != (3,):
                raise ValueError(f"[...] has {len(vector)} numbers; needed: 3")
            return lambda outputs: Value(vector[None, None], ("axis",))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
            return self._call(node.func.id, node.args)
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            return self._named(node.value)
        if isinstance(node, ast.Attribute | ast.Name):
            return self._named(ast.unparse(node))
        number = np.full((1, 1), self._number(node))
        return lambda outputs: Value(number)

    def _number(self, node: ast.expr) -> float:
        return plain_number((ast.get_source_segment(self.text, node) or "").replace(" ", ""))

    def _call(self, name: str, arguments: list[ast.expr]) -> Callable[[Outputs], Value]:
        if name not in FUNCTIONS:
            raise ValueError(f"unknown function {name!r:.50}; {choices(name, FUNCTIONS)}")
        function, count = FUNCTIONS[name]
        if len(arguments) != count:
            raise ValueError(f"{name} takes {count} arguments, not {len(arguments)}")
        if name == "direction":  # which is the same for both signs
            turned = self._quantity(ast.unparse(arguments[0]).strip("'"), signed=False)
            nodes = [turned or self._node(arguments[0]), self._node(arguments[1])]
        else:
            nodes = [self._node(each) for each in arguments]
        return lambda outputs: function(*(node(outputs) for node in nodes))

    def _named(self, text: str) -> Callable[[Outputs], Value]:
        if text == "time":
            return lambda outputs: Value(outputs.times[None], unit="s")
        found = self._quantity(text, signed=True)
        if found is None:
            name = text.rpartition(".")[2]
            raise ValueError(f"unknown output {name!r:.100}; {choices(name, (*QUANTITIES, 'time'))}")
        return found

    def _quantity(self, text: str, signed: bool) -> Callable[[Outputs], Value] | None:
        """Return what looks up [ELEMENT.]QUANTITY[.COMPONENT]; None if no quantity is named."""
        before, _, last = text.rpartition(".")
        component = ""
        if last not in QUANTITIES:
            component, (before, _, last) = last, before.rpartition(".")
        if last not in QUANTITIES:
            return None
        dimensions = DIMENSIONS[last]
        if before and not dimensions:
            raise ValueError(f"{last} is of the whole mechanism, not of {before!r:.100}")
        if before and before not in self._labels[dimensions[0]]:
            raise UnknownNameError(dimensions[0], before, self._labels[dimensions[0]])
        if last == "work" and not self._works:
            raise ValueError("work is that of control, forces and motions, of which the scene has none")
        parts = COMPONENTS.get(dimensions[-1], ()) if dimensions else ()
        if component and component not in parts:
            raise ValueError(f"{last} has no component {component!r:.50}; {choices(component, parts)}")
        self.quantities.add(last)
        self.signed = self.signed or (last == "quaternion" and signed)

        def look_up(outputs: Outputs) -> Value:
            found = outputs.quantity(last, before, signed)
            if not component:
                return found
            place = parts.index(component)
            return Value(found.array[..., place], found.dimensions[:-1], found.unit)

        return look_up


def _nothing(scene: Scene) -> Outputs:
    """Return all outputs of a run, zeros at two times, to check expressions with."""
    sizes = {dimension: len(names) for dimension, names in labels(scene).items()}

    def zeros(name: str) -> Array:
        return np.zeros((1, 2, *(sizes[dimension] for dimension in DIMENSIONS[name])))

    return Outputs(scene, np.array([0.0, 1.0]), zeros)


def _mapped(function: Callable[[Array], Array], value: Value) -> Value:
    return Value(function(value.array), value.dimensions, value.unit)


def _aligned(a: Value, b: Value) -> tuple[Array, Array, tuple[str, ...]]:
    """Return two arrays of the same dimensions, one of them spread out if it has none."""
    if a.dimensions == b.dimensions:
        return a.array, b.array, a.dimensions
    if a.dimensions and b.dimensions:
        raise ValueError(f"({', '.join(a.dimensions)}) and ({', '.join(b.dimensions)}) do not combine")
    dimensions = a.dimensions or b.dimensions
    ones = (1,) * len(dimensions)
    left, right = (
        each.array if each.dimensions else each.array.reshape(*each.array.shape, *ones) for each in (a, b)
    )
    return left, right, dimensions


def _combined(
    function: Callable[[Array, Array], Array], is_sum: bool = False
) -> Callable[[Value, Value], Value]:
    def apply(a: Value, b: Value) -> Value:
        left, right, dimensions = _aligned(a, b)
        return Value(function(left, right), dimensions, a.unit if is_sum and a.unit == b.unit else "")

    return apply


OPERATORS: Mapping[type[ast.operator], Callable[[Value, Value], Value]] = {
    ast.Add: _combined(operator.add, is_sum=True),
    ast.Sub: _combined(operator.sub, is_sum=True),
    ast.Mult: _combined(operator.mul),
    ast.Div: _combined(operator.truediv),
    ast.Pow: _combined(operator.pow),
}


def _of_dimension(dimension: str, *values: Value) -> None:
    """Raise `ValueError` for values whose last dimension is another."""
    for value in values:
        if value.dimensions[-1:] != (dimension,):
            words = {"axis": "a vector", "component": "a quaternion"}
            raise ValueError(f"({', '.join(value.dimensions) or 'a number'}) is not {words[dimension]}")


def _vectors(a: Value, b: Value) -> tuple[Array, Array, tuple[str, ...]]:
    """Return the arrays of two vectors, of which one may be the same for all elements."""
    _of_dimension("axis", a, b)
    if len(a.dimensions) == len(b.dimensions):
        return _aligned(a, b)
    more = max(a, b, key=lambda each: len(each.dimensions))
    left, right = (each.array if each is more else each.array[:, :, None] for each in (a, b))
    return left, right, more.dimensions


def _dot_of(a: Array, b: Array) -> Array:
    """Sum products element by element, in the same order for any number of runs."""
    return np.asarray(a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2])


def _dot(a: Value, b: Value) -> Value:
    left, right, dimensions = _vectors(a, b)
    return Value(_dot_of(left, right), dimensions[:-1])


def _cross(a: Value, b: Value) -> Value:
    left, right, dimensions = _vectors(a, b)
    return Value(np.cross(left, right), dimensions)


def norm(value: Value) -> Value:
    """Return the lengths of vectors."""
    _of_dimension("axis", value)
    return Value(np.sqrt(_dot_of(value.array, value.array)), value.dimensions[:-1], value.unit)


def _angle(a: Value, b: Value) -> Value:
    across, along = norm(_cross(a, b)).array, _dot(a, b)
    return Value(np.arctan2(across, along.array), along.dimensions, "rad")


def _direction(quaternion: Value, vector: Value) -> Value:
    """Return vectors of a body's frame along the world's axes."""
    _of_dimension("component", quaternion)
    _of_dimension("axis", vector)
    if len(vector.dimensions) > 1:
        raise ValueError("direction takes a quaternion and one vector [x, y, z]")
    q = quaternion.array
    fixed = vector.array if len(quaternion.dimensions) == 1 else vector.array[:, :, None]
    twice = 2.0 * np.cross(q[..., 1:], fixed)
    turned = fixed + q[..., :1] * twice + np.cross(q[..., 1:], twice)
    return Value(turned, (*quaternion.dimensions[:-1], "axis"), vector.unit)


def _of_number(function: Callable[[Array], Array]) -> Callable[[Value], Value]:
    return lambda value: Value(function(value.array), value.dimensions)


FUNCTIONS: dict[str, tuple[Callable[..., Value], int]] = {
    "abs": (lambda value: _mapped(np.abs, value), 1),
    "sqrt": (_of_number(np.sqrt), 1),
    "sin": (_of_number(np.sin), 1),
    "cos": (_of_number(np.cos), 1),
    "arctan2": (lambda a, b: Value(np.arctan2(*_aligned(a, b)[:2]), _aligned(a, b)[2], "rad"), 2),
    "norm": (norm, 1),
    "dot": (_dot, 2),
    "cross": (_cross, 2),
    "angle": (_angle, 2),
    "direction": (_direction, 2),
}
"""Functions by name, with how many arguments each takes: angle(a, b) between vectors, rad; direction(q, v) of
a vector v in the frame of a body with the quaternion q."""
