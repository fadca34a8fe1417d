"""Forward and inverse kinematics: poses for chosen joint coordinates and directions of a body's axis.

Compiled equations solve thousands of poses at once (`newton_euler.analysis.kinematics.continuation`).

An assembly branch is a set of poses that the mechanism can reach from each other without passing a singular
configuration, such as the elbow-up poses of a four-bar linkage. Joint coordinates have names, and keys
(joint, number).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from newton_euler.analysis.kinematics.configurations import (
    Axis,
    Chain,
    Configurations,
    Goal,
    products,
    unit_vectors,
    within_revolution,
)
from newton_euler.analysis.kinematics.continuation import (
    MAX_RESIDUAL,
    approach,
    follow,
    gradient,
    half_square,
    largest,
    sample_branch,
)
from newton_euler.analysis.kinematics.point import Point, positions
from newton_euler.arguments import checked
from newton_euler.equations.dense import RANK_TOLERANCE
from newton_euler.errors import MechanismError, OptionError, finite_array, listed
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.model.state import State
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array

MAX_GOAL = 1e6
"""Largest distance of a goal from the initial pose, rad or sizes of the mechanism."""

MET = 1e-9
"""Largest error of a goal that a pose meets: rad, or lengths divided by the size of the mechanism."""

STATIONARY_SLOPE = 1e-7
"""Slope of the distance to the goal, per dimensionless motion, below which no pose nearby is nearer."""


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses of a mechanism for n goals; world frame, SI.

    Attributes:
        position, quaternion: (n, b, 3) centers of mass, m, and (n, b, 4) w-x-y-z of all bodies.
        coordinates: (n,) m or rad from the initial pose, for each chosen or measured joint coordinate, by
            name of the joint, or by (name, number) if given in this form.
        direction: (n, 3) direction of the axis; None without an axis.
        reached: (n,) True if the goals are met on the assembly branch of the start.
        beyond: (n,) True for poses that the start reaches only through a singular configuration, or by a
            jump. In such a configuration the goals, or all chosen and measured coordinates, do not determine
            the motion. If loops lose rank there instead, as in a four-bar that lies flat, `reached` may be
            True as well: the mechanism may have taken another branch.
        missing: (n,) value minus goal of each chosen joint coordinate, m or rad.
        angle: (n,) angle between the axis and its goal, rad; zeros without a goal.
        slope: (n,) decrease of the dimensionless distance to the goals per dimensionless motion. 0 at a local
            minimum of the distance, for example for goals that are out of reach.
        closed: (n,) True if all loops are closed.

    Examples:
        >>> poses: Poses = solve_poses(load("slider_crank"), {"guide": [0.0, 1.0]}, measure=["pivot"])
        >>> print(poses.reached)
        [ True False]
        >>> print(*poses.report())
        pose 1: out of reach, nearest pose, misses 'guide' by -0.90984 m
    """

    position: Array
    quaternion: Array
    coordinates: Mapping[str | Key, Array]
    direction: Array | None
    reached: Array
    beyond: Array
    missing: Mapping[str | Key, Array]
    angle: Array
    slope: Array
    closed: Array
    _names: tuple[str | Key, ...]
    _configs: Configurations

    def __len__(self) -> int:
        return len(self.position)

    def __repr__(self) -> str:
        return f"<Poses: {len(self)}, reached: {np.sum(self.reached)}>"

    def report(self) -> list[str]:
        """Return a line for each pose that misses its goals, or lies beyond a singular configuration."""
        lines, mechanism = [], self._configs.chain.scene.mechanism
        keys = {name: mechanism.coordinate(name) for name in self.missing}
        units = {name: "m" if mechanism.is_slide(*key) else "rad" for name, key in keys.items()}
        for k in np.flatnonzero(~self.reached | self.beyond):
            errors = [f"{name!r} by {values[k]:.6g} {units[name]}" for name, values in self.missing.items()]
            errors += [f"axis by {self.angle[k]:.6g} rad"] if self.angle.any() else []
            is_nearest = self.slope[k] < STATIONARY_SLOPE
            pose_text = "nearest pose" if is_nearest else "nearest pose not found, the last one"
            where = ", beyond a singular configuration" if self.beyond[k] else ""
            if self.beyond[k] and self._distance(int(k)) < MET:
                lines.append(f"pose {k}: meets its goals, but only beyond a singular configuration")
                continue
            lines.append(f"pose {k}: out of reach, {pose_text}{where}, misses {', '.join(errors)}")
        return lines

    def _distance(self, k: int) -> float:
        """Return the largest dimensionless error of the goals of a pose."""
        units = self._configs.chain.units
        errors = [abs(values[k]) / unit for values, unit in zip(self.missing.values(), units, strict=False)]
        return float(max([*errors, self.angle[k]]))

    @checked
    def state(self, number: int) -> State:
        """Return the state of a pose at rest, from which a scene may start.

        Raises:
            OptionError: for a number that is no index of a pose.
        """
        if not -len(self) <= number < len(self):
            raise OptionError("number", number, f"an index of {len(self)} poses")
        rest = np.zeros_like(self.position[number])
        angles = {key: float(values[number]) for key, values in self.angles.items()}
        return State(self.position[number], self.quaternion[number], rest, rest, angles=angles)

    @cached_property
    def angles(self) -> Mapping[Key, Array]:
        """Angles (n,) with their revolutions, rad, by joint coordinate; see `State.angles`.

        Chosen angles have the revolutions of their goals. Couplings and prescribed motions determine the
        revolutions of others.
        """
        chain = self._configs.chain
        system, names = chain.system, dict(zip(chain.keys, self._names, strict=True))
        return {
            key: np.asarray(self.coordinates[names[key]]) if key in names else self._configs.q[:, place]
            for key, place in system.angles.items()
        }

    @property
    def tree_coordinates(self) -> Array:
        """Coordinates (n, nq) of the spanning tree of the mechanism."""
        return self._configs.q[:, : self._configs.chain.system.tree.nq]

    @checked
    def positions(self, of: Point) -> Array:
        """Compute world positions (n, 3), m, of a point of a body.

        Raises:
            UnknownNameError: for an unknown body.
            MechanismError: for a point of the ground.
        """
        return positions(self._configs, of)

    @checked
    def jacobian(self, of: Sequence[str | Key | Axis], by: Sequence[str | Key | Axis]) -> Array:
        """Compute the Jacobian (n, rows, columns) of quantities with respect to others, with closed loops.

        A joint coordinate has one row or column, m or rad. An axis has three: the components of its unit
        vector. If `by` do not determine the motion, the motion of least length is taken.

        Raises:
            OptionError: for a quantity that was neither chosen nor measured.
        """
        rows, row_units = self._reduced(of)
        columns, column_units = self._reduced(by)
        inverse = np.linalg.pinv(columns, RANK_TOLERANCE)
        return np.asarray(rows @ inverse * row_units[:, None] / column_units)

    @checked
    def independence(self, of: Sequence[str | Key | Axis]) -> Array:
        """Compute the smallest singular value (n,) of the Jacobian of quantities, dimensionless.

        The Jacobian is taken in the tangent space of the closed loops. The value is the smallest rate of the
        quantities per unit motion of the mechanism. At 0, a singular configuration, the mechanism may move
        while the quantities stand still.
        """
        rows, _ = self._reduced(of)
        axis_count = sum(isinstance(each, Axis) for each in of)
        independent = rows.shape[1] - axis_count  # two of the three rows of an axis are independent
        values = np.linalg.svd(rows, compute_uv=False)
        return np.asarray(values[:, min(independent, rows.shape[2]) - 1])

    def _reduced(self, quantities: Sequence[str | Key | Axis]) -> tuple[Array, Array]:
        """Compute the dimensionless Jacobian (n, r, f) in the tangent space, and units (r,) of its rows."""
        if not len(quantities):
            raise OptionError("quantities", quantities, "one or more")
        chain, rows, units = self._configs.chain, [], []
        for each in quantities:
            if isinstance(each, Axis) and chain.axis is each:  # d axis/dt = omega x axis
                direction = self._configs.direction[:, :, None]
                rows.append(np.cross(self._configs.axis_jacobian, direction, axis=1))
                units += [1.0, 1.0, 1.0]
            elif not isinstance(each, Axis) and each in self._names:
                k = self._names.index(each)
                rows.append(self._configs.coordinate_jacobian[:, [k]])
                units.append(chain.units[k])
            else:
                known = listed(map(repr, self._names))
                raise OptionError("quantity", each, f"one of {known}, or the axis, as given")
        # `tangent` (n, f, nv): orthonormal velocities that keep the loops closed
        return np.concatenate(rows, axis=1) @ np.swapaxes(self._configs.tangent, 1, 2), np.array(units)


@checked
def solve_poses(
    scene: Scene,
    coordinates: Mapping[str | Key, Any] | None = None,
    axis: Axis | None = None,
    towards: Any = None,
    measure: Sequence[str | Key] | None = None,
    start: State | None = None,
    nearest: bool = True,
) -> Poses:
    """Solve forward or inverse kinematics for many goals at once, by compiled equations.

    Goals are joint coordinates, the direction of an axis of a body, or both, but not the position of a point
    (`Poses.positions` computes positions). If goals do not determine the
    pose, the mechanism moves the least from the nearest solved pose. If goals cannot be met, the nearest pose
    is found: its distance is the root of the sum of squares of angles, rad, and lengths, sizes of the
    mechanism. Poses are on the assembly branch of the start. Prescribed motions of other joints hold their
    values at time 0.

    Args:
        scene: gives the mechanism and the start.
        coordinates: values (n,), or one for all, m or rad from the initial pose, by name of the joint, or by
            (name, number) for joints of several coordinates.
        axis: axis of a body.
        towards: (n, 3) or (3,), world frame, direction that the axis points in; None to measure it only.
        measure: other joint coordinates to return. If None and without `coordinates`, the coordinates of
            control laws.
        start: pose to begin at, on the wanted assembly branch; the scene's initial state if None.
        nearest: False to save the search for the nearest pose if a goal is not reached; the pose is then the
            last one that was solved on the way to the goal.

    Raises:
        UnknownNameError: for an unknown joint or body.
        MechanismError: for values that are not finite, and for a joint without such a coordinate.
        OptionError: for different numbers of values, and without any goal.

    Examples:
        >>> up = solve_poses(load("tracker"), axis=Axis("panel_7", [0, 0, 1]), towards=[0, 0, 1])
        >>> print(up.reached, up.coordinates["slide_12"].round(6))
        [ True] [0.0214]
    """
    if measure is None:
        keys = () if coordinates else dict.fromkeys(law.key for law in scene.control)
        measure = [scene.mechanism.coordinate_name(key) for key in keys]
    chain, names, goal = goals_of(scene, coordinates, axis, towards, measure, start)
    # continuation from the start
    begin = chain.at(chain.start[None])
    configs, reached, beyond = follow(begin, goal)
    # goals that are not reached: the nearest pose, searched from the last one or from random poses of the
    # branch
    missed = np.flatnonzero(~reached)
    if missed.size and nearest:
        # signs (n, 2) are -1 if a singular configuration was passed: of the Jacobian of the goals, and of all
        # chosen and measured coordinates
        near, signs = approach(configs[missed], sample_branch(begin), goal[missed])
        met = largest(near.phi, near.goal_errors(goal[missed])[0]) < MAX_RESIDUAL
        # a goal at the limit of reach is met without a change of sign
        reached[missed] = met & np.all(signs > 0.0, axis=1)
        beyond[missed] = (signs[:, 1] < 0.0) | (met & (signs[:, 0] < 0.0))
        values = configs.values.copy()
        values[missed] = near.values
        configs = Configurations(chain, values)
    return poses_of(configs, goal, names, reached, beyond)


def poses_of(
    configs: Configurations, goal: Goal, names: tuple[str | Key, ...], reached: Array, beyond: Array
) -> Poses:
    """Return solved configurations as poses.

    Args:
        configs: the configurations.
        goal: one goal for each configuration.
        names: names of the chosen and measured joint coordinates.
        reached, beyond: see the attributes of `Poses`.
    """
    chain = configs.chain
    missing, turn = chain.difference(chain.goal_at(configs), goal)
    coordinates = configs.coordinates.copy()
    coordinates[:, chain.is_periodic] = within_revolution(coordinates[:, chain.is_periodic])
    coordinates[:, : chain.goal_count] = goal.coordinates + missing
    distance = np.sqrt(2.0 * half_square(configs, goal))
    slope = np.linalg.norm(products(configs.tangent, gradient(configs, goal)), axis=1) / np.maximum(
        distance, MAX_RESIDUAL
    )
    return Poses(
        position=configs.position,
        quaternion=configs.quaternion,
        coordinates=dict(zip(names, coordinates.T, strict=True)),
        direction=None if chain.axis is None else configs.direction,
        reached=reached,
        beyond=beyond,
        missing=dict(zip(names, missing.T, strict=False)),
        angle=np.linalg.norm(turn, axis=1),
        slope=np.where(distance < MAX_RESIDUAL, 0.0, slope),
        closed=largest(configs.phi) < MAX_RESIDUAL,
        _names=names,
        _configs=configs,
    )


def goals_of(
    scene: Scene,
    coordinates: Mapping[str | Key, Any] | None,
    axis: Axis | None,
    towards: Any,
    measure: Sequence[str | Key],
    start: State | None,
) -> tuple[Chain, tuple[str | Key, ...], Goal]:
    """Check the goals of `solve_poses`, whose arguments these are.

    Returns:
        The mechanism with chosen joint coordinates (`Chain`); the names of its coordinates, those with goals
        first; the goals.
    """
    wanted = {name: coordinate_values(scene, name, given) for name, given in (coordinates or {}).items()}
    names = (*wanted, *(name for name in measure if name not in wanted))
    goal = _goal(wanted, axis, towards)
    chain = chain_of(scene, names, len(wanted), axis, towards is not None, start)
    for name, values, unit in zip(wanted, goal.coordinates.T, chain.units, strict=False):
        farthest = float(np.max(np.abs(values)))
        if farthest > MAX_GOAL * unit:
            what = f"joint {chain.keys[names.index(name)][0]!r}"
            needed = f"{MAX_GOAL * unit:.3g} at most, {MAX_GOAL:g} rad or sizes of the mechanism"
            raise MechanismError(what, f"coordinate is {farthest:g}", needed)
    return chain, names, goal


def chain_of(
    scene: Scene,
    names: Sequence[str | Key],
    goal_count: int,
    axis: Axis | None,
    has_axis_goal: bool,
    start: State | None,
) -> Chain:
    """Make the `Chain` of a scene: its mechanism with chosen joint coordinates and an axis.

    Args:
        scene: gives the mechanism and the start.
        names: joint coordinates.
        goal_count: number of the coordinates that have goals; they come first.
        axis: axis of a body, or None.
        has_axis_goal: True if the axis has a goal.
        start: state at which the motion begins; the scene's initial state if None.
    """
    keys = [scene.mechanism.coordinate(name) for name in names]
    if len(set(keys)) < len(keys):
        raise OptionError("coordinates", names, "each joint coordinate once")
    return Chain(scene, keys, goal_count, axis, has_axis_goal, _start(scene, start))


def needed_goals(chain: Chain) -> str:
    """Describe the number of coordinates that determine a pose, and the motions that hold others."""
    text = f"as many as degrees of freedom, {chain.freedoms}"
    held = [repr(motion.joint) for motion in chain.scene.motions if motion.key not in chain.keys]
    if not held:
        return text
    return f"{text} while motions hold {', '.join(held)}; give these coordinates, or delete their motions"


def coordinate_values(scene: Scene, name: str | Key, given: object) -> Array:
    """Return values (n,) or () of a joint coordinate as finite floats; raises `MechanismError`."""
    where = f"joint {scene.mechanism.coordinate(name)[0]!r}"
    count = given.shape[:1] if isinstance(given, np.ndarray) else ()
    if isinstance(given, list | tuple):
        count = (len(given),)
    return finite_array(where, "coordinate", given, count)


def _goal(wanted: Mapping[str | Key, Array], axis: Axis | None, towards: object) -> Goal:
    """Return goals for n configurations.

    Args:
        wanted: values (n,), (1,) or () of joint coordinates, m or rad, by name.
        axis: axis of a body that has a goal, or None.
        towards: directions (n, 3) or (3,) of the axis; None for no goal.

    Raises:
        OptionError: for different numbers of values, and without any goal.
    """
    if towards is not None and axis is None:
        raise OptionError("towards", towards, "an axis of a body that is to point there")
    if not wanted and towards is None:
        raise OptionError("coordinates", dict(wanted), "values of one joint or more, or where an axis points")
    rows = np.zeros((1, 0)) if towards is None else np.atleast_2d(unit_vectors("goal", "towards", towards))
    columns = [np.atleast_1d(values) for values in wanted.values()]
    lengths = {str(name): len(column) for name, column in zip(wanted, columns, strict=True)}
    lengths |= {} if towards is None else {"towards": len(rows)}
    count = max(lengths.values())
    if rows.ndim != 2 or not set(lengths.values()) <= {1, count} or 0 in lengths.values():
        raise OptionError("numbers of values", lengths, "one number for all, or single values")
    x = [np.broadcast_to(column, count) for column in columns]
    coordinates = np.stack(x, axis=1) if x else np.zeros((count, 0))
    return Goal(coordinates, np.broadcast_to(rows, (count, rows.shape[1])))


def _start(scene: Scene, start: State | None) -> State:
    """Return the checked state to begin at: the scene's initial state if `start` is None."""
    if start is None:
        return initial_state(scene)
    return initial_state(replace(scene, initial_state=start))
