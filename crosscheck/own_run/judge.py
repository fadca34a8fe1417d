"""Judge the run of a model file: its error, the setting that causes it, and settings that reduce it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, is_dataclass, replace
from typing import Any

import numpy as np

from crosscheck.own_run.comparison import Comparison, with_names
from crosscheck.own_run.errors import (
    ACCURATE_BELOW,
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
from newton_euler.reading.file_run import (
    OF_UNSTABLE_MODES,
    CauseName,
    Event,
    FileRun,
    FileSimulation,
    LoopNeed,
)
from newton_euler.reading.import_report import CONTACTS, FORCE_LIMITS, FRICTION, LIMITS

STATES = 8
"""Number of states of the run at which the fastest mode is sought."""


CANCELLATION = 1.05
"""Smallest ratio of the error by one cause and the error of the run at which errors count as cancelling."""


SEPARATION = 1.0
"""Error of a run, as a fraction of the motion, above which errors by causes do not add up to it."""

MIN_EXPLAINED = 0.75
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
    """Errors of a file's run in a baseline.

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

    The judged run is the file as it stands. If an element acts that the reference does not have, such as a
    contact, the comparison ends there, and `without` judges the run of the file without such elements.

    Attributes:
        engine: name and version of the file's engine.
        settings: settings of the file in words.
        error: error of the run, up to the end of the comparison or the time at which the run ended.
        loop_error: largest violations of the loop constraints up to then.
        stopped: reason why the run ended early; "" for a complete run.
        events: elements of the file that act in the reference's motion and that the reference does not have,
            in the order of time.
        until: time, s, at which the comparison ends because the first of `events` acts; 0 if the motion until
            then is too short to judge; None if the comparison ends with the run.
        only_in_run: elements that act in the judged run although they do not act in the reference's motion.
            Their action is a part of the error.
        too_short: reason why the motion until the first of `events` is too short, and what to do; "" if it is
            judged, or if the event is at the start.
        without: judgement of the whole run without all `events`; None if there are none, or if no run of the
            file's engine has them.
        approximated: dry friction and limits of the file that the reference has as forces. The difference of
            both models is a part of the error.
        stiffer_limits: change of the file that makes its limits stiffer, as text; "" if there are none, or if
            they are as stiff as the time step permits.
        needs: elements that the run has, and that a user's own time loop lacks unless the user adds them.
        causes: error by property of the settings, largest first; empty for an accurate run. If the run before
            the first event needs no causes, `without` has those of the run without `events`.
        harmless: tested properties without which no run is closer to the reference.
        remedies: settings with a smaller error, cheapest first; empty for an accurate run.
        smallest: smallest error of all tried settings if there are no `remedies` although some were tried.
        stability: stability limit of the time step, and the mode of the linearized model that sets the limit.
            Only if the run diverged, or the time step or the integrator is the largest cause of its error.
        changes: changes of the model with which the time step is stable; empty if it is stable.
        run: the judged run, up to the end of the comparison.
        reference: the reference solution at the same times.
        are_assumed: True if the settings are usual ones, since the file has none and the user gives none.
        scale: extent of the reference's motion, by which errors are divided. A mechanism that is chaotic is
            compared until its `MechanismMotion.until`.
        unjudged_from: time, s, from which the run is not judged because it has too many time steps; None if
            the whole motion is judged.
        extended_to: time, s, until which the run is judged although the scene ends before, as its duration
            is too few time steps; None if the run ends with the scene.
        run_inputs: start, controls, changed numbers and output times of the judged run. With these,
            the engine alone can repeat the run.
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
    only_in_run: tuple[Event, ...] = ()
    run_inputs: Mapping[str, Any] = field(default_factory=dict)
    are_assumed: bool = False
    harmless: tuple[str, ...] = ()
    smallest: RunError | None = None
    unjudged_from: float | None = None
    extended_to: float | None = None
    approximated: tuple[str, ...] = ()
    stiffer_limits: str = ""
    needs: tuple[LoopNeed, ...] = ()
    too_short: str = ""
    without: Judgement | None = None

    @property
    def judged(self) -> tuple[Judgement, ...]:
        """This judgement and that of the run without `events`, as far as they have an error.

        A run that diverges only without `events` is not in the result: that run is not the user's.
        """
        own = (self,) if self.is_judged else ()
        reduced = self.without
        return (*own, reduced) if reduced and reduced.is_judged and not reduced.stopped else own

    @property
    def analyzed(self) -> Judgement:
        """The judgement with causes and remedies: this one, or else that of the run without `events`."""
        return self if self.without is None or self.causes or self.remedies else self.without

    @property
    def shown(self) -> Judgement:
        """The judgement to draw: this one, or that of the run without `events` if this one has no motion."""
        return self if self.without is None or len(self.run.time) > 1 else self.without

    @property
    def errors_cancel(self) -> bool:
        """True if an exact cause alone has a clearly larger error than the run has."""
        by_position = self.error.stated_by_position
        exact = [cause.error.relative_by(by_position) for cause in self.causes if not cause.is_choice]
        largest = max(exact, default=0.0)
        return not self.stopped and largest > CANCELLATION * self.error.relative_by(by_position)

    @property
    def has_separated(self) -> bool:
        """True if the error is about as large as the motion; causes then compare runs that have parted."""
        moves = all(each.moves(self.error.stated_by_position) for each in self.scale.mechanisms)
        return not self.stopped and moves and self.error.relative > SEPARATION

    @property
    def have_one_error(self) -> bool:
        """True if a smaller time step and another integrator both remove most of the run's error."""
        by_position = self.error.stated_by_position
        least = MIN_EXPLAINED * self.error.relative_by(by_position)
        large = {each.name for each in self.causes if each.error.relative_by(by_position) >= least > 0.0}
        return not self.stopped and large.issuperset(OF_UNSTABLE_MODES)

    @property
    def is_explained(self) -> bool:
        """False if all causes together have a clearly smaller error than the run has."""
        by_position = self.error.stated_by_position
        total = sum(cause.error.relative_by(by_position) for cause in self.causes)
        return bool(self.stopped) or total >= MIN_EXPLAINED * self.error.relative_by(by_position)

    @property
    def rests(self) -> bool:
        """True if nothing moves in the compared part of the reference, and the run rests as well."""
        is_compared = self.error.outputs > 0 and not self.stopped
        return is_compared and self.scale.rests and self.error.relative < ACCURATE_BELOW

    @property
    def is_judged(self) -> bool:
        """False if a complete run shows nothing, see `Band.NOT_JUDGED`."""
        return self.band is not Band.NOT_JUDGED

    @property
    def why_not_judged(self) -> str:
        """Reason why a run is not judged, and what would permit a judgement."""
        if self.until is not None and not self.error.outputs:
            return _early_event_text(self.events[0], self.too_short)
        if not self.error.outputs:
            return early_chaos_text(self.scale)
        return "nothing moves, so that the run tests nothing; needed: a motion, such as --set excitation=on"

    @property
    def band(self) -> Band:
        """Accuracy of the run; a run that diverged is wrong."""
        if self.stopped:
            return Band.WRONG
        return Band.NOT_JUDGED if self.rests else self.error.band

    def summary(self) -> dict[str, Any]:
        """All numbers, for JSON."""
        left_out = ("run", "reference", "without")
        fields = {name: value for name, value in vars(self).items() if name not in left_out}
        position, rotation = errors_over_time(self.run, self.reference)
        found: dict[str, Any] = {
            "band": self.band.value,
            "relative": self.error.relative,
            "without": self.without.summary() if self.without else None,
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


def _early_event_text(first: Event, too_short: str) -> str:
    """State that an element acts before the motion is long enough to judge, why, and what to do."""
    since = f"from {first.time:.3g} s on" if first.time else "from the start on"
    acts = "act" if is_plural(first) else "acts"
    options = {FRICTION: "--set friction=regularized", LIMITS: "--set limits=compliant"}
    option = next((option for topic, option in options.items() if first.element.startswith(topic)), "")
    it = "them" if acts == "act" else "it"
    parts = [f"{first.element} {acts} {since}, and the reference does not simulate {it}", too_short]
    if option:
        parts.append(f"{option} makes a force of {it}, if the joint is a hinge or a slide")
    if first.element.startswith(FORCE_LIMITS):
        parts.append("a smaller step of the command keeps the force below the limit")
    return "; ".join(filter(None, parts))


def is_plural(event: Event) -> bool:
    """Return True if the name of an element is plural, such as "limits of joint 'pivot'"."""
    return event.element.startswith((CONTACTS, LIMITS))


def judge(simulation: FileSimulation[Any], acting: Sequence[Event] = ()) -> Judgement:
    """Judge the run of a file with its own settings.

    Args:
        simulation: the file in its own engine.
        acting: elements of the file that act in the reference's motion and are not simulated there, in the
            order of time. Until the first of them acts, the reference is a solution of the file as it stands.

    Raises:
        NewtonEulerError: if the scene has no reference solution.
    """
    whole = Comparison.of(simulation)
    run = whole.run_once(simulation.settings)
    events = with_names(acting, run.events)
    acting_names = {event.element for event in events}
    only_in_run = tuple(event for event in run.events if event.element not in acting_names)
    if not (events and simulation.has_all_elements):
        judged = _judgement(whole, run, is_analyzed=True, only_in_run=only_in_run)
        return replace(judged, events=events)
    until_event = whole.until_event(events, run)
    compared = until_event or whole.ending_at(0.0)
    too_short = whole.why_too_short(events[0]) if until_event is None and events[0].time else ""
    # causes and remedies are those of the run as it stands if its error needs them
    needs_causes = not run.stopped and compared.error(run).band in (Band.OFF, Band.WRONG)
    own = _judgement(
        compared,
        run,
        is_analyzed=needs_causes,
        only_in_run=tuple(event for event in only_in_run if event.time < events[0].time),
    )
    reduced = replace(whole, reduced=True)
    without = _judgement(reduced, reduced.run_once(simulation.settings), is_analyzed=not needs_causes)
    return replace(own, events=events, too_short=too_short, without=without)


def _judgement(
    compared: Comparison, run: FileRun, *, is_analyzed: bool, only_in_run: tuple[Event, ...] = ()
) -> Judgement:
    """Judge a run up to the end of a comparison.

    Args:
        compared: the file with its reference.
        run: run with the settings of the file.
        is_analyzed: True to find causes and remedies of an error that is not small.
        only_in_run: see `Judgement`.
    """
    simulation = compared.simulation
    error = compared.error(run)
    causes: tuple[MeasuredCause, ...] = ()
    harmless: tuple[str, ...] = ()
    remedies: tuple[MeasuredRemedy, ...] = ()
    smallest: RunError | None = None
    stability: Stability | None = None
    changes: tuple[ModelChange, ...] = ()
    if is_analyzed and (run.stopped or error.band in (Band.OFF, Band.WRONG)):
        causes = tuple(_causes(compared, run, error.stated_by_position))
        tested = dict.fromkeys(
            cause.name
            for cause in simulation.causes()
            if compared.is_comparable(compared.run_once(cause.without))
        )
        harmless = tuple(name for name in tested if name not in {cause.name for cause in causes})
        found = find_remedies(compared, run, error)
        remedies, smallest = found.remedies, found.smallest
        if run.stopped or (causes and causes[0].name in OF_UNSTABLE_MODES):
            stability, changes = _stability(compared, run)
    output_times = compared.reference.time.tolist()
    return Judgement(
        engine=simulation.engine,
        settings=simulation.words(),
        error=error,
        loop_error=compared.loop_error(run),
        stopped=run.stopped,
        events=(),
        until=compared.until,
        causes=causes,
        remedies=remedies,
        run=compared.until_end(run.trajectory),
        reference=compared.until_end(compared.reference),
        scale=compared.scale,
        stability=stability,
        changes=changes,
        only_in_run=only_in_run,
        run_inputs={**simulation.run_inputs(compared.reduced), "output_times": output_times},
        are_assumed=simulation.are_assumed,
        harmless=harmless,
        smallest=smallest,
        unjudged_from=compared.unjudged_from,
        extended_to=compared.extended_to,
        approximated=tuple(simulation.approximated),
        stiffer_limits=simulation.stiffer_limits,
        needs=tuple(simulation.needs),
    )


def horizons(simulation: FileSimulation[Any]) -> tuple[float | None, ...]:
    """Find the time, s, until which each of `Mechanism.connected_bodies` can be compared in runs of a file.

    None means the whole run.
    """
    return Comparison.of(simulation).horizons


def measure_error(
    simulation: FileSimulation[Any], rtol: float, horizons: Sequence[float | None]
) -> MeasuredError:
    """Measure the error of a file's run with its own settings, for a baseline.

    Elements of the file that the reference does not have are switched off, whether they act or not.

    Args:
        simulation: the file in its own engine.
        rtol: relative tolerance of the reference solution.
        horizons: result of `horizons`; empty if no mechanism is chaotic.

    Raises:
        CrosscheckError: if the run diverges, or if the motion is chaotic before its first output.
    """
    compared = replace(Comparison.of(simulation, {"rtol": rtol, "atol": 0.01 * rtol}, horizons), reduced=True)
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
