"""Poses of a mechanism's bodies from the quantities of a log.

Logged poses of body frames give poses of the scene's bodies. From these, and from the ground, poses of other
bodies follow along the joints whose coordinates are logged. Bodies that the log does not determine stay
unknown and are not compared.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from crosscheck.logs.columns import LogData
from crosscheck.logs.names import Elements, Origin
from newton_euler.model.euler_parameters import conjugate, product, rotations
from newton_euler.model.joint import Joint, Key
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.state import stacked_frames
from newton_euler.reading.file_run import LoopErrors
from newton_euler.scalars import Array, unstacked

MAX_CENTER_OFFSET = 1e-12
"""Largest distance between a point and the center of mass, in sizes of the mechanism, that is round-off."""


class BodyPose(NamedTuple):
    """Poses of a body, or of a logged frame on a body, at n times; None if unknown.

    Attributes:
        position: (n, 3) m, center of mass of the body, or logged point of the frame.
        quaternion: (n, 4) orientation, (w, x, y, z).
    """

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


class LoggedQuantities(NamedTuple):
    """Logged joint coordinates and poses of frames at n times, SI units.

    Attributes:
        row_count: number n of times.
        coordinates: joint coordinates (n,) of the scene.
        frames: logged poses, by name of the frame.
        points: logged point of each frame, by its name; "" if the names of the columns do not state a point.
    """

    row_count: int
    coordinates: Mapping[Key, Array]
    frames: Mapping[str, BodyPose]
    points: Mapping[str, Origin]


def logged_quantities(data: LogData, count: int | None = None) -> LoggedQuantities:
    """Return the coordinates and poses of the first `count` rows of a log; of all rows if None."""
    count = len(data.time) if count is None else count
    frames = {
        name: BodyPose(
            None if frame.position is None else frame.position.values[:count],
            None if frame.quaternion is None else frame.quaternion.values[:count],
        )
        for name, frame in data.frames.items()
    }
    coordinates = {key: measured.values[:count] for key, measured in data.coordinates.items()}
    points = {name: frame.point for name, frame in data.frames.items()}
    return LoggedQuantities(count, coordinates, frames, points)


def body_poses(elements: Elements, quantities: LoggedQuantities, default: Origin) -> Poses:
    """Compute the poses of all bodies that logged quantities determine.

    Args:
        elements: joint coordinates and frames of the scene that columns of the log can belong to.
        quantities: logged coordinates and poses of frames.
        default: point of positions whose columns do not state a point.
    """
    mechanism, count = elements.mechanism, quantities.row_count
    ground = mechanism.bodies[0]
    poses: Poses = {
        0: BodyPose(
            np.broadcast_to(ground.center_of_mass, (count, 3)), np.broadcast_to(ground.quaternion, (count, 4))
        )
    }
    # logged poses of frames; `frame.point` and `frame.quaternion` are the fixed pose of a frame relative to
    # the body's center of mass and body frame
    for name, logged in quantities.frames.items():
        frame = elements.frames[name]
        body = mechanism.body_index(frame.body)
        quaternion = position = None
        if logged.quaternion is not None:
            quaternion = quaternion_products(logged.quaternion, conjugate(frame.quaternion))
        points = {"frame": frame.point, "center": frame.center, "scene": np.zeros(3)}
        point = points[quantities.points[name] or default]
        if logged.position is not None and np.max(np.abs(point)) <= MAX_CENTER_OFFSET * mechanism.size:
            position = logged.position
        elif logged.position is not None and quaternion is not None:
            position = logged.position - _rotated(quaternion, point)
        known = poses.get(body, BodyPose(None, None))
        poses[body] = BodyPose(
            position if known.position is None else known.position,
            quaternion if known.quaternion is None else known.quaternion,
        )
    # along joints with logged coordinates, until no further body becomes known
    waiting = list(mechanism.joints)
    while waiting:
        others = [joint for joint in waiting if not _pass_on(mechanism, joint, quantities, poses)]
        if len(others) == len(waiting):
            break
        waiting = others
    return {body: pose for body, pose in poses.items() if pose.is_known}


def _pass_on(mechanism: Mechanism, joint: Joint, quantities: LoggedQuantities, poses: Poses) -> bool:
    """Compute the pose of one end of a joint from the other end; False if that is not possible (yet)."""
    first, second = mechanism.body_index(joint.first), mechanism.body_index(joint.second)
    ends = [poses.get(end, BodyPose(None, None)) for end in (first, second)]
    keys = [(joint.name, k) for k in range(len(joint.coordinate_kinds))]
    kinds = {motion.kind for motion in joint.motions}
    if ends[0].is_complete == ends[1].is_complete or len(keys) != len(joint.motions) or "ball" in kinds:
        return ends[0].is_complete and ends[1].is_complete
    # coordinates and constraint equations together must determine the relative pose
    if len(keys) + _constraint_count(mechanism, joint) != 6 or not set(keys) <= quantities.coordinates.keys():
        return False
    coordinates = [quantities.coordinates[key] for key in keys]
    way, turn = _relative_pose(mechanism, joint, coordinates, quantities.row_count)
    initial = [mechanism.bodies[end].quaternion for end in (first, second)]
    # rotations since the initial pose: that of the second body is that of the first, times `turn`
    if ends[0].is_complete:
        rotation = quaternion_products(ends[0].quaternion, conjugate(initial[0]))
        found, known, position = second, poses.get(second), ends[0].position + _rotated(rotation, way)
        quaternion = quaternion_products(quaternion_products(rotation, turn), initial[1])
    else:
        rotation = quaternion_products(
            quaternion_products(ends[1].quaternion, conjugate(initial[1])), conjugate(turn)
        )
        found, known, position = first, poses.get(first), ends[1].position - _rotated(rotation, way)
        quaternion = quaternion_products(rotation, initial[0])
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
    # Zero coordinates close the `point_gap` that a variation of the joint has between its points on the two
    # bodies at the initial pose
    here = joint.motion_points[0] if joint.motions else joint.point_on_second
    way = np.tile(here - joint.point_gap - centers[0], (count, 1))
    turn = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    for motion, point, x in zip(joint.motions, joint.motion_points, coordinates, strict=True):
        way, here = way + _rotated(turn, point - here), point
        if motion.kind == "slide":
            way = way + _rotated(turn, motion.axis) * x[:, None]
        else:
            half = 0.5 * x[:, None]
            turn = quaternion_products(
                turn, np.concatenate([np.cos(half), np.sin(half) * motion.axis], axis=1)
            )
    return way + _rotated(turn, centers[1] - here), turn


def loop_joints(mechanism: Mechanism) -> tuple[str, ...]:
    """Name the joints of loops: without such a joint, other joints still connect its two bodies."""
    ends = [(equations.first, equations.second) for equations in mechanism.equations]
    found = []
    for k, (first, second) in enumerate(ends):
        reached, to_visit = {first}, [first]
        while to_visit:
            body = to_visit.pop()
            for other in set(mechanism.joints_at[body]) - {k}:
                (neighbor,) = {*ends[other]} - {body}
                if neighbor not in reached:
                    reached.add(neighbor)
                    to_visit.append(neighbor)
        if second in reached:
            found.append(mechanism.joint_names[k])
    return tuple(found)


def loop_errors(mechanism: Mechanism, poses: Poses) -> LoopErrors | None:
    """Return the violations of all joints of loops; None if a body of a loop has no known pose.

    Poses that follow along joints do not violate these joints, so that some joints of a loop show nothing.
    """
    found, needed = joint_errors(mechanism, poses), loop_joints(mechanism)
    if not set(needed) <= set(found.names):
        return None
    columns = [found.names.index(name) for name in needed]
    return LoopErrors(
        needed,
        found.openings[:, columns],
        found.angles[:, columns],
        found.have_lengths[columns],
        found.have_angles[columns],
    )


def joint_errors(mechanism: Mechanism, poses: Poses) -> LoopErrors:
    """Return the violations of all joints between bodies with known poses."""
    frames, count = _frames(poses)
    errors: dict[str, tuple[Array, Array]] = {}
    kinds: list[tuple[bool, bool]] = []  # whether a joint constrains lengths, and angles
    for joint, equations in zip(mechanism.joints, mechanism.equations, strict=True):
        if equations.first in frames and equations.second in frames:
            phi = equations.phi(frames[equations.first], frames[equations.second])
            residuals = np.abs(unstacked(phi, count))  # (n, rows of the joint)
            openings = np.linalg.norm(residuals * equations.is_length, axis=1)
            kinds.append((bool(np.any(equations.is_length)), not np.all(equations.is_length)))
            errors[joint.name] = openings, np.max(residuals * ~equations.is_length, axis=1, initial=0.0)
    if not errors:
        return LoopErrors((), np.zeros((0, 0)), np.zeros((0, 0)), np.zeros(0, bool), np.zeros(0, bool))
    openings, angles = (np.stack(each, axis=1) for each in zip(*errors.values(), strict=True))
    return LoopErrors(tuple(errors), openings, angles, *np.array(kinds).T)


def coordinates_in_poses(mechanism: Mechanism, poses: Poses) -> dict[Key, Array]:
    """Measure the coordinates (n,) of all joints between bodies with known poses, m or rad, up to pi."""
    frames, count = _frames(poses)
    found: dict[Key, Array] = {}
    for joint, equations in zip(mechanism.joints, mechanism.equations, strict=True):
        if equations.first in frames and equations.second in frames:
            for number, measure in enumerate(equations.coordinates):
                phi = measure.phi(frames[equations.first], frames[equations.second])
                found[joint.name, number] = unstacked(phi, count)[:, 0]
    return found


def _frames(poses: Poses) -> tuple[dict[int, Any], int]:
    """Return frames at rest for the bodies with known poses, each for n times at once, and the number n."""
    complete = {body: pose for body, pose in poses.items() if pose.is_complete}
    position = np.stack([np.asarray(pose.position) for pose in complete.values()], axis=1)
    quaternion = np.stack([np.asarray(pose.quaternion) for pose in complete.values()], axis=1)
    rest = np.zeros_like(position)
    return dict(zip(complete, stacked_frames(position, quaternion, rest, rest), strict=True)), len(position)


def quaternion_products(p: Any, q: Any) -> Array:
    """Return quaternion products (n, 4); one of the factors may be (4,)."""
    p, q = np.broadcast_arrays(p, q)
    return np.moveaxis(product(np.moveaxis(p, -1, 0), np.moveaxis(q, -1, 0)), 0, -1)


def _rotated(quaternions: Any, vectors: Any) -> Array:
    """Rotate vectors (3,) or (n, 3) by quaternions (n, 4)."""
    vectors = np.broadcast_to(vectors, (len(quaternions), 3))
    return np.einsum("nij,nj->ni", rotations(np.asarray(quaternions)), vectors)
