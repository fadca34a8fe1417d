"""Loops, joint coordinates and the direction of a body's axis in many configurations at once, compiled.

Chosen joint coordinates are driving constraints (`newton_euler.equations.driven`). Jacobians are derivatives
with respect to velocities of the spanning tree.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from newton_euler.codegen.compile import NativeFunction
from newton_euler.codegen.program import native_program
from newton_euler.compiled.equations import NOT_COMPILED_FIELDS
from newton_euler.compiled.outputs import at_rows
from newton_euler.equations.couplings import couplings
from newton_euler.equations.dense import RANK_TOLERANCE
from newton_euler.equations.driven import driven
from newton_euler.equations.kinematics import TreeKinematics
from newton_euler.equations.redundancy import inherit_mobility, mobility, rows_left_out
from newton_euler.errors import MechanismError, quoted, real_array
from newton_euler.model.description import ArrayField, description
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.model.smooth_functions import Polynomial
from newton_euler.model.state import State
from newton_euler.scalars import Array, Scalar

MAX_JOINT_STEP = 0.2
"""Largest motion of a joint in one step, rad or sizes of the mechanism."""

PARALLEL_SINE = 1e-15
"""Sine of the angle between two vectors below which their plane is round-off."""

INVALID_RESULT = 1e6
"""Value of all results of a configuration that are not finite."""


def products(matrices: Array, vectors: Array) -> Array:
    """Compute A x (n, i) for each of n matrices (n, i, j) and vectors (n, j)."""
    return np.einsum("nij,nj->ni", matrices, vectors)


def within_revolution(angles: Array) -> Array:
    """Reduce angles to half a revolution at most, rad."""
    return np.asarray(angles - 2.0 * np.pi * np.round(angles / (2.0 * np.pi)))


@description
class Axis:
    """An axis fixed in a body, as the normal of a panel.

    Attributes:
        body: name of the body.
        axis: (3,) in the frame of the body, of any length but 0; kept as a unit vector.

    Raises:
        MechanismError: for an axis without a direction.

    Examples:
        >>> Axis("panel_7", [0, 0, 2]).axis
        array([0., 0., 1.])
    """

    body: str
    axis: ArrayField

    def __post_init__(self) -> None:
        unit = unit_vectors(f"axis of body {quoted(self.body)}", "axis", self.axis)
        if unit.shape != (3,):
            problem = f"axis has shape {unit.shape}"
            raise MechanismError(f"axis of body {quoted(self.body)}", problem, "three numbers")
        object.__setattr__(self, "axis", unit)


def unit_vectors(element: str, name: str, given: object) -> Array:
    """Convert vectors (..., 3) to unit vectors; raises `MechanismError` for a vector without a direction."""
    try:
        vectors = real_array(given)
    except (TypeError, ValueError, OverflowError):
        vectors = np.zeros(0)
    if vectors.shape[-1:] != (3,) or not vectors.size:
        raise MechanismError(element, f"{name} is {quoted(given)}", "three numbers, or rows of them, (n, 3)")
    with np.errstate(all="ignore"):
        vectors = vectors / np.max(np.abs(vectors), axis=-1, keepdims=True)
        vectors = vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
    wrong = np.flatnonzero(~np.isfinite(vectors).all(axis=-1))
    if wrong.size:
        value = np.reshape(real_array(given), (-1, 3))[wrong[0]].tolist()
        raise MechanismError(element, f"{name} is {value}", "finite numbers, not all of them 0")
    return vectors


def across(vectors: Array) -> Array:
    """Compute unit vectors perpendicular to unit vectors (n, 3)."""
    found = np.cross(vectors, np.eye(3)[np.argmin(np.abs(vectors), axis=1)])
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))


def smallest_turns(start: Array, end: Array) -> Array:
    """Compute the rotation vectors (n, 3), rad, of the smallest rotations from unit vectors to others."""
    sine = np.cross(start, end)
    length = np.linalg.norm(sine, axis=1, keepdims=True)
    angle = np.arctan2(length, np.sum(start * end, axis=1, keepdims=True))
    return np.asarray(angle * np.divide(sine, length, out=across(start), where=length > PARALLEL_SINE))


@dataclass(frozen=True, eq=False)
class Goal:
    """Wanted values of chosen coordinates, and directions of the axis, for n configurations.

    Attributes:
        coordinates: (n, m) m or rad; (n, 0) for none.
        towards: (n, 3) unit vectors, world frame; (n, 0) for none.
    """

    coordinates: Array
    towards: Array

    def __getitem__(self, rows: Any) -> Goal:
        return Goal(self.coordinates[rows], self.towards[rows])

    def with_others(self, other: Goal) -> Goal:
        """Append other goals."""
        pairs = (self.coordinates, other.coordinates), (self.towards, other.towards)
        return Goal(*(np.concatenate(pair) for pair in pairs))


class Chain:
    """The kinematic chain of a scene with chosen coordinates and an axis, compiled.

    Prescribed motions of the scene hold their values at time 0, except motions of chosen coordinates.

    Attributes:
        keys, axis: the chosen joint coordinates, and an axis of a body or None.
        goals, pointing: number of coordinates with goals, the first of them; True if the axis has a goal.
        units: (m,) of the coordinates: the size of the mechanism for slides, m, 1 for angles.
        turns: (m,) True for angles that are the same after a full revolution.
        freedoms: degrees of freedom.
        system: equations in joint coordinates, with driving constraints for the chosen coordinates.
        closing, driving: rows of `phi` that close loops, and rows of the chosen coordinates minus `offsets`
            (m,).
        independent: rows that imply all rows of `closing`.
        start: q (nq,) of the initial state.
    """

    def __init__(
        self, scene: Scene, keys: Sequence[Key], goals: int, axis: Axis | None, pointing: bool, state: State
    ) -> None:
        self.scene, self.keys, self.axis = scene, tuple(keys), axis
        self.goals, self.pointing = goals, pointing
        # the mechanism: motions that are held, and driving constraints for the other chosen coordinates
        held = tuple(motion.held() for motion in scene.motions if motion.key not in self.keys[:goals])
        values = {motion.key: motion.function.value(0.0) for motion in held}
        chosen = {key: Polynomial((0.0,)) for key in self.keys if key not in values}
        loops = replace(scene.without_forces(), motions=held, initial_state=state)
        if not scene.motions:
            mobility(scene)  # decided once for all chains
            inherit_mobility(loops, scene)
        found = mobility(loops)
        mechanism = driven(scene, chosen, held, initial_state=None)
        self.driven = mechanism.scene
        self.system = TreeKinematics(self.driven)
        self.freedoms = found.degrees_of_freedom
        # rows of the driving constraints, of all others, and of an independent set
        closures = self.system.rows - len(self.system.couplings)
        places = {motion.key: closures + k for k, motion in enumerate(self.driven.motions)}
        self.driving = np.array([places[key] for key in self.keys], dtype=int)
        self.offsets = np.array([values.get(key, 0.0) for key in self.keys])
        own = np.delete(np.arange(len(self.system.phi_units)), mechanism.rows(self.system))
        self.closing = np.delete(own, rows_left_out(TreeKinematics(loops)))
        self.independent = own[found.independent]
        self.units = self.system.phi_units[self.driving]
        linked = {key for coupling in couplings(loops) for key in coupling.factors}
        turns = [not scene.mechanism.is_slide(*key) and key not in linked for key in self.keys]
        self.turns = np.array(turns, dtype=bool)
        self.start = self.system.coordinates(state)[0]

    @cached_property
    def function(self) -> NativeFunction:
        """Function of (q, step, 0): q moved by the step, phi, the axis, poses and nonzeros of Jacobians."""
        axis = self.axis and (self.axis.body, self.axis.axis)
        inputs, chosen = self.system.nq + self.system.nv + 1, (self.driven, self.keys, axis)
        neutral = NOT_COMPILED_FIELDS
        return native_program("configurations", inputs, self._trace, *chosen, neutral=neutral, many=True)

    def _trace(self, x: Array) -> tuple[list[Scalar], list[tuple[int, int]]]:
        """Trace the results, and the places of nonzeros in the Jacobians as their layout."""
        system = self.system
        q, rest = system.retract(x[: system.nq], x[system.nq : -1]), np.zeros(system.nv)
        phi, rows = system.phi_and_jacobian(q)
        places = [(i, k) for i, row in enumerate(rows) for k in row]
        scalars = [entry for row in rows for entry in row.values()]
        state, axis = system.state(q, rest), np.zeros(0)
        if self.axis is not None:
            body = self.scene.mechanism.body_index(self.axis.body)
            link = system.links(q, rest)[body]
            axis = link.frame.rotation @ (system.tree.initial_rotations[body] @ self.axis.axis)
            places += [(i, k) for i in range(len(rows), len(rows) + 3) for k in link.path]
            scalars += [*link.angular.ravel()]
        values = [*q, *phi, *axis, *state.position.ravel(), *state.quaternion.ravel(), *scalars]
        return values, places

    def at(self, q: Array, step: Array | None = None) -> Configurations:
        """Evaluate the configurations q (n, nq), moved by steps (n, nv) if given."""
        function, system = self.function, self.system
        states = np.zeros((len(q), system.nq + system.nv))
        states[:, : system.nq] = q
        if step is not None:
            states[:, system.nq :] = step
        results = at_rows(function, np.column_stack([states, np.zeros(len(q))]))
        results[~np.isfinite(results).all(axis=1)] = INVALID_RESULT
        return Configurations(self, results)

    def goal_at(self, at: Configurations) -> Goal:
        """Return the goals that configurations meet."""
        return Goal(at.coordinates[:, : self.goals], at.direction[:, : 3 * self.pointing])

    def difference(self, goal: Goal, other: Goal) -> tuple[Array, Array]:
        """Compute goal - other: coordinates (n, m), and the rotation vectors (n, 3) from other to goal."""
        x = goal.coordinates - other.coordinates
        turns = self.turns[: self.goals]
        x[:, turns] = within_revolution(x[:, turns])
        if not self.pointing:
            return x, np.zeros((len(x), 0))
        return x, smallest_turns(other.towards, goal.towards)

    def between(self, goal: Goal, other: Goal, share: Array) -> Goal:
        """Interpolate between goals: `other` at share 0, `goal` at share 1, for shares (n,)."""
        x, turn = self.difference(goal, other)
        coordinates = other.coordinates + share[:, None] * x
        if not self.pointing:
            return Goal(coordinates, goal.towards)
        angle = np.linalg.norm(turn, axis=1, keepdims=True)
        ahead = np.cross(np.divide(turn, angle, out=np.zeros_like(turn), where=angle > 0.0), other.towards)
        angle *= share[:, None]
        return Goal(coordinates, np.cos(angle) * other.towards + np.sin(angle) * ahead)

    def embed(self, goal: Goal) -> Array:
        """Compute points (n, e) whose distances are the distances of goals, for goals near each other."""
        x, turns = goal.coordinates / self.units[: self.goals], self.turns[: self.goals]
        turned = x[:, turns]
        return np.hstack([x[:, ~turns], np.sin(turned), np.cos(turned), goal.towards])


class Configurations:
    """Evaluated configurations of a chain; rows of Jacobians are dimensionless, by dimensionless velocities.

    Attributes:
        q: (n, nq).
        phi: (n, k) dimensionless residuals of loops.
        coordinates: (n, m) the chosen ones, m or rad.
        direction: (n, 3) of the axis, world frame; (n, 0) for none.
        position, quaternion: (n, b, 3) and (n, b, 4) of all bodies.
        jacobian: (n, rows, nv) of the system's residuals, then three of the angular velocity of the axis.
    """

    def __init__(self, chain: Chain, values: Array) -> None:
        """`values` (n, outputs) are results of `Chain.function`."""
        system, bodies = chain.system, len(chain.scene.mechanism.bodies)
        self.chain, self.values = chain, values
        sizes = [system.nq, len(system.phi_units), 3 * (chain.axis is not None), 3 * bodies, 4 * bodies]
        self.q, phi, self.direction, position, quaternion, self._nonzeros = np.split(
            values, np.cumsum(sizes), axis=1
        )
        self.phi = (phi / system.phi_units)[:, chain.closing]
        self.coordinates = phi[:, chain.driving] + chain.offsets
        self.position, self.quaternion = position.reshape(-1, bodies, 3), quaternion.reshape(-1, bodies, 4)

    def __getitem__(self, rows: Any) -> Configurations:
        found = Configurations(self.chain, self.values[rows])
        if "spaces" in self.__dict__:  # computed before
            found.__dict__["jacobian"] = self.jacobian[rows]
            found.__dict__["spaces"] = tuple(each[rows] for each in self.spaces)
        return found

    def __len__(self) -> int:
        return len(self.values)

    @cached_property
    def jacobian(self) -> Array:
        system = self.chain.system
        units = np.concatenate([system.phi_units, np.ones(3 * (self.chain.axis is not None))])
        found = np.zeros((len(self), len(units), system.nv))
        rows, columns = np.array(self.chain.function.layout, dtype=int).reshape(-1, 2).T
        found[:, rows, columns] = self._nonzeros * (system.velocity_units[columns] / units[rows])
        return found

    @property
    def loops(self) -> Array:
        """The Jacobian (n, k, nv) of the loops."""
        return self.jacobian[:, self.chain.closing]

    @property
    def driving(self) -> Array:
        """The Jacobian (n, m, nv) of the chosen coordinates."""
        return self.jacobian[:, self.chain.driving]

    @property
    def turning(self) -> Array:
        """The angular velocity (n, 3, nv) of the body with the axis; (n, 0, nv) for none."""
        return self.jacobian[:, len(self.chain.system.phi_units) :]

    @cached_property
    def spaces(self) -> tuple[Array, Array]:
        """`back` and `tangent`."""
        system = self.chain.system
        rank = system.nv - self.chain.freedoms
        if rank == 0:
            shape = len(self), system.nv, self.phi.shape[1]
            return np.zeros(shape), np.tile(np.eye(system.nv), (len(self), 1, 1))
        u, s, vt = np.linalg.svd(self.loops)
        s = s[:, :rank, None]
        inverse = np.divide(1.0, s, out=np.zeros_like(s), where=s > RANK_TOLERANCE)
        back = np.swapaxes(vt[:, :rank], 1, 2) @ (inverse * np.swapaxes(u[:, :, :rank], 1, 2))
        return back, vt[:, rank:]

    @property
    def back(self) -> Array:
        """The pseudo-inverse (n, nv, k) of the Jacobian of the loops."""
        return self.spaces[0]

    @property
    def tangent(self) -> Array:
        """Orthonormal velocities (n, f, nv) that leave the loops closed."""
        return self.spaces[1]

    def misses(self, goal: Goal) -> tuple[Array, Array]:
        """Compute dimensionless distances (n, t) to goals, and their Jacobian (n, t, nv).

        Those of the axis are rotations: about the axis that turns it to its goal, less the angle that is
        missing, and about the one perpendicular to it.
        """
        chain = self.chain
        x, turn = chain.difference(goal, chain.goal_at(self))
        misses, rows = -x / chain.units[: chain.goals], self.driving[:, : chain.goals]
        if not chain.pointing:
            return misses, rows
        angle = np.linalg.norm(turn, axis=1, keepdims=True)
        first = np.divide(turn, angle, out=across(self.direction), where=angle > 0.0)
        second = np.cross(self.direction, first)
        two = np.stack([first, second], axis=1) @ self.turning
        return np.hstack([misses, -angle, np.zeros_like(angle)]), np.concatenate([rows, two], axis=1)

    def moved(self, step: Array) -> Configurations:
        """Evaluate the configurations moved by dimensionless steps (n, nv), long ones shortened."""
        largest = np.max(np.abs(step), axis=1, keepdims=True, initial=0.0)
        step = step * np.minimum(1.0, MAX_JOINT_STEP / np.maximum(largest, MAX_JOINT_STEP))
        return self.chain.at(self.q, step * self.chain.system.velocity_units)
