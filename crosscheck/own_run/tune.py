"""Find the cheapest settings with which a model file reaches a given error, on the motion of its scene.

In: a file in its own engine (`newton_euler.reading.file_run.FileSimulation`) and a largest error of
`crosscheck.own_run.allowed`. Out: a `SettingsSearch` with settings, errors and costs, all of runs.
The cost of settings is their number of evaluations of the equations of motion, so that results repeat
exactly. `crosscheck.tuning` has the Python interface.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from crosscheck.own_run.allowed import AllowedError, without_loops
from crosscheck.own_run.comparison import MIN_OUTPUTS, Comparison, MeasuredSettings, with_names
from crosscheck.own_run.errors import ACCURATE_BELOW, LoopError, MotionScale
from crosscheck.support.errors import CrosscheckError
from newton_euler.reading.file_run import Event, FileSimulation, LoopNeed

MAX_ORDER = 6.0
"""Largest order of convergence that the search allows for: the 4 of RK4, and a margin for steps that are too
long for errors to follow their order."""

MIN_SATURATED = 0.1
"""Smallest relative error of a run that is too far from the reference for an order of convergence."""

MAX_COST = 1000.0
"""Largest number of evaluations of a run, as a multiple of those of the file's settings."""

MAX_LONG_RUN = 10.0
"""Largest number of evaluations of a run, as a multiple of `FileSimulation.max_evaluations`."""

MAX_STEPS_BETWEEN_OUTPUTS = 100_000
"""Largest number of time steps between two outputs."""

MIN_RATIO = 2.0
"""Smallest ratio of the errors of listed settings."""

MAX_LISTED_ERROR = 1.0
"""Relative error from which settings are not listed, unless they have the smallest error: an error as large
as the motion."""

CONVERGED_RATIO, CONVERGED_CHANGE = 4.0, 0.1
"""Ratio of time steps over which a converged error changes at most by this fraction. Smaller steps of such
settings do not reduce the error: what remains has another cause, such as soft constraints. An error of order
1 or more would change by a factor of 4; one that turns, such as a h - b h^2, by at least a quarter."""

MIN_CONVERGED = 3
"""Smallest number of time steps that show that an error has converged."""


@dataclass(frozen=True)
class Tried(MeasuredSettings):
    """Settings that the search has tried, with the cost of their run.

    Attributes:
        loop_error: largest violations of the loop constraints.
        stopped: reason why the run ended early; "" for a complete run.
        evaluations: evaluations of the equations of motion per second of motion.
        run_time: measured run time, as a multiple of that with the settings of the file; None if the run
            was not timed. The multiple of the evaluations if the run with the settings of the file stopped.
    """

    loop_error: LoopError
    stopped: str
    evaluations: float
    run_time: float | None = None

    def measured(self, target: AllowedError) -> float:
        """Return the error of the kind of `target`."""
        return target.kind.measured_in(self.error, self.loop_error)

    def reaches(self, target: AllowedError) -> bool:
        """Return True if the run is complete and compared, and its error is at most `target`."""
        return not self.stopped and self.error.outputs > 0 and self.measured(target) <= target.largest


@dataclass(frozen=True)
class SettingsSearch:
    """Result of a search for settings.

    Attributes:
        engine: name and version of the file's engine.
        settings: settings of the file in words.
        target: error to reach.
        own: the run with the settings of the file.
        found: the cheapest settings that reach the target; None if no tried settings do.
        tradeoff: settings with a smaller error than all cheaper ones, the cheapest first; errors differ by
            `MIN_RATIO` or more. The last ones are `found`, or have the smallest error of all.
        runs: number of runs that were made.
        events: elements of the file that act and that the reference does not have, in the order of time.
        until: time, s, until which runs of the file as it stands are compared, because the first of `events`
            acts; None if runs are compared to the end. If there are `events`, all runs are then without them,
            because the motion until the first event is too short.
        has_converged: True if no settings reach the target because smaller steps do not reduce the error.
        approximated, stiffer_limits, needs: see `Judgement`.
        scale: extent of the motion, by which errors are divided, and the time until which each mechanism is
            compared because its motion is chaotic or unstable from then on.
        settings_place: where the user pastes the found settings.
    """

    engine: str
    settings: str
    target: AllowedError
    own: Tried
    found: Tried | None
    tradeoff: tuple[Tried, ...]
    runs: int
    events: tuple[Event, ...]
    scale: MotionScale
    until: float | None = None
    has_converged: bool = False
    approximated: tuple[str, ...] = ()
    stiffer_limits: str = ""
    needs: tuple[LoopNeed, ...] = ()
    settings_place: str = "the model"

    def summary(self) -> dict[str, Any]:
        """All numbers, for JSON."""
        return asdict(self)


@dataclass(order=True)
class _Candidate:
    """Settings that wait for their run, in the order of their costs.

    Attributes:
        evaluations: evaluations per second of motion.
        kind: index of the kind of settings: integrator, solver, and softness or gains of loop closures.
        steps: number of time steps between two outputs; 1/k for a step of k times the time between outputs.
        settings: the settings.
    """

    evaluations: float
    kind: int
    steps: float
    settings: Any = field(compare=False)


def search_settings(
    simulation: FileSimulation[Any],
    target: AllowedError,
    acting: Sequence[Event] = (),
    progress: Callable[[str], None] = lambda _: None,
) -> SettingsSearch:
    """Find the cheapest settings whose run has at most a given error.

    The search tries settings in the order of their costs, and ends at the first ones that reach the target.
    Time steps of each kind of settings divide the time between two outputs by products of twos and fives, or
    multiply it. Runs with longer steps are compared at fewer outputs. A step is not tried if the error at a
    longer step excludes that it reaches the target, with convergence of order `MAX_ORDER`, or if the error
    of such settings has converged.

    Args:
        simulation: the file in its own engine.
        target: error to reach.
        acting: elements of the file that act in the reference's motion and are not simulated there, in the
            order of time.
        progress: shows a message to the user before each run.

    Raises:
        NewtonEulerError: if the scene has no reference solution.
        CrosscheckError: if the motion is chaotic before its first output, if nothing moves, or if the model
            has no loops for the kind of `target`.
    """
    progress("simulating the reference")
    whole = Comparison.of(simulation)
    whole.check_outputs()
    # the file as it stands until something acts that the reference does not have; if that is too early, the
    # file without it
    as_it_stands = whole.run_once(simulation.settings)
    events = with_names(acting, as_it_stands.events)
    compared = whole
    if events and simulation.has_all_elements:
        compared = whole.until_event(events, as_it_stands) or replace(whole, reduced=True)
    runs = 0

    def tried(settings: Any) -> Tried:
        nonlocal runs
        runs += 1
        evaluations = simulation.evaluations(settings)
        progress(f"run {runs}: {evaluations:.0f} evaluations per second of motion")
        # the run with the settings of the file is kept; many others would need much memory
        make_run = compared.run_once if settings == simulation.settings else compared.run
        run = compared.in_window(make_run(settings))
        loop_error = compared.loop_error(run)
        return Tried(*compared.measured(settings, run), loop_error, run.stopped, evaluations)

    own = tried(simulation.settings)
    if reason := without_loops(own.loop_error).get(target.kind):
        raise CrosscheckError(reason)
    if compared.scale.rests and own.error.relative < ACCURATE_BELOW:
        raise CrosscheckError("nothing moves, so that all settings are accurate; needed: a motion")
    steps_of_file = compared.every  # number of the file's time steps between two outputs
    times = compared.until_end(compared.reference).time
    judged_outputs = compared.scale.outputs(times) - 1  # after the start
    numbers = _numbers_of_steps(steps_of_file, judged_outputs)
    kinds = list(simulation.alternatives(divisor=1))  # with the file's time step

    def candidate(kind: int, above: float = 0.0, least: float = 0.0) -> _Candidate | None:
        """Return settings of a kind with the next number of steps between outputs; None if there is none.

        Args:
            kind: index of the kind.
            above, least: the number is larger than `above`, and `least` or more.
        """
        number = next((number for number in numbers if number > above and number >= least), None)
        if number is None:
            return None
        settings = simulation.at_divisor(kinds[kind], divisor=number / steps_of_file)
        return _Candidate(simulation.evaluations(settings), kind, number, settings)

    # each kind of settings has one candidate at a time: its longest step that can still reach the target
    waiting = [first for kind in range(len(kinds)) if (first := candidate(kind)) is not None]
    heapq.heapify(waiting)
    most = _largest_cost(compared)
    tradeoff: list[tuple[Any, Tried]] = []
    found: Tried | None = None
    has_converged = False
    errors: list[list[tuple[float, float]]] = [[] for _ in kinds]  # number of steps and error, by kind
    while waiting and waiting[0].evaluations <= most and found is None:
        each = heapq.heappop(waiting)
        result = tried(each.settings)
        value = result.measured(target)
        is_better = all(value < one.measured(target) for _, one in tradeoff)
        if not result.stopped and result.error.outputs and is_better:
            tradeoff.append((each.settings, result))
        if result.reaches(target):
            found = result
        is_far = result.stopped or not result.error.outputs or result.error.relative >= MIN_SATURATED
        if not is_far:
            errors[each.kind].append((each.steps, value))
            if _has_converged(errors[each.kind]):
                has_converged = True
                continue
        refined = 1.0 if is_far else max(1.0, value / target.largest) ** (1.0 / MAX_ORDER)
        if (finer := candidate(each.kind, each.steps, refined * each.steps)) is not None:
            heapq.heappush(waiting, finer)

    # measured run times, of the listed settings only
    progress("measuring run times")
    own_run = compared.fastest(simulation.settings)

    def relative_time(settings: Any) -> float:
        if settings == simulation.settings:
            return 1.0
        return compared.relative_run_time(settings, compared.fastest(settings), own_run)

    listed = tuple(
        replace(one, run_time=relative_time(settings)) for settings, one in _thinned(tradeoff, target)
    )
    return SettingsSearch(
        simulation.engine,
        simulation.words(),
        target,
        replace(own, run_time=1.0),
        listed[-1] if found is not None else None,
        listed,
        runs,
        events,
        compared.scale,
        until=compared.until,
        has_converged=has_converged and found is None,
        approximated=tuple(simulation.approximated),
        stiffer_limits=simulation.stiffer_limits,
        needs=tuple(simulation.needs),
        settings_place=simulation.settings_place,
    )


def _has_converged(errors: Sequence[tuple[float, float]]) -> bool:
    """Return True if the last errors of settings do not change with the time step.

    Args:
        errors: number of time steps between outputs and the error, the longest step first.
    """
    last, _ = errors[-1]
    longest = max((number for number, _ in errors if number * CONVERGED_RATIO <= last), default=None)
    if longest is None:
        return False
    values = [value for number, value in errors if number >= longest]
    is_same = max(values) - min(values) <= CONVERGED_CHANGE * max(values)
    return is_same and len(values) >= MIN_CONVERGED


def _largest_cost(compared: Comparison) -> float:
    """Return the largest number of evaluations per second of motion that the search tries."""
    simulation = compared.simulation
    affordable = MAX_LONG_RUN * simulation.max_evaluations / compared.scene.duration
    return min(MAX_COST * simulation.evaluations(simulation.settings), affordable)


def _thinned(tradeoff: list[tuple[Any, Tried]], target: AllowedError) -> list[tuple[Any, Tried]]:
    """Select settings whose errors differ by `MIN_RATIO` or more; the most accurate ones are kept.

    Args:
        tradeoff: settings and their runs, the largest error first.
        target: error to reach.
    """
    kept: list[tuple[Any, Tried]] = []
    for settings, one in reversed(tradeoff):
        is_listed = not kept or MIN_RATIO * kept[-1][1].measured(target) <= one.measured(target)
        if is_listed and (not kept or one.error.relative < MAX_LISTED_ERROR):
            kept.append((settings, one))
    return kept[::-1]


def _numbers_of_steps(own: int, outputs: int) -> list[float]:
    """List numbers of time steps between two outputs: products of twos and fives, and those of the file.

    The steps are then short decimal numbers, if the file's own step is one. A number 1/k is a step of k times
    the time between two outputs.

    Args:
        own: number of the file's own steps between two outputs.
        outputs: number of outputs after the start that are compared.
    """
    products = {2**k * 5**m for k in range(20) for m in range(10)}
    parts = [1.0 / k for k in products if outputs // k >= MIN_OUTPUTS]
    numbers = {*parts, *products, *(own * 2**k for k in range(20))}
    return sorted(number for number in numbers if number <= MAX_STEPS_BETWEEN_OUTPUTS)
