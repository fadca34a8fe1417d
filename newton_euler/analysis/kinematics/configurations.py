"""Compiled evaluation of many configurations: loop closure, joint coordinates, direction of a body's axis.

A configuration is a vector q of coordinates of the spanning tree: the mechanism without the joints that close
loops. Chosen joint coordinates are driving constraints (`newton_euler.equations.driven`): each has the
residual coordinate - offset. Joint coordinates have keys (joint, number). Jacobians are derivatives with
respect to the nv velocities of the spanning tree. All arrays begin with an axis for the n configurations. f
is the number of degrees of freedom.
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
"""Sine of the angle between two vectors below which the vectors are parallel, and any perpendicular axis is
used as the axis of rotation."""

INVALID_RESULT = 1e6
"""Value of all results of a configuration that are not finite."""


def products(matrices: Array, vectors: Array) -> Array:
    """Compute A x (n, i) for each of n matrices (n, i, j) and vectors (n, j)."""
    return np.einsum("nij,nj->ni", matrices, vectors)


def within_revolution(angles: Array) -> Array:
    """Reduce angles, rad, to the range from -pi to pi by full revolutions."""
    return np.asarray(angles - 2.0 * np.pi * np.round(angles / (2.0 * np.pi)))


@description
class Axis:
    """An axis fixed in a body, such as the normal of a panel.

    Attributes:
        body: name of the body.
        axis: (3,) in the frame of the body, of any length but 0; kept as a unit vector.

    Raises:
        MechanismError: for an axis without a direction.

    Examples:
        >>> normal = Axis("panel_7", [0, 0, 2])
        >>> poses = solve_poses(load("tracker"), {"slide_12": 0.02, "slide_13": 0.02}, axis=normal)
        >>> print(np.asarray(poses.direction).round(2))  # world frame
        [[-0.02  0.02  1.  ]]
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


def perpendicular_to(vectors: Array) -> Array:
    """Compute unit vectors perpendicular to unit vectors (n, 3)."""
    perpendicular = np.cross(vectors, np.eye(3)[np.argmin(np.abs(vectors), axis=1)])
    return np.asarray(perpendicular / np.linalg.norm(perpendicular, axis=1, keepdims=True))


def smallest_turns(start: Array, end: Array) -> Array:
    """Compute the rotation vectors (n, 3), rad, of the smallest rotations from unit vectors to others."""
    sine = np.cross(start, end)
    length = np.linalg.norm(sine, axis=1, keepdims=True)
    angle = np.arctan2(length, np.sum(start * end, axis=1, keepdims=True))
    return np.asarray(
        angle * np.divide(sine, length, out=perpendicular_to(start), where=length > PARALLEL_SINE)
    )


@dataclass(frozen=True, eq=False)
class Goal:
    """Goals for n configurations: values of joint coordinates, and directions of an axis.

    Attributes:
        coordinates: (n, m) wanted values, m or rad; (n, 0) for none.
        towards: (n, 3) wanted directions, unit vectors, world frame; (n, 0) for none.
    """

    coordinates: Array
    towards: Array

    def __getitem__(self, rows: Any) -> Goal:
        """Return the goals of some of the configurations, given by indices, a mask or a slice."""
        return Goal(self.coordinates[rows], self.towards[rows])

    def with_others(self, other: Goal) -> Goal:
        """Return these goals, followed by others."""
        pairs = (self.coordinates, other.coordinates), (self.towards, other.towards)
        return Goal(*(np.concatenate(pair) for pair in pairs))


class Chain:
    """The mechanism of a scene with m chosen joint coordinates and an axis, compiled for many configurations.

    Prescribed motions of the scene hold their values at time 0, except motions of chosen coordinates.

    Attributes:
        keys: the chosen joint coordinates.
        axis: an axis of a body, or None.
        goal_count: number of chosen coordinates that have goals; they come first.
        has_axis_goal: True if the axis has a goal.
        units: (m,) units of the coordinates: the size of the mechanism, m, for slides, 1 for angles.
        is_periodic: (m,) True for angles that are the same after a full revolution.
        freedoms: number of degrees of freedom f.
        driven: the scene whose motions drive the chosen coordinates.
        system: equations in joint coordinates, with driving constraints for the chosen coordinates.
        closing: numbers of the constraint rows (of the residuals phi) that always hold: loops, couplings
            and held motions, without almost redundant rows.
        driving: (m,) numbers of the driving constraints. Their residual is coordinate - offset.
        offsets: (m,) offsets of the driving constraints, m or rad. An offset is not 0 if a held motion drives
            a chosen coordinate that has no goal.
        independent: numbers of constraint rows that imply all rows of `closing`.
        start: q (nq,) of the initial state.
    """

    def __init__(
        self,
        scene: Scene,
        keys: Sequence[Key],
        goal_count: int,
        axis: Axis | None,
        has_axis_goal: bool,
        state: State,
    ) -> None:
        """Analyze the mechanism; `state` is the initial state, see the attributes for the other arguments."""
        self.scene, self.keys, self.axis = scene, tuple(keys), axis
        self.goal_count, self.has_axis_goal = goal_count, has_axis_goal
        # the mechanism: motions that are held, and driving constraints for the other chosen coordinates
        held = tuple(
            motion.held_at_start() for motion in scene.motions if motion.key not in self.keys[:goal_count]
        )
        values = {motion.key: motion.function.value(0.0) for motion in held}
        functions = {key: Polynomial((0.0,)) for key in self.keys if key not in values}
        without_driving = replace(scene.without_forces(), motions=held, initial_state=state)
        if not scene.motions:
            mobility(scene)  # analyzed once for all chains of the scene
            inherit_mobility(without_driving, scene)
        analysis = mobility(without_driving)
        mechanism = driven(scene, functions, held, initial_state=None)
        self.driven = mechanism.scene
        self.system = TreeKinematics(self.driven)
        self.freedoms = analysis.degrees_of_freedom
        # rows of the driving constraints, of all others, and of an independent set; in phi, rows of joints
        # come first, then those of `couplings`, of which prescribed motions are the first
        joint_rows = self.system.rows - len(self.system.couplings)
        motion_rows = {motion.key: joint_rows + k for k, motion in enumerate(self.driven.motions)}
        self.driving = np.array([motion_rows[key] for key in self.keys], dtype=int)
        self.offsets = np.array([values.get(key, 0.0) for key in self.keys])
        other_rows = np.delete(np.arange(len(self.system.phi_units)), mechanism.rows(self.system))
        self.closing = np.delete(other_rows, rows_left_out(TreeKinematics(without_driving)))
        self.independent = other_rows[analysis.independent]
        self.units = self.system.phi_units[self.driving]
        # couplings such as gears distinguish revolutions of an angle
        coupled = {key for coupling in couplings(without_driving) for key in coupling.factors}
        periodic = [not scene.mechanism.is_slide(*key) and key not in coupled for key in self.keys]
        self.is_periodic = np.array(periodic, dtype=bool)
        self.start = self.system.coordinates(state)[0]

    @cached_property
    def function(self) -> NativeFunction:
        """Native function of (q, step, time), whose results `Configurations` splits; time is unused, 0.

        The results are q moved by the step, residuals phi, direction of the axis, poses, and nonzeros of
        Jacobians.
        """
        axis = self.axis and (self.axis.body, self.axis.axis)
        inputs, depends_on = self.system.nq + self.system.nv + 1, (self.driven, self.keys, axis)
        neutral = NOT_COMPILED_FIELDS  # fields of the scene that do not change the code
        return native_program("configurations", inputs, self._trace, *depends_on, neutral=neutral, many=True)

    def _trace(self, x: Array) -> tuple[list[Scalar], list[tuple[int, int]]]:
        """Trace the results of `function` over symbolic scalars x, and return the layout of the nonzeros.

        The layout lists (row, column) of each nonzero in the Jacobian. Its rows are those of the constraints,
        then three of the angular velocity of the body with the axis.
        """
        system = self.system
        q, rest = system.retract(x[: system.nq], x[system.nq : -1]), np.zeros(system.nv)
        phi, rows = system.phi_and_jacobian(q)
        places = [(i, k) for i, row in enumerate(rows) for k in row]
        scalars = [entry for row in rows for entry in row.values()]
        state, axis = system.state(q, rest), np.zeros(0)
        if self.axis is not None:
            body = self.scene.mechanism.body_index(self.axis.body)
            # frames of links are parallel to the world at the initial pose; `axis` is in the body frame
            link = system.links(q, rest)[body]
            axis = link.frame.rotation @ (system.tree.initial_rotations[body] @ self.axis.axis)
            places += [(i, k) for i in range(len(rows), len(rows) + 3) for k in link.path]
            scalars += [*link.angular.ravel()]
        values = [*q, *phi, *axis, *state.position.ravel(), *state.quaternion.ravel(), *scalars]
        return values, places

    def at(self, q: Array, step: Array | None = None) -> Configurations:
        """Evaluate the configurations q (n, nq), displaced by steps (n, nv), rad or m, if given."""
        function, system = self.function, self.system
        states = np.zeros((len(q), system.nq + system.nv))
        states[:, : system.nq] = q
        if step is not None:
            states[:, system.nq :] = step
        results = at_rows(function, np.column_stack([states, np.zeros(len(q))]))
        results[~np.isfinite(results).all(axis=1)] = INVALID_RESULT
        return Configurations(self, results)

    def goal_at(self, configs: Configurations) -> Goal:
        """Return the goals that given configurations meet exactly."""
        return Goal(configs.coordinates[:, : self.goal_count], configs.direction[:, : 3 * self.has_axis_goal])

    def difference(self, goal: Goal, other: Goal) -> tuple[Array, Array]:
        """Compute goal - other: coordinates (n, m), and the rotation vectors (n, 3) from other to goal."""
        x = goal.coordinates - other.coordinates
        is_periodic = self.is_periodic[: self.goal_count]
        x[:, is_periodic] = within_revolution(x[:, is_periodic])
        if not self.has_axis_goal:
            return x, np.zeros((len(x), 0))
        return x, smallest_turns(other.towards, goal.towards)

    def between(self, goal: Goal, other: Goal, share: Array) -> Goal:
        """Interpolate between goals: `other` at share 0, `goal` at share 1, for shares (n,)."""
        x, turn = self.difference(goal, other)
        coordinates = other.coordinates + share[:, None] * x
        if not self.has_axis_goal:
            return Goal(coordinates, goal.towards)
        # rotate the direction in the plane of both directions; `perpendicular` lies in this plane
        angle = np.linalg.norm(turn, axis=1, keepdims=True)
        rotation_axis = np.divide(turn, angle, out=np.zeros_like(turn), where=angle > 0.0)
        perpendicular = np.cross(rotation_axis, other.towards)
        angle *= share[:, None]
        return Goal(coordinates, np.cos(angle) * other.towards + np.sin(angle) * perpendicular)

    def embed(self, goal: Goal) -> Array:
        """Map goals to points (n, e) in a Euclidean space.

        The distance of two points approximates the distance of nearby goals. Angles become points (sin, cos)
        of a circle, so that angles one revolution apart coincide.
        """
        is_angle = self.is_periodic[: self.goal_count]
        x = goal.coordinates / self.units[: self.goal_count]
        angles = x[:, is_angle]
        return np.hstack([x[:, ~is_angle], np.sin(angles), np.cos(angles), goal.towards])


class Configurations:
    """Results of the evaluation of n configurations of a chain.

    Residuals, rows of Jacobians and velocities are dimensionless: lengths are divided by the size of the
    mechanism.

    Attributes:
        chain: the chain.
        values: (n, outputs) all results of `Chain.function`, from which the other attributes are extracted.
        q: (n, nq) coordinates of the spanning tree.
        phi: (n, k) residuals of the rows `Chain.closing`.
        coordinates: (n, m) chosen coordinates, m or rad.
        direction: (n, 3) direction of the axis, world frame; (n, 0) for none.
        position, quaternion: (n, b, 3) and (n, b, 4) poses of all bodies.
    """

    def __init__(self, chain: Chain, values: Array) -> None:
        """Split the results `values` (n, outputs) of `Chain.function`."""
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
        """Return some of the configurations, given by indices, a mask or a slice."""
        selected = Configurations(self.chain, self.values[rows])
        if "spaces" in self.__dict__:  # reuse cached properties that are computed already
            selected.__dict__["jacobian"] = self.jacobian[rows]
            selected.__dict__["spaces"] = tuple(each[rows] for each in self.spaces)
        return selected

    def __len__(self) -> int:
        return len(self.values)

    @cached_property
    def jacobian(self) -> Array:
        """The Jacobian (n, rows, nv) of all residuals, then three rows of the axis' angular velocity."""
        system = self.chain.system
        units = np.concatenate([system.phi_units, np.ones(3 * (self.chain.axis is not None))])
        jacobian = np.zeros((len(self), len(units), system.nv))
        rows, columns = np.array(self.chain.function.layout, dtype=int).reshape(-1, 2).T
        jacobian[:, rows, columns] = self._nonzeros * (system.velocity_units[columns] / units[rows])
        return jacobian

    @property
    def loops(self) -> Array:
        """The Jacobian (n, k, nv) of the rows `Chain.closing`."""
        return self.jacobian[:, self.chain.closing]

    @property
    def coordinate_jacobian(self) -> Array:
        """The Jacobian (n, m, nv) of the chosen coordinates."""
        return self.jacobian[:, self.chain.driving]

    @property
    def axis_jacobian(self) -> Array:
        """The angular velocity (n, 3, nv) of the body with the axis; (n, 0, nv) for none."""
        return self.jacobian[:, len(self.chain.system.phi_units) :]

    @cached_property
    def spaces(self) -> tuple[Array, Array, Array]:
        """`loop_inverse`, `tangent` and `weakest_loop`, from one singular value decomposition."""
        system = self.chain.system
        rank = system.nv - self.chain.freedoms
        if rank == 0:
            shape = len(self), system.nv, self.phi.shape[1]
            no_loops = np.full(len(self), np.inf)
            return np.zeros(shape), np.tile(np.eye(system.nv), (len(self), 1, 1)), no_loops
        u, s, vt = np.linalg.svd(self.loops)
        weakest, s = s[:, rank - 1], s[:, :rank, None]
        inverse = np.divide(1.0, s, out=np.zeros_like(s), where=s > RANK_TOLERANCE)
        pseudo_inverse = np.swapaxes(vt[:, :rank], 1, 2) @ (inverse * np.swapaxes(u[:, :, :rank], 1, 2))
        return pseudo_inverse, vt[:, rank:], weakest

    @property
    def loop_inverse(self) -> Array:
        """The pseudo-inverse (n, nv, k) of the Jacobian of the loops."""
        return self.spaces[0]

    @property
    def tangent(self) -> Array:
        """Orthonormal velocities (n, f, nv) that leave the loops closed."""
        return self.spaces[1]

    @property
    def weakest_loop(self) -> Array:
        """Smallest singular value (n,) of the Jacobian of the loops: 0 where they lose rank."""
        return self.spaces[2]

    def goal_errors(self, goal: Goal) -> tuple[Array, Array]:
        """Compute the dimensionless errors (n, e) of goals, configuration minus goal, and their Jacobian.

        The direction of the axis has two errors, rotations about two perpendicular vectors: minus the angle
        to the goal about the vector that rotates the axis to the goal, and 0 about the other vector. e is the
        number of coordinates with goals, plus 2 for a direction. The Jacobian is (n, e, nv).
        """
        chain = self.chain
        x, turn = chain.difference(goal, chain.goal_at(self))
        errors, rows = -x / chain.units[: chain.goal_count], self.coordinate_jacobian[:, : chain.goal_count]
        if not chain.has_axis_goal:
            return errors, rows
        angle = np.linalg.norm(turn, axis=1, keepdims=True)
        first = np.divide(turn, angle, out=perpendicular_to(self.direction), where=angle > 0.0)
        second = np.cross(self.direction, first)
        axis_rows = np.stack([first, second], axis=1) @ self.axis_jacobian
        return np.hstack([errors, -angle, np.zeros_like(angle)]), np.concatenate([rows, axis_rows], axis=1)

    def step_by(self, step: Array) -> Configurations:
        """Evaluate the configurations after dimensionless steps (n, nv).

        A step whose largest component exceeds `MAX_JOINT_STEP` is shortened.
        """
        largest = np.max(np.abs(step), axis=1, keepdims=True, initial=0.0)
        step = step * np.minimum(1.0, MAX_JOINT_STEP / np.maximum(largest, MAX_JOINT_STEP))
        return self.chain.at(self.q, step * self.chain.system.velocity_units)
