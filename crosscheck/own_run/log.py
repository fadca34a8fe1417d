"""Judge the log of another simulator or of a test bench against the reference solution from the log's start.

`judge_log` reads a log, finds the state of its first row, simulates the reference from there with the log's
own inputs, and measures the error of every logged body. A log that is read wrongly has a large error.
Other readings are then tried: order of quaternions, units, points of bodies, times. A reading that reduces
the error by a large factor is reported with the option that selects it.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np

from crosscheck.engines.engine import native_method
from crosscheck.own_run.errors import USABLE_BELOW, MotionScale, RunError, run_error
from crosscheck.own_run.horizon import comparable_until
from crosscheck.own_run.interpolation import at_outputs, interpolated, of_bodies, without_energies
from crosscheck.own_run.judge import Judgement
from crosscheck.own_run.log_columns import (
    Elements,
    LogData,
    LogOptions,
    Measured,
    Origin,
    read_columns,
)
from crosscheck.own_run.log_inputs import is_time_dependent, started_at, with_inputs
from crosscheck.own_run.log_mistake import Mistake, mistake_line
from crosscheck.own_run.log_motion import (
    LogStart,
    Poses,
    all_rows,
    body_poses,
    energy,
    first_rows,
    log_start,
    logged_rates,
    opening,
    velocities,
)
from crosscheck.own_run.log_table import LogTable, read_table
from newton_euler.errors import NewtonEulerError, check_choices, quoted
from newton_euler.model.scene import Scene
from newton_euler.model.source_file import SourceError
from newton_euler.model.state import State
from newton_euler.model.trajectory import StoppedError, Trajectory
from newton_euler.reading.file_names import FileNames
from newton_euler.reading.file_run import Event
from newton_euler.runs.assemble import initial_state
from newton_euler.runs.simulate import simulate
from newton_euler.scalars import Array

MAX_ROWS = 4000
"""Largest number of compared rows; of a longer log every second, third, ... row is compared."""

MIN_PERIODS = 500
"""Smallest number of outputs of the reference if the rows of a log are not equally spaced. The reference is
interpolated between outputs by cubic polynomials."""

EQUAL_SPACING = 1e-6
"""Largest deviation of a row from equal spacing, relative to the spacing, that is round-off of the file."""

MISTAKE_FACTOR = 10.0
"""Factor by which another reading of a log must reduce the error to be reported. Right readings of logs with
a wrong order, unit or time reduce the error a hundred times and more."""

MAX_SEARCH_S = 20.0
"""Processor time, s, after which no further reading of a log is tried."""

MAX_MISTAKES = 3
"""Largest number of wrong readings of one log that are searched."""

DELAYS = 81
"""Number of delays that are tried at once in the search for an offset of times."""

DELAY_ROUNDS = 4
"""Number of times that the search for a delay is repeated around the best one."""

MAX_DELAY = 0.25
"""Largest delay that is searched, as a fraction of the duration of the log."""

WHOLE_ROWS = 0.1
"""Distance of a delay from a whole number of rows, in rows, below which the delay is that number of rows."""

Stepper = Callable[[State, Array], Any]
"""Function of a user that simulates: from a start state and times (n,), s, to the states at these times, as a
sequence of `State`, a `Trajectory`, or a table like a log."""


Watch = Callable[[Scene, Trajectory], Sequence[Event]]
"""Function that finds elements of a file that act in a run of a scene and that the scene does not have."""


class Log:
    """Run of another simulator or of a test bench, with statements on its columns, for `crosscheck.check`.

    Attributes:
        table: path of a CSV or Parquet file, DataFrame, or mapping from names to columns.
        options: statements on the columns.

    Examples:
        >>> run = simulate(load("pendulum"))
        >>> angle = np.degrees(run.joint("pivot").coordinates[:, 0])
        >>> log = Log({"time": run.time, "pivot": angle}, angle="deg")
        >>> check("pendulum", ["newton_euler"], runs={"isaac": log}).logs["isaac"].error.relative < 1e-6
        True
    """

    def __init__(self, table: Any, options: LogOptions | None = None, **statements: Any) -> None:
        """Take a log and statements on its columns.

        Args:
            table: path of a CSV or Parquet file, DataFrame, or mapping from names to columns.
            options: statements on the columns; None for none.
            statements: `LogOptions` by name. `quaternion` is "wxyz" or "xyzw", the order of columns. `angle`,
                `length` and `time` are units that the names of columns do not have, such as "deg".
                `offset` is the time of the log, s, at which the scene starts. `position` is "center" or
                "frame"; `zero` may be "start", `inputs` "scene". `columns` maps columns to quantities.

        Raises:
            UnknownNameError, OptionError: for an unknown statement or value.
        """
        check_choices("option of a log", statements, [each.name for each in fields(LogOptions)])
        self.table = table
        self.options = replace(options or LogOptions(), **statements)

    def __repr__(self) -> str:
        return f"<Log {quoted(self.table)}>" if isinstance(self.table, str | os.PathLike) else "<Log>"


@dataclass(frozen=True, eq=False)
class LogJudgement(Judgement):
    """Judgement of a log.

    Attributes:
        name: name of the run.
        start: start of the reference, next to the first row.
        scene: scene that was simulated, from the start of the log.
        solution: reference solution of all bodies, at its own output times.
        missing: bodies that the log does not determine, with the joint coordinates that it lacks there.
        compared: names of the compared bodies.
        rows: number of compared rows.
        points: point of the bodies that positions are of, "center" or "frame"; "" without positions.
        has_energy: True if the log determines the energy.
        has_inputs: True if the reference has inputs of the log.
        start_error: error that another estimate of the start velocities causes; None if the log has
            velocities.
        unused: columns that belong to no quantity.
        dropped: number of rows without some of the numbers.
        mistakes: other readings with a much smaller error.
    """

    name: str = ""
    start: LogStart | None = None
    scene: Scene | None = None
    solution: Trajectory | None = None
    missing: tuple[str, ...] = ()
    compared: tuple[str, ...] = ()
    rows: int = 0
    points: Origin = ""
    has_energy: bool = False
    has_inputs: bool = False
    start_error: RunError | None = None
    unused: tuple[str, ...] = ()
    dropped: int = 0
    mistakes: tuple[Mistake, ...] = ()

    def summary(self) -> dict[str, Any]:
        """All numbers, for JSON."""
        own: dict[str, Any] = {each.name: getattr(self, each.name) for each in fields(Judgement)}
        result = Judgement(**own).summary()
        if not self.has_energy:
            result["error"]["energy"] = None
        if (start := self.start) is not None:
            result["start"] = {
                "moved": start.moved,
                "turned": start.turned,
                "moved_at": start.moved_at,
                "differences": list(start.differences),
            }
        result["start_error"] = asdict(self.start_error) if self.start_error else None
        result["mistakes"] = [asdict(mistake) | {"text": mistake_line(mistake)} for mistake in self.mistakes]
        names = ("name", "compared", "missing", "rows", "points", "has_inputs", "unused", "dropped")
        return result | {name: getattr(self, name) for name in names}


def judge_log(
    scene: Scene,
    names: FileNames | None,
    name: str,
    log: Log | Stepper | Any,
    watch: Watch = lambda scene, run: (),
) -> LogJudgement:
    """Judge a log.

    Args:
        scene: the scene, whose start the log replaces.
        names: names in the model file of the scene; None for other scenes.
        name: name of the run, for messages and reports.
        log: the log, a table like `Log.table`, or a function that simulates.
        watch: finds elements of the file that act in a run and that the scene does not have. The comparison
            ends when the first of them acts.

    Raises:
        SourceError: for a log that cannot be read, with the column and the remedy.
        NewtonEulerError: if the scene has no reference solution from the start of the log.
    """
    if callable(log) and not isinstance(log, Log):
        log = _simulated(scene, name, log)
    if not isinstance(log, Log):
        log = Log(log)
    table = read_table(log.table, name)
    reading = _Reading(scene, names, table)
    return reading.judged(name, log.options, watch)


def _simulated(scene: Scene, name: str, step: Stepper) -> Log:
    """Run a function of the user from the scene's start, and return its states as a log."""
    found = step(initial_state(scene), scene.times)
    if isinstance(found, Sequence) and found and all(isinstance(state, State) for state in found):
        if len(found) != len(scene.times):
            raise SourceError(name, f"returns {len(found)} states; needed: {len(scene.times)}, one per time")
        names = ("position", "quaternion", "linear_velocity", "angular_velocity")
        arrays: dict[str, Any] = {each: np.array([getattr(state, each) for state in found]) for each in names}
        mechanism = scene.mechanism
        found = Trajectory(name, {}, 0.0, scene.times, mechanism.body_names, mechanism.joint_names, **arrays)
    if isinstance(found, Trajectory):
        columns: dict[str, Array] = {"time": found.time}
        for kind, letters in (("position", "xyz"), ("quaternion", "wxyz"), *_VELOCITIES):
            if (array := getattr(found, kind)) is not None:
                for k, body in enumerate(found.body_names[1:], start=1):
                    columns |= {f"{kind}.{body}.{c}": array[:, k, i] for i, c in enumerate(letters)}
        found = columns
    return found if isinstance(found, Log) else Log(found)


_VELOCITIES = (("linear_velocity", "xyz"), ("angular_velocity", "xyz"))
"""Arrays of velocities of a trajectory, with the names of their components."""


@dataclass(frozen=True, eq=False)
class _Compared:
    """A log beside the reference solution from its start.

    Attributes:
        data: numbers of the log.
        start: start of the reference.
        scene: scene of the reference.
        reference: reference solution, at its own output times.
        scale: extent of the reference's motion.
        run: logged motion of the known bodies at the compared times.
        points: point of positions.
        poses: poses of all known bodies.
        has_energy: True if the log determines the energy.
        error: error of the log.
    """

    data: LogData
    start: LogStart
    scene: Scene
    reference: Trajectory
    scale: MotionScale
    run: Trajectory
    points: Origin
    poses: Poses
    has_energy: bool
    error: RunError

    def reference_at(self, times: Array) -> Trajectory:
        """Return the reference at some times, s since the start, for the bodies of the log."""
        found = of_bodies(interpolated(self.reference, times), self.run.body_names)
        return found if self.has_energy else without_energies(found)


class _Reading:
    """A log that is read in different ways."""

    def __init__(self, scene: Scene, names: FileNames | None, table: LogTable) -> None:
        """Take a scene, the names of its model file, and a log."""
        self._scene, self._names, self._table = scene, names, table
        self._elements = Elements(scene.mechanism, names)

    def judged(self, name: str, options: LogOptions, watch: Watch) -> LogJudgement:
        """Judge the log as the options state, and search other readings if the error is large."""
        data = read_columns(self._table, self._elements, options)
        try:
            compared = self.compared(options)
        except NewtonEulerError as failure:
            mistakes = self._mistakes(options, data, None)
            if not mistakes:
                raise
            raise self._table.error("; ".join(map(mistake_line, mistakes))) from failure
        mistakes = self._mistakes(options, data, compared)
        # the comparison ends when an element acts that the reference does not have, and in chaos
        events = tuple(sorted(watch(compared.scene, compared.reference), key=lambda event: event.time))
        until = comparable_until(compared.scene, compared.reference)
        ends = [event.time for event in events if event.time > 0.0] + ([] if until is None else [until])
        error, run, rows = compared.error, compared.run, len(compared.run.time)
        if ends:
            rows = max(2, int(np.searchsorted(run.time, min(ends))))
            run = run.first(rows)
            error = run_error(run, compared.reference_at(run.time), compared.scale)
        return LogJudgement(
            engine=self._table.where,
            settings="",
            error=error,
            opening=opening(self._scene.mechanism, compared.poses),
            stopped="",
            events=events,
            until=until,
            causes=(),
            remedies=(),
            run=run,
            reference=compared.reference_at(run.time),
            name=name,
            start=compared.start,
            scene=compared.scene,
            solution=compared.reference,
            missing=self._missing(compared),
            compared=run.body_names,
            rows=rows,
            points=compared.points,
            has_energy=compared.has_energy,
            has_inputs=bool(data.inputs or data.forces),
            start_error=self._start_error(compared),
            unused=data.unused,
            dropped=data.dropped,
            mistakes=mistakes,
        )

    def compared(self, options: LogOptions) -> _Compared:
        """Simulate the reference from the start of the log, and compare.

        Raises:
            SourceError: for a log that cannot be read so, or whose first row fits no state.
            NewtonEulerError: if the reference stops.
        """
        data = _from_offset(read_columns(self._table, self._elements, options), options.offset)
        points = options.position or self._point(data)
        scene = started_at(self._scene, float(data.time[0]) - options.offset)
        scene = with_inputs(scene, data, self._names)
        start = log_start(scene, self._elements, data, points)
        # rows to compare, and outputs of the reference at these or at closer times
        stride = -(-len(data.time) // MAX_ROWS)
        rows = _at_rows(data, np.arange(0, len(data.time), stride))
        times = rows.time - rows.time[0]
        scene = replace(
            scene,
            initial_state=start.state,
            duration=float(times[-1]),
            output_period=_output_period(times),
            outputs=frozenset({"velocities", "energy"}),
        )
        reference = _reference(scene)
        scale = MotionScale.of(reference, scene.mechanism.size)
        run, poses, has_energy = self._run(scene, rows, points, reference, times)
        expected = of_bodies(interpolated(reference, run.time), run.body_names)
        error = run_error(run, expected if has_energy else without_energies(expected), scale)
        return _Compared(
            data, start, scene, reference, scale, run, points if data.frames else "", poses, has_energy, error
        )

    def _point(self, data: LogData) -> Origin:
        """Choose the point of positions for which the joints of the first row fit better."""
        if not any(np.any(self._elements.frames[name].point) for name in data.frames):
            return "center"
        sample = first_rows(all_rows(data))
        gaps = dict[Origin, float]()
        points: tuple[Origin, ...] = ("frame", "center")
        for point in points:
            poses = body_poses(self._elements, sample, point)
            gaps[point] = opening(self._scene.mechanism, poses)
        return "center" if gaps["center"] < 0.5 * gaps["frame"] else "frame"

    def _run(
        self, scene: Scene, data: LogData, points: Origin, reference: Trajectory, times: Array
    ) -> tuple[Trajectory, Poses, bool]:
        """Return the logged motion of known bodies; unknown parts of a pose are those of the reference."""
        times = times[times <= reference.time[-1] * (1.0 + 1e-9)]
        sample = all_rows(_at_rows(data, np.arange(len(times))))
        poses = body_poses(self._elements, sample, points)
        bodies = [body for body in sorted(poses) if body]
        if not bodies:
            needed = (
                "columns position.BODY.x, quaternion.BODY.w, or coordinates of all joints up to the ground"
            )
            raise self._table.error(f"determines the motion of no body; needed: {needed}")
        at_times = interpolated(reference, times)
        position, quaternion = (np.array(each) for each in (at_times.position, at_times.quaternion))
        for body in bodies:
            if (known := poses[body].position) is not None:
                position[:, body] = known
            if (known := poses[body].quaternion) is not None:
                quaternion[:, body] = known
        energies: Any = None
        if (rates := logged_rates(_at_rows(data, np.arange(len(times))))) is not None:
            moving = velocities(self._elements, sample, rates, points)
            energies = energy(scene, _at_rows(data, np.arange(len(times))), poses, moving)
        kinetic, potential = (None, None) if energies is None else energies
        run = replace(
            at_times,
            engine=self._table.where,
            position=position,
            quaternion=quaternion,
            kinetic_energy=kinetic,
            potential_energy=potential,
        )
        names = [scene.mechanism.body_names[body] for body in bodies]
        return of_bodies(run, names), poses, energies is not None

    def _start_error(self, compared: _Compared) -> RunError | None:
        """Measure the error that another estimate of the start velocities causes; None if they are logged."""
        if not compared.start.differences:
            return None
        try:
            data = compared.data
            start = log_start(compared.scene, self._elements, data, compared.points or "frame", rows=4)
            other = _reference(replace(compared.scene, initial_state=start.state))
        except NewtonEulerError:
            return None
        return run_error(without_energies(other), without_energies(compared.reference), compared.scale)

    def _missing(self, compared: _Compared) -> tuple[str, ...]:
        """Name bodies that the log does not determine, with the coordinates that it lacks of their joints."""
        mechanism, found = self._scene.mechanism, list[str]()
        for name in set(mechanism.body_names[1:]) - set(compared.run.body_names):
            keys = [
                (joint.name, k)
                for joint in mechanism.joints
                if name in (joint.first, joint.second)
                for k in range(len(joint.coordinate_kinds))
            ]
            labels = [
                mechanism.coordinate_labels[key] for key in keys if key not in compared.data.coordinates
            ]
            columns = " or ".join(f"coordinate.{label}" for label in labels)
            found.append(f"{name} ({columns or f'pose of {name}'} is missing)")
        return tuple(sorted(found))

    # Other readings

    def _mistakes(
        self, options: LogOptions, data: LogData, compared: _Compared | None
    ) -> tuple[Mistake, ...]:
        """Search readings that reduce the error by `MISTAKE_FACTOR`, one after the other.

        Args:
            options: the present reading.
            data: the log in this reading.
            compared: comparison in this reading; None if the log fits no state.
        """
        found: list[Mistake] = []
        end = time.process_time() + MAX_SEARCH_S
        while len(found) < MAX_MISTAKES and (compared is None or compared.error.relative > USABLE_BELOW):
            before = None if compared is None else compared.error
            best: tuple[_Compared, LogOptions, tuple[str, ...], str, str] | None = None
            for other, columns, what, option in self._other_readings(options, data):
                if time.process_time() > end:
                    break
                try:
                    tried = self.compared(other)
                except NewtonEulerError:
                    continue
                if best is None or tried.error.relative < best[0].error.relative:
                    best = tried, other, columns, what, option
            accepted = best is not None and (
                before is None or best[0].error.relative * MISTAKE_FACTOR < before.relative
            )
            if best is None or not accepted:
                break
            compared, options, columns, what, option = best
            data = read_columns(self._table, self._elements, options)
            found.append(Mistake(columns, what, option, before, compared.error))
        if compared is not None and compared.error.relative > USABLE_BELOW:
            found.extend(self._delay(compared))
        return tuple(found)

    def _other_readings(
        self, options: LogOptions, data: LogData
    ) -> Iterator[tuple[LogOptions, tuple[str, ...], str, str]]:
        """Yield other options, the columns that they concern, the other reading in words, and the option."""
        quaternions = [frame.quaternion for frame in data.frames.values() if frame.quaternion is not None]
        if quaternions:
            columns = tuple(name for each in quaternions for name in each.columns)
            for order in ("xyzw", "wxyz"):
                other = replace(options, quaternion=order)
                if order != options.quaternion:
                    what = f"order {', '.join(order)} of the columns"
                    yield other, columns, what, f"--log-set quaternion={order}"
        angles = data.without_unit.get("angle", [])
        if angles:
            unit = "deg" if options.angle == "rad" else "rad"
            other = replace(options, angle=unit)  # type: ignore[arg-type]
            yield other, tuple(angles), f"unit {unit}", f"--log-set angle={unit}"
        for unit in ("mm", "cm", "m"):
            if (lengths := data.without_unit.get("length", [])) and unit != options.length:
                other = replace(options, length=unit)  # type: ignore[arg-type]
                yield other, tuple(lengths), f"unit {unit}", f"--log-set length={unit}"
        if len(angles) > 1 and options.angle == "rad":
            labels = {name: text for name, text in self._coordinate_columns(data) if name in angles}
            for name, text in labels.items():
                mapped = {**options.columns, name: f"{text} [deg]"}
                other = replace(options, columns=mapped)
                yield other, (name,), "unit deg", f"--log-map '{name}={text} [deg]'"
        positions = [frame.position for frame in data.frames.values() if frame.position is not None]
        if positions:
            columns = tuple(name for each in positions for name in each.columns)
            for point, words in (("center", "centers of mass"), ("frame", "origins of body frames")):
                if point != options.position:
                    other = replace(options, position=point)  # type: ignore[arg-type]
                    yield other, columns, f"{words}", f"--log-set position={point}"
        if data.coordinates and self._names is not None and options.zero == "file":
            columns = tuple(name for each in data.coordinates.values() for name in each.columns)
            other = replace(options, zero="start")
            yield other, columns, "coordinates from the start of the file", "--log-set zero=start"
        if options.time == "s":
            for unit in ("ms", "us", "ns"):
                other = replace(options, time=unit)  # type: ignore[arg-type]
                yield other, ("time",), f"unit {unit}", f"--log-set time={unit}"
        first = float(data.time[0])
        if options.offset == 0.0 and first != 0.0 and is_time_dependent(self._scene):
            other = replace(options, offset=first)
            yield other, ("time",), f"time {first:.6g} s as time zero", f"--log-set offset={first:.9g}"

    def _coordinate_columns(self, data: LogData) -> Iterator[tuple[str, str]]:
        """Yield the column of each joint coordinate, and the quantity as `LogOptions.columns` names it."""
        for key, measured in data.coordinates.items():
            for name, (own, _) in self._elements.coordinates.items():
                if own == key:
                    yield measured.columns[0], f"coordinate.{name}"

    def _delay(self, compared: _Compared) -> Iterator[Mistake]:
        """Yield the delay of the log behind the reference, if one reduces the error by `MISTAKE_FACTOR`."""
        run, duration = compared.run, float(compared.run.time[-1])
        best, reach = 0.0, MAX_DELAY * duration
        error = compared.error
        for _ in range(DELAY_ROUNDS):
            for delay in best + np.linspace(-reach, reach, DELAYS):
                times = run.time - delay
                inside = (times >= 0.0) & (times <= compared.reference.time[-1])
                inside[0] = False  # the reference starts there, whatever its time is
                if np.sum(inside) < 3:
                    continue
                part = at_outputs(run, np.flatnonzero(inside))
                found = run_error(
                    without_energies(part),
                    without_energies(compared.reference_at(times[inside])),
                    compared.scale,
                )
                if found.relative < error.relative:
                    error, best = found, float(delay)
            reach *= 4.0 / DELAYS
        spacing = float(np.median(np.diff(run.time)))
        if abs(best - spacing * round(best / spacing)) < WHOLE_ROWS * spacing:
            best = spacing * round(best / spacing)
        if error.relative * MISTAKE_FACTOR < compared.error.relative:
            if best > 0.0:
                offset = float(compared.data.time[0]) + best
                option = f"--log-set offset={offset:.6g}"
                yield Mistake(("time",), f"times {best:.4g} s earlier", option, compared.error, error)
            else:
                what = f"times {-best:.4g} s later, or without the first row"
                yield Mistake(("time",), what, "", compared.error, error)


def _from_offset(data: LogData, offset: float) -> LogData:
    """Return a log without the rows before the time zero of the scene, if it has three rows after that."""
    rows = np.flatnonzero(data.time >= offset)
    if not offset or len(rows) < 3 or len(rows) == len(data.time):
        return data
    return _at_rows(data, rows)


def _at_rows(data: LogData, rows: Array) -> LogData:
    """Return chosen rows of a log."""

    def chosen(given: Mapping[Any, Measured]) -> dict[Any, Measured]:
        """Return chosen rows of all quantities."""
        return {key: each.at(rows) for key, each in given.items()}

    frames = {}
    for name, frame in data.frames.items():
        parts: dict[str, Any] = {
            each.name: value.at(rows) if isinstance(value, Measured) else value
            for each in fields(frame)
            for value in (getattr(frame, each.name),)
        }
        frames[name] = replace(frame, **parts)
    return replace(
        data,
        time=data.time[rows],
        coordinates=chosen(data.coordinates),
        rates=chosen(data.rates),
        frames=frames,
        inputs=chosen(data.inputs),
        forces=chosen(data.forces),
    )


def _output_period(times: Array) -> float:
    """Return the output period of a reference, s: the spacing of equally spaced rows, or a shorter period."""
    duration, count = float(times[-1]), len(times) - 1
    spacing = duration / count
    if np.max(np.abs(times - spacing * np.arange(len(times)))) <= EQUAL_SPACING * spacing:
        return spacing
    return duration / min(MAX_ROWS, max(MIN_PERIODS, 4 * count))


def _reference(scene: Scene) -> Trajectory:
    """Simulate the reference; a run that stops early counts as far as it came."""
    try:
        return simulate(scene, **native_method(scene, refined=False))
    except StoppedError as error:
        if error.partial is None or len(error.partial.time) < 3:
            raise
        return error.partial
