"""What is measured of equations of motion and of runs: tables of numbers, and what they are relative to."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from crosscheck.comparison.energy import energy_balance
from newton_euler.equations.system import Evaluation
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.scalars import Array

XYZ = ("x", "y", "z")
WXYZ = ("w", "x", "y", "z")


@dataclass(frozen=True, eq=False)
class Value:
    """A measured figure.

    Attributes:
        name, unit: of the quantity; the unit of a count is empty.
        rows, columns: names, as of `crosscheck.regress.baseline.Figure`.
        array: (rows, columns).
        scale: what round-off is relative to.
        over_time: whether rows are times; errors grow along them, otherwise all rows have one error.
        is_count: of steps, evaluations or operations.
    """

    name: str
    unit: str
    rows: tuple[str, ...]
    columns: tuple[str, ...]
    array: Array
    scale: float
    over_time: bool = False
    is_count: bool = False


def single(name: str, unit: str, value: float, scale: float) -> Value:
    """A figure of one number."""
    return Value(name, unit, ("",), ("",), np.array([[value]]), scale)


def count(name: str, value: int) -> Value:
    """A number of steps, evaluations or operations."""
    return Value(name, "", ("",), ("",), np.array([[float(value)]]), float(value), is_count=True)


def table(name: str, unit: str, rows: Sequence[str], array: Array, scale: float) -> Value:
    """(rows, 3) vectors or (rows, 4) quaternions."""
    columns = WXYZ if array.shape[1] == 4 else XYZ
    return Value(name, unit, tuple(rows), columns, np.asarray(array), scale)


def _largest(array: Array) -> float:
    return float(np.max(np.abs(array), initial=0.0))


def _scales(linear: Array, angular: Array, arm: float) -> tuple[float, float]:
    """What round-off in a linear and an angular quantity is relative to: either makes the other, on an arm.

    Without both there is nothing that could have round-off.
    """
    scale = max(_largest(linear), _largest(angular) * arm) or 1.0
    return scale, scale / arm


def equations(scene: Scene, label: str, found: Evaluation) -> Iterator[Value]:
    """Accelerations of all bodies and reactions at all joints at one state."""
    mechanism = scene.mechanism
    bodies, size = mechanism.body_names[1:], mechanism.size
    linear, angular = found.linear_acceleration[1:], found.angular_acceleration[1:]
    of_linear, of_angular = _scales(linear, angular, size)
    yield table(f"{label}: linear acceleration", "m/s^2", bodies, linear, of_linear)
    yield table(f"{label}: angular acceleration", "rad/s^2", bodies, angular, of_angular)
    # a torque is a force on an arm
    force, torque = found.reaction_force, found.reaction_torque
    of_force, of_torque = _scales(force, torque, 1.0 / size)
    joints = mechanism.joint_names
    yield table(f"{label}: reaction force", "N", joints, force, of_force)
    yield table(f"{label}: reaction torque", "N m", joints, torque, of_torque)


def poses_over_time(scene: Scene, run: Trajectory) -> Iterator[Value]:
    """Positions and quaternions of all bodies at all output times."""
    bodies = run.body_names[1:]
    rows = tuple(f"{time:.9g} s" for time in run.time)
    scale = max(scene.mechanism.size, _largest(run.position))
    for name, unit, array, letters, of in (
        ("position over time", "m", run.position, XYZ, scale),
        ("quaternion over time", "", run.quaternion, WXYZ, 1.0),
    ):
        columns = tuple(f"{body} {letter}" for body in bodies for letter in letters)
        yield Value(name, unit, rows, columns, array[:, 1:].reshape(len(rows), -1), of, over_time=True)


def end_of_run(scene: Scene, label: str, run: Trajectory) -> Iterator[Value]:
    """Poses and velocities of all bodies at the end, and by how much joints were open at most."""
    assert run.linear_velocity is not None
    assert run.angular_velocity is not None
    assert run.constraint_violation is not None
    bodies, size = run.body_names[1:], scene.mechanism.size
    far = max(size, _largest(run.position))
    yield table(f"{label}: position at the end", "m", bodies, run.position[-1, 1:], far)
    yield table(f"{label}: quaternion at the end", "", bodies, run.quaternion[-1, 1:], 1.0)
    linear, angular = run.linear_velocity, run.angular_velocity
    of_linear, of_angular = _scales(linear, angular, size)
    yield table(f"{label}: linear velocity at the end", "m/s", bodies, linear[-1, 1:], of_linear)
    yield table(f"{label}: angular velocity at the end", "rad/s", bodies, angular[-1, 1:], of_angular)
    yield single(f"{label}: drift", "m or rad", _largest(run.constraint_violation), max(size, 1.0))


def balance(scene: Scene, label: str, run: Trajectory) -> Iterator[Value]:
    """By how much the energy changes beyond the work done, as a share of what is exchanged."""
    found = energy_balance(scene, run)
    assert found is not None
    error = _largest(found.residual) / (found.exchanged or 1.0)
    yield single(f"{label}: energy error", "relative", error, 1.0)


def counts(label: str, run: Trajectory) -> Iterator[Value]:
    """What the integrator counted."""
    for name in ("steps", "evaluations"):
        yield count(f"{label}: {name}", run.settings[name])
