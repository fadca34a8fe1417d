"""Runs of a model file compared with a reference solution at the same output times.

In: a file in its own engine (`newton_euler.reading.file_run.FileSimulation`): MuJoCo for MJCF, Pinocchio for
URDF. Out: runs with any settings, and their errors, for `crosscheck.own_run.judge` and
`crosscheck.own_run.tune`. The reference does not simulate contacts, limits and dry friction. A reduced run
has these elements switched off.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count
from typing import Any

import numpy as np

from crosscheck.engines.engine import newton_euler_options
from crosscheck.own_run.errors import MotionScale, RunError, run_error
from crosscheck.own_run.horizon import comparable_until
from newton_euler.model.scene import Scene
from newton_euler.model.trajectory import Trajectory
from newton_euler.reading.file_run import Event, FileRun, FileSimulation
from newton_euler.runs.simulate import simulate

MAX_STEPS = 200_000
"""Largest number of time steps of the judged run; a longer run is judged up to this number."""


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


def merged(events: Sequence[Event], acting: Sequence[Event]) -> tuple[Event, ...]:
    """Return the first event of each element in two sequences, in the order of time."""
    first: dict[str, Event] = {}
    for event in sorted([*events, *acting], key=lambda event: event.time):
        first.setdefault(event.element, event)
    return tuple(first.values())


@dataclass(frozen=True, eq=False)
class Comparison:
    """A file's simulation and its reference solution at the same output times.

    Attributes:
        simulation: the file in its own engine.
        scene: scene of the reference, with the output times of the comparison.
        reference: reference solution.
        scale: extent of the motion up to `until`, by which errors are divided.
        every: number of the file's time steps from one output to the next.
        steps: number of the file's time steps in the compared time.
        until: time, s, at which the comparison ends; None for the whole run.
    """

    simulation: FileSimulation[Any]
    scene: Scene
    reference: Trajectory
    scale: MotionScale
    every: int
    steps: int
    until: float | None
    _runs: dict[Any, FileRun] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        simulation: FileSimulation[Any],
        method: Mapping[str, Any] | None = None,
        until: float | None = None,
    ) -> Comparison:
        """Choose output times that are multiples of the file's time step, and simulate the reference.

        Args:
            simulation: the file in its own engine.
            method: arguments of `newton_euler.simulate` for the reference; those of crosschecks if None.
            until: time, s, at which the comparison ends, None for the whole run. Without `method`, it is
                found from the reference instead, as the time at which the motion becomes chaotic.
        """
        step = simulation.settings.timestep
        scene = simulation.scene
        # if possible a multiple of four, so that RK4 at four times the step (the same number of evaluations)
        # has the same outputs
        every = 4 * round(scene.output_period / step / 4.0) or max(1, round(scene.output_period / step))
        # evaluations of the equations of motion: the limit of a run, and the number per simulated second
        max_duration = simulation.max_evaluations / simulation.evaluations(simulation.settings)
        duration = min(scene.duration, max_duration, MAX_STEPS * step)
        steps = int(duration / step * (1.0 + 1e-9)) // every * every
        steps = max(steps, math.lcm(every, 4))  # RK4 at four times the step needs one output
        sampled = replace(
            scene,
            output_period=every * step,
            duration=steps * step,
            outputs=frozenset({"velocities", "energy"}),
        )
        reference = simulate(sampled, **(method or newton_euler_options(sampled)))
        if method is None:
            until = comparable_until(sampled, reference)
        whole = MotionScale.of(reference, scene.mechanism)
        compared = cls(simulation, sampled, reference, whole, every, steps, None)
        return compared if until is None else compared.ending_at(until)

    def ending_at(self, until: float) -> Comparison:
        """Return the comparison up to a time, s, which divides errors by the motion up to then."""
        ending = replace(self, until=until)
        scale = MotionScale.of(ending.until_end(self.reference), self.scene.mechanism)
        return replace(ending, scale=scale)

    def reaches(self, time: float) -> bool:
        """Return True if the comparison goes on at a time, s, and has outputs between the start and then."""
        return time > self.reference.time[1] and (self.until is None or time < self.until)

    def run(
        self, settings: Any, reduced: bool = True, simulation: FileSimulation[Any] | None = None
    ) -> FileRun:
        """Simulate the file, or another simulation, with outputs at the times of the reference.

        Args:
            settings: settings of the run.
            reduced: True to switch off all elements that the reference does not simulate.
            simulation: simulation of a changed model; that of the file if None.
        """
        own_step = self.simulation.settings.timestep
        every = self.every * own_step / settings.timestep
        # outputs at each `stride`-th output time of the reference, as steps may be too long for all of them
        stride = next(n for n in count(1) if round(n * every, 6).is_integer() and n * every > 0.5)
        outputs = self.steps // self.every // stride
        every = round(stride * every)
        return (simulation or self.simulation).run(settings, outputs * every, every, reduced)

    def run_once(self, settings: Any) -> FileRun:
        """Return the reduced run with some settings; it is simulated at the first call."""
        if settings not in self._runs:
            self._runs[settings] = self.run(settings)
        return self._runs[settings]

    @property
    def unjudged_from(self) -> float | None:
        """Time, s, at which the compared run ends although the motion of the file goes on; else None."""
        whole = self.simulation.scene.duration
        return self.scene.duration if self.scene.duration + self.scene.output_period < whole else None

    @property
    def completed(self) -> list[FileRun]:
        """Runs of `run_once` that came to their end."""
        return [run for run in self._runs.values() if not run.stopped]

    def affords(self, settings: Any) -> bool:
        """Return True if a run with these settings has few enough evaluations for its engine."""
        return self.simulation.evaluations(settings) * self.scene.duration <= self.simulation.max_evaluations

    def error(self, run: FileRun) -> RunError:
        """Compare a run with the reference, up to the time `until`."""
        return run_error(self.until_end(run.trajectory), self.reference, self.scale)

    def measured(self, settings: Any, run: FileRun) -> tuple[Mapping[str, str], str, RunError]:
        """Return the fields of `MeasuredSettings` for settings and the run with them."""
        return self.simulation.changes(settings), self.simulation.fragment(settings), self.error(run)

    def apart(self, one: FileRun, two: FileRun) -> RunError:
        """Compare two runs, up to the time `until`."""
        return run_error(self.until_end(one.trajectory), two.trajectory, self.scale)

    def until_end(self, run: Trajectory) -> Trajectory:
        """Return a run up to the time at which the comparison ends."""
        if self.until is None:
            return run
        return run.first(max(1, int(np.searchsorted(run.time, self.until))))
