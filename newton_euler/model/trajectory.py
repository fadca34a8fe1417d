"""Trajectory: the result of a run in any engine, with body poses, velocities, reactions and energies over
time.

`Trajectory.save` writes the arrays to an .npz file and `load_arrays` reads them. The module also defines the
errors of runs that stop early; such an error carries the trajectory up to the stop. `joint_motion` computes
joint coordinates from body poses.
"""

from __future__ import annotations

import io
import os
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any, NamedTuple
from zipfile import BadZipFile, ZipFile
from zlib import error as ZlibError

import numpy as np

from newton_euler.arguments import Range, checked
from newton_euler.errors import (
    MechanismError,
    MissingPackageError,
    NewtonEulerError,
    OptionError,
    is_whole,
    quoted,
)
from newton_euler.limits import MB, exceeded
from newton_euler.model.euler_parameters import angle_between
from newton_euler.model.joint import Joint, JointEquations, Key
from newton_euler.model.mechanism import Mechanism
from newton_euler.model.scene import OutputName
from newton_euler.model.source_file import SourceError, read_content
from newton_euler.model.state import State, stacked_frames, whole_revolutions
from newton_euler.model.written_file import atomic_file
from newton_euler.optional_packages import optional_package
from newton_euler.scalars import Array, Floats, unstacked


class Quantity(NamedTuple):
    """Shape and unit of an array that a run computes, and the optional output to which it belongs.

    Attributes:
        shape: one character per dimension: n output times, b bodies, j joints, a actuators, or a number.
        unit: SI unit; "" if the unit depends on the joint.
        output: name of the optional output of the scene (`newton_euler.model.scene.OUTPUTS`) to which the
            array belongs; None if every run has the array.
    """

    shape: str
    unit: str
    output: OutputName | None = None


QUANTITIES = {
    "position": Quantity("nb3", "m"),
    "quaternion": Quantity("nb4", "1"),
    "linear_velocity": Quantity("nb3", "m/s", "velocities"),
    "angular_velocity": Quantity("nb3", "rad/s", "velocities"),
    "reaction_force": Quantity("nj3", "N", "reactions"),
    "reaction_torque": Quantity("nj3", "N m", "reactions"),
    "actuator_force": Quantity("na", "", "actuation"),
    "kinetic_energy": Quantity("n", "J", "energy"),
    "potential_energy": Quantity("n", "J", "energy"),
    "work": Quantity("n", "J", "energy"),
}
"""Computed arrays of a trajectory by attribute name."""

SHAPES = {
    "time": "n",
    "body_names": "b",
    "joint_names": "j",
    "constraint_violation": "nj",
    "angle_names": "c",
    "joint_angle": "nc",
} | {name: quantity.shape for name, quantity in QUANTITIES.items()}
"""Shapes of all arrays of a trajectory by name, with the letters of `Quantity.shape`.

The letter c stands for the carried angles: hinge angles that a run integrates with their full revolutions.
"""

ARCHIVE_ERRORS = (OSError, EOFError, KeyError, RuntimeError, MemoryError, BadZipFile, ZlibError)
"""Errors, in addition to ValueError, that `zipfile` and `numpy.load` raise for broken archives."""

COMPONENTS = {"3": "xyz", "4": "wxyz"}
"""Letters of the components of vectors and quaternions, by the character of their dimension in `SHAPES`."""

REQUIRED_ARRAYS = ("time", "body_names", "joint_names", "position", "quaternion")
"""Names of the arrays that every saved trajectory has."""


class JointMotion(NamedTuple):
    """The k coordinates of a joint over n output times, as control laws and springs measure them.

    Attributes:
        names: (k,) "angle" or "position", numbered from 1 if the joint has several coordinates of a kind.
        coordinates: (n, k) rad or m from the initial pose; angles include full revolutions.
        rates: (n, k) rad/s or m/s; None if the run has no velocities.
    """

    names: tuple[str, ...]
    coordinates: Floats
    rates: Floats | None

    def __repr__(self) -> str:
        return f"<JointMotion of {', '.join(self.names)}: {len(self.coordinates)} outputs>"


def joint_motion(
    equations: JointEquations,
    time: Array,
    carried: Mapping[int, Array],
    position: Array,
    quaternion: Array,
    linear_velocity: Array | None,
    angular_velocity: Array | None,
) -> JointMotion:
    """Compute the k coordinates of a joint and their rates from body poses and velocities, for any number of
    runs.

    Args:
        equations: the joint, with its two bodies.
        time: (n,) output times of all runs, s.
        carried: angles (..., n), rad, that the runs integrate with their full revolutions, by index of the
            coordinate in the joint. Body poses determine an angle only within one revolution.
        position: (..., n, b, 3) centers of mass of all b bodies, m, as in `Trajectory`.
        quaternion: (..., n, b, 4) orientations.
        linear_velocity, angular_velocity: (..., n, b, 3) m/s and rad/s; None if the runs have no velocities.

    Returns:
        Coordinates and rates (..., n, k).
    """
    # Evaluate all coordinates and rates at all times at once: the frames of the two bodies consist of `Stack`
    # scalars (the numbers of all runs and times as one scalar). A measure computes a coordinate as its `phi`
    bodies, measures = [equations.first, equations.second], equations.coordinates
    has_rates = linear_velocity is not None and angular_velocity is not None
    if linear_velocity is None or angular_velocity is None:
        linear_velocity = angular_velocity = np.zeros_like(position)
    motion = (position, quaternion, linear_velocity, angular_velocity)
    first, second = stacked_frames(*(a[..., bodies, :].reshape(-1, 2, a.shape[-1]) for a in motion))
    # A joint of three hinges may not be able to reach the poses; its angles are then NaN
    with np.errstate(invalid="ignore", divide="ignore"):
        x_stacks = [measure.phi(first, second)[0] for measure in measures]
        rate_stacks = [measure.jacobian(first, second).rate(first, second)[0] for measure in measures]
    count, shape = position[..., 0, 0].size, (*position.shape[:-2], len(measures))
    x, rates = (unstacked(stacks, count).reshape(shape) for stacks in (x_stacks, rate_stacks))

    # Add full revolutions (multiples of 2 pi) to angles: those of carried angles, or those that the rates
    # imply (trapezoidal rule)
    for k, measure in enumerate(measures):
        if k in carried:
            x[..., k] += whole_revolutions(carried[k] - x[..., k])
        elif not measure.is_length:
            expected = np.diff(time) * 0.5 * (rates[..., 1:, k] + rates[..., :-1, k])
            x[..., 1:, k] += np.cumsum(whole_revolutions(expected - np.diff(x[..., k])), axis=-1)
    return JointMotion(coordinate_names(equations.joint), x, rates if has_rates else None)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A run at n output times: b bodies (ground first), j joints, a actuators; world frame, SI units.

    Arrays of outputs that the scene does not list are None and are omitted in files.

    Attributes:
        engine: name of the engine that simulated the run.
        settings: options of the engine and its counts of steps and evaluations.
        wall_time: duration of the simulation in real time, s, without the construction of the model.
        body_names, joint_names: names in the order of the arrays.
        angle_names: labels (`Mechanism.coordinate_labels`) of the c carried angles. A run carries (integrates
            with their full revolutions) the angles on which forces, control laws or couplings depend.
        mechanism: the mechanism that moved; None for a trajectory that was made from arrays. Files do not
            contain it.

    Examples:
        >>> run: Trajectory = simulate(load("pendulum"))
        >>> run
        <Trajectory of newton_euler: 1001 outputs to 10 s, bodies: 2, joints: 1>
        >>> print(run.position[-1, run.body_names.index("dumbbell")].round(3))  # m, at the end
        [-0.138 -0.481  0.   ]
    """

    engine: str
    settings: dict[str, Any]
    wall_time: float
    time: Floats
    """(n,) output times, s."""
    body_names: tuple[str, ...]
    joint_names: tuple[str, ...]
    position: Floats
    """(n, b, 3) centers of mass, m."""
    quaternion: Floats
    """(n, b, 4) orientations (w, x, y, z), with signs that make them continuous in time."""
    linear_velocity: Floats | None = None
    """(n, b, 3) velocities of the centers of mass, m/s."""
    angular_velocity: Floats | None = None
    """(n, b, 3) rad/s."""
    reaction_force: Floats | None = None
    """(n, j, 3) constraint force on the second body of each joint, N. It is not unique if constraints are
    redundant; see `newton_euler.equations.reactions`."""
    reaction_torque: Floats | None = None
    """(n, j, 3) constraint torque on the second body of each joint about its joint point, N m; unique like
    the force."""
    actuator_force: Floats | None = None
    """(n, a) forces of control laws on their joint coordinates, N or N m."""
    constraint_violation: Floats | None = None
    """(n, j) largest residual of each joint's constraint equations, m or rad."""
    kinetic_energy: Floats | None = None
    """(n,) J."""
    potential_energy: Floats | None = None
    """(n,) J: energy in gravity, zero with all mass at the world origin, plus energy in springs, zero at
    their rest lengths and angles."""
    work: Floats | None = None
    """(n,) work since the start by control laws, dampers, wrenches, wind and prescribed motions, J."""
    angle_names: tuple[str, ...] = ()
    joint_angle: Floats | None = None
    """(n, c) carried angles including full revolutions, rad from the initial pose; None if there are none."""
    mechanism: Mechanism | None = None

    def __repr__(self) -> str:
        made = f"of {self.engine}" if self.engine else "of no engine"
        size = f"bodies: {len(self.body_names)}, joints: {len(self.joint_names)}"
        return f"<Trajectory {made}: {len(self.time)} outputs to {self.time[-1]:g} s, {size}>"

    @checked
    def joint(self, name: str) -> JointMotion:
        """Compute the coordinates of a joint, and their rates, at all output times.

        Angles that the run carries (`angle_names`) have the revolutions of `joint_angle`. Other angles begin
        within half a revolution of the initial pose; their revolutions follow from the rates by the
        trapezoidal rule. The error of the rule must be below half a revolution per output period: choose a
        shorter output period for joints that rotate fast and unevenly. Without velocities, angles must change
        by less than half a revolution per period.

        Args:
            name: name of the joint.

        Raises:
            UnknownNameError: for an unknown joint.
            MechanismError: if the trajectory has no mechanism.

        Examples:
            >>> motion = simulate(load("pendulum")).joint("pivot")
            >>> motion.names, motion.coordinates.shape
            (('angle',), (1001, 1))
        """
        if self.mechanism is None:
            needed = "one: dataclasses.replace(trajectory, mechanism=scene.mechanism)"
            raise MechanismError("trajectory", "has no mechanism", needed)
        motion = self.position, self.quaternion, self.linear_velocity, self.angular_velocity
        carried = {number: angle for (joint, number), angle in self._carried.items() if joint == name}
        return joint_motion(self.mechanism.joint_equations(name), self.time, carried, *motion)

    @property
    def _carried(self) -> dict[Key, Array]:
        """Carried angles (n,), rad, including full revolutions, by joint coordinate."""
        if self.joint_angle is None:
            return {}
        keys = (coordinate_key(name, self.joint_names) for name in self.angle_names)
        return dict(zip(keys, self.joint_angle.T, strict=True))

    def state(self, output: int) -> State:
        """Return the state at an output time, from which another scene may start; at rest if the run has no
        velocities.

        Args:
            output: index of the output time; negative indices count from the end.

        Raises:
            OptionError: for an output that the run does not have.

        Examples:
            >>> run = simulate(load("pendulum"))
            >>> again = simulate(replace(load("pendulum"), initial_state=run.state(-1)))
        """
        count = len(self.time)
        if not is_whole(output) or not -count <= int(output) < count:
            raise OptionError("output", output, f"a whole number from {-count} to {count - 1}")
        still = np.zeros_like(self.position)
        moving = (still if each is None else each for each in (self.linear_velocity, self.angular_velocity))
        arrays = (array[int(output)] for array in (self.position, self.quaternion, *moving))
        return State(*arrays, angles={key: float(angle[int(output)]) for key, angle in self._carried.items()})

    def to_dataframe(self) -> Any:
        """Return a pandas DataFrame with a row per output time; a polars DataFrame if only polars is
        installed.

        The columns are `time` and the components of the arrays, such as `position.rod.x` and
        `reaction_force.pivot.z`. Actuators are numbered from 0.

        Raises:
            MissingPackageError: if neither package is installed.
        """
        columns: dict[str, Array] = {}
        for name, array in self.arrays().items():
            if array.dtype.kind == "f":
                names = column_names(name, array.shape[1:], self._names)
                columns |= zip(names, array.reshape(len(array), -1).T, strict=True)
        with suppress(MissingPackageError):
            return optional_package("pandas", extra="tables").DataFrame(columns)
        with suppress(MissingPackageError):
            return optional_package("polars", extra="tables").DataFrame(columns)
        raise MissingPackageError("pandas", extra="tables")

    @property
    def _names(self) -> dict[str, Sequence[str]]:
        """Names of bodies, joints and carried angles, by the letter of the dimension in `SHAPES`."""
        return {"b": self.body_names, "j": self.joint_names, "c": self.angle_names}

    def arrays(self) -> dict[str, Array]:
        """Return the arrays of the run by name; names of bodies, joints and angles are arrays of text."""
        values = {f.name: getattr(self, f.name) for f in fields(self) if f.name in SHAPES}
        if not self.angle_names:
            del values["angle_names"]
        return {name: np.asarray(value) for name, value in values.items() if value is not None}

    @checked
    def first(self, outputs: Annotated[int, Range(0)]) -> Trajectory:
        """Return the run at its first output times; the run itself if it has at most this number of outputs.

        Args:
            outputs: number of output times.
        """
        if outputs >= len(self.time):
            return self
        shortened: dict[str, Any] = {
            name: values[:outputs] for name, values in self.arrays().items() if values.dtype.kind == "f"
        }
        return replace(self, **shortened)

    @checked
    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the arrays to an .npz file, which `numpy.load` reads.

        The file appears complete or not at all.

        Args:
            path: path of the file.

        Raises:
            SourceError: naming a path that cannot be written.
        """
        content = self.archive()  # in memory, because closing a zip file on a full disk raises a second error
        try:
            with atomic_file(path) as temporary:
                temporary.write_bytes(content)
        except OSError as error:
            raise SourceError(quoted(os.fspath(path)), f"cannot be written: {error.strerror}") from error

    def archive(self) -> bytes:
        """Return the content of an .npz file with the arrays."""
        content = io.BytesIO()
        arrays: dict[str, Any] = dict(self.arrays())
        np.savez_compressed(content, **arrays)
        return content.getvalue()


def column_names(name: str, shape: Sequence[int], names: Mapping[str, Sequence[str]]) -> list[str]:
    """Name the components of an array of a trajectory at one time, such as `position.rod.x`, in C order.

    Args:
        name: name of the array in `SHAPES`.
        shape: shape of the array without the dimension of time.
        names: names along dimensions, by the letter of the dimension in `SHAPES`; indices for other
            dimensions.
    """
    labels_of = {**names, **COMPONENTS}
    columns = []
    for indices in np.ndindex(*shape):
        labels = [name]
        for dimension, index in zip(SHAPES[name][1:], indices, strict=True):
            labels.append(labels_of[dimension][index] if dimension in labels_of else str(index))
        columns.append(".".join(labels))
    return columns


def coordinate_key(label: str, joints: Collection[str]) -> Key:
    """Return the joint coordinate that a label from `Mechanism.coordinate_labels` names.

    Args:
        label: "JOINT" or "JOINT.INDEX".
        joints: names of all joints.

    Raises:
        ValueError: for a label that names no coordinate of these joints.
    """
    joint, _, number = (label, "", "0") if label in joints else label.rpartition(".")
    if joint not in joints or not (number.isascii() and number.isdecimal()):
        raise ValueError(f"angle_names has {label!r:.100}, no coordinate of a joint")
    return joint, int(number)


def coordinate_names(joint: Joint) -> tuple[str, ...]:
    """Name the coordinates of a joint "angle" or "position"; several of a kind are numbered from 1."""
    kinds = ["position" if kind == "slide" else "angle" for kind in joint.coordinate_kinds]
    return tuple(
        kind if kinds.count(kind) == 1 else f"{kind}_{kinds[:k].count(kind) + 1}"
        for k, kind in enumerate(kinds)
    )


def distance(one: Trajectory, two: Trajectory, at: int | slice = slice(None), length: float = 1.0) -> float:
    """Return the largest difference between the body poses of two runs, over all bodies and some output
    times.

    Args:
        one, two: runs of the same bodies at the same output times.
        at: index or slice of the output times; all by default.
        length: length, m, by which distances are divided, so that they are comparable with angles in rad.

    Returns:
        The larger one of the largest distance of centers of mass, in units of `length`, and the largest
        angle, rad.
    """
    angles = angle_between(one.quaternion[at], two.quaternion[at])
    distances = np.linalg.norm(one.position[at] - two.position[at], axis=-1) / length
    return float(max(np.max(distances), np.max(angles)))


class StoppedError(NewtonEulerError):
    """Base class of errors for runs, in any engine, that stop before their end.

    Attributes:
        time: time that the run had reached, s.
        reason: why the run stopped, with the joint or force that caused it.
        partial: the run at the output times before the stop; None if there are none, or if the run was one of
            a batch.
    """

    def __init__(self, time: float, reason: str, message: str) -> None:
        self.time = time
        self.reason = reason
        self.partial: Trajectory | None = None
        super().__init__(message)


class IntegrationError(StoppedError):
    """A run that the integrator could not continue; `time`, `reason` and `partial` as of `StoppedError`."""

    def __init__(self, time: float, reason: str) -> None:
        super().__init__(time, reason, f"integration stopped at t = {time:.6g} s: {reason}")


class UndeterminedStartError(IntegrationError):
    """A run that starts at a singular configuration, where the equations do not determine the motion.

    The run starts at rest, or with velocities that belong to no branch of motion through the configuration.
    Different engines may then move in different directions, so that their runs cannot be compared.
    """


def check_finite(times: Array, arrays: Mapping[str, Array]) -> None:
    """Raise `IntegrationError` for the first time at which an array is not finite.

    Args:
        times: (n,) s.
        arrays: arrays (n, ...) with one row per time, by name.
    """
    not_finite = {name: np.argwhere(~np.isfinite(array)) for name, array in arrays.items()}
    first_rows = [(int(indices[0, 0]), name) for name, indices in not_finite.items() if len(indices)]
    if first_rows:
        row, name = min(first_rows)
        raise IntegrationError(float(times[row]), f"{name} is not finite")


def load_arrays(path: str | os.PathLike[str]) -> dict[str, Array]:
    """Read the arrays of a trajectory from an .npz file, and check their types and shapes (`SHAPES`).

    Args:
        path: path of the file.

    Returns:
        The arrays by name.

    Raises:
        SourceError: naming the file and, if one array is invalid, the array.
    """
    content = io.BytesIO(read_content(path, "array_size"))  # refuses a file larger than this limit
    try:
        # Refuse an archive whose arrays together are larger than the limit `array_size`, MB. The zip reader
        # unpacks at most the sizes in the archive's directory
        with ZipFile(content) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
        if problem := exceeded("array_size", size / MB):
            raise ValueError(problem)
        with np.load(content, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        _check_arrays(arrays)
    except (*ARCHIVE_ERRORS, ValueError) as error:
        raise SourceError(os.fspath(path), f"holds no trajectory: {error}") from error
    return arrays


def _check_arrays(arrays: Mapping[str, Array]) -> None:
    """Raise `ValueError` for missing or unknown arrays, shapes that do not fit together, and numbers that are
    not finite."""
    # All required arrays exist, and each array has the right type and number of dimensions
    sizes = {digit: int(digit) for digit in "34"}  # length of each dimension by its character in SHAPES
    for name in REQUIRED_ARRAYS:
        if name not in arrays:
            raise ValueError(f"no array {name!r}")
    for name, array in arrays.items():
        if name not in SHAPES:
            raise ValueError(f"unknown array {name!r:.100}")
        kind = "U" if name.endswith("_names") else "f"
        if array.dtype.kind != kind or array.ndim != len(SHAPES[name]):
            raise ValueError(f"{name} is an array of {array.dtype}, shape {array.shape}")
        for letter, size in zip(SHAPES[name], array.shape, strict=True):
            sizes.setdefault(letter, size)

    # The lengths of a dimension are the same in all arrays, and all numbers are finite
    for name, array in arrays.items():
        needed = tuple(sizes[letter] for letter in SHAPES[name])
        if array.shape != needed:
            raise ValueError(f"{name} has shape {array.shape}; needed: {needed}")
        if array.dtype.kind == "f" and not np.all(np.isfinite(array)):
            raise ValueError(f"{name} is not finite")

    # The labels of carried angles name different coordinates of known joints. There is at least one body, and
    # the times increase
    if ("joint_angle" in arrays) != ("angle_names" in arrays):
        raise ValueError("one of joint_angle and angle_names without the other")
    joints, labels = (
        arrays[name].tolist() if name in arrays else [] for name in ("joint_names", "angle_names")
    )
    if len({coordinate_key(label, joints) for label in labels}) < len(labels):
        raise ValueError("angle_names has a coordinate twice")
    if sizes["n"] == 0 or sizes["b"] == 0 or np.any(np.diff(arrays["time"]) <= 0.0):
        raise ValueError("no bodies, or no times that increase")
