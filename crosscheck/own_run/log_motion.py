"""Motion of a mechanism's bodies in the log of another simulator, and the start of the log as a state.

Logged poses of body frames give poses of the scene's bodies. From these, and from the ground, poses of other
bodies follow along the joints whose coordinates are logged. Bodies that the log does not determine stay
unknown and are not compared.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from crosscheck.own_run.log_columns import Elements, LogData, Measured, Origin
from crosscheck.own_run.log_velocities import RANK_TOLERANCE, fitted_velocities, free_motions
from newton_euler.equations.applied_forces import energies, surroundings
from newton_euler.equations.couplings import counted_angles
from newton_euler.equations.relative import Relative
from newton_euler.equations.sparse import to_array
from newton_euler.errors import MechanismError, NewtonEulerError, listed, quoted
from newton_euler.model.euler_parameters import (
    angle_between,
    conjugate,
    from_rotation_vector,
    product,
    rotations,
)
from newton_euler.model.joint import Joint, Key
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import Scene
from newton_euler.model.source_file import SourceError
from newton_euler.model.state import State, stacked_frames
from newton_euler.runs.assemble import assemble, initial_state
from newton_euler.runs.variation import start
from newton_euler.scalars import Array, unstacked

RATE_ROWS = 5
"""Number of first rows whose polynomial gives the rates at the start, if the log has no rates."""

MAX_RATE_STEP = 1e-5
"""Largest change of a coordinate, rad or m, by which rates of coordinates are converted to velocities."""


class BodyPose(NamedTuple):
    """Poses of a body at n times: center of mass (n, 3), m, and orientation (n, 4); None if unknown."""

    position: Array | None
    quaternion: Array | None

    @property
    def is_complete(self) -> bool:
        """True if position and orientation are known."""
        return self.position is not None and self.quaternion is not None

    @property
    def is_known(self) -> bool:
        """True if position or orientation is known."""
        return self.position is not None or self.quaternion is not None


Poses = dict[int, BodyPose]
"""Known poses by the index of the body; the ground is always known."""


class Sample(NamedTuple):
    """Logged quantities at n times, SI units.

    Attributes:
        rows: number n of times.
        coordinates: joint coordinates (n,) of the scene.
        frames: positions (n, 3) and quaternions (n, 4) of body frames.
        points: points of the bodies that the names of columns state, by name of the frame.
    """

    rows: int
    coordinates: Mapping[Key, Array]
    frames: Mapping[str, BodyPose]
    points: Mapping[str, Origin]


def all_rows(data: LogData) -> Sample:
    """Return the logged quantities at all times."""
    frames = {
        name: BodyPose(
            None if frame.position is None else frame.position.values,
            None if frame.quaternion is None else frame.quaternion.values,
        )
        for name, frame in data.frames.items()
    }
    coordinates = {key: measured.values for key, measured in data.coordinates.items()}
    points = {name: frame.point for name, frame in data.frames.items()}
    return Sample(len(data.time), coordinates, frames, points)


def body_poses(elements: Elements, sample: Sample, default: Origin) -> Poses:
    """Compute the poses of all bodies that logged quantities determine.

    Args:
        elements: names of the scene and of the model file.
        sample: logged quantities.
        default: point of positions whose columns do not state a point.
    """
    mechanism, count = elements.mechanism, sample.rows
    ground = mechanism.bodies[0]
    poses: Poses = {
        0: BodyPose(
            np.broadcast_to(ground.center_of_mass, (count, 3)), np.broadcast_to(ground.quaternion, (count, 4))
        )
    }
    # logged poses of frames
    for name, logged in sample.frames.items():
        frame = elements.frames[name]
        body = mechanism.body_index(frame.body)
        quaternion = position = None
        if logged.quaternion is not None:
            quaternion = _times(logged.quaternion, conjugate(frame.quaternion))
        at_center = (sample.points[name] or default) == "center" and frame.body == name
        if logged.position is not None and (at_center or not np.any(frame.point)):
            position = logged.position
        elif logged.position is not None and quaternion is not None:
            position = logged.position - _rotated(quaternion, frame.point)
        known = poses.get(body, BodyPose(None, None))
        poses[body] = BodyPose(
            position if known.position is None else known.position,
            quaternion if known.quaternion is None else known.quaternion,
        )
    # along joints with logged coordinates, until no further body becomes known
    waiting = list(mechanism.joints)
    while waiting:
        others = [joint for joint in waiting if not _pass_on(mechanism, joint, sample, poses)]
        if len(others) == len(waiting):
            break
        waiting = others
    return {body: pose for body, pose in poses.items() if pose.is_known}


def _pass_on(mechanism: Mechanism, joint: Joint, sample: Sample, poses: Poses) -> bool:
    """Compute the pose of one end of a joint from the other end; False if that is not possible (yet)."""
    first, second = mechanism.body_index(joint.first), mechanism.body_index(joint.second)
    ends = [poses.get(end, BodyPose(None, None)) for end in (first, second)]
    keys = [(joint.name, k) for k in range(len(joint.coordinate_kinds))]
    kinds = {motion.kind for motion in joint.motions}
    if ends[0].is_complete == ends[1].is_complete or len(keys) != len(joint.motions) or "ball" in kinds:
        return ends[0].is_complete and ends[1].is_complete
    if len(keys) + _constraint_count(mechanism, joint) != 6 or not set(keys) <= sample.coordinates.keys():
        return False
    way, turn = _relative_pose(mechanism, joint, [sample.coordinates[key] for key in keys], sample.rows)
    initial = [mechanism.bodies[end].quaternion for end in (first, second)]
    # rotations since the initial pose: that of the second body is that of the first, times `turn`
    if ends[0].is_complete:
        rotation = _times(ends[0].quaternion, conjugate(initial[0]))
        found, known, position = second, poses.get(second), ends[0].position + _rotated(rotation, way)
        quaternion = _times(_times(rotation, turn), initial[1])
    else:
        rotation = _times(_times(ends[1].quaternion, conjugate(initial[1])), conjugate(turn))
        found, known, position = first, poses.get(first), ends[1].position - _rotated(rotation, way)
        quaternion = _times(rotation, initial[0])
    if known is not None:  # logged numbers count before computed ones
        position = position if known.position is None else known.position
        quaternion = quaternion if known.quaternion is None else known.quaternion
    poses[found] = BodyPose(position, quaternion)
    return True


def _constraint_count(mechanism: Mechanism, joint: Joint) -> int:
    """Return the number of constraint equations of a joint."""
    equations = mechanism.joint_equations(joint.name)
    return sum(constraint.count for constraint in equations.constraints)


def _relative_pose(
    mechanism: Mechanism, joint: Joint, coordinates: Sequence[Array], count: int
) -> tuple[Array, Array]:
    """Compute the pose of a joint's second body relative to the first body.

    Args:
        mechanism: bodies, at their initial poses.
        joint: joint of hinges and slides.
        coordinates: (n,) each, m or rad from the initial pose.
        count: number n of times.

    Returns:
        The vector (n, 3) from the first to the second center of mass, m, and the rotation (n, 4) of the
        second body since the initial pose. In both, the first body has its initial orientation.
    """
    centers = [mechanism.body(name).center_of_mass for name in (joint.first, joint.second)]
    here = joint.motion_points[0] if joint.motions else joint.reaction_point
    way = np.tile(here - joint.point_gap - centers[0], (count, 1))
    turn = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    for motion, point, x in zip(joint.motions, joint.motion_points, coordinates, strict=True):
        way, here = way + _rotated(turn, point - here), point
        if motion.kind == "slide":
            way = way + _rotated(turn, motion.axis) * x[:, None]
        else:
            half = 0.5 * x[:, None]
            turn = _times(turn, np.concatenate([np.cos(half), np.sin(half) * motion.axis], axis=1))
    return way + _rotated(turn, centers[1] - here), turn


def _times(p: Any, q: Any) -> Array:
    """Return quaternion products (n, 4); one of the factors may be (4,)."""
    p, q = np.broadcast_arrays(p, q)
    return np.moveaxis(product(np.moveaxis(p, -1, 0), np.moveaxis(q, -1, 0)), 0, -1)


def _rotated(quaternions: Any, vectors: Any) -> Array:
    """Rotate vectors (3,) or (n, 3) by quaternions (n, 4)."""
    vectors = np.broadcast_to(vectors, (len(quaternions), 3))
    return np.einsum("nij,nj->ni", rotations(np.asarray(quaternions)), vectors)


def derivative_at_start(time: Array, values: Array, rows: int) -> Array:
    """Differentiate values (n, ...) at the first of n times by the polynomial through the first rows."""
    rows = min(rows, len(time))
    scale = time[rows - 1] - time[0]
    powers = np.vander((time[:rows] - time[0]) / scale, rows, increasing=True)
    # weights w of the rows: p'(0) = w . values
    weights = np.linalg.solve(powers.T, np.eye(rows)[1]) / scale
    return np.tensordot(weights, values[:rows], axes=1)


class Rates(NamedTuple):
    """Rates of logged quantities at one time or at n times: of coordinates, and of frames."""

    coordinates: Mapping[Key, Array]
    linear: Mapping[str, Array]
    angular: Mapping[str, Array]


def rates_at_start(data: LogData, rows: int = RATE_ROWS) -> tuple[Rates, list[str]]:
    """Return rates (1,), (1, 3) at the first row, and the columns whose rates are differences of rows.

    Args:
        data: the log.
        rows: number of rows for differences.
    """
    differences: list[str] = []

    def rate(given: Measured | None, measured: Measured) -> Array:
        """Return the logged rate of the first row, or else the difference of the first rows."""
        if given is not None:
            return given.values[:1]
        differences.extend(measured.columns)
        return derivative_at_start(data.time, measured.values, rows)[None]

    coordinates = {key: rate(data.rates.get(key), x) for key, x in data.coordinates.items()}
    linear, angular = dict[str, Array](), dict[str, Array]()
    for name, frame in data.frames.items():
        if frame.position is not None:
            linear[name] = rate(frame.linear_velocity, frame.position)
        if frame.quaternion is not None and frame.angular_velocity is not None:
            angular[name] = frame.angular_velocity.values[:1]
        elif frame.quaternion is not None:
            slope = rate(None, frame.quaternion)
            angular[name] = 2.0 * _times(slope, conjugate(frame.quaternion.values[:1]))[:, 1:]
    return Rates(coordinates, linear, angular), differences


def logged_rates(data: LogData) -> Rates | None:
    """Return the rates at all times; None if the log does not have all of them."""
    if not data.coordinates.keys() <= data.rates.keys():
        return None
    linear, angular = dict[str, Array](), dict[str, Array]()
    for name, frame in data.frames.items():
        if frame.position is not None:
            if frame.linear_velocity is None:
                return None
            linear[name] = frame.linear_velocity.values
        if frame.quaternion is not None:
            if frame.angular_velocity is None:
                return None
            angular[name] = frame.angular_velocity.values
    return Rates({key: data.rates[key].values for key in data.coordinates}, linear, angular)


def velocities(
    elements: Elements, sample: Sample, rates: Rates, default: Origin
) -> dict[int, tuple[Array, Array]]:
    """Compute linear and angular velocities (n, 3) of all bodies with known poses.

    The poses are computed a short time before and after each time, and subtracted.
    """
    numbers = [*rates.coordinates.values(), *rates.linear.values(), *rates.angular.values()]
    step = MAX_RATE_STEP / max(1e-3, *(float(np.max(np.abs(each))) for each in numbers))
    before, after = (
        body_poses(elements, _advanced(sample, rates, sign * step), default) for sign in (-1.0, 1.0)
    )
    found: dict[int, tuple[Array, Array]] = {}
    for body, pose in after.items():
        if pose.is_complete:
            linear = (pose.position - before[body].position) / (2.0 * step)  # type: ignore[operator]
            turn = _times(pose.quaternion, conjugate(before[body].quaternion))  # type: ignore[arg-type]
            turn = turn * np.where(turn[:, :1] < 0.0, -1.0, 1.0)
            found[body] = linear, turn[:, 1:] / step  # twice the vector part, in twice the step
    return found


def _advanced(sample: Sample, rates: Rates, step: float) -> Sample:
    """Return the quantities after a short time, s, which may be negative."""
    coordinates = {key: x + step * rates.coordinates[key] for key, x in sample.coordinates.items()}
    frames = {}
    for name, (position, quaternion) in sample.frames.items():
        if position is not None:
            position = position + step * rates.linear[name]
        if quaternion is not None:
            turns = np.array([from_rotation_vector(step * omega) for omega in rates.angular[name]])
            quaternion = _times(turns, quaternion)
        frames[name] = BodyPose(position, quaternion)
    return sample._replace(coordinates=coordinates, frames=frames)


def first_rows(sample: Sample, count: int = 1) -> Sample:
    """Return the quantities of the first rows."""
    frames = {
        name: BodyPose(*(None if each is None else each[:count] for each in pose))
        for name, pose in sample.frames.items()
    }
    coordinates = {key: x[:count] for key, x in sample.coordinates.items()}
    return Sample(count, coordinates, frames, sample.points)


@dataclass(frozen=True, eq=False)
class LogStart:
    """Start of a log as a state of the scene.

    Attributes:
        state: consistent state next to the first row.
        moved: largest distance between a logged center of mass and that of the state, m.
        turned: largest angle between a logged orientation and that of the state, rad.
        moved_at: name of the body with the larger one of both, relative to the mechanism's size and 1 rad.
        differences: columns whose rates are differences of the first rows.
    """

    state: State
    moved: float
    turned: float
    moved_at: str
    differences: tuple[str, ...]


def log_start(
    scene: Scene, elements: Elements, data: LogData, default: Origin, rows: int = RATE_ROWS
) -> LogStart:
    """Find the consistent state of a scene that is next to the first row of a log.

    Args:
        scene: the scene.
        elements: names of the scene and of the model file.
        data: the log.
        default: point of positions whose columns do not state a point.
        rows: number of first rows for rates that the log does not have.

    Raises:
        SourceError: if the log does not determine the start, naming what is missing, or if the loops cannot
            close next to the first row.
    """
    sample = first_rows(all_rows(data))
    rates, differences = rates_at_start(data, rows)
    known = {body: pose for body, pose in body_poses(elements, sample, default).items() if pose.is_complete}
    moving = velocities(elements, sample, rates, default)
    guess = initial_state(scene)
    if len(known) < len(scene.mechanism.bodies):
        guess = _completed(scene, data, rates, known)
    arrays = [array.copy() for array in guess.arrays]
    for body in known.keys() - {0}:
        for array, values in zip(arrays, (*known[body], *moving[body]), strict=True):
            array[body] = values[0]  # type: ignore[index]
    angles = {key: float(x[0]) for key, x in sample.coordinates.items() if key in counted_angles(scene)}
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
    return LogStart(state, moved, turned, worst[1], tuple(differences))


def _fitted(
    scene: Scene, state: State, elements: Elements, data: LogData, default: Origin, rows: int
) -> State:
    """Fit the velocities of a start state to the first rows of a log."""
    count = min(rows, len(data.time))
    sample = first_rows(all_rows(data), count)
    poses = {
        body: pose
        for body, pose in body_poses(elements, sample, default).items()
        if body and pose.is_complete
    }
    if not poses:
        return state
    position = np.stack([np.asarray(pose.position) for pose in poses.values()], axis=1)
    quaternion = np.stack([np.asarray(pose.quaternion) for pose in poses.values()], axis=1)
    times = data.time[:count] - data.time[0]
    return fitted_velocities(scene, state, times, position, quaternion, list(poses))


def _completed(scene: Scene, data: LogData, rates: Rates, known: Poses) -> State:
    """Find a state with the logged coordinates for a scene of which not all bodies are known.

    Raises:
        SourceError: if the log does not determine all bodies, naming a joint or body that is missing.
    """
    mechanism, where = scene.mechanism, data.where
    system = Relative(scene)
    q, _ = system.coordinates(initial_state(scene))
    free = free_motions(system, q)

    links = system.links(q, np.zeros(system.nv))

    def effect(keys: Sequence[Key]) -> Array:
        """Return the effect of free motions on joint coordinates."""
        rows: list[dict[int, Any]] = []
        for joint, number in keys:
            equations = system.tree.equations(mechanism.joint_index(joint))
            first, second = links[equations.first], links[equations.second]
            blocks = equations.coordinates[number].jacobian(first.frame, second.frame)
            rows.extend(system.project(blocks, first, second))
        return to_array(rows, system.nv) @ free

    bodies = system.velocity_transformation(q).reshape(-1, 6, system.nv)
    # what the log determines: known bodies, then coordinates
    chosen = np.concatenate([bodies[body] for body in known]) @ free
    count = np.linalg.matrix_rank(chosen, RANK_TOLERANCE)
    keys: list[Key] = []
    for key in [*data.coordinates, *mechanism.coordinate_labels]:
        if count == free.shape[1]:
            break
        more = np.concatenate([chosen, effect([key])])
        if np.linalg.matrix_rank(more, RANK_TOLERANCE) > count:
            if key not in data.coordinates:
                label = mechanism.coordinate_labels[key]
                problem = f"column coordinate.{label} is missing: no column determines joint {quoted(label)}"
                needed = (
                    f"that column, --log-map COLUMN=coordinate.{label}, or poses of the bodies that it moves"
                )
                raise SourceError(where, f"{problem}; needed: {needed}")
            chosen, count = more, count + 1
            keys.append(key)
    if count < free.shape[1]:
        unknown = [name for k, name in enumerate(mechanism.body_names) if k not in known]
        problem = f"no columns determine the poses of {listed(map(quoted, unknown)):.200}"
        raise SourceError(where, f"{problem}; needed: position.BODY.x to z and quaternion.BODY.w to z")
    own = [key for key in data.coordinates if key[0] in mechanism.joint_names]
    keys = _independent(effect(own), own) if own else []
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


def _independent(effects: Array, keys: Sequence[Key]) -> list[Key]:
    """Choose coordinates whose effects (k, free motions) are independent, the earlier ones first."""
    found: list[int] = []
    for k in range(len(keys)):
        if np.linalg.matrix_rank(effects[[*found, k]], RANK_TOLERANCE) > len(found):
            found.append(k)
    return [keys[k] for k in found]


def opening(mechanism: Mechanism, poses: Poses) -> float:
    """Return the largest residual of all joints between bodies with known poses, m or rad."""
    complete = {body: pose for body, pose in poses.items() if pose.is_complete}
    if len(complete) < 2:
        return 0.0
    places = list(complete)
    position = np.stack([complete[k].position for k in places], axis=1)  # type: ignore[misc]
    quaternion = np.stack([complete[k].quaternion for k in places], axis=1)  # type: ignore[misc]
    rest = np.zeros_like(position)
    frames = dict(zip(places, stacked_frames(position, quaternion, rest, rest), strict=True))
    largest = 0.0
    for equations in mechanism.equations:
        if equations.first in complete and equations.second in complete:
            phi = equations.phi(frames[equations.first], frames[equations.second])
            if len(phi):
                largest = max(largest, float(np.max(np.abs(unstacked(phi, len(position))))))
    return largest


def energy(scene: Scene, data: LogData, poses: Poses, moving: Mapping[int, tuple[Array, Array]]) -> Any:
    """Return kinetic and potential energy (n,), J, of logged motion; None if it is not known.

    Args:
        scene: the scene.
        data: the log.
        poses: poses of bodies.
        moving: linear and angular velocities (n, 3) of bodies.
    """
    count = len(scene.mechanism.bodies)
    if len(moving) < count:
        return None
    wound = [key for key in counted_angles(scene) if key in data.coordinates]
    if any(np.max(np.abs(data.coordinates[key].values)) > np.pi for key in wound):
        return None
    arrays = [[*poses[k], *moving[k]] for k in range(count)]
    stacked = [np.stack([np.asarray(each[i]) for each in arrays], axis=1) for i in range(4)]
    frames = stacked_frames(*stacked)
    rows = len(data.time)
    inertias = [body.inertia for body in scene.mechanism.bodies]
    kinetic, potential = energies(scene, frames, inertias)
    at = surroundings(scene, _StackedState(frames))  # type: ignore[arg-type]
    kinetic = kinetic + sum((armature.energy(at) for armature in scene.armatures), start=0.0)
    potential = potential + sum((force.energy(at) for force in scene.forces), start=0.0)
    return unstacked([kinetic, potential], rows).T


class _StackedState:
    """Frames of a state at n times, for `surroundings`."""

    def __init__(self, frames: list[Any]) -> None:
        self._frames = frames

    def frames(self) -> list[Any]:
        """Return the frames of all bodies."""
        return self._frames

    def revolutions(self, key: Key, x: Any) -> float:
        """Return no revolutions: angles are within half a revolution."""
        return 0.0
