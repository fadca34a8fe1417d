"""Velocities and energies of a mechanism's bodies from the quantities of a log.

A log has joint coordinates, and poses of frames on bodies, at the times of its rows. Rates come from columns
of the log, or else from differences of its first rows.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from crosscheck.logs.columns import LogData, Measured
from crosscheck.logs.names import Elements, Origin
from crosscheck.logs.poses import BodyPose, LoggedQuantities, Poses, body_poses, quaternion_products
from newton_euler.equations.applied_forces import energies, surroundings
from newton_euler.equations.couplings import counted_angles
from newton_euler.model.euler_parameters import conjugate, from_rotation_vector
from newton_euler.model.joint import Key
from newton_euler.model.scene import Scene
from newton_euler.model.state import stacked_frames
from newton_euler.scalars import Array, unstacked

RATE_ROWS = 5
"""Number of first rows whose polynomial gives the rates at the start, if the log has no rates."""

MAX_DIFFERENCE = 1e-5
"""Largest change of a coordinate or frame, rad or m, in the time step of a difference quotient that converts
rates of coordinates and frames to velocities of bodies."""

MIN_FASTEST_RATE = 1e-3
"""Lower bound, rad/s or m/s, of the largest rate, which limits that time step to 0.01 s."""


class Rates(NamedTuple):
    """Rates of logged quantities at n times, or at one (n = 1).

    Attributes:
        coordinates: (n,) m/s or rad/s, by joint coordinate.
        linear: (n, 3) m/s, world frame, by name of the frame: velocity of the point whose position is logged.
        angular: (n, 3) rad/s, world frame, by name of the frame.
    """

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
            angular[name] = 2.0 * quaternion_products(slope, conjugate(frame.quaternion.values[:1]))[:, 1:]
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


def derivative_at_start(time: Array, values: Array, rows: int) -> Array:
    """Differentiate values (n, ...) at the first of n times by the polynomial through the first rows."""
    rows = min(rows, len(time))
    scale = time[rows - 1] - time[0]
    powers = np.vander((time[:rows] - time[0]) / scale, rows, increasing=True)
    # weights w of the rows: p'(0) = w . values
    weights = np.linalg.solve(powers.T, np.eye(rows)[1]) / scale
    return np.tensordot(weights, values[:rows], axes=1)


def velocities(
    elements: Elements, quantities: LoggedQuantities, rates: Rates, default: Origin
) -> dict[int, tuple[Array, Array]]:
    """Compute velocities of centers of mass and angular velocities (n, 3) of all bodies with known poses.

    The poses are computed a short time before and after each time, and subtracted.

    Args:
        elements: the scene's joints, and frames with their places on bodies, by the names that columns of the
            log can have.
        quantities: logged coordinates and poses of frames at n times.
        rates: their rates.
        default: point of positions whose columns do not state a point.

    Returns:
        By number of the body, in the world frame: m/s and rad/s.
    """
    numbers = [*rates.coordinates.values(), *rates.linear.values(), *rates.angular.values()]
    step = MAX_DIFFERENCE / max(MIN_FASTEST_RATE, *(float(np.max(np.abs(each))) for each in numbers))
    before, after = (
        body_poses(elements, _advanced(quantities, rates, sign * step), default) for sign in (-1.0, 1.0)
    )
    found: dict[int, tuple[Array, Array]] = {}
    for body, pose in after.items():
        if pose.is_complete:
            linear = (pose.position - before[body].position) / (2.0 * step)  # type: ignore[operator]
            turn = quaternion_products(pose.quaternion, conjugate(before[body].quaternion))  # type: ignore[arg-type]
            turn = turn * np.where(turn[:, :1] < 0.0, -1.0, 1.0)
            found[body] = linear, turn[:, 1:] / step  # twice the vector part, in twice the step
    return found


def _advanced(quantities: LoggedQuantities, rates: Rates, step: float) -> LoggedQuantities:
    """Return the quantities after a short time, s, which may be negative."""
    coordinates = {key: x + step * rates.coordinates[key] for key, x in quantities.coordinates.items()}
    frames = {}
    for name, (position, quaternion) in quantities.frames.items():
        if position is not None:
            position = position + step * rates.linear[name]
        if quaternion is not None:
            turns = np.array([from_rotation_vector(step * omega) for omega in rates.angular[name]])
            quaternion = quaternion_products(turns, quaternion)
        frames[name] = BodyPose(position, quaternion)
    return quantities._replace(coordinates=coordinates, frames=frames)


def energy(
    scene: Scene, data: LogData, poses: Poses, moving: Mapping[int, tuple[Array, Array]]
) -> Array | None:
    """Compute kinetic and potential energy (2, n), J, of logged motion.

    Args:
        scene: the scene.
        data: the log, with n rows.
        poses: poses of bodies.
        moving: velocities of bodies, see `velocities`.

    Returns:
        The energies; None if the log does not determine the motion of all bodies, or if forces depend on a
        logged angle beyond half a revolution. Energies follow from poses, which do not show revolutions.
    """
    body_count = len(scene.mechanism.bodies)
    if len(moving) < body_count:
        return None
    # angles on which forces and couplings depend, and whose revolutions simulations count; an angle that is
    # not logged is taken to be within half a revolution
    counted = [key for key in counted_angles(scene) if key in data.coordinates]
    if any(np.max(np.abs(data.coordinates[key].values)) > np.pi for key in counted):
        return None
    # frames whose numbers are stacks: scalars that hold the values at all n times
    motions = [[*poses[k], *moving[k]] for k in range(body_count)]
    arrays = [np.stack([np.asarray(each[i]) for each in motions], axis=1) for i in range(4)]  # (n, bodies, .)
    frames = stacked_frames(*arrays)
    inertias = [body.inertia for body in scene.mechanism.bodies]
    kinetic, potential = energies(scene, frames, inertias)
    # `at`: coordinates, rates and poses on which the energies of armatures (rotors) and springs depend
    at = surroundings(scene, _StackedState(frames))  # type: ignore[arg-type]
    kinetic = kinetic + sum((armature.energy(at) for armature in scene.armatures), start=0.0)
    potential = potential + sum((force.energy(at) for force in scene.forces), start=0.0)
    return unstacked([kinetic, potential], len(data.time)).T  # from (n, 2)


class _StackedState:
    """The part of a `State` that `surroundings` uses, with frames at n times."""

    def __init__(self, frames: list[Any]) -> None:
        self._frames = frames

    def frames(self) -> list[Any]:
        """Return the frames of all bodies."""
        return self._frames

    def revolutions(self, key: Key, x: Any) -> float:
        """Return 0, the full revolutions of an angle: all angles are within half a revolution here."""
        return 0.0
