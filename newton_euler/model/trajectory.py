"""Trajectory: what every engine returns, or, of a run that ends before its time, raises with the error."""

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
    """A computed array of a trajectory.

    Attributes:
        shape: n times, b bodies, j joints, a actuators.
        unit: SI, "" where it depends on the joint.
        output: which a scene has to be asked for; None for what all runs have.
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
"""Quantities of bodies, joints and mechanisms, by name."""

SHAPES = {
    "time": "n",
    "body_names": "b",
    "joint_names": "j",
    "constraint_violation": "nj",
    "angle_names": "c",
    "joint_angle": "nc",
} | {name: quantity.shape for name, quantity in QUANTITIES.items()}
"""Shapes of the arrays of a trajectory; c is the number of carried angles."""

UNREADABLE = (OSError, EOFError, KeyError, RuntimeError, MemoryError, BadZipFile, ZlibError)
"""Errors that broken archives raise, in addition to ValueError."""

COMPONENTS = {"3": "xyz", "4": "wxyz"}  # names of the components of vectors and quaternions
NEEDED = ("time", "body_names", "joint_names", "position", "quaternion")  # arrays that every run has


class JointMotion(NamedTuple):
    """The k coordinates of a joint over n output times, as control laws and springs measure them."""

    names: tuple[str, ...]
    """(k,) "angle" or "position", numbered from 1 where a joint has several of a kind."""
    coordinates: Floats
    """(n, k) rad or m from the initial pose, revolutions counted."""
    rates: Floats | None
    """(n, k) rad/s or m/s; None where the scene did not ask for velocities."""

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
    """Compute the coordinates (..., n, k) of a joint, and their rates, of motions over the same n times, s.

    Arrays are those of `Trajectory`, (..., n, b, 3 or 4), of any number of runs; `carried` has the angles
    (..., n), rad, that the runs carry, by the number of the coordinate.
    """
    bodies, measures = [equations.first, equations.second], equations.coordinates
    has_rates = linear_velocity is not None and angular_velocity is not None
    if linear_velocity is None or angular_velocity is None:
        linear_velocity = angular_velocity = np.zeros_like(position)
    motion = (position, quaternion, linear_velocity, angular_velocity)
    first, second = stacked_frames(*(a[..., bodies, :].reshape(-1, 2, a.shape[-1]) for a in motion))
    with np.errstate(invalid="ignore", divide="ignore"):  # hinges in a row do not reach all
        found = [measure.phi(first, second)[0] for measure in measures]
        slopes = [measure.jacobian(first, second).rate(first, second)[0] for measure in measures]
    times, shape = position[..., 0, 0].size, (*position.shape[:-2], len(measures))
    x, rates = (unstacked(scalars, times).reshape(shape) for scalars in (found, slopes))
    for k, measure in enumerate(measures):
        if k in carried:
            x[..., k] += whole_revolutions(carried[k] - x[..., k])
        elif not measure.is_length:
            expected = np.diff(time) * 0.5 * (rates[..., 1:, k] + rates[..., :-1, k])
            x[..., 1:, k] += np.cumsum(whole_revolutions(expected - np.diff(x[..., k])), axis=-1)
    return JointMotion(coordinate_names(equations.joint), x, rates if has_rates else None)


@dataclass(frozen=True, eq=False)
class Trajectory:
    """A run at n output times: b bodies (ground first), j joints, a actuators; world frame, SI.

    Arrays that the scene did not ask for are None and are left out of files.

    Attributes:
        engine: name of the engine that made it.
        settings: the options it ran with and what it counted (steps, evaluations).
        wall_time: s, of the run itself, without building the model.
        angle_names: of the c angles that the run carries, as of `Mechanism.coordinate_labels`: those that
            forces, control laws or couplings depend on. Files hold none where there are none.
        mechanism: what moved; None of a run that was made of arrays alone. Files do not hold it.

    Examples:
        >>> run = simulate(load("pendulum"))
        >>> run
        <Trajectory of newton_euler: 1001 outputs to 10 s, bodies: 2, joints: 1>
        >>> def shape(run: Trajectory) -> tuple[int, ...]:
        ...     return run.position.shape
        >>> shape(run)
        (1001, 2, 3)
    """

    engine: str
    settings: dict[str, Any]
    wall_time: float
    time: Floats
    """(n,) s."""
    body_names: tuple[str, ...]
    joint_names: tuple[str, ...]
    position: Floats
    """(n, b, 3) centers of mass, m."""
    quaternion: Floats
    """(n, b, 4) w-x-y-z, continuous in sign."""
    linear_velocity: Floats | None = None
    """(n, b, 3) of the centers of mass, m/s."""
    angular_velocity: Floats | None = None
    """(n, b, 3) rad/s."""
    reaction_force: Floats | None = None
    """(n, j, 3) constraint force on the second body, N; not unique where constraints are redundant, see
    `newton_euler.equations.reactions`."""
    reaction_torque: Floats | None = None
    """(n, j, 3) constraint torque on the second body about the joint point, N m; as unique as the force."""
    actuator_force: Floats | None = None
    """(n, a) along the actuated coordinates, N or N m."""
    constraint_violation: Floats | None = None
    """(n, j) largest residual of each joint's equations, m or rad."""
    kinetic_energy: Floats | None = None
    """(n,) J."""
    potential_energy: Floats | None = None
    """(n,) of gravity, zero at the world origin, and of springs, zero at rest, J."""
    work: Floats | None = None
    """(n,) done since the start by control, dampers, wrenches, wind and prescribed motions, J."""
    angle_names: tuple[str, ...] = ()
    joint_angle: Floats | None = None
    """(n, c) the carried angles with their revolutions, rad from the initial pose; None if there are none."""
    mechanism: Mechanism | None = None

    def __repr__(self) -> str:
        made = f"of {self.engine}" if self.engine else "of no engine"
        size = f"bodies: {len(self.body_names)}, joints: {len(self.joint_names)}"
        return f"<Trajectory {made}: {len(self.time)} outputs to {self.time[-1]:g} s, {size}>"

    @checked
    def joint(self, name: str) -> JointMotion:
        """Compute the coordinates of a joint, and their rates, at all output times.

        Angles that the run carries, `angle_names`, have the revolutions of `joint_angle`. Other angles begin
        within half a revolution of the initial pose. From output to output they follow their rates by the
        trapezoidal rule, whose error must be below half a revolution: where joints turn fast and unevenly,
        choose a shorter output period. Without rates they must move by less than half a revolution.

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
        """The carried angles (n,) by joint coordinate."""
        if self.joint_angle is None:
            return {}
        keys = (coordinate_key(name, self.joint_names) for name in self.angle_names)
        return dict(zip(keys, self.joint_angle.T, strict=True))

    def state(self, output: int) -> State:
        """Return the state at an output, from which a scene may start; at rest if the run has no velocities.

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
        """Return a table with a row per output time, of pandas, or of polars if that alone is installed.

        Its columns are `time` and the components of the arrays, `position.rod.x` and `reaction_force.pivot.z`
        for example; actuators go by number.

        Raises:
            MissingPackageError: if neither is installed.
        """
        columns: dict[str, Array] = {}
        for name, array in self.arrays().items():
            if array.dtype.kind == "f":
                names = column_names(name, array.shape[1:], self._names)
                columns |= zip(names, array.reshape(len(array), -1).T, strict=True)
        with suppress(MissingPackageError):
            return optional_package("pandas", "tables").DataFrame(columns)
        with suppress(MissingPackageError):
            return optional_package("polars", "tables").DataFrame(columns)
        raise MissingPackageError("pandas", "tables")

    @property
    def _names(self) -> dict[str, Sequence[str]]:
        """Names along dimensions, by their letters in `SHAPES`."""
        return {"b": self.body_names, "j": self.joint_names, "c": self.angle_names}

    def arrays(self) -> dict[str, Array]:
        """The arrays of the run by name, names as arrays of text."""
        skipped = (
            "engine",
            "settings",
            "wall_time",
            "mechanism",
            *(() if self.angle_names else ("angle_names",)),
        )
        values = {f.name: getattr(self, f.name) for f in fields(self) if f.name not in skipped}
        return {name: np.asarray(value) for name, value in values.items() if value is not None}

    @checked
    def first(self, outputs: Annotated[int, Range(0)]) -> Trajectory:
        """The run at its first outputs; itself if it has no more."""
        if outputs >= len(self.time):
            return self
        cut: dict[str, Any] = {
            name: values[:outputs] for name, values in self.arrays().items() if values.dtype.kind == "f"
        }
        return replace(self, **cut)

    @checked
    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the arrays to an .npz; the file appears whole or not at all.

        Raises:
            SourceError: naming a path that cannot be written.
        """
        content = self.archive()  # a zip file on a full disk would fail once more on its way out
        try:
            with atomic_file(path) as temporary:
                temporary.write_bytes(content)
        except OSError as error:
            raise SourceError(quoted(os.fspath(path)), f"cannot be written: {error.strerror}") from error

    def archive(self) -> bytes:
        """The content of an .npz of the arrays."""
        content = io.BytesIO()
        arrays: dict[str, Any] = dict(self.arrays())
        np.savez_compressed(content, **arrays)
        return content.getvalue()


def column_names(name: str, shape: Sequence[int], names: Mapping[str, Sequence[str]]) -> list[str]:
    """Name the components of an array of a trajectory at one time, in order: `position.rod.x` for one.

    `names` are those along dimensions by their letters in `SHAPES`.
    """
    named = {**names, **COMPONENTS}
    found = []
    for place in np.ndindex(*shape):
        ends = zip(SHAPES[name][1:], place, strict=True)
        found.append(".".join((name, *(named[each][k] if each in named else str(k) for each, k in ends))))
    return found


def coordinate_key(label: str, joints: Collection[str]) -> Key:
    """Return the joint coordinate of a label of `Mechanism.coordinate_labels`, of joints of these names.

    Raises:
        ValueError: for a label of none of them.
    """
    joint, _, number = (label, "", "0") if label in joints else label.rpartition(".")
    if joint not in joints or not (number.isascii() and number.isdecimal()):
        raise ValueError(f"angle_names has {label!r:.100}, no coordinate of a joint")
    return joint, int(number)


def coordinate_names(joint: Joint) -> tuple[str, ...]:
    """Name the coordinates of a joint, numbered from 1 where it has several of a kind."""
    kinds = ["position" if kind == "slide" else "angle" for kind in joint.coordinate_kinds]
    return tuple(
        kind if kinds.count(kind) == 1 else f"{kind}_{kinds[:k].count(kind) + 1}"
        for k, kind in enumerate(kinds)
    )


def distance(one: Trajectory, two: Trajectory, at: int | slice = slice(None), length: float = 1.0) -> float:
    """Return the largest difference of two runs at some outputs, of positions, in units of a length in m, and
    of orientations, rad."""
    angles = angle_between(one.quaternion[at], two.quaternion[at])
    apart = np.linalg.norm(one.position[at] - two.position[at], axis=-1) / length
    return float(max(np.max(apart), np.max(angles)))


class StoppedError(NewtonEulerError):
    """Base of errors of runs, in any engine, that end before their time.

    Attributes:
        time: s, that the run had reached.
        reason: why it could not go on, with the joint or the force that it is about.
        partial: the run at the output times before, a trajectory like any other; None if it did not
            come that far, or was one of a batch.
    """

    def __init__(self, time: float, reason: str, message: str) -> None:
        self.time = time
        self.reason = reason
        self.partial: Trajectory | None = None
        super().__init__(message)


class IntegrationError(StoppedError):
    """A run that an integrator could not carry on."""

    def __init__(self, time: float, reason: str) -> None:
        super().__init__(time, reason, f"integration stopped at t = {time:.6g} s: {reason}")


class UndeterminedStartError(IntegrationError):
    """A run that starts at a singular configuration, where no equation determines its motion.

    It starts at rest, or with velocities of no branch. Runs of other engines may move in any of the possible
    directions, so they cannot be compared.
    """


def check_finite(times: Array, arrays: Mapping[str, Array]) -> None:
    """Raise `IntegrationError` for the first time at which an array, a row for each, is not finite."""
    wrong = {name: np.argwhere(~np.isfinite(array)) for name, array in arrays.items()}
    first = [(int(rows[0, 0]), name) for name, rows in wrong.items() if len(rows)]
    if first:
        row, name = min(first)
        raise IntegrationError(float(times[row]), f"{name} is not finite")


def load_arrays(path: str | os.PathLike[str]) -> dict[str, Array]:
    """Read the arrays of a saved trajectory by name, each with the type and the shape of `SHAPES`.

    Raises:
        SourceError: naming the file, and the array at fault if one is.
    """
    content = io.BytesIO(read_content(path, "array_size"))
    try:
        with ZipFile(content) as archive:  # which unpacks no more than its directory says
            size = sum(entry.file_size for entry in archive.infolist())
        if problem := exceeded("array_size", size / MB):
            raise ValueError(problem)
        with np.load(content, allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
        _check_arrays(arrays)
    except (*UNREADABLE, ValueError) as error:
        raise SourceError(os.fspath(path), f"holds no trajectory: {error}") from error
    return arrays


def _check_arrays(arrays: Mapping[str, Array]) -> None:
    """Raise `ValueError` for arrays that are missing, of shapes that do not fit, or not finite."""
    sizes = {digit: int(digit) for digit in "34"}
    for name in NEEDED:
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
    for name, array in arrays.items():
        needed = tuple(sizes[letter] for letter in SHAPES[name])
        if array.shape != needed:
            raise ValueError(f"{name} has shape {array.shape}; needed: {needed}")
        if array.dtype.kind == "f" and not np.all(np.isfinite(array)):
            raise ValueError(f"{name} is not finite")
    if ("joint_angle" in arrays) != ("angle_names" in arrays):
        raise ValueError("one of joint_angle and angle_names without the other")
    joints, labels = (
        arrays[name].tolist() if name in arrays else [] for name in ("joint_names", "angle_names")
    )
    if len({coordinate_key(label, joints) for label in labels}) < len(labels):
        raise ValueError("angle_names has a coordinate twice")
    if sizes["n"] == 0 or sizes["b"] == 0 or np.any(np.diff(arrays["time"]) <= 0.0):
        raise ValueError("no bodies, or no times that increase")
