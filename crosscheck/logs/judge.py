"""Judge the log of another simulator or of a test bench against the reference solution from the log's start.

`judge_log` reads a log, finds the state of its first row, simulates the reference from there with the log's
own inputs, and measures the error of every logged body. A log that is read wrongly has a large error; other
readings are then tried (`crosscheck.logs.mistakes`).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from typing import Any

import numpy as np

from crosscheck.logs.columns import LogData
from crosscheck.logs.inputs import held_inputs
from crosscheck.logs.lacking import Lack, find_lack
from crosscheck.logs.mistakes import Mismatch, Mistake, find_mismatches, find_mistakes
from crosscheck.logs.names import Origin
from crosscheck.logs.options import LogOptions
from crosscheck.logs.poses import loop_errors
from crosscheck.logs.reading import LogReading, OtherInputs, row_stride
from crosscheck.logs.start import LogStart
from crosscheck.logs.table import read_table
from crosscheck.own_run.allowed import ErrorKind, without_loops
from crosscheck.own_run.errors import Band, LoopError, MotionScale, RunError, run_error
from crosscheck.own_run.horizon import comparable_until
from crosscheck.own_run.judge import Judgement
from newton_euler.errors import NewtonEulerError, check_choices, quoted
from newton_euler.model.scene import Scene
from newton_euler.model.source_file import SourceError
from newton_euler.model.state import State
from newton_euler.model.trajectory import Trajectory
from newton_euler.reading.file_names import FileNames
from newton_euler.reading.file_run import Event
from newton_euler.runs.assemble import initial_state
from newton_euler.scalars import Array

Stepper = Callable[[State, Array], Any]
"""Function of a user that simulates: from a start state and times (n,), s, to the states at these times, as a
sequence of `State`, a `Trajectory`, or a table like a log."""

Watch = Callable[[Scene, Trajectory, LogData], Sequence[Event]]
"""Function that finds elements of a file that act in a run of a scene and that the scene does not have. The
scene has the inputs of the log."""

_VELOCITIES = (("linear_velocity", "xyz"), ("angular_velocity", "xyz"))
"""Arrays of velocities of a trajectory, with the names of their components."""


class Log:
    """Run of another simulator or of a test bench, with statements on its columns, for `crosscheck.check`.

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
            statements: attributes of `LogOptions` by name, such as `angle="deg"`.

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
    """Judgement of a log: a `Judgement`, whose `error.relative` and `band` are those of the log, and more.

    Attributes:
        name: name of the run.
        start: start of the reference: the consistent state that is nearest to the first row, and the
            distances (m and rad) between both.
        scene: scene that was simulated, from the start of the log.
        solution: reference solution of all bodies, at its own output times.
        reference_stop: why the reference stopped before the end of the log; "" if it did not.
        missing: bodies that the log does not determine, with the joint coordinates that it lacks there.
        compared: names of the compared bodies.
        rows: number of compared rows.
        stride: 2 if every second row is compared, 3 if every third, and so on.
        unknown_positions: compared bodies of which the log does not determine the position.
        unknown_orientations: compared bodies of which the log does not determine the orientation.
        points: point of the bodies that positions are of, "center" or "frame"; "" without positions.
        has_energy: True if the log determines the energy.
        has_loops: True if the log determines the poses of all bodies of loops, or if there are no loops.
        has_inputs: True if the reference has inputs of the log.
        held_inputs: actuators whose controls the reference holds at their start, because the log does not
            have their inputs.
        other_inputs: comparisons with inputs at other times; None without inputs, and for a log
            that is accurate or has mistakes.
        start_error: error that another fit of the start velocities causes; None if they are not fitted.
        unused: columns that belong to no quantity.
        dropped: number of rows without some of the numbers.
        mistakes: other readings with a much smaller error, and coordinates that contradict the poses.
        lack: elements of the model that the log's simulation seems not to have; None if none explain the
            error, and for a log that is accurate or has mistakes.
    """

    name: str = ""
    start: LogStart | None = None
    scene: Scene | None = None
    solution: Trajectory | None = None
    reference_stop: str = ""
    missing: tuple[str, ...] = ()
    compared: tuple[str, ...] = ()
    unknown_positions: tuple[str, ...] = ()
    unknown_orientations: tuple[str, ...] = ()
    rows: int = 0
    stride: int = 1
    points: Origin = ""
    has_energy: bool = False
    has_loops: bool = False
    has_inputs: bool = False
    held_inputs: tuple[str, ...] = ()
    other_inputs: OtherInputs | None = None
    start_error: RunError | None = None
    unused: tuple[str, ...] = ()
    dropped: int = 0
    mistakes: tuple[Mistake | Mismatch, ...] = ()
    lack: Lack | None = None

    @property
    def why_not_judged(self) -> str:
        """Reason why no row after the first one is compared, for a log that is not judged."""
        if self.rows > 1:
            return super().why_not_judged
        first = next(event for event in self.events if event.time > 0.0)
        action = f"the first action of {first.element}, at {first.time:.3g} s"
        return f"no row before {action}, which the reference does not simulate"

    @property
    def undetermined(self) -> dict[ErrorKind, str]:
        """Errors that the log does not determine, with the reason and what is needed."""
        found = {}
        for kind, part, unknown, columns in (
            (ErrorKind.POSITION, "position", self.unknown_positions, "position.{}.x to z"),
            (ErrorKind.ROTATION, "orientation", self.unknown_orientations, "quaternion.{}.w to z"),
        ):
            if unknown:
                needed = f"needed: {columns.format(unknown[0])}, or the coordinates of its joints"
                found[kind] = f"its columns do not determine the {part} of {', '.join(unknown)}; {needed}"
        if not self.has_energy:
            needed = "needed: velocities of all joints or bodies"
            found[ErrorKind.ENERGY] = f"its columns do not determine the energy; {needed}"
        if not self.has_loops:
            needed = "needed: coordinates of all joints, or poses of all bodies, of loops"
            reason = f"its columns do not determine the violation of loops; {needed}"
            return found | dict.fromkeys((ErrorKind.OPENING, ErrorKind.LOOP_ANGLE), reason)
        return found | without_loops(self.loop_error)

    def summary(self) -> dict[str, Any]:
        """All numbers, for JSON."""
        own: dict[str, Any] = {each.name: getattr(self, each.name) for each in fields(Judgement)}
        result = Judgement(**own).summary()
        if not self.has_energy:
            result["error"]["energy"] = None
        if not self.has_loops:
            result["loop_error"] = None
        for part, unknown in (("position", self.unknown_positions), ("rotation", self.unknown_orientations)):
            if set(unknown) == set(self.compared):
                for name in (part, f"{part}_at", f"relative_{part}", f"largest_{part}"):
                    result["error"][name] = None
        if (start := self.start) is not None:
            result["start"] = {
                "moved": start.moved,
                "turned": start.turned,
                "moved_at": start.moved_at,
                "differences": list(start.differences),
                "is_fitted": start.is_fitted,
            }
        other = self.other_inputs
        result["other_inputs"] = other and {
            "option": other.option,
            "error": asdict(other.error),
            "thinned": asdict(other.thinned),
        }
        result["start_error"] = asdict(self.start_error) if self.start_error else None
        result["lack"] = self.lack and asdict(self.lack)
        result["mistakes"] = [asdict(mistake) | {"text": mistake.text} for mistake in self.mistakes]
        names = (
            "name",
            "reference_stop",
            "compared",
            "missing",
            "unknown_positions",
            "unknown_orientations",
            "rows",
            "stride",
            "points",
            "has_inputs",
            "held_inputs",
            "unused",
            "dropped",
        )
        return result | {name: getattr(self, name) for name in names}


def judge_log(
    scene: Scene,
    names: FileNames | None,
    name: str,
    log: Log | Stepper | Any,
    watch: Watch = lambda scene, run, data: (),
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
    reading = LogReading(scene, names, read_table(log.table, name))
    return _judged(reading, name, log.options, watch)


def _judged(reading: LogReading, name: str, options: LogOptions, watch: Watch) -> LogJudgement:
    """Judge a log as its options state, and search other readings if the error is large."""
    data = reading.data(options)
    try:
        compared = reading.compared(options)
    except NewtonEulerError as failure:
        mistakes = find_mistakes(reading, options, data, None)
        if not mistakes:
            raise
        raise reading.table.error("; ".join(mistake.text for mistake in mistakes)) from failure
    mistakes = find_mistakes(reading, options, data, compared)
    # the comparison ends when an element acts that the reference does not have, and of a mechanism in chaos
    events = tuple(
        sorted(watch(compared.scene, compared.reference, compared.data), key=lambda event: event.time)
    )
    horizons = comparable_until(compared.scene, compared.reference)
    until = min((event.time for event in events if event.time > 0.0), default=None)
    error, run, rows, scale = compared.error, compared.run, len(compared.run.time), compared.motion_scale
    if until is not None or any(horizons):
        rows = rows if until is None else max(1, int(np.searchsorted(run.time, until)))
        run = run.first(rows)
        # errors are parts of the motion up to the end of the comparison
        count = max(2, int(np.searchsorted(compared.reference.time, run.time[-1], side="right")))
        scale = MotionScale.of(compared.reference.first(count), compared.scene.mechanism, horizons)
        error = run_error(run, compared.reference_at(run.time), scale)
    # the reference stops before the log and before all reasons to end the comparison
    is_unjudged = bool(compared.reference_stop) and until is None and not all(horizons)
    other_inputs, lack = None, None
    if error.band in (Band.OFF, Band.WRONG) and not mistakes:
        other_inputs = reading.other_inputs(options, compared)
        lack = find_lack(reading, options, error, rows, scale)
    loops = loop_errors(reading.scene.mechanism, compared.poses)
    return LogJudgement(
        engine=reading.table.where,
        settings="",
        error=error,
        loop_error=LoopError() if loops is None else LoopError.of(loops, run.time),
        stopped=data.divergence,
        events=events,
        until=until,
        causes=(),
        remedies=(),
        run=run,
        reference=compared.reference_at(run.time),
        scale=scale,
        name=name,
        start=compared.start,
        scene=compared.scene,
        solution=compared.reference,
        reference_stop=compared.reference_stop,
        unjudged_from=float(compared.reference.time[-1]) if is_unjudged else None,
        missing=reading.missing(compared),
        compared=run.body_names,
        unknown_positions=compared.unknown_positions,
        unknown_orientations=compared.unknown_orientations,
        rows=rows,
        stride=row_stride(compared.data),
        points=compared.points,
        has_energy=compared.has_energy,
        has_loops=loops is not None,
        has_inputs=bool(data.inputs or data.forces),
        held_inputs=held_inputs(data, reading.names),
        other_inputs=other_inputs,
        start_error=reading.start_error(compared),
        unused=data.unused,
        dropped=data.dropped,
        mistakes=(*mistakes, *find_mismatches(reading, options, compared)),
        lack=lack,
    )


def _simulated(scene: Scene, name: str, step: Stepper) -> Log:
    """Run a function of the user from the scene's start, and return its states as a log."""
    found = step(initial_state(scene), scene.times)
    if isinstance(found, Sequence) and found and all(isinstance(state, State) for state in found):
        if len(found) != len(scene.times):
            raise SourceError(name, f"returns {len(found)} states; needed: {len(scene.times)}, one per time")
        names = ("position", "quaternion", "linear_velocity", "angular_velocity")
        arrays: dict[str, Any] = {each: np.array([getattr(state, each) for state in found]) for each in names}
        mechanism = scene.mechanism
        found = Trajectory(
            engine=name,
            settings={},
            wall_time=0.0,
            time=scene.times,
            body_names=mechanism.body_names,
            joint_names=mechanism.joint_names,
            **arrays,
        )
    if isinstance(found, Trajectory):
        columns: dict[str, Array] = {"time": found.time}
        for kind, letters in (("position", "xyz"), ("quaternion", "wxyz"), *_VELOCITIES):
            if (array := getattr(found, kind)) is not None:
                for k, body in enumerate(found.body_names[1:], start=1):
                    columns |= {f"{kind}.{body}.{c}": array[:, k, i] for i, c in enumerate(letters)}
        found = columns
    return found if isinstance(found, Log) else Log(found)
