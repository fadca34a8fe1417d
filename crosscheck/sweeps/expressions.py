"""Expressions over the outputs of many runs, such as `norm(panel_7.position - slider_2.position)`.

A quantity is one of these: an array of a trajectory (`reaction_force`); the part of one body, joint or
actuator (`panel_7.quaternion`); a component (`panel_7.position.z`); a joint coordinate or its rate
(`slide_12.coordinate`). Quantities are combined by + - * / **, numbers, vectors `[x, y, z]` and `FUNCTIONS`.

A joint coordinate is a number that measures the motion of a joint, such as an angle or a displacement.

An expression is parsed once, and evaluated by NumPy for all times of many runs. This takes little time
compared with the runs, and the compiled code of a scene does not depend on the expressions.

The value of an expression is an array over runs, times, elements (bodies, joints, actuators or joint
coordinates) and components (of vectors or quaternions).
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial, reduce

import numpy as np

from crosscheck.support.errors import CrosscheckError
from crosscheck.sweeps.distributions import wrong_syntax
from newton_euler.errors import UnknownNameError, choices, plain_number
from newton_euler.model.euler_parameters import continuous
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import coordinate_name
from newton_euler.model.trajectory import QUANTITIES, SHAPES, JointMotion, Trajectory, coordinate_names
from newton_euler.runs.assemble import initial_state
from newton_euler.runs.batch import Batch
from newton_euler.scalars import Array

MAX_EXPRESSION_LENGTH = 2_000
"""Largest number of characters of an expression."""

Dimensions = tuple[str, str]
"""Names of the dimension of elements (such as "body") and of the dimension of components: "axis" for vectors,
"component" for quaternions. A name is empty if a value does not have this dimension."""

ELEMENT_DIMENSIONS = {"b": "body", "j": "joint", "a": "actuator"}
"""Names of the dimensions of elements, by their letters in `SHAPES`, which has the shape of each quantity as
a text such as "nb3": times, bodies, three components."""

PART_DIMENSIONS = {"3": "axis", "4": "component"}
"""Names of the dimensions of vectors and quaternions, by their digits in `SHAPES`."""

COMPONENT_NAMES = {"axis": tuple("xyz"), "component": tuple("wxyz")}
"""Labels of the components of vectors and quaternions, by dimension."""

SAME_UNIT = "same"
"""Argument of `_elementwise`: the result has the unit of the operands if all operands have the same unit."""


def _dimension(shape: str, names: Mapping[str, str]) -> str:
    """Return the name of the dimension whose letter occurs in a shape; empty if none does.

    Args:
        shape: shape of a quantity, see `ELEMENT_DIMENSIONS`.
        names: names of dimensions by letter.
    """
    return next((names[letter] for letter in shape if letter in names), "")


COORDINATES = {"coordinate": "coordinates", "rate": "rates"}
"""Quantities of joints, and the attributes of `Trajectory.joint` that contain them."""

DIMENSIONS = {
    name: (_dimension(SHAPES[name], ELEMENT_DIMENSIONS), _dimension(SHAPES[name], PART_DIMENSIONS))
    for name in QUANTITIES
} | dict.fromkeys(COORDINATES, ("coordinate", ""))
"""Dimensions of each quantity."""

QUANTITY_OUTPUTS = {name: quantity.output for name, quantity in QUANTITIES.items()} | dict.fromkeys(
    COORDINATES, "velocities"
)
"""Optional output of a scene that each quantity needs; None for quantities that every run has. The velocities
are needed for the rates of joint coordinates, and to count the revolutions of hinges between output times."""


@dataclass(frozen=True, eq=False)
class Value:
    """Value of an expression.

    Attributes:
        array: (runs, times, elements, components); the length is 1 along a missing dimension, and along
            a dimension on which the values do not depend.
        dimensions: names of the dimension of elements and of the dimension of components.
        unit: unit of the values; empty if unknown.
    """

    array: Array
    dimensions: Dimensions = ("", "")
    unit: str = ""

    @property
    def named(self) -> tuple[str, ...]:
        """Names of the existing dimensions."""
        return tuple(filter(None, self.dimensions))

    def __str__(self) -> str:
        return f"({', '.join(self.named) or 'a number'})"


@dataclass(frozen=True, eq=False)
class Outputs:
    """Outputs of runs of a scene.

    Attributes:
        scene: the scene.
        times: (n,) s, output times.
        stacked: function that returns the array (runs, n, ...) of a quantity, given the name of the quantity.
        joint: function that returns the k coordinates (runs, n, k) of a joint and their rates, given the name
            of the joint.
    """

    scene: Scene
    times: Array
    stacked: Callable[[str], Array]
    joint: Callable[[str], JointMotion]

    @classmethod
    def of(cls, scene: Scene, run: Trajectory) -> Outputs:
        """Return the outputs of one run of any engine."""

        def joint(name: str) -> JointMotion:
            """Return the coordinates (1, n, k) of a joint and their rates."""
            names, coordinates, rates = run.joint(name)
            return JointMotion(names, coordinates[None], None if rates is None else rates[None])

        return cls(scene, run.time, lambda name: np.asarray(getattr(run, name))[None], cache(joint))

    @classmethod
    def of_batch(cls, scene: Scene, batch: Batch) -> Outputs:
        """Return the outputs of a batch, which may omit optional outputs of the scene."""
        return cls(scene, batch.scene.times, batch.stacked, cache(batch.joint))

    @cached_property
    def labels(self) -> dict[str, tuple[str, ...]]:
        """Labels along each dimension, by name of the dimension."""
        return labels(self.scene)

    def quantity(self, name: str, element: str, signed: bool) -> Value:
        """Return a quantity of an element, or of all elements.

        Args:
            name: name of the quantity.
            element: name of a body, joint or actuator; empty for all elements.
            signed: True to make the signs of quaternions continuous over time.
        """
        element_dimension, component_dimension = DIMENSIONS[name]
        if name in COORDINATES:
            return self._coordinates(name, element)
        array = self.stacked(name)
        elements, components = self.labels[element_dimension], self.labels[component_dimension]
        array = array.reshape(*array.shape[:2], len(elements), len(components))
        selected = slice(None)
        if element:
            k = elements.index(element)
            selected, element_dimension = slice(k, k + 1), ""
        array = array[:, :, selected]
        if name == "quaternion" and signed:
            # q and -q are the same orientation: choose the sign nearest to that of the previous output, and
            # at the first output nearest to that of the scene's initial state
            start = initial_state(self.scene).quaternion[selected]
            first = np.broadcast_to(start, (len(array), *start.shape))
            array = np.swapaxes(continuous(np.swapaxes(array, 0, 1), first), 0, 1)
        return Value(array, (element_dimension, component_dimension), self._unit(name, element))

    def _coordinates(self, name: str, element: str) -> Value:
        """Return a joint coordinate or its rate, or those of all joints.

        Args:
            name: "coordinate" or "rate".
            element: label of the joint coordinate; empty for all joint coordinates.
        """
        mechanism, columns, units = self.scene.mechanism, [], set()
        for (joint, k), label in mechanism.coordinate_labels.items():
            if element in ("", label):
                columns.append(np.asarray(getattr(self.joint(joint), COORDINATES[name]))[:, :, k])
                units.add("m" if mechanism.is_slide(joint, k) else "rad")
        unit = f"{units.pop()}{'/s' if name == 'rate' else ''}" if len(units) == 1 else ""
        array = np.stack(columns, axis=-1)[..., None]
        return Value(array, ("" if element else "coordinate", ""), unit)

    def _unit(self, name: str, element: str) -> str:
        """Return the unit of a quantity of an element; empty if elements have different units."""
        if name != "actuator_force":
            return QUANTITIES[name].unit
        laws = zip(self.labels["actuator"], self.scene.control, strict=True)
        mechanism = self.scene.mechanism
        units = {
            "N" if mechanism.is_slide(*law.key) else "N m" for label, law in laws if element in ("", label)
        }
        return units.pop() if len(units) == 1 else ""


def labels(scene: Scene) -> dict[str, tuple[str, ...]]:
    """Return the labels along each dimension of a scene's quantities, by name of the dimension.

    The dimension "", which stands for a missing one, has one empty label. Actuators are labeled by the joint
    coordinates that they drive.
    """
    mechanism = scene.mechanism
    actuators = (coordinate_name(mechanism.joint(law.joint), law.coordinate) for law in scene.control)
    return {
        "": ("",),
        "body": tuple(mechanism.body_names),
        "joint": tuple(mechanism.joint_names),
        "actuator": tuple(actuators),
        "coordinate": tuple(mechanism.coordinate_labels.values()),
        **COMPONENT_NAMES,
    }


def _zero_joint_motion(mechanism: Mechanism, joint: str) -> JointMotion:
    """Return coordinates and rates of zero of a joint, for one run and two times."""
    names = coordinate_names(mechanism.joint(joint))
    zeros = np.zeros((1, 2, len(names)))
    return JointMotion(names, zeros, zeros)


Node = Callable[[Outputs], Value]
"""Node of an expression: function that evaluates a part of the expression from the outputs of runs."""


class Expression:
    """Expression over the quantities of a scene.

    Attributes:
        text: text of the expression.
        elements: by quantity, names of the bodies, joints and actuators that occur; an empty name stands for
            all.
        signed: True if the value depends on signs of quaternions or on numbers of revolutions of joints,
            which are tracked over all earlier output times.
        plain: True if the expression is a single quantity, so that its text can serve as its name.
        evaluate: returns the value at all times of all runs from their outputs.
        example: value for outputs that are all zero, whose dimensions and unit are those of every value.
    """

    def __init__(self, text: str, scene: Scene) -> None:
        """Parse and check an expression.

        Args:
            text: the expression.
            scene: scene whose runs the expression is evaluated for.

        Raises:
            CrosscheckError: describing the error in the text.
        """
        self.text, self.signed, self.elements = text.strip(), False, dict[str, set[str]]()
        self._contains_time = False
        self._labels, self._motions = labels(scene), scene.motions
        self._has_work = bool(scene.control or scene.forces or scene.motions)
        try:
            if len(text) > MAX_EXPRESSION_LENGTH:
                raise ValueError(f"the expression is longer than {MAX_EXPRESSION_LENGTH} characters")
            single_quantity = self._single_quantity(self.text)
            self.plain = single_quantity is not None
            self.evaluate = single_quantity or self._node(ast.parse(self.text, mode="eval").body)
            if not (self.elements or self._contains_time):
                raise ValueError(
                    "it contains no output of a run; name a quantity, for example panel_7.position"
                )
            with np.errstate(all="ignore"):
                # evaluate for outputs of zero, to find dimensions and unit
                joint = partial(_zero_joint_motion, scene.mechanism)
                zeros = Outputs(scene, np.array([0.0, 1.0]), self._zeros, joint)
                self.example = self.evaluate(zeros)
        except SyntaxError as error:
            raise CrosscheckError(wrong_syntax(error, self.text)) from None
        except (UnknownNameError, ValueError, RecursionError, MemoryError) as error:
            raise CrosscheckError(f"{error}"[:400]) from None

    @property
    def quantities(self) -> set[str]:
        """Names of the quantities in the expression."""
        return set(self.elements)

    def _zeros(self, name: str) -> Array:
        """Return a zero array of the shape of a quantity, for one run and two times."""
        return np.zeros((1, 2, *(len(self._labels[each]) for each in DIMENSIONS[name])))

    def _single_quantity(self, text: str) -> Node | None:
        """Return the node of a text that is a single quantity, else None.

        The text need not be valid Python, since names of elements may contain any characters.
        """
        with suppress(ValueError, UnknownNameError):
            return self._quantity(text, signed=True)
        return None

    def _node(self, node: ast.expr) -> Node:
        """Convert a part of the syntax tree to a node; raises `ValueError` for unknown syntax."""
        if isinstance(node, ast.BinOp) and type(node.op) in OPERATORS:
            return _applied(OPERATORS[type(node.op)], self._node(node.left), self._node(node.right))
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            return _applied(NEGATIVE, self._node(node.operand))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and not node.keywords:
            return self._call(node.func.id, node.args)
        # a quoted quantity, such as 'left arm.position'
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            return self._output(node.value)
        if isinstance(node, ast.Attribute | ast.Name):
            return self._output(ast.unparse(node))
        if isinstance(node, ast.List):
            vector = np.array([self._number(each) for each in node.elts])
            if vector.shape != (3,):
                raise ValueError(f"[...] has {len(vector)} numbers; needed: 3")
            return lambda outputs: Value(vector[None, None, None], ("", "axis"))
        number = np.full((1, 1, 1, 1), self._number(node))
        return lambda outputs: Value(number)

    def _number(self, node: ast.expr) -> float:
        """Return the value of a number; raises `ValueError` for anything else."""
        return plain_number((ast.get_source_segment(self.text, node) or "").replace(" ", ""))

    def _call(self, name: str, arguments: list[ast.expr]) -> Node:
        """Return the node of a function call; raises `ValueError` for an unknown function."""
        if name not in FUNCTIONS:
            raise ValueError(f"unknown function {name!r:.50}; {choices(name, FUNCTIONS)}")
        function, count = FUNCTIONS[name]
        if len(arguments) != count:
            raise ValueError(f"{name} takes {count} arguments, not {len(arguments)}")
        first = None
        # the sign of the quaternion, the first argument, does not affect a direction
        if name == "direction":
            first = self._quantity(ast.unparse(arguments[0]).strip("'"), signed=False)
        return _applied(function, first or self._node(arguments[0]), *map(self._node, arguments[1:]))

    def _output(self, text: str) -> Node:
        """Return the node of a quantity or of `time`; raises `ValueError` for an unknown name."""
        if text == "time":
            self._contains_time = True
            return lambda outputs: Value(outputs.times[None, :, None, None], unit="s")
        found = self._quantity(text, signed=True)
        if found is None:
            name = text.rpartition(".")[2]
            raise ValueError(f"unknown output {name!r:.100}; {choices(name, (*DIMENSIONS, 'time'))}")
        return found

    def _quantity(self, text: str, signed: bool) -> Node | None:
        """Return the node of [ELEMENT.]QUANTITY[.COMPONENT]; None if the text names no quantity.

        `signed` is an argument of `Outputs.quantity`. Raises `ValueError` or `UnknownNameError` for an
        element or a component that the quantity does not have.
        """
        element, _, name = text.rpartition(".")
        component = ""
        if name not in DIMENSIONS:
            component, (element, _, name) = name, element.rpartition(".")
        if name not in DIMENSIONS:
            return None
        element_dimension, component_dimension = DIMENSIONS[name]
        if element and not element_dimension:
            raise ValueError(f"{name} belongs to the whole mechanism, not to {element!r:.100}")
        if element_dimension and not self._labels[element_dimension]:
            joint = next((motion.joint for motion in self._motions), None)
            drive = f"; for its prescribed motions, use {joint}.reaction_torque" if joint else ""
            raise ValueError(f"{name}: the scene has no {element_dimension}{drive}")
        if element and element not in self._labels[element_dimension]:
            raise UnknownNameError(element_dimension, element, self._labels[element_dimension])
        if name == "work" and not self._has_work:
            raise ValueError("the scene has no control, forces or motions that do work")
        letters = COMPONENT_NAMES.get(component_dimension, ())
        if component and component not in letters:
            raise ValueError(f"{name} has no component {component!r:.50}; {choices(component, letters)}")
        self.elements.setdefault(name, set()).add(element)
        self.signed = self.signed or (name == "quaternion" and signed) or name == "coordinate"

        def look_up(outputs: Outputs) -> Value:
            """Return the quantity, or its component, from the outputs of runs."""
            found = outputs.quantity(name, element, signed)
            if not component:
                return found
            k = letters.index(component)
            return Value(found.array[..., k : k + 1], (found.dimensions[0], ""), found.unit)

        return look_up


def _applied(function: Callable[..., Value], *nodes: Node) -> Node:
    """Return the node that applies a function to the values of other nodes."""
    return lambda outputs: function(*(node(outputs) for node in nodes))


def _combined_dimensions(a: Dimensions, b: Dimensions) -> Dimensions:
    """Return the dimensions of the combination of two values; raises `ValueError` if they do not match."""
    if any(one and two and one != two for one, two in zip(a, b, strict=True)):
        raise ValueError(f"{Value(np.zeros(0), a)} and {Value(np.zeros(0), b)} do not combine")
    return a[0] or b[0], a[1] or b[1]


def _elementwise(function: Callable[..., Array], unit: str = "") -> Callable[..., Value]:
    """Convert an elementwise function of arrays into a function of values.

    Args:
        function: the function of arrays.
        unit: unit of the result; empty if unknown, `SAME_UNIT` for that of the operands.
    """

    def apply(*values: Value) -> Value:
        """Apply the function to the arrays of values; find dimensions and unit of the result."""
        units = {value.unit for value in values}
        result_unit = unit
        if unit == SAME_UNIT:
            result_unit = units.pop() if len(units) == 1 else ""
        dimensions = reduce(_combined_dimensions, (value.dimensions for value in values))
        return Value(function(*(value.array for value in values)), dimensions, result_unit)

    return apply


NEGATIVE = _elementwise(np.negative, SAME_UNIT)
"""Function of the sign before an expression, -a."""

OPERATORS: Mapping[type[ast.operator], Callable[..., Value]] = {
    ast.Add: _elementwise(operator.add, SAME_UNIT),
    ast.Sub: _elementwise(operator.sub, SAME_UNIT),
    ast.Mult: _elementwise(operator.mul),
    ast.Div: _elementwise(operator.truediv),
    ast.Pow: _elementwise(operator.pow),
}
"""Functions of the operators between two expressions, by class of the operator in a syntax tree."""


def _vector_dimensions(a: Value, b: Value) -> Dimensions:
    """Return the dimensions of the combination of two vectors; raises `ValueError` for other values."""
    for value in (a, b):
        if value.dimensions[1] != "axis":
            raise ValueError(f"{value} is not a vector")
    return _combined_dimensions(a.dimensions, b.dimensions)


def _dot(a: Value, b: Value) -> Value:
    """Return the scalar products of vectors."""
    element_dimension, _ = _vector_dimensions(a, b)
    products = a.array * b.array
    # explicit sums, whose order does not depend on the number of runs
    return Value(products[..., :1] + products[..., 1:2] + products[..., 2:], (element_dimension, ""))


def _cross(a: Value, b: Value) -> Value:
    """Return the vector products of vectors."""
    return Value(np.cross(a.array, b.array), _vector_dimensions(a, b))


def norm(value: Value) -> Value:
    """Return the lengths of vectors."""
    squares = _dot(value, value)
    return replace(squares, array=np.sqrt(squares.array), unit=value.unit)


def _angle(a: Value, b: Value) -> Value:
    """Return the angles between vectors, rad."""
    return ARCTAN2(norm(_cross(a, b)), _dot(a, b))


def _direction(quaternion: Value, vector: Value) -> Value:
    """Transform vectors from the body frame to the world frame."""
    if quaternion.dimensions[1] != "component":
        raise ValueError(f"{quaternion} is not a quaternion")
    as_vector = replace(quaternion, dimensions=(quaternion.dimensions[0], "axis"))
    dimensions = _vector_dimensions(vector, as_vector)
    # with q = (w, u): v' = v + w (2 u x v) + u x (2 u x v)
    q, in_body = quaternion.array, vector.array
    twice = 2.0 * np.cross(q[..., 1:], in_body)
    in_world = in_body + q[..., :1] * twice + np.cross(q[..., 1:], twice)
    return Value(in_world, dimensions, vector.unit)


ARCTAN2 = _elementwise(np.arctan2, "rad")
"""Angle arctan2(y, x) of a point (x, y), rad, given y and x."""

FUNCTIONS: dict[str, tuple[Callable[..., Value], int]] = {
    "abs": (_elementwise(np.abs, SAME_UNIT), 1),
    "sqrt": (_elementwise(np.sqrt), 1),
    "sin": (_elementwise(np.sin), 1),
    "cos": (_elementwise(np.cos), 1),
    "arctan2": (ARCTAN2, 2),
    "norm": (norm, 1),
    "dot": (_dot, 2),
    "cross": (_cross, 2),
    "angle": (_angle, 2),
    "direction": (_direction, 2),
}
"""Functions by name, with their numbers of arguments. `angle(a, b)` is the angle between vectors, rad;
`direction(q, v)` transforms a vector v of a body with the quaternion q to the world frame."""
