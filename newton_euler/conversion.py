"""Initial states of many runs, checked and turned into coordinates all at once.

The equations of the joints run once, over scalars that hold one value for each state. A state of the tracker
takes some 15 microseconds so; one by one it would take a millisecond, twice its run of a second.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from newton_euler.assemble import VELOCITY_TOLERANCE, initial_state
from newton_euler.equations.couplings import couplings
from newton_euler.errors import MechanismError
from newton_euler.model.elements import Surroundings
from newton_euler.model.euler_parameters import conjugate, product
from newton_euler.model.geometry import UNIT_TOLERANCE
from newton_euler.model.mechanism import CLOSURE_TOLERANCE
from newton_euler.model.scene import Scene
from newton_euler.model.spanning_tree import SpanningTree
from newton_euler.model.state import State
from newton_euler.scalars import Array, objects

PORTION = 1000
"""States at a time: their values stay in the processor's caches."""

SURE = 0.99
"""Share of a tolerance up to which round-off cannot matter; states above it are checked one by one."""

WIDTHS = {"position": 3, "quaternion": 4, "linear_velocity": 3, "angular_velocity": 3}
"""Arrays of a state and their widths."""


class Stack:
    """A scalar with one value for each of n states."""

    __slots__ = ("values",)

    def __init__(self, values: Array) -> None:
        """Hold the values (n,)."""
        self.values = values

    def __add__(self, other: Any) -> Any:
        return _each(np.add, self, other)

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        return _each(np.subtract, self, other)

    def __rsub__(self, other: Any) -> Any:
        return -self + other

    def __mul__(self, other: Any) -> Any:
        return _each(np.multiply, self, other)

    __rmul__ = __mul__

    def __neg__(self) -> Stack:
        return Stack(-self.values)

    def sin(self) -> Stack:
        return Stack(np.sin(self.values))

    def cos(self) -> Stack:
        return Stack(np.cos(self.values))

    def arctan2(self, other: Any) -> Any:
        return _each(np.arctan2, self, other)


def _each(function: Any, a: Stack, b: Any) -> Any:
    if isinstance(b, Stack):
        return Stack(function(a.values, b.values))
    return Stack(function(a.values, b)) if isinstance(b, float | int) else NotImplemented


def arrays(states: Sequence[State]) -> list[Array]:
    """Collect the arrays of n states, (n, b, 3) or (n, b, 4), in the order of `WIDTHS`."""
    return [np.array([getattr(state, name) for state in states]) for name in WIDTHS]


def stack(found: Sequence[Array]) -> State:
    """Make one state of `Stack` for n states, from their `arrays`."""
    return State(*(_stacked(values) for values in found))


def _stacked(values: Array) -> Array:
    """Turn (n, b, w) floats into (b, w) of `Stack`."""
    columns = np.ascontiguousarray(np.moveaxis(values, 0, -1)).reshape(-1, len(values))
    return objects([Stack(column) for column in columns]).reshape(values.shape[1:])


def _floats(scalars: Array, count: int) -> Array:
    """Turn (k,) of `Stack` or floats into (n, k) floats."""
    rows = np.empty((count, len(scalars)))
    for k, scalar in enumerate(scalars):
        rows[:, k] = scalar.values if isinstance(scalar, Stack) else scalar
    return rows


class Convertible(Protocol):
    """Equations with coordinates of their own; those of a spanning tree, if they have a `tree`."""

    scene: Scene

    def coordinates(self, state: State) -> tuple[Array, Array]:
        """Return q (nq,) and v (nv,) of a state."""


def coordinates(system: Convertible, states: Sequence[State]) -> tuple[Array, Array]:
    """Convert n consistent states into q (n, nq) and v (n, nv), as `system.coordinates` does one by one."""
    if couplings(system.scene):  # the revolution of an angle depends on those of others
        q, v = (np.array(rows) for rows in zip(*map(system.coordinates, states), strict=True))
        return q, v
    over_stacks: Any = copy.copy(system)
    if hasattr(system, "tree"):
        over_stacks.tree = _TreeOverStacks(system.tree)
    found = []
    for portion in _portions(len(states)):
        part = states[portion]
        q, v = over_stacks.coordinates(stack(arrays(part)))
        found.append((_floats(q, len(part)), _floats(v, len(part))))
    q, v = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return q, v


def _portions(count: int) -> list[slice]:
    return [slice(begin, begin + PORTION) for begin in range(0, count, PORTION)]


class _TreeOverStacks(SpanningTree):
    """A tree whose coordinates of a state may be found over `Stack`."""

    def __init__(self, tree: SpanningTree) -> None:
        self.__dict__.update(vars(tree))

    def coordinates(self, state: State) -> tuple[Array, Array]:
        """Convert as any tree does; rotations of balls by products of Euler parameters, without a choice."""
        frames = [
            frame._replace(rotation=frame.rotation @ initial.T)
            for frame, initial in zip(state.frames(), self.initial_rotations, strict=True)
        ]
        turns = [
            product(p, conjugate(body.quaternion))
            for p, body in zip(state.quaternion, self.mechanism.bodies, strict=True)
        ]
        q: list[Any] = []
        v: list[Any] = []
        for kept in self.joints:
            equations = self.equations(kept.joint)
            i, j = frames[equations.first], frames[equations.second]
            values = [(c.phi(i, j), c.jacobian(i, j).rate(i, j)) for c in equations.coordinates]
            single = iter(values if kept.forward else values[::-1])
            parent, child = frames[kept.parent], frames[kept.child]
            for motion in kept.motions:
                if motion.kind == "ball":
                    q.extend(_normalized(product(conjugate(turns[kept.parent]), turns[kept.child])))
                    v.extend(child.rotation.T @ (child.angular_velocity - parent.angular_velocity))
                else:
                    coordinate, rate = next(single)
                    q.extend(coordinate)
                    v.extend(rate)
        return objects(q), objects(v)


def _normalized(p: Array) -> list[Stack]:
    """Scale Euler parameters (4,) to norm 1 with e0 >= 0."""
    values = np.array([scalar.values for scalar in p])
    values *= np.where(values[0] < 0.0, -1.0, 1.0) / np.linalg.norm(values, axis=0)
    return [Stack(row) for row in values]


# Checks


def check(scene: Scene, states: Sequence[State]) -> None:
    """Raise `MechanismError` for the first state that the scene would not start from, with its number.

    The scene itself judges every state that is not surely consistent.
    """
    count = len(scene.mechanism.bodies)
    for portion in _portions(len(states)):
        part = states[portion]
        unsure = [k for k, state in enumerate(part) if not _shaped(state, count)]
        if not unsure:
            unsure = np.flatnonzero(~_consistent(scene, part)).tolist()
        for k in unsure:
            if not isinstance(part[k], State):
                raise MechanismError(f"run {portion.start + k}", f"starts from {part[k]!r:.200}", "a State")
            try:
                initial_state(replace(scene, initial_state=part[k]))
            except MechanismError as error:
                element = f"run {portion.start + k}: {error.element}"
                raise MechanismError(element, error.problem, error.needed) from error


def _shaped(state: object, bodies: int) -> bool:
    """Return True for a state of so many bodies, all floats."""
    if not isinstance(state, State):
        return False
    arrays = ((getattr(state, name), width) for name, width in WIDTHS.items())
    return all(
        isinstance(array, np.ndarray) and array.dtype.kind == "f" and array.shape == (bodies, width)
        for array, width in arrays
    )


def _consistent(scene: Scene, states: Sequence[State]) -> Array:
    """Return True (n,) for each state that surely passes all that `newton_euler.initial_state` checks.

    None does where coordinates are coupled or prescribed: that is left to the scene.
    """
    if couplings(scene):
        return np.zeros(len(states), dtype=bool)
    found = arrays(states)
    position, quaternion, velocity, spin = found
    mechanism, count = scene.mechanism, len(states)
    ground, size = mechanism.bodies[0], mechanism.size
    with np.errstate(all="ignore"):
        squares = quaternion[:, 0, :, None] * quaternion[:, 0, None, :]
        turn = squares - np.outer(ground.quaternion, ground.quaternion)
        speed = np.linalg.norm(velocity, axis=2).max(axis=1) + size * np.linalg.norm(spin, axis=2).max(axis=1)
        shares = [
            np.abs(np.linalg.norm(quaternion, axis=2) - 1.0) / UNIT_TOLERANCE,
            np.linalg.norm(position[:, :1] - ground.center_of_mass, axis=2) / CLOSURE_TOLERANCE,
            np.linalg.norm(turn, axis=(1, 2))[:, None] / UNIT_TOLERANCE,
        ]
        sure = ~np.any(velocity[:, 0], axis=1) & ~np.any(spin[:, 0], axis=1) & np.isfinite(speed)
        frames = stack(found).frames()
        for equations in mechanism.equations:
            i, j = frames[equations.first], frames[equations.second]
            shares.append(np.abs(_floats(equations.phi(i, j), count)) / CLOSURE_TOLERANCE)
            rates = np.abs(_floats(equations.jacobian(i, j).rate(i, j), count))
            allowed = VELOCITY_TOLERANCE * speed[:, None] * np.where(equations.is_length, 1.0, 1.0 / size)
            sure &= np.all(rates <= SURE * allowed, axis=1)
        at = Surroundings(mechanism, [body.pose for body in mechanism.bodies], frames, {}, 0.0)
        for force in scene.forces:
            for span in force.spans(at):
                d = _floats(span, count)
                sure &= np.linalg.norm(d, axis=1) > CLOSURE_TOLERANCE / SURE
        return np.asarray(sure & np.all(np.concatenate(shares, axis=1) <= SURE, axis=1))
