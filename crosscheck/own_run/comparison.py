"""Runs of a model file compared with a reference solution at the same output times.

In: a file in its own engine (`newton_euler.reading.file_run.FileSimulation`): MuJoCo for MJCF, Pinocchio for
URDF. Out: runs with any settings, and their errors, for `crosscheck.own_run.judge` and
`crosscheck.own_run.tune`. The reference does not simulate contacts, limits and dry friction: it is a solution
of the file as it stands until the first of them acts. A reduced run has these elements switched off.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count
from typing import Any

from crosscheck.engines.adaptive import newton_euler_options
from crosscheck.own_run.errors import (
    LoopError,
    MotionScale,
    RunError,
    early_chaos_text,
    outputs_before,
    run_error,
)
from crosscheck.own_run.horizon import comparable_until
from crosscheck.own_run.interpolation import common_outputs
from crosscheck.support.errors import CrosscheckError
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.reading.file_run import CONTACT_OF, Event, FileRun, FileSimulation
from newton_euler.reading.import_report import CONTACTS
from newton_euler.runs.simulate import simulate

MAX_STEPS = 200_000
"""Largest number of time steps of the judged run; a longer run is judged up to this number."""


TIMINGS = 3
"""Number of runs of which the shortest run time is reported."""

MAX_TIMED_RUN = 0.5
"""Largest run time, s, of a run that is repeated for a more accurate run time."""

MIN_OUTPUTS = 10
"""Smallest number of outputs after the start at which a motion is compared. If a motion is chaotic before so
many outputs of the scene, outputs are closer to each other."""

MAX_OUTPUTS = 20_000
"""Largest number of outputs that are closer to each other than those of the scene."""


@dataclass(frozen=True)
class MeasuredSettings:
    """Settings and the error of the run with them.

    Attributes:
        changes: settings that differ from those of the file, by name.
        fragment: text that gives the file these settings.
        error: error of the run.
    """

    changes: Mapping[str, str]
    fragment: str
    error: RunError

    @property
    def text(self) -> str:
        """The changes as attributes, such as 'timestep="0.001" integrator="RK4"'."""
        return " ".join(f'{name}="{value}"' for name, value in self.changes.items())


def with_names(acting: Sequence[Event], events: Sequence[Event]) -> tuple[Event, ...]:
    """Return the elements that act in the reference's motion, contacts with the names of both bodies.

    Contacts are one element in the reference's motion, and one for each pair of bodies in a run of the file.
    If the run has contacts, its first pair stands for those of the reference's motion.

    Args:
        acting: elements of the file that act in the reference's motion, in the order of time.
        events: events in a run of the file.
    """
    pairs = [event.element for event in events if event.element.startswith(CONTACT_OF)]
    return tuple(
        replace(event, element=pairs[0]) if pairs and event.element == CONTACTS else event for event in acting
    )


@dataclass(frozen=True, eq=False)
class Comparison:
    """A file's simulation and its reference solution at the same output times.

    Attributes:
        simulation: the file in its own engine.
        scene: scene of the reference, with the output times of the comparison.
        reference: reference solution.
        scale: extent of the motion up to `until`, by which errors are divided, and the time until which
            each mechanism is compared.
        every: number of the file's time steps from one output to the next.
        steps: number of the file's time steps in the compared time.
        until: time, s, at which the comparison of all mechanisms ends; None for the whole run.
        reduced: True if runs have all elements switched off that the reference does not simulate; False for
            runs of the file as it stands.
    """

    simulation: FileSimulation[Any]
    scene: Scene
    reference: Trajectory
    scale: MotionScale
    every: int
    steps: int
    until: float | None
    reduced: bool = False
    _runs: dict[Any, FileRun] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        simulation: FileSimulation[Any],
        method: Mapping[str, Any] | None = None,
        horizons: Sequence[float | None] = (),
    ) -> Comparison:
        """Choose output times that are multiples of the file's time step, and simulate the reference.

        The output period is that of the scene. If a mechanism has fewer than `MIN_OUTPUTS` outputs before its
        motion is chaotic, the period is shorter.

        Args:
            simulation: the file in its own engine.
            method: arguments of `newton_euler.simulate` for the reference; those of crosschecks if None.
            horizons: time, s, at which the comparison of each mechanism ends because its motion is chaotic,
                None for the whole run; empty if no mechanism is chaotic. Without `method`, these times are
                found from the reference instead.
        """
        step = simulation.settings.timestep
        scene = simulation.scene
        # if possible a multiple of four, so that RK4 at four times the step (the same number of evaluations)
        # has the same outputs
        every = 4 * round(scene.output_period / step / 4.0) or max(1, round(scene.output_period / step))
        # evaluations of the equations of motion: the limit of a run, and the number per simulated second
        max_duration = simulation.max_evaluations / simulation.evaluations(simulation.settings)
        duration = min(scene.duration, max_duration, MAX_STEPS * step)
        whole = int(duration / step * (1.0 + 1e-9))  # number of steps
        if method is not None:
            every = _steps_between_outputs(every, step, whole, horizons)
        while True:
            # RK4 at four times the step needs one output
            steps = max(whole // every * every, math.lcm(every, 4))
            sampled = replace(
                scene,
                output_period=every * step,
                duration=steps * step,
                outputs=frozenset({"velocities", "energy"}),
            )
            reference = simulate(sampled, **(method or newton_euler_options(sampled)))
            if method is None:
                horizons = comparable_until(sampled, reference)
            closer = _steps_between_outputs(every, step, whole, horizons)
            if method is not None or closer == every:
                scale = MotionScale.of(reference, scene.mechanism, horizons)
                return cls(simulation, sampled, reference, scale, every, steps, None)
            # times at which a motion becomes chaotic are output times, and may be earlier at closer outputs
            every = closer

    def ending_at(self, until: float) -> Comparison:
        """Return the comparison up to a time, s, which divides errors by the motion up to then."""
        ending = replace(self, until=until)
        reference = ending.until_end(self.reference)
        return replace(ending, scale=MotionScale.of(reference, self.scene.mechanism, self.horizons))

    def until_event(self, events: Sequence[Event], run: FileRun) -> Comparison | None:
        """Return the comparison until the first event; None if the motion until then is too short.

        A motion is long enough if it has `MIN_OUTPUTS`, and if the mechanism of the largest error clearly
        moves. The error of a short motion is a large part of the motion, as that grows with the square of
        time.

        Args:
            events: elements that act in the reference's motion, in the order of time; at least one.
            run: run with the settings of the file.
        """
        if not self.reaches(events[0].time):
            return None
        ending = self.ending_at(events[0].time)
        error = ending.error(run)
        by_position = error.relative_position >= error.relative_rotation
        body, _ = error.position_at if by_position else error.rotation_at
        outputs = self._outputs_until(events[0])
        return ending if outputs >= MIN_OUTPUTS and ending.scale.by_body[body].moves(by_position) else None

    def why_too_short(self, event: Event) -> str:
        """Return why the motion until an event is too short to judge, see `until_event`, and what to do."""
        if event.time > (end := float(self.reference.time[-1])):
            return f"the judged run ends at {end:.3g} s, as it has too many time steps"
        outputs = self._outputs_until(event)
        if outputs >= MIN_OUTPUTS:
            return "the motion until then is below the smallest scale"
        step = self.simulation.settings.timestep
        found = f"the comparison has {outputs} of the {MIN_OUTPUTS} outputs that it needs until then"
        # numbers of steps between outputs that `of` makes of an output period: 1, 2 and multiples of four
        most = math.floor(event.time / step / MIN_OUTPUTS * (1.0 - 1e-9))
        if most == 0:
            return f"{found}, and steps of {1e3 * step:g} ms are too long for more"
        every = 4 * (most // 4) or min(most, 2)
        return f"{found}; --set output_period={every * step:.10g} gives enough"

    def _outputs_until(self, event: Event) -> int:
        """Return the number of outputs after the start and before an event."""
        return outputs_before(self.reference.time, event.time) - 1

    @property
    def horizons(self) -> tuple[float | None, ...]:
        """Time, s, at which the comparison of each mechanism ends because its motion is chaotic."""
        return tuple(mechanism.until for mechanism in self.scale.mechanisms)

    def reaches(self, time: float) -> bool:
        """Return True if a time, s, is in the run and the run has outputs between the start and then."""
        return bool(self.reference.time[1] < time <= self.reference.time[-1])

    def run(self, settings: Any, simulation: FileSimulation[Any] | None = None) -> FileRun:
        """Simulate the file, or another simulation, with outputs at the times of the reference.

        Args:
            settings: settings of the run.
            simulation: simulation of a changed model; that of the file if None.
        """
        own_step = self.simulation.settings.timestep
        every = self.every * own_step / settings.timestep
        # outputs at each `stride`-th output time of the reference, as steps may be too long for all of them
        stride = next(n for n in count(1) if round(n * every, 6).is_integer() and n * every > 0.5)
        outputs = self.steps // self.every // stride
        every = round(stride * every)
        return (simulation or self.simulation).run(settings, outputs * every, every, self.reduced)

    def run_once(self, settings: Any) -> FileRun:
        """Return the run with some settings; it is simulated at the first call."""
        key = settings, self.reduced
        if key not in self._runs:
            self._runs[key] = self.run(settings)
        return self.in_window(self._runs[key])

    def in_window(self, run: FileRun) -> FileRun:
        """Return a run, as a complete one if it has all outputs up to the end of the comparison."""
        times = run.trajectory.time
        if self.until is None or not run.stopped or times[-1] == 0.0:
            return run
        # the run may have its outputs only at each second output time of the reference, or fewer
        next_output = times[-1] + times[1]
        return replace(run, stopped="") if next_output >= self.until else run

    def is_comparable(self, run: FileRun) -> bool:
        """Return True if a run has an output after the start at which it is compared."""
        common, _ = common_outputs(self.until_end(run.trajectory), self.reference)
        return self.scale.outputs(common.time) > 1

    def check_outputs(self) -> None:
        """Raise `CrosscheckError` if no output after the start can be compared."""
        if self.scale.outputs(self.reference.time) == 1:
            raise CrosscheckError(
                f"not judged: {early_chaos_text(self.scale)}; needed: a shorter --set duration, or a start "
                "at which the motion is stable"
            )

    @property
    def unjudged_from(self) -> float | None:
        """Time, s, at which the compared run ends although the motion of the file goes on; else None."""
        whole = self.simulation.scene.duration
        return self.scene.duration if self.scene.duration + self.scene.output_period < whole else None

    @property
    def extended_to(self) -> float | None:
        """Time, s, at which the compared run ends if that is after the end of the scene; else None."""
        end = self.scene.duration
        return end if end > self.simulation.scene.duration * (1.0 + 1e-9) else None

    @property
    def completed(self) -> list[FileRun]:
        """Runs of `run_once` that came to the end of the comparison."""
        runs = (run for (_, reduced), run in self._runs.items() if reduced == self.reduced)
        return [run for each in runs if not (run := self.in_window(each)).stopped]

    def affords(self, settings: Any) -> bool:
        """Return True if a run with these settings has few enough evaluations for its engine."""
        return self.simulation.evaluations(settings) * self.scene.duration <= self.simulation.max_evaluations

    def error(self, run: FileRun) -> RunError:
        """Compare a run with the reference, up to the time `until`."""
        return run_error(self.until_end(run.trajectory), self.reference, self.scale)

    def loop_error(self, run: FileRun) -> LoopError:
        """Find the largest violations of the loop constraints of a run, up to the time `until`."""
        return LoopError.of(run.loop_errors, self.until_end(run.trajectory).time)

    def fastest(self, settings: Any) -> FileRun:
        """Return the run with the shortest run time of `TIMINGS` runs; a long run is not repeated."""
        runs = [self.run(settings)]
        while len(runs) < TIMINGS and runs[0].trajectory.wall_time <= MAX_TIMED_RUN:
            runs.append(self.run(settings))
        return min(runs, key=lambda run: run.trajectory.wall_time)

    def relative_run_time(self, settings: Any, run: FileRun, own: FileRun) -> float:
        """Return the run time per second of motion, as a multiple of that with the settings of the file.

        It is the multiple of the evaluations if the run with the settings of the file stopped early.

        Args:
            settings, run: settings, and a complete run with them.
            own: run with the settings of the file.
        """
        if not own.stopped:
            return _pace(run) / _pace(own)
        return self.simulation.evaluations(settings) / self.simulation.evaluations(self.simulation.settings)

    def measured(self, settings: Any, run: FileRun) -> tuple[Mapping[str, str], str, RunError]:
        """Return the fields of `MeasuredSettings` for settings and the run with them."""
        return self.simulation.changes(settings), self.simulation.fragment(settings), self.error(run)

    def apart(self, one: FileRun, two: FileRun) -> RunError:
        """Compare two runs, up to the time `until`."""
        return run_error(self.until_end(one.trajectory), two.trajectory, self.scale)

    def until_end(self, run: Trajectory) -> Trajectory:
        """Return a run up to the time at which the comparison ends."""
        return run.first(outputs_before(run.time, self.until))


def _pace(run: FileRun) -> float:
    """Return the run time per second of motion."""
    return run.trajectory.wall_time / float(run.trajectory.time[-1])


def _steps_between_outputs(every: int, step: float, steps: int, horizons: Sequence[float | None]) -> int:
    """Return a number of steps between outputs with which all mechanisms have `MIN_OUTPUTS` outputs.

    A smaller number than `every` is 1, 2, or four times a product of twos and fives. Then RK4 at four times
    the step has the same outputs, and the period is a short decimal number if the step is one.

    Args:
        every: number of steps between the outputs of the scene.
        step: time step, s.
        steps: number of steps of the run, which has at most `MAX_OUTPUTS` such outputs.
        horizons: time, s, at which the comparison of each mechanism ends; None for the whole run.
    """
    horizon = min((each for each in horizons if each is not None), default=math.inf)
    if MIN_OUTPUTS * every * step < horizon * (1.0 - 1e-9):
        return every
    numbers = {1, 2, *(4 * 2**k * 5**m for k in range(20) for m in range(10))}
    fewest = steps / MAX_OUTPUTS
    closer = [number for number in numbers if fewest <= number < every]
    enough = [number for number in closer if MIN_OUTPUTS * number * step < horizon * (1.0 - 1e-9)]
    return max(enough, default=min(closer, default=every))
