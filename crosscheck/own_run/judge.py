"""Judge the run of a model file: its error, the setting that causes it, and settings that reduce it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, is_dataclass
from typing import Any

import numpy as np

from crosscheck.own_run.comparison import MIN_OUTPUTS, Comparison, merged
from crosscheck.own_run.errors import (
    Band,
    LoopError,
    MotionScale,
    RunError,
    early_chaos_text,
    errors_over_time,
)
from crosscheck.own_run.remedies import MeasuredRemedy, find_remedies
from crosscheck.own_run.stability import ModeAtFault, ModelChange, Stability, model_changes
from crosscheck.support.errors import CrosscheckError
from newton_euler.model.trajectory import Trajectory
from newton_euler.reading.file_run import OF_UNSTABLE_MODES, CauseName, Event, FileRun, FileSimulation

STATES = 8
"""Number of states of the run at which the fastest mode is sought."""


CANCELLATION = 1.25
"""Smallest ratio of the error by one cause and the error of the run at which errors count as cancelling."""


MIN_EXPLAINED = 0.5
"""Smallest sum of the errors by all causes, as a fraction of the run's error, that explains this error."""


@dataclass(frozen=True)
class MeasuredCause:
    """One property of the settings and the error that it causes alone.

    Attributes:
        name: the property.
        error: difference of a run from a run without the error of the property.
        brings_back: whether the run completes without the property; False if the judged run does.
        is_choice: whether the other run has another choice, such as another integrator, with an error of its
            own; False if it is more exact.
    """

    name: CauseName
    error: RunError
    brings_back: bool = False
    is_choice: bool = False


@dataclass(frozen=True)
class MeasuredError:
    """Errors of a file's run up to the end of a comparison.

    Attributes:
        error: error of the run.
        loop_error: largest violations of the loop constraints.
        scale: extent of the motion, by which errors are divided.
    """

    error: RunError
    loop_error: LoopError
    scale: MotionScale


@dataclass(frozen=True, eq=False)
class Judgement:
    """Judgement of a file's run.

    Attributes:
        engine: name and version of the file's engine.
        settings: settings of the file in words.
        error: error of the judged run, up to the time at which it ended.
        loop_error: largest violations of the loop constraints up to then.
        stopped: reason why the run ended early; "" for a complete run.
        events: elements of the file that act and that the reference does not have, in the order of time. If
            there are any, the judged run is without them.
        until: time, s, at which the comparison ends because the first of `events` acts; None if it ends with
            the run. It ends with the event if the error until then is a larger part of the motion until then
            than the error of the whole run, or if only the run without `events` stops early.
        approximated: dry friction and limits of the file that the reference has as forces. The difference of
            both models is a part of the error.
        other: the errors of the whole run if the comparison ends with an event, or else the errors until the
            first event; None if no event is after the start.
        causes: error by property of the settings, largest first; empty for an accurate run.
        harmless: tested properties without which no run is closer to the reference.
        remedies: settings with a smaller error, cheapest first; empty for an accurate run.
        stability: stability limit of the time step, and the mode of the linearized model that sets the limit.
            Only if the run diverged, or the time step or the integrator is the largest cause of its error.
        changes: changes of the model with which the time step is stable; empty if it is stable.
        run: the judged run.
        reference: the reference solution at the same times.
        are_assumed: True if the settings are usual ones, since the file has none and the user gives none.
        stopped_as_it_stands: reason why the run with contacts, limits and friction ended early, although the
            judged run without them completes; "" otherwise.
        stopped_reduced: reason why the run without contacts, limits and friction ended early, although the
            run with them completes; "" otherwise.
        scale: extent of the reference's motion, by which errors are divided. A mechanism that is chaotic is
            compared until its `MechanismMotion.until`.
        unjudged_from: time, s, from which the run is not judged because it has too many time steps; None if
            the whole motion is judged.
        extended_to: time, s, until which the run is judged although the scene ends before, as its duration
            is too few time steps; None if the run ends with the scene.
        run_inputs: start, controls, changed numbers and output times of the judged run. With these,
            the engine alone can repeat the run, see `FileSimulation.run_inputs`.
    """

    engine: str
    settings: str
    error: RunError
    loop_error: LoopError
    stopped: str
    events: tuple[Event, ...]
    until: float | None
    causes: tuple[MeasuredCause, ...]
    remedies: tuple[MeasuredRemedy, ...]
    run: Trajectory
    reference: Trajectory
    scale: MotionScale
    stability: Stability | None = None
    changes: tuple[ModelChange, ...] = ()
    stopped_as_it_stands: str = ""
    stopped_reduced: str = ""
    run_inputs: Mapping[str, Any] = field(default_factory=dict)
    are_assumed: bool = False
    harmless: tuple[str, ...] = ()
    unjudged_from: float | None = None
    extended_to: float | None = None
    approximated: tuple[str, ...] = ()
    other: MeasuredError | None = None

    @property
    def measured(self) -> tuple[MeasuredError, ...]:
        """Errors of the judged comparison, and those of the other comparison if there is one."""
        judged = MeasuredError(self.error, self.loop_error, self.scale)
        return (judged,) if self.other is None else (judged, self.other)

    @property
    def errors_cancel(self) -> bool:
        """True if an exact cause alone has a clearly larger error than the run has."""
        by_position = self.error.stated_by_position
        exact = [cause.error.relative_by(by_position) for cause in self.causes if not cause.is_choice]
        largest = max(exact, default=0.0)
        return not self.stopped and largest > CANCELLATION * self.error.relative_by(by_position)

    @property
    def is_explained(self) -> bool:
        """False if all causes together have a clearly smaller error than the run has."""
        by_position = self.error.stated_by_position
        total = sum(cause.error.relative_by(by_position) for cause in self.causes)
        return bool(self.stopped) or total >= MIN_EXPLAINED * self.error.relative_by(by_position)

    @property
    def is_judged(self) -> bool:
        """False if no output of a complete run after the start is compared, see `Band.NOT_JUDGED`."""
        return self.band is not Band.NOT_JUDGED

    @property
    def why_not_judged(self) -> str:
        """Reason why no output after the start is compared, for a run that is not judged."""
        return early_chaos_text(self.scale)

    @property
    def band(self) -> Band:
        """Accuracy of the run; a run that diverged, if only with what the reference lacks, is wrong."""
        return Band.WRONG if self.stopped or self.stopped_as_it_stands else self.error.band

    def summary(self) -> dict[str, Any]:
        """All numbers, for JSON."""
        left_out = ("run", "reference")
        fields = {name: value for name, value in vars(self).items() if name not in left_out}
        position, rotation = errors_over_time(self.run, self.reference)
        found: dict[str, Any] = {
            "band": self.band.value,
            "relative": self.error.relative,
            "error_over_time": {
                "time": self.run.time[: len(position)].tolist(),
                "position": np.max(position, axis=1).tolist(),
                "rotation": np.max(rotation, axis=1).tolist(),
            },
        }
        return found | {name: _plain(value) for name, value in fields.items()}


def _plain(value: Any) -> Any:
    """Return a value for JSON: dataclasses as mappings, tuples as lists."""
    if isinstance(value, tuple):
        return [_plain(each) for each in value]
    return asdict(value) if is_dataclass(value) and not isinstance(value, type) else value


def judge(simulation: FileSimulation[Any], acting: Sequence[Event] = ()) -> Judgement:
    """Judge the run of a file with its own settings.

    Args:
        simulation: the file in its own engine.
        acting: elements of the file that act in the reference's motion and are not simulated there.

    Raises:
        NewtonEulerError: if the scene has no reference solution.
    """
    whole = Comparison.of(simulation)
    # the run as it stands; if something acts that the reference does not have, the run without such elements
    as_it_stands = run = whole.run(simulation.settings, reduced=False)
    events = merged(run.events, acting)
    if events:
        run = whole.run_once(simulation.settings)  # reduced, and kept for later calls
    stopped_reduced = "" if as_it_stands.stopped else run.stopped
    # until the first event both runs are the same
    compared, other = whole, None
    if events and whole.reaches(events[0].time):
        until_event = whole.ending_at(events[0].time)
        if stopped_reduced:
            compared = until_event
        elif not run.stopped:
            # the larger one of both errors is judged
            judged, other = _measured(whole, run), _measured(until_event, run)
            if other.error.relative > judged.error.relative and _is_long_enough(until_event, other.error):
                compared, other = until_event, judged
    run = compared.in_window(run)
    found = _measured(compared, run)
    error = found.error
    causes: tuple[MeasuredCause, ...] = ()
    harmless: tuple[str, ...] = ()
    remedies: tuple[MeasuredRemedy, ...] = ()
    stability: Stability | None = None
    changes: tuple[ModelChange, ...] = ()
    if run.stopped or error.band in (Band.USABLE, Band.WRONG):
        causes = tuple(_causes(compared, run, error.stated_by_position))
        tested = dict.fromkeys(
            cause.name
            for cause in simulation.causes()
            if compared.is_comparable(compared.run_once(cause.without))
        )
        harmless = tuple(name for name in tested if name not in {cause.name for cause in causes})
        remedies = tuple(find_remedies(compared, run, error))
        if run.stopped or (causes and causes[0].name in OF_UNSTABLE_MODES):
            stability, changes = _stability(compared, run)
    output_times = compared.reference.time.tolist()
    return Judgement(
        engine=simulation.engine,
        settings=simulation.words(),
        error=error,
        loop_error=found.loop_error,
        stopped=run.stopped,
        events=events,
        until=compared.until,
        causes=causes,
        remedies=remedies,
        run=run.trajectory,
        reference=compared.reference,
        scale=found.scale,
        stability=stability,
        changes=changes,
        stopped_as_it_stands="" if run.stopped else as_it_stands.stopped,
        stopped_reduced=stopped_reduced,
        run_inputs={**simulation.run_inputs(reduced=bool(events)), "output_times": output_times},
        are_assumed=simulation.are_assumed,
        harmless=harmless,
        unjudged_from=compared.unjudged_from,
        extended_to=compared.extended_to,
        approximated=tuple(simulation.approximated),
        other=other,
    )


def _measured(compared: Comparison, run: FileRun) -> MeasuredError:
    """Measure the errors of a run up to the end of a comparison."""
    return MeasuredError(compared.error(run), compared.loop_error(run), compared.scale)


def _is_long_enough(compared: Comparison, error: RunError) -> bool:
    """Return True if a comparison has `MIN_OUTPUTS`, and the mechanism of the largest error clearly moves.

    The error of a short motion is a large part of the motion, as that grows with the square of time.
    """
    by_position = error.relative_position >= error.relative_rotation
    body, _ = error.position_at if by_position else error.rotation_at
    outputs = len(compared.until_end(compared.reference).time) - 1  # after the start
    return outputs >= MIN_OUTPUTS and compared.scale.by_body[body].moves(by_position)


def horizons(simulation: FileSimulation[Any]) -> tuple[float | None, ...]:
    """Find the time, s, until which each of `Mechanism.connected_bodies` can be compared in runs of a file.

    None means the whole run.
    """
    return Comparison.of(simulation).horizons


def measure_error(
    simulation: FileSimulation[Any], rtol: float, horizons: Sequence[float | None]
) -> MeasuredError:
    """Measure the error of a file's run with its own settings.

    Elements of the file that the reference does not have are switched off, whether they act or not.

    Args:
        simulation: the file in its own engine.
        rtol: relative tolerance of the reference solution.
        horizons: result of `horizons`; empty if no mechanism is chaotic.

    Raises:
        CrosscheckError: if the run diverges, or if the motion is chaotic before its first output.
    """
    compared = Comparison.of(simulation, {"rtol": rtol, "atol": 0.01 * rtol}, horizons)
    compared.check_outputs()
    run = compared.run(simulation.settings)
    if run.stopped:
        raise CrosscheckError(f"the run with the settings of the file diverges: {run.stopped}")
    # violations of chaotic loops do not repeat on another processor
    times = run.trajectory.time
    loop_error = LoopError.of(run.loop_errors, times[: compared.scale.outputs(times)])
    return MeasuredError(compared.error(run), loop_error, compared.scale)


def _causes(compared: Comparison, run: FileRun, of_position: bool) -> list[MeasuredCause]:
    """Measure the error of each property of the settings: how far a run without that error is from the run.

    Several changes of one property, such as other integrators, count by the one that is closest to the
    reference. Another choice that brings the run no closer to the reference shows no error of the property.
    More exact settings always show one: if they bring the run no closer, the errors of two properties cancel.

    Args:
        compared: the file with its reference.
        run: the judged run.
        of_position: whether causes are sorted by errors of positions, else by errors of rotations.

    Returns:
        The largest cause first. If the judged run diverged, first the properties without which the run
        completes; the one with the smallest remaining error leads.
    """
    best: dict[str, tuple[float, MeasuredCause]] = {}
    for cause in compared.simulation.causes():
        removed = compared.run_once(cause.without)
        # the run with the error of the property: the judged run, or one with settings for this comparison
        kept = run if cause.against is None else compared.run_once(cause.against)
        if removed.stopped or not compared.is_comparable(removed):
            continue
        error, remaining = compared.error(kept), compared.error(removed)
        is_closer = remaining.relative < error.relative or bool(kept.stopped)
        if cause.is_choice and not is_closer:
            continue
        if cause.name not in best or remaining.relative < best[cause.name][0]:
            apart = compared.apart(kept, removed)
            measured = MeasuredCause(cause.name, apart, bool(kept.stopped), cause.is_choice)
            best[cause.name] = remaining.relative, measured

    def place(pair: tuple[float, MeasuredCause]) -> tuple[bool, float]:
        remaining, cause = pair
        if cause.brings_back:
            return False, remaining
        return True, -cause.error.relative_by(of_position)

    return [cause for _, cause in sorted(best.values(), key=place)]


def _stability(compared: Comparison, run: FileRun) -> tuple[Stability | None, tuple[ModelChange, ...]]:
    """Find the fastest mode of the file, and changes of the model that make its time step stable.

    Small motions are the equations and time steps of the model, linearized about states of the judged run. If
    that run diverged, states of the completed run with the smallest error are taken, or the start without
    such a run.
    """
    simulation = compared.simulation
    if run.stopped:
        run = min(compared.completed, key=lambda each: compared.error(each).relative, default=run)
    count = len(compared.until_end(run.trajectory).time) if not run.stopped else 1
    outputs = sorted({*np.linspace(0, count - 1, STATES).astype(int).tolist()})
    motions = simulation.small_motions(run, outputs)
    if motions is None:
        return None, ()
    step = simulation.settings.timestep
    mode = ModeAtFault(motions, simulation.settings, timestep=step, duration=step * compared.steps)
    if mode.found.is_stable:
        return mode.found, ()

    def is_stable(changed: FileSimulation[Any]) -> bool:
        """Return True if the time step of the file is stable for a changed model, about the mode's state."""
        changed_motions = changed.small_motions(run, outputs)
        return changed_motions is not None and mode.steps.of_changed(changed_motions).is_stable(step)

    def changed_run(changed: FileSimulation[Any]) -> FileRun:
        """Simulate a changed model with the settings of the file."""
        return compared.in_window(compared.run(simulation.settings, simulation=changed))

    return mode.found, tuple(model_changes(mode, simulation, is_stable, changed_run, compared.error))
