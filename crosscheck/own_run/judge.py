"""Judge the run of a model file: its error, the setting that causes it, and settings that reduce it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import islice
from typing import Any

import numpy as np

from crosscheck.own_run.comparison import Comparison
from crosscheck.own_run.errors import ACCURATE_BELOW, Band, MotionScale, RunError, errors_over_time
from crosscheck.own_run.stability import ModeAtFault, ModelChange, Stability, model_changes
from crosscheck.support.errors import CrosscheckError
from newton_euler.model.trajectory import Trajectory
from newton_euler.reading.file_run import INTEGRATOR, TIME_STEP, Event, FileRun, FileSimulation

TARGET = ACCURATE_BELOW
"""Relative error that remedies aim at."""

MIN_GAIN = 0.5
"""Largest error of a remedy, as a fraction of the error of the file's settings."""

KINDS_REFINED = 2
"""Number of kinds of settings that are tried at smaller steps."""

STATES = 8
"""Number of states of the run at which the fastest mode is sought."""

MAX_REMEDY_COST = 40.0
"""Largest number of evaluations of a remedy, as a multiple of those of the judged run."""


@dataclass(frozen=True)
class MeasuredCause:
    """One property of the settings and the error that it causes alone.

    Attributes:
        name: the property, such as "time step".
        error: difference of a run from a run without the error of the property.
        brings_back: whether the run completes without the property; False if the judged run does.
    """

    name: str
    error: RunError
    brings_back: bool = False


@dataclass(frozen=True)
class MeasuredRemedy:
    """Settings that were tried.

    Attributes:
        changes: settings that differ from those of the file, by name.
        fragment: text that gives the file these settings.
        error: error of the run.
        evaluations: evaluations of the equations of motion, as a multiple of those of the file's settings.
        run_time: measured run time, as a multiple of the run time of the file's settings; the multiple of
            the evaluations if the run of the file diverged.
    """

    changes: Mapping[str, str]
    fragment: str
    error: RunError
    evaluations: float
    run_time: float


@dataclass(frozen=True, eq=False)
class Judgement:
    """Judgement of a file's run.

    Attributes:
        engine: name and version of the file's engine.
        settings: settings of the file in words.
        error: error of the judged run, up to the time at which it ended.
        opening: largest error of the loop constraints, m or rad.
        stopped: reason why the run ended early; "" for a complete run.
        events: elements of the file that act and that the reference does not have, in the order of time. If
            there are any, the judged run is without them.
        until: time, s, at which the comparison ends because the motion is chaotic or unstable; None if the
            comparison ends with the run.
        causes: error by property of the settings, largest first; empty for an accurate run.
        remedies: settings with a smaller error, cheapest first; empty for an accurate run.
        stability: the fastest mode beside the stability limit; only if the run diverged, or the time step or
            the integrator is the largest cause of its error.
        changes: changes of the model with which the time step is stable; empty if it is stable.
        run: the judged run.
        reference: the reference solution at the same times.
        stopped_as_it_stands: reason why the run with contacts, limits and friction ended early, although the
            judged run without them completes; "" otherwise.
        run_inputs: start, controls, changed numbers and output times of the judged run. With these,
            the engine alone can repeat the run, see `FileSimulation.run_inputs`.
    """

    engine: str
    settings: str
    error: RunError
    opening: float
    stopped: str
    events: tuple[Event, ...]
    until: float | None
    causes: tuple[MeasuredCause, ...]
    remedies: tuple[MeasuredRemedy, ...]
    run: Trajectory
    reference: Trajectory
    stability: Stability | None = None
    changes: tuple[ModelChange, ...] = ()
    stopped_as_it_stands: str = ""
    run_inputs: Mapping[str, Any] = field(default_factory=dict)

    @property
    def band(self) -> Band:
        """Accuracy of the run; a run that diverged is wrong."""
        return Band.WRONG if self.stopped else self.error.band

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
        return found | {
            name: [asdict(each) for each in value]
            if isinstance(value, tuple)
            else asdict(value)
            if isinstance(value, RunError | Stability)
            else value
            for name, value in fields.items()
        }


def judge(simulation: FileSimulation[Any], acting: Sequence[Event] = ()) -> Judgement:
    """Judge the run of a file with its own settings.

    Args:
        simulation: the file in its own engine.
        acting: elements of the file that act in the reference's motion and are not simulated there.

    Raises:
        NewtonEulerError: if the scene has no reference solution.
    """
    compared = Comparison.of(simulation)
    # the run as it stands, and without what the reference does not have
    run = compared.run(simulation.settings, reduced=False)
    as_it_stands = run.stopped
    first: dict[str, Event] = {}
    for event in sorted([*run.events, *acting], key=lambda event: event.time):
        first.setdefault(event.element, event)
    events = tuple(first.values())
    if events:
        run = compared.run_once(simulation.settings)
    error = compared.error(run)
    causes: tuple[MeasuredCause, ...] = ()
    remedies: tuple[MeasuredRemedy, ...] = ()
    stability: Stability | None = None
    changes: tuple[ModelChange, ...] = ()
    if run.stopped or error.band is not Band.ACCURATE:
        causes = tuple(_causes(compared, run, error.is_of_position))
        remedies = tuple(_remedies(compared, run, error))
        if run.stopped or (causes and causes[0].name in (TIME_STEP, INTEGRATOR)):
            stability, changes = _stability(compared, run)
    return Judgement(
        simulation.engine,
        simulation.words(),
        error,
        float(np.max(run.opening, initial=0.0)),
        run.stopped,
        events,
        compared.until,
        causes,
        remedies,
        run.trajectory,
        compared.reference,
        stability,
        changes,
        "" if run.stopped else as_it_stands,
        {**simulation.run_inputs(reduced=bool(events)), "output_times": compared.reference.time.tolist()},
    )


@dataclass(frozen=True)
class MeasuredError:
    """Error of a file's run without causes and remedies.

    Attributes:
        error: error of the run.
        opening: largest error of the loop constraints, m or rad.
        scale: extent of the motion, by which errors are divided.
    """

    error: RunError
    opening: float
    scale: MotionScale


def horizon(simulation: FileSimulation[Any]) -> float | None:
    """Find the time, s, until which runs of a file can be compared; None means the whole run."""
    return Comparison.of(simulation).until


def measure_error(simulation: FileSimulation[Any], rtol: float, until: float | None) -> MeasuredError:
    """Measure the error of a file's run with its own settings.

    Elements of the file that the reference does not have are switched off, whether they act or not.

    Args:
        simulation: the file in its own engine.
        rtol: relative tolerance of the reference solution.
        until: time, s, at which the comparison ends; None for the whole run.

    Raises:
        CrosscheckError: if the run diverges.
    """
    compared = Comparison.of(simulation, {"rtol": rtol, "atol": 0.01 * rtol}, until)
    run = compared.run(simulation.settings)
    if run.stopped:
        raise CrosscheckError(f"the run with the settings of the file diverges: {run.stopped}")
    count = len(run.opening) if until is None else int(np.searchsorted(run.trajectory.time, until))
    opening = float(np.max(run.opening[:count], initial=0.0))
    return MeasuredError(compared.error(run), opening, compared.scale)


def _causes(compared: Comparison, run: FileRun, of_position: bool) -> list[MeasuredCause]:
    """Measure the error of each property of the settings: how far a run without that error is from the run.

    Several changes of one property, such as other integrators, count by the one that is closest to the
    reference. A change that brings the run no closer to the reference shows no error of the property.

    Args:
        compared: the file beside its reference.
        run: the judged run.
        of_position: whether causes are sorted by errors of positions, see `RunError.part`.

    Returns:
        The largest cause first. If the judged run diverged, first the properties without which the run
        completes; the one with the smallest remaining error leads.
    """
    best: dict[str, tuple[float, MeasuredCause]] = {}
    for cause in compared.simulation.causes():
        removed = compared.run_once(cause.without)
        kept = run if cause.against is None else compared.run_once(cause.against)
        if removed.stopped:
            continue
        remaining = compared.error(removed).relative
        if remaining >= compared.error(kept).relative and not kept.stopped:
            continue
        if cause.name not in best or remaining < best[cause.name][0]:
            measured = MeasuredCause(cause.name, compared.apart(kept, removed), bool(kept.stopped))
            best[cause.name] = remaining, measured

    def place(pair: tuple[float, MeasuredCause]) -> tuple[bool, float]:
        remaining, cause = pair
        return not cause.brings_back, remaining if cause.brings_back else -cause.error.part(of_position)

    return [cause for _, cause in sorted(best.values(), key=place)]


def _stability(compared: Comparison, run: FileRun) -> tuple[Stability | None, tuple[ModelChange, ...]]:
    """Find the fastest mode of the file, and changes of the model that make its time step stable.

    The file is linearized at states of the judged run. If that run diverged, states of the completed run with
    the smallest error are taken, or the start without such a run.
    """
    simulation = compared.simulation
    if run.stopped:
        run = min(compared.completed, key=lambda each: compared.error(each).relative, default=run)
    count = len(compared.until_end(run.trajectory).time) if not run.stopped else 1
    outputs = sorted({*np.linspace(0, count - 1, STATES).astype(int).tolist()})
    motions = simulation.small_motions(run, outputs)
    if motions is None:
        return None, ()
    step, duration = simulation.timestep(simulation.settings), compared.steps
    mode = ModeAtFault(motions, simulation.settings, step, step * duration)
    if mode.found.is_stable:
        return mode.found, ()

    def is_stable(changed: FileSimulation[Any]) -> bool:
        others = changed.small_motions(run, outputs)
        return others is not None and mode.steps.of_changed(others).is_stable(step)

    def changed_run(changed: FileSimulation[Any]) -> FileRun:
        return compared.run(simulation.settings, simulation=changed)

    return mode.found, tuple(model_changes(mode, simulation, is_stable, changed_run, compared.error))


def _remedies(compared: Comparison, run: FileRun, error: RunError) -> Iterator[MeasuredRemedy]:
    """Try other settings: yield the best of similar cost, and the cheapest with an error below `TARGET`.

    All kinds of settings are tried at the file's time step. The two best kinds are tried at smaller steps. If
    the run of the file diverged and no settings of similar cost complete, the cheapest that do come first.
    """
    simulation = compared.simulation

    def tried(settings: Any) -> MeasuredRemedy | None:
        found = compared.run_once(settings)
        if found.stopped:
            return None
        changes, fragment = simulation.changes(settings), simulation.fragment(settings)
        evaluations = simulation.evaluations(settings) / simulation.evaluations(simulation.settings)
        run_time = evaluations if run.stopped else found.trajectory.wall_time / run.trajectory.wall_time
        return MeasuredRemedy(changes, fragment, compared.error(found), evaluations, run_time)

    def completed(kinds: Iterable[tuple[int, Any]]) -> Iterator[tuple[int, Any, MeasuredRemedy]]:
        """Yield divisor of the time step, settings and remedy of those whose run completes."""
        for divisor, settings in kinds:
            if (remedy := tried(settings)) is not None:
                yield divisor, settings, remedy

    measured = list(completed((1, settings) for settings in simulation.alternatives(1)))
    if not measured:
        # the first kinds that complete at smaller steps, in the order of their evaluations
        divisors = [2**k for k in range(1, int(np.log2(MAX_REMEDY_COST)) + 1)]
        smaller = [
            (divisor, settings) for divisor in divisors for settings in simulation.alternatives(divisor)
        ]
        smaller = [pair for pair in smaller if compared.affords(pair[1])]
        smaller.sort(key=lambda pair: simulation.evaluations(pair[1]))
        measured = list(islice(completed(smaller), KINDS_REFINED))
    measured.sort(key=lambda each: each[2].error.relative)
    found = [remedy for _, _, remedy in measured]
    for first_divisor, settings, remedy in measured[:KINDS_REFINED]:
        last, divisor = remedy, 2 * first_divisor
        while (
            last.error.relative > TARGET and divisor / first_divisor * remedy.evaluations <= MAX_REMEDY_COST
        ):
            divided = simulation.at_divisor(settings, divisor)
            if not compared.affords(divided):
                break
            finer = tried(divided)
            divisor *= 2
            if finer is not None:
                found.append(finer)
                last = finer
    better = [each for each in found if each.error.relative < MIN_GAIN * error.relative or run.stopped]
    similar = [each for each in better if each.evaluations <= 1.0]
    cheap = min(similar, key=lambda each: each.error.relative, default=None)
    if cheap is None and run.stopped:
        cheap = min(better, key=lambda each: (each.evaluations, each.error.relative), default=None)
    good = [each for each in better if each.error.relative <= TARGET]
    best = min(good, key=lambda each: (each.evaluations, each.error.relative), default=None)
    if best is None:
        best = min(better, key=lambda each: each.error.relative, default=None)
    if cheap is not None:
        yield cheap
    if best is not None and best is not cheap:
        yield best
