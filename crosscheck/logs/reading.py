"""Read a log and compare it with the reference solution, a simulation from the start of the log.

A log is a table of joint coordinates and poses over time, measured or written by another simulator. It may
also have inputs: controls of actuators, and forces on joint coordinates. Options, such as units, state what
the names of its columns do not show.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np

from crosscheck.engines.adaptive import newton_euler_options
from crosscheck.logs.columns import LogData, read_columns
from crosscheck.logs.inputs import started_at, with_inputs
from crosscheck.logs.names import Elements, Origin
from crosscheck.logs.options import LogOptions
from crosscheck.logs.poses import Poses, body_poses, joint_errors, logged_quantities
from crosscheck.logs.rates import RATE_ROWS, energy, logged_rates, velocities
from crosscheck.logs.start import LogStart, log_start, with_own_velocities
from crosscheck.logs.table import MIN_ROWS, LogTable
from crosscheck.own_run.errors import MotionScale, RunError, run_error
from crosscheck.own_run.interpolation import TIME_TOLERANCE, interpolated, of_bodies, without_energies
from newton_euler.errors import NewtonEulerError
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import StoppedError, Trajectory
from newton_euler.reading.file_names import FileNames
from newton_euler.runs.simulate import simulate
from newton_euler.scalars import Array

MAX_ROWS = 4000
"""Largest number of compared rows; of a longer log every second, third, ... row is compared."""

MIN_FIT_GAIN = 3.0
"""Factor by which fitted velocities of the start must reduce the error of a log, beside the scene's own ones.
An error of the log itself, such as a late start, changes the fit, and the fit hides a part of this error."""

MIN_PERIODS = 500
"""Smallest number of outputs of the reference if the rows of a log are not equally spaced. The reference is
interpolated between outputs by cubic polynomials."""

EQUAL_SPACING = 1e-6
"""Largest deviation of a row from equal spacing, relative to the spacing, that is round-off of the file."""


def row_stride(data: LogData) -> int:
    """Return 1 if every row of a log is compared, 2 if every second row is, and so on."""
    return -(-len(data.time) // MAX_ROWS)


@dataclass(frozen=True, eq=False)
class ComparedLog:
    """A log and the reference solution from its start.

    Attributes:
        data: numbers of the log.
        start: start of the reference.
        scene: scene of the reference.
        reference: reference solution, at its own output times.
        reference_stop: why the reference stopped before the end of the log; "" if it did not.
        motion_scale: extent of the reference's motion, by which errors are divided.
        run: logged motion of the known bodies at the compared times.
        points: point of a body that logged positions are of: the "center" of mass, or the origin of the body
            "frame"; "" if the log has no positions of bodies.
        poses: poses of all known bodies.
        has_energy: True if the log determines the energy.
        error: error of the log.
    """

    data: LogData
    start: LogStart
    scene: Scene
    reference: Trajectory
    reference_stop: str
    motion_scale: MotionScale
    run: Trajectory
    points: Origin
    poses: Poses
    has_energy: bool
    error: RunError

    def reference_at(self, times: Array) -> Trajectory:
        """Return the reference at some times, s since the start, for the bodies of the log."""
        found = of_bodies(interpolated(self.reference, times), self.run.body_names)
        return found if self.has_energy else without_energies(found)

    @property
    def unknown_positions(self) -> tuple[str, ...]:
        """Compared bodies of which the log does not determine the position."""
        return tuple(self._compared_bodies("position"))

    @property
    def unknown_orientations(self) -> tuple[str, ...]:
        """Compared bodies of which the log does not determine the orientation."""
        return tuple(self._compared_bodies("quaternion"))

    def _compared_bodies(self, unknown: str) -> Iterator[str]:
        """Yield the compared bodies with an unknown part of the pose, an attribute of `BodyPose`."""
        for name in self.run.body_names:
            if getattr(self.poses[self.scene.mechanism.body_index(name)], unknown) is None:
                yield name


class OtherInputs(NamedTuple):
    """Comparisons with inputs that hold at other times than those of a log.

    Attributes:
        option: option by which each input holds from the row before, or else until the next row.
        error: error of the log with that option.
        thinned: change of the reference if only the inputs of every second row are used.
    """

    option: str
    error: RunError
    thinned: RunError


class LogReading:
    """A log that can be read in different ways.

    Attributes:
        scene: the scene, whose start the log replaces.
        names: names in the model file of the scene; None for other scenes.
        table: the log.
        elements: joint coordinates, frames and actuators that columns can belong to, by name.
    """

    def __init__(self, scene: Scene, names: FileNames | None, table: LogTable) -> None:
        """Take a scene, the names of its model file, and a log."""
        self.scene, self.names, self.table = scene, names, table
        self.elements = Elements(scene.mechanism, names)

    def data(self, options: LogOptions) -> LogData:
        """Return the numbers of the log as options read them.

        Raises:
            SourceError: for a log that cannot be read so, with the column and the remedy.
        """
        return read_columns(self.table, self.elements, options)

    def compared_rows(self, options: LogOptions) -> LogData:
        """Return the numbers of the log from the start of the comparison on, see `LogOptions.offset`."""
        return _from_offset(self.data(options), options.offset)

    def compared(self, options: LogOptions) -> ComparedLog:
        """Simulate the reference from the start of the log, and compare.

        Raises:
            SourceError: for a log that cannot be read so, or whose first row fits no state.
            NewtonEulerError: if the reference stops.
        """
        data = self.compared_rows(options)
        points = options.position or self._point(data)
        scene = with_inputs(self._scene_at(data, options), data, self.names)  # logged inputs replace its own
        start = log_start(scene, self.elements, data, points)
        if not start.is_fitted:
            return self._beside_reference(scene, data, points, start)
        # velocities that no column has may be those of the scene's own start; most runs start at rest
        try:
            own = self._beside_reference(scene, data, points, with_own_velocities(scene, start))
        except NewtonEulerError:  # such as rest at a singular configuration
            return self._beside_reference(scene, data, points, start)
        try:
            fitted = self._beside_reference(scene, data, points, start)
        except NewtonEulerError:  # fitted velocities of round-off can open loops
            return own
        return own if own.error.relative <= MIN_FIT_GAIN * fitted.error.relative else fitted

    def _beside_reference(self, scene: Scene, data: LogData, points: Origin, start: LogStart) -> ComparedLog:
        """Simulate a scene from the start of a log, and compare.

        Args:
            scene: scene that begins at the first row of the log, with the inputs of the log.
            data: the log.
            points: point of a body that positions are of.
            start: start of the reference.
        """
        # rows to compare, and outputs of the reference at these or at closer times
        rows = data.at(np.arange(0, len(data.time), row_stride(data)))
        times = rows.time - rows.time[0]
        scene = replace(
            scene,
            initial_state=start.state,
            duration=float(times[-1]),
            output_period=_output_period(times),
            outputs=frozenset({"velocities", "energy"}),
        )
        reference, stop = _reference(scene)
        scene = replace(scene, duration=float(reference.time[-1]))
        scale = MotionScale.of(reference, scene.mechanism)
        run, poses, has_energy = self._run(scene, rows, points, reference, times)
        expected = of_bodies(interpolated(reference, run.time), run.body_names)
        error = run_error(run, expected if has_energy else without_energies(expected), scale)
        return ComparedLog(
            data=data,
            start=start,
            scene=scene,
            reference=reference,
            reference_stop=stop,
            motion_scale=scale,
            run=run,
            points=points if any(frame.position for frame in data.frames.values()) else "",
            poses=poses,
            has_energy=has_energy,
            error=error,
        )

    def _point(self, data: LogData) -> Origin:
        """Choose the point that logged positions are of, by the violations of the joints at the first row.

        It is the "frame", unless the largest violation for "center" is less than half as large.
        """
        # if all origins are centers of mass, both choices give the same poses
        frames = [self.elements.frames[name] for name in data.frames]
        if all(np.array_equal(frame.point, frame.center) for frame in frames):
            return "center"
        first_row = logged_quantities(data, count=1)
        gaps = dict[Origin, float]()
        points: tuple[Origin, ...] = ("frame", "center")
        for point in points:
            poses = body_poses(self.elements, first_row, point)
            errors = joint_errors(self.scene.mechanism, poses)
            # largest violation, m or rad
            gaps[point] = max(float(np.max(each, initial=0.0)) for each in (errors.openings, errors.angles))
        return "center" if gaps["center"] < 0.5 * gaps["frame"] else "frame"

    def _run(
        self, scene: Scene, data: LogData, points: Origin, reference: Trajectory, times: Array
    ) -> tuple[Trajectory, Poses, bool]:
        """Return the logged motion of known bodies.

        Unknown parts of a pose are those of the reference, so that they do not count as errors.
        """
        times = times[times <= reference.time[-1] * (1.0 + 1e-9)]
        data = data.at(np.arange(len(times)))
        quantities = logged_quantities(data)
        poses = body_poses(self.elements, quantities, points)
        bodies = [body for body in sorted(poses) if body]
        if not bodies:
            needed = (
                "columns position.BODY.x, quaternion.BODY.w, or coordinates of all joints up to the ground"
            )
            raise self.table.error(f"determines the motion of no body; needed: {needed}")
        at_times = interpolated(reference, times)
        position, quaternion = (np.array(each) for each in (at_times.position, at_times.quaternion))
        for body in bodies:
            if (known := poses[body].position) is not None:
                position[:, body] = known
            if (known := poses[body].quaternion) is not None:
                quaternion[:, body] = known
        energies: Any = None
        if (rates := logged_rates(data)) is not None:
            moving = velocities(self.elements, quantities, rates, points)
            energies = energy(scene, data, poses, moving)
        kinetic, potential = (None, None) if energies is None else energies
        # velocities remain those of the reference; `run_error` does not use them
        run = replace(
            at_times,
            engine=self.table.where,
            position=position,
            quaternion=quaternion,
            kinetic_energy=kinetic,
            potential_energy=potential,
        )
        names = [scene.mechanism.body_names[body] for body in bodies]
        return of_bodies(run, names), poses, energies is not None

    def start_error(self, compared: ComparedLog) -> RunError | None:
        """Measure the error that another fit of the start velocities causes; None if they are not fitted.

        Velocities are fitted to the first `RATE_ROWS` rows, or to all if there are fewer; the other fit uses
        one row less.
        """
        if not compared.start.is_fitted:
            return None
        try:
            data = compared.data
            points = compared.points or "frame"
            rows = min(RATE_ROWS, len(data.time)) - 1
            start = log_start(compared.scene, self.elements, data, points, rows)
            other, _ = _reference(replace(compared.scene, initial_state=start.state))
        except NewtonEulerError:
            return None
        return run_error(without_energies(other), without_energies(compared.reference), compared.motion_scale)

    def other_inputs(self, options: LogOptions, compared: ComparedLog) -> OtherInputs | None:
        """Compare with inputs that hold at other times; None without inputs or without such references."""
        if not (compared.data.inputs or compared.data.forces):
            return None
        inputs: Literal["log", "before"] = "log" if options.inputs == "before" else "before"
        try:
            other = self.compared(replace(options, inputs=inputs))
            # inputs of rows 0, 0, 2, 2, ...
            thinned = compared.data.with_inputs_of(np.arange(len(compared.data.time)) // 2 * 2)
            given = with_inputs(self._scene_at(thinned, options), thinned, self.names)
            reference, _ = _reference(
                replace(compared.scene, mechanism=given.mechanism, control=given.control)
            )
        except NewtonEulerError:
            return None
        change = run_error(reference, compared.reference, compared.motion_scale)
        return OtherInputs(f"--log-set inputs={inputs}", other.error, change)

    def _scene_at(self, data: LogData, options: LogOptions) -> Scene:
        """Return the scene with its functions of time, from the first row of a log on.

        The time of the scene is zero at the time `LogOptions.offset` of the log.
        """
        return started_at(self.scene, float(data.time[0]) - (options.offset or 0.0))

    def missing(self, compared: ComparedLog) -> tuple[str, ...]:
        """Name bodies that the log does not determine, with columns that would determine them.

        A body needs all coordinates of one of its joints. The log may determine only its position or only its
        orientation.
        """
        mechanism, found = self.scene.mechanism, list[str]()
        for name in compared.unknown_positions:
            found.append(f"position of {name} (position.{name}.x to z are missing)")
        for name in compared.unknown_orientations:
            found.append(f"orientation of {name} (quaternion.{name}.w to z are missing)")
        for name in set(mechanism.body_names[1:]) - set(compared.run.body_names):
            ways = []  # by joint
            for joint in mechanism.joints:
                if name in (joint.first, joint.second):
                    keys = [(joint.name, k) for k in range(len(joint.coordinate_kinds))]
                    lacking = [key for key in keys if key not in compared.data.coordinates]
                    ways.append(" and ".join(f"coordinate.{self.elements.labels[key]}" for key in lacking))
            columns = " or ".join(way for way in ways if way)
            found.append(f"{name} ({columns or f'pose of {name}'} is missing)")
        return tuple(sorted(found))


def _from_offset(data: LogData, offset: float | None) -> LogData:
    """Return a log without the rows before `offset`, the time of the log at which the scene's time is zero.

    All rows are kept if there is no offset (None), or if fewer than `MIN_ROWS` would be left. A row within
    `TIME_TOLERANCE` of the offset is kept.
    """
    if offset is None:
        return data
    rows = np.flatnonzero(data.time >= offset - TIME_TOLERANCE)
    if len(rows) < MIN_ROWS or len(rows) == len(data.time):
        return data
    return data.at(rows)


def _output_period(times: Array) -> float:
    """Return the output period of a reference, s: the spacing of equally spaced rows, or a shorter period."""
    duration, count = float(times[-1]), len(times) - 1
    spacing = duration / count
    if np.max(np.abs(times - spacing * np.arange(len(times)))) <= EQUAL_SPACING * spacing:
        return spacing
    return duration / min(MAX_ROWS, max(MIN_PERIODS, 4 * count))


def _reference(scene: Scene) -> tuple[Trajectory, str]:
    """Simulate the reference in newton_euler at default tolerances; also return why it stopped, or "".

    A run that stops early counts up to its end if it has `MIN_ROWS` outputs.
    """
    try:
        return simulate(scene, **newton_euler_options(scene)), ""
    except StoppedError as error:
        if error.partial is None or len(error.partial.time) < MIN_ROWS:
            raise
        return error.partial, error.reason
