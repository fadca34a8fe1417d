"""Start of a log as a state of the scene: the consistent state next to the first row.

A log has columns of measured joint coordinates, poses and rates over time. Coordinates have keys (joint,
number).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from crosscheck.logs.columns import LogData, Measured
from crosscheck.logs.fitted_velocities import RANK_TOLERANCE, fitted_velocities, free_motions
from crosscheck.logs.names import COMPONENTS_OF, Elements, Origin
from crosscheck.logs.poses import Poses, body_poses, logged_quantities
from crosscheck.logs.rates import RATE_ROWS, Rates, rates_at_start, velocities
from newton_euler.equations.couplings import counted_angles
from newton_euler.equations.relative import Relative
from newton_euler.equations.sparse import to_array
from newton_euler.errors import MechanismError, NewtonEulerError, listed, quoted
from newton_euler.model.euler_parameters import angle_between
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.model.source_file import SourceError
from newton_euler.model.state import State
from newton_euler.runs.assemble import assemble, initial_state
from newton_euler.runs.variation import start
from newton_euler.scalars import Array


@dataclass(frozen=True, eq=False)
class LogStart:
    """Start of a log as a state of the scene.

    Attributes:
        state: consistent state next to the first row.
        moved: largest distance between a logged center of mass and that of the state, m.
        turned: largest angle between a logged orientation and that of the state, rad.
        moved_at: name of the body with the larger one of both, relative to the mechanism's size and 1 rad.
        differences: columns whose rates the log does not have.
        is_fitted: True if the velocities are fitted to the first rows because of these columns, False if they
            are those of the log or of the scene's own start.
    """

    state: State
    moved: float
    turned: float
    moved_at: str
    differences: tuple[str, ...]
    is_fitted: bool


def log_start(
    scene: Scene, elements: Elements, data: LogData, default: Origin, rows: int = RATE_ROWS
) -> LogStart:
    """Find the consistent state of a scene that is next to the first row of a log.

    Args:
        scene: the scene.
        elements: joint coordinates and frames of the scene that columns of the log can belong to.
        data: the log.
        default: point of positions whose columns do not state a point.
        rows: number of first rows for rates that the log does not have.

    Raises:
        SourceError: if the log does not determine the start, naming what is missing, or if the loops cannot
            close next to the first row.
    """
    first_row = logged_quantities(data, count=1)
    rates, differences = rates_at_start(data, rows)
    known = {
        body: pose for body, pose in body_poses(elements, first_row, default).items() if pose.is_complete
    }
    moving = velocities(elements, first_row, rates, default)
    guess = initial_state(scene)
    if len(known) < len(scene.mechanism.bodies):
        guess = _completed(scene, elements, data, rates, known)
    arrays = [array.copy() for array in guess.arrays]
    for body in known.keys() - {0}:
        for array, values in zip(arrays, (*known[body], *moving[body]), strict=True):
            array[body] = values[0]  # type: ignore[index]
    # full revolutions of angles on which forces or couplings depend
    angles = {key: float(x[0]) for key, x in first_row.coordinates.items() if key in counted_angles(scene)}
    try:
        state = assemble(scene, State(*arrays, angles={**guess.angles, **angles}))
        angles = {key: angle for key, angle in state.angles.items() if key in counted_angles(scene)}
        state = replace(state, angles=angles)
    except NewtonEulerError as error:
        raise SourceError(data.where, f"the first row fits no state of the model: {error}") from error
    if differences:
        state = _fitted(scene, state, elements, data, default, rows)
    # distance from the logged poses
    size, worst, moved, turned = scene.mechanism.size, (0.0, ""), 0.0, 0.0
    for body in known.keys() - {0}:
        gap = float(np.linalg.norm(state.position[body] - arrays[0][body]))
        angle = float(angle_between(state.quaternion[body], arrays[1][body]))
        moved, turned = max(moved, gap), max(turned, angle)
        worst = max(worst, (gap / size + angle, scene.mechanism.body_names[body]))
    return LogStart(state, moved, turned, worst[1], tuple(differences), is_fitted=bool(differences))


def with_own_velocities(scene: Scene, found: LogStart) -> LogStart:
    """Return the start of a log with the velocities of the scene's own start, such as rest."""
    own = initial_state(scene)
    moving = replace(found.state, linear_velocity=own.linear_velocity, angular_velocity=own.angular_velocity)
    return replace(found, state=assemble(scene, moving), is_fitted=False)


def _fitted(
    scene: Scene, state: State, elements: Elements, data: LogData, default: Origin, rows: int
) -> State:
    """Fit the velocities of a start state to the first rows of a log."""
    count = min(rows, len(data.time))
    first_rows = logged_quantities(data, count)
    poses = {
        body: pose
        for body, pose in body_poses(elements, first_rows, default).items()
        if body and pose.is_complete
    }
    if not poses:
        return state
    position = np.stack([np.asarray(pose.position) for pose in poses.values()], axis=1)
    quaternion = np.stack([np.asarray(pose.quaternion) for pose in poses.values()], axis=1)
    times = data.time[:count] - data.time[0]
    return fitted_velocities(scene, state, times, position, quaternion, list(poses))


def _completed(scene: Scene, elements: Elements, data: LogData, rates: Rates, known: Poses) -> State:
    """Find a state with the logged coordinates for a scene of which not all bodies are known.

    Raises:
        SourceError: if the log does not determine all bodies, naming a joint or body that is missing.
    """
    mechanism, where = scene.mechanism, data.where
    system = Relative(scene)
    q, _ = system.coordinates(initial_state(scene))
    free = free_motions(system, q)  # velocities (nv, f) that the constraints leave free, as columns
    links = system.links(q, np.zeros(system.nv))

    def effect(keys: Sequence[Key]) -> Array:
        """Return the rates (k, f) of k joint coordinates in the free motions."""
        # Jacobian of each coordinate by the motion of the joint's two bodies, then by v
        rows: list[dict[int, Any]] = []
        for joint, number in keys:
            equations = system.tree.equations(mechanism.joint_index(joint))
            first, second = links[equations.first], links[equations.second]
            blocks = equations.coordinates[number].jacobian(first.frame, second.frame)
            rows.extend(system.project(blocks, first, second))
        return to_array(rows, system.nv) @ free

    # Jacobian (6, nv) of the velocity and angular velocity of each body
    bodies = system.velocity_transformation(q).reshape(-1, 6, system.nv)
    # what the log determines: known bodies, then coordinates
    chosen = np.concatenate([bodies[body] for body in known]) @ free
    count = np.linalg.matrix_rank(chosen, RANK_TOLERANCE)
    for key in [*data.coordinates, *mechanism.coordinate_labels]:
        if count == free.shape[1]:
            break
        more = np.concatenate([chosen, effect([key])])
        if np.linalg.matrix_rank(more, RANK_TOLERANCE) > count:
            if key not in data.coordinates:
                joint = mechanism.joint(key[0])
                _check_parts(elements, data, {joint.first, joint.second})
                label = elements.labels[key]
                problem = f"column coordinate.{label} is missing: no column determines joint {quoted(label)}"
                problem += _unread(data)
                needed = (
                    f"that column, --log-map COLUMN=coordinate.{label}, or poses of the bodies that it moves"
                )
                raise SourceError(where, f"{problem}; needed: {needed}")
            chosen, count = more, count + 1
    if count < free.shape[1]:
        unknown = [name for k, name in enumerate(mechanism.body_names) if k not in known]
        _check_parts(elements, data, set(unknown))
        problem = f"no columns determine the poses of {listed(map(quoted, unknown)):.200}{_unread(data)}"
        raise SourceError(where, f"{problem}; needed: position.BODY.x to z and quaternion.BODY.w to z")
    # start at the independent ones of the logged coordinates, and at their rates
    logged = list(data.coordinates)
    keys = _independent(effect(logged), logged) if logged else []
    if not keys:
        return initial_state(scene)
    given: dict[str, Any] = {}
    for name in dict.fromkeys(joint for joint, _ in keys):
        pairs = [
            (float(data.coordinates[key].values[0]), float(rates.coordinates[key][0]))
            if key in keys
            else None
            for key in ((name, k) for k in range(len(mechanism.joint(name).coordinate_kinds)))
        ]
        given[name] = pairs if len(pairs) > 1 else pairs[0]
    try:
        return initial_state(start(scene, **given))
    except MechanismError as error:
        columns = [data.coordinates[key].columns[0] for key in keys]
        problem = f"the first row of {', '.join(map(quoted, columns)):.200} fits no state of the model"
        raise SourceError(where, f"{problem}: {error}") from error


def _check_parts(elements: Elements, data: LogData, bodies: set[str]) -> None:
    """Raise `SourceError` if a log has only the position or only the orientation of one of some bodies."""
    for name, frame in data.frames.items():
        if elements.frames[name].body not in bodies:
            continue
        for missing, beside in (("quaternion", "position"), ("position", "quaternion")):
            logged: Measured | None = getattr(frame, beside)
            if getattr(frame, missing) is None and logged is not None:
                components = COMPONENTS_OF[missing]
                quantity = f"{missing}.{name}"
                problem = f"columns {quantity}.{components[0]} to {components[-1]} are missing"
                needed = f"these columns, or --log-map COLUMN={quantity}.{components[0]}"
                beside = f"beside {quoted(logged.columns[0])}"
                raise SourceError(data.where, f"{problem} {beside}{_unread(data)}; needed: {needed}")


def _unread(data: LogData) -> str:
    """Name the columns of a log that have no quantity of the model, for a message; "" if there are none."""
    names = [*map(quoted, data.unused[:2]), *([f"{len(data.unused) - 2} more"] if data.unused[2:] else [])]
    return f"; not read, as the model has no joint or body of that name: {', '.join(names)}" if names else ""


def _independent(effects: Array, keys: Sequence[Key]) -> list[Key]:
    """Choose coordinates whose effects (k, free motions) are independent, the earlier ones first."""
    found: list[int] = []
    for k in range(len(keys)):
        if np.linalg.matrix_rank(effects[[*found, k]], RANK_TOLERANCE) > len(found):
            found.append(k)
    return [keys[k] for k in found]
